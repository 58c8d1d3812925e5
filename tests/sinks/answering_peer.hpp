// A server in the test itself that answers each event, request or message; it may vanish without a word.
#pragma once

#include <arpa/inet.h>
#include <doctest/doctest.h>
#include <linux/filter.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <functional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace sinks {

/// From now on the kernel drops whatever comes for this socket, before TCP sees it.
inline void go_silent(int fd) {
  sock_filter drop{BPF_RET | BPF_K, 0, 0, 0};
  const sock_fprog program{1, &drop};
  REQUIRE(::setsockopt(fd, SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof program) == 0);
}

inline void hear_again(int fd) {
  const int unused = 0;
  REQUIRE(::setsockopt(fd, SOL_SOCKET, SO_DETACH_FILTER, &unused, sizeof unused) == 0);
}

/// Takes what is whole out of the bytes that have come: the answer to it, empty when there is nothing whole.
using Answering = std::function<std::string(std::string& in, std::string& got)>;

class Peer {
 public:
  /// On a free port, or on this one.
  explicit Peer(Answering answering, std::uint32_t at = INADDR_LOOPBACK, std::uint16_t port = 0)
      : answering_(std::move(answering)) {
    listener_ = ::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(at);
    address.sin_port = htons(port);
    socklen_t size = sizeof address;
    REQUIRE(::bind(listener_, reinterpret_cast<sockaddr*>(&address), size) == 0);
    REQUIRE(::listen(listener_, 16) == 0);
    ::getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &size);
    port_ = ntohs(address.sin_port);
  }
  Peer(const Peer&) = delete;
  Peer& operator=(const Peer&) = delete;
  ~Peer() {
    for (const Connection& one : connections_) ::close(one.fd);
    ::close(listener_);
  }
  std::uint16_t port() const { return port_; }
  std::size_t connections() const { return connections_.size(); }
  const std::string& got() const { return got_; }
  void look() {
    for (int fd = accept(); fd >= 0; fd = accept()) connections_.push_back({fd, ""});
    for (Connection& one : connections_) {
      char bytes[65536];
      for (ssize_t size = 0; (size = ::recv(one.fd, bytes, sizeof bytes, MSG_DONTWAIT)) > 0;)
        one.in.append(bytes, static_cast<std::size_t>(size));
      for (;;) {
        const std::string answer = answering_(one.in, got_);
        if (answer.empty()) break;
        one.out += answer;
        if (!drips_) pour(one, one.out.size());
      }
    }
  }
  /// From now on it answers a byte for each call of `drop`, or all at once again.
  void drip(bool drips) {
    drips_ = drips;
    for (Connection& one : connections_)
      if (!drips) pour(one, one.out.size());
  }
  void drop() {
    for (Connection& one : connections_) pour(one, 1);
  }
  /// The connections that there are.
  void lose_connections() {
    for (const Connection& one : connections_) go_silent(one.fd);
  }
  /// Nor does a new one come about.
  void vanish() {
    lose_connections();
    go_silent(listener_);
  }
  /// As a program that ends: nobody listens, and the connections are closed.
  void leave() {
    close_connections();
    ::close(std::exchange(listener_, -1));
  }
  void return_() { hear_again(listener_); }
  /// All that there are; new ones come about.
  void close_connections() {
    for (const Connection& one : connections_) ::close(one.fd);
    connections_.clear();
  }

 private:
  struct Connection {
    int fd;
    std::string in;
    std::string out = {};  // answers, not sent yet
  };
  static void pour(Connection& one, std::size_t most) {
    const ssize_t sent = ::send(one.fd, one.out.data(), std::min(most, one.out.size()), MSG_NOSIGNAL);
    if (sent > 0) one.out.erase(0, static_cast<std::size_t>(sent));
  }
  int accept() const {
    const int fd = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC), on = 1;
    // In virtual time nothing waits for the kernel to send a small answer.
    if (fd >= 0) ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    return fd;
  }

  const Answering answering_;
  int listener_ = -1;
  std::uint16_t port_ = 0;
  std::vector<Connection> connections_;
  std::string got_;
  bool drips_ = false;
};

inline std::string take(std::string& in, std::size_t size) {
  std::string taken = in.substr(0, size);
  in.erase(0, size);
  return taken;
}

inline std::string answer_line(std::string& in, std::string& got) {
  const std::size_t end = in.find('\n');
  if (end == std::string::npos) return "";
  got += take(in, end + 1);
  return "ok\n";
}

inline std::string answer_request(std::string& in, std::string& got) {
  constexpr std::string_view end_of_head = "\r\n\r\n", length = "Content-Length: ";
  const std::size_t head = in.find(end_of_head), at = in.find(length);
  if (head == std::string::npos || at == std::string::npos) return "";
  const std::size_t body = head + end_of_head.size();
  const std::size_t size = std::strtoul(in.c_str() + at + length.size(), nullptr, 10);
  if (in.size() < body + size) return "";
  (void)take(in, body);
  got += take(in, size);
  return "HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n";
}

/// As much of a broker of MQTT 5 as a sender with QoS 1 needs.
inline std::string answer_packet(std::string& in, std::string& got) {
  for (;;) {
    std::size_t size = 0, used = 1;
    for (unsigned shift = 0;; shift += 7) {
      if (in.size() <= used) return "";
      const auto byte = static_cast<unsigned char>(in[used++]);
      size |= std::size_t{byte & 127U} << shift;
      if ((byte & 128) == 0) break;
    }
    if (in.size() < used + size) return "";
    const std::string packet = take(in, used + size);
    switch (static_cast<unsigned char>(packet[0]) >> 4) {
      case 1:
        return {"\x20\x03\0\0\0", 5};
      case 3: {
        const std::size_t topic = std::size_t{static_cast<unsigned char>(packet[used])} * 256 +
                                  static_cast<unsigned char>(packet[used + 1]);
        const std::size_t number = used + 2 + topic;
        got += packet.substr(number + 3) + "\n";  // after the number, and no properties
        return std::string("\x40\x02") + packet.substr(number, 2);
      }
      case 12:
        return {"\xd0\0", 2};
      default:
        break;
    }
  }
}

}  // namespace sinks
