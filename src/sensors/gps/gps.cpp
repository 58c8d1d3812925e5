#include "rtdata/sensors/gps.hpp"

#include <algorithm>
#include <cerrno>
#include <utility>
#include <vector>

#include "data/listed.hpp"
#include "data/setting_mistake.hpp"
#include "io/enabling.hpp"
#include "net/tcp_stream.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/loop/timer.hpp"
#include "sensors/core/stream_node.hpp"
#include "sensors/gps/gps_report.hpp"
#include "sensors/gps/gps_time.hpp"

namespace rtdata {
namespace detail {
namespace {

// Read at once, and so per turn of the loop; the most reports that this can be stay below the capacity of a topic's
// ring.
constexpr std::size_t most_read = 4096;
constexpr std::size_t most_line = 65536;  // gpsd's own limit is 10 KiB
constexpr std::size_t most_receivers = 16;
constexpr Duration connect_limit = std::chrono::seconds{5};
constexpr Duration start_limit = std::chrono::seconds{2};
constexpr std::string_view watch_command = "?WATCH={\"enable\":true,\"json\":true};\n";
constexpr std::string_view sign_of_life_command = "?DEVICES;\n";

}  // namespace

class GpsNode final : public StreamNode {
 public:
  GpsNode(LoopCore& loop, const FeedConfig& feed, GpsConfig config)
      : StreamNode(loop, feed, payload_type<GpsFix>(), {config.silence, config.retry_first, config.retry_longest}),
        config_(std::move(config)),
        stream_(
            loop, object_name(), [this](const Result<void>& result) { on_opened(result); }, [this] { on_ready(); }),
        answer_(loop.face, [this] { look_for_answer(); }) {
    line_.reserve(2 * most_read);
  }

  void start() override {
    if (!is_open() || is_running()) return;
    begin();
    if (!config_.required) return open_stream();
    Call call(*this);
    std::optional<Error> refusal;
    refusal_ = &refusal;
    open_stream();
    if (is_open()) stream_.wait(start_limit);
    refusal_ = nullptr;
    if (is_open() && stream_.is_connecting() && !refusal) {
      refusal = Error{Errc::timed_out, "cannot connect", server(), "no answer within " + to_string(start_limit),
                      "check `host` and `port`"};
    }
    if (!refusal) return;
    if (is_open()) end();
    throw SetupError(std::move(*refusal));
  }
  std::optional<SensorLoad> load() const override {
    return SensorLoad{origin_.name, Duration{0}, {}, read_time(config_)};
  }

 private:
  /// A receiver that gpsd has named.
  struct Receiver {
    std::string device;
    bool has_reported = false;  ///< a fix, or that there is none
    std::string last;           ///< report, if it had a time
    std::optional<std::uint16_t> used, visible;
    GpsTimeCheck time;
  };

  std::string server() const { return config_.host + " port " + std::to_string(config_.port); }

  void open_stream() override {
    began_ = loop()->now();
    stream_.connect(config_.host, config_.port, connect_limit);
  }
  void close_stream() noexcept override {
    ++connections_;
    answer_.stop();
    stream_.close();
    line_.clear();
    is_overlong_ = false;
    receivers_.clear();
    is_several_ = false;
  }
  void on_opened(const Result<void>& result) {
    Call call(*this);
    if (result && stream_.send(watch_command)) {
      opened();
    } else {
      Error error = result
                        ? Error{Errc::disconnected, "cannot speak to gpsd", server(), "gpsd does not accept data", ""}
                        : result.error();
      const bool is_here = config_.host == "localhost" || config_.host == "127.0.0.1" || config_.host == "::1";
      if (!result && is_here) error.advice = detail::how_to_start_gpsd;
      if (refusal_ != nullptr) {
        *refusal_ = error;
      } else {
        lose(error, began_);
      }
    }
  }

