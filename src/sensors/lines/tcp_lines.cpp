#include "rtdata/sensors/tcp_lines.hpp"

#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <optional>
#include <string>
#include <utility>

#include "net/ip_address.hpp"
#include "net/tcp_stream.hpp"
#include "rtdata/data/config_item.hpp"
#include "sensors/lines/line_config.hpp"
#include "sensors/lines/line_node.hpp"
#include "sensors/lines/tcp_listener.hpp"

namespace rtdata {
namespace detail {
namespace {

constexpr Duration silence_of_the_old = std::chrono::seconds{1};  // after this time a new connection replaces it

std::string place_of(const TcpLinesConfig& config) {
  return (config.listen.empty() ? config.host : config.listen) + " port " + std::to_string(config.port);
}

/// The device connects to this machine: its connection begins with a line.
LineConfig lines_of(TcpLinesConfig& config) {
  if (!config.listen.empty()) config.lines.first_line = FirstLine::keep;
  return std::move(config.lines);
}

SettingMistake mistake_in_tcp(const TcpLinesConfig& config) {
  if (!config.listen.empty()) {
    if (!config.host.empty()) return {"listen", "there is also a `host`: remove one of them"};
    return mistake_in_addresses("listen", config.listen, config.from);
  }
  if (config.host.empty()) return {"host", "there is neither a `host` nor an address to `listen` at"};
  if (std::string why = obstacle_of_host(config.host); !why.empty()) return {"host", std::move(why)};
  if (!config.from.empty()) return {"from", "it works only with `listen`"};
  return {};
}

}  // namespace

/// Sensors that receive lines over a TCP connection.
class TcpLinesNode : public LineNode {
 protected:
  TcpLinesNode(LoopCore& loop, const FeedConfig& feed, TcpLinesConfig& config)
      : LineNode(loop, feed, lines_of(config), place_of(config), "check what the device sends") {
    set_stream();
  }
  void close_source(int fd) noexcept override { ::close(fd); }
  void source_ended(int error_number) override { lose(lost(error_number), loop()->now()); }
  Error lost(int error_number) const {
    constexpr const char* what = "lost the connection";
    if (error_number == 0) return {Errc::disconnected, what, place(), "the device has closed it", "check the device"};
    return system_error(error_number, what, place(), "check the device and the network");
  }
};

class TcpClientNode final : public TcpLinesNode {
 public:
  TcpClientNode(LoopCore& loop, const FeedConfig& feed, TcpLinesConfig config)
      : TcpLinesNode(loop, feed, config),
        host_(std::move(config.host)),
        port_(config.port),
        limit_(config.connect_timeout),
        at_open_(texts_at_open(config.at_open, config.at_open_hex)),
        stream_(
            loop, "sensor " + feed.name, [this](const Result<void>& done) { connected(done); }, [] {}) {}

 private:
  void open_stream() override { stream_.connect(host_, port_, limit_); }
  void close_stream() noexcept override {
    stream_.close();
    LineNode::close_stream();
  }
  void connected(const Result<void>& done) {
    if (!done) return take(done.error());
    for (const std::string& text : at_open_)
      if (!stream_.send(text)) return take(lost(0));
    take(stream_.release());
  }
  void on_close() noexcept override {
    LineNode::on_close();
    stream_.end();
  }

  const std::string host_;
  const std::uint16_t port_;
  const Duration limit_;
  const std::vector<std::string> at_open_;
  TcpStream stream_;
};

class TcpServerNode final : public TcpLinesNode, private TcpListener::User {
 public:
  TcpServerNode(LoopCore& loop, const FeedConfig& feed, TcpLinesConfig config)
      : TcpLinesNode(loop, feed, config),
        address_(*ip_address(config.listen, config.port)),
        at_open_(texts_at_open(config.at_open, config.at_open_hex)),
        later_(loop.face, [this] { choose(); }) {
    if (!config.from.empty()) from_ = ip_address(config.from, 0);
  }
  void stop_schedule(MonotonicTime end) override {
    LineNode::stop_schedule(end);
    end_listening();
  }

