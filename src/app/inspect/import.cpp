// rtdata import: makes a recording from a table, to verify, read and export it like any other recording.
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <ostream>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/core/recording_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/import_columns.hpp"
#include "app/inspect/import_head.hpp"
#include "app/inspect/import_rows.hpp"
#include "app/inspect/import_time.hpp"
#include "app/inspect/import_time_format.hpp"
#include "app/inspect/import_zone.hpp"
#include "app/inspect/separator.hpp"
#include "data/lower_case.hpp"
#include "data/saturating.hpp"
#include "data/utf8.hpp"
#include "rtdata/loop/clock.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/recording/runs.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata::app {
namespace {

/// A row, where rows are sorted.
struct Place {
  Time time{};
  std::uint64_t position = 0, line = 0;  // in the file
};

/// The structure of the table, found by reading it once.
struct Found {
  std::vector<ImportColumn> columns;  // all of the file
  std::vector<std::size_t> time_columns;
  Time first{}, last{};  // the earliest, the latest
  std::uint64_t rows = 0;
  std::uint64_t short_rows = 0, first_short_line = 0;  // rows that end early
  std::uint64_t cut_line = 0;                          // of a last row that is skipped; 0: none
  std::uint64_t out_of_order = 0, twice = 0, midnights = 0, headings_again = 0, without_time = 0, others = 0;
  std::vector<Place> places;                             // only if rows are sorted
  std::optional<std::pair<Duration, Duration>> offsets;  // of --zone: the least, the largest
  std::shared_ptr<const Description> description;
};

/// True if the row has as many cells as there are columns; a separator at its end makes no cell.
bool is_of_columns(std::vector<detail::CsvCell>& cells, const std::vector<ImportColumn>& columns) {
  const auto is_empty = [](const detail::CsvCell& cell) { return cell.text.empty() && !cell.quoted; };
  if (cells.size() == columns.size() + 1 && is_empty(cells.back())) cells.pop_back();
  if (cells.size() + 1 == columns.size() && columns.back().heading.empty()) cells.emplace_back();
  return cells.size() == columns.size();
}

/// Advice for a row that looks like a comment. Empty: it does not.
std::string comment_advice(const std::vector<detail::CsvCell>& cells) {
  for (const char* const begin : {"#", "//", ";", "%", "!"})
    if (cells.front().text.starts_with(begin))
      return std::string("if it is a comment, write --comment \"") + begin + "\"";
  return {};
}

bool has_no_date(const ImportOptions& options) {
  return !options.time_format.empty() && !format_has_date(options.time_format);
}

/// For messages.
std::string column_of_time(const ImportOptions& options) {
  const std::vector<std::string>& columns = options.time_columns;
  std::string all = columns.size() > 1 ? "columns " : "column ";
  for (std::size_t i = 0; i < columns.size(); ++i)
    all += (i == 0 ? "" : i + 1 < columns.size() ? ", " : " and ") + columns[i];
  return all;
}

/// The heading of the time columns, with the unit if that is in a separate row.
std::string heading_of_time(const Found& found) {
  std::string all;
  for (const std::size_t at : found.time_columns) {
    const ImportColumn& column = found.columns[at];
    const bool has_unit = column.unit.empty() || column.heading.find(column.unit) != std::string::npos;
    all += (all.empty() ? "" : " ") + column.heading + (has_unit ? "" : " " + column.unit);
  }
  return all;
}

/// A format for times like this one.
std::string format_for(const std::string& when, const Found& found) {
  std::string format = format_in(heading_of_time(found));
  if (format.empty()) return "%d.%m.%Y %H:%M:%S";
  const auto colons = std::count(when.begin(), when.end(), ':');
  if (!format_has_hour(format) && colons > 0) format += colons > 1 ? " %H:%M:%S" : " %H:%M";
  return format;
}

/// The text of the time in a row; date and time, or more parts, may be in separate cells.
std::string time_text(const std::vector<detail::CsvCell>& cells, const Found& found) {
  if (found.time_columns.empty()) return {};
  std::string text = cells[found.time_columns.front()].text;
  for (std::size_t i = 1; i < found.time_columns.size(); ++i) (text += ' ') += cells[found.time_columns[i]].text;
  return text;
}

/// Refuses a row whose time cannot be read.
[[noreturn]] void refuse_time(const ImportOptions& options, const ImportNotation& notation, const Error& error,
                              const ImportRows& table, const std::vector<detail::CsvCell>& cells, const Found& found) {
  const std::string when = time_text(cells, found);
  double number = 0;
  const bool is_beyond = options.time_format.empty() && is_number(when, notation.numbers, number) &&
                         std::isfinite(number);
  ImportNotation without_start = notation;
  without_start.start = Time{};
  const bool is_start = is_beyond && ImportClock(without_start).read(when);
  const bool has_comma = options.decimal.empty() && when.find(',') != std::string::npos &&
                         is_number(when, {','}, number) && !may_have_thousands(when);
  const bool has_date = when.size() >= 10 && when[4] == '-' && when[7] == '-';
  const bool has_reason = has_date || !options.time_format.empty();
  const bool has_digits = when.find_first_of("0123456789") != std::string::npos;
  std::string advice;
  if (is_start) {
    advice = "check --start";
  } else if (is_beyond) {
    advice = "check --scale" + scale_of(number);
  } else if (has_comma) {
    advice = "its numbers have decimal commas: write --decimal ,";
  } else if (has_date && when.size() == 10 && options.time_format.empty()) {
    advice = "if its rows are days, write --time-format %F";
  } else if (has_date && error.what == "not a time") {  // looks like ISO 8601, whose own advice says how to write that
    advice = "for another notation write --time-format, such as \"%F %T %z\"";
  } else if (has_reason && !error.advice.empty()) {
    advice = error.advice;
    const std::string heading = heading_of_time(found), zone = zone_in(heading);
    if (error.why == says_no_zone && !zone.empty())
      advice = "its heading \"" + heading + "\" seems to say one: write --zone " + zone + "; or " +
               advice.substr(std::string("write ").size());
  } else if (when.find_first_not_of(' ') == std::string::npos) {
    advice = "to skip rows without a time, write --partial";
  } else if (advice = comment_advice(cells); found.rows == 0 && !has_digits) {
    advice = "if the row has the units, write --units row; if the heading has two rows, --head 2" +
             (advice.empty() ? "" : "; " + advice);
  } else if (advice.empty()) {
    if (!has_reason) advice = "write a number, or a time such as 2026-03-01T12:00:00Z";
    if (!has_reason && has_digits)
      advice += "; for another notation write --time-format, such as \"" + format_for(when, found) + "\"";
    if (!has_digits)
      advice += std::string(advice.empty() ? "" : "; ") + "if the table ends above it, take that part: head -n " +
                std::to_string(table.line() - 1) + " " + options.file + " >table.csv";
  }
  refuse_import(table.where(),
                "\"" + detail::readable(when.substr(0, 64)) + "\" in " + column_of_time(options) + " is not a time" +
                    (is_beyond    ? " that can be recorded, which are those from 1678 to 2261"
                     : has_reason ? ": " + error.why
                                  : ""),
                advice);
}

/// Advice for a row that is before the row above it: sorting is not always the remedy.
std::string sort_advice(const ImportOptions& options, const ImportNotation& notation, std::uint64_t line, Time before,
                        Time time, const std::string& when) {
  double number = 0;
  if (has_no_date(options))
    return "if all of its rows are of one day, write --sort; if they are not, the table needs a column with the date";
  const bool is_count = options.time_format.empty() && is_number(when, notation.numbers, number);
  const Duration was = before - notation.start, is = time - notation.start;
  if (is_count && is >= Duration{0} && is <= was / 4) {
    const std::string above = std::to_string(line - 1);
    return "its clock seems to begin again in line " + std::to_string(line) + ": import the part above it (head -n " +
           above + " " + options.file + " >table.csv) and the rest separately; if it did not, write --sort";
  }
  if (is_count) return "sort the rows by time: write --sort; or, if its clock began again there, divide the file there";
  return std::string("sort the rows by time: write --sort") +
         (options.only.empty() ? "; or, if it has rows of several kinds, take one: --only" : "");
}

/// Refuses a row whose number of cells differs from the number of columns.
[[noreturn]] void refuse_row(const ImportOptions& options, ImportRows& table, const std::vector<detail::CsvCell>& cells,
                             const Found& found) {
  const bool is_short = cells.size() < found.columns.size();
  std::string advice = comment_advice(cells);
  const bool has_kind = !options.only.empty() && options.only.front().find('=') == std::string::npos;
  if (advice.empty() && has_kind && options.columns.empty()) advice = "name the columns of these rows: --columns";
  if (advice.empty() && is_short)
    advice = table.is_at_end() ? "if the file is cut off there, write --partial, which skips the row"
                               : "if rows may end early, write --partial: what they lack is absent";
  if (options.only.empty() && comment_advice(cells).empty())
    advice += std::string(advice.empty() ? "" : "; ") + "if it has rows of several kinds, take one: --only";
  refuse_import(table.where(),
                std::to_string(cells.size()) + (cells.size() == 1 ? " cell" : " cells") + ", where " +
                    (options.columns.empty() ? "the first row has " : "--columns names ") +
                    std::to_string(found.columns.size()),
                advice);
}

/// Reads the heading. Rows follow.
std::vector<ImportColumn> begin_table(ImportRows& table, const ImportOptions& options, const ImportNotation& notation,
                                      std::vector<std::size_t>& time_columns) {
  std::vector<ImportColumn> columns = read_head(table, options, notation);
  time_columns.clear();
  for (const std::string& heading : options.time_columns)
    time_columns.push_back(find_column(columns, heading, options, notation));
  std::vector<ImportChoice> choices;
  for (const std::string& one : options.only) {
    const std::size_t mark = one.find('=');
    ImportChoice& choice = choices.emplace_back(ImportChoice{.text = one});
    if (mark == std::string::npos) continue;
    choice = {.text = one.substr(mark + 1), .heading = one.substr(0, mark)};
    choice.column = find_column(columns, choice.heading, options, notation);
  }
  table.choose(std::move(choices));
  for (const std::string& heading : options.texts)
    columns[find_column(columns, heading, options, notation)].is_text = true;
  std::vector<detail::CsvCell> heading;
  std::vector<std::string> names;
  for (const ImportColumn& column : columns) names.push_back(column.heading);
  if (options.columns.empty() && options.head == 1)
    for (const ImportColumn& column : columns) heading.push_back({column.heading});
  table.begin_rows(std::move(heading), std::move(names), time_columns);
  return columns;
}

/// True if the row has no time, and such rows are skipped.
bool is_without_time(const std::vector<detail::CsvCell>& cells, const Found& found, const ImportNotation& notation) {
  return notation.takes_partial && notation.step <= 0 &&
         std::all_of(found.time_columns.begin(), found.time_columns.end(),
                     [&](std::size_t column) { return cells[column].text.empty(); });
}

/// Refuses a table without a chosen row.
void check_choices(const ImportOptions& options, const ImportRows& table) {
  for (const ImportChoice& choice : table.choices()) {
    if (choice.has_any) continue;
    constexpr std::size_t most_shown = 8;
    std::string others;
    for (std::size_t i = 0; i < std::min(choice.others.size(), most_shown); ++i)
      (others += i == 0 ? "there are " : ", ") += detail::readable(choice.others[i]);
    if (choice.others.size() > most_shown) others += ", ...";
    refuse_import(options.file,
                  (choice.column ? "no row has " + choice.text + " in column " + choice.heading
                                 : "no row begins with " + choice.text) +
                      (choice.others.empty() ? "" : ", where " + others),
                  choice.column ? "check --only" : "check --only; for the text of a column write COLUMN=TEXT");
  }
}

/// Refuses numbers that count days or years.
void check_days(const ImportOptions& options, const ImportColumn& time, const std::string& first, double number) {
  std::string words = " " + detail::lower_case(time.bare) + " ";
  for (char& c : words)
    if (c < 'a' || c > 'z') c = ' ';
  const auto has = [&](const char* word) { return words.find(word) != std::string::npos; };
  const auto refuse = [&](const std::string& what, const std::string& advice) {
    refuse_import(options.file, "\"" + first + "\" in column " + time.heading + " is " + what,
                  advice + "; or --scale 1s if it counts seconds");
  };
  const auto less = [](const char* days) {
    return std::string("subtract ") + days + " first, so that they count days since 1970, and write --scale 24h";
  };
  if (has(" mjd ")) refuse("a modified Julian day", "write --scale 24h --start 1858-11-17T00:00:00Z");
  if (has(" jd ") || has(" hjd ") || has(" bjd ") || has(" julian")) refuse("a Julian day", less("2440587.5"));
  if (has(" datenum ")) refuse("a day of MATLAB", less("719529"));
  if (has(" year ") || has(" decimal date "))
    refuse("a year", "years differ in length: write their days first, as 2026-03-01");
  // Not those since 1970, which are far larger in each unit.
  constexpr double least = 10'000, most = 100'000;
  if ((has(" date ") || has(" datum ") || has(" datetime ") || has(" day ")) && number >= least && number < most)
    refuse("a day, as of a spreadsheet",
           "write --scale 24h --start 1899-12-30T00:00:00Z, with the offset of a local "
           "time instead of Z");
}

/// Refuses numbers that are times of day with nothing between their parts.
void check_clock(const ImportOptions& options, const ClockDigits& digits, const Found& found) {
  const std::string heading = heading_of_time(found);
  const bool is_said = says_a_zone(heading) || detail::lower_case(heading).find("hhmmss") != std::string::npos;
  const std::string format = digits.format(is_said);
  if (format.empty()) return;
  refuse_import(options.file, column_of_time(options) + " seems to have times of day: " + digits.shown(),
                "write --time-format " + format +
                    ", and --start with their day; or, if a column has the day, --time DAY " +
                    options.time_columns.front() + " --time-format \"%d%m%y " + format +
                    "\"; or --scale 1s if they count seconds");
}

/// Refuses a format in which day, month and year are in another order than the heading says.
void check_order(const ImportOptions& options, const Found& found) {
  const std::string said = format_in(heading_of_time(found));
  const std::string order = order_of_date(options.time_format);
  if (said.empty() || order.empty() || order == order_of_date(said)) return;
  refuse_import("--time-format " + options.time_format,
                "the heading \"" + heading_of_time(found) + "\" has day, month and year in another order",
                "write --time-format \"" + said + (format_has_hour(said) ? "" : "...") +
                    "\"; if the heading is wrong, change it");
}

/// Refuses numbers with an unknown scale.
void check_scale(const ImportOptions& options, const ImportNotation& notation, const ImportColumn& time,
                 const std::string& first) {
  double number = 0;
  if (!options.time_format.empty() || !is_number(first, notation.numbers, number)) return;
  if (!options.zone.empty() && options.zone != "Z")
    refuse_import("--zone " + options.zone, "its times are numbers that count from --start, so they have no zone",
                  "remove --zone; if they count from a local time, write --start with its offset, such as "
                  "1899-12-30T00:00:00+01:00");
  if (options.scale.empty()) check_days(options, time, first, number);
  const std::string shown = "its column " + time.heading;
  if (options.scale.empty() && options.start.empty() && may_be_a_day(first))
    refuse_import(options.file, "\"" + first + "\" in column " + time.heading + " seems to be a day",
                  "write --time-format, such as " +
                      std::string(first.size() == 8    ? "%Y%m%d"
                                  : first.size() == 10 ? "%Y%m%d%H"
                                                       : "%Y%m%d%H%M") +
                      "; or --scale 1s if it counts seconds since 1970");
  // "time_ms", "t in ms": without brackets, only texts that cannot be anything else.
  std::string unit = time.unit;
  const std::size_t open = time.heading.find_last_of("([");
  if (unit.empty() && open != std::string::npos && (time.heading.ends_with(')') || time.heading.ends_with(']')))
    unit = time.heading.substr(open + 1, time.heading.size() - open - 2);  // longer than units are elsewhere
  if (time.unit.empty() && !duration_of_unit(unit)) unit.clear();
  if (unit.empty() && options.scale.empty()) unit = unit_in(time.bare);
  if (unit.empty()) return;
  const auto duration = duration_of_unit(unit);
  if (duration && *duration != notation.scale)
    refuse_import(options.file, shown + " says " + unit + ", and --scale 1 in it is " + to_string(notation.scale),
                  "write --scale \"" + to_string(*duration) + "\"" +
                      (options.scale.empty() ? ", or --scale \"1 s\" if it is wrong" : ", or change the heading"));
  if (!duration && options.scale.empty() && !says_a_zone(unit))
    refuse_import(options.file, shown + " says " + unit + ", which is not a known unit of time",
                  "write the time that 1 in it means, such as --scale \"10 us\"");
}

Found look_at(const ImportOptions& options, const ImportNotation& notation) {
  ImportRows table(options.file, notation);
  if (!table.is_open())
    throw SetupError(system_error(errno, "cannot read", options.file, "give the path of a CSV file"));
  Found found;
  found.columns = begin_table(table, options, notation, found.time_columns);
  for (ImportColumn& column : found.columns) column.numbers = notation.numbers;
  for (const std::size_t column : found.time_columns) found.columns[column].is_time = true;
  if (!options.time_format.empty()) check_order(options, found);
  ImportClock clock(notation);
  ClockDigits digits;
  const bool may_be_digits = options.time_format.empty() && options.scale.empty() && notation.step <= 0;
  std::vector<detail::CsvCell> cells;
  bool has_comma_in_quotes = false;
  Time before{};  // of the row above
  while (table.next(cells).or_throw()) {
    if (!is_of_columns(cells, found.columns)) {
      const bool is_short = cells.size() < found.columns.size();
      if (!is_short || !notation.takes_partial) refuse_row(options, table, cells, found);
      // The only row that ends early, and the last one: the file ends within it.
      if (found.short_rows == 0 && table.is_at_end()) {
        found.cut_line = table.line();
        break;
      }
      if (found.short_rows++ == 0) found.first_short_line = table.line();
      cells.resize(found.columns.size());
    }
    if (is_without_time(cells, found, notation)) {
      ++found.without_time;
      continue;
    }
    if (found.rows == 0 && notation.step <= 0)
      check_scale(options, notation, found.columns[found.time_columns.front()], time_text(cells, found));
    const std::uint64_t twice = clock.twice();
    const auto time = clock.read(time_text(cells, found));
    if (!time) refuse_time(options, notation, time.error(), table, cells, found);
    const bool is_sorted = options.order == ImportOptions::Order::sorted;
    if (clock.twice() > twice && is_sorted)
      refuse_import(table.where(),
                    time_text(cells, found) + " comes twice in " + notation.zone +
                        "; the rows are not in time order, so the right one is unknown",
                    "write --zone with an offset such as +01:00, or sort the file");
    if (found.rows++ == 0) found.first = found.last = before = *time;
    if (may_be_digits) digits.look_at(time_text(cells, found));
    if (*time < before && !is_sorted && may_be_digits) check_clock(options, digits, found);
    if (*time < before && !is_sorted)
      refuse_import(table.where(),
                    "\"" + detail::readable(time_text(cells, found).substr(0, 64)) + "\" in " +
                        column_of_time(options) + " is before the time of the row above it",
                    sort_advice(options, notation, table.line(), before, *time, time_text(cells, found)));
    if (*time < before) ++found.out_of_order;
    if (is_sorted) found.places.push_back({*time, table.position(), table.line()});
    before = *time;
    found.first = std::min(found.first, *time);
    found.last = std::max(found.last, *time);
    for (std::size_t i = 0; i < cells.size(); ++i) {
      table.check_text(cells[i].text, &found.columns[i].heading);
      ImportColumn& column = found.columns[i];
      column.look_at(cells[i], table.line());
      column.is_as_time = column.is_as_time && notation.step <= 0 &&
                          cells[i].text == cells[found.time_columns.front()].text;
      has_comma_in_quotes = has_comma_in_quotes || (cells[i].quoted && cells[i].text.find(',') != std::string::npos);
    }
  }
  if (notation.separator == notation.numbers.decimal && !has_comma_in_quotes)
    refuse_import("--separator " + shown_separator(notation.separator), "it is the decimal mark, too", "set --decimal");
  if (table.cut_line() != 0) found.cut_line = table.cut_line();
  if (found.rows > 0 && may_be_digits) check_clock(options, digits, found);
  found.twice = clock.twice();
  found.offsets = clock.offsets();
  found.midnights = clock.midnights();
  found.headings_again = table.headings_again();
  std::stable_sort(found.places.begin(), found.places.end(),
                   [](const Place& a, const Place& b) { return a.time < b.time; });
  found.others = table.others();
  if (found.rows == 0) check_choices(options, table);
  if (found.rows == 0) refuse_import(options.file, "it has no rows", "");
  if (detail::span_between(found.first, found.last) == Duration::max())
    refuse_import(options.file, "its times span more than 292 years", "check --scale");
  for (ImportColumn& column : found.columns) {
    column.look_at_all();
    if (options.decimal.empty() && options.thousands.empty() && column.seems_to_have_decimal_commas())
      refuse_import(options.file, "the numbers in column " + column.heading + " seem to have decimal commas",
                    "write --decimal , or, if they are texts, --decimal .");
    if (options.decimal.empty() && options.thousands.empty() && column.seems_to_have_thousands())
      refuse_import(
          options.file,
          "the numbers in column " + column.heading +
              " have commas before three digits, which may be "
              "thousands or decimals",
          "if they are thousands, write --thousands , and if they are decimals, --decimal , and if they are texts, "
          "--decimal .");
  }
  found.description = describe_columns(found.columns, options.file).or_throw();
  const TopicToRecord topic{options.topic, found.description.get()};
  const auto refusals = refused_topics(SqliteConfig{.path = options.database}, std::span(&topic, 1));
  if (!refusals.empty()) refuse_import(options.file, refusals.front().why, refusals.front().advice);
  return found;
}

/// What happens while rows are recorded.
struct Recorded {
  std::uint64_t moved = 0;  // rows that got a later time than in the file
  std::vector<Error> told;  // warnings of the recording
};

std::vector<RunInfo> runs_in(const std::string& database) {
  const auto recording = Recording::open(database);
  auto runs = recording ? recording->runs() : Result<std::vector<RunInfo>>(std::vector<RunInfo>{});
  return runs ? *std::move(runs) : std::vector<RunInfo>{};
}

void record_rows(const ImportOptions& options, const Found& found, const ImportNotation& notation, Recorded& recorded) {
  ManualClock clock(found.first - Duration{1});
  Runtime runtime({.name = std::filesystem::path(options.file).filename().string(), .clock = &clock});
  Loop loop(runtime, {.name = "import"});
  std::optional<Error> failed;
  SqliteSink sink;
  loop.on_error([&](const ErrorReport& report) {
    if (sink.health() != Health::faulted) {
      recorded.told.push_back(report.error);
    } else if (!failed) {
      failed = report.error;
    }
  });
  // Made first, so that a wrong name is refused before there is a file.
  AnyFeed feed(loop, {.name = options.origin, .topic = options.topic}, found.description);
  // Virtual time passes as fast as possible, so batches are limited by memory, not by time.
  sink = SqliteSink(loop, {.path = options.database, .sink = {.batch_time = std::chrono::hours{1}}});
  std::uint64_t published = 0;
  try {
    ImportRows table(options.file, notation);
    std::vector<detail::CsvCell> cells;
    std::vector<std::size_t> time_columns;
    (void)begin_table(table, options, notation, time_columns);
    const auto changed = [&] { refuse_import(table.where(), "the file has changed while it was read", "try again"); };
    ImportClock times(notation);
    Time last = found.first - Duration{1};
    std::vector<std::byte> payload;
    for (std::uint64_t row = 0; row < found.rows;) {
      if (!found.places.empty()) table.go_to(found.places[row].position, found.places[row].line);
      if (!table.next(cells).or_throw()) changed();
      if (!is_of_columns(cells, found.columns)) {
        if (!notation.takes_partial || cells.size() > found.columns.size()) changed();
        cells.resize(found.columns.size());
      }
      if (is_without_time(cells, found, notation)) continue;
      ++row;
      const auto time = times.read(time_text(cells, found));
      if (!time || *time < found.first || *time > found.last) changed();
      payload.assign(found.description->size(), std::byte{0});
      std::size_t leaf = 0;
      for (std::size_t i = 0; i < cells.size(); ++i) {
        if (found.columns[i].is_time || !found.columns[i].has_any) continue;
        const Value value = value_of(found.columns[i], cells[i]);
        if (!write(found.description->leaves()[leaf++], payload.data(), value)) changed();
      }
      // As in the feed: times of one origin must increase.
      const Time given = std::max(*time, last + Duration{1});
      if (given != *time) ++recorded.moved;
      loop.advance(given - last);
      last = given;
      feed.publish_bytes(payload, given);
      ++published;
      if (failed) throw SetupError(*failed);
    }
    const std::uint64_t lost = loop.close();
    const std::vector<RunInfo> runs = runs_in(options.database);
    const bool is_whole = lost == 0 && !runs.empty() && runs.back().state == RunState::closed;
    if (!is_whole && !failed && !recorded.told.empty()) failed = recorded.told.back();
    if (!is_whole)
      throw SetupError(failed ? *failed : import_refused(options.database, "its rows could not be stored", ""));
  } catch (...) {  // a run that cannot be deleted says what it lacks
    feed.set_numbered();
    feed.lost(found.rows - published);
    loop.close();
    throw;
  }
}

/// Deletes the run of an import that failed; together with the file if the import has made it. Returns what is left;
/// empty: nothing.
std::string left_after(const std::string& database, bool is_made, std::int64_t last_before) {
  const std::vector<RunInfo> runs = runs_in(database);
  if (runs.empty() || runs.back().run <= last_before || runs.back().pid != ::getpid()) return "";
  std::error_code failed;
  if (is_made && runs.size() == 1) {
    for (const char* const ending : {"", "-wal", "-shm", "-lock"}) std::filesystem::remove(database + ending, failed);
    if (!std::filesystem::exists(database, failed)) return "";
  }
  if (runs.back().state == RunState::recording) (void)rtdata::seal(database);  // otherwise deleting it says why
  const auto deleted = delete_run(database, runs.back().run, Unsent::discarded);
  if (deleted) return "";
  const std::string run = std::to_string(runs.back().run);
  return "a part of its rows is left as run " + run + " (" + deleted.error().why + "): delete it with `rtdata rm " +
         database + " " + run + "`";
}

Recorded record(const ImportOptions& options, const Found& found, const ImportNotation& notation) {
  std::error_code ignored;
  const bool is_made = !std::filesystem::exists(options.database, ignored);
  const std::vector<RunInfo> before = runs_in(options.database);
  Recorded recorded;
  try {
    record_rows(options, found, notation, recorded);
    return recorded;
  } catch (const SetupError& error) {
    Error why = error.error();
    const std::string left = left_after(options.database, is_made, before.empty() ? 0 : before.back().run);
    why.advice += (why.advice.empty() ? "" : "; ") + (left.empty() ? std::string("nothing was imported") : left);
    throw SetupError(std::move(why));
  }
}

/// Throws SetupError: bad-argument, with the option.
ImportNotation notation_of(const ImportOptions& options) {
  ImportNotation notation;
  notation.zone = options.zone;
  if (!options.scale.empty()) notation.scale = parse_duration(options.scale).or_throw();
  if (notation.scale <= Duration{0})
    refuse_import("--scale " + options.scale, "it is not above 0", "write one such as 10us");
  if (!options.start.empty()) notation.start = parse_iso8601(options.start).or_throw();
  const std::optional<char> in_file = separator_line(options.file);
  notation.skip = std::max<std::uint64_t>(options.skip, in_file ? 1 : 0);
  notation.comments = options.comments;
  const bool has_step = options.rate > 0 || !options.step.empty();
  if (options.time_columns.empty() != has_step || (options.rate > 0 && !options.step.empty()))
    refuse_import(options.file,
                  has_step ? "more than one of --time, --rate and --step is given" : "--time is not given",
                  "write --time with the heading of its times; for a table without times, --rate or --step");
  if (has_step && !(options.time_format + options.scale + options.zone).empty())
    refuse_import(options.file,
                  "its rows have no times of their own, so --time-format, --scale and --zone have no meaning",
                  "remove them, and write --start with the time of the first row");
  if (options.rate > 0) notation.step = 1e9L / static_cast<long double>(options.rate);
  if (!options.step.empty()) notation.step = static_cast<long double>(parse_duration(options.step).or_throw().count());
  if (has_step && !(notation.step >= 1))
    refuse_import("--rate, --step", "its rows are less than 1 ns apart", "write one such as --rate 32, --step 31.25ms");
  notation.none = options.none;
  notation.strip = options.strip;
  notation.adds_days = options.order != ImportOptions::Order::sorted;
  const std::string& said = options.separator;
  notation.has_blanks = said == "blanks";
  const char separator = said.empty() ? in_file.value_or(',') : notation.has_blanks ? ' ' : separator_of(said);
  if (separator != '\t' && (separator < ' ' || separator == '"' || std::isalnum(static_cast<unsigned char>(separator))))
    refuse_import("--separator " + said, "it must be one character, which separates cells",
                  "write one such as \";\", or tab");
  notation.separator = separator;
  ImportNumbers& numbers = notation.numbers;
  if (options.decimal == ",") numbers.decimal = ',';
  if (separator == numbers.decimal && separator != ',')  // a comma within quotes may be one
    refuse_import("--separator " + shown_separator(separator), "it is the decimal mark, too", "set --decimal");
  numbers.thousands = options.thousands;
  if (numbers.thousands == std::string(1, numbers.decimal))
    refuse_import("--thousands " + numbers.thousands, "it is the decimal mark, too", "set --decimal");
  if (numbers.thousands.find_first_of("0123456789+-eE\"") != std::string::npos)
    refuse_import("--thousands " + numbers.thousands, "it may be part of a number", "write one such as \",\" or \" \"");
  if (!notation.zone.empty() && !parse_iso8601("2026-03-01T12:00:00" + notation.zone)) {
    notation.has_named_zone = use_zone(notation.zone);
    if (!notation.has_named_zone)
      refuse_import("--zone " + notation.zone, "it is not a time zone",
                    "write Z for UTC, an offset such as +01:00, or a name such as Europe/Berlin");
  }
  notation.time_format = options.time_format;
  if (const std::string mistake = format_mistake(options.time_format); !mistake.empty() && !options.time_format.empty())
    refuse_import("--time-format " + options.time_format, mistake, "write one such as \"%d.%m.%Y %H:%M:%S\"");
  if (!notation.zone.empty() && has_no_date(options))
    refuse_import("--zone " + options.zone,
                  "times of --time-format " + options.time_format + " have no date, and count from --start",
                  "remove --zone, and write --start with the day and its offset, such as 2026-03-01T00:00:00+01:00");
  if (options.time_columns.size() > 1 && options.time_format.empty() && numbers.thousands == " ")
    refuse_import("--time", "a time of several columns is not a number with blanks between its thousands",
                  "write --time-format");
  notation.takes_partial = options.partial == ImportOptions::Partial::taken;
  if (!options.columns.empty() && options.head > 1)
    refuse_import("--columns " + options.columns, "--head needs a heading, but --columns says that there is none",
                  "choose one of them");
  return notation;
}

/// True if this is a second column of times, such as "Time 2" beside "Time 1".
bool is_another_time(const ImportColumn& column, const ImportColumn& time) {
  const auto base = [](const ImportColumn& of) {
    const std::string lower = of.bare.size() > 2 ? detail::lower_case(of.bare) : of.bare;  // not T1 of t
    return lower.substr(0, lower.find_last_not_of("0123456789 _.#-") + 1);
  };
  return !column.is_time && column.can_be_number && column.never_falls && column.rises && !column.is_as_time &&
         !base(time).empty() && base(column) == base(time);
}

/// Warns of values that differ from the table, or that may not be as intended.
void tell_warnings(std::ostream& err, const ImportOptions& options, const Found& found, const ImportNotation& notation,
                   const Recorded& recorded) {
  const auto warn = [&](const std::string& text) { err << "rtdata: warning: " << text << "\n"; };
  const auto rows = [](std::uint64_t count) { return std::to_string(count) + (count == 1 ? " row" : " rows"); };
  for (const ImportColumn& column : found.columns) {
    if (column.is_time || column.is_text || !column.is_text_for_few()) continue;
    const std::string text = "\"" + detail::readable(column.first_text) + "\"";
    if (!column.thousands_in_texts().empty() || column.numbers_with_more == column.texts) continue;
    warn("column " + column.heading + " is text because of " + std::to_string(column.texts) + " of its " +
         std::to_string(column.values) + " values, the first " + text + " in line " +
         std::to_string(column.first_text_line) + ": if it stands for no value, write --none " + text);
  }
  for (const ImportColumn& column : found.columns) {
    if (column.is_time || column.is_text || column.can_be_number || column.texts > 0 || !column.has_any) continue;
    warn("column " + column.heading + " is text: no type of number holds all of its values exactly, such as " +
         column.first_large + " in line " + std::to_string(column.first_large_line));
  }
  for (const ImportColumn& column : found.columns) {
    if (column.is_time || column.is_text || column.can_be_number || column.texts == 0) continue;
    const std::string text = "column " + column.heading + " is text, with numbers such as \"" +
                             detail::readable(column.first_text) + "\": ";
    if (const std::string mark = column.thousands_in_texts(); !mark.empty())
      warn(text + "if \"" + mark + "\" is between thousands, write --thousands \"" + mark + "\"");
    else if (column.numbers_with_more != column.texts)
      continue;
    else if (const std::string more = column.more.substr(
                 std::min(column.more.find_first_not_of(' '), column.more.size()));
             more == "N" || more == "S" || more == "E" || more == "W")
      warn(text +
           (more == "S" || more == "W" ? "if these are places, make numbers of the south and west negative first"
                                       : "if these are places, remove " + more + " first, and make numbers of the " +
                                             (more == "N" ? "south" : "west") + " negative") +
           (says_a_place(column.heading) ? "" : "; if " + more + " is a unit, --strip removes it"));
    else
      warn(text + "to have the numbers, write --strip \"" + detail::readable(column.more) + "\"");
  }
  std::string with_zeros, number_with_zeros;
  for (const ImportColumn& column : found.columns) {
    if (column.is_time || !column.can_be_integer || column.with_zeros.empty()) continue;
    with_zeros += " \"" + column.heading + "\"";
    if (number_with_zeros.empty()) number_with_zeros = column.with_zeros;
  }
  if (!with_zeros.empty())
    warn("zeros before whole numbers, such as " + number_with_zeros +
         ", are not kept: to keep them as texts, write --text" + with_zeros);
  for (std::size_t i = 0; i < found.columns.size() && notation.step <= 0; ++i)
    if (const ImportColumn& column = found.columns[i], &time = found.columns[found.time_columns.front()];
        is_another_time(column, time))
      warn("column " + column.heading + " seems to be a time, too: all values are stored at the times of column " +
           time.heading + "; to have those of " + column.heading + " at theirs, import the file again with --time \"" +
           column.heading + "\"");
  const std::string heading = heading_of_time(found), zone = zone_in(heading);
  if (const auto offset = parse_iso8601("1970-01-01T00:00:00" + zone); found.offsets && !zone.empty() && offset) {
    const Duration said = -offset->time_since_epoch();
    if (found.offsets->first != said || found.offsets->second != said)
      warn("the heading \"" + heading + "\" seems to say the zone " + zone + ", and --zone " + notation.zone +
           " is another one: if the heading is right, write --zone " + zone);
  }
  if (found.others > 0) warn(rows(found.others) + " of other kinds: left out");
  if (found.headings_again > 0)
    warn(rows(found.headings_again) + (found.headings_again == 1 ? " is" : " are") + " the heading again: left out");
  if (found.without_time > 0) warn(rows(found.without_time) + " without a time: left out");
  constexpr std::size_t hour_at = 11;
  const bool may_be_of_day = has_no_date(options) && options.start.size() > hour_at + 4 &&
                             options.start.compare(hour_at, 5, "00:00") != 0;
  if (may_be_of_day && found.first - notation.start >= std::chrono::hours{1})
    warn("its times count from --start, so that the first is " + to_iso8601(found.first) +
         ": if they are times of day, write --start with 00:00");
  if (found.midnights > 0)
    warn("its times have no date, and go back " + std::to_string(found.midnights) +
         (found.midnights == 1 ? " time" : " times") +
         (format_has_hour(options.time_format) ? ", as at midnight: each time a day was added"
                                               : ", as at the full hour: each time an hour was added"));
  if (found.short_rows > 0)
    warn(rows(found.short_rows) + " ended early, the first in line " + std::to_string(found.first_short_line) +
         "; what they lack is absent");
  if (found.cut_line > 0)
    warn("line " + std::to_string(found.cut_line) + ", the last row, is cut off and was left out");
  if (found.out_of_order > 0)
    warn(rows(found.out_of_order) + " had a time before the row above; the rows were sorted" +
         (has_no_date(options) ? ", as times of one day" : ""));
  if (found.twice > 0)
    warn(rows(found.twice) + (found.twice == 1 ? " is" : " are") + " in an hour that comes twice in " + notation.zone +
         "; each is taken as the first that is not before the row above");
  if (const std::uint64_t moved = recorded.moved; moved > 0)
    warn(rows(moved) + (moved == 1 ? " was" : " were") +
         " not later than the row before; each got a time 1 ns after the row before");
  for (const Error& error : recorded.told) warn(error.text());
}

}  // namespace

