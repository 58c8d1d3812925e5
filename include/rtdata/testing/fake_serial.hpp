/// FakeSerial: a serial line made of a function, for tests of drivers without hardware.
///
///     auto wires = std::make_shared<rtdata::FakeSerial>();
///     wires->on_write([](std::string_view request) { return request == "MEAS?\n" ? "1.25\n" : ""; });
///     rtdata::SerialPort port("meter", wires);
///
/// The function is called with what each write sends, and returns what the device answers. On a manual loop an answer
/// comes after the virtual time set: an answer after the driver's timeout is found by its next read, unless that drops
/// it.
///
/// Thread: any; a lock protects it. The function is called under it, and must not call the fake.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/io/serial.hpp"

namespace rtdata {

class FakeSerial final : public SerialTransport {
 public:
  void on_write(std::function<std::string(std::string_view request)> answer);
  /// The device sends by itself.
  void send(std::string_view bytes);
  /// The time from each request to its answer, of the lane.
  void set_delay(Duration delay);
  /// The port is gone until it is plugged in again; data under way is lost.
  void unplug();
  void plug_in();
  /// What was sent to the device, one element for each write.
  std::vector<std::string> written() const;

  Result<void> open() override;
  Result<void> write(std::span<const std::uint8_t> bytes, Duration timeout) override;
  Result<std::size_t> read(std::span<std::uint8_t> bytes, Duration timeout) override;

 private:
  struct Sent {
    MonotonicTime arrives{};
    std::string bytes;
  };
  Result<void> check_plugged() const;

  mutable std::mutex mutex_;
  std::function<std::string(std::string_view)> answer_;
  std::deque<Sent> under_way_;
  std::vector<std::string> written_;
  Duration delay_{0};
  bool is_plugged_in_ = true;
};

}  // namespace rtdata
