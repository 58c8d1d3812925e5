#include "loop/events/made_of.hpp"

#include <utility>

#include "loop/events/origin_core.hpp"
#include "loop/events/topic_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {

void set_made_of(OriginCore& origin, std::vector<std::string> topics) {
  origin.made_of = std::move(topics);
  const auto& listeners = origin.topic.runtime().listeners;
  for (std::size_t i = 0; i < listeners.size(); ++i) listeners[i]->on_made_of(origin);
}

}  // namespace rtdata::detail
