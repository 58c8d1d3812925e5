#include "app/inspect/html.hpp"

#include "app/core/table.hpp"

namespace rtdata::app {

std::string html_text(std::string_view text, std::size_t most) {
  std::string out;
  for (const char character : fitted(text, most)) {
    switch (character) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default:
        out += character;
    }
  }
  return out;
}

}  // namespace rtdata::app
