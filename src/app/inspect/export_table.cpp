#include "app/inspect/export_table.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <map>
#include <ostream>
#include <string_view>
#include <utility>

#include "recording/recording_file.hpp"
#include "rtdata/data/value.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::app {
namespace {

[[noreturn]] void refuse(Errc code, const Recording& recording, std::string why, std::string advice) {
  throw SetupError({code, "cannot export", recording.path(), std::move(why), std::move(advice)});
}

struct Column {
  std::string path, unit;
};

/// True if it has events in the run, or in any of them if none is chosen.
bool has_events(const Recording& recording, const RecordedTopic& topic, const std::optional<std::int64_t>& run) {
  if (!run) return true;
  auto any = recording.file()->prepare("SELECT EXISTS(SELECT 1 FROM " + sqlite::quoted(topic.table) +
                                       " WHERE run = ?)");
  any.bind(1, *run).step();
  return any.integer(0) != 0;
}

/// Of each topic the descriptions that the chosen run has events of, or the last.
std::vector<RecordedTopic> topics_of(const Recording& recording, const std::optional<std::int64_t>& run) {
  const std::vector<RecordedTopic> topics = recording.topics().or_throw();
  std::vector<RecordedTopic> chosen;
  for (auto next = topics.begin(); next != topics.end();) {  // those of one topic stand together
    const auto end = std::find_if(next, topics.end(),
                                  [&](const RecordedTopic& other) { return other.topic != next->topic; });
    const auto last = std::prev(end);
    for (; next != end; ++next) {
      const bool is_left = next == last && (chosen.empty() || chosen.back().topic != next->topic);
      if (is_left || has_events(recording, *next, run)) chosen.push_back(*next);
    }
  }
  return chosen;
}

/// The columns of a topic, in all of its descriptions.
std::vector<Column> columns_of_topic(const Recording& recording, const std::vector<RecordedTopic>& topics,
                                     const std::string& topic) {
  std::vector<Column> columns;
  for (const RecordedTopic& one : topics) {
    if (one.topic != topic) continue;
    for (const Leaf& leaf : one.description->leaves()) {
      const auto same = std::find_if(columns.begin(), columns.end(),
                                     [&](const Column& column) { return column.path == leaf.path; });
      if (same == columns.end()) {
        columns.push_back({leaf.path, leaf.unit});
      } else if (same->unit != leaf.unit) {
        refuse(Errc::bad_argument, recording, "the unit of " + topic + "." + leaf.path + " changed",
               "choose a run in which it has one unit by --run, or export it without --join, --separator, --decimal, "
               "--digits and --time");
      }
    }
  }
  return columns;
}

/// Writes cells and rows.
class TableWriter {
 public:
  explicit TableWriter(const TableFormat& format) : format_(format) {}
  /// Begins another cell of the row.
  void next_cell() {
    if (std::exchange(has_cells_, true)) text += format_.separator;
  }
  void end_row() {
    text += '\n';
    has_cells_ = false;
  }
  void put_text(std::string_view cell, bool is_value = false) {
    const bool needs_quotes = cell.find_first_of("\"\r\n") != std::string_view::npos ||
                              cell.find(format_.separator) != std::string_view::npos || (is_value && cell.empty());
    if (!needs_quotes) {
      text += cell;
      return;
    }
    text += '"';
    for (const char c : cell) text.append(c == '"' ? 2 : 1, c);
    text += '"';
  }
  template <class Number>
  void put_number(Number number) {
    std::array<char, 400> digits;  // a double has 309 before the mark
    if (std::isnan(number)) {
      text += "nan";  // its sign has no meaning
      return;
    }
    char* const end = format_.digits < 0 || std::isinf(number)
                          ? std::to_chars(digits.data(), digits.data() + digits.size(), number).ptr
                          : std::to_chars(digits.data(), digits.data() + digits.size(), number,
                                          std::chars_format::fixed, format_.digits)
                                .ptr;
    put_digits({digits.data(), static_cast<std::size_t>(end - digits.data())});
  }
  /// Exact: all decimals.
  void put_seconds(Duration time) {
    const std::int64_t ns = time.count();
    const auto size = ns < 0 ? std::uint64_t{0} - static_cast<std::uint64_t>(ns) : static_cast<std::uint64_t>(ns);
    constexpr std::uint64_t second = 1'000'000'000;
    std::string decimals = std::to_string(second + size % second).substr(1);
    decimals.erase(decimals.find_last_not_of('0') + 1);
    put_digits((ns < 0 ? "-" : "") + std::to_string(size / second) + (decimals.empty() ? "" : "." + decimals));
  }
  void put_leaf(const Leaf& leaf, const std::byte* payload) {
    const Value value = read(leaf, payload);
    if (std::holds_alternative<std::monostate>(value)) return;
    if (const double* number = std::get_if<double>(&value)) {
      leaf.kind == rtdata::Kind::f32 ? put_number(static_cast<float>(*number)) : put_number(*number);
    } else {
      put_text(to_string(value), true);
    }
  }

