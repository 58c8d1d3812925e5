#include "rtdata/sinks/replay.hpp"

#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <set>
#include <utility>

#include "data/time_text.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/support/deadline.hpp"
#include "loop/support/fitting.hpp"
#include "loop/support/handler.hpp"
#include "loop/support/name.hpp"
#include "rtdata/loop/topic.hpp"
#include "sinks/sqlite/recording_file.hpp"
#include "sinks/sqlite/replay_source.hpp"
#include "sinks/sqlite/schema.hpp"

namespace rtdata {
namespace {

constexpr Duration no_limit = std::chrono::hours{24 * 365};
constexpr Duration pause_for_handlers = std::chrono::microseconds{50};
constexpr std::size_t most_at_once = 64;

Error refused(std::string where, std::string why, std::string advice) {
  return {Errc::bad_argument, "cannot replay", std::move(where), std::move(why), std::move(advice)};
}

/// None: there is no such time.
struct GivenTime {
  Time time;
  RowFilter::Times line;
};
Result<std::optional<GivenTime>> time_of(const char* key, const std::string& text) {
  if (text.empty()) return std::optional<GivenTime>{};
  std::int64_t ns = 0;
  const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), ns);
  if (failed == std::errc{} && end == text.data() + text.size())
    return std::optional<GivenTime>{{from_nanoseconds(ns), RowFilter::Times::recorded}};
  auto time = parse_iso8601(text);
  if (time) return std::optional<GivenTime>{{*time, RowFilter::Times::utc}};
  return refused(std::string(key) + " \"" + text + "\"", "it is no time",
                 "write it as 2026-03-01T12:00:00Z, or as recorded ns");
}

/// "OLD=NEW".
Result<std::pair<std::string, std::string>> renaming_of(const std::string& text) {
  const std::size_t at = text.find('=');
  if (at == std::string::npos || !is_topic_name(text.substr(0, at)) || !is_topic_name(text.substr(at + 1))) {
    return refused("rename \"" + text + "\"", "it is not the name of a topic, \"=\", and another name",
                   "write room=lab/room");
  }
  return std::pair(text.substr(0, at), text.substr(at + 1));
}

Result<RunInfo> chosen_run(const Recording& recording, const ReplayConfig& config) {
  auto runs = recording.runs();
  if (!runs) return std::move(runs).error();
  std::string numbers;
  RunInfo chosen;
  for (RunInfo& run : *runs) {
    if (run.state == RunState::recording && run.pid == ::getpid()) {
      return refused(config.file, "this program records into it: what is replayed would be recorded again",
                     "record into another file");
    }
    numbers += (numbers.empty() ? "" : ", ") + std::to_string(run.run);
    if (config.run == 0 || run.run == config.run) chosen = std::move(run);
  }
  if (chosen.run != 0) return chosen;
  return Error{Errc::not_found, "cannot replay", config.file,
               numbers.empty() ? "it has no run" : "it has no run " + std::to_string(config.run),
               numbers.empty() ? "" : "its runs are " + numbers};
}

