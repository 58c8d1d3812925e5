#include "rtdata/testing/fake_serial.hpp"

#include <algorithm>

#include "rtdata/detail/loop/lane.hpp"

namespace rtdata {

void FakeSerial::on_write(std::function<std::string(std::string_view)> answer) {
  const std::lock_guard lock(mutex_);
  answer_ = std::move(answer);
}

void FakeSerial::send(std::string_view bytes) {
  const std::lock_guard lock(mutex_);
  under_way_.push_back({MonotonicTime{}, std::string(bytes)});
}

void FakeSerial::set_delay(Duration delay) {
  const std::lock_guard lock(mutex_);
  delay_ = delay;
}

void FakeSerial::unplug() {
  const std::lock_guard lock(mutex_);
  is_plugged_in_ = false;
  under_way_.clear();
}

void FakeSerial::plug_in() {
  const std::lock_guard lock(mutex_);
  is_plugged_in_ = true;
}

std::vector<std::string> FakeSerial::written() const {
  const std::lock_guard lock(mutex_);
  return written_;
}

Result<void> FakeSerial::check_plugged() const {
  if (is_plugged_in_) return {};
  return Error{Errc::disconnected, "lost the serial line", "fake", "the device has disappeared", ""};
}

Result<void> FakeSerial::open() {
  const std::lock_guard lock(mutex_);
  return check_plugged();
}

Result<void> FakeSerial::write(std::span<const std::uint8_t> bytes, Duration) {
  const std::lock_guard lock(mutex_);
  if (auto plugged = check_plugged(); !plugged) return plugged;
  written_.emplace_back(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  std::string answer = answer_ ? answer_(written_.back()) : std::string();
  if (!answer.empty()) under_way_.push_back({detail::lane_now() + delay_, std::move(answer)});
  return {};
}

Result<std::size_t> FakeSerial::read(std::span<std::uint8_t> bytes, Duration timeout) {
  Duration waits = timeout;
  {
    const std::lock_guard lock(mutex_);
    if (auto plugged = check_plugged(); !plugged) return std::move(plugged).error();
    if (!under_way_.empty()) waits = std::clamp(under_way_.front().arrives - detail::lane_now(), Duration{0}, timeout);
  }
  detail::lane_sleep(waits);
  const std::lock_guard lock(mutex_);
  if (auto plugged = check_plugged(); !plugged) return std::move(plugged).error();
  if (under_way_.empty() || under_way_.front().arrives > detail::lane_now()) return std::size_t{0};
  std::string& first = under_way_.front().bytes;
  const std::size_t count = std::min(first.size(), bytes.size());
  std::copy_n(first.begin(), count, bytes.begin());
  first.erase(0, count);
  if (first.empty()) under_way_.pop_front();
  return count;
}

}  // namespace rtdata
