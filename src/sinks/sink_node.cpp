#include <algorithm>
#include <cstring>

#include "loop/loop_core.hpp"
#include "loop/runtime_core.hpp"
#include "rtdata/loop/lane.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sinks/sink.hpp"
#include "sinks/sink_queue.hpp"

namespace rtdata {
namespace detail {
namespace {

constexpr std::size_t most_errors = 256;
constexpr Duration no_limit = std::chrono::hours{24 * 365};

/// Stores what is queued, on the lane.
class StoreJob final : public LaneJob {
 public:
  explicit StoreJob(std::shared_ptr<SinkQueue> queue_) : queue(std::move(queue_)) {}
  void run() noexcept override {
    try {
      result = queue->process();
      if (result && closing) result = queue->close_writer();
    } catch (const std::exception& e) {
      result = Error{Errc::io_failed, "the writer threw", "", e.what(), ""};
    }
    refused = queue->take_refusals(refusal);
    warning = queue->writer().take_warning();
  }
  void done(Outcome outcome) override;

  std::shared_ptr<SinkQueue> queue;
  SinkNode* owner = nullptr;  // null once the sink is gone
  bool closing = false;
  Result<void> result;
  std::uint64_t refused = 0;
  Error refusal;
  std::optional<Error> warning;
};

}  // namespace

class SinkNode final : public Node, public Recorder, public RateMember {
 public:
  SinkNode(LoopCore& loop, SinkConfig config, std::unique_ptr<Writer> writer)
      : Node(loop),
        config_(std::move(config)),
        queue_(std::make_shared<SinkQueue>(config_, std::move(writer))),
        job_(std::make_shared<StoreJob>(queue_)),
        lane_(std::make_unique<Lane>(loop, config_.name, no_limit)) {}

  void attach() {
    RuntimeCore& runtime = loop()->runtime;
    for (const std::string& pattern : config_.topics) {
      if (!is_topic_pattern(pattern)) {
        throw SetupError({Errc::bad_name, "cannot attach sink " + config_.name, "\"" + pattern + "\"", "not a topic or pattern",
                          "levels are joined by /, + stands for one level, # at the end for all below"});
      }
      const TopicCore* exact = runtime.find_topic(pattern);
      if (exact != nullptr && exact->type.description == nullptr) {
        throw SetupError({Errc::bad_description, "cannot attach sink " + config_.name, "topic " + pattern,
                          "its payload has no description, so it cannot be recorded", "give its type a `describe`"});
      }
    }
    job_->owner = this;
    for (const auto& topic : runtime.topics()) on_topic(*topic);
    runtime.recorders.push_back(this);
    clock_.push_back({loop()->now(), runtime.clock().realtime(), "start"});
    loop()->schedule().add(*this, config_.batch_time, Duration{0});
    is_attached_ = true;
  }

  // ---- taking events: the hot path

  struct TopicTap final : Tap {
    TopicTap(SinkNode& sink_, TopicCore& topic_, std::uint32_t number_)
        : sink(sink_), topic(topic_), number(number_), record_bytes(sizeof(RecordHeader) + (topic_.type.size + 7) / 8 * 8) {}
    void offer(OriginCore& origin, const EventHeader& header, const void* payload) override {
      Slot& slot = origin.index < slots.size() && slots[origin.index] != nullptr ? *slots[origin.index] : sink.slot_of(*this, origin);
      ++slot.live->offered;
      if (slot.first_sequence == 0) [[unlikely]] slot.first_sequence = header.sequence;
      slot.last_sequence = header.sequence;
      SinkQueue& queue = *sink.queue_;
      std::byte* to = queue.room(slot, record_bytes);
      if (to == nullptr) [[unlikely]] return sink.start_storing();
      const RecordHeader record{slot.accounted.slot, static_cast<std::uint32_t>(record_bytes), to_nanoseconds(header.time), header.sequence};
      std::memcpy(to, &record, sizeof record);
      std::memcpy(to + sizeof record, payload, topic.type.size);
      queue.commit(record_bytes);
      if (queue.rows_since_handover() >= sink.config_.batch_rows) sink.flush_rows();
    }
    SinkNode& sink;
    TopicCore& topic;
    std::uint32_t number;
    std::size_t record_bytes;
    std::vector<Slot*> slots;  // by the origin's index within the topic
  };

