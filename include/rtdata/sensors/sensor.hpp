/// Sensor: reads a device at a rate and publishes what it reads.
///
///     rtdata::Sensor<Climate> room(loop, {.name = "room", .rate = 10_Hz}, [] { return Climate{21.5, 40}; });
///
/// A new kind of sensor is a lambda, or a small class with `read()` and, where there is something to acquire and to
/// release, `open()` and `close()`; the rate, time, account, health, retries and gaps are inherited:
///
///     struct Barometer {
///       rtdata::Result<void> open();            // optional; called at start and again after faults
///       rtdata::Result<Pressure> read();        // or Pressure, or Reading<Pressure>
///       void close();                           // optional
///       rtdata::Duration read_time() const;     // optional: how long read() takes at most, see loop.hpp
///     };
///     rtdata::Sensor<Pressure> barometer(loop, {.name = "barometer", .rate = 50_Hz}, Barometer{});
///
/// All calls of a device may use any handle, its own sensor's too, and may throw, which is a failure.
///
/// Reading must not block: slow work (bus transfers, slow kernel files) belongs on a lane, as in `AnalogSensor`.
///
/// The life of a sensor:
///   1. Made, it starts at once, unless `start` is false; on a running loop too. `stop` and `start` any number of
///      times.
///   2. Each tick of its schedule ends as taken, missed or failed; each sample that a read brings as published,
///      repeated, filtered or unreadable (ledger.hpp).
///   3. A failure (an error, or an exception) makes it degraded; `faulted_after` failures in a row make it
///      faulted: the device is closed, and opened again after a delay that doubles from `retry_first` to
///      `retry_longest`, with jitter. The ticks between fail.
///   4. A device that is absent at the start is a fault like any other; with `required` it ends the set-up instead.
///   5. After `stop` or `close`: no event and no callback; queued deliveries are cancelled. The device is closed; on a
///      lane that comes after a read under way, which is discarded.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <chrono>
#include <concepts>
#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "rtdata/data/parameter.hpp"
#include "rtdata/loop/handle.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/process/processing.hpp"

namespace rtdata {

struct Tick;

/// The device had no new sample: counted as repeated, not published.
struct NothingNew {};
inline constexpr NothingNew nothing_new{};

/// The device's answer cannot be decoded: counted as unreadable, and the read has failed.
struct Unreadable {
  Error error;
  bool is_answer = false;  ///< the device says that it has no value: no other answer to this request may still come
};

/// The result of a read: a value, nothing new, an error, or an answer that cannot be decoded.
template <class T>
class Reading {
 public:
  Reading(T value) : content_(std::in_place_index<0>, std::move(value)) {}
  Reading(NothingNew) : content_(std::in_place_index<1>) {}
  Reading(Error error) : content_(std::in_place_index<2>, std::move(error)) {}
  Reading(Unreadable unreadable) : content_(std::in_place_index<3>, std::move(unreadable)) {}
  Reading(Result<T> result) : content_(std::in_place_index<1>) {
    if (result) {
      content_.template emplace<0>(*std::move(result));
    } else {
      content_.template emplace<2>(std::move(result).error());
    }
  }
  T* value() noexcept { return std::get_if<0>(&content_); }
  Error* error() noexcept { return std::get_if<2>(&content_); }
  Unreadable* unreadable() noexcept { return std::get_if<3>(&content_); }

