// The reports of gpsd, a JSON object a line (man gpsd_json).
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/error.hpp"
#include "rtdata/sensors/gps.hpp"

namespace rtdata::detail {

struct GpsReport {
  enum class Kind : std::uint8_t { none, fix, satellites, device, devices, error, other };
  Kind kind = Kind::none;
  GpsFix fix;                            ///< of a fix, without satellites; `device` of all kinds that have one
  std::optional<std::uint16_t> used;     ///< satellites
  std::optional<std::uint16_t> visible;  ///< satellites
  std::vector<std::string> devices;      ///< of the list of devices
  bool is_deactivated = false;           ///< of a device: gpsd has lost it
  std::string message;                   ///< of an error
};

/// The line, without its end, as a report. Errors: bad-data, not-a-number, out-of-range, does-not-fit; `report` is then
/// not usable.
Result<void> read_report(std::string_view line, GpsReport& report);

}  // namespace rtdata::detail
