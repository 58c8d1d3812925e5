/// Any bytes as a line of gpsd: reading it must neither crash nor give a position that there is not.
///
///     tests/fuzz/run.sh 60
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "sensors/gps/gps_report.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static rtdata::detail::GpsReport report;  // is used again, as by the sensor
  const std::string_view line(reinterpret_cast<const char*>(data), size);
  const auto done = rtdata::detail::read_report(line, report);
  if (!done) {
    if (done.error().why.empty()) std::abort();
    return 0;
  }
  if (report.kind == rtdata::detail::GpsReport::Kind::none) std::abort();
  if (report.kind != rtdata::detail::GpsReport::Kind::fix) return 0;
  if (!(std::abs(report.fix.lat.value_or(0)) <= 90 && std::abs(report.fix.lon.value_or(0)) <= 180)) std::abort();
  if (report.fix.satellites_used || report.fix.satellites_visible) std::abort();
  return 0;
}
