#include "sinks/core/sink_node.hpp"

#include <algorithm>
#include <exception>

#include "data/saturating.hpp"

namespace rtdata {
namespace detail {
namespace {

constexpr Duration no_limit = std::chrono::hours{24 * 365};

}  // namespace

SinkNode::SinkNode(LoopCore& loop, SinkConfig config, std::unique_ptr<Writer> writer)
    : Node(loop),
      RateMember(config.batch_time),
      config_(std::move(config)),
      queue_(std::make_shared<SinkQueue>(config_, std::move(writer))),
      account_(queue_),
      job_(std::make_shared<Job>(queue_)),
      lane_(std::make_unique<Lane>(loop, config_.name, no_limit)),
      work_timer_(loop.face, [this] { work_timer_fired(); }),
      account_timer_(loop.face, [this] { account_timer_fired(); }),
      deadline_(loop.face, [this] { finish_drain(); }),
      follow_(loop.face, [this] { follow_timer_fired(); }),
      is_to_open_(queue_->opens_at_set_up()) {
  drained_.reserve(1);
  if (Sender* sender = queue_->sender()) transfer_ = std::make_shared<Transfer>(loop, *sender, config_, *this);
}

void SinkNode::attach() {
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
  job_->sink = this;
  wait_for_predecessors();
  if (!config_.through.empty()) return follow_recording();
  // Events that tiers published before this are not recorded: takes them from the rings first, and waits for each tier
  // for a limited time only.
  const Exchange::Interest until_all_is_attached(runtime, config_.topics);
  const std::string unknown = runtime.exchange.catch_up(std::chrono::seconds{1});
  if (!unknown.empty()) unknown_ = "the sink began although " + unknown;
  // If it replaces a closed sink, it refuses topics that came meanwhile as that one did.
  std::vector<std::pair<TopicCore*, Error>> refused;
  for (const auto& topic : runtime.topics()) {
    auto taken = take_topic(*topic);
    if (!taken && !runtime.exchange.stands_still()) throw SetupError(std::move(taken).error());
    if (!taken) refused.emplace_back(topic.get(), std::move(taken).error());
  }
  account_.follow_all(*this);
  runtime.attach(*this);
  for (const ClockPair& pair : runtime.clock_log.pairs()) account_.notes.add(pair);
  for (const ConfigurationChange& change : runtime.configurations.changes()) account_.notes.add(change);
  for (const auto& [object, change] : runtime.configurations.told()) account_.notes.add(change);
  loop()->schedule().add(*this);
  life_ = Life::attached;
  report_run();
  for (const auto& [topic, why] : refused) {
    account_.refuse_topic(*topic, *this);
    fault_for_good(why.text());
  }
  if (is_to_open_) {
    start_work();
    if (loop()->is_being_set_up() && !loop()->is_in_user_code()) wait_for_opening();
  }
  if (!unknown.empty()) runtime.log(LogLevel::warning, object_name(), "begins although " + unknown);
}

std::string SinkNode::run_of(const TopicCore& topic) const {
  if (queue_->is_recording() || is_fed()) return {};
  RuntimeCore& runtime = loop()->runtime.main();
  for (Recorder* const recorder : runtime.recorders)
    if (const SinkNode* const sink = recorder->as_sink(); sink != nullptr && sink->records(topic.name))
      return sink->queue_->run();
  return runtime.run_uuid();
}

void SinkNode::report_run() noexcept {
  if (!queue_->is_recording()) return;
  for (Recorder* const recorder : loop()->runtime.recorders) {
    SinkNode* const sink = recorder->as_sink();
    if (sink != nullptr && !sink->is_fed() && !sink->is_closing()) sink->note([&] { sink->account_.look_at_runs(); });
  }
}

// ---- Recorder

Result<void> SinkNode::on_topic(TopicCore& topic) {
  if (is_closing() || is_fed()) return {};
  const auto threw = [&](std::string_view what) {
    return Error{Errc::handler_threw, "the writer threw", "topic " + topic.name, std::string(what),
                 "this topic is not recorded"};
  };
  Result<void> taken;
  try {
    taken = take_topic(topic);
    if (!wants(topic.name)) account_.follow_new(topic, *this);
    if (account_.is_follow_due()) follow_.start(Duration{0});
  } catch (const std::exception& e) {
    taken = threw(reason_of(e));
  } catch (...) {
    taken = threw("an exception that is not a std::exception");
  }
  if (!taken) {
    account_.refuse_topic(topic, *this);
    fault_for_good(taken.error().text());
  }
  return taken;
}

void SinkNode::on_made_of(OriginCore& origin) {
  if (is_closing() || is_fed()) return;
  account_.follow(origin, *this);
  if (account_.is_follow_due()) follow_.start(Duration{0});
}

void SinkNode::on_refusal(const Error& error) {
  Call call(*this);
  report(error, 1);
  report_health();
}

bool SinkNode::wants(std::string_view topic) const noexcept {
  return std::any_of(config_.topics.begin(), config_.topics.end(),
                     [&](const std::string& pattern) { return topic_matches(pattern, topic); });
}

Result<void> SinkNode::take_topic(TopicCore& topic) {
  if (!wants(topic.name)) return {};
  if (topic.type.type_key == &type_key_of<NoEvents> && !queue_->is_recording()) return {};
  if (topic.type.description == nullptr) {
    if (std::find(config_.topics.begin(), config_.topics.end(), topic.name) == config_.topics.end()) return {};
    return Error{Errc::bad_description, "cannot record", "topic " + topic.name, "its payload has no description",
                 "give its type a `describe`"};
  }
  return account_.add_topic(topic, *this);
}

void SinkNode::on_gap(OriginCore& origin, const Gap& gap) {
  note([&] { account_.add(origin, gap); });
}

void SinkNode::on_segment(OriginCore& origin, const Segment& segment) {
  note([&] { account_.add(origin, segment); });
  account_is_due();
}

void SinkNode::on_clock(const ClockPair& pair) {
  if (is_fed()) return;
  note([&] { account_.notes.add(pair); });
}

void SinkNode::on_configuration(const ConfigurationChange& change) {
  if (is_fed()) return;
  note([&] { account_.notes.add(change); });
  account_is_due();
}

void SinkNode::on_error(Time first, Time last, std::string_view object, const Error& error, std::uint64_t count) {
  if (is_fed()) return;
  note([&] { account_.notes.add(first, last, object, error, count); });
}

void SinkNode::on_health(Time first, Time last, const HealthChange& change, std::uint64_t count) {
  if (is_fed()) return;
  note([&] { account_.notes.add(first, last, change, count); });
}

SinkStatus SinkNode::status() const {
  if (last_) return *last_;
  SinkStatus now{config_.name, health_, reason_, queue_->counts(), queue_->dropped_by_topic(SinkQueue::Queued::waits)};
  if (is_fed()) {
    const FeedCounts fed = queue_->feed()->counts();
    if (fed.is_known) {
      RuntimeCore& runtime = loop()->runtime;
      const bool is_utc = queue_->sender() != nullptr;
      const Time present = is_utc ? runtime.clock().realtime() : runtime.event_now();
      now.backlog = {fed.bytes, fed.oldest,
                     fed.oldest == Time{} ? Duration{0} : std::max(present - fed.oldest, Duration{0}),
                     catch_up_.at(loop()->now(), fed.backlog)};
    }
  }
  return now;
}

// ---- batches by time

void SinkNode::tick(const Tick&) {
  Call call(*this);
  RuntimeCore& runtime = loop()->runtime;
  runtime.clock_log.look();  // may log, as the next may, and a user's handler may close this sink
  runtime.reports.flush(Reports::Repeated::due);
  if (is_fed()) return;  // by commits
  if (std::exchange(are_positions_due_, false) && work_ == Work::idle) start_work();
  if (is_open()) hand_over(is_account_worth_it() ? Hand::rows_and_account : Hand::rows);
  if (is_open() && is_sync_due()) start_work();  // also when nothing more came
}

bool SinkNode::is_idle() const noexcept {
  if (is_fed()) return true;
  if (work_ != Work::idle || are_positions_due_ || is_account_due_ || queue_->has_rows() || !syncs_.empty())
    return false;
  const StorePace& pace = queue_->pace();
  if (pace.sync_time.count() > 0 && unsynced_since_) return false;
  if (!queue_->keeps_account()) return true;
  return account_.notes.is_empty() && queue_->slot_count() == reported_slots_ &&
         queue_->rows_since_account() == reported_rows_ && had_no_news_ && !account_.goes_on_by_itself();
}

bool SinkNode::report_times(CallbackStatus& status) const {
  status.name = object_name();
  status.times = times;
  return true;
}

// ---- health and reports

void SinkNode::fault_for_good(const std::string& reason) noexcept {
  health_ = Health::faulted;
  note([&] {
    if (fault_.empty()) fault_ = loop()->runtime.hide(reason);
    reason_ = fault_;
  });
}

void SinkNode::set_reason(const Error& error) noexcept {
  note([&] { reason_ = loop()->runtime.hide(error.text()); });
}

void SinkNode::report_health() {
  if (!is_open() || health_ == published_health_) return;
  published_health_ = health_;
  loop()->runtime.health_changed("sink", config_.name, health_, reason_);
}

void SinkNode::report(const Error& error, std::uint64_t count) noexcept {
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

// ---- the handle

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
std::error_code Sink::obstacle() const noexcept {
  const auto* s = detail::sink(node());
  return s != nullptr ? s->obstacle() : std::error_code{};
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
  s->hand_over(detail::SinkNode::Hand::rows_and_account);
}
void Sink::sync(Callback<void()> done) {
  auto* const s = detail::sink(node());
  if (s == nullptr) return;
  s->loop()->check_thread("cannot sync", s->name());
  s->sync(std::move(done));
}
void Sink::finish(Callback<void(std::uint64_t)> done) {
  auto* const s = detail::sink(node());
  if (s == nullptr) return done(0);
  s->loop()->check_thread("cannot finish", s->name());
  s->finish(std::move(done));
}
void Sink::end_before(const std::string& successor) {
  auto* const s = detail::sink(node());
  if (s == nullptr) return;
  s->loop()->check_thread("cannot use", s->name());
  s->end_before(successor);
}

}  // namespace rtdata
