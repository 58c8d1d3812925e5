// rtdata import: makes a recording of somebody's table, so that it can be verified, read and exported as any other.
#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <istream>
#include <optional>
#include <ostream>
#include <set>
#include <span>
#include <string_view>
#include <vector>

#include "app/core/recording_commands.hpp"
#include "data/csv_row.hpp"
#include "data/nearest.hpp"
#include "data/number_text.hpp"
#include "data/utf8.hpp"
#include "rtdata/data/value.hpp"
#include "rtdata/loop/clock.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/sqlite.hpp"

namespace rtdata::app {
namespace {

constexpr std::size_t longest_row = std::size_t{1} << 20;
constexpr std::size_t longest_text = 1024;

Error refused(std::string where, std::string why, std::string advice) {
  return {Errc::bad_argument, "cannot import", std::move(where), std::move(why), std::move(advice)};
}

/// The rows of a file, one after the other.
class Table {
 public:
  Table(std::string path, char separator)
      : path_(std::move(path)), separator_(separator), in_(path_, std::ios::binary) {}
  bool is_open() const { return in_.is_open(); }
  /// The number of the line on which the last row begins.
  std::uint64_t line() const noexcept { return line_; }
  std::string where() const { return path_ + ":" + std::to_string(line_); }

  /// False: there are no more. Errors: bad-data (a quote that does not end, a row of more than 1 MiB).
  Result<bool> next(std::vector<detail::CsvCell>& cells) {
    std::string row, line;
    line_ = next_line_;
    while (std::getline(in_, line)) {
      ++next_line_;
      row += line;
      row += '\n';
      if (line_ == 1 && row.starts_with(detail::byte_order_mark)) row.erase(0, detail::byte_order_mark.size());
      if (row.size() > longest_row)
        return Error{Errc::bad_data, "cannot import", where(), "the row is longer than 1 MiB", ""};
      if (detail::csv_row_size(row) == 0) continue;  // within quotes
      if (row == "\n" || row == "\r\n") {
        row.clear();
        line_ = next_line_;
        continue;
      }
      auto split = detail::split_csv(row, separator_);
      if (!split)
        return Error{Errc::bad_data, "cannot import", where(), split.error().where + ": " + split.error().why, ""};
      cells = *std::move(split);
      return true;
    }
    if (in_.bad()) return Error{Errc::io_failed, "cannot read", path_, "", ""};
    if (!row.empty()) return Error{Errc::bad_data, "cannot import", where(), "a quoted cell does not end", ""};
    return false;
  }

 private:
  std::string path_;
  char separator_;
  std::ifstream in_;
  std::uint64_t line_ = 1, next_line_ = 1;
};

/// How numbers and times are written.
struct Notation {
  char decimal = '.';
  std::string zone = {};
};

/// `scale` times a number such as "1795665132.554291437", to the nearest nanosecond: a double would be up to 119 ns
/// beside a time of today. None: it is written otherwise, or is too large.
std::optional<Duration> exact_time(std::string_view text, char decimal, Duration scale) {
  const bool is_negative = text.starts_with('-');
  if (is_negative || text.starts_with('+')) text.remove_prefix(1);
  const std::size_t mark = text.find(decimal);
  const std::string_view whole_part = text.substr(0, mark);
  std::string_view part = mark == std::string_view::npos ? std::string_view() : text.substr(mark + 1);
  const auto is_digits = [](std::string_view digits) {
    return std::all_of(digits.begin(), digits.end(), [](char c) { return c >= '0' && c <= '9'; });
  };
  std::int64_t whole = 0;
  if (!is_digits(whole_part) || !is_digits(part) || detail::read_number(whole_part, whole) != std::errc{}) return {};
  // 18 digits of the fraction and the scale, in two halves each: their products fit.
  constexpr std::int64_t half = 1'000'000'000;
  const std::string digits = (std::string(part) + std::string(18, '0')).substr(0, 18);
  const std::int64_t high = std::stoll(digits.substr(0, 9)), low = std::stoll(digits.substr(9));
  const std::int64_t scale_high = scale.count() / half, scale_low = scale.count() % half;
  if (scale_high >= half) return {};
  const std::int64_t of_high = high * scale_low, of_low = low * scale_high;
  const std::int64_t rest = of_high % half + of_low % half + low * scale_low / half;
  const std::int64_t fraction = high * scale_high + of_high / half + of_low / half + (rest + half / 2) / half;
  constexpr std::int64_t most = 9'200'000'000'000'000'000;
  if (whole > (most - fraction) / scale.count()) return {};
  const std::int64_t ns = whole * scale.count() + fraction;
  return Duration{is_negative ? -ns : ns};
}

/// Whether the text is a number, and which.
bool is_number(const std::string& text, char decimal, double& number) {
  if (decimal == '.') return detail::read_number(text, number) == std::errc{};
  if (text.find('.') != std::string::npos) return false;
  std::string usual = text;
  if (const std::size_t comma = usual.find(','); comma != std::string::npos) usual[comma] = '.';
  return detail::read_number(usual, number) == std::errc{};
}

struct Column {
  std::string heading, name, unit;
  std::string array;  // of which it is an element, as of "accel[0]"; empty: none
  std::size_t index = 0;
  char decimal = '.';
  // What all its cells can be.
  bool can_be_integer = true, can_be_number = true, has_empty = false, has_any = false;
  bool has_large = false;
  bool can_be_with_comma = true, has_comma = false;  // a number with a decimal comma
  std::size_t longest = 1;

