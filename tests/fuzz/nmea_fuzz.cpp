/// Any bytes as the lines of a receiver: reading them must neither crash nor give a position that there is not.
///
///     tests/fuzz/run.sh 60
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "sensors/lines/nmea.hpp"

using rtdata::GpsFix;
using rtdata::detail::NmeaFixes;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  NmeaFixes fixes("/dev/gps");
  std::size_t lines = 0, published = 0;
  rtdata::Time last{};
  const NmeaFixes::Publish publish = [&](const GpsFix& fix, rtdata::Time time) {
    ++published;
    if (time < last) std::abort();
    last = time;
    const auto is_within = [](const std::optional<double>& value, double most) {
      return std::abs(value.value_or(0)) <= most;
    };
    if (!is_within(fix.lat, 90) || !is_within(fix.lon, 180)) std::abort();
    for (const auto& value :
         {fix.lat, fix.lon, fix.alt_msl, fix.alt_hae, fix.speed, fix.track, fix.mag_var, fix.geoid_sep})
      if (value && !std::isfinite(*value)) std::abort();
    if (fix.mode > 3 || (fix.mode == 1 && (fix.lat || fix.lon || fix.speed || fix.alt_msl))) std::abort();
  };
  std::string_view rest(reinterpret_cast<const char*>(data), size);
  while (!rest.empty()) {
    const std::string_view line = rest.substr(0, rest.find('\n'));
    rest.remove_prefix(std::min(line.size() + 1, rest.size()));
    const rtdata::Time time(rtdata::Duration(static_cast<std::int64_t>(++lines)));
    // As it is, and with a right checksum, without which hardly anything would come through.
    if (const auto done = fixes.take(line, time, publish); !done && done.error().why.empty()) std::abort();
    constexpr char digits[] = "0123456789ABCDEF";
    const unsigned sum = NmeaFixes::checksum(line);
    const std::string right = "$" + std::string(line) + "*" + digits[sum / 16] + digits[sum % 16];
    if (const auto done = fixes.take(right, time, publish); !done && done.error().why.empty()) std::abort();
  }
  fixes.finish(publish);
  if (published > 2 * lines) std::abort();
  return 0;
}
