/// DriverSensor: a sensor made of a driver, which is plain blocking code for one chip on a bus.
///
///     class Lm75 {
///      public:
///       static constexpr std::string_view type = "lm75";        // as in configurations
///       static constexpr std::string_view description = "temperature of an LM75 or the like on I2C";
///       struct Config { ... };                      // its parameters
///       using Value = TemperatureReading;           // what it publishes
///       using Device = rtdata::I2cDevice;           // how it talks to the chip
///       static constexpr rtdata::I2cDevice::Place place{0x48};  // where it is unless the user says otherwise
///       explicit Lm75(const Config& config);
///       rtdata::Result<void> open(rtdata::I2cDevice& chip);     // optional: identity, calibration; see below
///       rtdata::Result<void> start(rtdata::I2cDevice& chip);    // optional: begins a conversion ...
///       rtdata::Duration conversion_time() const;               // ... which takes this long; the bus is free
///       rtdata::Reading<TemperatureReading> read(rtdata::I2cDevice& chip);  // or the value itself, or a Result of it
///       void close(rtdata::I2cDevice& chip);                    // optional
///     };
///     rtdata::DriverSensor<Lm75> room(loop, {.name = "room", .rate = 10_Hz}, bus, {.address = 0x49});
///
/// A chip with several samples at a time has `Result<void> read(Device&, Samples<Value>&)` instead. A chip that needs
/// several conversions for a sample, such as a converter with several channels, has `bool goes_on() const`: it is
/// called after each read without an error; while it returns true, `start`, the pause and `read` are repeated, and the
/// bus is free in between.
///
/// If the payload depends on the Config, for example on the selected channels, the driver describes it: `static
/// Result<std::shared_ptr<const Description>> describe(const Config&)`. Value is then trivially copyable and begins
/// with the fields of the description (DescriptionBuilder uses the layout of compilers), or is a `DescribedValue` if
/// its size is not known beforehand.
///
/// For rules such as a list of valid values, or two parameters that must fit together, a driver has `static
/// Result<void> check(const Config&)`: the error's `where` is the key of the parameter ("channels[1].range"). A
/// configuration is refused with the error at that place; a program gets a SetupError.
///
/// A driver that waits for its chip while it holds the bus, such as for a reset or a self-test, declares the time:
/// `static Duration bus_time(const Config&)`, the longest of its calls without the transfers. A bus with a shorter
/// limit is refused, in a configuration at its place, otherwise by a SetupError.
///
/// The driver of a chip with registers that supports both I2C and SPI has `using Device = rtdata::RegisterDevice` and
/// `static RegisterAddressing addressing(const Config&)` (registers.hpp).
///
/// A driver without open() is opened with one reading that is discarded, so that a missing chip is detected at the
/// start and `required` works. A driver with several samples at a time needs an open() for that.
///
/// `registry.add_driver<Lm75>()` makes a driver available in configurations. A driver describes its chips (chip.hpp)
/// with `static constexpr KnownChip chips[]`, by which `rtdata scan` finds them, and `static constexpr ChipSample
/// samples[]`, by which tests try it. The driver of a chip with an identity checks it with `check_identity`, and
/// accepts clones that the user has set (identity.hpp).
///
/// State that a driver must keep between openings, such as a tare, is its `Memory`: it is copied with `Memory memory()
/// const` after each completed read, and into a new driver object with `void remember(const Memory&)`. For a chip that
/// measures by itself, with a FIFO, the driver has `static std::uint64_t unread(const Memory&, MonotonicTime now)`: the
/// number of samples that the chip took since the last one read. It is called when the sensor stops while the chip
/// cannot be read; that Memory is then discarded. A new driver object with a Memory reports earlier losses with
/// `Samples::lost_in_fault`.
///
/// A driver object is made from its Config for each opening; all its calls except the constructor run on the bus's
/// lane, one at a time. A call beyond the bus's limit is given up: thread, driver and device are abandoned (the device
/// does nothing more), and a new driver object continues.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: DriverSensor: the loop's; the bus must outlive it.
#pragma once