  Slot& slot_of(TopicTap& tap, OriginCore& origin) {
    if (tap.slots.size() <= origin.index) tap.slots.resize(std::max<std::size_t>(origin.index + 1, tap.topic.origins().size()));
    Slot*& slot = tap.slots[origin.index];
    if (slot == nullptr) slot = &queue_->add_slot({tap.number, tap.topic.name, origin.name, tap.topic.type.description});
    return *slot;
  }

  void flush_rows() {
    if (queue_->hand_over()) start_storing();
  }

  // ---- Recorder

  void on_topic(TopicCore& topic) override {
    if (topic.type.description == nullptr) return;
    const auto matches = [&](const std::string& pattern) { return topic_matches(pattern, topic.name); };
    if (std::none_of(config_.topics.begin(), config_.topics.end(), matches)) return;
    taps_.push_back(std::make_unique<TopicTap>(*this, topic, static_cast<std::uint32_t>(taps_.size())));
    topic.add_tap(*taps_.back());
  }

  void on_gap(OriginCore& origin, const Gap& gap) override {
    Slot* slot = find_slot(origin);
    if (slot == nullptr) return;
    const std::uint32_t index = slot->accounted.slot;
    if (gaps_.size() >= std::max<std::size_t>(4096, 2 * queue_->slot_count())) {  // storage stalls: gaps of one origin become one
      for (auto entry = gaps_.rbegin(); entry != gaps_.rend(); ++entry) {
        if (entry->slot != index || entry->gap.kind != gap.kind) continue;
        entry->gap.last = gap.last;
        entry->gap.count += gap.count;
        if (entry->gap.reason != gap.reason) entry->gap.reason = "several";
        return;
      }
    }
    gaps_.push_back({index, gap});
  }

  void on_segment(OriginCore& origin, const Segment& segment) override {
    if (Slot* slot = find_slot(origin)) segments_.push_back({slot->accounted.slot, segment});
  }

  void on_clock(const ClockPair& pair) override { clock_.push_back(pair); }

  void on_error(Time time, std::string_view object, const Error& error, std::uint64_t count) override {
    for (auto& entry : errors_) {
      if (errors_.size() < most_errors) break;
      if (entry.object == object && entry.id == error.id()) {
        entry.count += count;
        return;
      }
    }
    if (errors_.size() < 2 * most_errors) errors_.push_back({time, std::string(object), std::string(error.id()), error.text(), count});
  }

  SinkStatus status() const override { return {config_.name, health_, reason_, queue_->counts()}; }

  void drain(MonotonicTime deadline, Callback<void(std::uint64_t)> done) override {
    if (!is_open()) return done(0);
    drained_ = std::move(done);
    begin_closing();
    if (closed_) return finish_drain();
    deadline_ = Timer(loop()->face, [this] { finish_drain(); });
    deadline_.start_at(deadline);
  }

  // ---- batches by time

  void tick(const Tick&) override {
    loop()->runtime.look_at_clock();
    loop()->runtime.flush_repeats(detail::RuntimeCore::Repeats::old);
    const bool has_rows = queue_->hand_over();
    const bool has_account = account(false);
    if (has_rows || has_account) start_storing();
  }
  std::string blame_name() const override { return object_name(); }

  void stored(StoreJob& job) {
    if (job.refused != 0) {
      Error error = job.refusal;
      report(error, job.refused);
    }
    if (job.warning) report(*job.warning, 1);
    if (!job.result) {
      failed(job.result.error());
      return;
    }
    if (health_ != Health::ok) {
      health_ = Health::ok;
      reason_.clear();
      loop()->runtime.log(LogLevel::info, object_name(), "ok again");
    }
    retry_delay_ = Duration{0};
    if (job.closing) {
      closed_ = true;
      if (drained_) finish_drain();
    } else if (closing_ || !queue_->is_idle()) {
      start_storing();
    }
  }

  void job_done(LaneJob::Outcome outcome) {
    is_storing_ = false;
    if (outcome == LaneJob::Outcome::finished) stored(*job_);
  }

  void flush() {
    queue_->hand_over();
    account(false);
    start_storing();
  }

  Callback<void(const ErrorReport&)> on_error_;
  const SinkCounts counts() const noexcept { return queue_->counts(); }
  Health health() const noexcept { return health_; }

