#include "rtdata/process/expression.hpp"

#include <algorithm>
#include <array>
#include <cfenv>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#ifdef RTDATA_WITH_MUPARSER
#include <muParser.h>
#if defined(__x86_64__) && defined(__SSE2_MATH__)
#include <xmmintrin.h>
#endif
#endif

#include "loop/support/deadline.hpp"
#include "process/expression_tree.hpp"
#include "process/time_window.hpp"
#include "rtdata/data/instant.hpp"
#include "rtdata/data/problem.hpp"

namespace rtdata {
namespace {

using detail::ExpressionNode;
using detail::ExpressionTree;
using State = ExpressionResult::State;
using Failure = ExpressionFailure;

[[noreturn]] void refuse(std::size_t column, std::string why, std::string suggestion = {}) {
  throw detail::ExpressionMistakeFound{{column, std::move(why), std::move(suggestion)}};
}

/// The tree of a text whose names are all among the given ones; `index_of`: which of them each is.
ExpressionTree tree_of(std::string_view text, const std::vector<std::string>& names,
                       std::vector<std::size_t>& index_of) {
  ExpressionTree tree = detail::parse_expression(text, names);
  std::vector<std::string> normal;
  for (const std::string& name : names) normal.push_back(Expression::normal_name(name));
  for (std::size_t i = 0; i < tree.names.size(); ++i) {
    const auto found = std::find(normal.begin(), normal.end(), tree.names[i]);
    if (found == normal.end()) {
      std::string nearest = nearest_name(tree.names[i], normal);
      std::string why = "there is no name `" + tree.names[i] + "`";
      if (nearest.empty() && !normal.empty()) {
        why += "; there are";
        for (std::size_t n = 0; n < normal.size() && n < 8; ++n) why += " " + normal[n];
        if (normal.size() > 8) why += " ...";
      }
      refuse(tree.columns[i], std::move(why), std::move(nearest));
    }
    index_of.push_back(static_cast<std::size_t>(found - normal.begin()));
  }
  return tree;
}

#ifdef RTDATA_WITH_MUPARSER

/// What an evaluation of a part gives. `at`: of what waits or is not finite, its place among the values; of another
/// failure, its column.
struct Got {
  State state = State::waiting;
  Failure failure = Failure::none;
  std::uint32_t at = 0;
  double value = 0;
};

constexpr int bad_flags = FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW;

/// Those of the processor's flags that are set. Where doubles are computed by SSE, std::fetestexcept asks the x87 as
/// well, which takes nearly as long as a short formula.
int set_flags() noexcept {
#if defined(__x86_64__) && defined(__SSE2_MATH__)
  static_assert(FE_INVALID == _MM_EXCEPT_INVALID && FE_DIVBYZERO == _MM_EXCEPT_DIV_ZERO &&
                FE_OVERFLOW == _MM_EXCEPT_OVERFLOW);
  return static_cast<int>(_mm_getcsr()) & bad_flags;
#else
  return std::fetestexcept(bad_flags);
#endif
}

Failure failure_of(int flags, double value) noexcept {
  if ((flags & FE_DIVBYZERO) != 0) return Failure::division_by_zero;
  if ((flags & FE_INVALID) != 0 || std::isnan(value)) return Failure::undefined;
  if ((flags & FE_OVERFLOW) != 0 || std::isinf(value)) return Failure::too_large;
  return Failure::none;
}

/// Evaluates arithmetic, and says what went wrong on the way: the processor's flags tell of an infinity that a
/// comparison or a quotient has hidden again. They stay set until they are cleared, which takes longer than looking, so
/// that one that is set may be older: then it is evaluated once more, which gives the same.
Failure evaluate_formula(const mu::Parser& formula, double& value) noexcept {
  try {
    value = formula.Eval();
    if (set_flags() == 0 && std::isfinite(value)) [[likely]]
      return Failure::none;
    std::feclearexcept(bad_flags);
    value = formula.Eval();
  } catch (...) {
    return Failure::undefined;
  }
  const int flags = set_flags();
  std::feclearexcept(bad_flags);
  return failure_of(flags, value);
}

#endif

}  // namespace

#ifdef RTDATA_WITH_MUPARSER

struct Expression::Program {
  /// A part of the expression that is no plain arithmetic, or that is all of it.
  struct Operation {
    enum class Type : std::uint8_t { number, value, formula, logical_not, logical_and, logical_or, choice };
    Type type = Type::number;
    double number = 0;
    std::size_t a = 0;  // of a value its place, of a formula its number, else operations
    std::size_t b = 0;
    std::size_t c = 0;
  };
  /// Arithmetic over values: muParser's.
  struct Formula {
    std::unique_ptr<mu::Parser> parser = std::make_unique<mu::Parser>();
    std::vector<std::size_t> inputs = {};
    std::uint32_t column = 1;
    std::uint32_t division_column = 0;
    std::size_t constants = 0;
  };
  struct Memory {
    ExpressionNode::Memory type{};
    std::size_t column = 1;
    std::string name = {};
    std::size_t argument = 0;             // an operation
    std::vector<std::size_t> names = {};  // in its argument
    bool is_always_new = false;           // time alone changes its argument, or itself
    std::unique_ptr<detail::TimeWindow> window = {};
    bool has_value = false;
    bool has_result = false;
    bool was_true = false;
    bool has_before = false;
    double last = 0;    // of the last instant
    double before = 0;  // of the instant before that
    double result = 0;
    double result_before = 0;
    Time last_time{};
    Time time_before{};
  };

