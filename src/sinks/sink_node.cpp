#include <algorithm>
#include <exception>
#include <optional>

#include "loop/deadline.hpp"
#include "loop/loop_core.hpp"
#include "loop/no_thread.hpp"
#include "loop/retry.hpp"
#include "loop/runtime_core.hpp"
#include "rtdata/loop/lane.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sinks/sink.hpp"
#include "sinks/sink_account.hpp"
#include "sinks/sink_queue.hpp"
#include "sinks/store_job.hpp"

namespace rtdata {
namespace detail {
namespace {

constexpr Duration pause_between_parts = std::chrono::milliseconds{1};

constexpr Duration early_after = std::chrono::milliseconds{10};

constexpr Duration no_limit = std::chrono::hours{24 * 365};

}  // namespace

class SinkNode final : public Node, public Recorder, public RateMember, public SinkTap::Owner {
 public:
  SinkNode(LoopCore& loop, SinkConfig config, std::unique_ptr<Writer> writer)
      : Node(loop),
        RateMember(config.batch_time, Duration{0}),
        config_(std::move(config)),
        queue_(std::make_shared<SinkQueue>(config_, std::move(writer))),
        account_(queue_),
        job_(std::make_shared<StoreJob>(queue_)),
        lane_(std::make_unique<Lane>(loop, config_.name, no_limit)),
        retry_(loop.face, [this] { try_again(); }),
        next_part_(loop.face, [this] { account_more(); }),
        early_(loop.face, [this] { tell_early(); }),
        deadline_(loop.face, [this] { finish_drain(); }) {
    drained_.reserve(1);
  }

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
    // What tiers published before is not this recording's. One that does not answer is not waited for.
    const Exchange::Interest until_all_is_attached(runtime, config_.topics);
    const std::string unknown = runtime.exchange.catch_up(std::chrono::seconds{1});
    if (!unknown.empty()) unknown_ = "it began although " + unknown;
    for (const auto& topic : runtime.topics()) {
      if (auto taken = take_topic(*topic); !taken) throw SetupError(std::move(taken).error());
    }
    runtime.attach(*this);
    for (const ClockPair& pair : runtime.clock_log.pairs()) account_.notes.add(pair);
    loop()->schedule().add(*this);
    is_attached_ = true;
    if (!unknown.empty()) runtime.log(LogLevel::warning, object_name(), "begins although " + unknown);
  }

  // ---- Recorder

  Result<void> on_topic(TopicCore& topic) override {
    if (closing_) return {};
    const auto threw = [&](const char* what) {
      return Error{Errc::handler_threw, "the writer threw", "topic " + topic.name, what, "this topic is not recorded"};
    };
    Result<void> taken;
    try {
      taken = take_topic(topic);
    } catch (const std::exception& e) {
      taken = threw(e.what());
    } catch (...) {
      taken = threw("an exception that is no std::exception");
    }
    if (!taken) {
      account_.refuse_topic(topic, *this);
      fault_for_good(taken.error().text());
    }
    return taken;
  }
  void on_refusal(const Error& error) override {
    Call call(*this);
    report(error, 1);
    tell_health();
  }

  Result<void> take_topic(TopicCore& topic) {
    const auto matches = [&](const std::string& pattern) { return topic_matches(pattern, topic.name); };
    if (std::none_of(config_.topics.begin(), config_.topics.end(), matches)) return {};
    if (topic.type.description == nullptr) {
      if (std::find(config_.topics.begin(), config_.topics.end(), topic.name) == config_.topics.end()) return {};
      return Error{Errc::bad_description, "cannot record", "topic " + topic.name, "its payload has no description",
                   "give its type a `describe`"};
    }
    return account_.add_topic(topic, *this);
  }

  void on_gap(OriginCore& origin, const Gap& gap) override {
    note([&] { account_.add(origin, gap); });
  }

  void on_segment(OriginCore& origin, const Segment& segment) override {
    note([&] { account_.add(origin, segment); });
    account_is_due();
  }

  void on_clock(const ClockPair& pair) override {
    note([&] { account_.notes.add(pair); });
  }

  void on_error(Time first, Time last, std::string_view object, const Error& error, std::uint64_t count) override {
    note([&] { account_.notes.add(first, last, object, error, count); });
  }

  void on_health(Time first, Time last, const HealthChange& change, std::uint64_t count) override {
    note([&] { account_.notes.add(first, last, change, count); });
  }

