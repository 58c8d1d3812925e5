// Selects output for people or for programs. Private to the program.
#pragma once

namespace rtdata::app {

enum class ShowAs { text, json };

}  // namespace rtdata::app
