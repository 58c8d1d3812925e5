#include <algorithm>
#include <atomic>
#include <bit>
#include <functional>
#include <utility>

#include "loop/core/no_thread.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/io/iio.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sensors/iio.hpp"
#include "sensors/core/stream_node.hpp"
#include "sensors/kernel/iio_lane.hpp"

namespace rtdata {
namespace detail {
namespace {

constexpr const char* cannot_open = "cannot use the IIO buffer";
// The most scans published in one turn: fewer than the capacity of a topic's ring.
constexpr std::size_t most_at_once = 512;
// Kernels up to at least 6.1 do not wake a reader when a device is removed.
constexpr Duration look_again = std::chrono::milliseconds{500};
// A driver may give the first scan a time before the buffer was enabled, because it counts back from its interrupt.
constexpr Duration most_before = std::chrono::seconds{1};
constexpr Duration most_ahead = std::chrono::milliseconds{10};

/// Opens the device on its lane. The sensor owns the result, or this job if the sensor no longer wants it.
class IioOpening final : public LaneJob {
 public:
  IioOpening(IioBufferConfig config, std::function<void(IioOpening&, Outcome)> done)
      : config_(std::move(config)), done_(std::move(done)) {}

  void run() noexcept override {
    if (state_.load() == unwanted) return;
    try {
      open();
    } catch (...) {  // the text is short enough to need no memory
      error = Error{Errc::io_failed, "no memory", "", "", ""};
    }
    if (state_.exchange(finished) == unwanted) capture = nullptr;
  }
  void done(Outcome outcome) override {
    if (const auto done = std::exchange(done_, nullptr)) done(*this, outcome);
  }
  /// Returns what must be closed. `done` is not called any more.
  std::shared_ptr<IioCapture> cancel() noexcept {
    done_ = nullptr;
    return state_.exchange(unwanted) == finished ? std::move(capture) : nullptr;
  }

  std::shared_ptr<IioCapture> capture;
  std::optional<Error> error;
  MonotonicTime began{};

 private:
  enum State { wanted, finished, unwanted };
  void open() {
    const auto device = IioDevice::find(config_.device, config_.root);
    began = lane_now();
    if (!device) {
      error = device.error();
      return;
    }
    auto opened = IioCapture::open(*device, {.channels = config_.channels,
                                             .trigger = config_.trigger,
                                             .rate = config_.rate.value_or(Rate{}),
                                             .length = config_.length,
                                             .watermark = config_.watermark});
    if (opened) {
      capture = std::make_shared<IioCapture>(std::move(*opened));
    } else {
      error = std::move(opened).error();
    }
  }
  const IioBufferConfig config_;
  std::function<void(IioOpening&, Outcome)> done_;  // on the loop
  std::atomic<State> state_{wanted};
};

class IioClosing final : public LaneJob {
 public:
  explicit IioClosing(std::shared_ptr<IioCapture> capture) noexcept : capture_(std::move(capture)) {}
  void run() noexcept override { capture_->close(); }
  void done(Outcome) override { is_done_ = true; }
  bool is_done() const noexcept { return is_done_; }

 private:
  std::shared_ptr<IioCapture> capture_;
  bool is_done_ = false;
};

}  // namespace

class IioBufferNode final : public StreamNode {
 public:
  IioBufferNode(LoopCore& loop, const FeedConfig& feed, IioBufferConfig config)
      : StreamNode(loop, feed, described_type(iio_description(config.channels).or_throw()),
                   {config.silence, config.retry_first, config.retry_longest}),
        config_(std::move(config)),
        rest_(loop.face, [this] { on_rest(); }),
        look_(loop.face, [this] { look(); }) {
    origin_.expect_gaps();
  }

  void start() override {
    if (!is_open() || is_running()) return;
    begin();
    Call call(*this);
    std::optional<Error> refusal;
    if (config_.required) refusal_ = &refusal;
    open_stream();
    if (is_open() && opening_ != nullptr && (loop()->is_being_set_up() || config_.required)) wait();
    refusal_ = nullptr;
    if (!config_.required) return;
    if (is_open() && opening_ != nullptr && !refusal) refusal = given_up_error();
    if (!refusal) return;
    if (is_open()) end();
    throw SetupError(std::move(*refusal));
  }
  std::optional<SensorLoad> load() const override {
    return SensorLoad{origin_.name, Duration{0}, {}, read_time(config_)};
  }

