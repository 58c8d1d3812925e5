#include <algorithm>
#include <cstring>
#include <exception>
#include <optional>
#include <unordered_map>

#include "loop/deadline.hpp"
#include "loop/loop_core.hpp"
#include "loop/retry.hpp"
#include "loop/runtime_core.hpp"
#include "rtdata/loop/lane.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sinks/sink.hpp"
#include "sinks/sink_notes.hpp"
#include "sinks/sink_queue.hpp"

namespace rtdata {
namespace detail {
namespace {

// Accounts of many origins are made in parts, so that none holds the loop for long.
constexpr std::size_t origins_at_once = 500;
constexpr Duration pause_between_parts = std::chrono::milliseconds{1};

constexpr Duration no_limit = std::chrono::hours{24 * 365};

/// Stores what is queued, on the lane.
class StoreJob final : public LaneJob {
 public:
  explicit StoreJob(std::shared_ptr<SinkQueue> queue_) : queue(std::move(queue_)) {}
  void run() noexcept override {
    if (pause.count() > 0) queue->pause(std::exchange(pause, Duration{0}));
    result = queue->process();
    if (result && closing) result = queue->close_writer();
    has_ended = queue->has_ended();
    refused = queue->take_refusals(refusal);
    try {
      warning = queue->writer().take_warning();
    } catch (...) {  // a warning less
    }
  }
  void done(Outcome outcome) override;

  std::shared_ptr<SinkQueue> queue;
  SinkNode* owner = nullptr;  // null once the sink is gone
  bool closing = false;
  Duration pause{0};  // before the work
  bool has_ended = false;
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
        RateMember(config.batch_time, Duration{0}),
        config_(std::move(config)),
        queue_(std::make_shared<SinkQueue>(config_, std::move(writer))),
        job_(std::make_shared<StoreJob>(queue_)),
        lane_(std::make_unique<Lane>(loop, config_.name, no_limit)),
        retry_(loop.face, [this] { start_storing(); }),
        next_part_(loop.face, [this] { account_more(); }) {}

  void attach() {
    RuntimeCore& runtime = loop()->runtime;
    for (const std::string& pattern : config_.topics) {
      if (!is_topic_pattern(pattern)) {
        throw SetupError({Errc::bad_name, "cannot attach sink " + config_.name, "\"" + pattern + "\"",
                          "not a topic or pattern",
                          "levels are joined by /, + stands for one level, # at the end for all below"});
      }
      const TopicCore* exact = runtime.find_topic(pattern);
      if (exact != nullptr && exact->type.description == nullptr) {
        throw SetupError({Errc::bad_description, "cannot attach sink " + config_.name, "topic " + pattern,
                          "its payload has no description, so it cannot be recorded", "give its type a `describe`"});
      }
    }
    job_->owner = this;
    for (const auto& topic : runtime.topics()) {
      if (auto taken = take_topic(*topic); !taken) throw SetupError(std::move(taken).error());
    }
    runtime.attach(*this);
    for (const ClockPair& pair : runtime.clock_pairs()) notes_.add(pair);
    loop()->schedule().add(*this);
    is_attached_ = true;
  }

  // ---- taking events: the hot path