  Program(std::string_view the_text, std::vector<std::string> the_names) : text(the_text), names(std::move(the_names)) {
    std::vector<std::size_t> index_of;
    const ExpressionTree tree = tree_of(text, names, index_of);
    is_condition = tree.is_condition;
    set_at.resize(names.size());
    is_used.resize(names.size());
    places.resize(tree.nodes.size(), no_place);
    has_names.resize(tree.nodes.size());
    std::size_t count = names.size();
    std::vector<bool> is_in_formula(tree.nodes.size());
    for (const ExpressionNode& node : tree.nodes)
      if (is_plain(node))
        for (const std::size_t child : node.children) is_in_formula[child] = true;
    for (std::size_t i = 0; i < tree.nodes.size(); ++i) {
      const ExpressionNode& node = tree.nodes[i];
      has_names[i] = node.type == ExpressionNode::Type::name;
      for (const std::size_t child : node.children) has_names[i] = has_names[i] || has_names[child];
      if (node.type == ExpressionNode::Type::name) {
        places[i] = index_of[node.name];
        is_used[places[i]] = true;
      } else if (is_step(node) && (is_in_formula[i] || node.type == ExpressionNode::Type::memory)) {
        places[i] = count++;
      }
    }
    values.resize(count);
    for (std::size_t i = 0; i < tree.nodes.size(); ++i) {
      if (!is_step(tree.nodes[i]) || places[i] == no_place) continue;
      if (tree.nodes[i].type == ExpressionNode::Type::memory)
        add_memory(tree, i);
      else
        steps.push_back({no_memory, add(tree, i), places[i]});
    }
    root = add(tree, tree.nodes.size() - 1);
    for (Formula& formula : formulas) formula.parser->Eval();  // takes its memory
    places = {};
    has_names = {};
    reset();
  }

  /// What has a place of its own among the values, computed before what uses it.
  static bool is_step(const ExpressionNode& node) noexcept {
    return node.type != ExpressionNode::Type::number && node.type != ExpressionNode::Type::name && !is_plain(node);
  }

  static bool is_plain(const ExpressionNode& node) noexcept {
    using Type = ExpressionNode::Type;
    return node.type == Type::negative || node.type == Type::arithmetic || node.type == Type::comparison ||
           node.type == Type::function;
  }

  static bool moves_with_time(ExpressionNode::Memory memory) noexcept {
    return memory == ExpressionNode::Memory::since || memory == ExpressionNode::Memory::age;
  }

  void add_memory(const ExpressionTree& tree, std::size_t at) {
    const ExpressionNode& node = tree.nodes[at];
    Memory memory;
    memory.type = node.memory;
    memory.column = node.column;
    memory.name = node.text;
    memory.is_always_new = moves_with_time(node.memory);
    if (node.children.size() == 2) memory.window = std::make_unique<detail::TimeWindow>(seconds(tree, node));
    memory.argument = add(tree, node.children[0]);
    collect(tree, node.children[0], memory);
    std::sort(memory.names.begin(), memory.names.end());
    memory.names.erase(std::unique(memory.names.begin(), memory.names.end()), memory.names.end());
    steps.push_back({memories.size(), memory.argument, places[at]});
    memories.push_back(std::move(memory));
  }