int import_table(const ImportOptions& options, std::ostream& out, std::ostream& err) try {
  std::error_code ignored;
  if (const auto what = std::filesystem::status(options.file, ignored);
      std::filesystem::exists(what) && !std::filesystem::is_regular_file(what) && !std::filesystem::is_directory(what))
    refuse_import(options.file, "it cannot be read twice", "copy it into a file first, such as table.csv");
  const ImportNotation notation = notation_of(options);
  ImportOptions named = options;
  const std::string stem = std::filesystem::path(options.file).stem().string();
  if (named.topic.empty()) named.topic = stem;
  if (named.origin.empty()) named.origin = stem;
  if (named.database.empty()) named.database = std::filesystem::path(options.file).replace_extension(".db").string();
  const Found found = look_at(named, notation);
  const Recorded recorded = record(named, found, notation);
  const std::uint64_t rows = found.rows;
  out << named.database << ": " << rows << (rows == 1 ? " row" : " rows") << " of " << named.file << " on topic "
      << named.topic << ", from " << to_iso8601(found.first) << " to " << to_iso8601(found.last) << "\n";
  for (std::size_t i = 0; i < found.columns.size(); ++i) {
    const ImportColumn& column = found.columns[i];
    out << "  " << column.heading << ": " << (column.is_time ? "the time" : column.name + ", " + column.type()) << "\n";
  }
  tell_warnings(err, options, found, notation, recorded);
  return 0;
} catch (const SetupError& error) {
  print_error(err, error.error());
  return 1;
}

}  // namespace rtdata::app