  void on_ready() {
    Call call(*this);
    const std::size_t before = line_.size();
    line_.resize(before + most_read);
    const ssize_t got = stream_.read(line_.data() + before, most_read);
    const int error_number = got < 0 ? errno : 0;
    line_.resize(before + static_cast<std::size_t>(std::max<ssize_t>(got, 0)));
    if (got > 0) {
      is_answered_ = true;
      at_ = loop()->now();
      time_ = loop()->runtime.event_time(at_);
      take_lines(before);
    } else if (got == 0) {
      lose({Errc::disconnected, "lost gpsd", server(), "it has closed the connection",
            "the program connects to it again when it is back"},
           loop()->now());
    } else if (error_number != EAGAIN && error_number != EINTR) {
      lose(system_error(error_number, "lost gpsd", server(), "the program connects to it again when it is back"),
           loop()->now());
    }
  }

  /// Takes the complete lines out of the buffer, whose bytes from `from` on are new.
  void take_lines(std::size_t from) {
    std::size_t begin = 0;
    // A handler may stop and restart the sensor.
    const auto is_same = [this, connection = connections_] { return is_open() && connections_ == connection; };
    while (is_same()) {
      const auto end = line_.find('\n', std::max(begin, from));
      if (end == std::string::npos) break;
      const std::string_view line(line_.data() + begin, end - begin);
      begin = end + 1;
      if (!std::exchange(is_overlong_, false)) take_line(line);
    }
    if (!is_same()) return;
    line_.erase(0, begin);
    if (line_.size() <= most_line) return;
    line_.clear();
    if (!std::exchange(is_overlong_, true)) fail_overlong();
  }
  void take_line(std::string_view line) {
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    if (line.empty()) return;
    if (line.size() > most_line) return fail_overlong();
    if (const Result<void> done = read_report(line, report_); !done) return fail(done.error());
    const std::string_view device = report_.fix.device;
    switch (report_.kind) {
      case GpsReport::Kind::fix:
        if (is_wanted(device)) take_fix(line);
        break;
      case GpsReport::Kind::satellites:
        if (is_wanted(device)) take_satellites(receiver(device));
        break;
      case GpsReport::Kind::device:
        if (report_.is_deactivated) forget(device);
        break;
      case GpsReport::Kind::devices:
        take_devices();
        break;
      case GpsReport::Kind::error:
        degrade({Errc::bad_data, "gpsd reports an error", server(), report_.message, ""});
        break;
      default:
        break;
    }
  }
  void fail_overlong() {
    fail({Errc::does_not_fit, "cannot use a line of gpsd", server(),
          "it is longer than " + std::to_string(most_line) + " bytes", "check that gpsd serves this port"});
  }

  bool is_wanted(std::string_view device) const noexcept { return config_.device.empty() || device == config_.device; }
  Receiver& receiver(std::string_view device) {
    for (Receiver& one : receivers_) {
      if (one.device == device) return one;
    }
    if (receivers_.size() == most_receivers) receivers_.erase(receivers_.begin());
    receivers_.push_back({});
    receivers_.back().device = device;
    return receivers_.back();
  }
  void forget(std::string_view device) {
    std::erase_if(receivers_, [&](const Receiver& one) { return one.device == device; });
    is_several_ = false;  // the next report says whether they still are
  }

  void take_satellites(Receiver& of) {
    if (report_.used) of.used = report_.used;
    if (report_.visible) of.visible = report_.visible;
  }
  void take_devices() {
    devices_ = report_.devices;
    if (config_.device.empty() ? devices_.empty()
                               : std::find(devices_.begin(), devices_.end(), config_.device) == devices_.end())
      lose_receiver();
  }
  void lose_receiver() {
    is_several_ = false;  // no longer the reason
    degrade(no_receiver());
  }
  Error no_receiver() const {
    if (config_.device.empty() || devices_.empty()) {
      return {Errc::not_found, "there is no receiver", server(), "gpsd has none",
              "plug it in, and add its device to /etc/default/gpsd, or with `gpsdctl add`"};
    }
    return {Errc::not_found, "there is no receiver " + config_.device, server(), "gpsd has " + listed(devices_),
            "set `device` to one of these"};
  }