  std::string text;

 private:
  /// A number as C++ writes it, with the chosen decimal mark.
  void put_digits(std::string_view digits) {
    std::string number(digits);
    if (number.starts_with('-') && number.find_first_not_of("-0.") == std::string::npos) number.erase(0, 1);
    std::replace(number.begin(), number.end(), '.', format_.decimal);
    put_text(number);
  }

  const TableFormat& format_;
  bool has_cells_ = false;
};

/// A joined topic: its last event at or before each row.
class JoinedTopic {
 public:
  JoinedTopic(std::string topic, std::vector<Column> columns, Rows rows)
      : topic_(std::move(topic)), columns_(std::move(columns)), rows_(std::move(rows)) {
    next_ = rows_.next().or_throw();
  }
  const std::string& topic() const noexcept { return topic_; }
  const std::vector<Column>& columns() const noexcept { return columns_; }

  /// Must be called in the order of runs and times.
  void advance_to(std::int64_t run, Time time) {
    while (next_ != nullptr && (next_->run() < run || (next_->run() == run && next_->header().time <= time))) {
      const EventView event = next_->event();
      run_ = next_->run();
      time_ = next_->header().time;
      description_ = next_->topic().description;
      payload_.assign(event.payload().begin(), event.payload().end());
      next_ = rows_.next().or_throw();
    }
  }
  bool has(std::int64_t run, Time time, const std::optional<Duration>& within) const {
    return description_ != nullptr && run_ == run && (!within || time - time_ <= *within);
  }
  const Description& description() const noexcept { return *description_; }
  const std::byte* payload() const noexcept { return payload_.data(); }

 private:
  const std::string topic_;
  const std::vector<Column> columns_;
  Rows rows_;
  const RecordedRow* next_ = nullptr;
  std::int64_t run_ = 0;
  Time time_{};
  std::shared_ptr<const Description> description_;  // null: no event yet
  std::vector<std::byte> payload_;
};

/// The topic of the rows, among those that the filter takes.
std::string topic_of_rows(const Recording& recording, const std::vector<RecordedTopic>& topics,
                          const RowFilter& filter) {
  std::string topic;
  bool has_rows = false;
  for (const RecordedTopic& one : topics) {
    if (!topic_matches(filter.topic, one.topic) || one.topic == topic) continue;
    const bool has_its_rows = one.topic == filter.topic || has_events(recording, one, filter.run);
    if (!topic.empty() && !has_its_rows) continue;
    if (std::exchange(has_rows, has_its_rows))
      refuse(Errc::bad_argument, recording,
             "a table can have the rows of only one topic, but there are " + topic + " and " + one.topic,
             "choose one by --topic; --join adds columns of others");
    topic = one.topic;
  }
  return topic;
}

}  // namespace

