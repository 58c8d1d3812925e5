#include "net/tcp_stream.hpp"

#include <linux/sockios.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

namespace rtdata::detail {

namespace {

void set_option(int fd, int level, int name, int value) noexcept {
  [[maybe_unused]] const int done = ::setsockopt(fd, level, name, &value, sizeof value);
}

}  // namespace

void keep_alive(int fd) noexcept {
  set_option(fd, SOL_SOCKET, SO_KEEPALIVE, 1);
  set_option(fd, IPPROTO_TCP, TCP_KEEPIDLE, 30);
  set_option(fd, IPPROTO_TCP, TCP_KEEPINTVL, 10);
  set_option(fd, IPPROTO_TCP, TCP_KEEPCNT, 3);
  set_option(fd, IPPROTO_TCP, TCP_USER_TIMEOUT, 60'000);  // nor confirms what was sent
}

TcpStream::TcpStream(LoopCore& loop, std::string owner, std::function<void(const Result<void>&)> opened,
                     std::function<void()> ready)
    : loop_(loop),
      owner_(std::move(owner)),
      opened_(std::move(opened)),
      ready_(std::move(ready)),
      timeout_(loop.face, [this] { attempt_failed(ETIMEDOUT); }),
      lookup_(loop, owner_, [this](Result<std::vector<HostLookup::Address>> found) {
        if (!found) return done(std::move(found).error());
        addresses_ = std::move(*found);
        try_next();
      }) {}

TcpStream::~TcpStream() { close(); }

void TcpStream::connect(const std::string& host, std::uint16_t port, Duration limit) {
  close();
  host_ = host;
  port_ = port;
  limit_ = limit;
  addresses_.clear();
  next_ = 0;
  last_error_ = 0;
  is_connecting_ = true;
  lookup_.start(host, port);
}

void TcpStream::try_next() {
  while (next_ < addresses_.size()) {
    const HostLookup::Address& address = addresses_[next_++];
    fd_ = ::socket(address.socket.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    int status = fd_ < 0 ? errno : 0;
    if (status == 0) {
      keep_alive(fd_);
      if (::connect(fd_, address.get(), address.size) != 0) status = errno;
    }
    if (status == 0 || status == EINPROGRESS) {
      timeout_.start(limit_);
      watch_ = FdWatch(loop_.face, fd_, FdWatch::readable_and_writable, owner_, [this](const FdEvent& event) {
        if (is_connecting_) return take_attempt();
        if (event.hung_up) watch_.set_events(FdWatch::readable);  // data from before the end is read first
        ready_();
      });
      // For a server on this computer, the result is known already.
      pollfd one{fd_, POLLOUT, 0};
      if (::poll(&one, 1, 0) > 0) take_attempt();
      return;
    }
    last_error_ = status;
    drop_socket();
  }
  done(failure(last_error_));
}

void TcpStream::take_attempt() {
  int error_number = 0;
  socklen_t size = sizeof error_number;
  if (::getsockopt(fd_, SOL_SOCKET, SO_ERROR, &error_number, &size) != 0) error_number = errno;
  sockaddr_storage peer{}, own{};
  size = sizeof peer;
  if (error_number == 0 && ::getpeername(fd_, reinterpret_cast<sockaddr*>(&peer), &size) != 0) {
    if (errno == ENOTCONN) return;  // under way still
    error_number = errno;
  }
  if (error_number != 0) return attempt_failed(error_number);
  // If no program listens, a port of this computer may connect to itself, when the kernel also chooses it for our end.
  size = sizeof own;
  ::getsockname(fd_, reinterpret_cast<sockaddr*>(&own), &size);
  if (std::memcmp(&own, &peer, sizeof own) == 0) return attempt_failed(ECONNREFUSED);
  watch_.set_events(FdWatch::readable);
  done({});
}

void TcpStream::attempt_failed(int error_number) {
  last_error_ = error_number;
  drop_socket();
  try_next();
}

void TcpStream::done(const Result<void>& result) {
  is_connecting_ = false;
  timeout_.stop();
  opened_(result);
}

int TcpStream::release() noexcept {
  watch_.close();
  return std::exchange(fd_, -1);
}

void TcpStream::wait(Duration at_most) {
  const auto end = std::chrono::steady_clock::now() + at_most;
  while (is_connecting_) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end - std::chrono::steady_clock::now());
    if (left.count() <= 0) return;
    if (lookup_.is_under_way()) {
      lookup_.wait(left);
      continue;
    }
    pollfd one{fd_, POLLOUT, 0};
    if (::poll(&one, 1, static_cast<int>(std::min<std::int64_t>(left.count(), 1000))) > 0) take_attempt();
  }
}

void TcpStream::drop_socket() noexcept {
  timeout_.stop();
  watch_.close();  // before the descriptor
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

void TcpStream::close() noexcept {
  is_connecting_ = false;
  lookup_.cancel();
  drop_socket();
}

void TcpStream::end() noexcept {
  close();
  lookup_.end();
}

ssize_t TcpStream::read(char* to, std::size_t most) noexcept { return ::recv(fd_, to, most, MSG_DONTWAIT); }

bool TcpStream::send(std::string_view text) noexcept {
  return ::send(fd_, text.data(), text.size(), MSG_DONTWAIT | MSG_NOSIGNAL) == static_cast<ssize_t>(text.size());
}

ssize_t TcpStream::write(const std::byte* from, std::size_t size) noexcept {
  return ::send(fd_, from, size, MSG_DONTWAIT | MSG_NOSIGNAL);
}

void TcpStream::want_to_write(bool wanted) {
  watch_.set_events(wanted ? FdWatch::readable_and_writable : FdWatch::readable);
}

std::size_t TcpStream::unconfirmed() const noexcept {
  int bytes = 0;
  return fd_ >= 0 && ::ioctl(fd_, SIOCOUTQ, &bytes) == 0 && bytes > 0 ? static_cast<std::size_t>(bytes) : 0;
}

void TcpStream::end_writing() noexcept {
  if (fd_ >= 0 && !is_connecting_) ::shutdown(fd_, SHUT_WR);
}

Error TcpStream::failure(int error_number) const {
  return system_error(error_number, "cannot connect", host_ + " port " + std::to_string(port_),
                      "check that the server runs there: `ss -ltn` on its computer lists the open ports");
}

}  // namespace rtdata::detail