#include <algorithm>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "rtdata/detail/sensors/transaction.hpp"
#include "rtdata/io/bus.hpp"
#include "rtdata/io/chip.hpp"
#include "rtdata/io/identity.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace rtdata {

/// The bytes of a payload that has a description and no C++ type. All are 0 at first: optional values are absent.
class DescribedValue {
 public:
  explicit DescribedValue(const Description& description) : bytes_(description.size()) {}
  explicit DescribedValue(std::span<const std::byte> payload) : bytes_(payload.begin(), payload.end()) {}
  /// Laid out as the description says (`Leaf::offset`).
  std::byte* data() noexcept { return bytes_.data(); }
  std::size_t size() const noexcept { return bytes_.size(); }

 private:
  std::vector<std::byte> bytes_;
};

/// The samples of one read, in order. Used by the driver, on the lane.
template <class T>
class Samples {
 public:
  /// Adds a sample with the time at which the read began.
  void add(T value) { samples_.push_back({std::move(value), std::nullopt}); }
  /// Adds a sample with its own time. A time in the future becomes the end of the read; a time not after the previous
  /// sample becomes 1 ns more than that.
  void add(T value, MonotonicTime time) { samples_.push_back({std::move(value), time}); }
  /// The chip has dropped `count` samples before it was read (its FIFO was full).
  void lost(std::uint64_t count) { lost_ += count; }
  /// The chip took `count` samples while it could not be read, which was already reported: counts them as lost without
  /// an error.
  void lost_in_fault(std::uint64_t count) { lost_in_fault_ += count; }
  /// The chip gave data that cannot be decoded.
  void unreadable(Error error) { note({std::move(error)}); }
  /// The time on the lane: for the times of samples.
  static MonotonicTime now() noexcept { return detail::lane_now(); }

 private:
  template <class Driver>
  friend class DriverDevice;
  struct Sample {
    T value;
    std::optional<MonotonicTime> time;
  };
  void note(Unreadable unreadable) {
    unreadable_.push_back(std::move(unreadable.error));
    is_doubtful_ = is_doubtful_ || !unreadable.is_answer;
  }
  void clear() {
    samples_.clear();
    unreadable_.clear();
    is_doubtful_ = false;
    lost_ = lost_in_fault_ = 0;
  }
  std::vector<Sample> samples_;
  std::vector<Error> unreadable_;
  bool is_doubtful_ = false;  // one of these may not be the answer
  std::uint64_t lost_ = 0, lost_in_fault_ = 0;
};

/// The error of a driver's decoder, with the place of its chip.
template <class Device>
Error at_place(const Device& chip, Error error) {
  error.where = chip.error(Errc::bad_data, {}, {}).where;
  return error;
}

template <class D>
concept Driver = requires(D driver, typename D::Device& device) {
  requires std::is_base_of_v<BusDevice, typename D::Device>;
  requires std::constructible_from<D, const typename D::Config&>;
  typename D::Value;
  typename D::Device::Place;
  typename D::Device::Bus;
  requires requires { driver.read(device); } || requires(Samples<typename D::Value> & out) {
    driver.read(device, out);
  };
};

/// The default place of a driver's chip.
template <Driver D>
constexpr typename D::Device::Place default_place() {
  if constexpr (requires { D::place; }) {
    return D::place;
  } else {
    return {};
  }
}

/// The description of a driver's events. Errors: bad-description (the Config selects something invalid).
template <Driver D>
Result<std::shared_ptr<const Description>> driver_description(const typename D::Config& config) {
  if constexpr (requires { D::describe(config); }) {
    return D::describe(config);
  } else {
    return description_of<typename D::Value>();
  }
}

/// The chip of a driver that this Config is for: `chips` has one for each `model`, in their order.
template <class D>
constexpr const KnownChip& known_chip(const typename D::Config& config) {
  if constexpr (requires { config.model; })
    return D::chips[static_cast<std::size_t>(config.model)];
  else
    return D::chips[0];
}

