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
/// How the device is set is an `Actuator`: two functions, which are all that a kind of one's own has.
///
/// What an output is set to comes from one place: `set`, or the topics that its configuration names (`on`,
/// `expression`; names and ages as of derived values, sensors/derived.hpp). Setting what it has already is no change,
/// but extends the lease; it is counted as `repeated`.
///
/// It has its safe value
///   - from the start on: the device is taken with it in one step, or with `keep` as it is;
///   - from when `stop`, the end of its loop, closing, or the destructor of the handle begins (not with `keep`);
///   - while its input has brought nothing for `max_age`, or its expression fails or gives what the device does not
///     take: it follows the input again when that is back;
///   - when `lease` has passed since the last `set`, until the next one;
///   - after a `set` that failed: tried again each second until the device takes it;
///   - while it is disarmed: `set` is refused, and its input is not followed;
///   - when its loop does not turn for `watchdog`, or the program ends in whatever way, if a guard holds the device
///     (guard.hpp): then it is disarmed, and must be armed again. Without a guard nobody does that.
///
/// Each change is an event on its topic, an OutputChange: what was asked, what was done, why, by whom, and how long it
/// took; arming, disarming and what was refused are such events, too.
///
/// The device is set on a lane, or in the guard: what is slow holds no loop. While one value is on its way, only the
/// latest of those that come is kept; the others are told as superseded, those of a topic counted as `filtered`. At its
/// start and end, an output waits for the device.
///
/// This is not a safety system: see docs/outputs.md for what it cannot do.
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

/// The values that a device takes; any finite number unless it says less.
struct OutputRange {
  double least = -std::numeric_limits<double>::infinity();
  double most = std::numeric_limits<double>::infinity();
  bool is_whole = false;  ///< whole numbers alone: of a line {0, 1, true}
  /// Why it does not take this value, for people: "0.5 is not what the device takes: 0 or 1". Empty: it does.
  std::string refusal(double value) const;
};

/// A device that can be set. The constructor leaves the device alone, and the destructor gives it back as it is.
/// Thread: one at a time, any: a lane's, or one of the guard's. What it throws counts as a failure.
class Actuator {
 public:
  virtual ~Actuator() = default;
  /// What it takes, by its settings alone: asked of one that is not open, by `rtdata check` and by each Output, which
  /// refuse other values before they come to the device.
  virtual OutputRange range() const { return {}; }
  /// Takes the device with this value, in one step where the device can; without one as it is. Called once; after an
  /// error another Actuator is made.
  virtual Result<void> open(std::optional<double> value) = 0;
  /// Returns when the device has the value.
  virtual Result<void> set(double value) = 0;
};
/// An Actuator whose device may go away between two values, and come back without the last one.
///
/// A guard (guard.hpp) asks each second. After an error the output has failed: the guard makes another Actuator, which
/// is set to the safe value as soon as it takes that. Without a guard nobody asks.
class CheckedActuator : public Actuator {
 public:
  /// Whether the device that has taken the last value is still there. Does not wait.
  /// Errors: disconnected, or what the device says.
  virtual Result<void> check() = 0;
};

using MakeActuator = std::function<std::unique_ptr<Actuator>()>;
/// What the devices that it makes take. Of one that cannot be made: any finite number.
OutputRange range_of(const MakeActuator& make) noexcept;

enum class OutputCause : std::uint8_t { start, set, input, stale, lease, arm, disarm, watchdog, failure, stop };
constexpr auto describe(type_tag<OutputCause>) {
  return enumeration("output_cause", value("start", OutputCause::start), value("set", OutputCause::set),
                     value("input", OutputCause::input), value("stale", OutputCause::stale),
                     value("lease", OutputCause::lease), value("arm", OutputCause::arm),
                     value("disarm", OutputCause::disarm), value("watchdog", OutputCause::watchdog),
                     value("failure", OutputCause::failure), value("stop", OutputCause::stop));
}