  /// Integers of which some would change as doubles stay texts.
  void look_at_all() { can_be_number = can_be_number && (can_be_integer || !has_large); }
  bool seems_to_have_decimal_commas() const { return has_any && !can_be_number && can_be_with_comma && has_comma; }
  void look_at(const detail::CsvCell& cell) {
    if (cell.text.empty() && !cell.quoted) {
      has_empty = true;
      return;
    }
    has_any = true;
    longest = std::max(longest, cell.text.size());
    std::int64_t integer = 0;
    double number = 0;
    const std::errc as_integer = detail::read_number(cell.text, integer);
    const bool is_integer = as_integer == std::errc{};
    constexpr std::int64_t exact = std::int64_t{1} << 53;  // a double holds all integers up to this
    has_large = has_large || as_integer == std::errc::result_out_of_range ||
                (is_integer && (integer > exact || integer < -exact));
    can_be_integer = can_be_integer && is_integer;
    can_be_number = can_be_number && is_number(cell.text, decimal, number);
    can_be_with_comma = can_be_with_comma && is_number(cell.text, ',', number);
    has_comma = has_comma || cell.text.find(',') != std::string::npos;
  }
  std::string type() const {
    const std::string absent = has_empty ? ", may be absent" : "";
    if (!has_any) return "no values: left out";
    return (can_be_integer  ? "integer"
            : can_be_number ? "number"
                            : "text of up to " + std::to_string(longest) + " bytes") +
           absent;
  }
};

/// "accel[0]": its end without the index, which is set.
std::string_view array_of(std::string_view heading, std::size_t& index) {
  const std::size_t open = heading.rfind('[');
  if (open == std::string_view::npos || open == 0 || heading[open - 1] == ' ' || !heading.ends_with(']')) return {};
  const std::string_view number = heading.substr(open + 1, heading.size() - open - 2);
  return detail::read_number(number, index) == std::errc{} ? heading.substr(0, open) : std::string_view();
}

void make_name(std::string& text) {
  for (char& c : text)
    if ((c < 'a' || c > 'z') && (c < 'A' || c > 'Z') && (c < '0' || c > '9')) c = '_';
  if (text.empty() || (text[0] >= '0' && text[0] <= '9')) text.insert(0, "c");
  if (text == "time" || text == "origin" || text == "sequence" || text == "run") text += "_";
}

/// "chamber temperature [Cel]" is the field chamber_temperature in Cel; of "imu.ax", ax where that is unique.
void name_columns(std::vector<Column>& columns) {
  std::set<std::string> all, twice;
  const auto tail = [](const std::string& text) { return text.substr(text.rfind('.') + 1); };
  for (Column& column : columns) {
    std::string text = column.heading;
    std::size_t index = 0;
    if (const std::size_t open = text.rfind('[');
        open != std::string::npos && text.ends_with(']') && array_of(text, index).empty()) {
      column.unit = text.substr(open + 1, text.size() - open - 2);
      text.resize(open);
    }
    while (!text.empty() && text.back() == ' ') text.pop_back();
    column.array = array_of(text, column.index);
    if (!column.array.empty()) {
      make_name(column.array);
      text = column.array + "_" + std::to_string(column.index);
    }
    column.name = text;
    if (!all.insert(tail(text)).second) twice.insert(tail(text));
  }
  std::set<std::string> names;
  for (Column& column : columns) {
    if (!twice.contains(tail(column.name))) column.name = tail(column.name);
    make_name(column.name);
    const std::string name = column.name;
    for (int i = 2; !names.insert(column.name).second; ++i) column.name = name + "_" + std::to_string(i);
  }
}

/// How many columns from this one on are the elements of an array, all of them numbers; 0: it is none.
std::size_t array_size(std::span<const Column> columns) {
  std::size_t size = 0;
  for (const Column& column : columns) {
    if (column.array.empty() || column.array != columns[0].array || column.index != size) break;
    if (!column.can_be_number || !column.has_any || column.has_empty || column.unit != columns[0].unit) return 0;
    ++size;
  }
  return size;
}

/// By which this would be a time of these decades, since 1970: "; with --scale 1ns it is 2026-03-01". Empty: by none.
std::string scale_of(double number) {
  for (const auto& [scale, name] : {std::pair{1, "1ns"}, {1'000, "1us"}, {1'000'000, "1ms"}}) {
    const double seconds = number * scale / 1e9;
    if (seconds < 631e6 || seconds > 4.1e9) continue;  // 1990 to 2099
    return std::string("; with --scale ") + name + " it is " +
           to_iso8601(Time{std::chrono::seconds{std::llround(seconds)}}).substr(0, 10);
  }
  return "";
}

/// Of a cell of the column of time. Absolute ones are ISO 8601; numbers count `scale` from `start`.
Result<Time> time_of(const std::string& text, const Notation& notation, Duration scale, Time start) {
  if (const auto exact = exact_time(text, notation.decimal, scale)) return start + *exact;
  double number = 0;
  if (is_number(text, notation.decimal, number)) {
    const double ns = number * static_cast<double>(scale.count());
    if (std::abs(ns) < 9.2e18) return start + Duration{std::llround(ns)};
    return refused("", text + " is no time that can be recorded", "look at --scale");
  }
  const auto time = parse_iso8601(text);
  if (time) return time;
  const auto with_zone = parse_iso8601(text + (notation.zone.empty() ? "Z" : notation.zone));
  if (!with_zone) return time;
  if (notation.zone.empty())
    return refused("", "it says no time zone", "write --zone Z if it is UTC, or such as +01:00");
  return with_zone;
}

Result<Value> value_of(const Column& column, const detail::CsvCell& cell) {
  if (cell.text.empty() && !cell.quoted) return Value{};
  std::int64_t integer = 0;
  if (column.can_be_integer && detail::read_number(cell.text, integer) == std::errc{}) return Value(integer);
  double number = 0;
  if (column.can_be_number && is_number(cell.text, column.decimal, number)) return Value(number);
  return Value(cell.text);
}

/// What the table is, found by reading it once.
struct Found {
  std::vector<Column> columns;  // all of the file
  std::size_t time_column = 0;
  Time first{};
  std::uint64_t rows = 0;
  std::shared_ptr<const Description> description;
};

/// How to write a separator on the command line.
std::string shown_separator(char separator) { return separator == '\t' ? "tab" : std::string("\"") + separator + "\""; }

/// What separates the columns, when it is another character than was said: how to say it. Empty: not known.
std::string separator_advice(const ImportOptions& options, char said) {
  std::ifstream in(options.file, std::ios::binary);
  std::string head, row;
  std::getline(in, head);
  std::getline(in, row);
  const auto count = [](const std::string& text, char c) { return std::count(text.begin(), text.end(), c); };
  char best = said;
  for (const char one : {',', ';', '\t', '|'})
    if (one != said && count(head, one) > count(head, best) && count(head, one) <= count(row, one)) best = one;
  if (best == said) return {};
  std::string advice = "its columns seem to be separated by " + shown_separator(best) + ": write --separator " +
                       shown_separator(best);
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  for (std::size_t i = 1; best != ',' && options.decimal.empty() && i + 1 < row.size(); ++i) {
    if (row[i] == ',' && is_digit(row[i - 1]) && is_digit(row[i + 1])) return advice + " --decimal ,";
  }
  return advice;
}

Result<void> check_text(const Table& table, const Column& column, const std::string& text, const std::string& file) {
  if (detail::is_readable(text)) return {};
  return refused(
      table.where(),
      "the text \"" + detail::readable(text.substr(0, 40)) + "\" in column " + column.heading + " is no UTF-8",
      "convert the file: iconv -f WINDOWS-1252 -t UTF-8 " + file);
}

Result<Found> look_at(const ImportOptions& options, char separator, const Notation& notation, Duration scale,
                      Time start) {
  Table table(options.file, separator);
  if (!table.is_open()) return system_error(errno, "cannot read", options.file, "give the path of a CSV file");
  std::vector<detail::CsvCell> cells;
  auto head = table.next(cells);
  if (!head) return head.error();
  if (!*head) return refused(options.file, "it is empty", "its first row names the columns");
  Found found;
  std::vector<std::string_view> headings;
  for (const detail::CsvCell& cell : cells) {
    if (!detail::is_readable(cell.text))
      return refused(table.where(), "the heading \"" + detail::readable(cell.text.substr(0, 40)) + "\" is no UTF-8",
                     "convert the file: iconv -f WINDOWS-1252 -t UTF-8 " + options.file);
    Column& column = found.columns.emplace_back();
    column.heading = cell.text;
    column.decimal = notation.decimal;
  }
  for (const Column& column : found.columns) headings.push_back(column.heading);
  const auto is_it = [&](std::string_view heading) {  // with its unit or without
    return heading == options.time_column || heading.substr(0, heading.find(" [")) == options.time_column;
  };
  const auto exact = std::count(headings.begin(), headings.end(), options.time_column);
  const auto matching = std::count_if(headings.begin(), headings.end(), is_it);
  if (exact > 1 || (exact == 0 && matching > 1))
    return refused(
        options.file, "it has " + std::to_string(std::max(exact, matching)) + " columns " + options.time_column,
        exact > 1 ? "give one of them another heading" : "write --time with the unit, as its heading has it");
  const auto at = exact == 1 ? std::find(headings.begin(), headings.end(), options.time_column)
                             : std::find_if(headings.begin(), headings.end(), is_it);
  if (at == headings.end()) {
    const std::string advice = separator_advice(options, separator);
    return refused(options.file, "it has no column " + options.time_column,
                   advice.empty() ? detail::suggestion(options.time_column, headings) : advice);
  }
  found.time_column = static_cast<std::size_t>(at - headings.begin());
  name_columns(found.columns);
  for (;;) {
    auto row = table.next(cells);
    if (!row) return row.error();
    if (!*row) break;
    if (cells.size() != found.columns.size())
      return Error{
          Errc::bad_data, "cannot import", table.where(),
          std::to_string(cells.size()) + " cells, where the first row has " + std::to_string(found.columns.size()), ""};
    const std::string& when = cells[found.time_column].text;
    const auto time = time_of(when, notation, scale, start);
    if (!time) {
      double number = 0;
      const bool is_beyond = is_number(when, notation.decimal, number);
      const bool has_comma = options.decimal.empty() && is_number(when, ',', number);
      const bool has_date = when.size() >= 10 && when[4] == '-' && when[7] == '-';
      return Error{Errc::bad_data, "cannot import", table.where(),
                   "\"" + detail::readable(when.substr(0, 64)) + "\" in column " + options.time_column + " is no time" +
                       (is_beyond  ? " that can be recorded, which are those from 1678 to 2261"
                        : has_date ? ": " + time.error().why
                                   : ""),
                   is_beyond                                  ? "look at --scale" + scale_of(number)
                   : has_comma                                ? "its numbers have decimal commas: write --decimal ,"
                   : has_date && !time.error().advice.empty() ? time.error().advice
                                                              : "a number, or a time as 2026-03-01T12:00:00Z"};
    }
    if (found.rows++ == 0) found.first = *time;
    found.first = std::min(found.first, *time);
    for (std::size_t i = 0; i < cells.size(); ++i) {
      if (auto good = check_text(table, found.columns[i], cells[i].text, options.file); !good)
        return std::move(good).error();
      found.columns[i].look_at(cells[i]);
    }
  }
  if (found.rows == 0) return refused(options.file, "it has no rows", "");
  for (Column& column : found.columns) {
    column.look_at_all();
    if (options.decimal.empty() && column.seems_to_have_decimal_commas())
      return refused(options.file, "the numbers in column " + column.heading + " seem to have decimal commas",
                     "write --decimal , or, if they are texts, --decimal .");
  }
  DescriptionBuilder builder("import");
  const std::span<Column> columns(found.columns);
  for (std::size_t i = 0; i < columns.size(); ++i) {
    const Column& column = columns[i];
    if (i == found.time_column || !column.has_any) continue;
    if (const std::size_t size = array_size(columns.subspan(i)); size > 0) {
      const auto elements = columns.subspan(i, size);
      const bool is_integer = std::all_of(elements.begin(), elements.end(),
                                          [](const Column& one) { return one.can_be_integer; });
      builder.array(column.array, is_integer ? Kind::i64 : Kind::f64, size, column.unit);
      for (Column& element : elements) {
        element.can_be_integer = is_integer;
        element.name = element.array + "[" + std::to_string(element.index) + "]";
      }
      i += size - 1;
      continue;
    }
    using Presence = DescriptionBuilder::Presence;
    const Presence presence = column.has_empty ? Presence::optional : Presence::always;
    if (column.can_be_number) {
      builder.field(column.name, column.can_be_integer ? Kind::i64 : Kind::f64, column.unit, presence);
    } else if (column.longest <= longest_text) {
      builder.text(column.name, column.longest, presence);
    } else {
      return refused(options.file,
                     "a text in column " + column.heading + " has " + std::to_string(column.longest) + " bytes",
                     "1024 at most");
    }
  }
  auto built = builder.build();
  if (!built) return built.error();
  found.description = *std::move(built);
  const TopicToRecord topic{options.topic, found.description.get()};
  const auto refusals = refused_topics(SqliteConfig{.path = options.database}, std::span(&topic, 1));
  if (!refusals.empty()) return refused(options.file, refusals.front().why, refusals.front().advice);
  return found;
}

Result<std::uint64_t> record(const ImportOptions& options, const Found& found, char separator, const Notation& notation,
                             Duration scale, Time start, std::uint64_t& moved) {
  ManualClock clock(found.first - Duration{1});
  Runtime runtime({.name = std::filesystem::path(options.file).filename().string(), .clock = &clock});
  Loop loop(runtime, {.name = "import"});
  std::optional<Error> failed;
  loop.on_error([&](const ErrorReport& report) {
    if (!failed) failed = report.error;
  });
  // First, since a wrong name is refused before there is a file.
  AnyFeed feed(loop, {.name = options.origin, .topic = options.topic}, found.description);
  // Time passes as fast as it goes: what is stored together is a matter of memory, not of time.
  SqliteSink sink(loop, {.path = options.database, .sink = {.batch_time = std::chrono::hours{1}}});
  Table table(options.file, separator);
  std::vector<detail::CsvCell> cells;
  (void)table.next(cells);
  Time last = found.first - Duration{1};
  std::vector<std::byte> payload;
  for (;;) {
    auto row = table.next(cells);
    if (!row) return row.error();
    if (!*row) break;
    const auto time = time_of(cells[found.time_column].text, notation, scale, start);
    if (!time || cells.size() != found.columns.size())
      return refused(table.where(), "the file has changed while it was read", "try again");
    payload.assign(found.description->size(), std::byte{0});
    std::size_t leaf = 0;
    for (std::size_t i = 0; i < cells.size(); ++i) {
      if (i == found.time_column || !found.columns[i].has_any) continue;
      const auto value = value_of(found.columns[i], cells[i]);
      if (auto done = write(found.description->leaves()[leaf++], payload.data(), *value); !done)
        return refused(table.where(), done.error().text(), "the file has changed while it was read");
    }
    if (*time <= last) ++moved;
    loop.advance(std::max(*time - last, Duration{0}));
    last = std::max(last, *time);
    feed.publish_bytes(payload, *time);
    if (failed) return *failed;
  }
  if (const std::uint64_t lost = loop.close(); lost > 0 || failed)
    return failed ? *failed : refused(options.database, std::to_string(lost) + " rows could not be stored", "");
  return found.rows;
}

}  // namespace

int import_table(const ImportOptions& options, std::ostream& out, std::ostream& err) {
  const auto fail = [&](const Error& error) {
    err << "rtdata: " << error.text() << "\n";
    return 1;
  };
  try {
    const auto scale = parse_duration(options.scale);
    if (!scale) return fail(scale.error());
    if (*scale <= Duration{0}) return fail(refused("--scale " + options.scale, "it is not above 0", "such as 10us"));
    Time start{};
    if (!options.start.empty()) {
      const auto given = parse_iso8601(options.start);
      if (!given) return fail(given.error());
      start = *given;
    }
    ImportOptions named = options;
    const std::string stem = std::filesystem::path(options.file).stem().string();
    if (named.topic.empty()) named.topic = stem;
    if (named.origin.empty()) named.origin = stem;
    if (named.database.empty()) named.database = std::filesystem::path(options.file).replace_extension(".db").string();
    const char separator = named.separator == "tab" || named.separator == "\\t" ? '\t'
                           : named.separator.size() == 1                        ? named.separator[0]
                                                                                : '\0';
    const Notation notation{named.decimal == "," ? ',' : '.', named.zone};
    if (separator != '\t' &&
        (separator < ' ' || separator == '"' || std::isalnum(static_cast<unsigned char>(separator))))
      return fail(
          refused("--separator " + named.separator, "it is no character between cells", "such as \";\", or tab"));
    if (separator == notation.decimal)
      return fail(refused("--separator " + named.separator, "it is the decimal mark, too", "set --decimal"));
    if (!notation.zone.empty() && !parse_iso8601("2026-03-01T12:00:00" + notation.zone))
      return fail(refused("--zone " + notation.zone, "it is no time zone", "Z, which is UTC, or such as +01:00"));
    auto found = look_at(named, separator, notation, *scale, start);
    if (!found) return fail(found.error());
    const Column& time = found->columns[found->time_column];
    if (const auto unit = parse_duration("1 " + time.unit); unit && *unit != *scale && time.can_be_number)
      return fail(
          refused(named.file,
                  "its column " + time.heading + " says " + time.unit + ", and --scale 1 in it is " + to_string(*scale),
                  "write --scale \"1 " + time.unit + "\", or change the heading"));
    std::uint64_t moved = 0;
    const auto rows = record(named, *found, separator, notation, *scale, start, moved);
    if (!rows) return fail(rows.error());
    out << named.database << ": " << *rows << (*rows == 1 ? " row" : " rows") << " of " << named.file << " on topic "
        << named.topic << ", from " << to_iso8601(found->first) << " on\n";
    for (std::size_t i = 0; i < found->columns.size(); ++i) {
      const Column& column = found->columns[i];
      out << "  " << column.heading << ": "
          << (i == found->time_column ? "the time" : column.name + ", " + column.type()) << "\n";
    }
    if (moved > 0)
      err << "rtdata: warning: " << moved
          << " rows were not later than the row before; each got a time 1 ns after it\n";
    return 0;
  } catch (const SetupError& error) {
    return fail(error.error());
  }
}

}  // namespace rtdata::app
