/// Load: how long the sensors of a loop may hold it, estimated before it runs from what their drivers declare.
///
///     rtdata::Tier fast(loop, {.name = "fast"});
///     rtdata::Sensor<Pressure> chamber(fast.loop(), {.name = "chamber", .rate = 1_kHz, .read_time = 200us}, read_adc);
///     const rtdata::LoopLoad load = fast.loop().load();
///     if (load.is_overloaded()) complain(load.text());  // "fast: 1 sensor, worst 200 us of 1 ms, 20 %"
///
/// `worst` is the sum of the reads that come due within the loop's shortest period: each sensor once, but of sensors
/// that share a longer period only those whose phases lie within one shortest period of each other. Sensors of
/// different periods, without a schedule or not running are assumed to coincide. A read on a lane counts for the lane;
/// it holds the loop only while it is decoded, at another time for each sensor, and so counts there with its share of
/// the shortest period. Handlers are not counted.
///
/// Values; any thread.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "rtdata/data/time.hpp"

namespace rtdata {

/// How long one reading takes at most while the device is well.
struct ReadTime {
  std::optional<Duration> on_loop = {};  ///< it holds the loop; unset: not known
  std::optional<Duration> on_lane = {};  ///< it holds its lane; unset: not known, or it uses none
  std::string lane = {};                 ///< one for each physical device; empty: it is read on the loop
};

/// What the estimate needs of a sensor.
struct SensorLoad {
  std::string name = {};
  Duration period{0};                  ///< 0: no schedule
  std::optional<Duration> phase = {};  ///< unset: not known
  ReadTime time = {};
};

struct LaneLoad {
  std::string lane = {};
  std::size_t sensors = 0;   ///< with a schedule
  std::size_t declared = 0;  ///< of these, how many say how long they hold it
  double share = 0;          ///< of the lane's time; above 1 it cannot be done

  bool is_overloaded() const noexcept;
  /// "lane adc0: 3 sensors, 45 % (2 of 3 declared)"
  std::string text() const;
};

struct LoopLoad {
  static constexpr double most = 0.8;  ///< above it a loop or lane is overloaded: the rest is for all else

  std::string loop = {};
  std::size_t sensors = 0;   ///< that are read, on the loop or on a lane
  std::size_t declared = 0;  ///< of these, how many say how long they hold the loop; the others are not in `worst`
  Duration worst{0};
  Duration period{0};  ///< the shortest; 0: nothing has a schedule
  double busy = 0;     ///< share of the loop's time that all readings take in the long run
  std::vector<LaneLoad> lanes = {};

  /// worst / period; 0 without a schedule. No less than the share of time that all readings take in the long run.
  double share() const noexcept;
  /// The readings take more of the loop's time than there is to spare, whenever they come.
  bool is_too_busy() const noexcept { return busy > most; }
  bool is_overloaded() const noexcept { return share() > most; }
  /// "fast: 3 sensors, worst 1.4 ms of 2 ms, 70 % (2 of 3 declared)"
  std::string text() const;
};

LoopLoad estimate_load(std::string loop, std::span<const SensorLoad> sensors);

}  // namespace rtdata