/// Checks that sensors can be made with this Config. Errors: `where` is the key of the wrong parameter, if there is
/// one.
template <Driver D>
Result<void> check_driver(const typename D::Config& config) {
  if constexpr (HasIdentity<typename D::Config>) {
    if (auto good = check_identity_setting(known_chip<D>(config), config.identity); !good) return good;
  }
  if constexpr (requires { D::check(config); }) {
    if (Result<void> good = D::check(config); !good) return good;
  }
  const auto description = driver_description<D>(config);
  return description ? Result<void>() : Result<void>(description.error());
}

/// Checks that the chip of this Config can be at this place: not all chips have SPI. Errors: `where` is the key.
template <Driver D>
Result<void> check_place(const typename D::Config& config, const typename D::Device::Place& place) {
  if constexpr (requires { D::addressing(config).without_spi; }) {
    if (const std::string_view chip = D::addressing(config).without_spi; place.chip_select && !chip.empty())
      return Error{Errc::bad_argument, "cannot use this chip", "chip_select",
                   "the " + std::string(chip) + " does not support SPI", "put it on I2C, with its `address`"};
  }
  return {};
}

/// The longest time that a call of the driver holds the bus, without the transfers: the declared time, or the
/// conversion time if a reading is used for opening.
template <Driver D>
Duration bus_time_of(const typename D::Config& config) {
  if constexpr (requires { D::bus_time(config); }) {
    return D::bus_time(config);
  } else if constexpr (
      requires(D driver, typename D::Device & device) {
        driver.start(device);
        driver.conversion_time();
      } &&
      !requires(D driver, typename D::Device & device) { driver.open(device); }) {
    try {
      return D(config).conversion_time();
    } catch (const SetupError&) {  // told elsewhere
    }
  }
  return Duration{0};
}

namespace detail {

template <Driver D>
PayloadType driver_payload(const typename D::Config& config) {
  if constexpr (requires { D::describe(config); }) {
    auto description = D::describe(config).or_throw();
    if constexpr (!std::is_same_v<typename D::Value, DescribedValue>) {
      static_assert(std::is_trivially_copyable_v<typename D::Value>);
      if (description->size() > sizeof(typename D::Value)) {
        throw SetupError({Errc::bad_description, "cannot use a driver", std::string(description->name()),
                          "its description is larger than its Value", "let `describe` and `Value` agree"});
      }
    }
    return described_type(std::move(description));
  } else {
    return payload_type<typename D::Value>();
  }
}

template <class D>
struct MemoryOf {
  struct type {};
};
// clang-format off
template <class D>
  requires requires { typename D::Memory; }
struct MemoryOf<D> {
  using type = typename D::Memory;
};
// clang-format on

}  // namespace detail

/// Adapts a driver to the sensor's base. All calls are on the loop.
template <class D>
class DriverDevice final : public detail::LaneDevice {
  using Value = typename D::Value;
  using Device = typename D::Device;
  using BusOf = typename Device::Bus;

  /// A driver and its chip, from one opening. On the lane, until it is abandoned.
  struct Session {
    Session(const typename D::Config& config, Device device_) : driver(config), device(std::move(device_)) {}
    D driver;
    Device device;
    bool is_open = false;

