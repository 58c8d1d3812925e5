#include "app/run/service.hpp"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdlib>
#include <cstring>

#include "data/number_text.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::app {
namespace {

constexpr Duration longest_limit = std::chrono::seconds{1};

/// A number from the environment; 0 if there is none.
std::int64_t number_of(const char* variable) {
  const char* text = std::getenv(variable);
  std::int64_t value = 0;
  return text != nullptr && detail::read_number(text, value) == std::errc{} && value > 0 ? value : 0;
}

/// How long a tier may be silent.
Duration limit_for(Duration watchdog) {
  return watchdog.count() > 0 ? std::clamp(watchdog / 2, Duration{std::chrono::milliseconds{1}}, longest_limit)
                              : longest_limit;
}

}  // namespace

ServiceManager::ServiceManager() {
  const char* address = std::getenv("NOTIFY_SOCKET");
  if (address == nullptr || (address[0] != '/' && address[0] != '@') || address[1] == '\0') return;
  address_ = address;
  if (address_.front() == '@') address_.front() = '\0';
  const std::int64_t owner = number_of("WATCHDOG_PID");
  if (owner == 0 || owner == ::getpid()) {
    constexpr std::int64_t most = std::int64_t{1} << 50;  // microseconds
    watchdog_ = std::chrono::microseconds{std::min(number_of("WATCHDOG_USEC"), most)};
  }
}

Result<void> ServiceManager::tell(std::string_view state) {
  if (address_.empty()) return {};
  const auto failed = [this](int number) {
    const std::string shown = (address_.front() == '\0' ? "@" : address_.substr(0, 1)) + address_.substr(1);
    return system_error(number, "cannot notify the service manager", shown,
                        "check `Type=notify` and `NotifyAccess` of the unit");
  };
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (address_.size() > sizeof address.sun_path) return failed(ENAMETOOLONG);
  std::memcpy(address.sun_path, address_.data(), address_.size());
  const auto length = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + address_.size() +
                                             (address_.front() == '/' ? 1 : 0));
  if (address_.size() == sizeof address.sun_path && address_.front() == '/') return failed(ENAMETOOLONG);
  if (fd_.fd() < 0) fd_.set(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  if (fd_.fd() < 0) return failed(errno);
  const ssize_t sent = ::sendto(fd_.fd(), state.data(), state.size(), MSG_NOSIGNAL | MSG_DONTWAIT,
                                reinterpret_cast<const sockaddr*>(&address), length);
  if (sent < 0) return failed(errno);
  return {};
}

Service::Service(Loop& loop) {
  if (loop.runtime().loops().size() > 1) tiers_.emplace(loop, limit_for(manager_.watchdog()));
  if (manager_.watchdog().count() == 0) return;
  const Duration period = std::max(manager_.watchdog() / 2, Duration{std::chrono::milliseconds{1}});
  ticker_ = Ticker(loop, Ticker::Config{.period = period, .name = "watchdog"}, [this](const Tick&) { feed(); });
}

void Service::feed() {
  if (all_turn()) {
    (void)manager_.tell("WATCHDOG=1");  // a failing socket was already reported with READY=1
  } else {
    ++withheld_;
  }
}

}  // namespace rtdata::app
