// A status as readable text, for `top`, a run on a terminal, and the tables at the end of a run.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "app/control/status.hpp"

namespace rtdata::app {

/// Lines of at most `columns` columns, and at most `rows` lines if that is enough for the most urgent. Problems come
/// first; if there are few rows, callbacks and other parts are left out, then objects without problems: "and 5 more,
/// all well".
std::vector<std::string> lines_of(const Status& status, std::size_t columns, std::size_t rows);

/// The result of each topic and sink, at most `columns` wide if the names allow (0: no limit).
std::string summary(const Status& status, std::size_t columns);

}  // namespace rtdata::app
