#include "rtdata/sensors/pps.hpp"

#include <algorithm>
#include <utility>

#include "data/setting_mistake.hpp"
#include "rtdata/data/problem.hpp"
#include "sensors/core/stream_node.hpp"
#include "sensors/core/sysfs_file.hpp"
#include "sensors/kernel/pps_time.hpp"

namespace rtdata {
namespace detail {
namespace {

constexpr const char* cannot_read_pps = "cannot read the pulses";
constexpr const char*
    find_advice = "`ls /sys/class/pps` lists the sources; an overlay or ldattach makes one (docs/iio.md)";
constexpr std::string_view no_name = "`device` must be a name such as pps0, or /dev/pps0";
constexpr Duration least_wait = std::chrono::milliseconds{2};
constexpr Duration first_wait = std::chrono::milliseconds{20};
constexpr Duration longest_wait = std::chrono::milliseconds{100};

std::string name_of(std::string device) {
  constexpr std::string_view folder = "/dev/";
  if (device.starts_with(folder)) device.erase(0, folder.size());
  return device;
}
bool is_name(const std::string& device) {
  const std::string name = name_of(device);
  return !name.empty() && name.find('/') == std::string::npos && name != "." && name != ".." && name.size() <= 64;
}

std::string file_of(const PpsConfig& config) {
  return config.root + "/sys/class/pps/" + name_of(config.device) +
         (config.edge == PpsEdge::assert_edge ? "/assert" : "/clear");
}

}  // namespace

class PpsNode final : public StreamNode {
 public:
  PpsNode(LoopCore& loop, const FeedConfig& feed, PpsConfig config)
      : StreamNode(loop, feed, payload_type<PpsPulse>(), {config.silence, config.retry_first, config.retry_longest}),
        config_(std::move(config)),
        file_(file_of(config_)),
        next_(loop.face, [this] { on_time(); }) {
    origin_.counts.lost_is_known = true;
  }

  void start() override {
    if (!is_open() || is_running()) return;
    const Result<PpsStamp> first = read();
    if (!first && config_.required) throw SetupError(first.error());
    begin();
    take_first(first);
  }
  std::optional<SensorLoad> load() const override {
    return SensorLoad{origin_.name, Duration{0}, {}, read_time(config_)};
  }

 private:
  Result<PpsStamp> read() {
    file_.read();
    if (file_.error_number() == ENODEV)
      return Error{Errc::disconnected, cannot_read_pps, file_.path(), "the source is gone",
                   "the program tries to open it again"};
    if (file_.error_number() != 0)
      return system_error(file_.error_number(), cannot_read_pps, file_.path(), find_advice);
    auto stamp = parse_pps(file_.text());
    if (stamp) return stamp;
    Error error = std::move(stamp).error();
    error.where = file_.path();
    return error;
  }

  void open_stream() override { take_first(read()); }
  void close_stream() noexcept override {
    next_.stop();
    file_.close();
  }
  /// The pulse before the opening is not an event: it may come from another source.
  void take_first(const Result<PpsStamp>& first) {
    if (!first) return lose(first.error(), loop()->now());
    count_ = first->count;
    looked_ = loop()->now();
    last_.reset();
    expected_.reset();
    check_.reset();
    opened();
    next_.start(first_wait);
  }

  void on_time() {
    Call call(*this);
    const MonotonicTime before = std::exchange(looked_, loop()->now());
    const Result<PpsStamp> stamp = read();
    if (!stamp && stamp.error().code == Errc::bad_data) {
      check_.reset();
      fail(stamp.error());
      if (is_open() && is_running()) next_.start(longest_wait);
      return;
    }
    if (!stamp) return lose(stamp.error(), looked_);
    if (stamp->count != count_) take(*stamp, before);
    if (!is_open() || !is_running()) return;
    Duration wait = is_silent() ? longest_wait : first_wait;
    if (expected_ && last_) {
      const MonotonicTime due = later(*last_, *expected_ + least_wait);
      wait = due > looked_ ? span_between(looked_, due)
                           : std::clamp(span_between(due, looked_) / 4 + *expected_ / 100, least_wait, longest_wait);
    }
    next_.start(wait);
  }