  struct TopicTap final : Tap {
    TopicTap(SinkNode& sink_, TopicCore& topic_, std::uint32_t number_)
        : sink(sink_),
          topic(topic_),
          number(number_),
          payload_bytes(static_cast<std::uint32_t>(topic_.type.size)),
          record_bytes(record_bytes_of(topic_.type.size)) {}
    /// What is touched for each event of an origin.
    struct Place {
      LiveCounts* live = nullptr;  // null: it has no slot yet
      SlotStored* stored = nullptr;
      std::uint64_t first_sequence = 0;
      std::uint64_t last_sequence = 0;
      std::uint32_t slot = 0;
    };
    void offer(OriginCore& origin, Time time, std::uint64_t sequence, const void* payload) override {
      Place& place = place_of(origin);
      ++place.live->offered;
      if (place.first_sequence == 0) [[unlikely]]
        place.first_sequence = sequence;
      place.last_sequence = sequence;
      SinkQueue& queue = *sink.queue_;
      std::byte* to = queue.room(place.slot, record_bytes);
      if (to == nullptr) [[unlikely]]
        return sink.start_storing();
      const RecordHeader record{place.stored, to_nanoseconds(time), sequence};
      std::memcpy(to, &record, sizeof record);
      std::memcpy(to + sizeof record, payload, payload_bytes);
      queue.commit(record_bytes);
      if (queue.is_batch_due()) sink.flush_rows();
    }
    void miss(OriginCore& origin, std::uint64_t count, std::uint64_t last_sequence) override {
      Place& place = place_of(origin);
      place.live->offered += count;
      sink.queue_->slot(place.slot).dropped_newest += count;
      // Told late, when another tier has gone on with the name, they are before what it published.
      if (place.first_sequence == 0 || last_sequence < place.first_sequence)
        place.first_sequence = last_sequence - count + 1;
      place.last_sequence = std::max(place.last_sequence, last_sequence);
    }
    Place& place_of(OriginCore& origin) {
      if (origin.index >= places.size() || places[origin.index].live == nullptr) [[unlikely]]
        make_place(origin);
      return places[origin.index];
    }
    void make_place(OriginCore& origin) {
      const std::uint32_t slot = sink.queue_->add_slot({number, origin.name, topic.name, topic.type.description});
      if (places.size() <= origin.index) {
        const auto count = std::max<std::size_t>(origin.index + 1, topic.origins().size());
        places.resize(count);
        accounted.resize(count);
      }
      places[origin.index] = {sink.queue_->slot(slot).live, &sink.queue_->stored(slot), 0, 0, slot};
    }
    SinkNode& sink;
    TopicCore& topic;
    const std::uint32_t number;
    const std::uint32_t payload_bytes;
    const std::size_t record_bytes;
    std::vector<Place> places;             // by the origin's index within the topic, as the next
    std::vector<OriginAccount> accounted;  // as last handed over
  };

  void flush_rows() {
    if (is_busy()) {  // the chunk goes on filling
      is_due_ = true;
    } else if (queue_->hand_over()) {
      start_storing();
    }
  }

  // ---- Recorder

  Result<void> on_topic(TopicCore& topic) override {
    if (closing_) return {};
    const auto threw = [&](const char* what) {
      return Error{Errc::handler_threw, "the writer threw", "topic " + topic.name, what, "this topic is not recorded"};
    };
    try {
      return take_topic(topic);
    } catch (const std::exception& e) {
      return threw(e.what());
    } catch (...) {
      return threw("an exception that is no std::exception");
    }
  }
  void on_refusal(const Error& error) override { report(error, 1); }

  Result<void> take_topic(TopicCore& topic) {
    const auto matches = [&](const std::string& pattern) { return topic_matches(pattern, topic.name); };
    if (std::none_of(config_.topics.begin(), config_.topics.end(), matches)) return {};
    if (topic.type.description == nullptr) {
      if (std::find(config_.topics.begin(), config_.topics.end(), topic.name) == config_.topics.end()) return {};
      return Error{Errc::bad_description, "cannot record", "topic " + topic.name, "its payload has no description",
                   "give its type a `describe`"};
    }
    const auto number = static_cast<std::uint32_t>(taps_.size());
    if (auto taken = queue_->writer().add_topic(number, topic.name, *topic.type.description); !taken) return taken;
    taps_.push_back(std::make_unique<TopicTap>(*this, topic, number));
    tap_of_[&topic] = taps_.back().get();
    topic.add_tap(*taps_.back());
    return {};
  }

  void on_gap(OriginCore& origin, const Gap& gap) override {
    const TopicTap::Place* place = find_place(origin);
    if (place == nullptr) return;
    notes_.add(place->slot, gap, queue_->slot_count());
  }

  void on_segment(OriginCore& origin, const Segment& segment) override {
    if (const TopicTap::Place* place = find_place(origin)) notes_.add(place->slot, segment);
  }

  void on_clock(const ClockPair& pair) override { notes_.add(pair); }

  void on_error(Time time, std::string_view object, const Error& error, std::uint64_t count) override {
    notes_.add(time, object, error, count);
  }

  void on_health(Time time, const HealthChange& change) override { notes_.add(time, change); }

  SinkStatus status() const override {
    if (last_) return *last_;
    return {config_.name, health_, reason_, queue_->counts(), queue_->dropped_by_topic(SinkQueue::Queued::waits)};
  }

