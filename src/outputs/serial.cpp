#include "rtdata/outputs/serial.hpp"

#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <map>
#include <mutex>
#include <string_view>

#include "data/hex_bytes.hpp"
#include "data/setting_mistake.hpp"
#include "io/stream_line.hpp"
#include "io/tty.hpp"
#include "outputs/set_text.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_set_serial = "cannot set the device";
constexpr const char* not_bytes = "these are not bytes: write two hexadecimal digits for each, such as \"a0 01 00 a1\"";
constexpr Duration greeting = std::chrono::milliseconds{100}, stillness = std::chrono::milliseconds{20};
using Deadline = std::chrono::steady_clock::time_point;

/// False: the time is over.
bool wait_for(int fd, short events, Deadline until) {
  for (;;) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(until - std::chrono::steady_clock::now());
    pollfd one{fd, events, 0};
    const int ready = ::poll(&one, 1, left.count() > 0 ? static_cast<int>(left.count()) : 0);
    if (ready > 0) return true;
    if (ready == 0) return false;
    if (errno != EINTR) return false;
  }
}

/// Drops earlier input, which cannot be the answer. Reads it, because flushing does not remove a pseudo terminal's
/// pending data; bounded for a device that always sends.
void drop_input(int fd) noexcept {
  std::array<char, 512> bytes;
  for (int i = 0; i < 1024 && ::read(fd, bytes.data(), bytes.size()) > 0; ++i) {
  }
}

/// The unsent rest of a text for each device. It is sent before the next text, which would otherwise be appended to the
/// incomplete one. Global, because after a failure another actuator opens the device. Thread: any.
class Unsent {
 public:
  void keep(const std::string& device, std::string_view rest) {
    const std::scoped_lock lock(mutex_);
    rests_[device] = rest;
  }
  std::string take(const std::string& device) {
    const std::scoped_lock lock(mutex_);
    const auto found = rests_.find(device);
    return found != rests_.end() ? std::move(rests_.extract(found).mapped()) : std::string();
  }

 private:
  std::mutex mutex_;
  std::map<std::string, std::string> rests_;
};
Unsent& unsent() {
  static Unsent all;
  return all;
}

}  // namespace

void SerialActuatorConfig::check(const SerialActuatorConfig& config, const ConfigItem& item, Problems& problems) {
  check_config(config.serial, item, problems);
  detail::check_words(config.words, item, problems);
  detail::check_place({.device = config.device, .host = config.host, .port = config.port, .serial = config.serial},
                      "`device` and `host`", item, problems);
  const auto refuse = [&](const char* key, std::string why) {
    detail::add_mistake({key, std::move(why)}, item, problems);
  };
  if (!config.answer.empty() && !config.answer_hex.empty())
    refuse("answer_hex", "there is also an `answer`: remove one of them");
  if (const auto bytes = detail::bytes_of_hex(config.answer_hex); !bytes) refuse("answer_hex", not_bytes);
  for (const auto& [value, hex] : config.words_hex) {
    const auto bytes = detail::bytes_of_hex(hex);
    if (!bytes || bytes->empty()) refuse("words_hex", "\"" + hex + "\": " + not_bytes);
  }
  if (!config.words_hex.empty()) {
    detail::check_words(config.words_hex, item, problems, "words_hex");
    if (!config.words.empty() || item.find("text") != nullptr)
      refuse("words_hex", "there is also a `text` or `words`: remove those, or this");
    return;
  }
  if (!detail::has_value_mark(config.text))
    refuse("text", "every value would send the same text: write {value} into it");
}

SerialActuator::SerialActuator(SerialActuatorConfig config)
    : config_(std::move(config)),
      place_(config_.host.empty() ? config_.device : config_.host + " port " + std::to_string(config_.port)),
      answer_(config_.answer.empty() ? detail::bytes_of_hex(config_.answer_hex).value_or("") : config_.answer) {}