Result<ExportCount> export_table(const Recording& recording, const ExportConfig& config, const TableFormat& format,
                                 std::ostream& out) try {
  const std::vector<RecordedTopic> topics = topics_of(recording, config.filter.run);
  const std::string topic = topic_of_rows(recording, topics, config.filter);
  const std::vector<Column> columns = columns_of_topic(recording, topics, topic);
  std::vector<JoinedTopic> joined;
  for (const std::string& name : format.join) {
    if (name == topic ||
        std::any_of(joined.begin(), joined.end(), [&](const auto& one) { return one.topic() == name; }))
      refuse(Errc::bad_argument, recording, "--join " + name + ": the topic is in the table already", "");
    auto of_topic = columns_of_topic(recording, topics, name);
    if (of_topic.empty())
      refuse(Errc::not_found, recording, "--join " + name + ": it has no such topic",
             "see `rtdata info " + recording.path() + "`");
    joined.emplace_back(name, std::move(of_topic),
                        recording.rows({.topic = name, .run = config.filter.run}).or_throw());
  }
  const bool is_utc = config.time == ExportTime::utc;
  const bool has_units = config.header == ExportConfig::Header::names_and_units;
  const bool has_runs = !config.filter.run && recording.runs().or_throw().size() > 1;
  TableWriter table(format);
  const auto put_heading = [&](const std::string& name, const std::string& unit) {
    table.next_cell();
    table.put_text(has_units && !unit.empty() ? name + " [" + unit + "]" : name);
  };
  put_heading(format.has_seconds ? "seconds"
              : is_utc           ? "utc"
                                 : "time",
              format.has_seconds                                        ? "s"
              : config.time_text == ExportConfig::TimeText::nanoseconds ? "ns"
                                                                        : "");
  put_heading("origin", "");
  put_heading("sequence", "");
  if (has_runs) put_heading("run", "");
  for (const Column& column : columns) put_heading(column.path, column.unit);
  for (const JoinedTopic& one : joined)
    for (const Column& column : one.columns()) put_heading(one.topic() + "." + column.path, column.unit);
  table.end_row();

  const auto put_cells = [&](const std::vector<Column>& of, const Description* description, const std::byte* payload) {
    for (const Column& column : of) {
      table.next_cell();
      const Leaf* const leaf = description == nullptr ? nullptr : description->find(column.path);
      if (leaf != nullptr) table.put_leaf(*leaf, payload);
    }
  };
  constexpr std::size_t flush_bytes = std::size_t{1} << 18;
  const auto flush = [&] {
    if (!out.write(table.text.data(), static_cast<std::streamsize>(table.text.size())) || !out.flush())
      throw SetupError(system_error(errno == 0 ? EIO : errno, "cannot write the export", "standard output", ""));
    table.text.clear();
  };
  Rows rows = recording.rows(config.filter).or_throw();
  std::map<std::int64_t, UtcLine> lines;
  std::optional<std::int64_t> run;
  Time start = format.start.value_or(Time{});
  ExportCount count;
  while (const RecordedRow* const row = rows.next().or_throw()) {
    const Time recorded = row->header().time;
    Time time = recorded;
    if (is_utc) {
      auto line = lines.find(row->run());
      if (line == lines.end()) line = lines.emplace(row->run(), recording.utc_line(row->run()).or_throw()).first;
      time = line->second.utc(recorded);
    }
    if (run != row->run() && !format.start) start = time;
    run = row->run();
    table.next_cell();
    if (format.has_seconds) {
      table.put_seconds(time - start);
    } else {
      table.put_text(config.time_text == ExportConfig::TimeText::iso8601 ? to_iso8601(time)
                                                                         : std::to_string(to_nanoseconds(time)));
    }
    table.next_cell();
    table.put_text(row->header().origin);
    table.next_cell();
    table.put_text(std::to_string(row->header().sequence));
    if (has_runs) {
      table.next_cell();
      table.put_text(std::to_string(row->run()));
    }
    put_cells(columns, row->topic().description.get(), row->event().payload().data());
    for (JoinedTopic& one : joined) {
      one.advance_to(row->run(), recorded);
      const bool has_event = one.has(row->run(), recorded, format.within);
      put_cells(one.columns(), has_event ? &one.description() : nullptr, one.payload());
    }
    table.end_row();
    ++count.rows;
    if (table.text.size() < flush_bytes) continue;
    flush();
    if (config.on_progress) config.on_progress({count.rows, time});
  }
  flush();
  return count;
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace rtdata::app