 private:
  Lane& lane() { return loop()->lanes.of(iio_lane(config_.device, config_.root), config_.timeout); }

  void wait() {
    const MonotonicTime end = later(loop()->now(), config_.timeout);
    Lane& on = lane();
    while (is_open() && opening_ != nullptr) {
      const Duration left = span_between(loop()->now(), end);
      if (left <= Duration{0}) return;
      on.wait(left);
    }
  }

  void wait_for_closing() noexcept {
    try {
      const MonotonicTime end = later(loop()->now(), config_.timeout);
      while (closing_ != nullptr && !closing_->is_done()) {
        const Duration left = span_between(loop()->now(), end);
        if (left <= Duration{0}) return;
        lane().wait(left);
      }
    } catch (...) {  // no memory for a lane
    }
  }

  void open_stream() override {
    close_the_rest();
    began_ = loop()->now();
    try {
      opening_ = std::make_shared<IioOpening>(
          config_, [this](IioOpening& job, LaneJob::Outcome outcome) { on_opened(job, outcome); });
      Lane& on = lane();
      if (on.submit(opening_, config_.timeout)) return;
      opening_ = nullptr;
      cannot(on.lacks_thread() ? no_thread(cannot_open, config_.device)
             : on.is_stuck()   ? given_up_error()
                               : Error{Errc::busy, cannot_open, config_.device, "its lane is full", ""});
    } catch (const std::exception& e) {
      opening_ = nullptr;
      cannot({Errc::io_failed, cannot_open, config_.device, e.what(), ""});
    }
  }
  void cannot(const Error& error) {
    if (refusal_ != nullptr) {
      *refusal_ = error;
    } else {
      lose(error, began_);
    }
  }
  Error given_up_error() const {
    return {Errc::timed_out, cannot_open, config_.device, "no answer within " + to_string(config_.timeout),
            "check the chip and its bus; `timeout` sets how long to wait"};
  }

  void on_opened(IioOpening& job, LaneJob::Outcome outcome) {
    Call call(*this);
    const auto done = std::exchange(opening_, nullptr);
    if (outcome != LaneJob::Outcome::finished) {
      job.cancel();
      return cannot(given_up_error());
    }
    if (job.error) return cannot(*job.error);
    use(std::move(job.capture), job.began);
  }
  void use(std::shared_ptr<IioCapture> capture, MonotonicTime began) {
    capture_ = std::move(capture);
    const IioLayout& layout = capture_->layout();
    // The kernel rounds the length up in this way; a full buffer comes in one read.
    bytes_.resize(std::bit_ceil(config_.length) * layout.size());
    values_.resize(layout.values());
    at_ = end_ = 0;
    turned_on_ = later(began, -most_before);
    last_ = last_published_ = MonotonicTime{};
    was_full_ = false;
    const std::string& clock = capture_->clock();
    is_monotonic_ = clock == "monotonic" || clock == "monotonic_coarse";
    has_clock_ = is_monotonic_ || clock == "realtime" || clock == "realtime_coarse";
    const double frequency = capture_->frequency();
    interval_ = frequency > 0 ? Rate::hertz(frequency).period() : Duration{0};
    opened();
    watch_ = FdWatch(loop()->face, capture_->fd(), FdWatch::readable, object_name(),
                     [this](const FdEvent& event) { on_ready(event.hung_up); });
    look_.start(look_again);
    for (const std::string& note : capture_->notes()) loop()->runtime.log(LogLevel::warning, object_name(), note);
  }

  void close_stream() noexcept override {
    watch_.close();  // before the descriptor
    rest_.stop();
    look_.stop();
    at_ = end_ = 0;
    auto capture = std::exchange(capture_, nullptr);
    if (const auto opening = std::exchange(opening_, nullptr)) capture = opening->cancel();
    if (capture != nullptr) unclosed_.push_back(std::move(capture));
    close_the_rest();
  }
  /// Disables open captures on the lane, which may take long. If the lane is stuck, they wait.
  void close_the_rest() noexcept {
    try {
      while (!unclosed_.empty()) {
        auto closing = std::make_shared<IioClosing>(unclosed_.back());
        if (!lane().submit(closing)) return;
        closing_ = std::move(closing);
        unclosed_.pop_back();
      }
    } catch (...) {  // no memory: later, or by the destructor
    }
  }

