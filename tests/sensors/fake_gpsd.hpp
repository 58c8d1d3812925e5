// A server as a test scripts it, on a port of this machine that was free.
#pragma once

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdint>
#include <string>
#include <string_view>

class FakeGpsd {
 public:
  enum class Family { ipv4, ipv6 };
  explicit FakeGpsd(Family family = Family::ipv4) : family_(family) { listen(); }
  FakeGpsd(const FakeGpsd&) = delete;
  FakeGpsd& operator=(const FakeGpsd&) = delete;
  ~FakeGpsd() { vanish(); }

  /// False: there is no such family here.
  bool listens() const { return listener_ >= 0; }
  std::uint16_t port() const { return port_; }
  /// At the port that it had before.
  void listen() {
    const bool is_6 = family_ == Family::ipv6;
    listener_ = ::socket(is_6 ? AF_INET6 : AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    const int on = 1;
    ::setsockopt(listener_, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    if (is_6) ::setsockopt(listener_, IPPROTO_IPV6, IPV6_V6ONLY, &on, sizeof on);
    sockaddr_in a4{};
    a4.sin_family = AF_INET;
    a4.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    a4.sin_port = htons(port_);
    sockaddr_in6 a6{};
    a6.sin6_family = AF_INET6;
    a6.sin6_addr = in6addr_loopback;
    a6.sin6_port = htons(port_);
    auto* address = is_6 ? reinterpret_cast<sockaddr*>(&a6) : reinterpret_cast<sockaddr*>(&a4);
    socklen_t size = is_6 ? sizeof a6 : sizeof a4;
    if (::bind(listener_, address, size) != 0 || ::listen(listener_, 8) != 0) {
      ::close(listener_);
      listener_ = -1;
      return;
    }
    ::getsockname(listener_, address, &size);
    port_ = ntohs(is_6 ? a6.sin6_port : a4.sin_port);
  }
  /// Nobody listens, and the connection is gone.
  void vanish() {
    if (listener_ >= 0) ::close(listener_);
    listener_ = -1;
    hang_up();
  }
  void hang_up() {
    if (peer_ >= 0) ::close(peer_);
    peer_ = -1;
  }
  /// Whether somebody has connected since; ends the connection before.
  bool accept() {
    const int peer = ::accept4(listener_, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (peer < 0) return false;
    hang_up();
    peer_ = peer;
    return true;
  }
  /// A connection that somebody has made since, to be closed by the caller; -1: none.
  int take() const { return ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC); }
  bool has_peer() const { return peer_ >= 0; }
  bool send(std::string_view text) {
    return ::send(peer_, text.data(), text.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(text.size());
  }
  /// What has come since.
  std::string received() {
    std::string all(4096, '\0');
    const ssize_t got = ::recv(peer_, all.data(), all.size(), 0);
    all.resize(got > 0 ? static_cast<std::size_t>(got) : 0);
    return all;
  }

 private:
  const Family family_;
  int listener_ = -1;
  int peer_ = -1;
  std::uint16_t port_ = 0;
};
