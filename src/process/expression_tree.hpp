// The grammar of expressions: from text to a tree, without any library.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/process/expression.hpp"

namespace rtdata::detail {

struct ExpressionNode {
  enum class Type : std::uint8_t {
    number,
    name,
    negative,
    arithmetic,  // `text` is the operator
    comparison,  // `text` is the operator
    function,    // of the library; `text` is its name
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
  std::string text = {};  // as muParser has it
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
