#include "app/inspect/import_columns.hpp"

#include <algorithm>
#include <set>
#include <string_view>
#include <utility>

#include "app/inspect/import_time.hpp"
#include "data/lower_case.hpp"
#include "data/number_text.hpp"

namespace rtdata::app {
namespace {

constexpr std::size_t longest_text = 1024;

/// "accel[0]": its end without the index, which is set.
std::string_view array_of(std::string_view heading, std::size_t& index) {
  const std::size_t open = heading.rfind('[');
  if (open == std::string_view::npos || open == 0 || heading[open - 1] == ' ' || !heading.ends_with(']')) return {};
  const std::string_view number = heading.substr(open + 1, heading.size() - open - 2);
  return detail::read_number(number, index) == std::errc{} ? heading.substr(0, open) : std::string_view();
}

/// The position of the bracket that the last character closes, which is `close`; units contain brackets too, such as
/// [m[H2O]].
std::size_t opening_bracket(std::string_view heading, char open, char close) {
  int depth = 0;
  for (std::size_t at = heading.ends_with(close) ? heading.size() : 0; at-- > 0;) {
    if (heading[at] == close) ++depth;
    if (heading[at] == open && --depth == 0) return at;
  }
  return std::string_view::npos;
}

/// True if a text in ( ) is a unit: a short word, such as feet or m/s; "at nozzle" and "2" are not.
bool is_unit(std::string_view text) {
  constexpr std::size_t longest = 10;
  return !text.empty() && text.size() <= longest && text.find(' ') == std::string_view::npos &&
         text.find_first_not_of("0123456789") != std::string_view::npos;
}

void make_name(std::string& text) {
  for (char& c : text)
    if ((c < 'a' || c > 'z') && (c < 'A' || c > 'Z') && (c < '0' || c > '9')) c = '_';
  if (text.empty() || (text[0] >= '0' && text[0] <= '9')) text.insert(0, "c");
  for (const char* taken : {"time", "origin", "sequence", "run", "_rowid_"})
    if (detail::lower_case(text) == taken) text += "_";
}

/// How many columns from this one on are elements of an array of numbers; 0: not an array.
std::size_t array_size(std::span<const ImportColumn> columns) {
  std::size_t size = 0;
  for (const ImportColumn& column : columns) {
    if (column.array.empty() || column.array != columns[0].array || column.index != size) break;
    if (!column.can_be_number || !column.has_any || column.has_empty || column.unit != columns[0].unit) return 0;
    ++size;
  }
  return size;
}

/// The name, with a number after it if a column already has it.
std::string free_name(const std::string& name, const std::vector<ImportColumn>& columns) {
  std::string free = name;
  const auto is_taken = [&](const ImportColumn& column) {
    const std::string other = detail::lower_case(column.name);
    return other == detail::lower_case(free) || other.starts_with(detail::lower_case(free) + "[");
  };
  for (int i = 2; std::any_of(columns.begin(), columns.end(), is_taken); ++i) free = name + "_" + std::to_string(i);
  return free;
}

}  // namespace

void ImportColumn::look_at(const detail::CsvCell& cell, std::uint64_t line) {
  if (cell.text.empty() && !cell.quoted) {
    has_empty = true;
    return;
  }
  has_any = true;
  longest = std::max(longest, cell.text.size());
  std::int64_t integer = 0;
  double number = 0;
  std::string buffer;
  const std::errc as_integer = detail::read_number(usual_number(cell.text, numbers, buffer), integer);
  const bool is_integer = as_integer == std::errc{};
  constexpr std::int64_t exact = std::int64_t{1} << 53;  // a double holds all integers up to this
  const bool is_large = as_integer == std::errc::result_out_of_range ||
                        (is_integer && (integer > exact || integer < -exact));
  if (is_large && !std::exchange(has_large, true)) {
    first_large = cell.text.substr(0, 40);
    first_large_line = line;
  }
  can_be_integer = can_be_integer && is_integer;
  const bool is_a_number = is_number(cell.text, numbers, number);
  can_be_number = can_be_number && is_a_number;
  if (is_integer && cell.text.size() > 1 && cell.text[0] == '0' && with_zeros.empty())
    with_zeros = cell.text.substr(0, 40);
  if (is_a_number) {
    never_falls = never_falls && (values == 0 || number >= before);
    rises = rises || (values > 0 && number > before);
    before = number;
  }
  ++values;
  if (!is_a_number && texts++ == 0) {
    first_text = cell.text.substr(0, 40);
    first_text_line = line;
    for (const char* const mark : {".", ",", " ", "'", "\u00a0", "\u202f", "\u2019"})
      if (numbers.thousands.empty() && mark != std::string(1, numbers.decimal)) marks.push_back({mark});
  }
  if (!is_a_number && cell.text.size() < 40) look_at_text(cell.text);
  can_be_with_comma = can_be_with_comma && is_number(cell.text, {','}, number);
  const bool is_with_comma = cell.text.find(',') != std::string::npos;
  has_comma = has_comma || is_with_comma;
  can_be_thousands = can_be_thousands && (!is_with_comma || may_have_thousands(cell.text));
  are_whole = are_whole && (is_with_comma ? may_have_thousands(cell.text) : is_number(cell.text, {}, number));
}

void ImportColumn::look_at_text(const std::string& text) {
  double number = 0;
  for (Mark& mark : marks)
    if (text.find(mark.text) != std::string::npos && is_number(text, {numbers.decimal, mark.text}, number))
      ++mark.count;
  const std::size_t end = text.find_last_of("0123456789");
  if (end == std::string::npos || end + 1 == text.size() || !is_number(text.substr(0, end + 1), numbers, number))
    return;
  if (numbers_with_more == 0) more = text.substr(end + 1);
  if (text.compare(end + 1, std::string::npos, more) == 0) ++numbers_with_more;
}

std::string ImportColumn::thousands_in_texts() const {
  for (const Mark& mark : marks)
    if (texts > 0 && mark.count == texts) return mark.text;
  return {};
}

std::string ImportColumn::type() const {
  const std::string absent = has_empty ? ", may be absent" : "";
  if (!has_any) return "no values: left out";
  return (can_be_integer  ? "integer"
          : can_be_number ? "number"
                          : "text of up to " + std::to_string(longest) + " bytes") +
         absent;
}

void name_columns(std::vector<ImportColumn>& columns) {
  std::set<std::string> all, twice;
  bool is_of_export = false;
  for (std::size_t i = 1; i < columns.size(); ++i)
    is_of_export = is_of_export || (columns[i - 1].heading == "origin" && columns[i].heading == "sequence");
  const auto tail = [&](const std::string& text) { return is_of_export ? text.substr(text.rfind('.') + 1) : text; };
  const auto key = [&](const std::string& text) { return detail::lower_case(tail(text)); };
  for (ImportColumn& column : columns) {
    std::string text = column.heading;
    // Many programs begin the heading so, for readers that take it as a comment.
    if (&column == &columns.front()) text.erase(0, std::min(text.find_first_not_of("# "), text.size()));
    std::size_t index = 0;
    std::size_t open = opening_bracket(text, '[', ']');
    if (open != std::string::npos && !array_of(text, index).empty()) open = std::string::npos;
    if (open == std::string::npos) {
      open = opening_bracket(text, '(', ')');
      column.is_round = open != std::string::npos && open > 0 && is_unit(text.substr(open + 1, text.size() - open - 2));
      if (!column.is_round) open = std::string::npos;
    }
    if (open != std::string::npos) {
      column.unit = text.substr(open + 1, text.size() - open - 2);
      text.resize(open);
      if (column.is_round)
        while (text.ends_with('_')) text.pop_back();  // Flight_Time_(s)
    }
    while (!text.empty() && text.back() == ' ') text.pop_back();
    column.bare = text;
    column.array = array_of(text, column.index);
    if (!column.array.empty()) {
      make_name(column.array);
      text = column.array + "_" + std::to_string(column.index);
    }
    column.name = text;
    if (!all.insert(key(text)).second) twice.insert(key(text));
  }
  // "altitude (baro)" and "altitude (GPS)": the text that distinguishes them is not a unit.
  for (ImportColumn& column : columns) {
    if (!column.is_round || !column.array.empty() || !twice.contains(key(column.name))) continue;
    column.name = column.bare + "_" + column.unit;
    column.unit.clear();
  }
  std::set<std::string> names;
  for (ImportColumn& column : columns) {
    if (!twice.contains(key(column.name))) column.name = tail(column.name);
    make_name(column.name);
    const std::string name = column.name;
    for (int i = 2; !names.insert(detail::lower_case(column.name)).second; ++i)
      column.name = name + "_" + std::to_string(i);
  }
}

bool says_a_place(const std::string& heading) {
  const auto is_letter = [&](std::size_t at) { return (heading[at] | 0x20) >= 'a' && (heading[at] | 0x20) <= 'z'; };
  const std::string lower = detail::lower_case(heading);
  for (const char* const word : {"lat", "lon", "lng"})
    for (std::size_t at = lower.find(word); at != std::string::npos; at = lower.find(word, at + 1))
      if (at == 0 || !is_letter(at - 1) || (heading[at] == 'L' && heading[at - 1] >= 'a')) return true;
  return false;
}

std::string unit_of(std::string text) {
  if (text == "-") return {};
  const bool is_in_brackets = opening_bracket(text, '[', ']') == 0 || opening_bracket(text, '(', ')') == 0;
  return is_in_brackets ? text.substr(1, text.size() - 2) : text;
}

Result<std::shared_ptr<const Description>> describe_columns(std::vector<ImportColumn>& columns,
                                                            const std::string& file) {
  DescriptionBuilder builder("import");
  const std::span<ImportColumn> all(columns);
  for (std::size_t i = 0; i < columns.size(); ++i) {
    const ImportColumn& column = columns[i];
    if (column.is_time || !column.has_any) continue;
    if (const std::size_t size = array_size(all.subspan(i)); size > 0) {
      const auto elements = all.subspan(i, size);
      const bool is_integer = std::all_of(elements.begin(), elements.end(),
                                          [](const ImportColumn& one) { return one.can_be_integer; });
      const std::string array = free_name(column.array, columns);
      builder.array(array, is_integer ? Kind::i64 : Kind::f64, size, column.unit);
      for (ImportColumn& element : elements) {
        element.can_be_integer = is_integer;
        element.name = array + "[" + std::to_string(element.index) + "]";
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
      return import_refused(file,
                            "a text in column " + column.heading + " has " + std::to_string(column.longest) + " bytes",
                            "at most 1024 are possible");
    }
  }
  return builder.build();
}

Value value_of(const ImportColumn& column, const detail::CsvCell& cell) {
  if (cell.text.empty() && !cell.quoted) return {};
  std::int64_t integer = 0;
  std::string buffer;
  if (column.can_be_integer &&
      detail::read_number(usual_number(cell.text, column.numbers, buffer), integer) == std::errc{})
    return Value(integer);
  double number = 0;
  if (column.can_be_number && is_number(cell.text, column.numbers, number)) return Value(number);
  return Value(cell.text);
}

}  // namespace rtdata::app