 private:
  /// Also called again and again while no device is connected.
  void open_stream() override {
    if (listener_) return;
    Result<std::shared_ptr<TcpListener>> listener = TcpListener::open(*loop(), address_, place());
    if (!listener) return take(listener.error());
    if (auto added = (*listener)->add(*this, from_); !added) return take(added.error());
    listener_ = *std::move(listener);
    lose({Errc::disconnected, "there is no connection", place(), "no device has connected yet",
          "check that the device is on, and that it connects to this address"},
         loop()->now());
  }
  void close_stream() noexcept override {
    LineNode::close_stream();
    if (!is_running()) end_listening();
  }
  void on_close() noexcept override {
    LineNode::on_close();
    later_.close();
  }
  void end_listening() noexcept {
    later_.stop();
    if (waiting_ >= 0) ::close(std::exchange(waiting_, -1));
    if (listener_) listener_->remove(*this);
    listener_.reset();
  }
  /// If a connection exists, the second waits until it is known which one is the device's.
  void take_connection(int fd) override {
    Call call(*this);
    if (!has_source()) return use(fd);
    if (waiting_ >= 0) return refuse(fd, "another device connected while one is sending");
    waiting_ = fd;
    later_.start(silence_of_the_old);
  }
  void connection_refused(Error why) override {
    Call call(*this);
    report(std::move(why));
  }
  void refuse(int fd, const char* why) {
    ::close(fd);
    report({Errc::busy, "closed a connection", place(), why, "use a separate sensor for each device"});
  }
  void choose() {
    Call call(*this);
    const int fd = std::exchange(waiting_, -1);
    if (fd < 0) return;
    char byte = 0;
    const bool has_ended = ::recv(fd, &byte, 1, MSG_PEEK | MSG_DONTWAIT) == 0;  // a port scan, not a device
    const bool is_old_silent = has_source() && loop()->now() - heard_at() >= silence_of_the_old;
    if (has_ended) return refuse(fd, "it was closed at once");
    if (has_source() && !is_old_silent) return refuse(fd, "another device connected while one is sending");
    if (has_source())
      lose({Errc::disconnected, "lost the connection", place(),
            "another connection was made, and nothing has come on this one for 1 s",
            "check the old device; the new connection is used"},
           loop()->now());
    if (!is_running() || has_source()) {
      ::close(fd);  // a callback has stopped it
      return;
    }
    use(fd);
  }
  void use(int fd) {
    keep_alive(fd);
    for (const std::string& text : at_open_) {
      if (::send(fd, text.data(), text.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(text.size())) continue;
      ::close(fd);
      return report(lost(0));
    }
    take(fd);
  }

  const IpAddress address_;
  std::optional<IpAddress> from_;
  const std::vector<std::string> at_open_;
  std::shared_ptr<TcpListener> listener_;
  Timer later_;
  int waiting_ = -1;  // a second connection
};

}  // namespace detail

void check_config(const TcpLinesConfig& config, const ConfigItem& item, Problems& problems) {
  detail::add_mistake(detail::mistake_in_tcp(config), item, problems, "missing-key");
  if (const ConfigItem* const at = item.find("connect_timeout"); at != nullptr && !config.listen.empty())
    problems.add(at->problem("bad-value", "with `listen`, the device makes the connection: remove `connect_timeout`"));
  detail::check_at_open(config.at_open_hex, item, problems);
  check_config(config.lines, item, problems);
}

ReadTime read_time(const TcpLinesConfig& config) { return read_time(config.lines); }

TcpLines::TcpLines(Loop& loop, FeedConfig feed, TcpLinesConfig config) {
  const auto refuse = [&](std::string why, const char* what_helps) {
    throw SetupError({Errc::bad_argument, "cannot connect", "sensor " + feed.name, std::move(why), what_helps});
  };
  if (const auto mistake = detail::mistake_in_tcp(config))
    refuse(mistake.key + ": " + mistake.why, "set `host` or `listen`");
  if (config.port == 0) refuse("there is no port", "set `port`");
  detail::check_source(config.lines, feed.name);
  const bool starts = config.lines.start;
  detail::LineNode* node = nullptr;
  if (config.listen.empty())
    node = new detail::TcpClientNode(loop.core(), feed, std::move(config));
  else
    node = new detail::TcpServerNode(loop.core(), feed, std::move(config));
  TcpLines made(node);
  if (starts) node->start();
  *this = std::move(made);
}

}  // namespace rtdata