    Result<void> open() {
      if constexpr (requires { device.look_at(); }) {
        if (auto usable = device.look_at(); !usable) return usable;
      }
      if constexpr (requires { driver.open(device); }) {
        if (auto opened = driver.open(device); !opened) return opened;
      } else if constexpr (requires { Reading<Value>(driver.read(device)); }) {
        if (auto answered = try_it(); !answered) return answered;
      }
      is_open = true;
      return {};
    }
    /// The answer was wrong: on a bus without numbered answers the right one may still come.
    void distrust() {
      if constexpr (requires { device.distrust(); }) device.distrust();
    }
    /// A reading that is discarded, to check that the chip answers correctly.
    Result<void> try_it() {
      for (bool goes_on = true; goes_on;) {
        if constexpr (requires { driver.start(device); }) {
          if (auto started = driver.start(device); !started) return started;
          device.wait(driver.conversion_time());
        }
        Reading<Value> reading(driver.read(device));
        if (Error* error = reading.error()) return std::move(*error);
        if (Unreadable* unreadable = reading.unreadable()) {
          if (unreadable->is_answer) return {};
          distrust();
          return std::move(unreadable->error);
        }
        goes_on = false;
        if constexpr (requires { driver.goes_on(); }) goes_on = driver.goes_on();
      }
      return {};
    }
    void close() noexcept {
      if (!std::exchange(is_open, false)) return;
      if constexpr (requires { driver.close(device); }) {
        try {
          driver.close(device);
        } catch (...) {  // there is no way left to report it
        }
      }
    }
  };

  template <class Function>
  static Result<void> guarded(const char* what, Function&& function) noexcept {
    try {
      try {
        return function();
      } catch (const std::exception& e) {
        return Error{Errc::handler_threw, what, "", std::string(detail::reason_of(e)), ""};
      } catch (...) {
        return Error{Errc::handler_threw, what, "", "an exception that is not a std::exception", ""};
      }
    } catch (...) {  // no memory for the error
      return Error{Errc::handler_threw, "", "", "", ""};
    }
  }

  class Opening final : public detail::Transaction {
   public:
    explicit Opening(std::shared_ptr<Session> session_) : session(std::move(session_)) {}
    void transact() noexcept override {
      result = guarded("open() of the driver threw", [this] { return session->open(); });
    }
    void given_up() noexcept override { session->device.abandon(); }
    std::shared_ptr<Session> session;
    Result<void> result;
  };

  class ReadJob final : public detail::Transaction {
   public:
    explicit ReadJob(std::shared_ptr<Session> session_) : session(std::move(session_)) {}
    void transact() noexcept override {
      if (!std::exchange(is_converting, false)) {
        samples.clear();
        has_news = true;
        if (!session->is_open) {  // the earlier one was abandoned
          result = guarded("open() of the driver threw", [this] { return session->open(); });
          if (!result) return;
        }
        if constexpr (has_start) return start();
      }
      result = guarded("read() of the driver threw", [this] { return read(); });
      if (samples.is_doubtful_ || (!result && result.error().code == Errc::bad_data)) session->distrust();
      if constexpr (has_start && requires(const D& driver) { driver.goes_on(); }) {
        if (result && session->driver.goes_on()) return start();
      }
      ended = detail::lane_now();
    }
    std::optional<Duration> goes_on_after() override {
      return is_converting ? std::optional<Duration>(pause) : std::nullopt;
    }
    void close() noexcept override { session->close(); }
    void given_up() noexcept override { session->device.abandon(); }

    static constexpr bool has_start = requires(D & driver, Device& device) { driver.start(device); };
    void start() noexcept {
      if constexpr (has_start) {
        result = guarded("start() of the driver threw", [this] { return session->driver.start(session->device); });
        is_converting = static_cast<bool>(result);
        if (is_converting) pause = session->driver.conversion_time();
      }
    }
    Result<void> read() {
      if constexpr (requires { session->driver.read(session->device, samples); }) {
        return session->driver.read(session->device, samples);
      } else {
        Reading<Value> reading(session->driver.read(session->device));
        if (Value* value = reading.value()) {
          samples.add(std::move(*value));
          has_news = true;
        } else if (Error* error = reading.error()) {
          return std::move(*error);
        } else if (Unreadable* unreadable = reading.unreadable()) {
          samples.note(std::move(*unreadable));
        } else {
          has_news = false;
        }
        return {};
      }
    }

    std::shared_ptr<Session> session;
    Samples<Value> samples;
    Result<void> result;
    bool is_converting = false;
    bool has_news = true;
    Duration pause{0};
    MonotonicTime ended{};
  };

