/// Processing: calibration and filters of the numeric fields of any sensor, between its reading and its topic.
///
///     rtdata::Sensor<Pressure> tank(loop, {.name = "tank", .rate = 10_Hz, .process = {
///         {"pressure", {.calibration = rtdata::Calibration{.version = "2026-03", .scale = 2.5, .offset = -0.1},
///                       .filters = {rtdata::Filter::median(5)},
///                       .unit = "bar"}}}}, read_tank);
///
/// A field is named by its path ("temperature", "position.x", "accel[0]"), an array also by its name, which stands for
/// all its elements. Each sample goes through the calibration and then through the filters in their order. The
/// published event has these additional fields after those of the sensor:
///   - `NAME.raw`, the sensor's value of each field that is changed by a calibration, median, mean, exponential or
///     clamp;
///   - `NAME.rate`, optional, of each field with a rate of change.
/// An integer whose value is changed becomes a double, beside the exact integer in `NAME.raw`; float stays float; all
/// else stays as it is. Calculations are in double: `delta` and rates of 64-bit integers beyond 2^53 are rounded.
///
/// A value that is not finite, before or afterwards, or outside its table or bounds, makes the sample unreadable
/// (ledger.hpp); it is never published. A sample that `throttle` or `delta` holds back counts as `filtered`, although
/// the other filters have used it. If several fields have `throttle` or `delta`, the sample is held back only if all of
/// them hold it back.
///
/// Filters restart, as if the next sample were the first, after a start, a gap, a fault, a lost or unreadable sample, a
/// time that goes back, and `AnySensor::set_processing`; filters of an optional field also after it was absent. All
/// memory is allocated when the sensor is made.
///
/// Recordings store each processing with its version and start time, in rtdata_configuration (docs/process.md).
///
/// Values; any thread.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "rtdata/data/description.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata {

enum class OutsideTable : std::uint8_t {
  refuse,  ///< the sample is unreadable
  clamp,   ///< the value of the nearest end
  extend,  ///< extend the line through the two points at that end
};

/// x = raw * scale + offset; then the polynomial or the table of x, if there is one. Or the line through `points`,
/// alone. At the end the tare is subtracted.
struct Calibration {
  std::string version = {};                       ///< for recordings; empty: eight hex digits made from the numbers
  double scale = 1;                               ///< not 0
  double offset = 0;                              ///< in the unit of the scaled value
  std::vector<double> polynomial = {};            ///< c0 + c1 x + c2 x^2 ...: 2 to 10 coefficients
  std::vector<std::array<double, 2>> table = {};  ///< 2 to 1000 pairs of ascending x and value; linear in between
  OutsideTable outside = OutsideTable::refuse;    ///< of a table
  std::optional<double> least = {};               ///< a value below it is unreadable; before the tare
  std::optional<double> most = {};                ///< a value above it is unreadable; before the tare
  /// 2 to 1000 pairs of raw and true value, no raw value twice: the line through them, which continues outside. Without
  /// scale, offset, polynomial and table.
  std::vector<std::array<double, 2>> points = {};
  double tare = 0;  ///< subtracted from the calibrated value, in its unit
};

/// A line through a point of it.
struct CalibrationLine {
  double slope = 0;
  double x = 0;
  double y = 0;
  double largest = 0;        ///< largest residual: true value minus that of the line
  std::size_t farthest = 0;  ///< the point with this residual

  double value(double raw) const noexcept { return (raw - x) * slope + y; }
};
/// The line of Calibration::points: by least squares, exact through two points. Not finite for points that a
/// Calibration refuses.
CalibrationLine line_through(std::span<const std::array<double, 2>> points) noexcept;

/// The value of a raw one; NaN: outside the table, which refuses it. `least` and `most` are not checked.
double calibrated(const Calibration& calibration, double raw) noexcept;

enum class FilterType : std::uint8_t { median, mean, exponential, clamp, throttle, delta, rate_of_change };

struct Filter {
  FilterType type = FilterType::median;
  std::optional<unsigned> of = {};    ///< number of samples. median: odd, 3 to 255; mean: 2 to 1000
  std::optional<double> weight = {};  ///< exponential: weight of the new value, above 0, up to 1
  std::optional<double> least = {};   ///< of a clamp
  std::optional<double> most = {};    ///< of a clamp
  std::optional<Duration> time = {};  ///< of a throttle
  std::optional<double> by = {};      ///< of a delta

  /// The median of the last `of` values, or of all while there are fewer; of an even number, the mean of the middle
  /// two.
  static Filter median(unsigned of) { return {.type = FilterType::median, .of = of}; }
  /// The mean of the last `of` values, or of all while there are fewer.
  static Filter mean(unsigned of) { return {.type = FilterType::mean, .of = of}; }
  /// y += weight * (x - y), beginning with the first value.
  static Filter exponential(double weight) { return {.type = FilterType::exponential, .weight = weight}; }
  /// Lower values become `least`, higher ones `most`.
  static Filter clamp(std::optional<double> least, std::optional<double> most) {
    return {.type = FilterType::clamp, .least = least, .most = most};
  }
  /// Publishes at most one sample in this time, by the times of the samples.
  static Filter throttle(Duration time) { return {.type = FilterType::throttle, .time = time}; }
  /// Publishes a sample only when it differs by this much or more from the last published one.
  static Filter delta(double by) { return {.type = FilterType::delta, .by = by}; }
  /// The change per second of the value after the previous filters, in `NAME.rate`; absent for the first sample and if
  /// no time has passed since the last one.
  static Filter rate_of_change() { return {.type = FilterType::rate_of_change}; }
};

