#include "rtdata/process/expression.hpp"

#include <algorithm>
#include <array>
#include <cfenv>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#if defined(__x86_64__) && defined(__SSE2_MATH__)
#include <xmmintrin.h>
#endif

#include "data/saturating.hpp"
#include "process/expression_tree.hpp"
#include "process/time_window.hpp"
#include "rtdata/data/problem.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata {
namespace {

using detail::ExpressionNode;
using detail::ExpressionTree;
using State = ExpressionResult::State;
using Failure = ExpressionFailure;

[[noreturn]] void refuse(std::size_t column, std::string why, std::string suggestion = {}) {
  throw detail::ExpressionMistakeFound{{column, std::move(why), std::move(suggestion)}};
}

/// The tree of a text that uses only the given names; `index_of`: the index of each.
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
        why += "; available:";
        for (std::size_t n = 0; n < normal.size() && n < 8; ++n) why += " " + normal[n];
        if (normal.size() > 8) why += " ...";
      }
      refuse(tree.columns[i], std::move(why), std::move(nearest));
    }
    index_of.push_back(static_cast<std::size_t>(found - normal.begin()));
  }
  return tree;
}

/// In addition to those of ExpressionFailure.
constexpr auto waiting = static_cast<Failure>(0xFF);

/// The result of evaluating a part. `at`: for a waiting or non-finite name, its index in the values; for another
/// failure, its column.
struct Got {
  Failure failure = waiting;
  std::uint32_t at = 0;
  double value = 0;

  Got() = default;
  Got(Failure its, std::uint32_t its_at, double its_value) : failure(its), at(its_at), value(its_value) {}
  Got(const Got&) = default;
  /// Copies field by field: loading all fields at once would stall after separate writes.
  Got& operator=(const Got& other) noexcept {
    failure = other.failure;
    at = other.at;
    value = other.value;
    return *this;
  }
  bool is_value() const noexcept { return failure == Failure::none; }
  State state() const noexcept {
    return failure == Failure::none ? State::value : failure == waiting ? State::waiting : State::failed;
  }
};

constexpr int bad_flags = FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW;

/// The processor's floating-point flags. With SSE, std::fetestexcept also reads the x87, which takes nearly as long as
/// a short formula.
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

}  // namespace

struct Expression::Program {
  /// An arithmetic step between values whose places are known.
  struct Instruction {
    detail::ExpressionOp op = {};
    detail::Compute compute = nullptr;
    std::uint32_t a = 0;
    std::uint32_t b = 0;
    std::uint32_t to = 0;
  };
  /// Arithmetic that is computed when all its inputs are there.
  struct Formula {
    std::vector<Instruction> code = {};
    std::vector<std::uint32_t> inputs = {};
    std::uint32_t column = 1;
    std::uint32_t division_column = 0;
  };
  /// A step that gives a value, or the reason for its absence, at every event.
  struct Step {
    enum class Type : std::uint8_t { formula, memory, logical_not, logical_and, logical_or, choice };
    Type type = Type::formula;
    std::uint32_t a = 0;  // of a formula or a memory its number, else places
    std::uint32_t b = 0;
    std::uint32_t c = 0;
    std::uint32_t to = 0;
  };
  static constexpr std::uint32_t no_place = std::numeric_limits<std::uint32_t>::max();
  struct Memory {
    ExpressionNode::Memory type{};
    std::size_t column = 1;
    std::string name = {};
    std::uint32_t argument = 0;             // a place
    std::uint32_t to = 0;                   // its own
    std::vector<std::uint32_t> names = {};  // in its argument
    bool is_always_new = false;             // time changes its argument, or itself
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

  Program(std::string_view the_text, std::vector<std::string> the_names);

  void compute(const Formula& formula, Got& got) noexcept {
    const Got* missing = nullptr;  // the first that has failed, else one that waits
    for (const std::uint32_t input : formula.inputs) {
      const Got& value = values[input];
      if (!value.is_value() && (missing == nullptr || missing->failure == waiting)) [[unlikely]]
        missing = &value;
    }
    if (missing != nullptr) {
      got = *missing;
      return;
    }
    got.failure = judged(formula, got.value);
    if (got.is_value()) [[likely]]
      return;
    got.value = 0;
    got.at = got.failure == Failure::division_by_zero ? formula.division_column : formula.column;
  }

