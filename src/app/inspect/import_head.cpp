#include "app/inspect/import_head.hpp"

#include <algorithm>
#include <string_view>

#include "data/nearest.hpp"

namespace rtdata::app {
namespace {

/// The option for the probable separator, if the given one is wrong. Empty: unknown.
std::string separator_advice(const ImportOptions& options, const ImportNotation& notation) {
  ImportRows table(options.file, notation);
  std::string head, row;
  for (std::uint64_t i = 0; i <= notation.skip; ++i) table.next_line(head);
  table.next_line(row);
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
  std::string wider;
  std::uint64_t first = 0;
  for (int i = 0; i < most_lines; ++i) {
    const Result<bool> more = table.next(cells);
    if (more && !*more) break;
    if (!more) continue;  // of another program's text
    if (first == 0) first = table.line();
    std::vector<ImportColumn> names(cells.size());
    for (std::size_t k = 0; k < cells.size(); ++k) names[k].heading = cells[k].text;
    name_columns(names);
    const std::string skip = ": write --skip " + std::to_string(table.line() - 1);
    if (std::any_of(names.begin(), names.end(),
                    [&](const ImportColumn& one) { return one.heading == heading || one.bare == heading; }))
      return "line " + std::to_string(table.line()) + " has it" + skip;
    if (wider.empty() && cells.size() > columns)
      wider = "line " + std::to_string(first) + " has " + counted(columns) + ", line " + std::to_string(table.line()) +
              " has " + std::to_string(cells.size()) + skip;
  }
  return wider;
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

}  // namespace

std::string shown_separator(char separator) { return separator == '\t' ? "tab" : std::string("\"") + separator + "\""; }

std::vector<ImportColumn> read_head(ImportRows& table, const ImportOptions& options) {
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
    if (!names) refuse_import("--columns " + options.columns, names.error().why, "such as: t,v");
    for (const detail::CsvCell& name : *names) columns.emplace_back().heading = name.text;
  } else {
    next(options.skip > 0 ? "it has no more than " + std::to_string(options.skip) + " lines" : "it is empty");
    const bool has_formats = cells.front().text == "FMT" && !options.only.empty();
    if (has_formats && options.only.front().find('=') == std::string::npos) return read_format(table, options);
    for (std::size_t i = 0; i < cells.size(); ++i) columns[i].heading = cells[i].text;
    if (options.head > 1) {
      next("it has one row, and --head 2 is given");
      // A cell that spans several columns is written over the first of them.
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
    advice = "of several columns there are blanks between their names, as in --time date time";
  if (advice.empty() && headings.front() == "FMT")
    advice = "each of its rows is of the kind that it begins with: take one, such as --only IMU";
  const std::string skip = advice.empty() ? skip_advice(heading, columns.size(), options, notation) : "";
  const bool is_below = skip.find(" has it: ") != std::string::npos;
  if (advice.empty() && (is_value(headings.front()) || (values > columns.size() / 2 && !is_below)))
    advice = "its first row seems to be no heading: name its " + counted(columns.size()) + " by --columns t,...";
  if (advice.empty()) advice = skip;
  refuse_import(options.file, "it has no column " + heading,
                advice.empty() ? detail::suggestion(heading, headings) : advice);
}

}  // namespace rtdata::app
