#include "rtdata/testing/fake_i2c.hpp"

#include <cerrno>

#include "rtdata/detail/loop/lane.hpp"

namespace rtdata {

void FakeI2cChip::set_width(Width width) {
  const std::lock_guard lock(mutex_);
  width_ = width;
}

void FakeI2cChip::set(std::uint8_t first, std::initializer_list<std::uint8_t> bytes) {
  const std::lock_guard lock(mutex_);
  std::size_t at = first;
  for (const std::uint8_t byte : bytes) memory_[at++ % 256] = byte;
}

std::uint8_t FakeI2cChip::get(std::uint8_t number) const {
  const std::lock_guard lock(mutex_);
  return memory_[number];
}

void FakeI2cChip::set_word(std::uint8_t number, std::uint16_t value) {
  const std::lock_guard lock(mutex_);
  memory_[2u * number] = static_cast<std::uint8_t>(value >> 8);
  memory_[2u * number + 1] = static_cast<std::uint8_t>(value & 0xff);
}

std::uint16_t FakeI2cChip::word(std::uint8_t number) const {
  const std::lock_guard lock(mutex_);
  return static_cast<std::uint16_t>(memory_[2u * number] << 8 | memory_[2u * number + 1]);
}

void FakeI2cChip::on_read(std::uint8_t number, std::function<std::uint8_t()> next) {
  const std::lock_guard lock(mutex_);
  readers_[number] = std::move(next);
}

void FakeI2cChip::on_write(std::uint8_t number, std::function<void(std::uint16_t)> written) {
  const std::lock_guard lock(mutex_);
  writers_[number] = std::move(written);
}

void FakeI2cChip::fail(std::uint64_t count, int errno_value) {
  const std::lock_guard lock(mutex_);
  failures_left_ = count;
  errno_ = errno_value;
}

void FakeI2cChip::unplug() {
  const std::lock_guard lock(mutex_);
  is_plugged_in_ = false;
}

void FakeI2cChip::plug_in() {
  const std::lock_guard lock(mutex_);
  is_plugged_in_ = true;
}

void FakeI2cChip::set_duration(Duration duration) {
  const std::lock_guard lock(mutex_);
  duration_ = duration;
}

std::uint64_t FakeI2cChip::transfers() const {
  const std::lock_guard lock(mutex_);
  return transfers_;
}

std::uint8_t FakeI2cChip::next_byte() {
  if (const auto reader = readers_.find(pointer_); reader != readers_.end()) return reader->second();
  if (width_ == Width::bytes) return memory_[pointer_++];
  return memory_[2u * pointer_ + byte_of_word_++ % 2];
}

void FakeI2cChip::take_byte(std::uint8_t byte) {
  const std::uint8_t number = pointer_;
  std::uint16_t value = byte;
  if (width_ == Width::bytes) {
    memory_[pointer_++] = byte;
  } else {
    memory_[2u * number + byte_of_word_ % 2] = byte;
    if (byte_of_word_++ % 2 == 0) return;
    value = static_cast<std::uint16_t>(memory_[2u * number] << 8 | byte);
  }
  if (const auto writer = writers_.find(number); writer != writers_.end()) writer->second(value);
}

int FakeI2cChip::transfer(std::span<const std::uint8_t> write, std::span<std::uint8_t> read) {
  ++transfers_;
  if (!is_plugged_in_) return ENXIO;
  if (failures_left_ > 0) {
    --failures_left_;
    return errno_;
  }
  byte_of_word_ = 0;
  if (!write.empty()) pointer_ = write[0];
  for (std::size_t i = 1; i < write.size(); ++i) take_byte(write[i]);
  byte_of_word_ = 0;
  for (std::uint8_t& byte : read) byte = next_byte();
  return 0;
}

FakeI2cChip& FakeI2c::chip(unsigned address) {
  const std::lock_guard lock(mutex_);
  auto& chip = chips_[address];
  if (chip == nullptr) chip.reset(new FakeI2cChip(mutex_));
  return *chip;
}

std::vector<FakeI2c::Transfer> FakeI2c::log() const {
  const std::lock_guard lock(mutex_);
  return log_;
}

int FakeI2c::transfer(unsigned address, std::span<const std::uint8_t> write, std::span<std::uint8_t> read) noexcept {
  int status = ENXIO;
  Duration takes{0};
  {
    const std::lock_guard lock(mutex_);
    const auto chip = chips_.find(address);
    if (chip != chips_.end()) {
      takes = chip->second->duration_;
      status = chip->second->transfer(write, read);
    }
    log_.push_back({address, detail::lane_now(), takes});
  }
  detail::lane_sleep(takes);
  return status;
}

}  // namespace rtdata
