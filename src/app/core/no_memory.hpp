// The end of the program where there is no memory.
#pragma once

namespace rtdata::app {

/// Says so on standard error, and while FatalSignals lives in its log; ends the program with status 1.
[[noreturn]] void end_without_memory() noexcept;

}  // namespace rtdata::app
