#include "app/inspect/import_head.hpp"

#include <algorithm>
#include <string_view>
#include <utility>

#include "data/nearest.hpp"

namespace rtdata::app {
namespace {

/// The option for the probable separator, if the given one is wrong. Empty: unknown.
std::string separator_advice(const ImportOptions& options, const ImportNotation& notation) {
  ImportRows table(options.file, notation);
  std::string head, row;
  for (std::uint64_t i = 0; i < notation.skip; ++i) table.next_line(head);
  const auto next = [&](std::string& line) {  // no comment
    while (table.next_line(line)) {
      const std::string_view text = std::string_view(line).substr(
          std::min(line.find_first_not_of(" \t\r"), line.size()));
      const bool is_comment = text.starts_with('#') ||
                              std::any_of(notation.comments.begin(), notation.comments.end(),
                                          [&](const std::string& begin) { return text.starts_with(begin); });
      if (!text.empty() && !is_comment) return true;
    }
    return false;
  };
  if (!next(head) || !next(row)) {  // of which all but one are comments
    ImportRows again(options.file, notation);
    for (std::uint64_t i = 0; i <= notation.skip; ++i) again.next_line(head);
    again.next_line(row);
  }
  const auto count = [](const std::string& text, char c) { return std::count(text.begin(), text.end(), c); };
  char best = notation.separator;
  for (const char one : {',', ';', '\t', '|'})
    if (one != notation.separator && count(head, one) > count(head, best) && count(head, one) <= count(row, one))
      best = one;
  if (best == notation.separator) return {};
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

std::string counted(std::size_t columns) { return std::to_string(columns) + (columns == 1 ? " column" : " columns"); }

/// True if it has names of columns with a comma between.
bool are_columns(const std::string& text, const std::vector<ImportColumn>& columns) {
  const auto names = detail::split_csv(text);
  return names && std::all_of(names->begin(), names->end(), [&](const detail::CsvCell& name) {
           return std::any_of(columns.begin(), columns.end(), [&](const ImportColumn& one) {
             return one.heading == name.text || one.bare == name.text;
           });
         });
}

/// The option for lines before the heading. Empty: there seem to be none.
std::string skip_advice(const std::string& heading, std::size_t columns, const ImportOptions& options,
                        const ImportNotation& notation) {
  constexpr int most_lines = 1000;
  ImportRows table(options.file, notation);
  std::vector<detail::CsvCell> cells;
  std::string wider, has_it;  // prefers lines with as many cells as the one below
  std::string maybe_wider, may_have_it;
  std::size_t before = 0;
  std::uint64_t first = 0;
  for (int i = 0; i < most_lines; ++i) {
    const Result<bool> more = table.next(cells);
    if (more && !*more) break;
    if (!more) continue;  // of another program's text
    if (first == 0) first = table.line();
    if (cells.size() == before && !may_have_it.empty()) return may_have_it;
    if (cells.size() == before && wider.empty()) wider = maybe_wider;
    before = cells.size();
    may_have_it.clear();
    std::vector<ImportColumn> names(cells.size());
    for (std::size_t k = 0; k < cells.size(); ++k) names[k].heading = cells[k].text;
    name_columns(names);
    const std::string skip = ": write --skip " + std::to_string(table.line() - 1);
    if (std::any_of(names.begin(), names.end(),
                    [&](const ImportColumn& one) { return one.heading == heading || one.bare == heading; }))
      may_have_it = "line " + std::to_string(table.line()) + " has it" + skip;
    if (has_it.empty()) has_it = may_have_it;
    if (cells.size() > columns)
      maybe_wider = "line " + std::to_string(first) + " has " + counted(columns) + ", line " +
                    std::to_string(table.line()) + " has " + std::to_string(cells.size()) + skip;
  }
  return !has_it.empty() ? has_it : wider.empty() ? maybe_wider : wider;
}

constexpr const char* name_of_kind = "kind";  // of the first column, in a log of DataFlash

/// The row of a log of DataFlash that names the columns of a kind: FMT, 129, 31, IMU, QBff, TimeUS,I,GyrX,GyrY
std::vector<ImportColumn> read_format(ImportRows& table, const ImportOptions& options) {
  const std::string& kind = options.only.front();
  constexpr std::size_t name = 3, first = 5;
  std::vector<ImportColumn> columns(1);
  columns.front().heading = name_of_kind;
  std::vector<std::string> kinds;
  std::vector<detail::CsvCell> cells;
  table.choose({{.text = "FMT"}});
  table.go_to(0, 1);
  while (columns.size() == 1 && table.next(cells).or_throw()) {
    if (cells.size() <= first) continue;
    if (cells[name].text != kind) {
      kinds.push_back(cells[name].text);
      continue;
    }
    for (std::size_t i = first; i < cells.size(); ++i) {
      table.check_text(cells[i].text, nullptr);
      columns.emplace_back().heading = cells[i].text;
    }
  }
  if (columns.size() == 1)
    refuse_import(options.file, "it has no FMT row that names the columns of " + kind,
                  detail::suggestion(kind, {kinds.begin(), kinds.end()}));
  table.choose({});
  table.go_to(0, 1);
  name_columns(columns);
  return columns;
}

/// The heading in a comment line, as OpenRocket and numpy write it: it names the time, which the first row does not,
/// and has as many cells as that. Empty: there is none.
std::vector<ImportColumn> head_in_comment(const ImportOptions& options, ImportNotation notation) {
  const std::vector<std::string> comments = std::exchange(notation.comments, {});
  if (comments.empty() || options.time_columns.empty()) return {};
  constexpr int most_lines = 1000;
  ImportRows table(options.file, notation);
  std::vector<detail::CsvCell> cells;
  std::vector<ImportColumn> head;
  const auto names = [&] {
    std::vector<ImportColumn> columns(cells.size());
    for (std::size_t i = 0; i < cells.size(); ++i) columns[i].heading = cells[i].text;
    name_columns(columns);
    return columns;
  };
  const auto has_time = [&](const std::vector<ImportColumn>& columns) {
    return std::any_of(columns.begin(), columns.end(), [&](const ImportColumn& one) {
      return one.heading == options.time_columns.front() || one.bare == options.time_columns.front();
    });
  };
  for (int i = 0; i < most_lines; ++i) {
    const Result<bool> more = table.next(cells);
    if (!more || !*more) return {};
    std::string& first = cells.front().text;
    const auto begin = std::find_if(comments.begin(), comments.end(),
                                    [&](const std::string& one) { return !one.empty() && first.starts_with(one); });
    if (begin == comments.end()) return head.size() == cells.size() && !has_time(names()) ? head : decltype(head)();
    first.erase(0, begin->size());
    first.erase(0, std::min(first.find_first_not_of(" \t"), first.size()));
    if (first.empty() && notation.has_blanks) cells.erase(cells.begin());
    if (auto columns = names(); has_time(columns)) head = std::move(columns);
  }
  return {};
}

}  // namespace

std::string shown_separator(char separator) { return separator == '\t' ? "tab" : std::string("\"") + separator + "\""; }

std::vector<ImportColumn> read_head(ImportRows& table, const ImportOptions& options, const ImportNotation& notation) {
  std::vector<ImportColumn> columns;
  std::vector<detail::CsvCell> cells;
  const auto next = [&](const std::string& otherwise) {
    if (!table.next(cells).or_throw())
      refuse_import(
          options.file, otherwise,
          options.skip > 0 ? "check --skip " + std::to_string(options.skip) : "its first row names the columns");
    for (const detail::CsvCell& cell : cells) table.check_text(cell.text, nullptr);
    if (columns.size() < cells.size()) columns.resize(cells.size());
  };
  if (!options.columns.empty()) {
    const auto names = detail::split_csv(options.columns);
    if (!names) refuse_import("--columns " + options.columns, names.error().why, "write names such as t,v");
    for (const detail::CsvCell& name : *names) columns.emplace_back().heading = name.text;
  } else if (auto head = head_in_comment(options, notation); options.head == 1 && !head.empty()) {
    columns = std::move(head);
  } else {
    next(options.skip > 0 ? "it has no more than " + std::to_string(options.skip) + " lines" : "it is empty");
    const bool has_formats = cells.front().text == "FMT" && !options.only.empty();
    if (has_formats && options.only.front().find('=') == std::string::npos) return read_format(table, options);
    for (std::size_t i = 0; i < cells.size(); ++i) columns[i].heading = cells[i].text;
    if (options.head > 1) {
      next("it has one row, and --head 2 is given");
      // The heading of several columns is in the cell of the first.
      for (std::size_t i = 1; i < cells.size(); ++i)
        if (columns[i].heading.empty()) columns[i].heading = columns[i - 1].heading;
      for (std::size_t i = 0; i < cells.size(); ++i) {
        std::string& heading = columns[i].heading;
        heading += (heading.empty() || cells[i].text.empty() ? "" : " ") + cells[i].text;
      }
    }
  }
  name_columns(columns);
  if (options.units == "row") {
    next("it has no row of units");
    for (std::size_t i = 0; i < cells.size(); ++i)
      if (std::string unit = unit_of(cells[i].text); !unit.empty()) columns[i].unit = std::move(unit);
  }
  return columns;
}

std::size_t find_column(const std::vector<ImportColumn>& columns, const std::string& heading,
                        const ImportOptions& options, const ImportNotation& notation) {
  std::vector<std::string_view> headings;
  for (const ImportColumn& column : columns) headings.push_back(column.heading);
  const auto is_it = [&](const ImportColumn& column) { return column.heading == heading || column.bare == heading; };
  const auto exact = std::count(headings.begin(), headings.end(), heading);
  const auto matching = std::count_if(columns.begin(), columns.end(), is_it);
  if (exact > 1 || (exact == 0 && matching > 1))
    refuse_import(options.file, "it has " + std::to_string(std::max(exact, matching)) + " columns " + heading,
                  exact > 1 ? "name the columns yourself: --columns, and --skip for the heading"
                            : "write it with the unit, as its heading has it");
  if (exact == 1)
    return static_cast<std::size_t>(std::find(headings.begin(), headings.end(), heading) - headings.begin());
  const auto at = std::find_if(columns.begin(), columns.end(), is_it);
  if (at != columns.end()) return static_cast<std::size_t>(at - columns.begin());
  if (!options.columns.empty())
    refuse_import("--columns " + options.columns, "there is no column " + heading,
                  detail::suggestion(heading, headings));
  const bool has_formats = !options.only.empty() && headings.front() == name_of_kind;
  std::string advice = has_formats ? detail::suggestion(heading, headings) : separator_advice(options, notation);
  const auto is_value = [&](std::string_view text) {  // a number or a time
    const bool is_dated = text.size() > 4 && text.find_first_not_of("0123456789.:-/+TZ ") == std::string_view::npos;
    double number = 0;
    return is_dated || is_number(text, notation.numbers, number);
  };
  const auto values = static_cast<std::size_t>(std::count_if(headings.begin(), headings.end(), is_value));
  if (advice.empty() && heading.find(',') != std::string::npos && are_columns(heading, columns))
    advice = "write blanks between the names of several columns, as in --time date time";
  for (const std::string_view one : headings)
    if (advice.empty() && options.head > 1 && one.starts_with(heading + " "))
      advice = "with --head 2 write --time \"" + std::string(one) + "\"";
  if (advice.empty() && headings.front() == "FMT")
    advice = "its rows have different kinds, named in the first cell: take one, such as --only IMU";
  const std::string skip = advice.empty() ? skip_advice(heading, columns.size(), options, notation) : "";
  const bool is_below = skip.find(" has it: ") != std::string::npos;
  if (advice.empty() && (is_value(headings.front()) || (values > columns.size() / 2 && !is_below)))
    advice = "its first row seems not to be a heading: name its " + counted(columns.size()) + " by --columns t,...";
  if (advice.empty()) advice = skip;
  refuse_import(options.file, "it has no column " + heading,
                advice.empty() ? detail::suggestion(heading, headings) : advice);
}

}  // namespace rtdata::app