  SinkStatus status() const override {
    if (last_) return *last_;
    return {config_.name, health_, reason_, queue_->counts(), queue_->dropped_by_topic(SinkQueue::Queued::waits)};
  }

  void drain(MonotonicTime deadline, Callback<void(std::uint64_t)> done) override {
    if (!is_open() || !is_attached_) return done(0);
    drained_.push_back(std::move(done));
    if (drained_.size() > 1) return;
    Call call(*this);
    deadline_.start_at(deadline);
    begin_closing(deadline);
  }

  // ---- batches by time

  void tick(const Tick&) override {
    Call call(*this);
    RuntimeCore& runtime = loop()->runtime;
    runtime.clock_log.look();  // may log, as the next may, and a user's handler may close this sink
    runtime.reports.flush(Reports::Repeated::due);
    if (is_open()) hand_over(is_account_worth_it() ? Hand::rows_and_account : Hand::rows);
    if (is_open() && is_sync_due()) start_storing();  // also when nothing more came
  }
  std::string blame_name() const override { return object_name(); }
  bool tell_times(CallbackStatus& status) const override {
    status.name = object_name();
    status.times = times;
    return true;
  }

  /// Takes the state that follows from what was stored, and goes on storing. Calls no code of the user's.
  void go_on_after(const StoreResult& stored) {
    if (!stored.topic_fault.empty()) fault_for_good(stored.topic_fault);
    if (!stored.result) {
      health_ = Health::faulted;
      is_told_ = false;
      note([&] {
        std::string reason = loop()->runtime.hide(stored.result.error().text());
        is_told_ = closing_ && reason == reason_;
        reason_ = std::move(reason);
      });
      if (!stored.has_ended) return retry_.start(next_delay());
    } else if (stored.has_ended) {
      // stays faulted
    } else if (!fault_.empty()) {
      fault_for_good({});
    } else {
      health_ = Health::ok;
      reason_.clear();
    }
    retry_delay_ = Duration{0};
    if (stored.was_syncing || stored.has_ended) unsynced_since_.reset();
    if (stored.has_closed()) {
      closed_ = true;
    } else if (closing_) {
      start_storing();
    } else if (is_due_ || is_account_due_ || !queue_->is_idle()) {
      is_due_ = false;
      queue_->hand_over();
      if (is_account_due_) begin_account();
      start_storing();
    }
  }

  /// Who is told may do anything to this sink, its closing included.
  void tell_of(const StoreResult& stored, Health before) {
    if (const auto error = queue_->take_set_up_error()) report(*error, 1);
    if (!is_open()) return;
    if (stored.refused != 0 && !stored.has_ended) {
      note([&] {
        Error error = stored.refusal;
        if (stored.refused > 1) error.where += " (the first of " + std::to_string(stored.refused) + ")";
        report(error, stored.refused);
      });
    }
    if (is_open() && stored.warning) report(*stored.warning, 1);
    // While it closes, it is tried often: what fails as before is told with what could not be stored, at the end.
    if (is_open() && !stored.result && !is_told_) report(stored.result.error(), 1);
    if (is_open() && stored.result && before != Health::ok && health_ == Health::ok)
      note([&] { loop()->runtime.log(LogLevel::info, object_name(), "ok again"); });
  }

  void job_done(LaneJob::Outcome outcome) {
    Call call(*this);
    is_storing_ = false;
    if (outcome == LaneJob::Outcome::finished && is_attached_) {  // else too late: counted as lost
      const StoreResult stored = std::exchange(job_->came_of_it, {});
      const Health before = health_;
      go_on_after(stored);
      tell_of(stored, before);
      if (is_open() && stored.has_closed()) finish_drain();
    }
    tell_health();  // at the end, since this sink may take the event itself
  }

  void flush() { hand_over(Hand::rows_and_account); }

  enum class Hand { rows, rows_and_account };
  void hand_over(Hand what) {
    if (closing_) return;
    bool has_rows = false;
    if (is_busy()) {  // the chunk goes on filling
      is_due_ = true;
    } else {
      has_rows = queue_->hand_over();
    }
    const bool has_account = what == Hand::rows_and_account;
    if (retry_.is_running()) {
      is_account_due_ = is_account_due_ || has_account;
    } else if ((has_account && begin_account()) || has_rows) {
      start_storing();
    }
  }