  void take_fix(std::string_view line) {
    heard();
    GpsFix& fix = report_.fix;
    Receiver& from = receiver(fix.device);
    from.has_reported = true;
    fix.satellites_used = from.used;
    fix.satellites_visible = from.visible;
    if (fix.gps_time && from.last == line) {
      ++origin_.counts.received;
      ++origin_.counts.repeated;
    } else {
      from.last.assign(fix.gps_time ? line : std::string_view());
      offer_time(fix, from);
      if (!take_or_fail(&fix, time_)) return;
    }
    if (!is_open() || !is_running()) return;
    if (!is_several_) {
      succeed();
      report_several();
    }
  }
  /// Reports that two receivers are mixed in one series of data.
  void report_several() {
    if (!config_.device.empty() || !is_open()) return;
    std::vector<std::string> names;
    for (const Receiver& one : receivers_) {
      if (one.has_reported) names.push_back(one.device);
    }
    if (names.size() < 2) return;
    is_several_ = true;
    degrade({Errc::bad_configuration, "several receivers", server(), "gpsd has " + listed(names),
             "make a sensor for each, with its `device`: now the reports of all of them come mixed"});
  }

  void offer_time(const GpsFix& fix, Receiver& from) {
    if (config_.report_delay <= Duration{0}) return;
    if (fix.mode < 2 || !fix.gps_time) return from.time.reset();
    RuntimeCore& runtime = loop()->runtime;
    Clock& clock = runtime.clock_log.clock();
    const Time time = from_nanoseconds(*fix.gps_time);
    const GpsTimeCheck::SystemTime system{clock.realtime(), clock.accuracy()};
    constexpr double most_seconds = 3600;
    const auto uncertainty = std::chrono::duration<double>(std::clamp(fix.ept.value_or(0), 0.0, most_seconds));
    const Duration accuracy = config_.report_delay + std::chrono::duration_cast<Duration>(uncertainty);
    const auto both = [&](const std::string& which) {
      return "the receiver says " + to_iso8601(time) + ", and the computer's clock, which " + which + ", says " +
             to_iso8601(system.time);
    };
    switch (from.time.look_at(at_, time, config_.report_delay, accuracy, system)) {
      case GpsTimeCheck::Verdict::open:
        return;
      case GpsTimeCheck::Verdict::other_clock:
        return refuse_time(
            both("is synchronised to " + to_string(*system.accuracy)),
            "check the receiver with `gpsmon`, and the synchronisation of the clock; until then the clock is trusted");
      case GpsTimeCheck::Verdict::other_age:
        return refuse_time(
            both("nothing synchronises") + "; this program was released in " +
                std::to_string(int{this_release.date.year()}),
            "update the receiver's firmware (its week counter restarts after 1024 weeks), or let NTP set the clock");
      case GpsTimeCheck::Verdict::good:
        break;
    }
    // A larger step than leap seconds means that the time was wrong before or is wrong now.
    constexpr Duration most_step = std::chrono::seconds{20};
    const Duration ahead = difference(at_.time_since_epoch(), time.time_since_epoch());
    const Duration step = difference(time_line_.value_or(ahead), ahead);
    if (is_step_reported_ || step > most_step || step < -most_step) {
      if (!std::exchange(is_step_reported_, true)) {
        report({Errc::bad_data, "the receiver's time of day is not used", server(), "it stepped by " + to_string(step),
                "check the receiver with `gpsmon`; recordings keep its earlier time of day"});
      }
      return;
    }
    if (!time_line_) time_line_ = ahead;
    if (!system.accuracy && !std::exchange(is_time_reported_, true))
      runtime.log(LogLevel::warning, object_name(), "its time of day is used: " + both("nothing synchronises"));
    const auto noted = runtime.clock_log.note_wall_clock(
        {.monotonic = at_, .realtime = time, .source = "gps", .accuracy = accuracy});
    if (!noted && !std::exchange(is_time_refusal_reported_, true)) report(noted.error());
  }
  /// Once: it comes with each report.
  void refuse_time(std::string why, const char* advice) {
    if (std::exchange(is_time_refusal_reported_, true)) return;
    report({Errc::bad_data, "the receiver's time of day is not used", server(), std::move(why), advice});
  }

