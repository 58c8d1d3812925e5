/// FakeSpi: an SPI bus made of functions, for tests of drivers without hardware.
///
///     auto wires = std::make_shared<rtdata::FakeSpi>();
///     wires->on_transfer(0, [](std::span<const std::uint8_t> write, std::span<std::uint8_t> read) { ... });
///     rtdata::SpiBus bus("spi0", wires);
///
/// A chip select without a function has no chip: it reads as ones. The function is called for each segment of a
/// transfer; either span may be empty. On a manual loop a transfer takes as much virtual time as is set, and one that
/// takes longer than the bus's timeout hangs.
///
/// Thread: any; a lock protects it. The functions are called under it, and must not call the fake.
#pragma once

#include <functional>
#include <map>
#include <mutex>

#include "rtdata/io/spi.hpp"

namespace rtdata {

class FakeSpi final : public SpiTransport {
 public:
  using Chip = std::function<void(std::span<const std::uint8_t> write, std::span<std::uint8_t> read)>;
  void on_transfer(unsigned chip_select, Chip chip);
  /// The next transfers with this chip fail with this errno.
  void fail(unsigned chip_select, std::uint64_t count, int errno_value);
  /// How long each transfer with this chip takes, in the time of the lane.
  void set_duration(unsigned chip_select, Duration duration);
  std::uint64_t transfers(unsigned chip_select) const;

  int transfer(const SpiPlace& place, std::span<const SpiSegment> segments) noexcept override;

 private:
  struct Select {
    Chip chip;
    std::uint64_t failures_left = 0;
    int error = 0;
    Duration duration{0};
    std::uint64_t transfers = 0;
  };
  mutable std::mutex mutex_;
  std::map<unsigned, Select> selects_;
};

}  // namespace rtdata
