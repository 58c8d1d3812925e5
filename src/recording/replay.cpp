#include "rtdata/recording/replay.hpp"

#include <algorithm>
#include <utility>

#include "data/fitting.hpp"
#include "loop/events/made_of.hpp"
#include "recording/replay_node.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata {
namespace detail {
namespace {

constexpr Duration pause_for_handlers = std::chrono::microseconds{50};
constexpr std::size_t most_at_once = 64;

}  // namespace

void ReplayJob::done(Outcome outcome) {
  if (node == nullptr) return;
  if (outcome != Outcome::finished) {
    portion.clear();
    portion.error = Error{Errc::io_failed, "cannot read the recording", "", "there is no thread to read it on", ""};
    portion.is_last = true;
  }
  is_ready = true;
  node->portion_is_ready();
}

// ---- giving

MonotonicTime ReplayNode::due_of(std::int64_t time) const noexcept {
  const std::int64_t base = to_nanoseconds(base_);
  if (time <= base) return started_;
  const auto after = static_cast<std::uint64_t>(time) - static_cast<std::uint64_t>(base);
  if (config_.speed == 1)  // exact
    return later(started_, Duration{static_cast<std::int64_t>(std::min<std::uint64_t>(after, INT64_MAX))});
  const double scaled = static_cast<double>(after) / config_.speed;
  return later(started_, scaled < 9.2e18 ? Duration{static_cast<std::int64_t>(scaled)} : Duration::max());
}

void ReplayNode::wait_until(MonotonicTime at) noexcept {
  due = at;
  if (is_listed()) {
    loop()->deadlines.moved(*this);
  } else {
    loop()->deadlines.insert(*this);
  }
}

void ReplayNode::portion_is_ready() {
  if (is_done_ || !is_open() || is_listed()) return;
  const MonotonicTime now = loop()->now();
  if (!std::exchange(is_started_, true)) started_ = is_aligned_ ? loop()->runtime.clock_log.monotonic_of(base_) : now;
  wait_until(now);
}

void ReplayNode::fire(MonotonicTime now) {
  LoopCore& on = *loop();
  Call call(*this);
  on.nodes.begins(this);
  if (!on.deliveries.is_empty()) return wait_until(later(now, pause_for_handlers));  // handlers come first
  on.call_own(callback_name_, [&] {
    if (!give_due(now)) on.deadlines.remove(*this);  // until the lane has read more
  });
  if (is_listed() && due <= now) wait_until(later(now, std::chrono::milliseconds{1}));  // there was no memory
}

bool ReplayNode::give_due(MonotonicTime now) {
  std::size_t given = 0;
  const TopicCore* topic = nullptr;
  std::int64_t last_time = 0;
  for (;;) {
    ReplayJob& job = *jobs_[current_];
    if (!job.is_ready) return false;
    if (!std::exchange(is_portion_begun_, true)) {
      for (const ReplayOrigin& found : job.portion.new_origins) {
        try {
          add_origin(found, std::nullopt, {});
        } catch (const SetupError& error) {
          origins_.push_back({});
          refuse(error.error().text());
        }
      }
      if (!job.portion.is_last) read_next();
    }
    while (next_entry_ < job.portion.entries.size()) {
      const ReplayPortion::Entry& entry = job.portion.entries[next_entry_];
      const MonotonicTime at = due_of(entry.time);
      if (at > now) {
        wait_until(at);
        return true;
      }
      // Only events of one topic together: deliveries of several topics would overlap, out of order.
      const OriginCore* const core = origins_[entry.origin].core;
      const bool is_of_other = topic != nullptr && core != nullptr && &core->topic != topic && entry.time != last_time;
      if (given == most_at_once || is_of_other) {
        wait_until(later(now, Duration{1}));
        return true;
      }
      if (core != nullptr && entry.sequence != 0) {
        topic = &core->topic;
        last_time = entry.time;
        ++given;
      }
      ++next_entry_;
      give(entry);
    }
    if (job.portion.is_last) {
      if (given != 0) {
        wait_until(later(now, Duration{1}));  // the last events are delivered before the end is reported
        return true;
      }
      finish(job.portion.error ? Result<void>(*job.portion.error) : Result<void>());
      return false;
    }
    job.is_ready = false;
    is_portion_begun_ = false;
    current_ ^= 1;
    next_entry_ = 0;
  }
}

void ReplayNode::read_next() {
  const std::shared_ptr<ReplayJob>& next = jobs_[current_ ^ 1];
  if (lane_->submit(next)) return;
  next->portion.clear();
  next->portion.error = Error{Errc::io_failed, "cannot read the recording", config_.file, "the system gives no thread",
                              ""};
  next->portion.is_last = true;
  next->is_ready = true;
}

void ReplayNode::give(const ReplayPortion::Entry& entry) {
  Origin& origin = origins_[entry.origin];
  if (next_health_ < health_changes_.size()) give_health(entry.time);
  last_given_ = std::max(last_given_, from_nanoseconds(entry.time));
  loop()->runtime.clock_log.is_repeated_until(last_given_);
  if (origin.core == nullptr) {
    ++counts_.refused;
  } else if (entry.sequence == 0) {
    give_gap(origin, jobs_[current_]->portion.gaps[entry.at]);
  } else {
    give_event(origin, entry);
  }
}

void ReplayNode::count_holes(Origin& origin, std::uint64_t count, std::uint64_t last) {
  OriginCore& core = *origin.core;
  counts_.dropped += count;
  core.counts.received += count;
  core.counts.published += count;
  if (core.counts.has_schedule) {
    core.counts.scheduled += count;
    core.counts.taken += count;
  }
  core.sequence = last;
  core.topic.miss(core, count, last);
}

void ReplayNode::give_event(Origin& origin, const ReplayPortion::Entry& entry) {
  ++origin.given;
  OriginCore& core = *origin.core;
  const Time time = from_nanoseconds(entry.time);
  if (entry.sequence <= core.sequence || time <= core.last_time) {
    return refuse("origin " + core.name + ", sequence " + std::to_string(entry.sequence) + ", " + to_iso8601(time) +
                  ": it is not after the event before it");
  }
  // The events that the recording dropped. Before its first event only the account counts them.
  const std::uint64_t expected = core.sequence != 0 ? core.sequence + 1
                                 : origin.ledger && origin.ledger->first_sequence != 0
                                     ? std::min(origin.ledger->first_sequence, entry.sequence)
                                     : entry.sequence;
  if (entry.sequence > expected) [[unlikely]]
    count_holes(origin, entry.sequence - expected, entry.sequence - 1);
  SensorCounts& counts = core.counts;
  ++counts.received;
  ++counts.published;
  if (counts.has_schedule) {
    ++counts.scheduled;
    ++counts.taken;
  }
  ++counts_.events;
  core.topic.republish(core, time, entry.sequence, jobs_[current_]->portion.payloads.data() + entry.at);
}

void ReplayNode::give_gap(Origin& origin, const Gap& recorded) {
  OriginCore& core = *origin.core;
  Gap gap = recorded;
  if (core.counts.has_schedule) {
    core.counts.scheduled += gap.count;
    (gap.kind == Gap::Kind::missed ? core.counts.missed : core.counts.failed) += gap.count;
  } else if (gap.kind == Gap::Kind::missed || gap.kind == Gap::Kind::failed) {
    gap.kind = Gap::Kind::silent;
    gap.count = 0;
  }
  ++counts_.gaps;
  for (Listener* listener : loop()->runtime.recorders) listener->on_gap(core, gap);
}

void ReplayNode::give_health(std::int64_t up_to) {
  RuntimeCore& runtime = loop()->runtime;
  for (; next_health_ < health_changes_.size(); ++next_health_) {
    const RecordedHealth& recorded = health_changes_[next_health_];
    if (to_nanoseconds(recorded.time) > up_to) return;
    const OriginCore* const of = runtime.find_origin(config_.prefix + recorded.name);
    const bool is_replayed = of != nullptr && recorded.time >= base_ &&
                             std::any_of(origins_.begin(), origins_.end(),
                                         [&](const Origin& origin) { return origin.core == of; });
    if (!is_replayed) continue;
    HealthChange change;
    change.kind = text<16>("sensor");
    change.name = text<200>(of->name);
    change.state = recorded.state == name_of(Health::ok)         ? Health::ok
                   : recorded.state == name_of(Health::degraded) ? Health::degraded
                                                                 : Health::faulted;
    change.reason = fitting<96>(recorded.reason);
    for (Listener* listener : runtime.recorders)
      listener->on_health(recorded.time, recorded.last, change, recorded.count);
    TopicCore& topic = runtime.topic(health_topic, payload_type<HealthChange>());
    OriginCore& program = runtime.program_origin(topic);
    ++program.counts.received;
    ++program.counts.published;
    topic.publish(program, recorded.time, &change);
  }
}

void ReplayNode::refuse(const std::string& why) {
  ++counts_.refused;
  if (std::exchange(has_told_refused_, true)) return;
  health_ = Health::degraded;
  reason_ = why;
  loop()->runtime.report(loop(), "replay " + config_.name,
                         {Errc::damaged, "an event is not replayed", config_.file, why,
                          "see `rtdata verify`; those that follow are counted"});
}

// ---- the end

void ReplayNode::end_account(Origin& origin, bool is_complete) noexcept {
  if (origin.core == nullptr || !origin.ledger) return;
  OriginCore& core = *origin.core;
  const LedgerEntry& ledger = *origin.ledger;
  if (is_complete) {
    const std::uint64_t next = core.sequence != 0 ? core.sequence + 1 : ledger.first_sequence;
    if (ledger.last_sequence >= next && next != 0)
      count_holes(origin, ledger.last_sequence - next + 1, ledger.last_sequence);
    core.counts = ledger.sensor;
  } else {
    core.counts.is_one_a_read = false;  // which of the ticks brought an event is not known
  }
  std::uint64_t ticks = core.counts.scheduled;  // that were given, events and gaps
  for (Segment segment : origin.segments) {
    if (!is_complete && segment.scheduled > ticks) {
      segment.scheduled = ticks;
      if (ticks == 0) break;
      segment.end = segment.first_due + static_cast<std::int64_t>(ticks - 1) * segment.period;
    }
    ticks -= std::min(ticks, segment.scheduled);
    for (Listener* listener : loop()->runtime.recorders) listener->on_segment(core, segment);
  }
  core.topic.notify_taps(core);
}

void ReplayNode::give_sources() noexcept {
  RuntimeCore& runtime = loop()->runtime;
  for (const Source& source : sources_) {
    const SensorCounts& counts = source.ledger.sensor;
    const auto supply = counts.has_schedule ? OriginCore::Supply::schedule : OriginCore::Supply::feed;
    loop()->call_own(callback_name_, [&] {
      try {
        const std::string name = renamed(source.ledger.topic);
        TopicCore* topic = runtime.find_topic(name);
        if (topic == nullptr) {
          PayloadType type = payload_type<FinalCounts>();
          type.type_key = &type_key_of<NoEvents>;
          topic = &runtime.topic(name, std::move(type));
        }
        origins_.reserve(origins_.size() + 1);
        OriginCore& core = runtime.names.claim(config_.prefix + source.ledger.origin, *topic, supply);
        origins_.push_back({&core, source.ledger, source.segments});
        core.is_mirror = true;
        if (!source.ledger.made_of.empty()) set_made_of(core, renamed(source.ledger.made_of));
        for (const Gap& gap : source.gaps)
          for (Listener* listener : runtime.recorders) listener->on_gap(core, gap);
        end_account(origins_.back(), true);
      } catch (const SetupError& error) {  // something of that name is there, and has an account of its own
        runtime.log(LogLevel::warning, "replay " + config_.name,
                    "the account of " + source.ledger.topic + " is not replayed: " + error.error().text());
      }
    });
  }
}

Result<void> ReplayNode::look_whether_all_came() const {
  const auto look = [&](const LedgerEntry& ledger, std::uint64_t given) -> Result<void> {
    if (given + ledger.pruned >= ledger.stored) return {};
    return Error{Errc::bad_data, "cannot replay all of it", config_.file + ", origin " + ledger.origin,
                 std::to_string(given) + " events are there, and its account says that " +
                     std::to_string(ledger.stored - ledger.pruned) + " are",
                 "see `rtdata verify`"};
  };
  Result<void> all;
  for (const Origin& origin : origins_)
    if (origin.ledger && all) all = look(*origin.ledger, origin.given);
  for (const Source& source : sources_)
    if (all) all = look(source.ledger, 0);
  return all;
}

void ReplayNode::finish(const Result<void>& came) {
  const Result<void> how = came ? look_whether_all_came() : came;
  give_health(INT64_MAX);
  const bool is_complete = how && counts_.refused == 0;
  for (Origin& origin : origins_) end_account(origin, is_complete);
  if (is_complete) give_sources();
  is_done_ = true;
  loop()->deadlines.remove(*this);
  if (!how) {
    health_ = Health::faulted;
    reason_ = how.error().text();
    loop()->runtime.report(loop(), "replay " + config_.name, how.error());
  }
  if (std::exchange(has_ref_, false)) loop()->unref();
  report_end(how && counts_.refused == 0);
  if (!how) own_->begin_absence(Gap::Kind::disconnected, how.error().id(), loop()->now());  // what would have followed
  if (on_done) on_done(how);                                                                // last: it may close this
}

void ReplayNode::report_end(bool is_complete) {
  LoopCore& on = *loop();
  const ReplayEnd end{run_.run, counts_.events, counts_.gaps, counts_.dropped, counts_.refused, is_complete};
  on.runtime.log(
      is_complete ? LogLevel::info : LogLevel::warning, "replay " + config_.name,
      std::string(is_complete ? "has ended: " : "was ended early: ") + std::to_string(counts_.events) + " events and " +
          std::to_string(counts_.gaps) + " gaps" +
          (counts_.dropped > 0 ? ", " + std::to_string(counts_.dropped) + " that the recording dropped" : "") +
          (counts_.refused > 0 ? ", " + std::to_string(counts_.refused) + " refused" : ""));
  ++own_->counts.received;
  ++own_->counts.published;
  own_->topic.publish(*own_, last_given_, const_cast<ReplayEnd*>(&end));
}

void ReplayNode::halt() noexcept {
  if (std::exchange(is_done_, true)) return;
  source_->cancel();
  loop()->deadlines.remove(*this);
  if (std::exchange(has_ref_, false)) loop()->unref();
  loop()->call_own("replay", [&] {
    for (Origin& origin : origins_) end_account(origin, false);
    report_end(false);
  });
}

void ReplayNode::leave() noexcept {
  for (Origin& origin : origins_) {
    if (origin.core != nullptr) loop()->runtime.names.release(*origin.core);
    origin.core = nullptr;
  }
  if (own_ != nullptr) {
    own_->sensor = nullptr;
    loop()->runtime.names.release(*own_);
  }
}

void ReplayNode::on_close() noexcept {
  stop();
  for (auto& job : jobs_) job->node = nullptr;
  source_->cancel();
  lane_.reset();
  loop()->deadlines.release_one();
  leave();
  loop()->runtime.sensors.remove(*this);
  loop()->runtime.sensors.tidy();
}

}  // namespace detail

namespace {

detail::Node* make_replay(Loop& loop, ReplayConfig config) {
  loop.core().check_thread("cannot make replay", config.name);
  if (config.name.empty()) config.name = ReplayConfig{}.name;
  return new detail::ReplayNode(loop.core(), std::move(config));
}

detail::ReplayNode* replay(detail::Node* node) {
  return node != nullptr && node->is_open() ? static_cast<detail::ReplayNode*>(node) : nullptr;
}

}  // namespace

Replay::Replay(Loop& loop, ReplayConfig config) : Handle(make_replay(loop, std::move(config))) {}

bool Replay::is_done() const noexcept {
  const auto* of = replay(node());
  return of == nullptr || of->is_done();
}
ReplayCounts Replay::counts() const noexcept {
  const auto* of = replay(node());
  return of != nullptr ? of->counts() : ReplayCounts{};
}
std::int64_t Replay::run() const noexcept {
  const auto* of = replay(node());
  return of != nullptr ? of->run() : 0;
}
void Replay::on_done(Callback<void(const Result<void>&)> handler) {
  if (auto* of = replay(node())) of->on_done.set(std::move(handler));
}

}  // namespace rtdata