/// Those with rows in the run.
Result<std::vector<RecordedTopic>> chosen_topics(const Recording& recording, const ReplayConfig& config,
                                                 std::int64_t run) {
  for (const std::string& pattern : config.topics) {
    if (!is_topic_pattern(pattern)) {
      return Error{Errc::bad_name, "cannot replay", "topic " + pattern, "it is neither a topic nor a pattern",
                   "write room/climate, room/+ or room/#"};
    }
  }
  auto all = recording.topics();
  if (!all) return std::move(all).error();
  std::set<std::string> all_names;  // one whose fields changed is there several times
  for (const RecordedTopic& topic : *all) all_names.insert(topic.topic);
  std::string names;
  for (const std::string& name : all_names)
    if (names.size() < 200) names += (names.empty() ? "" : ", ") + name;
  std::vector<RecordedTopic> chosen;
  for (RecordedTopic& topic : *all) {
    const bool is_wanted = std::any_of(config.topics.begin(), config.topics.end(),
                                       [&](const std::string& pattern) { return topic_matches(pattern, topic.topic); });
    // Of one whose fields changed between runs, those of this run.
    auto rows = recording.file()->prepare("SELECT EXISTS(SELECT 1 FROM " + sqlite::quoted(topic.table) +
                                          " t WHERE t.run = " + std::to_string(run) + ")");
    if (!rows) return std::move(rows).error();
    auto row = rows->step();
    if (!row) return std::move(row).error();
    if (!is_wanted || !*row || rows->integer(0) == 0) continue;
    if (topic.description->size() > max_payload_size) {
      return Error{Errc::bad_description, "cannot replay", config.file + ", topic " + topic.topic,
                   "its events have " + std::to_string(topic.description->size()) + " bytes", "4096 at most"};
    }
    chosen.push_back(std::move(topic));
  }
  if (!chosen.empty()) return chosen;
  return Error{Errc::not_found, "cannot replay", config.file + ", run " + std::to_string(run),
               "it has no events on the topics that are asked for",
               names.empty() ? "it has no topics" : "its topics are " + names};
}

}  // namespace

Result<void> check_replayable(const ReplayConfig& config) {
  auto recording = Recording::open(config.file);
  if (!recording) return std::move(recording).error();
  auto run = chosen_run(*recording, config);
  if (!run) return std::move(run).error();
  auto topics = chosen_topics(*recording, config, run->run);
  if (!topics) return std::move(topics).error();
  return {};
}

void check_config(const ReplayConfig& config, const ConfigItem& item, Problems& problems) {
  const auto add = [&](const char* key, const Error& error) {
    const ConfigItem* at = item.find(key);
    problems.add(
        (at != nullptr ? *at : item).problem("bad-value", error.where + ": " + error.why + "; " + error.advice));
  };
  const auto from = time_of("from", config.from), until = time_of("until", config.until);
  if (!from) add("from", from.error());
  if (!until) add("until", until.error());
  if (from && until && *from && *until) {
    if ((*from)->line != (*until)->line) {
      add("until", refused("until", "one of from and until is UTC, the other in ns", "write both in the same way"));
    } else if ((*from)->time > (*until)->time) {
      add("until", refused("until", "it ends before it begins", "exchange from and until"));
    }
  }
  for (const std::string& text : config.rename) {
    if (const auto renaming = renaming_of(text); !renaming) add("rename", renaming.error());
  }
  if (!config.prefix.empty() && !detail::is_name(config.prefix + "x"))
    add("prefix", refused("prefix", detail::name_rule, "choose another one"));
  if (const auto replayable = check_replayable(config); !replayable) {
    const Error& error = replayable.error();
    const bool is_of_run = error.code == Errc::not_found && config.run != 0 && error.where == config.file;
    add(is_of_run ? "run" : "file", error);
  }
}

namespace detail {

class ReplayNode final : public SensorEntry, public Deadline {
 public:
  ReplayNode(LoopCore& loop, ReplayConfig config);

  // ---- SensorEntry
  void stop() override {
    halt();
    for (const Origin& origin : origins_)
      if (origin.core != nullptr) origin.core->topic.cancel(*origin.core);
  }
  const OriginCore& origin() const noexcept override { return *own_; }
  Duration schedule_period() const noexcept override { return Duration{0}; }
  bool is_active() const noexcept override { return !is_done_; }
  Health health() const noexcept override { return health_; }
  std::string_view reason() const noexcept override { return reason_; }
  void stop_schedule(MonotonicTime) override { halt(); }
  bool is_reading() const noexcept override { return false; }

  // ---- Deadline
  void fire(MonotonicTime now) override;

  void portion_is_ready();
  bool is_done() const noexcept { return is_done_; }
  ReplayCounts counts() const noexcept { return counts_; }
  std::int64_t run() const noexcept { return run_.run; }
  Handler<Result<void>> on_done;