  void take(const PpsStamp& stamp, MonotonicTime before) {
    heard();
    const std::uint32_t pulses = stamp.count - std::exchange(count_, stamp.count);
    const Time now = loop()->runtime.clock_log.clock().realtime();
    const Duration ago = difference(stamp.time.time_since_epoch(), now.time_since_epoch());
    const MonotonicTime instant = later(looked_, -ago);
    // The pulse came between the last read and this read, unless the clock was set in between.
    constexpr Duration noise = std::chrono::milliseconds{1};
    const bool is_known = instant <= later(looked_, noise) && instant >= later(before, -noise);
    const MonotonicTime at = is_known ? std::min(instant, looked_) : looked_;
    PpsPulse pulse{stamp.count, {}, std::chrono::duration<double>(from_second(stamp.time)).count()};
    if (is_known && last_ && span_between(*last_, at) > Duration{0}) {
      const Duration apart = span_between(*last_, at);
      expected_ = apart / static_cast<std::int64_t>(pulses);
      if (pulses == 1) pulse.interval = std::chrono::duration<double>(apart).count();
    }
    if (last_ || pulses > 1) origin_.counts.lost += pulses - 1;
    last_ = is_known ? std::optional(at) : std::nullopt;
    ++origin_.counts.received;
    ++origin_.counts.published;
    origin_.topic.publish(origin_, loop()->runtime.event_time(at), &pulse);
    if (is_known) {
      offer_time(at, stamp.time);
    } else {
      check_.reset();
    }
    if (is_open() && is_running()) succeed();
  }

  void offer_time(MonotonicTime at, Time time) {
    if (config_.accuracy <= Duration{0}) return;
    ClockLog& log = loop()->runtime.clock_log;
    switch (check_.look_at(at, time, log.clock().accuracy(), config_.accuracy)) {
      case PpsTimeCheck::Verdict::accepted: {
        const auto noted = log.note_wall_clock({.monotonic = at,
                                                .realtime = time - from_second(time),
                                                .source = name_of(config_.device),
                                                .accuracy = config_.accuracy});
        if (!noted && !std::exchange(is_reported_, true)) report(noted.error());
        break;
      }
      case PpsTimeCheck::Verdict::not_a_second:
        if (std::exchange(is_reported_, true)) break;
        report({Errc::bad_data, "the pulses cannot give the time of day", file_.path(),
                "the pulses are " + to_string(from_second(time)) + " off the full second by the computer's clock",
                "set `edge` to the other edge, or `accuracy` to 0 if the pulses do not mark full seconds"});
        break;
      case PpsTimeCheck::Verdict::unkept_clock:
      case PpsTimeCheck::Verdict::too_few:
        break;
    }
  }

  Error silence_error() const override {
    return {Errc::timed_out, "nothing comes", file_.path(), "no pulse for " + to_string(config_.silence),
            "check the wire, and wait for a fix: receivers give no pulses before it"};
  }
  void on_close() noexcept override {
    StreamNode::on_close();
    next_.close();
  }

  const PpsConfig config_;
  SysfsFile file_;
  Timer next_;                         // read of the file
  std::uint32_t count_ = 0;            // of the last pulse
  MonotonicTime looked_{};             // last
  std::optional<MonotonicTime> last_;  // pulse, if its time is known
  std::optional<Duration> expected_;   // from one to the next
  PpsTimeCheck check_;
  bool is_reported_ = false;  // why it cannot be a time source
};

}  // namespace detail

void check_config(const PpsConfig& config, const ConfigItem& item, Problems& problems) {
  if (detail::is_name(config.device)) return;
  detail::add_mistake({"device", std::string(detail::no_name)}, item, problems);
}

ReadTime read_time(const PpsConfig&) { return {.on_loop = std::chrono::microseconds{100}}; }

PpsSensor::PpsSensor(Loop& loop, FeedConfig feed, PpsConfig config) {
  const auto refuse = [&](std::string why, const char* advice) {
    throw SetupError(
        {Errc::bad_argument, "cannot use this source of pulses", "sensor " + feed.name, std::move(why), advice});
  };
  if (!detail::is_name(config.device)) refuse(std::string(detail::no_name), "`ls /sys/class/pps` lists them");
  if (config.retry_first <= Duration{0}) refuse("retry_first is not positive", "such as 100 ms");
  const bool starts = config.start;
  auto* node = new detail::PpsNode(loop.core(), feed, std::move(config));
  PpsSensor made(node);
  if (starts) node->start();
  *this = std::move(made);
}

}  // namespace rtdata
