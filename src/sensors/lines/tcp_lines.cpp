#include "rtdata/sensors/tcp_lines.hpp"

#include <unistd.h>

#include <string>
#include <utility>

#include "net/tcp_stream.hpp"
#include "rtdata/data/config_item.hpp"
#include "sensors/lines/line_node.hpp"

namespace rtdata {
namespace detail {

class TcpLinesNode final : public LineNode {
 public:
  TcpLinesNode(LoopCore& loop, const FeedConfig& feed, TcpLinesConfig config)
      : LineNode(loop, feed, std::move(config.lines), config.host + " port " + std::to_string(config.port),
                 "check what the device sends"),
        host_(std::move(config.host)),
        port_(config.port),
        limit_(config.connect_timeout),
        at_open_(std::move(config.at_open)),
        stream_(
            loop, "sensor " + feed.name, [this](const Result<void>& done) { connected(done); }, [] {}) {
    set_stream();
  }

 private:
  void open_stream() override { stream_.connect(host_, port_, limit_); }
  void close_stream() noexcept override {
    stream_.close();
    LineNode::close_stream();
  }
  void close_source(int fd) noexcept override { ::close(fd); }
  void connected(const Result<void>& done) {
    if (!done) return take(done.error());
    for (const std::string& text : at_open_)
      if (!stream_.send(text)) return take(lost(0));
    take(stream_.release());
  }
  void source_ended(int error_number) override { lose(lost(error_number), loop()->now()); }
  Error lost(int error_number) const {
    constexpr const char* what = "lost the connection";
    if (error_number == 0) return {Errc::disconnected, what, place(), "the device has ended it", "check the device"};
    return system_error(error_number, what, place(), "check the device and the network");
  }

  const std::string host_;
  const std::uint16_t port_;
  const Duration limit_;
  const std::vector<std::string> at_open_;
  TcpStream stream_;
};

}  // namespace detail

void check_config(const TcpLinesConfig& config, const ConfigItem& item, Problems& problems) {
  if (const std::string why = detail::obstacle_of_host(config.host); !why.empty()) {
    const ConfigItem* const at = item.find("host");
    problems.add((at != nullptr ? *at : item).problem("bad-value", why));
  }
  check_config(config.lines, item, problems);
}

ReadTime read_time(const TcpLinesConfig& config) { return read_time(config.lines); }

TcpLines::TcpLines(Loop& loop, FeedConfig feed, TcpLinesConfig config) {
  const auto refuse = [&](std::string why, const char* what_helps) {
    throw SetupError({Errc::bad_argument, "cannot connect", "sensor " + feed.name, std::move(why), what_helps});
  };
  if (std::string why = detail::obstacle_of_host(config.host); !why.empty()) refuse(std::move(why), "set `host`");
  if (config.port == 0) refuse("there is no port", "set `port`");
  detail::check_source(config.lines, feed.name);
  const bool starts = config.lines.start;
  auto* node = new detail::TcpLinesNode(loop.core(), feed, std::move(config));
  TcpLines made(node);
  if (starts) node->start();
  *this = std::move(made);
}

}  // namespace rtdata
