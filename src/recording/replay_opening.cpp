// How a replay begins: the recording is opened, and its topics and origins are made on this loop.
#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include "loop/events/made_of.hpp"
#include "recording/replay_choice.hpp"
#include "recording/replay_node.hpp"
#include "recording/schema.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration no_limit = std::chrono::hours{24 * 365};

/// True if a replay of the whole run gives all that the account counts.
bool is_account_whole(const LedgerEntry& of) {
  return of.carried == 0 && of.sensor.published == of.offered && of.offered == of.stored + of.dropped();
}

}  // namespace

ReplayNode::ReplayNode(LoopCore& loop, ReplayConfig config)
    : SensorEntry(loop), config_(std::move(config)), callback_name_("replay " + config_.name) {
  if (!(config_.speed >= 1e-6 && config_.speed <= 1e6))
    throw SetupError(replay_refused("speed", "it is not from 0.000001 to 1000000", "use 1 for the recorded speed"));
  for (const std::string& text : config_.rename) renamings_.push_back(renaming_of(text).or_throw());
  RowFilter filter;
  filter.gaps = RowFilter::Gaps::in_place;
  const auto from = given_time("from", config_.from).or_throw(), until = given_time("until", config_.until).or_throw();
  if (from) filter.from = from->time;
  if (until) filter.until = until->time;
  if (from || until) filter.times = (from ? from : until)->line;
  if (from && until && (from->line != until->line || from->time > until->time))
    throw SetupError(replay_refused("from " + config_.from + ", until " + config_.until,
                                    "it ends before it begins, or one is UTC and the other in ns", "correct them"));
  Recording recording = Recording::open(config_.file).or_throw();
  run_ = chosen_run(recording, config_);
  filter.run = run_.run;
  base_ = beginning_of(recording, run_, config_);
  last_given_ = base_;
  const std::string from_utc = to_iso8601(recording.utc_line(run_.run).or_throw().utc(base_));
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
      "run " + std::to_string(run_.run) + " of " + config_.file + ", from " + from_utc +
          (goes_on ? "; it is still being recorded, or was not sealed: its present rows are replayed" : ""));
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

std::vector<std::string> ReplayNode::renamed(const std::vector<std::string>& topics) const {
  std::vector<std::string> all;
  for (const std::string& topic : topics) all.push_back(renamed(topic));
  return all;
}

void ReplayNode::choose_topics(const Recording& recording) {
  for (RecordedTopic& topic : chosen_topics(recording, config_, run_.run)) {
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
  // Rows are selected by one pattern. With several patterns all rows are read, and the others skipped.
  filter.topic = topics_.size() == 1          ? topics_.front().recorded.topic
                 : config_.topics.size() == 1 ? config_.topics.front()
                                              : "#";
  const bool is_whole = is_aligned_ && run_.state == RunState::closed && !filter.from && !filter.until;
  std::map<std::pair<std::string, std::string>, std::vector<Segment>> segments;
  for (RecordedSegment& of : recording.schedule(run_.run).or_throw())
    segments[{of.topic, of.origin}].push_back(of.segment);
  std::vector<LedgerEntry> ledger = recording.ledger(run_.run).or_throw();
  const auto chosen = [&](const std::string& name) {
    return std::find_if(topics_.begin(), topics_.end(), [&](const Topic& of) { return of.recorded.topic == name; });
  };
  bool has_all = is_whole && find_sources(recording, ledger, segments);
  for (LedgerEntry& entry : ledger) {
    const auto topic = chosen(entry.topic);
    if (topic == topics_.end()) continue;
    ReplayOrigin origin{static_cast<std::size_t>(topic - topics_.begin()), entry.origin};
    auto& of_origin = segments[{entry.topic, entry.origin}];
    const bool is_replayed = is_whole && is_account_whole(entry);
    has_all = has_all && is_replayed;
    add_origin(origin, is_replayed ? std::optional(std::move(entry)) : std::nullopt, std::move(of_origin));
    known.push_back(std::move(origin));
  }
  if (has_all) return;
  loop()->runtime.log(
      LogLevel::info, "replay " + config_.name,
      std::string(!is_aligned_                     ? "the loop's time is not that of the run"
                  : run_.state == RunState::closed ? "it is not replayed as a whole"
                                                   : "the run was not closed") +
          ": if you record this replay, the new recording has no schedule, and its gaps have the kind `silent`");
}

bool ReplayNode::find_sources(const Recording& recording, const std::vector<LedgerEntry>& ledger,
                              std::map<std::pair<std::string, std::string>, std::vector<Segment>>& segments) {
  const auto is_chosen = [&](const std::string& topic) {
    return std::any_of(config_.topics.begin(), config_.topics.end(),
                       [&](const std::string& pattern) { return topic_matches(pattern, topic); });
  };
  std::set<std::string> given, wanted;
  for (const Topic& topic : topics_) given.insert(topic.recorded.topic);
  for (const LedgerEntry& entry : ledger)
    if (is_chosen(entry.topic) && !given.contains(entry.topic)) wanted.insert(entry.topic);
  for (bool has_more = true; has_more;) {
    has_more = false;
    for (const LedgerEntry& entry : ledger) {
      if (!given.contains(entry.topic) && !wanted.contains(entry.topic)) continue;
      for (const std::string& source : entry.made_of)
        has_more = (!given.contains(source) && wanted.insert(source).second) || has_more;
    }
  }
  if (wanted.empty()) return true;
  bool has_all = true;
  const std::vector<RecordedGap> gaps = recording.gaps(run_.run).or_throw();
  for (const LedgerEntry& entry : ledger) {
    if (!wanted.contains(entry.topic)) continue;
    const bool has_no_rows = is_chosen(entry.topic);
    if (has_no_rows ? !is_account_whole(entry) : entry.carried != 0) {
      has_all = false;
      continue;
    }
    Source& source = sources_.emplace_back(Source{entry, std::move(segments[{entry.topic, entry.origin}]), {}});
    if (!has_no_rows) {  // what was recorded of it is not given
      SensorCounts& counts = source.ledger.sensor;
      counts.filtered += std::exchange(counts.published, 0);
      source.ledger.first_sequence = source.ledger.last_sequence = 0;
      source.ledger.stored = source.ledger.pruned = 0;
    }
    for (const RecordedGap& gap : gaps) {
      const auto kind = gap_kind(gap.kind);
      if (kind && gap.topic == entry.topic && gap.origin == entry.origin)
        source.gaps.push_back({*kind, kept_reason(gap.reason), gap.first, gap.last, gap.count});
    }
  }
  return has_all;
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
  if (ledger && !ledger->made_of.empty()) set_made_of(*origin.core, renamed(ledger->made_of));
  origin.ledger = std::move(ledger);
  origin.segments = std::move(segments);
  origins_.push_back(std::move(origin));
}

}  // namespace rtdata::detail