 private:
  ~SinkNode() override = default;
  std::string object_name() const { return "sink " + config_.name; }

  Slot* find_slot(OriginCore& origin) {
    for (const auto& tap : taps_) {
      if (&tap->topic == &origin.topic) return &slot_of(*tap, origin);
    }
    return nullptr;
  }

  void start_storing() {
    if (is_storing_ || retry_.is_running()) return;
    job_->closing = closing_;
    is_storing_ = lane_->submit(job_);
  }

  void report(const Error& error, std::uint64_t count) noexcept {
    const std::string object = object_name();
    if (on_error_) {
      Call call(*this);
      loop()->call_user(object, [&] { on_error_({object, error, count}); });
    } else {
      loop()->runtime.report(loop(), object, error);
    }
  }

  void failed(const Error& error) {
    retry_delay_ = retry_delay_.count() == 0 ? config_.retry_first : std::min(2 * retry_delay_, config_.retry_longest);
    health_ = Health::faulted;
    reason_ = error.text();
    report(error, 1);
    if (!is_open()) return;
    if (!retry_.is_open()) retry_ = Timer(loop()->face, [this] { start_storing(); });
    retry_.start(retry_delay_);
  }

  /// Fills an account with what changed since the last one. False when there is nothing, or no place for it now.
  bool account(bool is_last) {
    Account* account = queue_->free_account();
    if (account == nullptr) return false;
    RuntimeCore& runtime = loop()->runtime;
    const MonotonicTime until = loop()->handled_until();
    account->at = runtime.event_time(loop()->now());
    account->is_last = is_last;
    account->origins.clear();
    for (const auto& tap : taps_) {
      for (OriginCore* origin : tap->topic.origins()) {
        if (is_last) origin->close_gap();
        Slot& slot = slot_of(*tap, *origin);
        OriginAccount now{slot.accounted.slot, origin->counts, slot.live->offered, slot.dropped_newest, slot.dropped_oldest,
                          slot.first_sequence, slot.last_sequence, {}};
        if (origin->has_segment()) now.segment = origin->segment(until);
        if (!is_last && now.offered == slot.accounted.offered && now.sensor.scheduled == slot.accounted.sensor.scheduled &&
            now.sensor.received == slot.accounted.sensor.received && now.segment.period == slot.accounted.segment.period &&
            now.sensor.in_flight == slot.accounted.sensor.in_flight) {
          continue;
        }
        slot.accounted = now;
        account->origins.push_back(now);
      }
    }
    account->gaps.swap(gaps_);
    account->segments.swap(segments_);
    account->errors.swap(errors_);
    account->clock.swap(clock_);
    gaps_.clear();
    segments_.clear();
    errors_.clear();
    clock_.clear();
    if (account->is_empty()) return false;
    queue_->hand_over_account();
    return true;
  }

  void begin_closing() {
    if (closing_) return;
    for (const auto& tap : taps_) tap->topic.remove_tap(*tap);
    loop()->runtime.flush_repeats(detail::RuntimeCore::Repeats::all);
    loop()->runtime.look_at_clock("end");
    if (is_scheduled()) loop()->schedule().remove(*this);
    queue_->hand_over();
    while (!account(true)) {  // all four are on their way to storage that stalls: the lane frees them, or never
      if (loop()->now() > closing_began_ + config_.close_deadline) break;
      if (closing_began_ == MonotonicTime{}) closing_began_ = loop()->now();
      wait_for_lane();
    }
    closing_ = true;
    if (!is_storing_) retry_.stop();
    start_storing();
  }

  /// Blocks until the lane has done something, or a while has passed. Only at the end.
  void wait_for_lane() {
    struct timespec pause{0, 1'000'000};
    ::nanosleep(&pause, nullptr);
    lane_->collect();
  }

  void finish_drain() {
    if (!drained_) return;
    auto done = std::move(drained_);
    drained_ = nullptr;
    deadline_.close();
    const std::uint64_t lost = leave();
    done(lost);
  }

