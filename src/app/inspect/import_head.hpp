// The heading of a table that is imported. Private to the program.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "app/core/recording_commands.hpp"
#include "app/inspect/import_columns.hpp"
#include "app/inspect/import_rows.hpp"
#include "app/inspect/import_time.hpp"

namespace rtdata::app {

/// Reads the heading and the row of units after it, and names the columns, unless they are named by hand. The heading
/// may be in a comment line if that names the time and has as many cells as the rows. Throws SetupError:
/// bad-argument, bad-data.
std::vector<ImportColumn> read_head(ImportRows& table, const ImportOptions& options, const ImportNotation& notation);

/// The column with this heading, written with its unit or without. Throws SetupError: bad-argument, which says how to
/// read the table so that it has one.
std::size_t find_column(const std::vector<ImportColumn>& columns, const std::string& heading,
                        const ImportOptions& options, const ImportNotation& notation);

/// How to write a separator on the command line.
std::string shown_separator(char separator);

}  // namespace rtdata::app
