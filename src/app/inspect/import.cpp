// rtdata import: makes a recording from a table, to verify, read and export it like any other recording.
#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <ostream>
#include <span>
#include <string_view>
#include <vector>

#include "app/core/recording_commands.hpp"
#include "app/inspect/import_columns.hpp"
#include "app/inspect/import_rows.hpp"
#include "app/inspect/import_time.hpp"
#include "data/nearest.hpp"
#include "data/saturating.hpp"
#include "data/utf8.hpp"
#include "rtdata/loop/clock.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata::app {
namespace {

/// The structure of the table, found by reading it once.
struct Found {
  std::vector<ImportColumn> columns;  // all of the file
  std::size_t time_column = 0;
  Time first{}, last{};  // the earliest, the latest
  std::uint64_t rows = 0;
  std::shared_ptr<const Description> description;
};

/// How to write a separator on the command line.
std::string shown_separator(char separator) { return separator == '\t' ? "tab" : std::string("\"") + separator + "\""; }

/// The option for the probable separator, if the given one is wrong. Empty: unknown.
std::string separator_advice(const ImportOptions& options, char said) {
  ImportRows table(options.file, said);
  std::string head, row;
  table.next_line(head);
  table.next_line(row);
  const auto count = [](const std::string& text, char c) { return std::count(text.begin(), text.end(), c); };
  char best = said;
  for (const char one : {',', ';', '\t', '|'})
    if (one != said && count(head, one) > count(head, best) && count(head, one) <= count(row, one)) best = one;
  if (best == said) return {};
  std::string advice = "its columns seem to be separated by " + shown_separator(best) + ": write --separator " +
                       shown_separator(best);
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  for (std::size_t i = 1; best != ',' && options.decimal.empty() && i + 1 < row.size(); ++i) {
    if (row[i] != ',' || !is_digit(row[i - 1]) || !is_digit(row[i + 1])) continue;
    const std::size_t before = row.find_last_of(std::string("\"") + best, i),
                      end = row.find_first_of(std::string("\"\r") + best, i);
    if (!may_have_thousands(row.substr(before + 1, end - before - 1))) return advice + " --decimal ,";
  }
  return advice;
}

[[noreturn]] void refuse(std::string where, std::string why, std::string advice) {
  throw SetupError(import_refused(std::move(where), std::move(why), std::move(advice)));
}

void check_text(const ImportRows& table, const ImportColumn& column, const std::string& text, const std::string& file) {
  if (detail::is_readable(text)) return;
  refuse(table.where(),
         "the text \"" + detail::readable(text.substr(0, 40)) + "\" in column " + column.heading + " is not UTF-8",
         "convert the file: iconv -f WINDOWS-1252 -t UTF-8 " + file);
}

Found look_at(const ImportOptions& options, const ImportNotation& notation) {
  ImportRows table(options.file, notation.separator);
  if (!table.is_open())
    throw SetupError(system_error(errno, "cannot read", options.file, "give the path of a CSV file"));
  std::vector<detail::CsvCell> cells;
  if (!table.next(cells).or_throw()) refuse(options.file, "it is empty", "its first row names the columns");
  Found found;
  std::vector<std::string_view> headings;
  for (const detail::CsvCell& cell : cells) {
    if (!detail::is_readable(cell.text))
      refuse(table.where(), "the heading \"" + detail::readable(cell.text.substr(0, 40)) + "\" is not UTF-8",
             "convert the file: iconv -f WINDOWS-1252 -t UTF-8 " + options.file);
    ImportColumn& column = found.columns.emplace_back();
    column.heading = cell.text;
    column.decimal = notation.decimal;
  }
  for (const ImportColumn& column : found.columns) headings.push_back(column.heading);
  const auto is_it = [&](std::string_view heading) {  // with its unit or without
    return heading == options.time_column || heading.substr(0, heading.find(" [")) == options.time_column;
  };
  const auto exact = std::count(headings.begin(), headings.end(), options.time_column);
  const auto matching = std::count_if(headings.begin(), headings.end(), is_it);
  if (exact > 1 || (exact == 0 && matching > 1))
    refuse(options.file, "it has " + std::to_string(std::max(exact, matching)) + " columns " + options.time_column,
           exact > 1 ? "give one of them another heading" : "write --time with the unit, as its heading has it");
  const auto at = exact == 1 ? std::find(headings.begin(), headings.end(), options.time_column)
                             : std::find_if(headings.begin(), headings.end(), is_it);
  if (at == headings.end()) {
    const std::string advice = separator_advice(options, notation.separator);
    refuse(options.file, "it has no column " + options.time_column,
           advice.empty() ? detail::suggestion(options.time_column, headings) : advice);
  }
  found.time_column = static_cast<std::size_t>(at - headings.begin());
  name_columns(found.columns);
  Time before{};  // of the row above
  while (table.next(cells).or_throw()) {
    if (cells.size() != found.columns.size())
      refuse(table.where(),
             std::to_string(cells.size()) + " cells, where the first row has " + std::to_string(found.columns.size()),
             "");
    const std::string& when = cells[found.time_column].text;
    const auto time = time_of(when, notation);
    if (!time) {
      double number = 0;
      const bool is_beyond = is_number(when, notation.decimal, number) && std::isfinite(number);
      ImportNotation without_start = notation;
      without_start.start = Time{};
      const bool is_start = is_beyond && time_of(when, without_start);
      const bool has_comma = options.decimal.empty() && when.find(',') != std::string::npos &&
                             is_number(when, ',', number) && !may_have_thousands(when);
      const bool has_date = when.size() >= 10 && when[4] == '-' && when[7] == '-';
      refuse(table.where(),
             "\"" + detail::readable(when.substr(0, 64)) + "\" in column " + options.time_column + " is not a time" +
                 (is_beyond  ? " that can be recorded, which are those from 1678 to 2261"
                  : has_date ? ": " + time.error().why
                             : ""),
             is_start                                   ? "check --start"
             : is_beyond                                ? "check --scale" + scale_of(number)
             : has_comma                                ? "its numbers have decimal commas: write --decimal ,"
             : has_date && !time.error().advice.empty() ? time.error().advice
                                                        : "a number, or a time as 2026-03-01T12:00:00Z");
    }
    if (found.rows++ == 0) found.first = found.last = before = *time;
    if (*time < before)
      refuse(table.where(),
             "\"" + detail::readable(when.substr(0, 64)) + "\" in column " + options.time_column +
                 " is before the time of the row above it",
             "sort the rows by time: a table with the newest row first is turned round by "
             "(head -n 1 " +
                 options.file + "; tail -n +2 " + options.file + " | tac)");
    before = *time;
    found.first = std::min(found.first, *time);
    found.last = std::max(found.last, *time);
    for (std::size_t i = 0; i < cells.size(); ++i) {
      check_text(table, found.columns[i], cells[i].text, options.file);
      found.columns[i].look_at(cells[i]);
    }
  }
  if (found.rows == 0) refuse(options.file, "it has no rows", "");
  if (detail::span_between(found.first, found.last) == Duration::max())
    refuse(options.file, "its times span more than 292 years", "check --scale");
  for (ImportColumn& column : found.columns) {
    column.look_at_all();
    if (options.decimal.empty() && column.seems_to_have_decimal_commas())
      refuse(options.file, "the numbers in column " + column.heading + " seem to have decimal commas",
             "write --decimal , or, if they are texts, --decimal .");
    if (options.decimal.empty() && column.seems_to_have_thousands())
      refuse(options.file,
             "the numbers in column " + column.heading +
                 " have commas before three digits, which may be "
                 "thousands or decimals",
             "if they are thousands, take them out of the file (1,234 becomes 1234); if they are decimals, "
             "write --decimal , and if they are texts, --decimal .");
  }
  found.description = describe_columns(found.columns, found.time_column, options.file).or_throw();
  const TopicToRecord topic{options.topic, found.description.get()};
  const auto refusals = refused_topics(SqliteConfig{.path = options.database}, std::span(&topic, 1));
  if (!refusals.empty()) refuse(options.file, refusals.front().why, refusals.front().advice);
  return found;
}

/// Records the rows and returns their number. `moved`: how many got a later time than in the file.
std::uint64_t record(const ImportOptions& options, const Found& found, const ImportNotation& notation,
                     std::uint64_t& moved) {
  ManualClock clock(found.first - Duration{1});
  Runtime runtime({.name = std::filesystem::path(options.file).filename().string(), .clock = &clock});
  Loop loop(runtime, {.name = "import"});
  std::optional<Error> failed;
  loop.on_error([&](const ErrorReport& report) {
    if (!failed) failed = report.error;
  });
  // Made first, so that a wrong name is refused before there is a file.
  AnyFeed feed(loop, {.name = options.origin, .topic = options.topic}, found.description);
  // Virtual time passes as fast as possible, so batches are limited by memory, not by time.
  SqliteSink sink(loop, {.path = options.database, .sink = {.batch_time = std::chrono::hours{1}}});
  ImportRows table(options.file, notation.separator);
  std::vector<detail::CsvCell> cells;
  (void)table.next(cells);
  const auto changed = [&] { refuse(table.where(), "the file has changed while it was read", "try again"); };
  Time last = found.first - Duration{1};
  std::vector<std::byte> payload;
  while (table.next(cells).or_throw()) {
    if (cells.size() != found.columns.size()) changed();
    const auto time = time_of(cells[found.time_column].text, notation);
    if (!time || *time < found.first || *time > found.last) changed();
    payload.assign(found.description->size(), std::byte{0});
    std::size_t leaf = 0;
    for (std::size_t i = 0; i < cells.size(); ++i) {
      if (i == found.time_column || !found.columns[i].has_any) continue;
      const Value value = value_of(found.columns[i], cells[i]);
      if (!write(found.description->leaves()[leaf++], payload.data(), value)) changed();
    }
    // As in the feed: times of one origin must increase.
    const Time given = std::max(*time, last + Duration{1});
    if (given != *time) ++moved;
    loop.advance(given - last);
    last = given;
    feed.publish_bytes(payload, given);
    if (failed) throw SetupError(*failed);
  }
  if (const std::uint64_t lost = loop.close(); lost > 0 || failed)
    throw SetupError(failed ? *failed
                            : import_refused(options.database, std::to_string(lost) + " rows could not be stored", ""));
  return found.rows;
}

/// Throws SetupError: bad-argument, with the option.
ImportNotation notation_of(const ImportOptions& options) {
  ImportNotation notation;
  notation.zone = options.zone;
  notation.scale = parse_duration(options.scale).or_throw();
  if (notation.scale <= Duration{0}) refuse("--scale " + options.scale, "it is not above 0", "such as 10us");
  if (!options.start.empty()) notation.start = parse_iso8601(options.start).or_throw();
  const std::string& said = options.separator;
  const char separator = said == "tab" || said == "\\t" ? '\t' : said.size() == 1 ? said[0] : '\0';
  if (separator != '\t' && (separator < ' ' || separator == '"' || std::isalnum(static_cast<unsigned char>(separator))))
    refuse("--separator " + said, "it must be one character, which separates cells", "such as \";\", or tab");
  notation.separator = separator;
  if (options.decimal == ",") notation.decimal = ',';
  if (separator == notation.decimal) refuse("--separator " + said, "it is the decimal mark, too", "set --decimal");
  if (!notation.zone.empty() && !parse_iso8601("2026-03-01T12:00:00" + notation.zone))
    refuse("--zone " + notation.zone, "it is not a time zone", "write Z for UTC, or an offset such as +01:00");
  return notation;
}

}  // namespace