  Handler<ErrorReport> on_error_;
  const std::string& name() const noexcept { return config_.name; }
  SinkCounts counts() const noexcept { return last_ ? last_->counts : queue_->counts(); }
  Health health() const noexcept { return health_; }

 private:
  ~SinkNode() override = default;
  std::string object_name() const { return "sink " + config_.name; }

  /// Who tells of it can do nothing about memory that is not there: the account says that it does not know.
  template <class Function>
  void note(Function&& function) noexcept {
    try {
      function();
    } catch (...) {
      had_no_memory_ = true;
    }
  }

  // ---- SinkTap::Owner

  void queue_is_full() override { start_storing(); }
  void batch_is_due() override {
    if (is_busy()) {  // the chunk goes on filling
      is_due_ = true;
    } else if (queue_->hand_over()) {
      start_storing();
    }
  }

  /// Sensors that begin, and schedules that change, are told soon: so that a kill in the first second leaves them too.
  void account_is_due() override {
    if (closing_ || !is_attached_ || early_.is_running() || loop()->now() < next_early_) return;
    next_early_ = later(loop()->now(), config_.batch_time);
    early_.start(early_after);
  }

  void tell_early() {
    if (closing_ || retry_.is_running()) {
      is_account_due_ = true;
    } else if (begin_account()) {
      start_storing();
    }
  }

  bool is_sync_due() const noexcept {
    const Duration time = queue_->pace().sync_time;
    return time.count() > 0 && unsynced_since_ && span_between(*unsynced_since_, loop()->now()) >= time;
  }

  bool is_busy() const noexcept { return is_storing_ || retry_.is_running(); }

  void start_storing() {
    if (is_busy() || closed_ || !is_attached_) return;
    job_->closing = closing_;
    if (!unsynced_since_) unsynced_since_ = loop()->now();
    job_->syncing = !closing_ && is_sync_due();
    if (closing_ && !is_last_told_ && !tell_last()) return retry_.start(next_delay());
    try {
      is_storing_ = lane_->submit(job_);
      if (is_storing_) return;
      has_no_thread_ = true;  // told by the timer, since this may be within a publish
      health_ = Health::faulted;
      set_reason(no_thread());
    } catch (...) {  // no memory for the lane: as after an error
    }
    retry_.start(next_delay());
  }

  /// False: there is no memory for it.
  bool tell_last() noexcept {
    tell(SinkAccount::Part::last);
    return is_last_told_;
  }

  void try_again() {
    Call call(*this);
    if (std::exchange(has_no_thread_, false)) report(no_thread(), 1);
    tell_health();
    if (is_open()) start_storing();
  }

  Error no_thread() const {
    Error error = detail::no_thread("cannot store", config_.name);
    error.advice += "; events wait in the queue";
    return error;
  }

  /// What will not get better: the first reason stays.
  void fault_for_good(const std::string& reason) noexcept {
    health_ = Health::faulted;
    note([&] {
      if (fault_.empty()) fault_ = loop()->runtime.hide(reason);
      reason_ = fault_;
    });
  }
  void set_reason(const Error& error) noexcept {
    note([&] { reason_ = loop()->runtime.hide(error.text()); });
  }

  void tell_health() {
    if (!is_open() || health_ == told_health_) return;
    told_health_ = health_;
    loop()->runtime.health_changed("sink", config_.name, health_, reason_);
  }

  Duration next_delay() noexcept {
    retry_delay_ = retry_delay_.count() == 0 ? config_.retry_first : doubled(retry_delay_, config_.retry_longest);
    return with_jitter(retry_delay_, config_.name, ++failures_);
  }

  void report(const Error& error, std::uint64_t count) noexcept {
    note([&] {
      const std::string object = object_name();
      if (on_error_) {
        Call call(*this);
        loop()->call_user(object, [&] { on_error_({object, error, count}); });
      } else {
        loop()->runtime.report(loop(), object, error);
      }
    });
  }

  /// Storing an account costs some pages however little it says: while nothing but counts go on, one is made now and then.
  bool is_account_worth_it() const noexcept {
    constexpr std::uint64_t events_an_origin = 50;  // so that accounts of many do not outweigh what they account for
    const StorePace& pace = queue_->pace();
    const std::uint64_t slots = queue_->slot_count();
    return pace.account_time.count() == 0 || !account_.notes.is_empty() || slots != slots_told_ ||
           span_between(account_at_, loop()->now()) >= pace.account_time ||
           queue_->rows_since_account() >= std::max(pace.account_events, events_an_origin * slots);
  }

