/// Output: something that is set (a GPIO line, a PWM channel, a device on a serial line), with a safe value.
///
///     const auto make_pump = [] {
///       return std::make_unique<rtdata::GpioActuator>(rtdata::GpioActuatorConfig{.line = 5});
///     };
///     rtdata::Output pump(loop, {.name = "pump", .lease = 2s}, make_pump);
///     pump.set(1, "operator").or_throw();
///
///     rtdata::Output fan(loop, {.name = "fan", .on = "room/air", .expression = "temperature > 28"}, make_fan);
///
/// An `Actuator` sets the device: two functions, which you can write for your own devices.
///
/// The value of an output has one source: `set`, or the topics in its configuration (`on`, `expression`; names and ages
/// as for derived values, sensors/derived.hpp). Setting the value that it already has changes nothing, but extends the
/// lease; it is counted as `repeated`.
///
/// It has its safe value
///   - from the start: the device is opened with it in one step, or with `keep` as it is;
///   - from the beginning of `stop`, of the end of its loop, of closing, or of the destructor (not with `keep`);
///   - while there is no input for `max_age`, or the expression fails or gives a value that the device does not take;
///     the output follows the input again when it is good again;
///   - when `lease` has passed since the last `set`, until the next one;
///   - after a failed `set`: the output tries again each second until the device takes it;
///   - while it is disarmed: it refuses `set` and ignores its input;
///   - if a guard holds the device (guard.hpp), when its loop does not turn for `watchdog` or the program ends for any
///     reason: the output is then disarmed and must be armed again. Without a guard this does not happen.
///
/// Each change is an event on its topic, an OutputChange: the requested value, the value of the device, the reason, who
/// asked, and how long it took. Arming, disarming and refusals are events too.
///
/// The device is set on a lane, or in the guard, so a slow device does not hold the loop. While one value is being set,
/// only the latest new value is kept; earlier ones are reported as replaced, or, if they come from a topic, counted as
/// `filtered`. At its start and end, an output waits for the device.
///
/// This is not a safety system: docs/outputs.md lists its limits.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/control/controllers.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/data/description.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/data/text.hpp"
#include "rtdata/loop/callback.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

/// The values that a device takes; default: any finite number.
struct OutputRange {
  double least = -std::numeric_limits<double>::infinity();
  double most = std::numeric_limits<double>::infinity();
  bool is_whole = false;  ///< whole numbers only; for a GPIO line: {0, 1, true}
  /// Why it refuses this value, as a text: "0.5 is not a value for the device: 0 or 1". Empty: it accepts the value.
  std::string refusal(double value) const;
};

/// A device that can be set. The constructor does not use the device; the destructor releases it as it is. Thread: any,
/// one at a time: of a lane or of the guard. An exception counts as a failure.
class Actuator {
 public:
  virtual ~Actuator() = default;
  /// The values that it takes, from its settings alone, before it is open. `rtdata check` and each Output refuse other
  /// values, so the device never gets them.
  virtual OutputRange range() const { return {}; }
  /// Opens the device and sets this value, in one step if the device can; an empty value means to leave it as it is.
  /// Called once; after an error a new Actuator is made.
  virtual Result<void> open(std::optional<double> value) = 0;
  /// Returns when the device has the value.
  virtual Result<void> set(double value) = 0;
};
/// An Actuator whose device may disappear between two values and come back without the last one.
///
/// A guard (guard.hpp) calls `check` each second. After an error the output has failed: the guard makes a new Actuator
/// and sets it to the safe value as soon as possible. Without a guard there is no check.
class CheckedActuator : public Actuator {
 public:
  /// Checks that the device with the last value is still there. Does not wait. Errors: disconnected, or the device's
  /// error.
  virtual Result<void> check() = 0;
};

using MakeActuator = std::function<std::unique_ptr<Actuator>()>;
/// The range of the devices that `make` makes; any finite number if it cannot make one.
OutputRange range_of(const MakeActuator& make) noexcept;

enum class OutputCause : std::uint8_t { start, set, input, stale, lease, arm, disarm, watchdog, failure, stop };
constexpr auto describe(type_tag<OutputCause>) {
  return enumeration("output_cause", value("start", OutputCause::start), value("set", OutputCause::set),
                     value("input", OutputCause::input), value("stale", OutputCause::stale),
                     value("lease", OutputCause::lease), value("arm", OutputCause::arm),
                     value("disarm", OutputCause::disarm), value("watchdog", OutputCause::watchdog),
                     value("failure", OutputCause::failure), value("stop", OutputCause::stop));
}

