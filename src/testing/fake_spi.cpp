#include "rtdata/testing/fake_spi.hpp"

#include <algorithm>

#include "rtdata/detail/loop/lane.hpp"

namespace rtdata {

void FakeSpi::on_transfer(unsigned chip_select, Chip chip) {
  const std::lock_guard lock(mutex_);
  selects_[chip_select].chip = std::move(chip);
}

void FakeSpi::fail(unsigned chip_select, std::uint64_t count, int errno_value) {
  const std::lock_guard lock(mutex_);
  selects_[chip_select].failures_left = count;
  selects_[chip_select].error = errno_value;
}

void FakeSpi::set_duration(unsigned chip_select, Duration duration) {
  const std::lock_guard lock(mutex_);
  selects_[chip_select].duration = duration;
}

std::uint64_t FakeSpi::transfers(unsigned chip_select) const {
  const std::lock_guard lock(mutex_);
  const auto found = selects_.find(chip_select);
  return found != selects_.end() ? found->second.transfers : 0;
}

int FakeSpi::transfer(const SpiPlace& place, std::span<const SpiSegment> segments) noexcept {
  Duration takes{0};
  int status = 0;
  {
    const std::lock_guard lock(mutex_);
    const auto found = selects_.find(place.chip_select);
    Select* const select = found != selects_.end() ? &found->second : nullptr;
    for (const SpiSegment& segment : segments) std::fill(segment.read.begin(), segment.read.end(), std::uint8_t{0xff});
    if (select != nullptr) {
      ++select->transfers;
      takes = select->duration;
      if (select->failures_left > 0) {
        --select->failures_left;
        status = select->error;
      } else if (select->chip) {
        for (const SpiSegment& segment : segments) select->chip(segment.write, segment.read);
      }
    }
  }
  detail::lane_sleep(takes);
  return status;
}

}  // namespace rtdata
