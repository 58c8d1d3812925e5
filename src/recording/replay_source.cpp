#include "recording/replay_source.hpp"

#include <algorithm>
#include <cstring>
#include <mutex>
#include <set>

#include "data/saturating.hpp"
#include "recording/recording_file.hpp"

namespace rtdata::detail {
namespace {

constexpr std::size_t rows_at_once = 1024;
constexpr Duration end_tolerance = std::chrono::milliseconds{1};  // events at one time are put 1 ns apart
constexpr std::size_t bytes_at_once = std::size_t{256} << 10;

}  // namespace

std::string_view kept_reason(std::string_view text) {
  constexpr std::size_t most = 1000, longest = 200;
  static std::mutex mutex;
  static std::set<std::string, std::less<>> kept;  // never freed: accounts point into it
  if (text.size() > longest) return "several";
  const std::lock_guard lock(mutex);
  if (const auto found = kept.find(text); found != kept.end()) return *found;
  if (kept.size() == most) return "several";
  return *kept.emplace(text).first;
}

std::optional<Gap::Kind> gap_kind(std::string_view name) noexcept {
  for (const Gap::Kind kind :
       {Gap::Kind::missed, Gap::Kind::failed, Gap::Kind::disconnected, Gap::Kind::silent, Gap::Kind::joined}) {
    if (name == name_of(kind)) return kind;
  }
  return std::nullopt;
}

ReplaySource::ReplaySource(Recording recording, RowFilter filter, const std::vector<RecordedTopic>& topics,
                           const std::vector<ReplayOrigin>& origins, std::optional<Time> end)
    : recording_(std::move(recording)), filter_(std::move(filter)), end_(end) {
  for (const RecordedTopic& topic : topics) topics_.emplace_back(topic.topic, topic.version);
  for (const ReplayOrigin& origin : origins) origins_.emplace(origin, static_cast<std::uint32_t>(origins_.size()));
}

void ReplaySource::cancel() noexcept {
  is_cancelled_.store(true);
  ::sqlite3_interrupt(recording_.file()->database.raw());
}

void ReplaySource::read(ReplayPortion& portion) noexcept {
  portion.clear();
  try {
    read_rows(portion);
  } catch (const SetupError& error) {
    portion.error = error.error();
  } catch (const std::exception& error) {
    portion.error = Error{Errc::io_failed, "cannot read the recording", recording_.path(), error.what(), ""};
  }
  portion.is_last = portion.is_last || portion.error.has_value();
}

void ReplaySource::read_rows(ReplayPortion& portion) {
  if (!rows_ && is_cancelled_.load()) return;
  if (!rows_) {
    auto rows = recording_.rows(filter_).or_throw();
    rows_.emplace(std::move(rows));
  }
  while (portion.entries.size() < rows_at_once && portion.payloads.size() < bytes_at_once &&
         !is_cancelled_.load(std::memory_order_relaxed)) {
    auto next = rows_->next().or_throw();
    const RecordedRow* const row = next;
    portion.is_last = row == nullptr;
    if (portion.is_last) {
      rows_.reset();  // the recording is not held any longer
      break;
    }
    const std::int64_t time = to_nanoseconds(row->header().time);
    if (const RecordedGap* const gap = row->gap(); gap != nullptr) {
      const auto kind = gap_kind(gap->kind);
      const auto place = place_of({gap->topic, 0, {}, {}, 0});
      if (!kind || !place) continue;
      const std::uint32_t origin = origin_of(*place, gap->origin, portion);
      portion.entries.push_back({time, 0, origin, static_cast<std::uint32_t>(portion.gaps.size())});
      portion.gaps.push_back({*kind, kept_reason(gap->reason), gap->first, gap->last, gap->count});
      continue;
    }
    if (end_ && row->header().time > later(*end_, end_tolerance)) {
      throw SetupError(at_row(
          *recording_.file(), row->topic(), row->run(), row->header().origin, row->header().sequence,
          {Errc::damaged, "cannot replay", "time " + to_iso8601(row->header().time),
           "it is after the end of the run, " + to_iso8601(*end_), "see `rtdata verify`; `--until` leaves it out"}));
    }
    Topic& topic = topic_of(row->topic());
    if (topic.place == topics_.size()) {
      if (!is_chosen(row->topic().topic)) continue;
      throw SetupError({Errc::damaged, "cannot replay", recording_.path() + ", topic " + row->topic().topic,
                        "the run has rows with other fields, too", "see `rtdata verify`"});
    }
    if (topic.last_name != row->header().origin || topic.last_name.empty()) {
      topic.last = origin_of(topic.place, row->header().origin, portion);
      topic.last_name = row->header().origin;
    }
    // 0 is a gap, and no sequence of an event: the loop's side refuses one that is not above the last.
    const std::span<const std::byte> payload = row->event().payload();
    portion.entries.push_back({time, std::max<std::uint64_t>(row->header().sequence, 1), topic.last,
                               static_cast<std::uint32_t>(portion.payloads.size())});
    portion.payloads.insert(portion.payloads.end(), payload.begin(), payload.end());
  }
}

ReplaySource::Topic& ReplaySource::topic_of(const RecordedTopic& read_as) {
  for (Topic& topic : known_topics_)
    if (topic.read_as == &read_as) return topic;
  known_topics_.push_back({&read_as, place_of(read_as).value_or(topics_.size()), {}, 0});
  return known_topics_.back();
}

bool ReplaySource::is_chosen(std::string_view topic) const {
  return std::any_of(topics_.begin(), topics_.end(), [&](const auto& known) { return known.first == topic; });
}

/// Version 0: any version.
std::optional<std::size_t> ReplaySource::place_of(const RecordedTopic& topic) const {
  const auto found = std::find_if(topics_.begin(), topics_.end(), [&](const auto& known) {
    return known.first == topic.topic && (topic.version == 0 || known.second == topic.version);
  });
  if (found == topics_.end()) return std::nullopt;
  return static_cast<std::size_t>(found - topics_.begin());
}

std::uint32_t ReplaySource::origin_of(std::size_t topic, std::string_view name, ReplayPortion& portion) {
  ReplayOrigin origin{topic, std::string(name)};
  const auto next = static_cast<std::uint32_t>(origins_.size());
  const auto [found, is_new] = origins_.emplace(origin, next);
  if (is_new) portion.new_origins.push_back(std::move(origin));
  return found->second;
}

}  // namespace rtdata::detail