  static double computed(const Instruction& one, double a, double b) noexcept {
    using Op = detail::ExpressionOp;
    switch (one.op) {
      case Op::negate:
        return -a;
      case Op::add:
        return a + b;
      case Op::subtract:
        return a - b;
      case Op::multiply:
        return a * b;
      case Op::divide:
        return a / b;
      case Op::power:
        return std::pow(a, b);
      case Op::less:
        return a < b ? 1 : 0;
      case Op::greater:
        return a > b ? 1 : 0;
      case Op::at_most:
        return a <= b ? 1 : 0;
      case Op::at_least:
        return a >= b ? 1 : 0;
      case Op::equal:
        return a == b ? 1 : 0;
      case Op::different:
        return a != b ? 1 : 0;
      default:
        return one.compute(a, b);
    }
  }

  /// False if an intermediate result is not finite; a comparison or a quotient may hide an infinity.
  bool run(const Formula& formula) noexcept {
    double last = 0;  // what was just computed need not come from memory
    bool is_finite = true;
    std::uint32_t at = no_place;
    for (const Instruction& one : formula.code) {
      last = computed(one, one.a == at ? last : values[one.a].value, one.b == at ? last : values[one.b].value);
      at = one.to;
      values[at].value = last;
      is_finite &= std::isfinite(last);
    }
    return is_finite;
  }

  /// The processor's flags tell what went wrong.
  Failure judged(const Formula& formula, const double& value) noexcept {
    if (run(formula)) [[likely]]
      return Failure::none;
    std::feclearexcept(bad_flags);
    run(formula);
    const int flags = set_flags();
    std::feclearexcept(bad_flags);
    return failure_of(flags, value);
  }

  static void set_truth(Got& got, bool is_true) noexcept {
    got.failure = Failure::none;
    got.value = is_true ? 1 : 0;
  }

  void take(const Step& step, Time time) noexcept {
    using Type = Step::Type;
    Got& got = values[step.to];
    switch (step.type) {
      case Type::formula:
        return compute(formulas[step.a], got);
      case Type::memory:
        return remember(memories[step.a], got, time);
      case Type::logical_not:
        got = values[step.a];
        if (got.is_value()) set_truth(got, got.value == 0);
        return;
      case Type::logical_and:
      case Type::logical_or: {
        const bool decides = step.type == Type::logical_or;  // such a side decides the result
        const Got &left = values[step.a], &right = values[step.b];
        for (const Got* side : {&left, &right})
          if (side->is_value() && (side->value != 0) == decides) return set_truth(got, decides);
        for (const State missing : {State::failed, State::waiting})
          for (const Got* side : {&left, &right})
            if (side->state() == missing) return void(got = *side);
        return set_truth(got, !decides);
      }
      case Type::choice: {
        const Got& condition = values[step.a];
        got = !condition.is_value() ? condition : values[condition.value != 0 ? step.b : step.c];
        return;
      }
    }
  }

  static double seconds_between(Time from, Time to) noexcept {
    return static_cast<double>(detail::span_between(from, to).count()) * 1e-9;
  }

  /// One more event.
  void remember(Memory& memory, Got& got, Time time) noexcept {
    const Got& argument = values[memory.argument];
    const bool is_age = memory.type == ExpressionNode::Memory::age;
    if (!argument.is_value() && !is_age) {
      got = argument;
      return;
    }
    if (is_age) {
      const bool is_first = !std::exchange(memory.has_result, true);
      if (is_first || (argument.is_value() && has_come(memory))) memory.last_time = time;
      memory.result = seconds_between(memory.last_time, time);
    } else if (memory.is_always_new || !memory.has_value || has_come(memory)) {
      take(memory, argument.value, time);
    }
    got.failure = memory.has_result ? Failure::none : waiting;
    got.at = memory.to;
    got.value = memory.has_result ? memory.result : 0;
    if (std::isfinite(got.value)) [[likely]]
      return;
    got.failure = Failure::too_large;
    got.at = static_cast<std::uint32_t>(memory.column);
    got.value = 0;
  }

  /// A name in its argument was set since the last event.
  bool has_come(const Memory& memory) const noexcept {
    for (const std::uint32_t name : memory.names)
      if (set_at[name] == event) return true;
    return false;
  }

