#include "process/expression_tree.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

#include "rtdata/data/problem.hpp"

namespace rtdata::detail {
namespace {

using Node = ExpressionNode;
using Type = Node::Type;
using Memory = Node::Memory;

using Op = ExpressionOp;
constexpr auto operators = std::to_array<std::pair<std::string_view, Op>>({{"+", Op::add},
                                                                           {"-", Op::subtract},
                                                                           {"*", Op::multiply},
                                                                           {"/", Op::divide},
                                                                           {"^", Op::power},
                                                                           {"<", Op::less},
                                                                           {">", Op::greater},
                                                                           {"<=", Op::at_most},
                                                                           {">=", Op::at_least},
                                                                           {"==", Op::equal},
                                                                           {"!=", Op::different}});

struct Function {
  std::string_view name;
  std::size_t least;
  std::size_t most;
  Compute compute = nullptr;
};
constexpr std::size_t any_number = 64;
constexpr auto functions = std::to_array<Function>({
    {"abs", 1, 1, [](double x, double) noexcept { return std::abs(x); }},
    {"acos", 1, 1, [](double x, double) noexcept { return std::acos(x); }},
    {"asin", 1, 1, [](double x, double) noexcept { return std::asin(x); }},
    {"atan", 1, 1, [](double x, double) noexcept { return std::atan(x); }},
    {"atan2", 2, 2, [](double y, double x) noexcept { return std::atan2(y, x); }},
    {"average", 2, any_number},  // their sum by their number
    {"ceil", 1, 1, [](double x, double) noexcept { return std::ceil(x); }},
    {"cos", 1, 1, [](double x, double) noexcept { return std::cos(x); }},
    {"cosh", 1, 1, [](double x, double) noexcept { return std::cosh(x); }},
    {"exp", 1, 1, [](double x, double) noexcept { return std::exp(x); }},
    {"floor", 1, 1, [](double x, double) noexcept { return std::floor(x); }},
    {"ln", 1, 1, [](double x, double) noexcept { return std::log(x); }},
    {"log10", 1, 1, [](double x, double) noexcept { return std::log10(x); }},
    {"log2", 1, 1, [](double x, double) noexcept { return std::log2(x); }},
    {"max", 2, any_number, [](double a, double b) noexcept { return std::max(a, b); }},
    {"min", 2, any_number, [](double a, double b) noexcept { return std::min(a, b); }},
    {"round", 1, 1, [](double x, double) noexcept { return std::round(x); }},
    {"sign", 1, 1, [](double x, double) noexcept { return x < 0   ? -1.0
                                                          : x > 0 ? 1.0
                                                                  : 0.0; }},
    {"sin", 1, 1, [](double x, double) noexcept { return std::sin(x); }},
    {"sinh", 1, 1, [](double x, double) noexcept { return std::sinh(x); }},
    {"sqrt", 1, 1, [](double x, double) noexcept { return std::sqrt(x); }},
    {"sum", 2, any_number},
    {"tan", 1, 1, [](double x, double) noexcept { return std::tan(x); }},
    {"tanh", 1, 1, [](double x, double) noexcept { return std::tanh(x); }},
});

struct MemoryFunction {
  std::string_view name;
  Memory memory;
  std::size_t arguments;
};
constexpr auto memory_functions = std::to_array<MemoryFunction>({
    {"age", Memory::age, 1},
    {"delta", Memory::delta, 1},
    {"highest", Memory::highest, 1},
    {"integral", Memory::integral, 1},
    {"lowest", Memory::lowest, 1},
    {"mean", Memory::mean, 2},
    {"previous", Memory::previous, 1},
    {"rate", Memory::rate, 1},
    {"rate", Memory::rate_over, 2},
    {"since", Memory::since, 1},
});

bool is_letter(char c) noexcept { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_'; }
bool is_digit(char c) noexcept { return c >= '0' && c <= '9'; }

enum class Token : std::uint8_t { end, number, name, quoted, symbol };

class Parser {
 public:
  Parser(std::string_view text, const std::vector<std::string>& known) : text_(text) {
    for (const std::string& name : known) known_.push_back(Expression::normal_name(name));
  }

  ExpressionTree parse() {
    if (text_.size() > Expression::max_length)
      fail_at(0, "it has " + std::to_string(text_.size()) + " bytes: an expression has at most " +
                     std::to_string(Expression::max_length));
    next();
    if (token_ == Token::end) fail("it is empty");
    const std::size_t root = choice();
    if (token_ != Token::end) unexpected();
    tree_.is_condition = is_condition(root);
    return std::move(tree_);
  }

 private:
  [[noreturn]] void fail_at(std::size_t byte, std::string why, std::string suggestion = {}) const {
    throw ExpressionMistakeFound{{column_of(byte), std::move(why), std::move(suggestion)}};
  }
  [[noreturn]] void fail(std::string why, std::string suggestion = {}) const {
    fail_at(start_, std::move(why), std::move(suggestion));
  }
  [[noreturn]] void fail_node(std::size_t node, std::string why) const {
    throw ExpressionMistakeFound{{tree_.nodes[node].column, std::move(why), {}}};
  }
  [[noreturn]] void unexpected() const {
    if (token_ == Token::end) fail("the expression ends, but a value is missing");
    if (token_ == Token::symbol && word_ == ")") fail("a `)` without its `(`");
    if (token_ == Token::symbol && word_ == "=") fail("a single `=` does not compare: write `==`");
    fail("`" + std::string(word_) + "` is not possible here");
  }
  std::size_t column_of(std::size_t byte) const noexcept {
    std::size_t column = 1;
    for (std::size_t i = 0; i < byte && i < text_.size(); ++i)
      if ((static_cast<unsigned char>(text_[i]) & 0xC0U) != 0x80U) ++column;
    return column;
  }

  /// The text of a token from start_ to the given end.
  void take(Token token, std::size_t end) {
    token_ = token;
    word_ = text_.substr(start_, end - start_);
    at_ = end;
  }

  void next() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\t' || text_[at_] == '\n' || text_[at_] == '\r'))
      ++at_;
    start_ = at_;
    if (at_ == text_.size()) return take(Token::end, at_);
    const char c = text_[at_];
    const char after = at_ + 1 < text_.size() ? text_[at_ + 1] : '\0';
    if (is_digit(c) || (c == '.' && is_digit(after))) return number();
    if (is_letter(c)) return name();
    if (c == '\'') return quoted();
    static constexpr auto pairs = std::to_array<std::string_view>({"<=", ">=", "==", "!=", "&&", "||"});
    const std::string_view two = text_.substr(at_, 2);
    if (std::find(pairs.begin(), pairs.end(), two) != pairs.end()) return take(Token::symbol, at_ + 2);
    if (two == "**") fail("there is no `**`: a power is `^`");
    if (two == "<>") fail("there is no `<>`: write `!=`");
    if (std::string_view("+-*/^()<>=!?:,").find(c) != std::string_view::npos) return take(Token::symbol, at_ + 1);
    if (c == '%') fail("there is no `%`");
    if (c == '"') fail("names stand in single quotes, if in any");
    if (c == '&' || c == '|')
      fail(std::string("there is no single `") + c + "`: write `" + (c == '&' ? "and" : "or") + "`");
    const auto byte = static_cast<unsigned char>(c);
    if (byte < 0x20 || byte == 0x7F) fail("a control character");
    std::size_t end = at_ + 1;
    while (end < text_.size() && (static_cast<unsigned char>(text_[end]) & 0xC0U) == 0x80U) ++end;
    fail("`" + std::string(text_.substr(at_, end - at_)) + "` is not possible in an expression");
  }

  void number() {
    double value = 0;
    const char* const first = text_.data() + at_;
    const auto [end, error] = std::from_chars(first, text_.data() + text_.size(), value);
    const auto length = static_cast<std::size_t>(end - first);
    if (error == std::errc::result_out_of_range) fail("the number is too large or too small for a double");
    std::size_t stop = at_ + length;
    if (stop < text_.size() && (is_letter(text_[stop]) || is_digit(text_[stop]) || text_[stop] == '.')) {
      while (stop < text_.size() && (is_letter(text_[stop]) || is_digit(text_[stop]) || text_[stop] == '.')) ++stop;
      fail("`" + std::string(text_.substr(at_, stop - at_)) +
           "` is not a number: units are not written, a product needs a `*`, and a name that begins with a digit must "
           "be in single quotes");
    }
    value_ = value;
    take(Token::number, stop);
  }

  void name() {
    std::size_t end = at_;
    while (true) {
      while (end < text_.size() && (is_letter(text_[end]) || is_digit(text_[end]))) ++end;
      while (end < text_.size() && text_[end] == '[') {
        std::size_t index = end + 1;
        while (index < text_.size() && is_digit(text_[index])) ++index;
        if (index == end + 1 || index == text_.size() || text_[index] != ']')
          fail_at(end, "an index is a number in brackets, such as [0]");
        end = index + 1;
      }
      if (end + 1 < text_.size() && text_[end] == '.' && (is_letter(text_[end + 1]) || is_digit(text_[end + 1])))
        ++end;
      else
        break;
    }
    if (end < text_.size() && text_[end] == '.') fail_at(end, "a word is missing behind the dot");
    take(Token::name, end);
  }

  void quoted() {
    const std::size_t end = text_.find('\'', at_ + 1);
    if (end == std::string_view::npos) fail("the single quote is not closed");
    if (end == at_ + 1) fail("there is no name in the quotes");
    take(Token::quoted, end + 1);
  }

  bool is_symbol(std::string_view symbol) const noexcept { return token_ == Token::symbol && word_ == symbol; }
  bool is_word(std::string_view word) const noexcept { return token_ == Token::name && word_ == word; }
  bool is_comparison() const noexcept {
    static constexpr auto all = std::to_array<std::string_view>({"<", ">", "<=", ">=", "==", "!="});
    return token_ == Token::symbol && std::find(all.begin(), all.end(), word_) != all.end();
  }

  std::size_t add(Node node) {
    tree_.nodes.push_back(std::move(node));
    return tree_.nodes.size() - 1;
  }
  Node made(Type type, std::string_view text, std::vector<std::size_t> children) const {
    Node node;
    node.type = type;
    node.column = column_of(start_);
    node.text = std::string(text);
    for (const auto& [symbol, op] : operators)
      if (symbol == text) node.op = op;
    node.children = std::move(children);
    return node;
  }
  [[noreturn]] void too_deep(std::size_t column) const {
    throw ExpressionMistakeFound{
        {column,
         "more than " + std::to_string(Expression::max_depth) + " parentheses, calls and operators within each other",
         {}}};
  }

  bool is_condition(std::size_t at) const noexcept {
    const Node& node = tree_.nodes[at];
    switch (node.type) {
      case Type::comparison:
      case Type::logical_not:
      case Type::logical_and:
      case Type::logical_or:
        return true;
      case Type::number:
        return node.text == "bool";
      case Type::choice:
        return is_condition(node.children[1]) && is_condition(node.children[2]);
      default:
        return false;
    }
  }

  struct Deeper {
    explicit Deeper(Parser& p) : parser(p) {
      if (++parser.depth_ > Expression::max_depth) parser.too_deep(parser.column_of(parser.start_));
    }
    Deeper(const Deeper&) = delete;
    Deeper& operator=(const Deeper&) = delete;
    ~Deeper() { --parser.depth_; }
    Parser& parser;
  };

  std::size_t choice() {
    const Deeper deeper(*this);
    const std::size_t condition = disjunction();
    if (!is_symbol("?")) return condition;
    Node node = made(Type::choice, "", {condition});
    next();
    node.children.push_back(choice());
    if (!is_symbol(":")) {
      if (token_ != Token::end) unexpected();
      fail("the `:` of the `?` is missing");
    }
    next();
    node.children.push_back(choice());
    return add(std::move(node));
  }

  std::size_t disjunction() {
    std::size_t left = conjunction();
    while (is_word("or") || is_symbol("||")) {
      Node node = made(Type::logical_or, "", {left});
      next();
      node.children.push_back(conjunction());
      left = add(std::move(node));
    }
    return left;
  }

  std::size_t conjunction() {
    std::size_t left = negation();
    while (is_word("and") || is_symbol("&&")) {
      Node node = made(Type::logical_and, "", {left});
      next();
      node.children.push_back(negation());
      left = add(std::move(node));
    }
    return left;
  }

  std::size_t negation() {
    if (!is_word("not") && !is_symbol("!")) return comparison();
    const Deeper deeper(*this);
    Node node = made(Type::logical_not, "", {});
    next();
    node.children.push_back(negation());
    return add(std::move(node));
  }

  std::size_t comparison() {
    const std::size_t left = sum();
    if (is_symbol("=")) unexpected();
    if (!is_comparison()) return left;
    Node node = made(Type::comparison, word_, {left});
    next();
    node.children.push_back(sum());
    if (is_comparison()) fail("a second comparison of one value: write `a < b and b < c`");
    if (is_symbol("=")) unexpected();
    return add(std::move(node));
  }

  std::size_t sum() {
    std::size_t left = product();
    while (is_symbol("+") || is_symbol("-")) {
      Node node = made(Type::arithmetic, word_, {left});
      next();
      node.children.push_back(product());
      left = add(std::move(node));
    }
    return left;
  }

  std::size_t product() {
    std::size_t left = signed_value();
    while (is_symbol("*") || is_symbol("/")) {
      Node node = made(Type::arithmetic, word_, {left});
      next();
      node.children.push_back(signed_value());
      left = add(std::move(node));
    }
    return left;
  }

  /// -x^2 is -(x^2), as in mathematics; 2^-1 is a half.
  std::size_t signed_value() {
    if (!is_symbol("-") && !is_symbol("+")) return power();
    const Deeper deeper(*this);
    const bool is_minus = word_ == "-";
    Node node = made(Type::negative, "", {});
    node.op = Op::negate;
    next();
    const std::size_t of = signed_value();
    if (!is_minus) return of;
    node.children.push_back(of);
    return add(std::move(node));
  }

  std::size_t power() {
    const std::size_t base = value();
    if (!is_symbol("^")) return base;
    const Deeper deeper(*this);
    Node node = made(Type::arithmetic, word_, {base});
    next();
    node.children.push_back(signed_value());
    return add(std::move(node));
  }

  std::size_t value() {
    if (token_ == Token::number) {
      Node node = made(Type::number, "", {});
      node.number = value_;
      next();
      return add(std::move(node));
    }
    if (is_symbol("(")) {
      const std::size_t opened = start_;
      next();
      const std::size_t inside = choice();
      if (token_ == Token::end) fail_at(opened, "the `(` is not closed");
      if (!is_symbol(")")) unexpected();
      next();
      return inside;
    }
    if (token_ == Token::quoted) return variable(std::string(word_.substr(1, word_.size() - 2)));
    if (token_ != Token::name) unexpected();
    for (const std::string_view word : {"and", "or", "not"})
      if (word_ == word) fail("`" + std::string(word) + "` has no value on its left, or it is in the place of a value");
    const std::string word(word_);
    const std::size_t behind = text_.find_first_not_of(" \t\r\n", at_);
    if (behind != std::string_view::npos && text_[behind] == '(') return call(word);
    if (!is_known(word)) {
      const auto constant = [&](double number, const char* kind) {
        Node node = made(Type::number, kind, {});
        node.number = number;
        next();
        return add(std::move(node));
      };
      if (word == "pi") return constant(std::numbers::pi, "");
      if (word == "e") return constant(std::numbers::e, "");
      if (word == "true") return constant(1, "bool");
      if (word == "false") return constant(0, "bool");
    }
    return variable(word);
  }

  bool is_known(std::string_view name) const noexcept {
    return std::find(known_.begin(), known_.end(), name) != known_.end();
  }

  std::size_t variable(const std::string& written) {
    Node node = made(Type::name, "", {});
    const std::string name = Expression::normal_name(written);
    const auto found = std::find(tree_.names.begin(), tree_.names.end(), name);
    node.name = static_cast<std::size_t>(found - tree_.names.begin());
    if (found == tree_.names.end()) {
      tree_.names.push_back(name);
      tree_.columns.push_back(node.column);
    }
    next();
    return add(std::move(node));
  }

  std::size_t call(const std::string& word) {
    const auto function = std::find_if(functions.begin(), functions.end(),
                                       [&](const Function& one) { return one.name == word; });
    const auto memory = std::find_if(memory_functions.begin(), memory_functions.end(),
                                     [&](const MemoryFunction& one) { return one.name == word; });
    if (function == functions.end() && memory == memory_functions.end()) {
      if (word == "log") fail("`log` has two meanings: write `ln` or `log10`");
      if (word == "if") fail("there is no `if`: write `condition ? a : b`");
      if (word == "avg") fail("there is no function `avg`", "average");
      if (word == "pow") fail("there is no function `pow`: a power is `^`");
      std::vector<std::string> all = expression_functions();
      fail("there is no function `" + word + "`", nearest_name(word, all));
    }
    const std::size_t called_at = start_;
    Node node = made(Type::function, "", {});
    next();
    const std::size_t opened = start_;
    next();
    if (!is_symbol(")")) {
      while (true) {
        node.children.push_back(choice());
        if (!is_symbol(",")) break;
        next();
      }
    }
    if (token_ == Token::end) fail_at(opened, "the `(` is not closed");
    if (!is_symbol(")")) unexpected();
    next();
    const std::size_t given = node.children.size();
    const auto refuse = [&](const std::string& wanted) {
      fail_at(called_at, "`" + word + "` takes " + wanted + ", not " + std::to_string(given));
    };
    if (function != functions.end()) {
      if (given == 1 && function->most == any_number)  // the writer probably means earlier values
        fail_at(called_at, "`" + word + "` needs several values of one event; for one value over time use `highest`, " +
                               "`lowest`, `mean` or `integral`");
      if (given < function->least || given > function->most)
        refuse(function->most == any_number
                   ? "2 arguments or more, up to 64"
                   : std::to_string(function->least) + (function->least == 1 ? " argument" : " arguments"));
      node.text = word;
      node.op = function->name == "sum" || function->name == "average" ? Op::add : Op::call;
      node.compute = function->compute;
      return add(std::move(node));
    }
    std::optional<Memory> meant;
    for (const MemoryFunction& one : memory_functions)
      if (one.name == word && one.arguments == given) meant = one.memory;
    if (!meant) {
      if (word == "rate") refuse("1 argument, or 2: a value and seconds");
      if (word == "mean") refuse("2 arguments: a value and seconds");
      refuse("1 argument");
    }
    node.type = Type::memory;
    node.memory = *meant;
    node.text = word;
    if (!has_name(node.children[0]))
      fail_node(node.children[0], "the first argument of `" + word + "` has no field in it, so it never changes");
    if (given == 2 && has_name(node.children[1]))
      fail_node(node.children[1], "the seconds of `" + word + "` must be a constant, without names");
    if (++memories_ > Expression::max_memories)
      fail_at(called_at, "more than " + std::to_string(Expression::max_memories) + " functions with a memory");
    return add(std::move(node));
  }

  bool has_name(std::size_t at) const noexcept {
    const Node& node = tree_.nodes[at];
    if (node.type == Type::name) return true;
    return std::any_of(node.children.begin(), node.children.end(),
                       [this](std::size_t child) { return has_name(child); });
  }

  std::string_view text_;
  std::vector<std::string> known_;
  ExpressionTree tree_;
  Token token_ = Token::end;
  std::string_view word_;
  double value_ = 0;
  std::size_t start_ = 0;
  std::size_t at_ = 0;
  std::size_t depth_ = 0;
  std::size_t memories_ = 0;
};

}  // namespace

ExpressionTree parse_expression(std::string_view text, const std::vector<std::string>& known) {
  return Parser(text, known).parse();
}

std::vector<std::string> expression_functions() {
  std::vector<std::string> all;
  for (const Function& one : functions) all.emplace_back(one.name);
  for (const MemoryFunction& one : memory_functions)
    if (all.back() != one.name) all.emplace_back(one.name);
  return all;
}

}  // namespace rtdata::detail
