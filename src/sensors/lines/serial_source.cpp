#include "sensors/lines/serial_source.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <filesystem>
#include <map>
#include <mutex>
#include <system_error>
#include <tuple>
#include <utility>

#include "io/tty.hpp"

namespace rtdata::detail {
namespace {

/// The open lines of all loops. Used only for opening and closing.
struct OpenLines {
  std::mutex mutex;
  std::map<std::pair<const LoopCore*, std::string>, std::weak_ptr<SerialSource>> all;
};
OpenLines& open_lines() {
  static OpenLines lines;
  return lines;
}

auto all_of(const SerialSettings& of) {
  return std::tie(of.baud_rate, of.character_size, of.parity, of.stop_bits, of.dtr, of.rts, of.hangup, of.rs485);
}

}  // namespace

Result<std::shared_ptr<SerialSource>> SerialSource::open(LoopCore& loop, const std::string& device,
                                                         const SerialSettings& settings) {
  std::error_code ignored;  // a missing device is identified by its path
  std::string canonical = std::filesystem::weakly_canonical(device, ignored).string();
  if (canonical.empty()) canonical = device;
  OpenLines& lines = open_lines();
  {
    const std::lock_guard lock(lines.mutex);
    const auto known = lines.all.find({&loop, canonical});
    if (known != lines.all.end()) {
      if (auto source = known->second.lock()) {
        if (all_of(source->settings_) == all_of(settings)) return source;
        return Error{Errc::busy, "cannot open the serial line", device,
                     "another sensor of this program uses it with different settings",
                     "set the same `baud_rate` and other settings for all sensors of this device"};
      }
    }
  }
  const Result<int> fd = open_tty(device, settings);
  if (!fd) return fd.error();
  std::shared_ptr<SerialSource> source(new SerialSource(loop, std::move(canonical), settings, *fd));
  const std::lock_guard lock(lines.mutex);
  lines.all[{&loop, source->device_}] = source;
  return source;
}

SerialSource::SerialSource(LoopCore& loop, std::string device, SerialSettings settings, int fd)
    : loop_(loop), device_(std::move(device)), settings_(settings), fd_(fd) {}

SerialSource::~SerialSource() {
  watch_.close();  // before the descriptor
  close_tty(fd_);
  OpenLines& lines = open_lines();
  const std::lock_guard lock(lines.mutex);
  const auto known = lines.all.find({&loop_, device_});
  if (known != lines.all.end() && known->second.expired()) lines.all.erase(known);
}

void SerialSource::add(User& user) {
  const bool is_watched = has_users();
  users_.push_back(&user);
  if (is_watched) return;
  watch_ = FdWatch(loop_.face, fd_, FdWatch::readable, device_, [this](const FdEvent& event) { on_ready(event); });
}

void SerialSource::remove(User& user) noexcept {
  const auto at = std::find(users_.begin(), users_.end(), &user);
  if (at == users_.end()) return;
  if (is_giving_) {
    *at = nullptr;
  } else {
    users_.erase(at);
  }
  if (!has_users()) watch_.close();
}

bool SerialSource::has_users() const noexcept {
  return std::any_of(users_.begin(), users_.end(), [](const User* one) { return one != nullptr; });
}

void SerialSource::on_ready(const FdEvent& event) {
  const std::shared_ptr<SerialSource> alive = shared_from_this();
  std::array<char, 1024> bytes;
  const ssize_t got = ::read(fd_, bytes.data(), bytes.size());
  const int error_number = got < 0 ? errno : 0;
  if (got > 0) return give({bytes.data(), static_cast<std::size_t>(got)}, 0);
  if (got == 0 || (error_number != EAGAIN && error_number != EINTR) || event.hung_up) give({}, error_number);
}

void SerialSource::give(std::string_view bytes, int error_number) {
  is_giving_ = true;
  const std::size_t count = users_.size();  // a user added meanwhile begins with the next bytes
  for (std::size_t i = 0; i < count; ++i)
    if (users_[i] != nullptr) users_[i]->take_bytes(bytes, error_number);
  is_giving_ = false;
  std::erase(users_, nullptr);
}

}  // namespace rtdata::detail