  /// Hands over the account of what changed since the last one, or its first part; the others follow. False: nothing
  /// was handed over.
  bool begin_account() {
    if (next_part_.is_running()) return false;  // the one before is under way
    is_account_due_ = !account_.has_room();
    if (is_account_due_) return false;
    account_at_ = loop()->now();
    slots_told_ = queue_->slot_count();
    return tell(SinkAccount::Part::first);
  }

  void account_more() {
    if (closing_ || !is_attached_) return;
    if (retry_.is_running() || !account_.has_room()) {
      next_part_.start(pause_between_parts);
    } else if (tell(SinkAccount::Part::next)) {
      start_storing();
    }
  }

  /// Hands over a part of the account, or all. False: there is nothing to be told; or no memory, then it is due again.
  bool tell(SinkAccount::Part part) noexcept try {
    is_account_due_ = part != SinkAccount::Part::last;
    if (part == SinkAccount::Part::next) next_part_.start(pause_between_parts);  // if there is no memory for it now
    if (had_no_memory_) {
      unknown_ += std::string(unknown_.empty() ? "" : "; ") + "there was no memory for some of what was told of it";
      loop()->runtime.keep_report(
          loop(), object_name(),
          {Errc::io_failed, "not kept", config_.name, "there was no memory for some of its account",
           "the recording says that it does not know"});
      had_no_memory_ = false;
    }
    const Time now = loop()->runtime.event_time(loop()->now());
    const auto told = account_.tell(part, now, loop()->deadlines.handled_until(), unknown_);
    is_account_due_ = false;
    next_part_.stop();
    if (told.has_more) next_part_.start(pause_between_parts);
    if (part == SinkAccount::Part::last) is_last_told_ = true;
    return told.is_something;
  } catch (...) {  // no memory: nothing has changed
    return false;
  }

  /// Takes no event from here on, and hands over what is left.
  void begin_closing(MonotonicTime deadline) {
    RuntimeCore& runtime = loop()->runtime;
    if (!is_attached_ || closing_) return;
    runtime.reports.flush(Reports::Repeated::all);
    if (!is_attached_ || closing_) return;  // a user's handler has closed this sink
    // What was published, by tiers too, and what is known to have been published is to be the same: nothing of the user's
    // runs between here and the last account. Storing needs time, too.
    std::string unknown = runtime.exchange.unknown();
    note([&] {
      if (unknown.empty())
        unknown = runtime.exchange.catch_up(std::max(span_between(loop()->now(), deadline), Duration{0}) / 2);
      if (!unknown.empty()) unknown_ += (unknown_.empty() ? "" : "; ") + unknown;
    });
    closing_ = true;
    account_.end();
    note([&] {
      if (!account_.notes.has_end()) account_.notes.add(runtime.clock_log.read("end"));
    });
    account_.close_gaps();
    next_part_.stop();
    early_.stop();
    queue_->hand_over();
    tell_last();
    queue_->keep_own_counts();
    if (is_scheduled()) loop()->schedule().remove(*this);
    if (retry_.is_running()) {  // one try at once, then the delays begin anew
      retry_.stop();
      retry_delay_ = Duration{0};
    }
    start_storing();
  }

  void finish_drain() {
    if (drained_.empty()) return;
    Call call(*this);
    auto done = std::move(drained_);
    drained_.clear();
    deadline_.stop();
    const std::uint64_t lost = leave();
    for (auto& tell : done) tell(lost);
  }

