// Text in HTML.
#pragma once

#include <string>
#include <string_view>

namespace rtdata::app {

/// Escapes a text for an element or a quoted attribute: it cannot contain markup; characters that are not printable
/// become '?'. A text of more than `most` characters is cut.
std::string html_text(std::string_view text, std::size_t most = 400);

}  // namespace rtdata::app
