/// FakeI2c: an I2C bus made of memory, for tests of drivers without hardware.
///
///     auto wires = std::make_shared<rtdata::FakeI2c>();
///     wires->chip(0x48).set_word(0, 0x1900);
///     rtdata::I2cBus bus("i2c1", wires);
///     rtdata::DriverSensor<rtdata::Lm75> room(loop, {.name = "room", .rate = 10_Hz}, bus, {.address = 0x48});
///
/// A chip has 256 registers and a pointer that increments by itself, like most chips; special registers get functions.
/// An address without a chip does not acknowledge. On a manual loop a transfer takes as much virtual time as is set,
/// and one that takes longer than the bus's timeout hangs.
///
/// Thread: any; a lock protects it. The functions are called under it, and must not call the fake.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <vector>

#include "rtdata/io/i2c.hpp"

namespace rtdata {

class FakeI2c;

class FakeI2cChip {
 public:
  enum class Width { bytes, words };  ///< of its registers; words have the high byte first, and the pointer stays
  void set_width(Width width);
  void set(std::uint8_t first, std::initializer_list<std::uint8_t> bytes);
  std::uint8_t get(std::uint8_t number) const;
  void set_word(std::uint8_t number, std::uint16_t value);
  std::uint16_t word(std::uint8_t number) const;
  /// The function returns each byte read from this register, and the pointer stays: a FIFO.
  void on_read(std::uint8_t number, std::function<std::uint8_t()> next);
  /// Calls the function after a write to this register, with the byte or the whole word.
  void on_write(std::uint8_t number, std::function<void(std::uint16_t value)> written);

  /// The next transfers fail with this errno.
  void fail(std::uint64_t count, int errno_value);
  /// It does not acknowledge until it is plugged in again.
  void unplug();
  void plug_in();
  /// How long each transfer takes, in the time of the lane.
  void set_duration(Duration duration);
  std::uint64_t transfers() const;

 private:
  friend class FakeI2c;
  explicit FakeI2cChip(std::mutex& mutex) : mutex_(mutex) {}
  int transfer(std::span<const std::uint8_t> write, std::span<std::uint8_t> read);
  std::uint8_t next_byte();
  void take_byte(std::uint8_t byte);

  std::mutex& mutex_;
  Width width_ = Width::bytes;
  std::array<std::uint8_t, 512> memory_{};  // of words, two bytes each
  std::uint8_t pointer_ = 0;
  unsigned byte_of_word_ = 0;
  std::map<std::uint8_t, std::function<std::uint8_t()>> readers_;
  std::map<std::uint8_t, std::function<void(std::uint16_t)>> writers_;
  std::uint64_t failures_left_ = 0;
  int errno_ = 0;
  bool is_plugged_in_ = true;
  Duration duration_{0};
  std::uint64_t transfers_ = 0;
};

class FakeI2c final : public I2cTransport {
 public:
  /// Made when first asked for.
  FakeI2cChip& chip(unsigned address);
  /// One transfer: the address, when it began (lane clock), and how long it took.
  struct Transfer {
    unsigned address = 0;
    MonotonicTime began{};
    Duration took{0};
  };
  /// All of them, in order.
  std::vector<Transfer> log() const;

  int transfer(unsigned address, std::span<const std::uint8_t> write, std::span<std::uint8_t> read) noexcept override;

 private:
  mutable std::mutex mutex_;
  std::map<unsigned, std::unique_ptr<FakeI2cChip>> chips_;
  std::vector<Transfer> log_;
};

}  // namespace rtdata