  void collect(const ExpressionTree& tree, std::size_t at, Memory& memory) const {
    const ExpressionNode& node = tree.nodes[at];
    if (node.type == ExpressionNode::Type::name) memory.names.push_back(places[at]);
    if (node.type == ExpressionNode::Type::memory && moves_with_time(node.memory)) memory.is_always_new = true;
    for (const std::size_t child : node.children) collect(tree, child, memory);
  }

  Duration seconds(const ExpressionTree& tree, const ExpressionNode& node) {
    const std::size_t argument = add(tree, node.children[1]);
    Got got;
    evaluate(operations[argument], got);
    const std::size_t column = tree.nodes[node.children[1]].column;
    if (got.state != State::value) refuse(column, "the seconds of `" + node.text + "` are no finite number");
    if (!(got.value >= 1e-6 && got.value <= 604800))
      refuse(column, "the seconds of `" + node.text + "` lie between 0.000001 and 604800 (a week)");
    return Duration{std::llround(got.value * 1e9)};
  }

  /// An operation that gives what the node gives.
  std::size_t add(const ExpressionTree& tree, std::size_t at) {
    using Type = ExpressionNode::Type;
    const ExpressionNode& node = tree.nodes[at];
    Operation made;
    switch (node.type) {
      case Type::number:
        made.number = node.number;
        break;
      case Type::name:
      case Type::memory:
        made.type = Operation::Type::value;
        made.a = places[at];
        break;
      case Type::logical_not:
        made.type = Operation::Type::logical_not;
        made.a = add(tree, node.children[0]);
        break;
      case Type::logical_and:
      case Type::logical_or:
        made.type = node.type == Type::logical_and ? Operation::Type::logical_and : Operation::Type::logical_or;
        made.a = add(tree, node.children[0]);
        made.b = add(tree, node.children[1]);
        break;
      case Type::choice:
        made.type = Operation::Type::choice;
        made.a = add(tree, node.children[0]);
        made.b = add(tree, node.children[1]);
        made.c = add(tree, node.children[2]);
        break;
      default:
        if (!has_names[at] && is_plain_below(tree, at)) {
          made.number = constant(tree, at);
          break;
        }
        made.type = Operation::Type::formula;
        made.a = add_formula(tree, at);
        break;
    }
    operations.push_back(made);
    return operations.size() - 1;
  }

  static bool is_plain_below(const ExpressionTree& tree, std::size_t at) {
    const ExpressionNode& node = tree.nodes[at];
    if (node.type == ExpressionNode::Type::number) return true;
    return is_plain(node) && std::all_of(node.children.begin(), node.children.end(),
                                         [&](std::size_t child) { return is_plain_below(tree, child); });
  }

  /// What has no name in it is computed once.
  double constant(const ExpressionTree& tree, std::size_t at) {
    Formula formula = formula_of(tree, at, Constants::as_they_are);
    std::feclearexcept(bad_flags);
    const double value = formula.parser->Eval();  // once: muParser computes it then, and keeps what comes of it
    const int flags = set_flags();
    std::feclearexcept(bad_flags);
    switch (failure_of(flags, value)) {
      case Failure::none:
        return value;
      case Failure::division_by_zero:
        refuse(tree.nodes[at].column, "this is a division by zero, or the logarithm of 0, whatever the values are");
      case Failure::too_large:
        refuse(tree.nodes[at].column, "this is too large for a double, whatever the values are");
      default:
        refuse(tree.nodes[at].column, "this is no number, whatever the values are");
    }
  }

  void refuse_division_by_zero(const ExpressionTree& tree, std::size_t at) {
    const ExpressionNode& node = tree.nodes[at];
    const std::size_t divisor = node.children[1];
    if (has_names[divisor] || !is_plain_below(tree, divisor)) return;
    const ExpressionNode& by = tree.nodes[divisor];
    const double value = by.type == ExpressionNode::Type::number ? by.number : constant(tree, divisor);
    if (value == 0) refuse(node.column, "this is a division by zero, whatever the values are");
  }

