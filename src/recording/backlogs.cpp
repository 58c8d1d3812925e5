// The backlogs of sinks with `through`, from their positions in the file.
#include <algorithm>
#include <iterator>
#include <utility>

#include "recording/database.hpp"
#include "recording/positions.hpp"
#include "recording/recording_file.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata {
namespace {

using sqlite::Position;
using sqlite::quoted;

struct Stored {
  std::string sink, table, host;
  Position position;
};

std::vector<Stored> positions_in(const detail::RecordingFile& file) {
  std::vector<Stored> stored;
  auto query = file.prepare(
      "SELECT sink, table_name, host, row, run, origin, sequence FROM rtdata_position ORDER BY sink, table_name");
  while (query.step()) {
    stored.push_back({std::string(query.text(0)),
                      std::string(query.text(1)),
                      std::string(query.text(2)),
                      {query.integer(3), query.integer(4), std::string(query.text(5)), query.integer(6)}});
  }
  return stored;
}

/// Adds tables of a sink's topics without a position: all their rows wait.
std::vector<Stored> with_other_tables(std::vector<Stored> stored, const std::vector<RecordedTopic>& topics) {
  std::vector<Stored> all;
  for (auto one = stored.begin(); one != stored.end();) {  // sorted by sink
    const auto end = std::find_if(one, stored.end(), [&](const Stored& other) { return other.sink != one->sink; });
    for (const RecordedTopic& topic : topics) {
      const auto is_of_table = [&](const Stored& other) { return other.table == topic.table; };
      if (one->table == sqlite::no_table && sqlite::has_topic(one->position.origin, topic.topic) &&
          std::none_of(one, end, is_of_table))
        all.push_back({one->sink, topic.table, one->host, {}});
    }
    std::move(one, end, std::back_inserter(all));
    one = end;
  }
  return all;
}

}  // namespace

Result<std::vector<RecordedBacklog>> Recording::backlogs() const try {
  std::vector<RecordedBacklog> backlogs;
  const auto number = [&](const std::string& sql) { return file_->database.integer(sql); };
  const auto count_of = [&](const std::string& sink, const char* sql) {
    auto query = file_->prepare(sql);
    query.bind(1, sink);
    query.step();
    return static_cast<std::uint64_t>(query.integer(0));
  };
  auto stored = positions_in(*file_);
  auto topics = this->topics().or_throw();
  for (Stored& one : with_other_tables(std::move(stored), topics)) {
    if (backlogs.empty() || backlogs.back().sink != one.sink) {
      RecordedBacklog& made = backlogs.emplace_back();
      made.sink = one.sink;
      made.host = one.host;
      auto kept = count_of(one.sink, "SELECT count(*) FROM rtdata_refused WHERE sink = ?");
      made.refused_keys = kept;
      made.refused = kept + count_of(one.sink, "SELECT total(count) FROM rtdata_refused_before WHERE sink = ?");
      made.unsent = count_of(one.sink, "SELECT total(count) FROM rtdata_unsent WHERE sink = ?");
    }
    RecordedBacklog& backlog = backlogs.back();
    for (const RecordedTopic& topic : topics) {
      if (topic.table != one.table) continue;
      auto after = sqlite::row_of(file_->database, one.table, one.position);
      const std::string rows = " FROM " + quoted(one.table) + " WHERE _rowid_ > " + std::to_string(after);
      auto waits = number("SELECT count(*)" + rows);
      if (waits == 0) continue;
      backlog.events += static_cast<std::uint64_t>(waits);
      backlog.bytes += static_cast<std::uint64_t>(waits) * topic.description->size();
      auto oldest = file_->prepare("SELECT run, time" + rows + " ORDER BY _rowid_ LIMIT 1");
      if (!oldest.step()) continue;
      auto line = utc_line(oldest.integer(0));
      const Time recorded = from_nanoseconds(oldest.integer(1));
      const Time time = line ? line->utc(recorded) : recorded;
      backlog.oldest = backlog.oldest ? std::min(*backlog.oldest, time) : time;
    }
  }
  return backlogs;
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace rtdata
