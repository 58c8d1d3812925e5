#include "loop/events/made_of.hpp"

#include "loop/events/origin_core.hpp"
#include "loop/events/topic_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {

void tell_followers(OriginCore& origin) {
  for (Recorder* const recorder : origin.topic.runtime().recorders)
    if (auto* const follower = dynamic_cast<FollowsSources*>(recorder)) follower->follow(origin);
}

}  // namespace rtdata::detail
