// docs/errors.md, as it was when the program was built. Private to the program.
#pragma once

namespace rtdata::app {

extern const char* const errors_page;

}  // namespace rtdata::app
