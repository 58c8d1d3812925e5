// A step: the events of an origin that lie in one second or minute, and what each number comes to in them. What writes,
// verifies and reads the tables of steps shares this; docs/recording.md explains them to users, schema.hpp has their
// columns.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "recording/checksum.hpp"
#include "recording/database.hpp"
#include "rtdata/data/description.hpp"

namespace rtdata::sqlite {

struct StepLength {
  std::int64_t nanoseconds;
  std::string_view ending;  ///< of the table's name, behind that of the topic's
  std::string_view from;    ///< the column of rtdata_ledger: the sequence from which on all rows are in steps; 0: none
  std::string_view text;
  /// Steps of an origin begin when a step has this many events. A slower origin has few rows to read, and each
  /// transaction would write a page of its steps for each page of its rows.
  std::uint64_t first_events;
};
inline constexpr std::size_t seconds = 0, minutes = 1;
inline constexpr std::array<StepLength, 2> step_lengths = {
    {{1'000'000'000, "~1s", "seconds_from", "1 s", 8}, {60'000'000'000, "~1min", "minutes_from", "1 min", 480}}};

/// A topic with more numbers has no steps: their columns would not go into a table.
inline constexpr std::size_t most_step_fields = 390;

std::string step_table(std::string_view table, const StepLength& length);
/// All tables that may belong to a topic: its own, and those of its steps, which need not be there.
std::vector<std::string> tables_of_topic(std::string_view table);
bool has_table(const Database& database, const std::string& name);

/// True if steps have figures of it: not for texts, characters, enumerations.
bool is_number(Kind kind) noexcept;

/// A field of which steps have figures.
struct StepField {
  const Leaf* leaf;
  enum class Type { real, integer, natural } type;
  std::size_t offset;  ///< of one that is always there, in the payload
};
/// In the order of `leaves`.
std::vector<StepField> step_fields(const std::vector<const Leaf*>& leaves);

/// The columns before those of the fields.
inline constexpr std::array<std::string_view, 7> step_columns = {
    "run", "time", "origin", "events", "first_sequence", "last_sequence", "checksum~"};
inline constexpr int step_checksum_column = 6;
/// And those of each field.
inline constexpr std::array<std::string_view, 5> figures = {".count", ".min", ".max", ".sum", ".last"};
/// Their definitions: "temperature.count" INTEGER and so on.
std::vector<std::string> figure_columns(const StepField& field);
std::string make_step_table(const std::string& name, const std::vector<StepField>& fields);

/// The time divided by the length, rounded down, times the length.
inline std::int64_t step_of(std::int64_t time, const StepLength& length) noexcept {
  const std::int64_t rest = time % length.nanoseconds;
  return time - (rest < 0 ? rest + length.nanoseconds : rest);
}

class Step {
 public:
  explicit Step(std::size_t fields = 0) : numbers_(fields) {}

  bool is_empty() const noexcept { return events == 0; }
  void begin(std::int64_t at) noexcept {
    time = at;
    events = 0;
    for (Number& number : numbers_) number = {};
  }
  void add_event(std::uint64_t sequence) noexcept {
    if (events++ == 0) first = sequence;
    last = sequence;
  }
  /// NaN does not count as a number.
  void add(std::size_t field, double value) noexcept {
    if (value != value) return;
    Number& number = numbers_[field];
    const bool is_first = number.count++ == 0;
    if (is_first || value < number.least.real) number.least.real = value;
    if (is_first || value > number.most.real) number.most.real = value;
    number.last.real = value;
    number.sum += value;
  }
  void add(std::size_t field, std::int64_t value) noexcept { add(field, value, static_cast<double>(value)); }
  void add(std::size_t field, std::uint64_t value) noexcept { add(field, turned(value), static_cast<double>(value)); }
  /// Adds the step that follows this one, of the same fields.
  void add(const Step& later, const std::vector<StepField>& fields) noexcept;

  /// All but run, time and origin, in the order of the columns: to integer(), real() and null() of `out`.
  template <class Out>
  void give(const std::vector<StepField>& fields, Out& out) const {
    for (const std::uint64_t count : {events, first, last}) out.integer(static_cast<std::int64_t>(count));
    for (std::size_t i = 0; i < fields.size(); ++i) {
      const Number& number = numbers_[i];
      if (number.count == 0) {  // as in the rows of steps from before the topic had the field
        for (std::size_t figure = 0; figure < figures.size(); ++figure) out.null();
        continue;
      }
      const auto give_figure = [&](Figure figure) {
        if (fields[i].type == StepField::Type::real) return out.real(figure.real);
        out.integer(fields[i].type == StepField::Type::natural ? static_cast<std::int64_t>(turned_back(figure.integer))
                                                               : figure.integer);
      };
      out.integer(static_cast<std::int64_t>(number.count));
      give_figure(number.least);
      give_figure(number.most);
      out.real(number.sum);
      give_figure(number.last);
    }
  }
  /// The value of "checksum~".
  std::uint64_t hash(std::string_view origin, const std::vector<StepField>& fields, RowHash& with) const {
    with.begin();
    with.integer(time);
    with.text(origin);
    give(fields, with);
    return with.hash_of_values();
  }

  std::int64_t time = 0;
  std::uint64_t events = 0;
  std::uint64_t first = 0, last = 0;  // sequences

 private:
  union Figure {
    std::int64_t integer = 0;
    double real;
  };
  struct Number {
    std::uint64_t count = 0;
    double sum = 0;
    Figure least, most, last;
  };
  /// Signed numbers that are in the order of these.
  static std::int64_t turned(std::uint64_t value) noexcept {
    return static_cast<std::int64_t>(value ^ (std::uint64_t{1} << 63));
  }
  static std::uint64_t turned_back(std::int64_t value) noexcept {
    return static_cast<std::uint64_t>(value) ^ (std::uint64_t{1} << 63);
  }
  void add(std::size_t field, std::int64_t in_order, double value) noexcept {
    Number& number = numbers_[field];
    const bool is_first = number.count++ == 0;
    if (is_first || in_order < number.least.integer) number.least.integer = in_order;
    if (is_first || in_order > number.most.integer) number.most.integer = in_order;
    number.last.integer = in_order;
    number.sum += value;
  }

  std::vector<Number> numbers_;
};

/// The open steps of an origin, from its first event on: `minute` has the events before `second`.
class OriginSteps {
 public:
  explicit OriginSteps(std::size_t fields = 0) : second(fields), minute(fields) {}
  /// Before an event at this time is added to `second`. `ended(length, step)` is called with each step that has ended.
  template <class Ended>
  void go_to(std::int64_t time, const std::vector<StepField>& fields, Ended&& ended) {
    if (time >= second.time && time - second.time < step_lengths[seconds].nanoseconds && !second.is_empty()) [[likely]]
      return;
    end(fields, ended, step_of(time, step_lengths[minutes]));
    second.begin(step_of(time, step_lengths[seconds]));
  }
  /// The last ones.
  template <class Ended>
  void end(const std::vector<StepField>& fields, Ended&& ended) {
    end(fields, ended, std::numeric_limits<std::int64_t>::min());
  }

  Step second, minute;

 private:
  template <class Ended>
  void end(const std::vector<StepField>& fields, Ended&& ended, std::int64_t next_minute) {
    if (!second.is_empty()) {
      minute.add(second, fields);
      ended(seconds, second);
      second.begin(0);
    }
    if (minute.time == next_minute) return;
    if (!minute.is_empty()) ended(minutes, minute);
    minute.begin(next_minute);
  }
};

}  // namespace rtdata::sqlite
