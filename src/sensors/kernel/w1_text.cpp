#include <algorithm>
#include <array>
#include <charconv>
#include <optional>

#include "data/number_text.hpp"
#include "io/kernel_file.hpp"
#include "rtdata/sensors/w1.hpp"

namespace rtdata {
namespace {

constexpr const char* unreadable_w1 = "cannot read the thermometer";

/// The nine bytes at the beginning of the text.
std::optional<std::array<unsigned, 9>> scratchpad(std::string_view text) {
  std::array<unsigned, 9> bytes{};
  for (unsigned& byte : bytes) {
    const auto [end, status] = std::from_chars(text.data(), text.data() + std::min<std::size_t>(text.size(), 2), byte,
                                               16);
    if (status != std::errc{} || end != text.data() + 2 || text.size() < 3 || text[2] != ' ') return {};
    text.remove_prefix(3);
  }
  return bytes;
}

}  // namespace

Result<double> parse_w1(std::string_view text) {
  const auto refused = [](Errc code, std::string why, const char* advice) {
    return Error{code, unreadable_w1, "", std::move(why), advice};
  };
  if (detail::trimmed(text).empty())  // what the driver gives when the device does not answer
    return refused(Errc::disconnected, "it does not answer", "check its wires and its pull-up resistor");
  const auto bytes = scratchpad(text);
  const std::size_t equals = text.rfind("t=");
  std::int64_t thousandths = 0;
  if (!bytes || equals == std::string_view::npos ||
      detail::read_number(detail::trimmed(text.substr(equals + 2)), thousandths) != std::errc{}) {
    return refused(Errc::bad_data, "this is not text of w1_therm", "check `device`");
  }
  const std::string_view first = text.substr(0, text.find('\n'));
  if (!detail::trimmed(first).ends_with(" YES")) {
    return refused(Errc::bad_data, "its checksum is wrong",
                   "check the wires: long ones need a smaller pull-up resistor");
  }
  if (std::all_of(bytes->begin(), bytes->end(), [](unsigned byte) { return byte == 0; }))
    return refused(Errc::bad_data, "all bits are 0", "check whether the data line is shorted to ground");
  constexpr std::int64_t power_on = 85000;
  if (thousandths == power_on && (*bytes)[6] == 0x0c) {
    return refused(Errc::bad_data, "85 degrees is its value before the first measurement",
                   "check its wires: it has lost its supply");
  }
  if (thousandths < -55000 || thousandths > 125000) {
    return refused(Errc::out_of_range,
                   std::to_string(thousandths) + "/1000 degrees is outside its range, -55 to 125 degrees",
                   "check its wires");
  }
  return static_cast<double>(thousandths) * 1e-3;
}

}  // namespace rtdata