  std::size_t add_formula(const ExpressionTree& tree, std::size_t at) {
    Formula formula = formula_of(tree, at, Constants::computed);
    formulas.push_back(std::move(formula));
    return formulas.size() - 1;
  }

  enum class Constants : std::uint8_t { as_they_are, computed };
  Formula formula_of(const ExpressionTree& tree, std::size_t at, Constants constants) {
    Formula formula;
    formula.column = static_cast<std::uint32_t>(tree.nodes[at].column);
    formula.parser->DefineFun("ceil", [](double x) { return std::ceil(x); });
    formula.parser->DefineFun("floor", [](double x) { return std::floor(x); });
    formula.parser->DefineFun("round", [](double x) { return std::round(x); });
    std::string text_of_it;
    write(tree, at, constants, formula, text_of_it);
    if (formula.division_column == 0) formula.division_column = formula.column;
    std::sort(formula.inputs.begin(), formula.inputs.end());
    formula.inputs.erase(std::unique(formula.inputs.begin(), formula.inputs.end()), formula.inputs.end());
    try {
      formula.parser->SetExpr(text_of_it);
      formula.parser->GetUsedVar();
    } catch (const mu::ParserError& error) {
      refuse(formula.column, "muParser refuses it: " + error.GetMsg());
    }
    return formula;
  }

  void write(const ExpressionTree& tree, std::size_t at, Constants constants, Formula& formula, std::string& out) {
    using Type = ExpressionNode::Type;
    const ExpressionNode& node = tree.nodes[at];
    const auto write_input = [&](std::size_t place) {
      const std::string name = "v" + std::to_string(place);
      if (std::find(formula.inputs.begin(), formula.inputs.end(), place) == formula.inputs.end()) {
        formula.parser->DefineVar(name, &values[place].value);
        formula.inputs.push_back(place);
      }
      out += name;
    };
    const auto write_number = [&](double number) {
      const std::string name = "c" + std::to_string(formula.constants++);
      formula.parser->DefineConst(name, number);
      out += name;
    };
    if (node.type == Type::number) return write_number(node.number);
    if (!is_plain(node)) return write_input(places[at]);
    if (constants == Constants::computed && !has_names[at] && is_plain_below(tree, at))
      return write_number(constant(tree, at));
    if (constants == Constants::computed && node.text == "/") refuse_division_by_zero(tree, at);
    if (node.text == "/" && formula.division_column == 0)
      formula.division_column = static_cast<std::uint32_t>(node.column);
    out += node.type == Type::function ? node.text + "(" : "(";
    if (node.type == Type::negative) out += "-";
    for (std::size_t i = 0; i < node.children.size(); ++i) {
      if (i > 0) out += node.type == Type::function ? "," : node.text;
      write(tree, node.children[i], constants, formula, out);
    }
    out += ")";
  }

  static Got truth(bool is_true) noexcept {
    Got got;
    got.state = State::value;
    got.value = is_true ? 1 : 0;
    return got;
  }

  void evaluate(const Operation& operation, Got& got) noexcept {
    using Type = Operation::Type;
    switch (operation.type) {
      case Type::number:
        got = {};
        got.state = State::value;
        got.value = operation.number;
        return;
      case Type::value:
        got = values[operation.a];
        return;
      case Type::formula:
        return compute(formulas[operation.a], got);
      case Type::logical_not:
        evaluate(operations[operation.a], got);
        if (got.state == State::value) got = truth(got.value == 0);
        return;
      case Type::logical_and:
      case Type::logical_or: {
        const bool decides = operation.type == Type::logical_or;  // such a side decides alone
        evaluate(operations[operation.a], got);
        if (got.state == State::value && (got.value != 0) == decides) return void(got = truth(decides));
        Got right;
        evaluate(operations[operation.b], right);
        if (right.state == State::value && (right.value != 0) == decides) return void(got = truth(decides));
        if (got.state == State::failed) return;
        if (right.state == State::failed) return void(got = right);
        if (got.state == State::waiting) return;
        got = right.state == State::waiting ? right : truth(!decides);
        return;
      }
      case Type::choice:
        evaluate(operations[operation.a], got);
        if (got.state == State::value) evaluate(operations[got.value != 0 ? operation.b : operation.c], got);
        return;
    }
  }