/// The event of an output for each change.
struct OutputChange {
  double asked = 0;
  std::optional<double> done = {};  ///< the value of the device now; empty: not set, see `why`
  OutputCause cause = OutputCause::start;
  bool armed = false;  ///< armed after the change
  double took = 0;     ///< from the request until the device had the value
  text<48> by = {};    ///< who asked: the `by` of `set`, `arm` and `disarm`, or the topic
  text<160> why = {};  ///< why it was not done; empty: it was done
  friend constexpr auto describe(type_tag<OutputChange>) {
    return record("output_change", field("asked", &OutputChange::asked), field("done", &OutputChange::done),
                  field("cause", &OutputChange::cause), field("armed", &OutputChange::armed),
                  field("took", &OutputChange::took, "s"), field("by", &OutputChange::by),
                  field("why", &OutputChange::why))
        .of_changes();
  }
};

enum class Arming : std::uint8_t { at_start, by_command };

struct OutputConfig {
  std::string name = {};               ///< the origin of its events
  std::string topic = {};              ///< empty: its name
  double safe = 0;                     ///< in the actuator's unit; for a line or a condition 1 is on, 0 off
  std::string on = {};                 ///< the topic that it follows; empty: it is set by `set`
  std::vector<std::string> with = {};  ///< other topics; their latest values are used
  std::string expression = {};         ///< gives its value; empty: the only number of the topic `on`
  std::optional<HysteresisConfig> hysteresis = {};     ///< switches on or off by the value of the expression
  std::optional<PidConfig> pid = {};                   ///< controls the value of the expression
  Duration max_age = std::chrono::seconds{5};          ///< without an event for longer, an input is stale
  Duration lease{0};                                   ///< a `set` is valid for this long; 0: until the next one
  Duration watchdog = std::chrono::milliseconds{500};  ///< how long the guard waits for the loop
  Arming armed = Arming::at_start;
  bool required = false;  ///< a device that is missing or silent at the start throws
  bool keep = false;      ///< opened and released without a change; other causes still set the safe value

  friend constexpr auto parameters(type_tag<OutputConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("name", &OutputConfig::name, "the origin of its events, unique in the file", rtdata::required,
                  TextIs::name),
        parameter("topic", &OutputConfig::topic, "topic of its changes; empty: its name", TextIs::topic),
        parameter("safe", &OutputConfig::safe, "safe value; for a GPIO line 1 is on and 0 is off"),
        parameter("on", &OutputConfig::on,
                  "topic that the output follows; empty: the program or a command sets the output",
                  names_part("topic")),
        parameter("with", &OutputConfig::with, "other topics; their latest values are used", names_part("topic")),
        parameter("expression", &OutputConfig::expression,
                  "value of the output, or value to control; a condition gives 1 or 0; empty: the only number of the "
                  "topic `on`",
                  TextIs::recorded),
        parameter("hysteresis", &OutputConfig::hysteresis,
                  "switches on and off at two thresholds of the expression's value"),
        parameter("pid", &OutputConfig::pid, "a controller that brings the expression's value to its set point"),
        parameter("max_age", &OutputConfig::max_age,
                  "the output is safe while its input has had no event for longer than this",
                  range(Duration{1ms}, Duration{24h * 365})),
        parameter("lease", &OutputConfig::lease,
                  "how long a value holds if no program or command sets it again; then the output becomes safe; 0: "
                  "without limit",
                  range(Duration{0}, Duration{24h * 365})),
        parameter("watchdog", &OutputConfig::watchdog,
                  "the output becomes safe when the program hangs for longer than this",
                  range(Duration{20ms}, Duration{1h})),
        parameter("armed", &OutputConfig::armed,
                  "whether the output can be set from the start, or only after a command has armed it",
                  choices(value("at start", Arming::at_start), value("by command", Arming::by_command))),
        parameter("required", &OutputConfig::required,
                  "true: the program ends if the device is absent or does not answer at the start"),
        parameter("keep", &OutputConfig::keep,
                  "true: at start and stop the device keeps its value, such as a relay while the program is replaced"));
  }
  friend void check_config(const OutputConfig& config, const ConfigItem& item, Problems& problems);
};
/// Checks rules over several parameters.
void check_config(const OutputConfig& config, const ConfigItem& item, Problems& problems);
/// Checks that the topics have the fields of its expression (sensors/derived.hpp).
void check_output_names(const OutputConfig& config,
                        const std::function<const Description*(std::string_view topic)>& payload_of,
                        const ConfigItem& item, Problems& problems);
