/// What a DriverSensor is made of: the device that reads a driver's chip on the lane of its bus, and what a class that
/// is no driver is told. Included by rtdata/sensors/driver.hpp, which has the rules.
#pragma once

#include <algorithm>
#include <concepts>
#include <cstdint>
#include <exception>
#include <memory>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>

#include "rtdata/detail/sensors/transaction.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

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

/// What a driver keeps of a chip that can no longer be read, as a `std::type_identity`.
template <class D>
constexpr auto memory_type() {
  if constexpr (requires { typename D::Memory; })
    return std::type_identity<typename D::Memory>{};
  else
    return std::type_identity<std::monostate>{};
}

}  // namespace detail

/// Adapts a driver to the sensor's base. All calls are on the loop.
template <class D>
class DriverDevice final : public detail::LaneDevice {
  using Value = typename D::Value;
  using Device = typename D::Device;
  using BusOf = typename Device::Bus;
  using Memory = typename decltype(detail::memory_type<D>())::type;

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
        session->device.begin_reading();
        if constexpr (has_start) return start();
      }
      result = guarded("read() of the driver threw", [this] { return read(); });
      if (const auto asked = session->device.asked()) begin_at(*asked);
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
    if constexpr (requires(const Memory& memory) { D::unread(memory, now); }) {
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
  std::optional<Memory> memory_;
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

/// For the parameters of a constructor that says what a class lacks: the types, or one in place of those that lack.
template <class D>
constexpr auto place_type() {
  if constexpr (requires { typename D::Device::Place; })
    return std::type_identity<typename D::Device::Place>{};
  else
    return std::type_identity<std::monostate>{};
}
template <class D>
constexpr auto config_type() {
  if constexpr (requires { typename D::Config; })
    return std::type_identity<typename D::Config>{};
  else
    return std::type_identity<std::monostate>{};
}

}  // namespace detail

}  // namespace rtdata