/// What an output publishes with each change.
struct OutputChange {
  double asked = 0;
  std::optional<double> done = {};  ///< what the device has now; none: it was not set, `why` says why
  OutputCause cause = OutputCause::start;
  bool armed = false;  ///< after it
  double took = 0;     ///< from when it was asked until the device had it
  text<48> by = {};    ///< who asked: as `set`, `arm` and `disarm` were told, or the topic
  text<160> why = {};  ///< empty: it was done
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
  std::string name = {};                            ///< the origin of its events
  std::string topic = {};                           ///< empty: as its name
  double safe = 0;                                  ///< in the actuator's unit; of a line or a condition 1 is on, 0 off
  std::string on = {};                              ///< the topic that it follows; empty: it is set by `set`
  std::vector<std::string> with = {};               ///< other topics, of which the latest values count
  std::string expression = {};                      ///< its value; empty: the only number of the topic `on`
  std::optional<HysteresisConfig> hysteresis = {};  ///< on or off by the value of the expression
  std::optional<PidConfig> pid = {};                ///< controls the value of the expression
  Duration max_age = std::chrono::seconds{5};       ///< an input that brings nothing for longer is stale
  Duration lease{0};                                ///< `set` holds for so long; 0: until the next one
  Duration watchdog = std::chrono::milliseconds{500};  ///< the guard waits for the loop for so long
  Arming armed = Arming::at_start;
  bool required = false;  ///< a device that is absent or mute at the start throws
  bool keep = false;      ///< taken and given back as it is; all other causes of its safe value stay

  friend constexpr auto parameters(type_tag<OutputConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("name", &OutputConfig::name, "the origin of its events, unique in the file", rtdata::required,
                  TextIs::name),
        parameter("topic", &OutputConfig::topic, "where its changes are published; empty: as its name", TextIs::topic),
        parameter("safe", &OutputConfig::safe, "its safe value; of a line 1 is on, 0 off"),
        parameter("on", &OutputConfig::on, "the topic that it follows; empty: it is set by the program or a command",
                  names_part("topic")),
        parameter("with", &OutputConfig::with, "other topics, of which the latest values count", names_part("topic")),
        parameter("expression", &OutputConfig::expression,
                  "its value, or what is controlled; of a condition 1 or 0; empty: the only number of the topic `on`",
                  TextIs::recorded),
        parameter("hysteresis", &OutputConfig::hysteresis, "on or off by two thresholds of the expression's value"),
        parameter("pid", &OutputConfig::pid, "a controller that brings the expression's value to its set point"),
        parameter("max_age", &OutputConfig::max_age, "safe while its input has brought nothing for longer",
                  range(Duration{1ms}, Duration{24h * 365})),
        parameter("lease", &OutputConfig::lease, "safe when nobody has set it for longer; 0: a value holds",
                  range(Duration{0}, Duration{24h * 365})),
        parameter("watchdog", &OutputConfig::watchdog, "safe when the program hangs for longer",
                  range(Duration{20ms}, Duration{1h})),
        parameter("armed", &OutputConfig::armed, "whether it can be set from the start on",
                  choices(value("at start", Arming::at_start), value("by command", Arming::by_command))),
        parameter("required", &OutputConfig::required,
                  "a device that is absent or does not answer at the start ends the program"),
        parameter("keep", &OutputConfig::keep,
                  "at start and stop the device keeps what it has, such as a relay while the program is replaced"));
  }
  friend void check_config(const OutputConfig& config, const ConfigItem& item, Problems& problems);
};
/// What no parameter says by itself.
void check_config(const OutputConfig& config, const ConfigItem& item, Problems& problems);
/// Whether the topics have what its expression names (sensors/derived.hpp).
void check_output_names(const OutputConfig& config,
                        const std::function<const Description*(std::string_view topic)>& payload_of,
                        const ConfigItem& item, Problems& problems);
