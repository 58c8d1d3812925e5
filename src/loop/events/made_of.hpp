// What makes its events of those of other topics: recordings keep the account of these, too.
#pragma once

#include <string>
#include <vector>

namespace rtdata::detail {

class OriginCore;

/// Says so of an origin that is claimed; the sinks and the main loop hear it. Loop's thread. Throws; may be called
/// again.
void set_made_of(OriginCore& origin, std::vector<std::string> topics);

}  // namespace rtdata::detail