 private:
  std::variant<T, NothingNew, Error, Unreadable> content_;
};

/// What to do if a read holds the loop longer than the loop's limit, besides the report.
enum class OnOverrun : std::uint8_t {
  warn,       ///< nothing more
  slow_down,  ///< halve its rate each time, down to a sixteenth
  stop,       ///< stop it; it is faulted until it is started again
};

struct SensorConfig {
  std::string name;        ///< unique in the runtime; the origin of its events
  std::string topic = {};  ///< empty: the name
  Rate rate = {};          ///< ticks a second, up to 1 MHz
  Duration phase{0};       ///< added to the start of its schedule; a negative one: within the first period
  std::optional<Duration> late_after = {};  ///< unset: the larger of 1 ms and 10 % of the period
  std::optional<Duration> read_time = {};   ///< longest time on the loop or lane; unset: as the device declares
  unsigned faulted_after = 3;               ///< failures in a row that make it faulted
  Duration retry_first = std::chrono::milliseconds{100};  ///< first delay before a faulted device is opened again
  Duration retry_longest = std::chrono::seconds{30};      ///< the delay doubles up to this
  OnOverrun on_overrun = OnOverrun::warn;                 ///< when its read holds the loop longer than its limit
  bool required = false;    ///< a device that cannot be opened at the start throws instead of being retried
  bool start = true;        ///< start when made
  Processing process = {};  ///< calibration and filters of its fields
  Duration warm_up{0};      ///< samples in this time after opening are discarded (filtered)
};

/// The configuration keys that all sensors have.
///
///     {"name": "chamber", "topic": "pressure/chamber", "rate": "100 Hz", "retry_first": "100 ms", ...}
///
/// Read them with `read_config(item, config, problems, UnknownKeys::ignore)`; the rest is the sensor's own Config.
constexpr auto parameters(type_tag<SensorConfig>) {
  using namespace std::chrono_literals;
  return parameter_list(
      parameter("name", &SensorConfig::name, "the origin of its events, unique in the file", required, TextIs::name),
      parameter("topic", &SensorConfig::topic, "topic of its events; empty: its name", TextIs::topic),
      parameter("rate", &SensorConfig::rate, "how often it is read", required, at_most(Rate::from_period(1us))),
      parameter("phase", &SensorConfig::phase, "time that is added to the start of its schedule",
                range(Duration{0}, Duration{1h})),
      parameter(
          "late_after", &SensorConfig::late_after,
          "readings that begin later than this are counted as late; default: the larger of 1 ms and 10 % of the period",
          at_least(Duration{0})),
      parameter("read_time", &SensorConfig::read_time,
                "longest time that a reading holds the loop or its lane; default: as the driver says",
                range(Duration{1}, Duration{1h})),
      parameter("faulted_after", &SensorConfig::faulted_after,
                "number of failures in a row after which the sensor is faulted", range(1, 1000000)),
      parameter("retry_first", &SensorConfig::retry_first, "first delay before a faulted device is opened again",
                range(Duration{1ms}, Duration{1h})),
      parameter("retry_longest", &SensorConfig::retry_longest, "the delay doubles up to this",
                range(Duration{1ms}, Duration{24h})),
      parameter("on_overrun", &SensorConfig::on_overrun, "what to do when a read holds the loop longer than the limit",
                choices(value("warn", OnOverrun::warn), value("slow down", OnOverrun::slow_down),
                        value("stop", OnOverrun::stop))),
      parameter("required", &SensorConfig::required,
                "true: the program ends if the device cannot be opened at the start"),
      parameter("start", &SensorConfig::start, "start it with the system"),
      parameter("process", &SensorConfig::process, "calibration and filters of each field"),
      parameter("warm_up", &SensorConfig::warm_up,
                "samples in this time after opening the device are discarded (counted as filtered)",
                range(Duration{0}, Duration{24h})));
}

namespace detail {

class SensorNode;

/// How a read ended. `value`: without an error; the port got no, one or many samples.
enum class Sampled { value, nothing_new, failed };

/// Takes the samples of one read. It does nothing if the sensor was stopped meanwhile.
class SamplePort {
 public:
  /// Publishes one sample with the time of the read; may move from the payload.
  void publish(void* payload) { publish(payload, time_); }
  /// Publishes with the device's own time.
  void publish(void* payload, Time time);
  /// Publishes with the monotonic time at which the device took it.
  void publish_at(void* payload, MonotonicTime time);
  /// The device reports that it has dropped `count` samples.
  void lost(std::uint64_t count);
  /// The device took `count` samples while it could not be read, which was already reported.
  void lost_in_fault(std::uint64_t count);
  /// The device gave a sample that it had given before.
  void repeated() noexcept;
  /// The return value of a failed read. The error is reported; if the read published a sample before, it still counts
  /// as taken.
  Sampled fail(Error error) {
    error_ = std::move(error);
    return Sampled::failed;
  }
  /// The device gave a sample that cannot be decoded. The read may publish others before and afterwards; without any,
  /// the read has failed, whatever it returns.
  Sampled unreadable(Error error);