 public:
  DriverDevice(BusOf& bus, typename Device::Place place, typename D::Config config)
      : bus_(bus), place_(std::move(place)), config_(std::move(config)), claim_(bus.claim(BusOf::text_of(place_))) {
    (void)make_session();  // throws for a wrong place or Config
    const Duration needed = bus_time_of<D>(config_);
    if (bus.give_up_after() > needed) return;
    throw SetupError({Errc::bad_argument, "cannot use this bus", "bus " + bus.name(),
                      "it gives up after " + to_string(bus.give_up_after()) + ", and this chip needs more than " +
                          to_string(needed) + " at a time",
                      "give the bus a longer `timeout`"});
  }

  std::shared_ptr<detail::Transaction> make_opening() override { return std::make_shared<Opening>(make_session()); }
  Result<void> take_opening(detail::Transaction& opening) override {
    auto& done = static_cast<Opening&>(opening);
    session_ = done.result ? done.session : nullptr;
    return done.result;
  }
  std::shared_ptr<detail::Transaction> make_transaction() override {
    auto session = std::exchange(session_, nullptr);
    return std::make_shared<ReadJob>(session != nullptr ? std::move(session) : make_session());
  }
  detail::Sampled decode(detail::Transaction& transaction, detail::SamplePort& port) override {
    auto& read = static_cast<ReadJob&>(transaction);
    if constexpr (has_memory) memory_ = read.session->driver.memory();
    Samples<Value>& samples = read.samples;
    port.lost_in_fault(samples.lost_in_fault_);
    if (samples.lost_ > 0) port.lost(samples.lost_);
    for (auto& sample : samples.samples_) {
      if (sample.time) {
        last_ = std::max(std::min(*sample.time, read.ended), last_ + Duration{1});
        port.publish_at(payload_of(sample.value), last_);
      } else {
        port.publish(payload_of(sample.value));
      }
    }
    for (Error& error : samples.unreadable_) port.unreadable(std::move(error));
    if (!read.result) return port.fail(read.result.error());
    if (!samples.unreadable_.empty()) return detail::Sampled::failed;
    return read.has_news && !samples.samples_.empty() ? detail::Sampled::value : detail::Sampled::nothing_new;
  }
  std::uint64_t stopped(MonotonicTime now) override {
    if constexpr (requires(const typename detail::MemoryOf<D>::type& memory) { D::unread(memory, now); }) {
      if (const auto memory = std::exchange(memory_, std::nullopt)) return D::unread(*memory, now);
    }
    return 0;
  }
  std::string lane_key() const override { return "bus " + bus_.name(); }
  std::shared_ptr<detail::LaneThread> lane_thread() const override { return bus_.lane_thread(); }
  Duration give_up_after() const override { return bus_.give_up_after(); }
  bool reads_on_loop() const override {
    if constexpr (requires { bus_.reads_on_loop(); }) {
      return bus_.reads_on_loop();
    } else {
      return false;
    }
  }
  std::string identity_by_word() const override {
    if constexpr (HasIdentity<typename D::Config>)
      return rtdata::identity_by_word(known_chip<D>(config_), config_.identity);
    return {};
  }
  Error given_up_error() const override {
    const std::string place = BusOf::text_of(place_);
    return {Errc::timed_out, "cannot read the chip", "bus " + bus_.name() + (place.empty() ? "" : ", " + place),
            "no answer within " + to_string(bus_.give_up_after()),
            "check the chip and its wires; `timeout` of the bus sets how long to wait"};
  }

 private:
  static void* payload_of(Value& value) {
    if constexpr (std::is_same_v<Value, DescribedValue>) {
      return value.data();
    } else {
      return &value;
    }
  }
  static constexpr bool has_memory = requires(D & driver) { driver.remember(driver.memory()); };
  std::shared_ptr<Session> make_session() const {
    auto session = std::make_shared<Session>(config_, bus_.device(place_));
    if constexpr (requires { D::addressing(config_); }) session->device.set_addressing(D::addressing(config_));
    if constexpr (has_memory) {
      if (memory_) session->driver.remember(*memory_);
    }
    return session;
  }