 private:
  struct Topic {
    RecordedTopic recorded;
    TopicCore* core = nullptr;
  };
  struct Origin {
    OriginCore* core = nullptr;         // null: it cannot be replayed
    std::optional<LedgerEntry> ledger;  // whole, when its account is replayed
    std::vector<Segment> segments;      // then
  };

  void choose_topics(const Recording& recording);
  void find_origins(const Recording& recording, RowFilter& filter, std::vector<ReplayOrigin>& known);
  std::string renamed(const std::string& topic) const;
  void add_origin(const ReplayOrigin& found, std::optional<LedgerEntry> ledger, std::vector<Segment> segments);
  void leave() noexcept;

  MonotonicTime due_of(std::int64_t time) const noexcept;
  /// Until one is to be given later; then it is `due`. False: there is none at hand.
  bool give_due(MonotonicTime now);
  void give(const ReplayPortion::Entry& entry);
  void give_event(Origin& origin, const ReplayPortion::Entry& entry);
  void give_gap(Origin& origin, const Gap& gap);
  void give_health(std::int64_t up_to);
  void count_holes(Origin& origin, std::uint64_t count, std::uint64_t last);
  void refuse(const std::string& why);
  void wait_until(MonotonicTime at) noexcept;
  void read_next();
  /// All was given.
  void finish(const Result<void>& how);
  /// Nothing more is given.
  void halt() noexcept;
  void end_account(Origin& origin, bool is_complete) noexcept;
  void tell_end(bool is_complete);

  void on_close() noexcept override;
  void drop_callbacks() noexcept override { on_done.reset(); }

