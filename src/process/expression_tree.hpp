// The grammar of expressions: from text to a tree, without any library.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/process/expression.hpp"

namespace rtdata::detail {

/// A function of the library. A function with one argument gets it twice; more than two arguments are applied from the
/// left.
using Compute = double (*)(double, double) noexcept;
/// Plain arithmetic.
enum class ExpressionOp : std::uint8_t {
  none,
  negate,
  add,
  subtract,
  multiply,
  divide,
  power,
  less,
  greater,
  at_most,
  at_least,
  equal,
  different,
  call
};

struct ExpressionNode {
  enum class Type : std::uint8_t {
    number,
    name,
    negative,
    arithmetic,
    comparison,
    function,
    logical_not,
    logical_and,
    logical_or,
    choice,  // condition, then, else
    memory,
  };
  enum class Memory : std::uint8_t { age, delta, highest, integral, lowest, mean, previous, rate, rate_over, since };

  Type type = Type::number;
  Memory memory{};
  std::size_t column = 1;
  double number = 0;
  std::size_t name = 0;   // among ExpressionTree::names
  std::string text = {};  // of functions; "bool" of true and false
  ExpressionOp op = ExpressionOp::none;
  Compute compute = nullptr;  // of `call`
  std::vector<std::size_t> children = {};
};

struct ExpressionTree {
  std::vector<ExpressionNode> nodes;  // each behind its children; the last one is the root
  std::vector<std::string> names;     // normal, in the order in which they come first
  std::vector<std::size_t> columns;   // where they do
  bool is_condition = false;          // the root gives true or false
};

/// Thrown by the functions below.
struct ExpressionMistakeFound {
  ExpressionMistake mistake;
};

/// `known`: whether a name is one of the program's, so that it hides a constant.
ExpressionTree parse_expression(std::string_view text, const std::vector<std::string>& known);

/// The names of all functions, for suggestions.
std::vector<std::string> expression_functions();

}  // namespace rtdata::detail
