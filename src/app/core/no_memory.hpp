// Ends the program when there is no memory.
#pragma once

namespace rtdata::app {

/// Writes a message to standard error and, while FatalSignals lives, to its log; ends the program with status 1.
[[noreturn]] void end_without_memory() noexcept;

}  // namespace rtdata::app
