/// What calibrations and filters are called in a configuration file: the key `process` of every sensor.
///
///     {"name": "tank", "type": "analog", ..., "process": {"value": {
///         "calibration": {"version": "2026-03", "table": [[0.5, 0], [4.5, 10]]},
///         "filters": [{"type": "median", "of": 5}, {"type": "throttle", "time": "1 s"}], "unit": "bar"}}}
///
/// Values; any thread.
#pragma once

#include "rtdata/data/parameter.hpp"
#include "rtdata/process/processing.hpp"

namespace rtdata {

constexpr auto parameters(type_tag<Calibration>) {
  return parameter_list(
      parameter("version", &Calibration::version, "kept in recordings; default: made from the numbers",
                TextIs::recorded),
      parameter("scale", &Calibration::scale, "the raw value is multiplied by it", not_zero),
      parameter("offset", &Calibration::offset, "added to that"),
      parameter("polynomial", &Calibration::polynomial, "its coefficients, of that: c0, c1, c2 ..., 2 to 10"),
      parameter("table", &Calibration::table, "pairs of that and the value, 2 to 1000, straight between them"),
      parameter("outside", &Calibration::outside, "what becomes of a value outside the table",
                choices(value("refuse", OutsideTable::refuse), value("clamp", OutsideTable::clamp),
                        value("extend", OutsideTable::extend))),
      parameter("least", &Calibration::least, "a value below it is unreadable"),
      parameter("most", &Calibration::most, "a value above it is unreadable"));
}

constexpr auto parameters(type_tag<Filter>) {
  using namespace std::chrono_literals;
  return parameter_list(
      parameter("type", &Filter::type, "what it does", required,
                choices(value("median", FilterType::median), value("mean", FilterType::mean),
                        value("exponential", FilterType::exponential), value("clamp", FilterType::clamp),
                        value("throttle", FilterType::throttle), value("delta", FilterType::delta),
                        value("rate_of_change", FilterType::rate_of_change))),
      parameter("of", &Filter::of, "so many samples: of a median odd, 3 to 255; of a mean 2 to 1000",
                only_with("type", "median", "mean")),
      parameter("weight", &Filter::weight, "of the new value, above 0, up to 1", only_with("type", "exponential")),
      parameter("least", &Filter::least, "what is below becomes this", only_with("type", "clamp")),
      parameter("most", &Filter::most, "what is above becomes this", only_with("type", "clamp")),
      parameter("time", &Filter::time, "at most one sample in this time", range(Duration{1}, Duration{24h}),
                only_with("type", "throttle")),
      parameter("by", &Filter::by, "only what differs by so much from what was published last",
                only_with("type", "delta")));
}

constexpr auto parameters(type_tag<FieldProcessing>) {
  return parameter_list(
      parameter("calibration", &FieldProcessing::calibration, "from the raw value, which is kept in `NAME.raw`"),
      parameter("filters", &FieldProcessing::filters, "of the calibrated value, in their order; at most 8"),
      parameter("unit", &FieldProcessing::unit, "of the calibrated value; default: that of the raw one", TextIs::unit));
}

void check_config(const FieldProcessing& config, const ConfigItem& item, Problems& problems);

}  // namespace rtdata
