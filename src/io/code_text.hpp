// Numbers of chips, such as addresses: in configurations 118 or "0x76".
#pragma once

#include <charconv>
#include <string>
#include <string_view>

#include "rtdata/data/config_item.hpp"
#include "rtdata/data/config_value.hpp"

namespace rtdata::detail {

/// `wanted`: "an address: write it as ..."
inline bool read_code(const ConfigItem& item, unsigned& number, const char* wanted, Problems& problems) {
  if (item.kind() != ConfigItem::Kind::string) return ConfigValue<unsigned>::read(item, number, problems);
  std::string_view text;
  if (!config_detail::read_string(item, text, problems)) return false;
  const bool is_hex = text.starts_with("0x") || text.starts_with("0X");
  const std::string_view digits = text.substr(is_hex ? 2 : 0);
  const auto [end, status] = std::from_chars(digits.data(), digits.data() + digits.size(), number, is_hex ? 16 : 10);
  if (status == std::errc{} && end == digits.data() + digits.size()) return true;
  problems.add(item.problem("bad-value", "\"" + std::string(text) + "\" is not " + wanted));
  return false;
}

}  // namespace rtdata::detail