  static void take(Memory& memory, double value, Time time) noexcept {
    using Type = ExpressionNode::Memory;
    if (memory.type == Type::highest || memory.type == Type::lowest) {
      const bool is_better = memory.type == Type::highest ? value > memory.result : value < memory.result;
      if (is_better || !memory.has_result) memory.result = value;
      memory.has_value = memory.has_result = true;
      return;
    }
    const bool is_first = !std::exchange(memory.has_value, true);
    const auto give = [&](double result) {
      memory.result = result;
      memory.has_result = true;
    };
    const double last = std::exchange(memory.last, value);
    const auto look_at_instant = [&] {
      if (!is_first && time <= memory.last_time) return;  // a later value of the same instant replaces it
      memory.has_before = !is_first;
      memory.before = last;
      memory.time_before = memory.last_time;
      memory.result_before = memory.has_result ? memory.result : 0;
      memory.last_time = time;
    };
    switch (memory.type) {
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
      case Type::highest:
      case Type::lowest:
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
    for (const Step& step : steps) take(step, instant);
    outcome = values[root];
    ++event;
    const State state = outcome.state();
    return {state, state == State::failed ? outcome.failure : Failure::none, outcome.value};
  }

  void reset() noexcept {
    for (std::size_t i = 0; i < names.size(); ++i) values[i] = {waiting, static_cast<std::uint32_t>(i), 0};
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
    for (const Memory& memory : memories)
      if (memory.to == place) return memory.name + " in column " + std::to_string(memory.column);
    return text;
  }

  std::string why() const {
    if (outcome.is_value()) return {};
    if (outcome.failure == waiting)
      return name_of(outcome.at) + (outcome.at < names.size() ? " has no value yet" : " has no value yet");
    const std::string column = " in column " + std::to_string(outcome.at);
    switch (outcome.failure) {
      case Failure::not_finite:
        return name_of(outcome.at) + " is not a finite number";
      case Failure::division_by_zero:
        return "division by zero, or the logarithm of 0," + column;
      case Failure::too_large:
        return "too large for a double," + column;
      default:
        return "no number, such as the root of a negative one," + column;
    }
  }

  std::string text;
  std::vector<std::string> names;
  bool is_condition = false;
  std::vector<Got> values;            // of names, then of constants, of what formulas compute on the way, and of steps
  std::uint64_t event = 1;            // the number of the next one
  std::vector<std::uint64_t> set_at;  // of each name: the number of the event that it was set for
  std::vector<std::uint8_t> is_used;
  std::vector<Formula> formulas;
  std::vector<Memory> memories;
  std::vector<Step> steps;  // each behind those whose places it reads
  std::size_t root = 0;     // a place
  Got outcome;
  Time last_time = Time::min();
  Time instant = Time::min();  // of the last event: the time of the first that is nearer to it than `one_instant`
};

/// Makes the steps of a program from a tree.
class Expression::Compiler {
 public:
  Compiler(Program& program, const ExpressionTree& tree, const std::vector<std::size_t>& index_of)
      : program_(program), tree_(tree), places_(tree.nodes.size(), no_place), nodes_(tree.nodes.size()) {
    for (std::size_t i = 0; i < tree.nodes.size(); ++i) {
      const Node& node = tree.nodes[i];
      nodes_[i] = {node.type == Type::name, node.type == Type::number || is_plain(node)};
      for (const std::size_t child : node.children) {
        nodes_[i].has_name |= nodes_[child].has_name;
        nodes_[i].is_plain &= nodes_[child].is_plain;
      }
      if (node.type != Type::name) continue;
      places_[i] = static_cast<std::uint32_t>(index_of[node.name]);
      program.is_used[places_[i]] = true;
    }
  }

  void compile() {
    std::vector<bool> is_input(tree_.nodes.size());  // of a formula
    for (const Node& node : tree_.nodes)
      if (is_plain(node))
        for (const std::size_t child : node.children) is_input[child] = true;
    for (std::size_t i = 0; i < tree_.nodes.size(); ++i)
      if (tree_.nodes[i].type == Type::memory || (is_input[i] && !is_plain(tree_.nodes[i]))) compile(i);
    program_.root = compile(tree_.nodes.size() - 1);
  }

 private:
  using Node = ExpressionNode;
  using Type = ExpressionNode::Type;
  using Op = detail::ExpressionOp;
  enum class Constants : std::uint8_t { as_they_are, computed };
  static constexpr std::uint32_t no_place = std::numeric_limits<std::uint32_t>::max();

  static bool is_plain(const Node& node) noexcept { return node.op != Op::none; }
  bool is_constant(std::size_t at) const noexcept { return !nodes_[at].has_name && nodes_[at].is_plain; }

