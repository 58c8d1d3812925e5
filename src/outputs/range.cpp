// Which values an output can have: those of its device, compared with those in a configuration.
#include <cmath>
#include <exception>
#include <utility>

#include "data/setting_mistake.hpp"
#include "outputs/set_text.hpp"
#include "process/expression_fields.hpp"
#include "process/expression_tree.hpp"
#include "rtdata/outputs/output.hpp"

namespace rtdata {
namespace {

constexpr double endless = std::numeric_limits<double>::infinity();

struct Constant {
  double value;
  std::size_t column;
};

/// The constant results of an expression that its text shows: a constant, the choices of `? :`, and for a condition 0
/// and 1. A text with a mistake has none.
std::vector<Constant> constants_of(const std::string& text) {
  using Type = detail::ExpressionNode::Type;
  std::vector<Constant> constants;
  try {
    const detail::ExpressionTree tree = detail::parse_expression(text, {});
    std::vector<std::size_t> results{tree.nodes.size() - 1};
    while (!results.empty()) {
      const detail::ExpressionNode& node = tree.nodes[results.back()];
      results.pop_back();
      if (node.type == Type::choice) {
        results.push_back(node.children[2]);
        results.push_back(node.children[1]);
      } else if (node.type == Type::number) {
        constants.push_back({node.number, node.column});
      } else if (node.type == Type::negative && tree.nodes[node.children[0]].type == Type::number) {
        constants.push_back({-tree.nodes[node.children[0]].number, node.column});
      } else if (node.type == Type::comparison || node.type == Type::logical_not || node.type == Type::logical_and ||
                 node.type == Type::logical_or) {
        constants.push_back({0, node.column});
        constants.push_back({1, node.column});
      }
    }
  } catch (const detail::ExpressionMistakeFound&) {  // another check reports the mistake
  }
  return constants;
}

}  // namespace

std::string OutputRange::refusal(double value) const {
  if (!std::isfinite(value)) return "the value is not a finite number";
  const bool fits = value >= least && value <= most && (!is_whole || value == std::floor(value));
  if (fits) return "";
  std::string text = detail::number_text(value) + " is not a value for the device: ";
  const std::string from = detail::number_text(least), to = detail::number_text(most);
  if (is_whole && most == least + 1) return text + from + " or " + to;
  if (is_whole) text += "whole numbers";
  if (least == -endless && most == endless) return text;
  text += is_whole ? " " : "";
  if (most == endless) return text + from + " or more";
  if (least == -endless) return text + to + " or less";
  return text + "from " + from + " to " + to;
}

OutputRange range_of(const MakeActuator& make) noexcept {
  try {
    const std::unique_ptr<Actuator> actuator = make ? make() : nullptr;
    if (actuator != nullptr) return actuator->range();
  } catch (...) {  // the start reports why there is none
  }
  return {};
}

void check_output_values(const OutputConfig& config, const OutputRange& range, const ConfigItem& item,
                         Problems& problems) {
  const auto check = [&](double value, const ConfigItem& at, const char* what) {
    if (const std::string why = range.refusal(value); !why.empty()) problems.add(at.problem("bad-value", what + why));
  };
  check(config.safe, detail::item_of(item, "safe"), item.find("safe") != nullptr ? "" : "`safe` is 0 by default: ");
  if (config.hysteresis) {
    const ConfigItem& at = detail::item_of(item, "hysteresis");
    check(0, at, "off is 0: ");
    check(1, at, "on is 1: ");
  } else if (config.pid) {
    const ConfigItem& at = detail::item_of(item, "pid");
    if (range.is_whole) {  // nearly all of its values would be refused
      problems.add(at.problem("bad-value",
                              "a `pid` gives fractions, but the device accepts only whole numbers: use `hysteresis`"));
      return;
    }
    check(config.pid->least, detail::item_of(at, "least"), at.find("least") != nullptr ? "" : "`least` is 0: ");
    check(config.pid->most, detail::item_of(at, "most"), at.find("most") != nullptr ? "" : "`most` is 1: ");
  } else if (const ConfigItem* const at = item.find("expression")) {
    for (const Constant& constant : constants_of(config.expression))
      if (const std::string why = range.refusal(constant.value); !why.empty())
        problems.add(detail::problem_of({constant.column, why, ""}, *at));
  }
}

}  // namespace rtdata