  void on_ready(bool hung_up) {
    Call call(*this);
    if (at_ < end_) return;  // some scans of the last read are not published yet
    const auto got = capture_->read(bytes_);
    if (!got) return lose(got.error(), loop()->now());
    if (*got == 0) {
      if (hung_up)
        lose({Errc::disconnected, "lost the IIO device", config_.device, "the device is gone", ""}, loop()->now());
      return;
    }
    const std::size_t size = capture_->layout().size();
    if (*got % size != 0) {
      ++origin_.counts.received;
      ++origin_.counts.unreadable;
      return lose({Errc::bad_data, "lost the IIO device", config_.device,
                   std::to_string(*got) + " bytes are not whole scans of " + std::to_string(size), ""},
                  loop()->now());
    }
    heard();
    at_ = 0;
    end_ = *got;
    is_full_ = *got / size >= config_.length;
    ahead_ = difference(heard_at().time_since_epoch(), loop()->runtime.clock_log.clock().realtime().time_since_epoch());
    take_scans();
  }
  void on_rest() {
    Call call(*this);
    if (capture_ != nullptr) take_scans();
  }
  /// Publishes the scans of one read, as many as allowed at once.
  void take_scans() {
    const IioLayout& layout = capture_->layout();
    const std::size_t size = layout.size();
    const std::size_t end = std::min(end_, at_ + most_at_once * size);
    missing_ = 0;
    bool is_dropped = false, is_odd = false;
    for (; at_ < end; at_ += size) {
      const std::byte* scan = bytes_.data() + at_;
      layout.decode(scan, values_.data());
      MonotonicTime time = time_of(scan, is_odd);
      is_dropped = look_for_hole(time) || is_dropped;
      time = std::max(std::min(time, heard_at()), later(last_published_, Duration{1}));
      last_published_ = time;
      ++origin_.counts.received;
      ++origin_.counts.published;
      origin_.topic.publish(origin_, loop()->runtime.event_time(time), values_.data());
    }
    if (at_ < end_) {
      rest_.start(Duration{0});
    } else {
      was_full_ = is_full_;
    }
    if (missing_ > 0 || is_dropped) return report_missing(is_dropped);
    if (is_odd) return report_odd_time();
    succeed();
  }

  /// By the device's clock if possible, otherwise by the time of the read.
  MonotonicTime time_of(const std::byte* scan, bool& is_odd) noexcept {
    if (capture_->layout().has_timestamp()) {
      const std::int64_t stamp = capture_->layout().timestamp(scan);
      const MonotonicTime time{is_monotonic_ ? Duration{stamp} : difference(ahead_, Duration{stamp})};
      if (has_clock_ && time >= turned_on_ && time <= later(heard_at(), most_ahead)) return time;
      is_odd = true;
      odd_ = has_clock_ ? span_between(heard_at(), time) : Duration{0};
    }
    const auto after = static_cast<std::int64_t>((end_ - at_) / capture_->layout().size()) - 1;
    return later(heard_at(), -multiple(after, interval_));
  }