  std::uint32_t place_of(double number) {
    program_.values.push_back({Failure::none, 0, number});
    return static_cast<std::uint32_t>(program_.values.size() - 1);
  }

  /// Where the value of a node is found.
  std::uint32_t compile(std::size_t at) {
    std::uint32_t& place = places_[at];
    const Node& node = tree_.nodes[at];
    if (place != no_place) return place;
    if (node.type == Type::number) return place = place_of(node.number);
    if (is_constant(at)) return place = place_of(constant(at));
    Program::Step step;
    if (node.type == Type::memory) {
      step.type = Program::Step::Type::memory;
      add_memory(node);
      step.a = static_cast<std::uint32_t>(program_.memories.size() - 1);
      step.to = program_.memories.back().to = place_of(0);
    } else if (is_plain(node)) {
      Program::Formula formula = formula_of(at, Constants::computed);
      step.a = static_cast<std::uint32_t>(program_.formulas.size());
      step.to = formula.code.back().to;
      program_.formulas.push_back(std::move(formula));
    } else {
      step.type = node.type == Type::logical_not   ? Program::Step::Type::logical_not
                  : node.type == Type::logical_and ? Program::Step::Type::logical_and
                  : node.type == Type::logical_or  ? Program::Step::Type::logical_or
                                                   : Program::Step::Type::choice;
      std::uint32_t* const operands[] = {&step.a, &step.b, &step.c};
      for (std::size_t i = 0; i < node.children.size(); ++i) *operands[i] = compile(node.children[i]);
      step.to = place_of(0);
    }
    program_.steps.push_back(step);
    return place = step.to;
  }

  static bool moves_with_time(Node::Memory memory) noexcept {
    return memory == Node::Memory::since || memory == Node::Memory::age;
  }

  void add_memory(const Node& node) {
    Program::Memory memory;
    memory.type = node.memory;
    memory.column = node.column;
    memory.name = node.text;
    memory.is_always_new = moves_with_time(node.memory);
    if (node.children.size() == 2) memory.window = std::make_unique<detail::TimeWindow>(seconds(node));
    memory.argument = compile(node.children[0]);
    collect(node.children[0], memory);
    std::sort(memory.names.begin(), memory.names.end());
    memory.names.erase(std::unique(memory.names.begin(), memory.names.end()), memory.names.end());
    program_.memories.push_back(std::move(memory));
  }

  void collect(std::size_t at, Program::Memory& memory) const {
    const Node& node = tree_.nodes[at];
    if (node.type == Type::name) memory.names.push_back(places_[at]);
    if (node.type == Type::memory && moves_with_time(node.memory)) memory.is_always_new = true;
    for (const std::size_t child : node.children) collect(child, memory);
  }

  Duration seconds(const Node& node) {
    const std::size_t before = program_.steps.size();
    const std::uint32_t place = compile(node.children[1]);
    for (std::size_t i = before; i < program_.steps.size(); ++i) program_.take(program_.steps[i], {});
    program_.steps.resize(before);
    const Got got = program_.values[place];
    const std::size_t column = tree_.nodes[node.children[1]].column;
    if (!got.is_value()) refuse(column, "the seconds of `" + node.text + "` are not a finite number");
    if (!(got.value >= 1e-6 && got.value <= 604800))
      refuse(column, "the seconds of `" + node.text + "` must be from 0.000001 to 604800 (a week)");
    return Duration{std::llround(got.value * 1e9)};
  }

  /// An expression without names is computed once.
  double constant(std::size_t at) {
    const Program::Formula formula = formula_of(at, Constants::as_they_are);
    std::feclearexcept(bad_flags);
    program_.run(formula);
    const int flags = set_flags();
    std::feclearexcept(bad_flags);
    const double value = program_.values[formula.code.back().to].value;
    switch (failure_of(flags, value)) {
      case Failure::none:
        return value;
      case Failure::division_by_zero:
        refuse(tree_.nodes[at].column, "this is a division by zero, or the logarithm of 0, whatever the values are");
      case Failure::too_large:
        refuse(tree_.nodes[at].column, "this is too large for a double, whatever the values are");
      default:
        refuse(tree_.nodes[at].column, "this is not a number, whatever the values are");
    }
  }

  void refuse_division_by_zero(const Node& node) {
    const std::size_t divisor = node.children[1];
    if (is_constant(divisor) && program_.values[compile(divisor)].value == 0)
      refuse(node.column, "this is a division by zero, whatever the values are");
  }