  const ReplayConfig config_;
  const std::string callback_name_;
  std::vector<std::pair<std::string, std::string>> renamings_;
  RunInfo run_;
  Time base_{};  // is given when it starts
  std::vector<Topic> topics_;
  std::vector<Origin> origins_;
  std::vector<RecordedHealth> health_changes_;
  std::size_t next_health_ = 0;
  OriginCore* own_ = nullptr;
  std::shared_ptr<ReplaySource> source_;
  std::shared_ptr<ReplayJob> jobs_[2];  // one is given while the other is read
  std::size_t current_ = 0;
  std::size_t next_entry_ = 0;
  bool is_portion_begun_ = false;
  std::unique_ptr<Lane> lane_;
  MonotonicTime started_{};
  Time last_given_{};
  ReplayCounts counts_;
  Health health_ = Health::ok;
  std::string reason_;
  bool is_started_ = false;
  bool is_aligned_ = false;  // the loop's time is that of the run: what is recorded again lies within its run
  bool is_done_ = false;
  bool has_told_refused_ = false;
  bool has_ref_ = false;
};

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

// ---- opening

ReplayNode::ReplayNode(LoopCore& loop, ReplayConfig config)
    : SensorEntry(loop), config_(std::move(config)), callback_name_("replay " + config_.name) {
  if (config_.speed < 1e-6 || config_.speed > 1e6)
    throw SetupError(refused("speed", "it is not from 0.000001 to 1000000", "1 is as it was recorded"));
  for (const std::string& text : config_.rename) renamings_.push_back(renaming_of(text).or_throw());
  RowFilter filter;
  filter.gaps = RowFilter::Gaps::in_place;
  const auto from = time_of("from", config_.from).or_throw(), until = time_of("until", config_.until).or_throw();
  if (from) filter.from = from->time;
  if (until) filter.until = until->time;
  if (from || until) filter.times = (from ? from : until)->line;
  if (from && until && (from->line != until->line || from->time > until->time))
    throw SetupError(refused("from " + config_.from + ", until " + config_.until,
                             "it ends before it begins, or one is UTC and the other in ns", "correct them"));
  Recording recording = Recording::open(config_.file).or_throw();
  run_ = chosen_run(recording, config_).or_throw();
  filter.run = run_.run;
  base_ = run_.started;
  if (from) {
    base_ = from->line == RowFilter::Times::utc ? recording.utc_line(run_.run).or_throw().recorded(from->time)
                                                : from->time;
  }
  last_given_ = base_;
  const Time time_now = loop.runtime.event_now();
  is_aligned_ = config_.speed == 1 && base_ >= time_now && base_ - time_now <= std::chrono::seconds{10};
  choose_topics(recording);
  for (RecordedHealth& change : recording.health(run_.run).or_throw())
    if (change.kind == "sensor") health_changes_.push_back(std::move(change));
  loop.deadlines.reserve_one();
  try {
    PayloadType type = payload_type<ReplayEnd>();
    own_ = &loop.runtime.names.claim(config_.name, loop.runtime.topic(replay_topic, std::move(type)),
                                     OriginCore::Supply::feed);
    own_->sensor = this;
    std::vector<ReplayOrigin> known;
    find_origins(recording, filter, known);
    std::vector<RecordedTopic> recorded;
    for (const Topic& topic : topics_) recorded.push_back(topic.recorded);
    source_ = std::make_shared<ReplaySource>(std::move(recording), std::move(filter), recorded, known,
                                             run_.state == RunState::recording ? std::nullopt : run_.ended);
    for (auto& job : jobs_) job = std::make_shared<ReplayJob>(*this, source_);
    lane_ = std::make_unique<Lane>(loop, "replay " + config_.name, no_limit);
    loop.runtime.sensors.add(*this);
  } catch (...) {
    lane_.reset();
    loop.deadlines.release_one();
    leave();
    throw;
  }
  loop.ref();
  has_ref_ = true;
  const bool goes_on = run_.state == RunState::recording;
  loop.runtime.log(
      goes_on ? LogLevel::warning : LogLevel::info, "replay " + config_.name,
      "run " + std::to_string(run_.run) + " of " + config_.file + ", from " + to_iso8601(base_) +
          (goes_on ? "; it is still being recorded, or was not sealed: what it holds now is replayed" : ""));
  lane_->submit(jobs_[0]);
}

std::string ReplayNode::renamed(const std::string& topic) const {
  for (const auto& [from, to] : renamings_) {
    if (topic == from) return to;
    if (topic.size() > from.size() && topic.starts_with(from) && topic[from.size()] == '/')
      return to + topic.substr(from.size());
  }
  return topic;
}

void ReplayNode::choose_topics(const Recording& recording) {
  for (RecordedTopic& topic : chosen_topics(recording, config_, run_.run).or_throw()) {
    PayloadType type;
    type.size = topic.description->size();
    type.alignment = topic.description->alignment();
    type.type_name = topic.description->name().c_str();
    type.description = topic.description;
    TopicCore& core = loop()->runtime.topic(renamed(topic.topic), std::move(type));
    topics_.push_back({std::move(topic), &core});
  }
}

void ReplayNode::find_origins(const Recording& recording, RowFilter& filter, std::vector<ReplayOrigin>& known) {
  // Rows are selected by one pattern; of several, all are read and the others left out.
  filter.topic = topics_.size() == 1          ? topics_.front().recorded.topic
                 : config_.topics.size() == 1 ? config_.topics.front()
                                              : "#";
  const bool is_whole = is_aligned_ && run_.state == RunState::closed && !filter.from && !filter.until &&
                        run_.format >= sqlite::first_version_of_own_data_account;
  std::map<std::pair<std::string, std::string>, std::vector<Segment>> segments;
  for (RecordedSegment& of : recording.schedule(run_.run).or_throw())
    segments[{of.topic, of.origin}].push_back(of.segment);
  bool has_all = is_whole;
  for (LedgerEntry& entry : recording.ledger(run_.run).or_throw()) {
    const auto topic = std::find_if(topics_.begin(), topics_.end(),
                                    [&](const Topic& of) { return of.recorded.topic == entry.topic; });
    if (topic == topics_.end()) continue;
    ReplayOrigin origin{static_cast<std::size_t>(topic - topics_.begin()), entry.origin};
    auto& of_origin = segments[{entry.topic, entry.origin}];
    const bool is_replayed = is_whole && entry.carried == 0 && entry.sensor.published == entry.offered &&
                             entry.offered == entry.stored + entry.dropped();
    has_all = has_all && is_replayed;
    add_origin(origin, is_replayed ? std::optional(std::move(entry)) : std::nullopt, std::move(of_origin));
    known.push_back(std::move(origin));
  }
  if (has_all) return;
  loop()->runtime.log(LogLevel::info, "replay " + config_.name,
                      std::string(!is_aligned_                     ? "the loop's time is not that of the run"
                                  : run_.state == RunState::closed ? "it is not replayed as a whole"
                                                                   : "the run was not closed") +
                          ": what is recorded of it again has no schedule, its gaps are silent ones");
}

void ReplayNode::add_origin(const ReplayOrigin& found, std::optional<LedgerEntry> ledger,
                            std::vector<Segment> segments) {
  RuntimeCore& runtime = loop()->runtime;
  Origin origin;
  const bool has_schedule = ledger && ledger->sensor.has_schedule;
  origin.core = &runtime.names.claim(config_.prefix + found.name, *topics_[found.topic].core,
                                     has_schedule ? OriginCore::Supply::schedule : OriginCore::Supply::feed);
  origin.core->is_mirror = true;  // it does not keep its account itself
  origin.core->counts.has_schedule = has_schedule;
  origin.core->counts.is_one_a_read = !ledger || ledger->sensor.is_one_a_read;
  origin.core->counts.lost_is_known = ledger && ledger->sensor.lost_is_known;
  origin.ledger = std::move(ledger);
  origin.segments = std::move(segments);
  origins_.push_back(std::move(origin));
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
      // Those of one topic together: deliveries of several would go on side by side, and not in their order.
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
        wait_until(later(now, Duration{1}));  // what was given last is delivered before the end is told
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
  OriginCore& core = *origin.core;
  const Time time = from_nanoseconds(entry.time);
  if (entry.sequence <= core.sequence || time <= core.last_time) {
    return refuse("origin " + core.name + ", sequence " + std::to_string(entry.sequence) + ", " + to_iso8601(time) +
                  ": it is not after the one before it");
  }
  // What the recording dropped. Before its first event only an account tells what there was.
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
  core.topic.give_again(core, time, entry.sequence, jobs_[current_]->portion.payloads.data() + entry.at);
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
    char reason[96];
    change.kind = text<16>("sensor");
    change.name = text<200>(of->name);
    change.state = recorded.state == name_of(Health::ok)         ? Health::ok
                   : recorded.state == name_of(Health::degraded) ? Health::degraded
                                                                 : Health::faulted;
    change.reason = text<96>(std::string_view(reason, put_fitting(reason, sizeof reason, recorded.reason)));
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
  core.topic.tell_taps_of_change(core);
}

void ReplayNode::finish(const Result<void>& how) {
  give_health(INT64_MAX);
  for (Origin& origin : origins_) end_account(origin, how && counts_.refused == 0);
  is_done_ = true;
  loop()->deadlines.remove(*this);
  if (!how) {
    health_ = Health::faulted;
    reason_ = how.error().text();
    loop()->runtime.report(loop(), "replay " + config_.name, how.error());
  }
  if (std::exchange(has_ref_, false)) loop()->unref();
  tell_end(how && counts_.refused == 0);
  if (!how) own_->begin_absence(Gap::Kind::disconnected, how.error().id(), loop()->now());  // what would have followed
  if (on_done) on_done(how);                                                                // last: it may close this
}

void ReplayNode::tell_end(bool is_complete) {
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
    tell_end(false);
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
