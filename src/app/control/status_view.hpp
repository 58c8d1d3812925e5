// A status as text for people: what `top` and a run on a terminal show, and the tables at the end of a run.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "app/control/status.hpp"

namespace rtdata::app {

/// Lines of at most so many columns, and `rows` of them if that is enough for the most urgent. What is not well comes
/// first; where rows are few, callbacks and other parts are left out, then what is well: "and 5 more, all well".
std::vector<std::string> lines_of(const Status& status, std::size_t columns, std::size_t rows);

/// What each topic and sink came to, at most `columns` wide where names allow (0: as wide as they are).
std::string summary(const Status& status, std::size_t columns);

}  // namespace rtdata::app
