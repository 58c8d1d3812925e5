// Origins whose events are made from other topics: recordings also store the accounts of these topics.
#pragma once

#include <string>
#include <vector>

namespace rtdata::detail {

class OriginCore;

/// Sets the source topics of a claimed origin and notifies the sinks and the main loop. Loop's thread. Throws; may be
/// called again.
void set_made_of(OriginCore& origin, std::vector<std::string> topics);

}  // namespace rtdata::detail
