// Replaces a file atomically: completely, or not at all.
#pragma once

#include <string>

#include "rtdata/data/error.hpp"

namespace rtdata::app {

/// Writes the text to a new file beside it and on the disk, which then takes its place; one that is there keeps its
/// owner and permissions, and links to it stay. Blocks. Errors: those of the system; then the file is as it was.
Result<void> replace_file(const std::string& file, const std::string& text);

}  // namespace rtdata::app
