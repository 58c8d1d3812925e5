// The summary of each topic of a run: rows, rates, lateness, losses.
#include <algorithm>
#include <array>
#include <bit>
#include <map>

#include "data/saturating.hpp"
#include "recording/recorded_outages.hpp"
#include "recording/recording_file.hpp"
#include "recording/verify_run.hpp"

namespace rtdata {
namespace {

/// Durations counted in buckets of at most 1/64 of their value: percentiles without keeping the values.
class Histogram {
 public:
  void add(Duration value) {
    const auto ns = static_cast<std::uint64_t>(std::max<std::int64_t>(0, value.count()));
    ++counts_[bucket_of(ns)];
    ++total_;
    largest_ = std::max(largest_, ns);
  }
  std::uint64_t total() const noexcept { return total_; }
  Duration largest() const noexcept { return Duration{static_cast<std::int64_t>(largest_)}; }
  /// The value below which this part of all values lies.
  Duration percentile(double part) const {
    auto wanted = static_cast<std::uint64_t>(part * static_cast<double>(total_));
    if (static_cast<double>(wanted) < part * static_cast<double>(total_)) ++wanted;
    std::uint64_t seen = 0;
    for (std::size_t i = 0; i < counts_.size(); ++i) {
      seen += counts_[i];
      if (seen >= wanted && seen != 0) return Duration{static_cast<std::int64_t>(std::min(end_of(i), largest_))};
    }
    return largest();
  }

 private:
  static constexpr unsigned sub_bits = 6;
  static std::size_t bucket_of(std::uint64_t ns) {
    if (ns < (1u << sub_bits)) return static_cast<std::size_t>(ns);
    const auto shift = static_cast<unsigned>(std::bit_width(ns)) - sub_bits - 1;
    return (static_cast<std::size_t>(shift) << sub_bits) + static_cast<std::size_t>(ns >> shift);
  }
  /// The largest value of a bucket.
  static std::uint64_t end_of(std::size_t bucket) {
    if (bucket < (2u << sub_bits)) return bucket;
    const std::size_t shift = (bucket >> sub_bits) - 1;
    return ((std::uint64_t{bucket} - (shift << sub_bits) + 1) << shift) - 1;
  }
  std::array<std::uint64_t, (64 - sub_bits + 1) << sub_bits> counts_{};
  std::uint64_t total_ = 0;
  std::uint64_t largest_ = 0;
};

struct OriginTimes {
  std::vector<Segment> segments;
  std::size_t current = 0;
  std::int64_t rows_up_to = 0;         // of its last account, while it is recorded
  Time accounted_until = Time::max();  // after a power cut there are rows beyond the last account's schedule
  std::uint64_t pruned = 0;
  std::uint64_t rows = 0, accounted_rows = 0;
  Time first = Time::max(), last = Time::min();

