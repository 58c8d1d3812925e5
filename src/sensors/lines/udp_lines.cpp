#include "rtdata/sensors/udp_lines.hpp"

#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <string>
#include <utility>

#include "net/ip_address.hpp"
#include "rtdata/data/config_item.hpp"
#include "sensors/lines/line_node.hpp"

namespace rtdata {
namespace detail {
namespace {

// The most datagrams read in one turn of the loop: their lines stay below the capacity of a topic's ring.
constexpr std::size_t most_turn_bytes = 512;
constexpr int most_turn_datagrams = 16;
constexpr int buffer_size = 1 << 20;  // in the kernel, which may give less

/// A non-blocking socket that receives at this address.
Result<int> open_udp(const IpAddress& address, const std::string& place) {
  const int fd = ::socket(address.storage.ss_family, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  const auto failed = [&](const char* advice) {
    const int number = errno;
    if (fd >= 0) ::close(fd);
    return system_error(number, "cannot receive on this port", place, advice);
  };
  if (fd < 0) return failed("check that this computer supports IPv4 or IPv6, as `address` needs");
  const int on = 1;
  ::setsockopt(fd, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on);
  ::setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &buffer_size, sizeof buffer_size);
  if (address.is_group())
    ::setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);  // other programs may receive it too
  if (::bind(fd, address.get(), address.size) != 0)
    return failed(errno == EADDRINUSE ? "choose another port, or end the program that uses this one (`ss -ulp` shows "
                                        "it); it may also be another sensor"
                                      : "check `address` and `port`");
  if (!address.is_group()) return fd;
  if (address.is_v6()) {
    const ipv6_mreq group{address.v6().sin6_addr, 0};
    if (::setsockopt(fd, IPPROTO_IPV6, IPV6_JOIN_GROUP, &group, sizeof group) != 0)
      return failed("check that a network interface supports multicast");
  } else {
    const ip_mreqn group{address.v4().sin_addr, {}, 0};
    if (::setsockopt(fd, IPPROTO_IP, IP_ADD_MEMBERSHIP, &group, sizeof group) != 0)
      return failed("check that a network interface supports multicast");
  }
  return fd;
}

/// No datagram begins in the middle of a line.
LineConfig from_the_first(LineConfig config) {
  config.first_line = FirstLine::keep;
  return config;
}

}  // namespace

class UdpLinesNode final : public LineNode {
 public:
  UdpLinesNode(LoopCore& loop, const FeedConfig& feed, UdpLinesConfig config)
      : LineNode(loop, feed, from_the_first(std::move(config.lines)),
                 config.address + " port " + std::to_string(config.port), "check what the device sends"),
        address_(*ip_address(config.address, config.port)) {
    if (!config.from.empty()) from_ = ip_address(config.from, 0);
    buffer_.resize(UdpLinesConfig::longest_datagram + 1);  // plus the end of its last line
    set_stream();
  }

  void stop() override {
    if (is_open()) look_for_drops();
    LineNode::stop();
  }
  void stop_schedule(MonotonicTime end) override {
    look_for_drops();
    LineNode::stop_schedule(end);
  }

 private:
  void open_stream() override {
    dropped_ = 0;
    take(open_udp(address_, place()));
  }
  void close_source(int fd) noexcept override {
    ::close(fd);
    fd_ = -1;
  }
  void watch_source(int fd) override {
    fd_ = fd;
    socket_ = FdWatch(loop()->face, fd, FdWatch::readable, object_name(),
                      [this, fd](const FdEvent&) { read_datagrams(fd); });
  }
  void close_stream() noexcept override {
    socket_.close();  // before the descriptor
    LineNode::close_stream();
  }
  void source_ended(int error_number) override {
    lose(system_error(error_number, "cannot receive on this port", place(), "check the network"), loop()->now());
  }