Result<std::string> SerialActuator::text_of(double value) const {
  if (config_.words_hex.empty()) return detail::set_text(config_.text, value, config_.words);
  const std::string number = detail::number_text(value);
  const auto word = config_.words_hex.find(number);
  if (word != config_.words_hex.end())
    if (auto bytes = detail::bytes_of_hex(word->second)) return *std::move(bytes);
  return Error{Errc::bad_argument, cannot_set_serial, place_, "`words_hex` has no bytes for " + number, "add them"};
}

SerialActuator::~SerialActuator() {
  if (fd_ < 0) return;
  if (config_.host.empty())
    detail::close_tty(fd_);
  else
    ::close(fd_);
}

Result<void> SerialActuator::open(std::optional<double> value) {
  const Deadline until = std::chrono::steady_clock::now() + config_.timeout;
  const Result<int> opened = config_.host.empty() ? detail::open_tty(config_.device, config_.serial)
                                                  : detail::connect_to(config_.host, config_.port, config_.timeout);
  if (!opened) return opened.error();
  fd_ = *opened;
  if (!config_.host.empty() && !answer_.empty() && wait_for(fd_, POLLIN, std::chrono::steady_clock::now() + greeting)) {
    do drop_input(fd_);  // the first data is not an answer
    while (wait_for(fd_, POLLIN, std::min(until, std::chrono::steady_clock::now() + stillness)));
  }
  return value ? set(*value) : Result<void>();
}

Result<void> SerialActuator::set(double value) {
  const Deadline until = std::chrono::steady_clock::now() + config_.timeout;
  const auto late = [&](std::string why) {
    return Error{Errc::timed_out, cannot_set_serial, place_, std::move(why), "check the device and its settings"};
  };
  const auto failed = [&] {
    if (errno == EIO || errno == ENXIO || errno == ENODEV || errno == EPIPE || errno == ECONNRESET) return gone();
    return system_error(errno, cannot_set_serial, place_);
  };
  const Result<std::string> wanted = text_of(value);
  if (!wanted) return wanted.error();
  drop_input(fd_);
  const bool is_socket = !config_.host.empty();
  const std::string before = is_socket ? std::string() : unsent().take(place_);
  const std::string text = before + *wanted;
  for (std::string_view rest = text; !rest.empty();) {
    const ssize_t wrote = is_socket ? ::send(fd_, rest.data(), rest.size(), MSG_NOSIGNAL)
                                    : ::write(fd_, rest.data(), rest.size());
    if (wrote > 0) rest.remove_prefix(static_cast<std::size_t>(wrote));
    if (wrote >= 0 || errno == EINTR) continue;
    if (errno != EAGAIN) return failed();
    if (wait_for(fd_, POLLOUT, until)) continue;
    // A text that was not begun need not be completed.
    const std::size_t sent = text.size() - rest.size();
    if (is_socket) {  // the rest would be part of the next text
      ::shutdown(fd_, SHUT_RDWR);
    } else if (sent != 0 || !before.empty()) {
      unsent().keep(place_, sent > before.size() ? rest : std::string_view(before).substr(sent));
    }
    return late("it does not accept data");
  }
  if (answer_.empty()) return {};
  std::string got;
  while (got.find(answer_) == std::string::npos) {
    if (!wait_for(fd_, POLLIN, until))
      return late("it did not answer `" + (config_.answer.empty() ? config_.answer_hex : config_.answer) + "`");
    std::array<char, 256> buffer;
    const ssize_t size = ::read(fd_, buffer.data(), buffer.size());
    if (size == 0) return gone();
    if (size < 0 && errno != EAGAIN && errno != EINTR) return failed();
    if (size > 0) got.append(buffer.data(), static_cast<std::size_t>(size));
    if (got.size() > 65536) got.erase(0, got.size() - 4096);
  }
  return {};
}

Result<void> SerialActuator::check() {
  pollfd one{fd_, POLLRDHUP, 0};  // a hang-up is always reported
  if (::poll(&one, 1, 0) <= 0) return {};
  return gone();
}

Error SerialActuator::gone() const {
  return {Errc::disconnected, cannot_set_serial, place_,
          config_.host.empty() ? "the device is gone" : "the device has closed the connection",
          config_.host.empty() ? "plug it in again" : "check the device and the network"};
}

}  // namespace rtdata