  void compute(const Formula& formula, Got& got) noexcept {
    const Got* missing = nullptr;  // the first that has failed, else one that waits
    for (const std::size_t input : formula.inputs) {
      const Got& value = values[input];
      if (value.state != State::value && (missing == nullptr || missing->state != State::failed)) [[unlikely]]
        missing = &value;
    }
    if (missing != nullptr) {
      got = *missing;
      return;
    }
    got.failure = evaluate_formula(*formula.parser, got.value);
    got.state = State::value;
    got.at = 0;
    if (got.failure == Failure::none) [[likely]]
      return;
    got.state = State::failed;
    got.value = 0;
    got.at = got.failure == Failure::division_by_zero ? formula.division_column : formula.column;
  }

  static double seconds_between(Time from, Time to) noexcept {
    return static_cast<double>(detail::span_between(from, to).count()) * 1e-9;
  }

  /// One more event: the step's place gets the result of its memory.
  void remember(Memory& memory, std::size_t place, const Got& argument, Time time) noexcept {
    Got& got = values[place];
    const bool is_age = memory.type == ExpressionNode::Memory::age;
    if (argument.state != State::value && !is_age) {
      got = argument;
      return;
    }
    if (is_age) {
      const bool is_first = !std::exchange(memory.has_result, true);
      if (is_first || (argument.state == State::value && has_come(memory))) memory.last_time = time;
      memory.result = seconds_between(memory.last_time, time);
    } else if (memory.is_always_new || !memory.has_value || has_come(memory)) {
      take(memory, argument.value, time);
    }
    got.state = memory.has_result ? State::value : State::waiting;
    got.failure = Failure::none;
    got.at = static_cast<std::uint32_t>(place);
    got.value = memory.has_result ? memory.result : 0;
    if (std::isfinite(got.value)) [[likely]]
      return;
    got.state = State::failed;
    got.failure = Failure::too_large;
    got.at = static_cast<std::uint32_t>(memory.column);
    got.value = 0;
  }

  /// A name in its argument was set since the last event.
  bool has_come(const Memory& memory) const noexcept {
    for (const std::size_t name : memory.names)
      if (set_at[name] == event) return true;
    return false;
  }

  static void take(Memory& memory, double value, Time time) noexcept {
    using Type = ExpressionNode::Memory;
    const bool is_first = !std::exchange(memory.has_value, true);
    const auto give = [&](double result) {
      memory.result = result;
      memory.has_result = true;
    };
    const double last = std::exchange(memory.last, value);
    const auto look_at_instant = [&] {
      if (!is_first && time <= memory.last_time) return;  // a later value of the same one, which takes its place
      memory.has_before = !is_first;
      memory.before = last;
      memory.time_before = memory.last_time;
      memory.result_before = memory.has_result ? memory.result : 0;
      memory.last_time = time;
    };
    switch (memory.type) {
      case Type::highest:
        give(memory.has_result ? std::max(memory.result, value) : value);
        break;
      case Type::lowest:
        give(memory.has_result ? std::min(memory.result, value) : value);
        break;
      case Type::mean:
        give(memory.window->take_mean(time, value));
        break;
      case Type::rate: {
        look_at_instant();
        if (memory.has_before) give((value - memory.before) / seconds_between(memory.time_before, memory.last_time));
        break;
      }
      case Type::rate_over: {
        double rate = 0;
        if (memory.window->take_rate(time, value, rate)) give(rate);
        break;
      }
      case Type::since: {
        const bool is_true = value != 0;
        if (is_true && !std::exchange(memory.was_true, is_true)) {
          memory.last_time = time;
          memory.has_result = true;
        }
        memory.was_true = is_true;
        if (memory.has_result) memory.result = seconds_between(memory.last_time, time);
        break;
      }
      case Type::integral: {
        look_at_instant();
        const double seconds = memory.has_before ? seconds_between(memory.time_before, memory.last_time) : 0;
        give(memory.result_before + (memory.before + value) / 2 * seconds);
        break;
      }
      case Type::age:  // needs no value: see `remember`
        break;
      case Type::previous:
        if (!is_first) give(last);
        break;
      case Type::delta:
        if (!is_first) give(value - last);
        break;
    }
  }

