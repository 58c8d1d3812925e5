// The tables that hold what was recorded on a topic.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace rtdata::sqlite {

/// All that have rows by run, of one row of rtdata_topic: `table`, which has the events, is the first.
inline std::vector<std::string> tables_of_topic(std::string_view table) { return {std::string(table)}; }

}  // namespace rtdata::sqlite
