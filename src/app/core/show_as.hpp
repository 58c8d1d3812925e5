// Selects output as text or as JSON. Private to the program.
#pragma once

namespace rtdata::app {

enum class ShowAs { text, json };

}  // namespace rtdata::app