  /// Takes the sink off the runtime, counting what was not stored as refused.
  std::uint64_t leave() {
    if (!is_attached_) return 0;
    is_attached_ = false;
    RuntimeCore& runtime = loop()->runtime;
    std::erase(runtime.recorders, static_cast<Recorder*>(this));
    SinkStatus last = status();
    const std::uint64_t lost = last.counts.queued;
    last.counts.dropped[static_cast<std::size_t>(DropReason::refused)] += lost;
    last.counts.queued = 0;
    if (lost > 0) {
      runtime.report(loop(), object_name(),
                     {Errc::timed_out, "lost " + std::to_string(lost) + " events", config_.name,
                      "they could not be stored before the deadline" + (reason_.empty() ? "" : " (" + reason_ + ")"),
                      "look at the storage; the next start seals the recording"});
    }
    runtime.closed_sinks.push_back(std::move(last));
    return lost;
  }

  void on_close() noexcept override {
    if (is_attached_) {
      begin_closing();
      // The lane needs the loop's thread to tell of its end only: waiting here runs no callback of the user's.
      const MonotonicTime end = loop()->now() + config_.close_deadline;
      while (!closed_ && loop()->now() < end) {
        if (!is_storing_ && !retry_.is_running()) start_storing();
        if (retry_.is_running() && loop()->now() + retry_delay_ < end) {
          retry_.stop();
          start_storing();
        }
        if (!closed_) wait_for_lane();
        if (loop()->is_manual()) break;
      }
      leave();
    }
    if (is_scheduled()) loop()->schedule().remove(*this);
    job_->owner = nullptr;
    if (is_storing_) lane_->give_up();
    lane_ = nullptr;
    retry_.close();
    deadline_.close();
    if (drained_) {
      auto done = std::move(drained_);
      done(0);
    }
  }
  void drop_callbacks() noexcept override { on_error_.reset(); }

  SinkConfig config_;
  std::shared_ptr<SinkQueue> queue_;
  std::shared_ptr<StoreJob> job_;
  std::unique_ptr<Lane> lane_;
  std::vector<std::unique_ptr<TopicTap>> taps_;
  std::vector<Account::GapEntry> gaps_;
  std::vector<Account::SegmentEntry> segments_;
  std::vector<Account::ErrorEntry> errors_;
  std::vector<ClockPair> clock_;
  Timer retry_;
  Timer deadline_;
  Duration retry_delay_{0};
  MonotonicTime closing_began_{};
  Callback<void(std::uint64_t)> drained_;
  Health health_ = Health::ok;
  std::string reason_;
  bool is_attached_ = false;
  bool is_storing_ = false;
  bool closing_ = false;
  bool closed_ = false;
};

namespace {

void StoreJob::done(Outcome outcome) {
  if (owner != nullptr) owner->job_done(outcome);
}

SinkNode* sink(Node* node) noexcept { return node != nullptr && node->is_open() ? static_cast<SinkNode*>(node) : nullptr; }

Node* make_sink(Loop& loop, SinkConfig config, std::unique_ptr<Writer> writer) {
  if (config.batch_rows == 0 || config.batch_time < std::chrono::milliseconds{1}) {
    throw SetupError({Errc::bad_argument, "cannot make sink", config.name, "a batch has at least one row and 1 ms", "leave the defaults"});
  }
  auto* node = new SinkNode(loop.core(), std::move(config), std::move(writer));
  try {
    node->attach();
  } catch (...) {
    node->close();
    node->release();
    throw;
  }
  return node;
}

}  // namespace
}  // namespace detail

Sink::Sink(Loop& loop, SinkConfig config, std::unique_ptr<Writer> writer)
    : Handle(detail::make_sink(loop, std::move(config), std::move(writer))) {}
SinkCounts Sink::counts() const noexcept {
  const auto* s = detail::sink(node());
  return s != nullptr ? s->counts() : SinkCounts{};
}
Health Sink::health() const noexcept {
  const auto* s = detail::sink(node());
  return s != nullptr ? s->health() : Health::ok;
}
SinkStatus Sink::status() const {
  const auto* s = detail::sink(node());
  return s != nullptr ? s->status() : SinkStatus{};
}
void Sink::on_error(Callback<void(const ErrorReport&)> handler) {
  if (auto* s = detail::sink(node())) s->on_error_ = std::move(handler);
}
void Sink::flush() {
  if (auto* s = detail::sink(node())) s->flush();
}

}  // namespace rtdata