  Error silence_error() const override {
    if (config_.device.empty() ? devices_.empty()
                               : std::find(devices_.begin(), devices_.end(), config_.device) == devices_.end())
      return no_receiver();
    return {Errc::timed_out, "nothing comes", config_.device.empty() ? listed(devices_) : config_.device,
            "gpsd has reported no fix for " + to_string(config_.silence),
            "check the receiver with `gpsmon`; `silence` is how long it may be silent"};
  }
  /// gpsd answers at once, so that a connection whose peer has disappeared silently is noticed.
  void fell_silent() override {
    is_several_ = false;  // silence is the reason now
    is_answered_ = false;
    if (stream_.send(sign_of_life_command)) {
      answer_.start(config_.silence);
    } else {
      lose(no_sign_of_life(), loop()->now());
    }
  }
  void look_for_answer() {
    Call call(*this);
    if (!is_silent()) return;
    if (is_answered_) return fell_silent();
    lose(no_sign_of_life(), loop()->now());
  }
  Error no_sign_of_life() const {
    return {Errc::timed_out, "lost gpsd", server(), "it does not answer",
            "the program connects to it again; check whether its machine and the network are up"};
  }

  void on_close() noexcept override {
    StreamNode::on_close();
    answer_.close();
    stream_.end();
  }

  const GpsConfig config_;
  TcpStream stream_;
  Timer answer_;
  std::optional<Error>* refusal_ = nullptr;  // while a required one starts: where its failure goes
  MonotonicTime began_{};                    // the attempt to connect
  unsigned connections_ = 0;                 // that have ended
  std::string line_;                         // bytes of lines that are not complete, at most most_line + most_read
  bool is_overlong_ = false;                 // the rest of the line is discarded
  bool is_answered_ = false;                 // data has come since gpsd was polled
  MonotonicTime at_{};                       // of the last read
  Time time_{};                              // of the last read
  GpsReport report_;
  std::vector<Receiver> receivers_;
  std::vector<std::string> devices_;   // the devices that gpsd named last
  bool is_several_ = false;            // there are several receivers, which was reported
  std::optional<Duration> time_line_;  // the first used time of day minus the monotonic time
  bool is_step_reported_ = false;
  bool is_time_reported_ = false;  // it was reported that the time is used because the clock is not synchronised
  bool is_time_refusal_reported_ = false;
};

}  // namespace detail

void check_config(const GpsConfig& config, const ConfigItem& item, Problems& problems) {
  if (config.host.empty())
    detail::add_mistake({"host", "the host is empty", "set it, such as \"localhost\""}, item, problems);
}

ReadTime read_time(const GpsConfig&) { return {.on_loop = std::chrono::microseconds{500}}; }

GpsSensor::GpsSensor(Loop& loop, FeedConfig feed, GpsConfig config) {
  const auto refuse = [&](const char* why, const char* advice) {
    throw SetupError({Errc::bad_argument, "cannot use this gpsd", "sensor " + feed.name, why, advice});
  };
  if (config.host.empty()) refuse("it has no host", "such as localhost");
  if (config.port == 0) refuse("port is 0", "set `port`; gpsd uses 2947");
  if (config.retry_first <= Duration{0}) refuse("retry_first is not positive", "such as 100 ms");
  const bool starts = config.start;
  auto* node = new detail::GpsNode(loop.core(), feed, std::move(config));
  GpsSensor made(node);
  if (starts) node->start();
  *this = std::move(made);
}

}  // namespace rtdata