  void drain(MonotonicTime deadline, Callback<void(std::uint64_t)> done) override {
    if (!is_open() || !is_attached_) return done(0);
    drained_.push_back(std::move(done));
    if (drained_.size() > 1) return;
    Call call(*this);
    deadline_ = Timer(loop()->face, [this] { finish_drain(); });
    deadline_.start_at(deadline);
    begin_closing();
  }

  // ---- batches by time

  void tick(const Tick&) override {
    Call call(*this);
    RuntimeCore& runtime = loop()->runtime;
    runtime.look_at_clock();  // may log, as the next may, and a user's handler may close this sink
    runtime.flush_repeats(RuntimeCore::Repeats::old);
    if (is_open()) flush();
  }
  std::string blame_name() const override { return object_name(); }
  bool tell_times(CallbackStatus& status) const override {
    status.name = object_name();
    status.times = times;
    return true;
  }

  void stored(StoreJob& job) {
    if (!is_attached_) return;  // too late: counted as lost
    if (job.refused != 0 && !job.has_ended) {
      Error error = job.refusal;
      if (job.refused > 1) error.where += " (the first of " + std::to_string(job.refused) + ")";
      report(error, job.refused);
      if (!is_open()) return;
    }
    if (job.warning) {
      report(*job.warning, 1);
      if (!is_open()) return;
    }
    if (!job.result) {
      failed(job.result.error());
      if (!is_open() || !job.has_ended) return;
    } else if (job.has_ended) {
      // stays faulted
    } else if (health_ != Health::ok) {
      health_ = Health::ok;
      reason_.clear();
      loop()->runtime.log(LogLevel::info, object_name(), "ok again");
    }
    retry_delay_ = Duration{0};
    if (job.closing && (job.result || job.has_ended)) {
      closed_ = true;
      finish_drain();
    } else if (closing_) {
      start_storing();
    } else if (is_due_ || is_account_due_ || !queue_->is_idle()) {
      is_due_ = false;
      queue_->hand_over();
      if (is_account_due_) begin_account();
      start_storing();
    }
  }

  void job_done(LaneJob::Outcome outcome) {
    Call call(*this);
    is_storing_ = false;
    if (outcome == LaneJob::Outcome::finished) stored(*job_);
    if (is_open() &&
        health_ != told_health_) {  // when nothing here is under way, since this sink may take the event itself
      told_health_ = health_;
      loop()->runtime.health_changed("sink", config_.name, health_, reason_);
    }
  }

  void flush() {
    if (closing_) return;
    bool has_rows = false;
    if (is_busy()) {  // the chunk goes on filling
      is_due_ = true;
    } else {
      has_rows = queue_->hand_over();
    }
    if (retry_.is_running()) {
      is_account_due_ = true;
    } else if (begin_account() || has_rows) {
      start_storing();
    }
  }

  Handler<ErrorReport> on_error_;
  SinkCounts counts() const noexcept { return last_ ? last_->counts : queue_->counts(); }
  Health health() const noexcept { return health_; }

 private:
  ~SinkNode() override = default;
  std::string object_name() const { return "sink " + config_.name; }

  const TopicTap::Place* find_place(OriginCore& origin) {
    const auto tap = tap_of_.find(&origin.topic);
    return tap != tap_of_.end() ? &tap->second->place_of(origin) : nullptr;
  }

  bool is_busy() const noexcept { return is_storing_ || retry_.is_running(); }

  void start_storing() {
    if (is_busy() || closed_ || !is_attached_) return;
    if (closing_ && !has_last_account_)
      has_last_account_ = account(all_and_last);  // else all are with the lane, which frees them first
    job_->closing = has_last_account_;
    is_storing_ = lane_->submit(job_);
    if (!is_storing_) retry_.start(next_delay());  // the system gives no thread
  }

  Duration next_delay() noexcept {
    retry_delay_ = retry_delay_.count() == 0 ? config_.retry_first : std::min(2 * retry_delay_, config_.retry_longest);
    return with_jitter(retry_delay_, config_.name, ++failures_);
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
    health_ = Health::faulted;
    reason_ = error.text();
    if (!job_->has_ended && is_attached_) retry_.start(next_delay());
    report(error, 1);
  }