  BusOf& bus_;
  const typename Device::Place place_;
  const typename D::Config config_;
  const std::shared_ptr<void> claim_;
  std::shared_ptr<Session> session_;  // opened, for the first read
  MonotonicTime last_{};              // of the last sample that had its own time
  std::optional<typename detail::MemoryOf<D>::type> memory_;
};

namespace detail {

/// Says in one sentence what a class lacks to be a `Driver`.
template <class D>
constexpr void check_driver_class() {
  static_assert(
      requires { typename D::Config; },
      "rtdata: a driver has `struct Config`, its parameters, see rtdata/sensors/driver.hpp");
  static_assert(
      requires { typename D::Value; },
      "rtdata: a driver has `using Value`, what it publishes, see rtdata/sensors/driver.hpp");
  static_assert(
      requires { typename D::Device; },
      "rtdata: a driver has `using Device`, how it talks to its chip, such as rtdata::I2cDevice");
  if constexpr (requires {
                  typename D::Device;
                  typename D::Value;
                  typename D::Config;
                }) {
    constexpr bool on_bus = std::is_base_of_v<BusDevice, typename D::Device> && requires {
      typename D::Device::Place;
      typename D::Device::Bus;
    };
    static_assert(on_bus, "rtdata: the `Device` of a driver derives from rtdata::BusDevice and has `Place` and `Bus`");
    constexpr bool made = std::constructible_from<D, const typename D::Config&>;
    static_assert(made, "rtdata: a driver has a public constructor that takes its `const Config&`");
    constexpr bool reads = requires(D driver, typename D::Device & device) { driver.read(device); }
    || requires(D driver, typename D::Device & device, Samples<typename D::Value> & out) { driver.read(device, out); };
    static_assert(reads, "rtdata: a driver has a public `read(Device&)` or `read(Device&, Samples<Value>&)`");
  }
}

template <class D>
struct PlaceOf {
  using type = std::monostate;
};
// clang-format off
template <class D>
  requires requires { typename D::Device::Place; }
struct PlaceOf<D> {
  using type = typename D::Device::Place;
};
template <class D>
struct ConfigOf {
  using type = std::monostate;
};
template <class D>
  requires requires { typename D::Config; }
struct ConfigOf<D> {
  using type = typename D::Config;
};
// clang-format on

}  // namespace detail

/// Of a class that is no driver: a compile error says what it lacks.
template <class D>
class DriverSensor : public AnySensor {
 public:
  template <class Bus, class Place = typename detail::PlaceOf<D>::type,
            class Config = typename detail::ConfigOf<D>::type>
  DriverSensor(Loop&, const SensorConfig&, Bus&, const Place& = {}, const Config& = {}) {
    detail::check_driver_class<D>();
  }
};

template <Driver D>
class DriverSensor<D> : public AnySensor {
 public:
  DriverSensor() noexcept = default;
  /// SetupError: as `Sensor`; from the driver's constructor; an invalid or taken place on the bus.
  DriverSensor(Loop& loop, SensorConfig sensor, typename D::Device::Bus& bus,
               typename D::Device::Place place = default_place<D>(), typename D::Config config = {})
      : AnySensor(make(loop, std::move(sensor), bus, std::move(place), std::move(config))) {}

 private:
  static detail::Node* make(Loop& loop, SensorConfig sensor, typename D::Device::Bus& bus,
                            typename D::Device::Place place, typename D::Config config) {
    check_driver<D>(config).or_throw();
    check_place<D>(config, place).or_throw();
    detail::PayloadType type = detail::driver_payload<D>(config);
    return detail::make_sensor(loop, std::move(sensor), std::move(type),
                               std::make_unique<DriverDevice<D>>(bus, std::move(place), std::move(config)));
  }
};

}  // namespace rtdata