struct FieldProcessing {
  std::optional<Calibration> calibration = {};
  std::vector<Filter> filters = {};      ///< at most 8
  std::optional<std::string> unit = {};  ///< UCUM, of the calibrated value; unset: the unit of the raw value
};

/// The configuration of calibrations and filters: the key `process` of every sensor.
///
///     {"name": "tank", "type": "analog", ..., "process": {"value": {
///         "calibration": {"version": "2026-03", "table": [[0.5, 0], [4.5, 10]]},
///         "filters": [{"type": "median", "of": 5}, {"type": "throttle", "time": "1 s"}], "unit": "bar"}}}
constexpr auto parameters(type_tag<Calibration>) {
  return parameter_list(
      parameter("version", &Calibration::version, "version, kept in recordings; default: made from the numbers",
                TextIs::recorded),
      parameter("scale", &Calibration::scale, "factor of the raw value", not_zero),
      parameter("offset", &Calibration::offset, "added after `scale`"),
      parameter("polynomial", &Calibration::polynomial, "coefficients c0, c1, c2 ..., 2 to 10; applied after `offset`"),
      parameter("table", &Calibration::table,
                "pairs [input, value], 2 to 1000, with straight lines between them; applied after `offset`"),
      parameter("outside", &Calibration::outside, "how a value outside the table is treated",
                choices(value("refuse", OutsideTable::refuse), value("clamp", OutsideTable::clamp),
                        value("extend", OutsideTable::extend))),
      parameter("least", &Calibration::least, "smaller values are unreadable"),
      parameter("most", &Calibration::most, "larger values are unreadable"),
      parameter("points", &Calibration::points,
                "pairs [raw value, true value], 2 to 1000: the calibration is a straight line through them, without "
                "the settings above"),
      parameter("tare", &Calibration::tare,
                "subtracted at the end, after `least` and `most` are checked; `rtdata ctl tare` sets it"));
}

constexpr auto parameters(type_tag<Filter>) {
  using namespace std::chrono_literals;
  return parameter_list(
      parameter("type", &Filter::type, "what the filter does", required,
                choices(value("median", FilterType::median), value("mean", FilterType::mean),
                        value("exponential", FilterType::exponential), value("clamp", FilterType::clamp),
                        value("throttle", FilterType::throttle), value("delta", FilterType::delta),
                        value("rate_of_change", FilterType::rate_of_change))),
      parameter("of", &Filter::of, "number of samples. median: odd, 3 to 255; mean: 2 to 1000",
                only_with("type", "median", "mean")),
      parameter("weight", &Filter::weight, "weight of the new value: above 0, up to 1",
                only_with("type", "exponential")),
      parameter("least", &Filter::least, "smaller values are replaced by this value", only_with("type", "clamp")),
      parameter("most", &Filter::most, "larger values are replaced by this value", only_with("type", "clamp")),
      parameter("time", &Filter::time, "at most one sample in this time", range(Duration{1}, Duration{24h}),
                only_with("type", "throttle")),
      parameter("by", &Filter::by, "only values that differ by at least this from the last published one",
                only_with("type", "delta")));
}

constexpr auto parameters(type_tag<FieldProcessing>) {
  return parameter_list(parameter("calibration", &FieldProcessing::calibration,
                                  "makes the value from the raw value, which is kept in `NAME.raw`"),
                        parameter("filters", &FieldProcessing::filters,
                                  "filters of the calibrated value, applied in this order; at most 8"),
                        parameter("unit", &FieldProcessing::unit,
                                  "unit of the calibrated value; default: the unit of the raw value", TextIs::unit));
}

void check_config(const FieldProcessing& config, const ConfigItem& item, Problems& problems);

/// By the path of the field.
using Processing = std::map<std::string, FieldProcessing>;

/// A mistake in a part of a Processing.
struct ProcessingMistake {
  std::string field;  ///< path of the field
  std::string key;    ///< key of the wrong part, such as "table"; empty: the field itself
  std::string why;
  std::string advice;
};

/// Thrown if a Processing does not fit a sensor.
class ProcessingError : public SetupError {
 public:
  ProcessingError(const std::string& sensor, std::vector<ProcessingMistake> mistakes);
  const std::vector<ProcessingMistake>& mistakes() const noexcept { return mistakes_; }

 private:
  std::vector<ProcessingMistake> mistakes_;
};

/// The description of the published event, made from the sensor's own description; the same if nothing is added or
/// changed. ProcessingError: a field that does not exist or is not a number, a mistake in a part, or a payload above 4
/// KiB.
std::shared_ptr<const Description> processed(const std::shared_ptr<const Description>& description,
                                             const Processing& processing, const std::string& sensor);

}  // namespace rtdata