  /// Hands over the account of what changed since the last one, or its first part; the others follow. False: nothing
  /// was handed over.
  bool begin_account() {
    if (next_part_.is_running()) return false;  // the one before is under way
    is_account_due_ = queue_->free_account() == nullptr;
    if (is_account_due_) return false;
    return account(first_part);
  }

  void account_more() {
    if (closing_ || !is_attached_) return;
    if (retry_.is_running() || queue_->free_account() == nullptr) {
      next_part_.start(pause_between_parts);
    } else if (account(next_part)) {
      start_storing();
    }
  }

  enum Part { first_part, next_part, all_and_last };
  /// There is a free account. False when there is nothing to tell.
  bool account(Part part) {
    Account* account = queue_->free_account();
    if (account == nullptr) return false;
    const bool is_last = part == all_and_last;
    RuntimeCore& runtime = loop()->runtime;
    const MonotonicTime until = loop()->handled_until();
    account->at = runtime.event_time(loop()->now());
    account->is_last = is_last;
    account->unknown = is_last ? runtime.unknown_end : "";
    account->origins.clear();
    if (part != next_part) account_topic_ = account_origin_ = 0;
    std::size_t looked_at = 0;
    for (; account_topic_ < taps_.size(); ++account_topic_, account_origin_ = 0) {
      TopicTap& tap = *taps_[account_topic_];
      for (const auto& origins = tap.topic.origins(); account_origin_ < origins.size(); ++account_origin_) {
        if (!is_last && looked_at++ == origins_at_once) {
          next_part_.start(pause_between_parts);
          return hand_over(*account);
        }
        OriginCore& origin = *origins[account_origin_];
        if (is_last) origin.close_gap();
        const TopicTap::Place& place = tap.place_of(origin);
        const Slot& slot = queue_->slot(place.slot);
        OriginAccount now{place.slot,          origin.counts,        slot.live->offered,  slot.dropped_newest,
                          slot.dropped_oldest, place.first_sequence, place.last_sequence, {}};
        if (origin.has_segment()) now.segment = origin.segment(until);
        OriginAccount& before = tap.accounted[origin.index];
        if (!is_last && now.offered == before.offered && now.dropped_oldest == before.dropped_oldest &&
            now.sensor.lost == before.sensor.lost && now.sensor.scheduled == before.sensor.scheduled &&
            now.sensor.received == before.sensor.received && now.segment.period == before.segment.period &&
            now.sensor.in_flight == before.sensor.in_flight) {
          continue;
        }
        before = now;
        account->origins.push_back(now);
      }
    }
    return hand_over(*account);
  }

  bool hand_over(Account& account) {
    notes_.move_into(account);
    if (account.is_empty()) return false;
    queue_->hand_over_account();
    return true;
  }

  /// Takes no event from here on, and hands over what is left.
  void begin_closing() {
    if (closing_) return;
    closing_ = true;
    remove_taps();
    RuntimeCore& runtime = loop()->runtime;
    runtime.flush_repeats(RuntimeCore::Repeats::all);  // a user's handler may close this sink: then that does the rest
    if (!is_attached_) return;
    if (!notes_.has_end()) notes_.add(runtime.read_clock("end"));
    if (is_scheduled()) loop()->schedule().remove(*this);
    next_part_.stop();
    queue_->hand_over();
    queue_->keep_own_counts();
    if (retry_.is_running()) {  // one try at once, then the delays begin anew
      retry_.stop();
      retry_delay_ = Duration{0};
    }
    start_storing();
  }

  void remove_taps() noexcept {
    for (const auto& tap : taps_) tap->topic.remove_tap(*tap);
  }

  void finish_drain() {
    if (drained_.empty()) return;
    Call call(*this);
    auto done = std::move(drained_);
    drained_.clear();
    deadline_.close();
    const std::uint64_t lost = leave();
    for (auto& tell : done) tell(lost);
  }