  Program::Formula formula_of(std::size_t at, Constants constants) {
    Program::Formula formula;
    formula.column = static_cast<std::uint32_t>(tree_.nodes[at].column);
    write(at, constants, formula);
    if (formula.division_column == 0) formula.division_column = formula.column;
    std::sort(formula.inputs.begin(), formula.inputs.end());
    formula.inputs.erase(std::unique(formula.inputs.begin(), formula.inputs.end()), formula.inputs.end());
    return formula;
  }

  /// The place of its result.
  std::uint32_t write(std::size_t at, Constants constants, Program::Formula& formula) {
    const Node& node = tree_.nodes[at];
    if (node.type == Type::number || (constants == Constants::computed && is_constant(at))) return compile(at);
    if (!is_plain(node)) {
      formula.inputs.push_back(places_[at]);
      return places_[at];
    }
    if (node.op == Op::divide) {
      if (constants == Constants::computed) refuse_division_by_zero(node);
      if (formula.division_column == 0) formula.division_column = static_cast<std::uint32_t>(node.column);
    }
    std::vector<std::uint32_t> operands;
    for (const std::size_t child : node.children) operands.push_back(write(child, constants, formula));
    std::uint32_t result = operands.front();
    const auto add = [&](Op op, std::uint32_t with) {
      formula.code.push_back({op, node.compute, result, with, place_of(0)});
      result = formula.code.back().to;
    };
    if (operands.size() == 1) add(node.op, result);
    for (std::size_t i = 1; i < operands.size(); ++i) add(node.op, operands[i]);
    if (node.text == "average") add(Op::divide, place_of(static_cast<double>(operands.size())));
    return result;
  }

  struct Known {
    bool has_name = false;
    bool is_plain = false;  // with all below it
  };
  Program& program_;
  const ExpressionTree& tree_;
  std::vector<std::uint32_t> places_;  // of each node, once it is compiled
  std::vector<Known> nodes_;
};

Expression::Program::Program(std::string_view the_text, std::vector<std::string> the_names)
    : text(the_text), names(std::move(the_names)) {
  std::vector<std::size_t> index_of;
  const ExpressionTree tree = tree_of(text, names, index_of);
  is_condition = tree.is_condition;
  values.resize(names.size());
  set_at.resize(names.size());
  is_used.resize(names.size());
  Compiler(*this, tree, index_of).compile();
  reset();
}

ExpressionError::ExpressionError(std::string_view text, ExpressionMistake mistake)
    : SetupError({Errc::bad_argument, "cannot use an expression",
                  "\"" + std::string(text.substr(0, 60)) + (text.size() > 60 ? "..." : "") + "\", column " +
                      std::to_string(mistake.column),
                  mistake.why, mistake.suggestion.empty() ? "" : "did you mean \"" + mistake.suggestion + "\"?"}),
      mistake_(std::move(mistake)) {}

std::string Expression::normal_name(std::string_view name) {
  std::string normal(name);
  std::replace(normal.begin(), normal.end(), '/', '.');
  return normal;
}

std::optional<ExpressionMistake> Expression::check(std::string_view text, const std::vector<std::string>& names) {
  try {
    const Program program(text, names);
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
                          "two names are the same: " + names[n] + " and " + names[i], "give each name once"});
  try {
    program_ = std::make_unique<Program>(text, std::move(names));
  } catch (detail::ExpressionMistakeFound& found) {
    throw ExpressionError(text, std::move(found.mistake));
  }
}

const std::string& Expression::text() const noexcept {
  static const std::string none;
  return program_ == nullptr ? none : program_->text;
}
const std::vector<std::string>& Expression::names() const noexcept {
  static const std::vector<std::string> none;
  return program_ == nullptr ? none : program_->names;
}

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
    at.failure = Failure::none;
    at.value = value;
  } else {
    at.failure = Failure::not_finite;
    at.value = 0;
  }
}

void Expression::set_unknown(std::size_t index) noexcept {
  if (program_ == nullptr || index >= program_->names.size()) return;
  program_->values[index].failure = waiting;
}

ExpressionResult Expression::evaluate(Time time) noexcept {
  return program_ == nullptr ? ExpressionResult{} : program_->evaluate(time);
}
std::string Expression::why() const { return program_ == nullptr ? "it is empty" : program_->why(); }
void Expression::reset() noexcept {
  if (program_ != nullptr) program_->reset();
}

}  // namespace rtdata