int import_table(const ImportOptions& options, std::ostream& out, std::ostream& err) try {
  const ImportNotation notation = notation_of(options);
  ImportOptions named = options;
  const std::string stem = std::filesystem::path(options.file).stem().string();
  if (named.topic.empty()) named.topic = stem;
  if (named.origin.empty()) named.origin = stem;
  if (named.database.empty()) named.database = std::filesystem::path(options.file).replace_extension(".db").string();
  const Found found = look_at(named, notation);
  const ImportColumn& time = found.columns[found.time_column];
  if (const auto unit = parse_duration("1 " + time.unit); unit && *unit != notation.scale && time.can_be_number)
    refuse(
        named.file,
        "its column " + time.heading + " says " + time.unit + ", and --scale 1 in it is " + to_string(notation.scale),
        "write --scale \"1 " + time.unit + "\", or change the heading");
  std::uint64_t moved = 0;
  const std::uint64_t rows = record(named, found, notation, moved);
  out << named.database << ": " << rows << (rows == 1 ? " row" : " rows") << " of " << named.file << " on topic "
      << named.topic << ", from " << to_iso8601(found.first) << " on\n";
  for (std::size_t i = 0; i < found.columns.size(); ++i) {
    const ImportColumn& column = found.columns[i];
    out << "  " << column.heading << ": " << (i == found.time_column ? "the time" : column.name + ", " + column.type())
        << "\n";
  }
  if (moved > 0)
    err << "rtdata: warning: " << moved
        << " rows were not later than the row before; each got a time 1 ns after the row before\n";
  return 0;
} catch (const SetupError& error) {
  err << "rtdata: " << error.what() << "\n";
  return 1;
}

}  // namespace rtdata::app
