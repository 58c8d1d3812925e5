// Live raw values of a sensor field, for `rtdata calibrate`: from a running instance, or from the sensor, made only
// for this.
#pragma once

#include <cstddef>
#include <memory>
#include <string>

#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// The values that came in some time.
struct TakenValues {
  std::size_t count = 0;
  double sum = 0, least = 0, most = 0;
  void add(std::size_t values, double their_mean, double their_least, double their_most);
  double mean() const { return sum / static_cast<double>(count); }
};

/// Thread: the one that made it.
class RawValues {
 public:
  virtual ~RawValues() = default;
  /// "the running instance bench, pid 4711"
  virtual std::string where() const = 0;
  /// Waits this long and takes the values that come meanwhile. Errors: no more can come.
  virtual Result<TakenValues> take(Duration time) = 0;
};

/// Null: no instance that answers runs this configuration with this sensor.
std::unique_ptr<RawValues> values_of_instance(const std::string& file, const std::string& sensor,
                                              const std::string& field);

/// A configuration with only this sensor and the parts that it uses: raw, on the main loop, without sinks. SetupError
/// if it uses outputs or machines, which must not run for this.
SystemPlan plan_alone(const Registry& registry, const SystemPlan& plan, const PartPlan& sensor);

/// Makes that sensor. Its errors are printed. SetupError. `alone`, `registry`: outlive it.
std::unique_ptr<RawValues> values_of_sensor(const Registry& registry, const SystemPlan& alone,
                                            const std::string& sensor, const std::string& field);

}  // namespace rtdata::app