 private:
  friend class SensorNode;
  SamplePort(SensorNode& sensor, MonotonicTime due, Time time, const Tick* tick)
      : sensor_(&sensor), due_(due), time_(time), tick_(tick) {}
  SensorNode* sensor_;
  MonotonicTime due_;
  Time time_;
  const Tick* tick_;        // of a read on the loop
  bool is_begun_ = false;   // already counted as begun; most reads on the loop are counted at their end
  Duration late_after_{0};  // limit for a late read, once begun
  Duration pushed_{0};      // added to the time of the read, so that timestamps strictly increase
  bool is_usable_ = false;  // a usable sample was published
  bool has_sample_ = false;
  std::optional<Error> error_;
};

/// The interface of a device for the sensor's base.
class SensorDevice {
 public:
  virtual ~SensorDevice() = default;
  virtual Result<void> open() { return {}; }
  virtual void close() {}
  /// How long one reading takes; may be called before `open`.
  virtual ReadTime read_time() const { return {}; }
  virtual Sampled sample(SamplePort& port) = 0;
};

template <class Device>
auto read_once(Device& device) {
  if constexpr (requires { device.read(); }) {
    return device.read();
  } else if constexpr (requires { device(); }) {
    return device();
  }
}

template <class T, class Got>
inline constexpr bool is_reading_of = std::is_constructible_v<Reading<T>, Got> || std::is_same_v<Got, std::optional<T>>;

template <class T, class Device>
class DeviceOf final : public SensorDevice {
 public:
  explicit DeviceOf(Device device) : device_(std::move(device)) {}

  Result<void> open() override {
    if constexpr (requires { device_.open(); }) {
      if constexpr (std::is_void_v<decltype(device_.open())>) {
        device_.open();
      } else {
        return device_.open();
      }
    }
    return {};
  }
  void close() override {
    if constexpr (requires { device_.close(); }) device_.close();
  }
  ReadTime read_time() const override {
    if constexpr (requires { Duration{device_.read_time()}; }) {
      return {.on_loop = device_.read_time()};
    } else {
      return {};
    }
  }
  Sampled sample(SamplePort& port) override {
    using Got = decltype(read_once(device_));
    if constexpr (std::is_same_v<Got, T>) {
      T value = read_once(device_);
      port.publish(&value);
      return Sampled::value;
    } else if constexpr (std::is_same_v<Got, std::optional<T>>) {
      std::optional<T> value = read_once(device_);
      if (!value) return Sampled::nothing_new;
      port.publish(&*value);
      return Sampled::value;
    } else if constexpr (is_reading_of<T, Got>) {
      Reading<T> reading(read_once(device_));
      if (T* value = reading.value()) {
        port.publish(value);
        return Sampled::value;
      }
      if (Error* error = reading.error()) return port.fail(std::move(*error));
      if (Unreadable* unreadable = reading.unreadable()) return port.unreadable(std::move(unreadable->error));
      return Sampled::nothing_new;
    } else {
      return Sampled::failed;  // does not compile: see Sensor
    }
  }

 private:
  Device device_;
};

Node* make_sensor(Loop& loop, SensorConfig config, PayloadType type, std::unique_ptr<SensorDevice> device);

}  // namespace detail

/// The interface of all sensors.
class AnySensor : public Handle {
 public:
  AnySensor() noexcept = default;

  /// Opens the device and begins a new segment of its schedule. Does nothing on a running or closed sensor. SetupError
  /// if the sensor is `required` and the device cannot be opened. Returns true if this call started it.
  bool start();
  /// Ends its activity: see "The life of a sensor". Returns true if this call stopped it.
  bool stop();
  bool is_running() const noexcept;
  /// Changes the rate, also while it runs: a new segment of the schedule begins now. Cancels a reduction by
  /// `on_overrun`. SetupError (bad-argument) if the rate is not possible.
  void set_rate(Rate rate);
  Rate rate() const noexcept;
  /// Changes the processing from the next sample on. The published fields, types and units must stay the same:
  /// otherwise SetupError (description-differs); ProcessingError.
  void set_processing(const Processing& processing);

  /// All 0 after it is closed.
  SensorCounts counts() const noexcept;
  Health health() const noexcept;
  SensorStatus status() const;
  CallbackTimes times() const noexcept;
  /// Sets the handler for errors of this sensor. Default: the loop's handler.
  void on_error(Callback<void(const ErrorReport&)> handler);

 protected:
  explicit AnySensor(detail::Node* node) noexcept : Handle(node) {}
};

template <class T>
class Sensor : public AnySensor {
 public:
  Sensor() noexcept = default;
  /// SetupError: the name is taken or not allowed, there is no rate, the topic has another payload, or a required
  /// device is missing.
  template <class Device>
  Sensor(Loop& loop, SensorConfig config, Device device)
      : AnySensor(detail::make_sensor(loop, std::move(config), detail::payload_type<T>(),
                                      std::make_unique<detail::DeviceOf<T, Device>>(std::move(device)))) {
    constexpr bool gives_readings = detail::is_reading_of<T, decltype(detail::read_once(std::declval<Device&>()))>;
    static_assert(gives_readings,
                  "rtdata: a sensor of T is made of a function without parameters, or an object with `read()`, that "
                  "returns T, Result<T>, Reading<T> or std::optional<T>");
  }
};

}  // namespace rtdata
