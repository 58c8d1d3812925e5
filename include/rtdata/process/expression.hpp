/// Expression: a formula over named values, written as text: of derived topics, limits and the conditions of machines.
///
///     rtdata::Expression falling("altitude < highest(altitude) - 5 and since(burnout) > 2", {"altitude", "burnout"});
///     falling.set(0, 812.5);
///     falling.set(1, false);
///     if (falling.evaluate(loop.now()).is_true()) ...
///
/// Numbers, `+ - * / ^`, comparisons, `and or not` (also `&& || !`), `condition ? a : b`, `pi`, `e`, `true`, `false`,
/// the usual functions (sqrt, sin, min, max ...), and functions with a memory (docs/expressions.md has all of them):
///   - highest(x), lowest(x): the largest and the least value so far
///   - mean(x, seconds): the mean of the values that came in the last so many seconds
///   - rate(x): the change a second since the value before; rate(x, seconds): since the oldest value of the last so
///     many seconds
///   - previous(x), delta(x): the value before this one; the change since it
///   - since(condition): seconds since the condition last became true, which includes that it was true at first
///   - integral(x): the area under x, in its unit times seconds: straight from each value to the next
///   - age(x): seconds since x last had a new value; before the first one, since the first event
/// `seconds` is a constant. Each of them takes a value in when a name in its argument has been `set` since the
/// evaluation before, whatever `? :`, `and` and `or` around it choose: setting one name says nothing about the others.
/// Without a new value it gives what it gave before.
///
/// A result is a value, *waiting*, or failed. Waiting: a name that it needs was never set, or a memory has nothing to
/// tell yet (`previous(x)` of the first value, `since(c)` before c was ever true). Failed: a number that is not finite
/// anywhere on the way, even where the result would be finite (1 / (1 / 0)), with a reason. An `and` with a side that
/// is false is false, and an `or` with one that is true is true, whatever the other side is; `? :` needs only what it
/// chooses. Otherwise failed wins over waiting. A memory but `age` whose argument is waiting or failed is so too, and
/// keeps what it has.
///
/// A name is words joined by dots, with an index where there is one: `altitude`, `imu.x`, `imu.accel[0]`. The "/" of a
/// topic is written as a dot, since "/" divides: topic "room/climate", field "temperature" is
/// `room.climate.temperature`. A name with other characters stands in single quotes: `'tank-1/level.value'`. A name of
/// the program's that is called as a constant (`e`) hides that.
///
/// Memory is taken when it is made: setting, evaluating and resetting take none, neither do they lock or throw.
/// Owner: the holder; move-only. Thread: one at a time.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata {

/// What is wrong with the text of an expression.
struct ExpressionMistake {
  std::size_t column = 1;  ///< of the text, from 1, in characters (UTF-8 code points), as those of files
  std::string why;         ///< "there is no name \"altitud\""
  std::string suggestion;  ///< the name that was probably meant, or empty
  bool operator==(const ExpressionMistake&) const = default;
};

/// Thrown when an expression is made of a text with a mistake. `what()` has text, column and reason.
class ExpressionError : public SetupError {
 public:
  ExpressionError(std::string_view text, ExpressionMistake mistake);
  const ExpressionMistake& mistake() const noexcept { return mistake_; }

 private:
  ExpressionMistake mistake_;
};

/// Why an expression has failed.
enum class ExpressionFailure : std::uint8_t {
  none,
  not_finite,        ///< a name was set to what is not finite
  division_by_zero,  ///< or the logarithm of 0
  undefined,         ///< such as the root of a negative number
  too_large,         ///< for a double
};

/// Of one evaluation.
struct ExpressionResult {
  enum class State : std::uint8_t { value, waiting, failed };
  State state = State::waiting;
  ExpressionFailure failure = ExpressionFailure::none;
  double value = 0;  ///< finite; of a condition 1 or 0; 0 where there is none

  bool has_value() const noexcept { return state == State::value; }
  bool has_failed() const noexcept { return state == State::failed; }
  /// Has a value, other than 0.
  bool is_true() const noexcept { return state == State::value && value != 0; }
};

class Expression {
 public:
  static constexpr std::size_t max_length = 4096;  ///< bytes of a text
  static constexpr std::size_t max_depth = 64;     ///< of parentheses, calls and operators within each other
  static constexpr std::size_t max_memories = 32;  ///< functions with a memory in one text

  /// The first mistake of a text, or none.
  static std::optional<ExpressionMistake> check(std::string_view text, const std::vector<std::string>& names);
  /// The names that a text uses, each once, in order, as they are written but with "." for "/" and without quotes; for
  /// who looks up what they are before making it. Of a text with a mistake in its grammar: bad-argument, with the
  /// mistake's column. `known`: words that are names also where they would be constants (`e`).
  static Result<std::vector<std::string>> names_in(std::string_view text, const std::vector<std::string>& known = {});
  /// As `names_in` writes it: two names that become the same are the same.
  static std::string normal_name(std::string_view name);

  /// Empty: evaluates to waiting.
  Expression() noexcept;
  /// ExpressionError: a mistake in the text. SetupError (bad-argument): two of the names are the same.
  Expression(std::string_view text, std::vector<std::string> names);
  Expression(Expression&&) noexcept;
  Expression& operator=(Expression&&) noexcept;
  ~Expression();

  const std::string& text() const noexcept;
  /// As they were given.
  const std::vector<std::string>& names() const noexcept;
  /// Whether the text has this name. `index`: among `names()`; one beyond them is not used.
  bool uses(std::size_t index) const noexcept;
  /// Whether its value is true or false: a comparison, `and`, `or`, `not`, `true`, `false`, or a choice between such.
  bool is_condition() const noexcept;

  /// A new value of a name. One that is not finite makes what uses it fail. An index beyond the names: nothing.
  void set(std::size_t index, double value) noexcept;
  /// It has no value now: what uses it waits.
  void set_unknown(std::size_t index) noexcept;
  /// One event. `time`: of the event, on the loop's line; one that is before the last one's counts as that.
  ExpressionResult evaluate(Time time) noexcept;
  /// Why the last evaluation failed or waits, for people: "imu.x is no finite number", "division by zero in column 7";
  /// empty when it has a value. Takes memory: not for each event.
  std::string why() const;
  /// Forgets all values and memories.
  void reset() noexcept;

 private:
  struct Program;
  class Compiler;
  std::unique_ptr<Program> program_;
};

}  // namespace rtdata
