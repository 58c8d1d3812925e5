/// Expression: a formula over named values, written as text, for derived topics, limits and conditions of machines.
///
///     rtdata::Expression falling("altitude < highest(altitude) - 5 and since(burnout) > 2", {"altitude", "burnout"});
///     falling.set(0, 812.5);
///     falling.set(1, false);
///     if (falling.evaluate(loop.now()).is_true()) ...
///
/// Numbers, `+ - * / ^`, comparisons, `and or not` (also `&& || !`), `condition ? a : b`, `pi`, `e`, `true`, `false`,
/// the usual functions (sqrt, sin, min, max ...), and functions with a memory (docs/expressions.md has all of them):
///   - highest(x), lowest(x): the largest and the least value so far
///   - mean(x, seconds): the mean of the values of the last `seconds`
///   - rate(x): the change per second since the previous value; rate(x, seconds): since the oldest value of the last
///     `seconds`
///   - previous(x), delta(x): the previous value; the change since it
///   - since(condition): seconds since the condition last became true, also if it was true at the first event
///   - integral(x): the area under x, in its unit times seconds: with a straight line from each value to the next
///   - age(x): seconds since x last had a new value; before the first one, since the first event
/// `seconds` is a constant. Such a function takes a new value when a name in its argument has been `set` since the last
/// evaluation, even if `? :`, `and` or `or` around it do not use it; setting one name does not affect functions of
/// other names. Without a new value the function keeps its result.
///
/// A result is a value, *waiting*, or failed. Waiting: a needed name was never set, or a function with a memory has no
/// result yet (`previous(x)` at the first value, `since(c)` before c was ever true). Failed, with a reason: any
/// intermediate number is not finite, even if the result would be finite (1 / (1 / 0)). An `and` with a false side is
/// false, and an `or` with a true side is true, whatever the other side is; `? :` needs only the chosen side. Otherwise
/// failed has priority over waiting. A function with a memory, except `age`, is waiting or failed if its argument is,
/// and keeps its memory.
///
/// A name is words joined by dots, with an index where there is one: `altitude`, `imu.x`, `imu.accel[0]`. The "/" of a
/// topic is written as a dot, since "/" divides: topic "room/climate", field "temperature" is
/// `room.climate.temperature`. A name with other characters must be in single quotes: `'tank-1/level.value'`. A name of
/// the program that equals a constant (`e`) hides the constant.
///
/// The constructor allocates all memory: setting, evaluating and resetting do not allocate, lock or throw. Owner: the
/// holder; move-only. Thread: one at a time.
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
  std::string suggestion;  ///< the name that was probably intended, or empty
  bool operator==(const ExpressionMistake&) const = default;
};

/// Thrown by the constructor for a text with a mistake. `what()` has text, column and reason.
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
  not_finite,        ///< a name was set to a number that is not finite
  division_by_zero,  ///< or the logarithm of 0
  undefined,         ///< such as the root of a negative number
  too_large,         ///< for a double
};

/// The result of one evaluation.
struct ExpressionResult {
  enum class State : std::uint8_t { value, waiting, failed };
  State state = State::waiting;
  ExpressionFailure failure = ExpressionFailure::none;
  double value = 0;  ///< finite; 1 or 0 for a condition; 0 without a value

  bool has_value() const noexcept { return state == State::value; }
  bool has_failed() const noexcept { return state == State::failed; }
  /// True if it has a value other than 0.
  bool is_true() const noexcept { return state == State::value && value != 0; }
};

class Expression {
 public:
  static constexpr std::size_t max_length = 4096;  ///< bytes of a text
  static constexpr std::size_t max_depth = 64;     ///< of nested parentheses, calls and operators
  static constexpr std::size_t max_memories = 32;  ///< functions with a memory in one text

  /// The first mistake of a text, or none.
  static std::optional<ExpressionMistake> check(std::string_view text, const std::vector<std::string>& names);
  /// The names that a text uses, each once, in order, with "." for "/" and without quotes, to look them up before
  /// making the expression. Errors: bad-argument (a mistake in the grammar, with its column). `known`: words that are
  /// names although they are also constants (`e`).
  static Result<std::vector<std::string>> names_in(std::string_view text, const std::vector<std::string>& known = {});
  /// The form that `names_in` returns: two names with the same form are the same name.
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
  /// True if the text uses this name. `index`: in `names()`; false for an index out of range.
  bool uses(std::size_t index) const noexcept;
  /// True if its result is true or false: a comparison, `and`, `or`, `not`, `true`, `false`, or a choice between such.
  bool is_condition() const noexcept;

  /// Sets a name. A value that is not finite makes the expressions with it fail. Ignores an index out of range.
  void set(std::size_t index, double value) noexcept;
  /// Removes the value of a name: expressions with it wait.
  void set_unknown(std::size_t index) noexcept;
  /// Evaluates for one event. `time`: the event's time; an earlier time than the last one counts as the last one.
  ExpressionResult evaluate(Time time) noexcept;
  /// Why the last evaluation failed or waits, as a text: "imu.x is not a finite number", "division by zero in column
  /// 7"; empty if it has a value. Allocates memory: do not call it for each event.
  std::string why() const;
  /// Forgets all values and memories.
  void reset() noexcept;

 private:
  struct Program;
  class Compiler;
  std::unique_ptr<Program> program_;
};

}  // namespace rtdata
