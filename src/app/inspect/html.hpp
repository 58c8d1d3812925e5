// Text in HTML.
#pragma once

#include <string>
#include <string_view>

namespace rtdata::app {

/// As text in an element or in an attribute in quotes, whatever it holds, with no markup; what is not printable becomes
/// '?'. A longer one than `most` characters is cut.
std::string html_text(std::string_view text, std::size_t most = 400);

}  // namespace rtdata::app