/// Whether the device takes the values that the configuration names: the safe one, those of a controller, and the
/// constants that the expression may give.
void check_output_values(const OutputConfig& config, const OutputRange& range, const ConfigItem& item,
                         Problems& problems);

class Output : public AnySensor {
 public:
  enum class Takes : std::uint8_t { at_once, later, patiently };
  Output() noexcept = default;
  /// Takes the device, and waits for that. `guarded`: what the runtime's guard makes its Actuator of (guard.hpp);
  /// empty, or without a guard: this program holds the device itself, as `make` makes it. What `make` makes also says
  /// which values it takes (`Actuator::range`); where `make` is empty, the device refuses the others itself.
  /// SetupError: a name or topic that is taken; bad-argument for a configuration that cannot work; out-of-range for a
  /// safe value that the device does not take; ExpressionError; what the device says. One that has gone (disconnected)
  /// makes the output begin as failed: it is tried again each second, and safe as soon as it takes that. Before the
  /// loop runs, so does one that is absent or mute (not-found, timed-out), and none that is `required`.
  /// `later`: does not wait for the device, which `when_taken` tells of; what it is set to meanwhile follows the safe
  /// value. `patiently`: the same, and whatever the device says, the output begins, as failed.
  Output(Loop& loop, OutputConfig config, MakeActuator make, std::string guarded = {}, Takes takes = Takes::at_once);
  /// Calls `done` on its loop, in a later turn, when the device has its safe value or is away (disconnected: that is no
  /// error here), within 5 s. An error: it has no device, and is to be closed.
  void when_taken(Callback<void(Result<void>)> done);

  /// `by`: who asks, for the event. Errors: bad-argument (not finite; it follows a topic), out-of-range (the device
  /// takes no such value), not-permitted (it is disarmed), io-failed (the device does not even take its safe value),
  /// busy (after `finish`), closed: it keeps what it has. What the device says comes later, as an event.
  Result<void> set(double value, std::string_view by = "program");
  /// From the next value on. When it is armed: nothing. Errors: busy (after `finish`); closed; disconnected (the guard
  /// has ended: it stays safe until the program is started again).
  Result<void> arm(std::string_view by);
  /// Sets its safe value. When it is disarmed: nothing. Errors: closed.
  Result<void> disarm(std::string_view by);

  /// Other settings of its controller, from the next event on, without a step in the output (controllers.hpp). Errors:
  /// bad-argument (it has no controller; one that cannot work), closed.
  Result<void> change_pid(const PidConfig& pid);
  /// The same of the set point alone.
  Result<void> change_setpoint(double setpoint);
  /// It was changed so, and all settings were not since. Waits for no loop.
  bool is_setpoint_commanded() const noexcept;

  /// Sets the safe value and gives the device back, as closing does, but does not wait for that: calls `done` on its
  /// loop, in a later turn, within 5 s unless a value was on its way. From the call on it takes no value. Then it is to
  /// be closed, which waits for nothing more; closing it before waits for the rest. For changes of a configuration.
  void finish(Callback<void()> done);
  /// How long the last value that was set still holds. Without a `lease`: for ever.
  Duration lease_left() const noexcept;

  /// As it is configured; 0 when it is closed.
  double safe_value() const noexcept;
  bool is_armed() const noexcept;
  /// Calls `done` on its loop, in a later turn, when the last event of its topic says whether it is armed: at once, or
  /// with the answer of the device, which arming does not wait for and disarming does. Never, when it is closed before.
  void when_told(Callback<void()> done);
  /// The device is known to have its safe value.
  bool is_safe() const noexcept;
  /// It was stopped, and nobody knows whether its device has the safe value.
  bool has_ended_unsafe() const noexcept;
  /// What the device has; none: it is not known.
  std::optional<double> value() const noexcept;
  /// A guard holds the device.
  bool is_guarded() const noexcept;

 private:
  explicit Output(detail::Node* node) noexcept : AnySensor(node) {}
};

}  // namespace rtdata
