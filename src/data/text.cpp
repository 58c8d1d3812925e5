#include "rtdata/data/text.hpp"

#include <string>

namespace rtdata::detail {

Error text_too_long(std::string_view text, std::size_t capacity) {
  std::string where = "\"";
  where.append(text.substr(0, 40)).append(text.size() > 40 ? "...\"" : "\"");
  return {Errc::does_not_fit, "the text is too long", std::move(where),
          std::to_string(text.size()) + " bytes, " + std::to_string(capacity) + " fit",
          "shorten it, or give the field a larger rtdata::text<N>"};
}

void throw_text_too_long(std::string_view text, std::size_t capacity) {
  throw SetupError(text_too_long(text, capacity));
}

}  // namespace rtdata::detail