  /// The segment that a time belongs to, or null. Times ascend, so it is mostly that of the time before.
  const Segment* segment_of(Time time) {
    if (segments.empty()) return nullptr;
    if (time < segments[current].first_due ||
        (current + 1 < segments.size() && time >= segments[current + 1].first_due)) {
      const auto after = std::upper_bound(segments.begin(), segments.end(), time,
                                          [](Time t, const Segment& s) { return t < s.first_due; });
      if (after == segments.begin()) return nullptr;
      current = static_cast<std::size_t>(after - segments.begin()) - 1;
    }
    return &segments[current];
  }
};

struct TopicTimes {
  TopicSummary summary;
  std::map<std::string, OriginTimes, std::less<>> origins;
  Histogram lateness;
};

void scan(const detail::RecordingFile& file, const RecordedTopic& topic, std::int64_t run, TopicTimes& into) {
  auto statement = file.prepare("SELECT t.time, t.origin, t._rowid_ FROM " + sqlite::quoted(topic.table) +
                                " t WHERE t.run = ? ORDER BY t._rowid_");
  statement.bind(1, run);
  OriginTimes* current = nullptr;
  std::string_view name;
  while (statement.step()) {
    const std::int64_t ns = statement.integer(0);
    const std::string_view origin = statement.text(1);
    if (current == nullptr || name != origin) {
      auto found = into.origins.find(origin);
      if (found == into.origins.end()) found = into.origins.emplace(std::string(origin), OriginTimes{}).first;
      current = &found->second;
      name = found->first;
    }
    const Time time = from_nanoseconds(ns);
    ++current->rows;
    if (statement.integer(2) <= current->rows_up_to && time < current->accounted_until) ++current->accounted_rows;
    current->first = std::min(current->first, time);
    current->last = std::max(current->last, time);
    TopicSummary& summary = into.summary;
    ++summary.rows;
    if (!summary.first || time < *summary.first) summary.first = time;
    if (!summary.last || time > *summary.last) summary.last = time;
    if (const Segment* segment = current->segment_of(time); segment != nullptr && segment->period.count() > 0) {
      into.lateness.add((time - segment->first_due) % segment->period);
    }
  }
}

/// `length`: of the run, when it was closed.
void add_rates(TopicTimes& topic, Duration length) {
  for (const auto& [name, origin] : topic.origins) {
    double seconds = 0, ticks = 0;
    for (const Segment& segment : origin.segments) {
      ticks += static_cast<double>(segment.scheduled);
      seconds += static_cast<double>(segment.scheduled) * static_cast<double>(segment.period.count()) / 1e9;
    }
    if (seconds > 0) {
      topic.summary.wanted_hertz += ticks / seconds;
      topic.summary.reached_hertz += static_cast<double>(origin.accounted_rows + origin.pruned) / seconds;
    } else if (length.count() > 0) {
      topic.summary.reached_hertz += static_cast<double>(origin.rows + origin.pruned) * 1e9 /
                                     static_cast<double>(length.count());
    } else if (origin.last > origin.first) {
      topic.summary.reached_hertz += static_cast<double>(origin.rows - 1) * 1e9 /
                                     static_cast<double>((origin.last - origin.first).count());
    }
  }
}

}  // namespace

Result<std::vector<TopicSummary>> summary(const Recording& recording, std::int64_t run) try {
  const detail::Snapshot snapshot(recording.file());
  auto of_run = detail::OfRun::load(recording, run);
  auto recorded = recording.topics().or_throw();
  auto runs = recording.runs().or_throw();
  Duration length{0};
  bool is_ended = false;
  bool is_complete = false;
  for (const RunInfo& info : runs) {
    if (info.run != run) continue;
    is_ended = info.state != RunState::recording;
    is_complete = is_ended && detail::is_account_known(info);
    if (is_complete && info.ended) length = *info.ended - info.started;
  }
  std::map<std::string, TopicTimes> topics;
  for (const LedgerEntry& entry : of_run.ledger) {
    TopicTimes& topic = topics[entry.topic];
    OriginTimes& origin = topic.origins[entry.origin];
    origin.rows_up_to = is_ended ? INT64_MAX : entry.rows_up_to;
    origin.pruned = entry.pruned;
    TopicSummary& sum = topic.summary;
    sum.published += entry.sensor.published;
    sum.missed += entry.sensor.missed;
    sum.failed += entry.sensor.failed;
    sum.unreadable += entry.sensor.unreadable;
    sum.repeated += entry.sensor.repeated;
    sum.late += entry.sensor.late;
    sum.first_lines += entry.sensor.first_lines;
    sum.dropped += entry.dropped();
    sum.pruned += entry.pruned;
    if (!entry.sensor.has_schedule)
      sum.outages.add(detail::outages_of(of_run.gaps_in(detail::origin_key(entry.topic, entry.origin))));
    if (entry.sensor.lost_is_known) sum.lost = sum.lost.value_or(0) + entry.sensor.lost;
  }
  for (auto& [topic, made_of_it] : detail::made_of_unrecorded(of_run.ledger))
    topics[topic].summary.made_of_it = std::move(made_of_it);
  for (const RecordedSegment& segment : of_run.schedule)
    topics[segment.topic].origins[segment.origin].segments.push_back(segment.segment);
  for (auto& [name, topic] : topics) {
    for (auto& [origin_name, origin] : topic.origins) {
      if (!is_ended || is_complete || origin.segments.empty()) continue;
      origin.accounted_until = detail::later(origin.segments.back().end, origin.segments.back().period);
    }
  }
  for (const RecordedTopic& topic : recorded) scan(*recording.file(), topic, run, topics[topic.topic]);
  std::vector<TopicSummary> summaries;
  for (auto& [name, topic] : topics) {
    if (topic.origins.empty()) continue;
    TopicSummary& sum = topic.summary;
    sum.topic = name;
    sum.origins = topic.origins.size();
    sum.is_complete = is_complete;
    add_rates(topic, length);
    if (topic.lateness.total() != 0) {
      sum.has_lateness = true;
      sum.lateness_p50 = topic.lateness.percentile(0.5);
      sum.lateness_p99 = topic.lateness.percentile(0.99);
      sum.lateness_max = topic.lateness.largest();
    }
    summaries.push_back(std::move(sum));
  }
  return summaries;
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace rtdata