/// Checks that the device takes the values in the configuration: the safe value, those of a controller, and the
/// constants that the expression may give.
void check_output_values(const OutputConfig& config, const OutputRange& range, const ConfigItem& item,
                         Problems& problems);

class Output : public AnySensor {
 public:
  enum class Takes : std::uint8_t { at_once, later, patiently };
  Output() noexcept = default;
  /// Opens the device and waits for it. `guarded`: the text from which the runtime's guard makes the Actuator
  /// (guard.hpp); if it is empty, or without a guard, this program makes it with `make` and holds the device itself.
  /// `make` also gives the range of values (`Actuator::range`); if `make` is empty, the device itself must refuse other
  /// values. Throws SetupError: a name or topic is taken; bad-argument, the configuration cannot work; out-of-range,
  /// the device does not take the safe value; ExpressionError; the device's error. If the device has disappeared
  /// (disconnected), the output starts as failed: it tries again each second and sets the safe value as soon as
  /// possible. Before the loop runs, the same holds for a missing or silent device (not-found, timed-out), unless the
  /// output is `required`. `later`: does not wait for the device, see `when_taken`; values set meanwhile follow the
  /// safe value. `patiently`: the same, and after any error of the device the output starts as failed.
  Output(Loop& loop, OutputConfig config, MakeActuator make, std::string guarded = {}, Takes takes = Takes::at_once);
  /// Calls `done` on its loop, in a later turn, when the device has its safe value or is disconnected (not an error
  /// here), within 5 s. On an error the output has no device; close it. Not called if it is closed before.
  void when_taken(Callback<void(Result<void>)> done);

  /// `by`: who asks, for the event. Errors: bad-argument (not finite; it follows a topic), out-of-range (the device
  /// takes no such value), not-permitted (it is disarmed), io-failed (the device does not even take its safe value),
  /// busy (after `finish`), closed. On an error the value does not change. The result of the device comes later, as an
  /// event.
  Result<void> set(double value, std::string_view by = "program");
  /// Arms the output, from the next value on. Does nothing if it is armed. Errors: busy (after `finish`); closed;
  /// disconnected (the guard has ended: the output stays safe until the program is started again).
  Result<void> arm(std::string_view by);
  /// Disarms the output and sets its safe value. Does nothing if it is disarmed. Errors: closed.
  Result<void> disarm(std::string_view by);

  /// Changes the settings of its controller, from the next event on, without a jump of the output (controllers.hpp).
  /// Errors: bad-argument (it has no controller; invalid settings), closed.
  Result<void> change_pid(const PidConfig& pid);
  /// The same for the set point only.
  Result<void> change_setpoint(double setpoint);
  /// True if the set point was changed this way and the settings were not replaced since. Does not wait for a loop.
  bool is_setpoint_commanded() const noexcept;

  /// Sets the safe value and releases the device, as closing does, but does not wait: calls `done` on its loop, in a
  /// later turn, within 5 s unless a value was being set. After the call it takes no value. Close it after `done`,
  /// which then does not wait; closing it earlier waits for the rest, and `done` is not called. For changes of a
  /// configuration.
  void finish(Callback<void()> done);
  /// The remaining lease of the last `set`. Without a `lease`: Duration::max().
  Duration lease_left() const noexcept;

  /// As it is configured; 0 when it is closed.
  double safe_value() const noexcept;
  bool is_armed() const noexcept;
  /// Calls `done` on its loop, in a later turn, when the last event of its topic shows the present armed state: after
  /// arming at once, after disarming when the device has answered. Not called if it is closed before.
  void when_published(Callback<void()> done);
  /// True if the device is known to have its safe value.
  bool is_safe() const noexcept;
  /// True if it was stopped and it is unknown whether the device has the safe value.
  bool has_ended_unsafe() const noexcept;
  /// The value of the device; empty: unknown.
  std::optional<double> value() const noexcept;
  /// True if a guard holds the device.
  bool is_guarded() const noexcept;

 private:
  explicit Output(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
