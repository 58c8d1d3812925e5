// Bytes written as two hexadecimal digits each, with blanks between them or not.
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace rtdata::detail {

/// Empty: the text is not hexadecimal bytes.
std::optional<std::string> bytes_of_hex(std::string_view text);

}  // namespace rtdata::detail
