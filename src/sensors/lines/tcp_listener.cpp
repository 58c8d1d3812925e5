#include "sensors/lines/tcp_listener.hpp"

#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <mutex>
#include <utility>

namespace rtdata::detail {
namespace {

/// The ports of all loops. Used only for opening and closing.
struct OpenPorts {
  std::mutex mutex;
  std::vector<std::pair<const LoopCore*, std::weak_ptr<TcpListener>>> all;
};
OpenPorts& open_ports() {
  static OpenPorts ports;
  return ports;
}

Result<int> listen_at(const IpAddress& address, const std::string& place) {
  const int fd = ::socket(address.storage.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  const int on = 1;
  if (fd >= 0 && ::setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) == 0 &&
      ::bind(fd, address.get(), address.size) == 0 && ::listen(fd, 4) == 0)
    return fd;
  const int number = errno;
  if (fd >= 0) ::close(fd);
  return system_error(number, "cannot listen on this port", place,
                      number == EADDRINUSE ? "choose another port, or end the program that uses this one (`ss -tlp` "
                                             "shows it); it may also be another sensor"
                                           : "check `listen` and `port`");
}

bool is_same_port(const IpAddress& a, const IpAddress& b) noexcept {
  return a.is_same_host(b) && (a.is_v6() ? a.v6().sin6_port == b.v6().sin6_port : a.v4().sin_port == b.v4().sin_port);
}

}  // namespace

Result<std::shared_ptr<TcpListener>> TcpListener::open(LoopCore& loop, const IpAddress& address,
                                                       const std::string& place) {
  OpenPorts& ports = open_ports();
  const std::lock_guard lock(ports.mutex);
  for (const auto& [of_loop, port] : ports.all)
    if (const auto known = port.lock(); known && of_loop == &loop && is_same_port(known->address_, address))
      return known;
  const Result<int> fd = listen_at(address, place);
  if (!fd) return fd.error();
  std::shared_ptr<TcpListener> made(new TcpListener(loop, address, place, *fd));
  made->watch();
  ports.all.emplace_back(&loop, made);
  return made;
}

TcpListener::TcpListener(LoopCore& loop, const IpAddress& address, std::string place, int fd)
    : loop_(loop), address_(address), place_(std::move(place)), fd_(fd), later_(loop.face, [this] { watch(); }) {}

TcpListener::~TcpListener() {
  connections_.close();  // before the descriptor
  ::close(fd_);
  OpenPorts& ports = open_ports();
  const std::lock_guard lock(ports.mutex);
  std::erase_if(ports.all, [](const auto& port) { return port.second.expired(); });
}

Result<void> TcpListener::add(User& user, const std::optional<IpAddress>& from) {
  const bool is_taken = std::any_of(devices_.begin(), devices_.end(), [&](const Device& other) {
    return from && other.from ? from->is_same_host(*other.from) : !from && !other.from;
  });
  if (is_taken)
    return Error{Errc::busy, "cannot listen on this port", place_,
                 "another sensor listens for the same devices on this port",
                 "set `from` of each sensor, or use a separate port for each"};
  devices_.push_back({&user, from});
  return {};
}

void TcpListener::remove(const User& user) noexcept {
  std::erase_if(devices_, [&](const Device& one) { return one.user == &user; });
}

void TcpListener::watch() {
  connections_ = FdWatch(loop_.face, fd_, FdWatch::readable, place_, [this](const FdEvent&) { take(); });
}

void TcpListener::take() {
  const std::shared_ptr<TcpListener> alive = shared_from_this();  // a callback may close the last user
  IpAddress peer;
  peer.size = sizeof peer.storage;
  const int fd = ::accept4(fd_, reinterpret_cast<sockaddr*>(&peer.storage), &peer.size, SOCK_NONBLOCK | SOCK_CLOEXEC);
  const int number = errno;
  if (fd < 0 && (number == EAGAIN || number == EINTR || number == ECONNABORTED)) return;
  if (devices_.empty()) {
    if (fd >= 0) ::close(fd);
    return;
  }
  if (fd < 0) {
    connections_.close();  // no descriptors, no memory
    later_.start(std::chrono::seconds{1});
    return devices_.front().user->connection_refused(system_error(number, "cannot take a connection", place_, ""));
  }
  auto device = std::find_if(devices_.begin(), devices_.end(),
                             [&](const Device& one) { return one.from && one.from->is_same_host(peer); });
  if (device == devices_.end())
    device = std::find_if(devices_.begin(), devices_.end(), [](const Device& one) { return !one.from; });
  if (device != devices_.end()) return device->user->take_connection(fd);
  ::close(fd);
  devices_.front().user->connection_refused(
      {Errc::not_permitted, "closed a connection", place_, "it did not come from the address `from`", ""});
}

}  // namespace rtdata::detail