  ExpressionResult evaluate(Time time) noexcept {
    last_time = std::max(time, last_time);
    if (instant == Time::min() || detail::span_between(instant, last_time) >= one_instant) instant = last_time;
    for (const Step& step : steps) {
      const Operation& operation = operations[step.operation];
      if (step.memory == no_memory) {
        evaluate(operation, values[step.place]);
      } else if (operation.type == Operation::Type::value) {
        remember(memories[step.memory], step.place, values[operation.a], instant);
      } else {
        Got argument;
        evaluate(operation, argument);
        remember(memories[step.memory], step.place, argument, instant);
      }
    }
    evaluate(operations[root], outcome);
    ++event;
    return {outcome.state, outcome.failure, outcome.value};
  }

  void reset() noexcept {
    for (std::size_t i = 0; i < values.size(); ++i) {
      values[i] = {};
      values[i].at = static_cast<std::uint32_t>(i);
    }
    ++event;  // no name is set with it
    for (Memory& memory : memories) {
      memory.has_value = memory.has_result = memory.was_true = memory.has_before = false;
      memory.before = memory.result_before = 0;
      if (memory.window != nullptr) memory.window->clear();
    }
    outcome = {};
    last_time = instant = Time::min();
  }

  std::string name_of(std::size_t place) const {
    if (place < names.size()) return names[place];
    for (const Step& step : steps)
      if (step.place == place && step.memory != no_memory)
        return memories[step.memory].name + " in column " + std::to_string(memories[step.memory].column);
    return text;
  }

  std::string why() const {
    switch (outcome.state) {
      case State::value:
        return {};
      case State::waiting:
        return name_of(outcome.at) + (outcome.at < names.size() ? " has no value yet" : " has nothing to tell yet");
      case State::failed:
        break;
    }
    const std::string column = " in column " + std::to_string(outcome.at);
    switch (outcome.failure) {
      case Failure::not_finite:
        return name_of(outcome.at) + " is no finite number";
      case Failure::division_by_zero:
        return "division by zero, or the logarithm of 0," + column;
      case Failure::too_large:
        return "too large for a double," + column;
      default:
        return "no number, such as the root of a negative one," + column;
    }
  }

  static constexpr std::size_t no_place = std::numeric_limits<std::size_t>::max();
  static constexpr std::size_t no_memory = std::numeric_limits<std::size_t>::max();
  /// What is computed before the rest, at every event, whatever that chooses.
  struct Step {
    std::size_t memory = no_memory;
    std::size_t operation = 0;
    std::size_t place = 0;
  };