  /// Takes the sink off the runtime, counting what was not stored as refused.
  std::uint64_t leave() noexcept {
    if (!is_attached_) return 0;
    is_attached_ = false;
    retry_.stop();
    queue_->abandon();
    RuntimeCore& runtime = loop()->runtime;
    runtime.detach(*this);
    try {
      last_ = status();
    } catch (...) {  // no memory for texts
      last_.emplace();
      last_->health = health_;
      last_->counts = queue_->counts();
    }
    const std::uint64_t lost = std::exchange(last_->counts.queued, 0);
    last_->counts.dropped[static_cast<std::size_t>(DropReason::refused)] += lost;
    SinkStatus end;
    end.health = health_;
    end.counts = last_->counts;
    note([&] {
      last_->dropped = queue_->dropped_by_topic(SinkQueue::Queued::lost);
      end = *last_;
    });
    runtime.closed_sinks.push_back(std::move(end));  // there is room for it
    note([&] {
      const std::string why = reason_.empty() ? "" : " (" + reason_ + ")";
      if (lost > 0) {
        runtime.report(loop(), object_name(),
                       {Errc::timed_out, "lost " + std::to_string(lost) + " events", config_.name,
                        "they could not be stored before the deadline" + why,
                        "look at the storage; of a recording, the next start writes down what was lost"});
      } else if (!closed_) {
        runtime.report(loop(), object_name(),
                       {Errc::timed_out, "not closed", config_.name, "there was no time or no memory for its end" + why,
                        "the next start seals the recording"});
      }
    });
    runtime.reports.flush(Reports::Repeated::all);  // of closing; nobody may come later to tell of them
    return lost;
  }

  void on_close() noexcept override {
    std::uint64_t lost = 0;
    if (is_attached_) {
      const MonotonicTime end = later(loop()->now(), config_.close_deadline);
      begin_closing(end);
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
    account_.end();
    loop()->runtime.detach(*this);
    if (is_scheduled()) loop()->schedule().remove(*this);
    job_->owner = nullptr;
    if (is_storing_) lane_->leave_behind();
    lane_ = nullptr;
    retry_.close();
    next_part_.close();
    early_.close();
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
  SinkAccount account_;
  std::shared_ptr<StoreJob> job_;
  std::unique_ptr<Lane> lane_;
  Timer retry_;
  Timer next_part_;  // of an account
  Timer early_;      // the account of what is new
  MonotonicTime next_early_{};
  Timer deadline_;
  Duration retry_delay_{0};
  bool is_told_ = false;  // the last error, by the one before it
  std::uint64_t failures_ = 0;
  std::vector<Callback<void(std::uint64_t)>> drained_;  // who waits for the end
  std::optional<SinkStatus> last_;                      // once it has left the runtime
  Health health_ = Health::ok;
  Health told_health_ = Health::ok;  // as published
  std::string reason_;
  std::string fault_;  // for good: it wants a topic that it cannot take
  bool is_attached_ = false;
  bool is_storing_ = false;
  bool has_no_thread_ = false;  // and that is still to be told
  bool is_due_ = false;         // to be handed over as soon as the lane is free
  bool is_account_due_ = false;
  MonotonicTime account_at_{};                   // when the last one was begun
  std::optional<MonotonicTime> unsynced_since_;  // the first storing since the writer was told to sync
  std::uint64_t slots_told_ = 0;                 // that it had
  std::string unknown_;                          // what the last account does not know
  bool had_no_memory_ = false;                   // for something that belongs into the account
  bool is_last_told_ = false;                    // the last account
  bool closing_ = false;
  bool closed_ = false;
};

void StoreJob::done(Outcome outcome) {
  if (owner != nullptr) owner->job_done(outcome);
}

namespace {

SinkNode* sink(Node* node) noexcept {
  return node != nullptr && node->is_open() ? static_cast<SinkNode*>(node) : nullptr;
}

Node* make_sink(Loop& loop, SinkConfig config, std::unique_ptr<Writer> writer) {
  if (config.batch_rows == 0 || config.batch_time < std::chrono::milliseconds{1}) {
    throw SetupError({Errc::bad_argument, "cannot make sink", config.name, "a batch has at least one row and 1 ms",
                      "leave the defaults"});
  }
  if (writer == nullptr) {
    throw SetupError({Errc::bad_argument, "cannot make sink", config.name, "it has no writer", "give it one"});
  }
  if (config.retry_first <= Duration{0} || config.retry_longest <= Duration{0}) {
    throw SetupError({Errc::bad_argument, "cannot make sink", config.name,
                      "it would try again and again without any delay",
                      "give retry_first and retry_longest 1 ms or more"});
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
  auto* const s = detail::sink(node());
  if (s == nullptr) return;
  s->loop()->check_thread("cannot set on_error of", s->name());
  s->on_error_.set(std::move(handler));
}
void Sink::flush() {
  auto* const s = detail::sink(node());
  if (s == nullptr) return;
  s->loop()->check_thread("cannot flush", s->name());
  s->flush();
}

}  // namespace rtdata
