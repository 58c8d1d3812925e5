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

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
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

template <class D>
class DriverDevice;

namespace detail {  // all in the header at the end
template <Driver D>
PayloadType driver_payload(const typename D::Config& config);
template <class D>
constexpr void check_driver_class();
template <class D>
constexpr auto place_type();
template <class D>
constexpr auto config_type();
}  // namespace detail

/// Of a class that is no driver: a compile error says what it lacks.
template <class D>
class DriverSensor : public AnySensor {
 public:
  template <class Bus, class Place = typename decltype(detail::place_type<D>())::type,
            class Config = typename decltype(detail::config_type<D>())::type>
  DriverSensor(Loop&, const SensorConfig&, Bus&, const Place& = {}, const Config& = {}) {
    detail::check_driver_class<D>();
  }
};

/// The sensor of a chip: driver `D` on a bus, at a rate.
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

#include "rtdata/detail/sensors/driver_device.hpp"
