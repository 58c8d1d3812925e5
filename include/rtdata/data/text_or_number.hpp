/// TextOrNumber: what a value of a configuration may be that is a text or a whole number.
///
///     template <>
///     struct rtdata::ConfigValue<Address> {
///       static constexpr TextOrNumber accepts{8, 119, "^0x[0-7][0-9a-f]$"};  // "0x76", or 118
///       static bool read(const ConfigItem&, Address&, Problems&);
///       static void write(const Address&, ConfigItem&);
///     };
///
/// The schema of configurations says it. Values; any thread.
#pragma once

#include <string_view>

namespace rtdata {

struct TextOrNumber {
  double least, most;        ///< of a whole number
  std::string_view pattern;  ///< of a text: a regular expression of JSON Schema
};

}  // namespace rtdata