  /// Takes the sink off the runtime, counting what was not stored as refused.
  std::uint64_t leave() {
    if (!is_attached_) return 0;
    is_attached_ = false;
    retry_.stop();
    queue_->abandon();
    RuntimeCore& runtime = loop()->runtime;
    runtime.detach(*this);
    last_ = status();
    const std::uint64_t lost = std::exchange(last_->counts.queued, 0);
    last_->counts.dropped[static_cast<std::size_t>(DropReason::refused)] += lost;
    last_->dropped = queue_->dropped_by_topic(SinkQueue::Queued::lost);
    runtime.closed_sinks.push_back(*last_);
    if (lost > 0) {
      runtime.report(loop(), object_name(),
                     {Errc::timed_out, "lost " + std::to_string(lost) + " events", config_.name,
                      "they could not be stored before the deadline" + (reason_.empty() ? "" : " (" + reason_ + ")"),
                      "look at the storage; the next start seals the recording"});
    }
    return lost;
  }

  void on_close() noexcept override {
    std::uint64_t lost = 0;
    if (is_attached_) {
      const MonotonicTime end = later(loop()->now(), config_.close_deadline);
      begin_closing();
      while (is_attached_ && !closed_ && loop()->now() < end) {
        if (!is_storing_) {
          const bool is_retry = retry_.is_running();
          retry_.stop();
          if (is_retry) pause_before_storing(std::min(retry_delay_, end - loop()->now()));
          start_storing();
          if (!is_storing_) break;  // the system gives no thread
        }
        lane_->wait(end - loop()->now());
      }
      lost = leave();
    }
    remove_taps();
    if (is_scheduled()) loop()->schedule().remove(*this);
    job_->owner = nullptr;
    if (is_storing_) lane_->leave_behind();
    lane_ = nullptr;
    retry_.close();
    next_part_.close();
    deadline_.close();
    auto done = std::move(drained_);
    drained_.clear();
    for (auto& tell : done) tell(lost);
  }

  /// The lane waits, so that the deadline ends that too.
  void pause_before_storing(Duration duration) {
    if (loop()->is_manual()) {
      loop()->manual_clock()->pass(duration);
    } else {
      job_->pause = duration;
    }
  }
  void drop_callbacks() noexcept override { on_error_.reset(); }

  SinkConfig config_;
  std::shared_ptr<SinkQueue> queue_;
  std::shared_ptr<StoreJob> job_;
  std::unique_ptr<Lane> lane_;
  std::vector<std::unique_ptr<TopicTap>> taps_;
  std::unordered_map<const TopicCore*, TopicTap*> tap_of_;
  SinkNotes notes_;
  Timer retry_;
  Timer next_part_;  // of an account
  Timer deadline_;
  Duration retry_delay_{0};
  std::uint64_t failures_ = 0;
  std::vector<Callback<void(std::uint64_t)>> drained_;  // who waits for the end
  std::optional<SinkStatus> last_;                      // once it has left the runtime
  Health health_ = Health::ok;
  Health told_health_ = Health::ok;  // as published
  std::string reason_;
  bool is_attached_ = false;
  bool is_storing_ = false;
  bool is_due_ = false;  // to be handed over as soon as the lane is free
  bool is_account_due_ = false;
  std::size_t account_topic_ = 0;  // where its next part begins
  std::size_t account_origin_ = 0;
  bool closing_ = false;
  bool has_last_account_ = false;
  bool closed_ = false;
};

namespace {

void StoreJob::done(Outcome outcome) {
  if (owner != nullptr) owner->job_done(outcome);
}

SinkNode* sink(Node* node) noexcept {
  return node != nullptr && node->is_open() ? static_cast<SinkNode*>(node) : nullptr;
}

Node* make_sink(Loop& loop, SinkConfig config, std::unique_ptr<Writer> writer) {
  if (config.batch_rows == 0 || config.batch_time < std::chrono::milliseconds{1}) {
    throw SetupError({Errc::bad_argument, "cannot make sink", config.name, "a batch has at least one row and 1 ms",
                      "leave the defaults"});
  }
  if (loop.core().runtime.hub != nullptr) {
    throw SetupError({Errc::bad_argument, "cannot make sink", config.name,
                      "loop " + loop.config().name + " is a tier's",
                      "make it on the main loop, whose sinks record every tier"});
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
  if (auto* s = detail::sink(node())) s->on_error_.set(std::move(handler));
}
void Sink::flush() {
  if (auto* s = detail::sink(node())) s->flush();
}

}  // namespace rtdata
