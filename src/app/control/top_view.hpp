// What `rtdata top` shows of an instance's status.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace rtdata::app {

/// The status (StatusSource::text) as lines of at most `columns`. Sensors and sinks that are not well come first, with
/// the reason. When there are more than `rows`, callbacks and parts are left out, then sinks and sensors, whose number
/// is told: "and 5 more, all well".
std::vector<std::string> lines_of_status(const std::string& answer, std::size_t columns, std::size_t rows);

}  // namespace rtdata::app