  std::string text;
  std::vector<std::string> names;
  bool is_condition = false;
  std::vector<Got> values;            // of names, then of steps; never moved, since muParser knows where they are
  std::uint64_t event = 1;            // the number of the next one
  std::vector<std::uint64_t> set_at;  // of each name: the number of the event that it was set for
  std::vector<std::uint8_t> is_used;
  std::vector<Operation> operations;
  std::vector<Formula> formulas;
  std::vector<Memory> memories;
  std::vector<Step> steps;
  std::size_t root = 0;
  Got outcome;
  Time last_time = Time::min();
  Time instant = Time::min();  // of the last event: the time of the first that is nearer to it than `one_instant`
  // While it is made, of each node of the tree.
  std::vector<std::size_t> places;
  std::vector<bool> has_names;
};

#else

struct Expression::Program {
  std::string text;
  std::vector<std::string> names;
};

#endif

ExpressionError::ExpressionError(std::string_view text, ExpressionMistake mistake)
    : SetupError({Errc::bad_argument, "cannot use an expression",
                  "\"" + std::string(text.substr(0, 60)) + (text.size() > 60 ? "..." : "") + "\", column " +
                      std::to_string(mistake.column),
                  mistake.why, mistake.suggestion.empty() ? "" : "did you mean \"" + mistake.suggestion + "\"?"}),
      mistake_(std::move(mistake)) {}

bool Expression::available() noexcept {
#ifdef RTDATA_WITH_MUPARSER
  return true;
#else
  return false;
#endif
}

std::string Expression::normal_name(std::string_view name) {
  std::string normal(name);
  std::replace(normal.begin(), normal.end(), '/', '.');
  return normal;
}

std::optional<ExpressionMistake> Expression::check(std::string_view text, const std::vector<std::string>& names) {
  try {
#ifdef RTDATA_WITH_MUPARSER
    const Program program(text, names);
#else
    std::vector<std::size_t> index_of;
    tree_of(text, names, index_of);
#endif
    return std::nullopt;
  } catch (detail::ExpressionMistakeFound& found) {
    return std::move(found.mistake);
  }
}

Result<std::vector<std::string>> Expression::names_in(std::string_view text, const std::vector<std::string>& known) {
  try {
    return detail::parse_expression(text, known).names;
  } catch (detail::ExpressionMistakeFound& found) {
    return ExpressionError(text, std::move(found.mistake)).error();
  }
}

Expression::Expression() noexcept = default;
Expression::Expression(Expression&&) noexcept = default;
Expression& Expression::operator=(Expression&&) noexcept = default;
Expression::~Expression() = default;

Expression::Expression(std::string_view text, std::vector<std::string> names) {
  for (std::size_t i = 0; i < names.size(); ++i)
    for (std::size_t n = 0; n < i; ++n)
      if (normal_name(names[i]) == normal_name(names[n]))
        throw SetupError({Errc::bad_argument, "cannot make an expression",
                          "\"" + std::string(text.substr(0, 60)) + "\"",
                          "two of its names are the same: " + names[n] + " and " + names[i], "give each name once"});
#ifdef RTDATA_WITH_MUPARSER
  try {
    program_ = std::make_unique<Program>(text, std::move(names));
  } catch (detail::ExpressionMistakeFound& found) {
    throw ExpressionError(text, std::move(found.mistake));
  }
#else
  if (std::optional<ExpressionMistake> mistake = check(text, names)) throw ExpressionError(text, *std::move(mistake));
  throw SetupError({Errc::not_found, "cannot make an expression", "\"" + std::string(text.substr(0, 60)) + "\"",
                    "this library was built without muParser", "install libmuparser-dev and build it again"});
#endif
}

const std::string& Expression::text() const noexcept {
  static const std::string none;
  return program_ == nullptr ? none : program_->text;
}
const std::vector<std::string>& Expression::names() const noexcept {
  static const std::vector<std::string> none;
  return program_ == nullptr ? none : program_->names;
}

#ifdef RTDATA_WITH_MUPARSER

bool Expression::uses(std::size_t index) const noexcept {
  return program_ != nullptr && index < program_->names.size() && program_->is_used[index] != 0;
}
bool Expression::is_condition() const noexcept { return program_ != nullptr && program_->is_condition; }

void Expression::set(std::size_t index, double value) noexcept {
  Program* const program = program_.get();
  if (program == nullptr || index >= program->set_at.size()) return;
  program->set_at[index] = program->event;
  Got& at = program->values[index];
  if (std::isfinite(value)) [[likely]] {
    at.state = State::value;
    at.failure = Failure::none;
    at.value = value;
  } else {
    at.state = State::failed;
    at.failure = Failure::not_finite;
    at.value = 0;
  }
}

void Expression::set_unknown(std::size_t index) noexcept {
  if (program_ == nullptr || index >= program_->names.size()) return;
  program_->values[index].state = State::waiting;
  program_->values[index].failure = Failure::none;
}

ExpressionResult Expression::evaluate(Time time) noexcept {
  return program_ == nullptr ? ExpressionResult{} : program_->evaluate(time);
}
std::string Expression::why() const { return program_ == nullptr ? "it is empty" : program_->why(); }
void Expression::reset() noexcept {
  if (program_ != nullptr) program_->reset();
}

#else

bool Expression::uses(std::size_t) const noexcept { return false; }
bool Expression::is_condition() const noexcept { return false; }
void Expression::set(std::size_t, double) noexcept {}
void Expression::set_unknown(std::size_t) noexcept {}
ExpressionResult Expression::evaluate(Time) noexcept { return {}; }
std::string Expression::why() const { return "it is empty"; }
void Expression::reset() noexcept {}

#endif

}  // namespace rtdata