  void read_datagrams(int fd) {
    Call call(*this);
    const auto is_same = [this, opening = opening()] { return has_source() && opening == this->opening(); };
    std::size_t taken = 0;
    for (int i = 0; i < most_turn_datagrams && taken < most_turn_bytes && is_same(); ++i) {
      IpAddress sender;
      iovec bytes{buffer_.data(), UdpLinesConfig::longest_datagram};
      alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(std::uint32_t))> extra;
      msghdr message{};
      message.msg_name = &sender.storage;
      message.msg_namelen = sizeof sender.storage;
      message.msg_iov = &bytes;
      message.msg_iovlen = 1;
      message.msg_control = extra.data();
      message.msg_controllen = extra.size();
      const ssize_t got = ::recvmsg(fd, &message, 0);
      if (got < 0) {
        const int number = errno;
        if (number == EAGAIN || number == EINTR) return;
        return source_ended(number);
      }
      note_drops(message);
      if (from_ && !from_->is_same_host(sender)) {
        leave_out();
        continue;
      }
      if ((message.msg_flags & MSG_TRUNC) != 0) {
        fail({Errc::does_not_fit, "cannot use a datagram", place(),
              "it is longer than " + std::to_string(UdpLinesConfig::longest_datagram) + " bytes",
              "set the device to send smaller datagrams"});
        continue;
      }
      taken += static_cast<std::size_t>(got);
      take_datagram(static_cast<std::size_t>(got));
    }
  }
  void take_datagram(std::size_t size) {
    if (size == 0) return leave_out();
    if (!config().frame && buffer_[size - 1] != config().line_end) buffer_[size++] = config().line_end;
    const unsigned before = opening();
    take_bytes_read({buffer_.data(), size}, 0);
    if (has_source() && opening() == before) end_message();  // the next datagram may be of another sender
  }
  /// Also finds dropped datagrams after which no datagram was received.
  void look_for_drops() {
    std::array<std::uint32_t, 16> numbers{};
    socklen_t size = sizeof numbers;
    constexpr std::size_t place_of_drops = 8;  // SK_MEMINFO_DROPS of linux/sock_diag.h
    if (fd_ < 0 || ::getsockopt(fd_, SOL_SOCKET, SO_MEMINFO, numbers.data(), &size) != 0) return;
    if (size > place_of_drops * sizeof numbers[0]) note_drops(numbers[place_of_drops], true);
  }
  void note_drops(std::uint32_t dropped, bool is_end = false) {
    const std::uint32_t more = dropped - std::exchange(dropped_, dropped);
    if (more == 0) return;
    const Error error{Errc::backlog, "datagrams are lost", place(),
                      "the kernel has dropped " + std::to_string(more) + ": its buffer was full",
                      "find what holds the loop, or set the device to send less"};
    // The numbers of the lines show how many are missing; without them each dropped datagram counts as unreadable.
    if (!config().sequence_field.empty()) {
      if (is_end) origin_.counts.lost += more;  // no number will follow
      return degrade(error);
    }
    origin_.counts.received += more - 1;
    origin_.counts.unreadable += more - 1;
    fail(error);
  }
  /// The kernel counts what it drops since the socket was opened.
  void note_drops(msghdr& message) {
    for (cmsghdr* one = CMSG_FIRSTHDR(&message); one != nullptr; one = CMSG_NXTHDR(&message, one)) {
      if (one->cmsg_level != SOL_SOCKET || one->cmsg_type != SO_RXQ_OVFL) continue;
      std::uint32_t dropped = 0;
      std::memcpy(&dropped, CMSG_DATA(one), sizeof dropped);
      note_drops(dropped);
    }
  }

  const IpAddress address_;
  std::optional<IpAddress> from_;
  FdWatch socket_;
  std::string buffer_;
  int fd_ = -1;
  std::uint32_t dropped_ = 0;  // by the kernel
};

}  // namespace detail

bool UdpLinesConfig::is_group() const {
  const auto own = detail::ip_address(address, port);
  return own && own->is_group();
}

void check_config(const UdpLinesConfig& config, const ConfigItem& item, Problems& problems) {
  detail::add_mistake(detail::mistake_in_addresses("address", config.address, config.from), item, problems);
  check_config(config.lines, item, problems);
}

ReadTime read_time(const UdpLinesConfig& config) { return read_time(config.lines); }

UdpLines::UdpLines(Loop& loop, FeedConfig feed, UdpLinesConfig config) {
  const auto refuse = [&](std::string why) {
    throw SetupError({Errc::bad_argument, "cannot receive on this port", "sensor " + feed.name, std::move(why),
                      "check `address`, `port` and `from`"});
  };
  if (const auto mistake = detail::mistake_in_addresses("address", config.address, config.from))
    refuse(mistake.key + ": " + mistake.why);
  if (config.port == 0) refuse("there is no port");
  detail::check_source(config.lines, feed.name);
  const bool starts = config.lines.start;
  auto* node = new detail::UdpLinesNode(loop.core(), feed, std::move(config));
  UdpLines made(node);
  if (starts) node->start();
  *this = std::move(made);
}

}  // namespace rtdata