  /// Whether the buffer was full before this scan, so that some before it may have been dropped.
  bool look_for_hole(MonotonicTime time) noexcept {
    const bool was_full = std::exchange(was_full_, false);
    const MonotonicTime before = std::exchange(last_, time);
    if (before == MonotonicTime{} || !capture_->layout().has_timestamp()) return was_full;
    const Duration apart = span_between(before, time);
    if (interval_ <= Duration{0}) return was_full;
    const Duration most = was_full ? interval_ / 2 * 3 : interval_ / 4 * 7;
    if (apart <= most) return false;
    missing_ += static_cast<std::uint64_t>((apart + interval_ / 2) / interval_ - 1);
    origin_.begin_absence(Gap::Kind::silent, id(Errc::backlog), before);
    origin_.end_absence(time);
    return was_full;
  }
  void report_missing(bool is_dropped) {
    const std::string many = missing_ > 0 ? "about " + std::to_string(missing_) + " by their times"
                                          : std::string("their number is unknown");
    degrade({Errc::backlog, "scans are missing", config_.device,
             is_dropped ? "the buffer was full: " + many : many + ": the trigger or the driver skipped them",
             is_dropped ? "set a larger `length`, or find out what held the loop"
                        : "set a lower rate, or check the bus of the device"});
  }
  void report_odd_time() {
    degrade({Errc::bad_data, "the times of scans are not used", config_.device,
             has_clock_ ? "the device clock and the arrival time of a scan differ by " + to_string(odd_)
                        : "the device uses the clock " + capture_->clock(),
             "the times of the reads are used instead"});
  }

  /// Removing the device may not wake the reader.
  void look() {
    Call call(*this);
    look_.start(look_again);
    if (capture_ != nullptr && span_between(heard_at(), loop()->now()) >= look_again) on_ready(false);
  }

  Error silence_error() const override {
    return {Errc::timed_out, "nothing comes", config_.device, "no scan for " + to_string(config_.silence),
            "check whether its trigger fires; `silence` is how long it may be silent"};
  }
  void on_close() noexcept override {
    StreamNode::on_close();
    rest_.close();
    look_.close();
    for (const auto& capture : unclosed_) capture->abandon();  // the driver of the device hangs
    if (loop()->is_being_set_up()) wait_for_closing();         // the program must not end with an enabled buffer
  }

  const IioBufferConfig config_;
  Timer rest_;  // of scans that were read and not published yet
  Timer look_;
  std::shared_ptr<IioOpening> opening_;
  std::optional<Error>* refusal_ = nullptr;  // while a required sensor starts: receives its error
  MonotonicTime began_{};                    // the attempt to open it
  std::shared_ptr<IioCapture> capture_;
  std::vector<std::shared_ptr<IioCapture>> unclosed_;
  std::shared_ptr<IioClosing> closing_;  // the last one
  FdWatch watch_;
  std::vector<std::byte> bytes_;
  std::size_t at_ = 0, end_ = 0;    // the scans in it that are not published yet
  std::vector<double> values_;      // of one scan: the payload
  Duration interval_{0};            // between two scans; 0: not known
  Duration ahead_{0};               // time of day minus monotonic clock, at the last read
  MonotonicTime turned_on_{};       // no time is earlier
  MonotonicTime last_{};            // of the last scan
  MonotonicTime last_published_{};  // the same, as it was published
  std::uint64_t missing_ = 0;       // estimated number of scans
  bool is_full_ = false;            // the buffer was, at the last read
  bool was_full_ = false;           // the same once all of that read is published: scans after it may be missing
  bool has_clock_ = false;          // a clock that can be converted to ours
  bool is_monotonic_ = false;
  Duration odd_{0};  // how far the last impossible time is from the read
};

}  // namespace detail

ReadTime read_time(const IioBufferConfig&) { return {.on_loop = std::chrono::microseconds{500}}; }

IioBufferSensor::IioBufferSensor(Loop& loop, FeedConfig feed, IioBufferConfig config) {
  detail::check_iio(config.device, config.channels, feed.name);
  const auto refuse = [&](const char* why, const char* advice) {
    throw SetupError({Errc::bad_argument, "cannot use this IIO sensor", "sensor " + feed.name, why, advice});
  };
  if (config.length < 2 || config.length > 65536) refuse("length is not 2 to 65536", "such as 512");
  if (config.watermark < 1 || config.watermark > config.length)
    refuse("watermark is not between 1 and length", "such as 1");
  if (config.retry_first <= Duration{0}) refuse("retry_first is not positive", "such as 100 ms");
  if (config.timeout <= Duration{0}) refuse("its timeout is not positive", "such as 5 s");
  const bool starts = config.start;
  auto* node = new detail::IioBufferNode(loop.core(), feed, std::move(config));
  IioBufferSensor made(node);
  if (starts) node->start();
  *this = std::move(made);
}

}  // namespace rtdata
