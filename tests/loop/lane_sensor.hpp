/// A sensor whose device is read on a lane. On a manual loop a read takes the loop's scripted lane time.
#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <thread>
#include <utility>

#include "rtdata/detail/sensors/transaction.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace lane_sensor {

using namespace rtdata;

/// How its reads go.
struct Reads {
  Duration take{0};    // on a loop in real time
  int fail_every = 0;  // 1: all; 0: none
};

template <class Payload>
class LaneDevice final : public detail::LaneDevice {
 public:
  LaneDevice(std::string lane, Reads reads) : lane_(std::move(lane)), reads_(reads) {}

 private:
  struct Read final : detail::Transaction {
    explicit Read(Duration take_) : take(take_) {}
    void transact() noexcept override { std::this_thread::sleep_for(take); }
    const Duration take;
  };
  std::shared_ptr<detail::Transaction> make_transaction() override { return std::make_shared<Read>(reads_.take); }
  detail::Sampled decode(detail::Transaction&, detail::SamplePort& port) override {
    if (reads_.fail_every != 0 && ++decoded_ % reads_.fail_every == 0)
      return port.fail({Errc::io_failed, "no answer", "", "", ""});
    Payload payload{};
    port.publish(&payload);
    return detail::Sampled::value;
  }
  std::string lane_key() const override { return lane_; }
  Duration give_up_after() const override { return std::chrono::seconds{10}; }
  Error given_up_error() const override { return {Errc::timed_out, "no answer", "", "", ""}; }

  const std::string lane_;
  const Reads reads_;
  int decoded_ = 0;
};

template <class Payload>
class LaneSensor : public AnySensor {
 public:
  LaneSensor() = default;
  LaneSensor(Loop& loop, const SensorConfig& config, Reads reads = {})
      : AnySensor(detail::make_sensor(loop, config, detail::payload_type<Payload>(),
                                      std::make_unique<LaneDevice<Payload>>(config.name, reads))) {}
};

}  // namespace lane_sensor
