#include "rtdata/process/processing.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <utility>

#include "data/field_layout.hpp"
#include "data/nearest.hpp"
#include "data/setting_mistake.hpp"
#include "process/published.hpp"
#include "rtdata/data/config_item.hpp"

namespace rtdata {
namespace {

constexpr std::size_t most_filters = 8;
constexpr std::size_t most_coefficients = 10;
constexpr std::size_t most_points = 1000;
constexpr unsigned longest_median = 255;
constexpr unsigned longest_mean = 1000;
constexpr std::size_t most_bytes = 4096;  // of a payload, max_payload_size

bool is_finite(const std::optional<double>& value) { return !value || std::isfinite(*value); }

/// Collects the mistakes of one field.
struct Finder {
  const std::string& field;
  std::vector<ProcessingMistake>& mistakes;

  void add(std::string key, std::string why, std::string advice) {
    mistakes.push_back({field, std::move(key), std::move(why), std::move(advice)});
  }

  void look_at(const Calibration& c) {
    if (!std::isfinite(c.scale) || c.scale == 0)
      add("calibration.scale", "it is not a finite number other than 0", "such as 2.5");
    if (!std::isfinite(c.offset)) add("calibration.offset", "it is not a finite number", "such as -0.1");
    if (!c.polynomial.empty() && !c.table.empty())
      add("calibration.table", "there is a polynomial already", "remove one of the two");
    if (c.polynomial.size() == 1 || c.polynomial.size() > most_coefficients) {
      add("calibration.polynomial", "it has " + std::to_string(c.polynomial.size()) + " coefficients",
          "use 2 to " + std::to_string(most_coefficients) + ", beginning with the constant");
    }
    if (!std::all_of(c.polynomial.begin(), c.polynomial.end(), [](double one) { return std::isfinite(one); }))
      add("calibration.polynomial", "a coefficient is not a finite number", "such as [0, 1.5, 0.02]");
    if (c.table.size() == 1 || c.table.size() > most_points) {
      add("calibration.table", "it has " + std::to_string(c.table.size()) + " points",
          "use 2 to " + std::to_string(most_points));
    }
    for (std::size_t i = 0; i < c.table.size(); ++i) {
      const std::string place = "calibration.table[" + std::to_string(i) + "]";
      if (!std::isfinite(c.table[i][0]) || !std::isfinite(c.table[i][1]))
        add(place, "it contains a value that is not a finite number", "such as [0.5, 12]");
      else if (i > 0 && c.table[i][0] <= c.table[i - 1][0])
        add(place, "the table is not in ascending order here",
            "sort the points by their first numbers, each number once");
    }
    if (!c.points.empty()) look_at_points(c);
    if (!std::isfinite(c.tare)) add("calibration.tare", "it is not a finite number", "such as 12.5");
    if (c.outside != OutsideTable::refuse && c.table.empty())
      add("calibration.outside", "there is no table that a value could be outside of", "remove it, or add a `table`");
    look_at_bounds("calibration", c.least, c.most);
  }

  void look_at_points(const Calibration& c) {
    if (c.scale != 1 || c.offset != 0 || !c.polynomial.empty() || !c.table.empty())
      add("calibration.points", "with `points`, there can be no `scale`, `offset`, `polynomial` or `table`",
          "remove those: the points give the whole line");
    if (c.points.size() < 2 || c.points.size() > most_points) {
      return add("calibration.points",
                 "it has " + std::to_string(c.points.size()) + (c.points.size() == 1 ? " point" : " points"),
                 "use 2 to " + std::to_string(most_points));
    }
    const std::size_t before = mistakes.size();
    std::map<double, std::size_t> known;
    for (std::size_t i = 0; i < c.points.size(); ++i) {
      const std::string place = "calibration.points[" + std::to_string(i) + "]";
      if (!std::isfinite(c.points[i][0]) || !std::isfinite(c.points[i][1])) {
        add(place, "it contains a value that is not a finite number", "such as [123.4, 0]");
      } else if (const auto [at, is_new] = known.emplace(c.points[i][0], i); !is_new) {
        add(place, "it has the raw value of points[" + std::to_string(at->second) + "]",
            "use each raw value once, such as with the mean of its true values");
      }
    }
    if (mistakes.size() != before) return;
    const CalibrationLine line = line_through(c.points);
    if (!std::isfinite(line.slope) || !std::isfinite(line.y) || !std::isfinite(line.largest))
      add("calibration.points", "the numbers of their line are not finite", "use points that are farther apart");
    else if (line.slope == 0)
      add("calibration.points", "their line gives the same value for every raw value",
          "use points with different true values");
  }

  void look_at_bounds(const std::string& where, const std::optional<double>& least, const std::optional<double>& most) {
    if (!is_finite(least)) add(where + ".least", "it is not a finite number", "such as 0");
    if (!is_finite(most)) add(where + ".most", "it is not a finite number", "such as 10");
    if (least && most && *least > *most) add(where + ".least", "it is above `most`", "exchange the two");
  }

  void look_at(const Filter& f, const std::string& where) {
    const auto count = [&](unsigned least, unsigned most, const char* which) {
      const std::string advice = std::string("give it ") + which + " number from " + std::to_string(least) + " to " +
                                 std::to_string(most);
      if (!f.of) return add(where + ".of", "the number of samples is missing", advice);
      const bool is_even_median = f.type == FilterType::median && *f.of % 2 == 0;
      if (*f.of < least || *f.of > most || is_even_median)
        add(where + ".of",
            std::to_string(*f.of) + " samples are not possible" + (is_even_median ? ", for a median" : ""), advice);
    };
    const auto only_of = [&](const char* key, bool is_set, std::initializer_list<FilterType> types) {
      if (!is_set || std::find(types.begin(), types.end(), f.type) != types.end()) return;
      add(where + "." + key, "a filter of this type has no such setting", "remove it, or set another `type`");
    };
    only_of("of", f.of.has_value(), {FilterType::median, FilterType::mean});
    only_of("weight", f.weight.has_value(), {FilterType::exponential});
    only_of("least", f.least.has_value(), {FilterType::clamp});
    only_of("most", f.most.has_value(), {FilterType::clamp});
    only_of("time", f.time.has_value(), {FilterType::throttle});
    only_of("by", f.by.has_value(), {FilterType::delta});
    switch (f.type) {
      case FilterType::median:
        return count(3, longest_median, "an odd");
      case FilterType::mean:
        return count(2, longest_mean, "a");
      case FilterType::exponential:
        if (!f.weight || !(*f.weight > 0 && *f.weight <= 1))
          add(where + ".weight", "the weight of the new value must be above 0, up to 1", "such as 0.2");
        return;
      case FilterType::clamp:
        if (!f.least && !f.most) add(where + ".least", "it has no limit", "set `least`, `most` or both");
        return look_at_bounds(where, f.least, f.most);
      case FilterType::throttle:
        if (!f.time || *f.time <= Duration{0}) add(where + ".time", "the time is missing", "such as \"1 s\"");
        return;
      case FilterType::delta:
        if (!f.by || !(*f.by > 0) || !std::isfinite(*f.by))
          add(where + ".by", "the amount is missing, or not above 0", "such as 0.1");
        return;
      case FilterType::rate_of_change:
        return;
    }
  }

  void look_at(const FieldProcessing& p) {
    if (p.calibration) look_at(*p.calibration);
    if (p.filters.size() > most_filters)
      add("filters", "these are " + std::to_string(p.filters.size()), "use at most " + std::to_string(most_filters));
    bool has_rate = false;
    for (std::size_t i = 0; i < p.filters.size(); ++i) {
      const std::string where = "filters[" + std::to_string(i) + "]";
      look_at(p.filters[i], where);
      if (p.filters[i].type == FilterType::rate_of_change && std::exchange(has_rate, true))
        add(where, "there is already a rate of change", "remove one: both would be in " + field + ".rate");
    }
    if (p.unit && !p.calibration)
      add("unit", "a value without a calibration keeps its unit", "add a `calibration`, or remove the unit");
    if (!p.calibration && p.filters.empty()) add("", "there is nothing to do", "add a `calibration` or `filters`");
  }

  /// Of the field in the description. False: none that can be processed.
  bool fits(const Field* found, const FieldProcessing& p, const std::vector<std::string_view>& known) {
    if (found == nullptr) {
      add("", "there is no such field", detail::suggestion(field, known));
      return false;
    }
    if (!detail::is_integer_kind(found->kind) && found->kind != Kind::f32 && found->kind != Kind::f64) {
      add("", "it is of type " + std::string(name_of(found->kind)), "only numbers can be calibrated and filtered");
      return false;
    }
    if (detail::is_integer_kind(found->kind) && detail::changes_value(p) && field.find('[') != std::string::npos) {
      add("", "all elements of an array of integers have one type, and this element would become a double",
          "process the whole array, or use only throttle, delta and rate_of_change");
      return false;
    }
    return true;
  }
};

/// Offsets and sizes again, after the types of some values were changed.
Result<detail::Layout> lay_out_again(std::vector<Field>& fields, const std::string& name) {
  for (Field& field : fields) {
    if (field.kind == Kind::record) {
      auto layout = lay_out_again(field.fields, field.name);
      if (!layout) return layout;
      field.size = layout->size;
      field.alignment = layout->alignment;
    }
    field = detail::finished(std::move(field), field.optional != nullptr ? DescriptionBuilder::Presence::optional
                                                                         : DescriptionBuilder::Presence::always);
  }
  return detail::lay_out(fields, name);
}

std::vector<ProcessingMistake> mistakes_in(const std::string& field, const FieldProcessing& processing) {
  std::vector<ProcessingMistake> mistakes;
  Finder{field, mistakes}.look_at(processing);
  return mistakes;
}

Error first_error(const std::string& sensor, const std::vector<ProcessingMistake>& mistakes) {
  const ProcessingMistake& first = mistakes.front();
  return {Errc::bad_argument, "cannot process", "sensor " + sensor + ", field " + first.field,
          (first.key.empty() ? "" : first.key + ": ") + first.why, first.advice};
}

}  // namespace

namespace detail {

bool changes_value(const FieldProcessing& processing) noexcept {
  return processing.calibration ||
         std::any_of(processing.filters.begin(), processing.filters.end(), [](const Filter& f) {
           return f.type != FilterType::throttle && f.type != FilterType::delta && f.type != FilterType::rate_of_change;
         });
}

std::vector<const Leaf*> leaves_of(const Description& description, std::string_view path) {
  std::vector<const Leaf*> leaves;
  for (const Leaf& leaf : description.leaves()) {
    const std::string_view of = leaf.path;
    if (of == path || (of.starts_with(path) && of[path.size()] == '[' && of.find(']', path.size()) == of.size() - 1))
      leaves.push_back(&leaf);
  }
  return leaves;
}

bool has_rate(const FieldProcessing& processing) noexcept {
  return std::any_of(processing.filters.begin(), processing.filters.end(),
                     [](const Filter& f) { return f.type == FilterType::rate_of_change; });
}

}  // namespace detail

ProcessingError::ProcessingError(const std::string& sensor, std::vector<ProcessingMistake> mistakes)
    : SetupError(first_error(sensor, mistakes)), mistakes_(std::move(mistakes)) {}

CalibrationLine line_through(std::span<const std::array<double, 2>> points) noexcept {
  CalibrationLine line;
  if (points.size() == 2) {  // exactly, also where the numbers are large
    line.x = points[0][0];
    line.y = points[0][1];
    line.slope = (points[1][1] - line.y) / (points[1][0] - line.x);
    return line;
  }
  const auto count = static_cast<double>(points.size());
  for (const auto& [x, y] : points) {
    line.x += x / count;
    line.y += y / count;
  }
  double squares = 0;
  double products = 0;
  for (const auto& [x, y] : points) {
    squares += (x - line.x) * (x - line.x);
    products += (x - line.x) * (y - line.y);
  }
  line.slope = products / squares;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double residual = points[i][1] - line.value(points[i][0]);
    if (std::abs(residual) <= std::abs(line.largest)) continue;
    line.largest = residual;
    line.farthest = i;
  }
  return line;
}

double calibrated(const Calibration& calibration, double raw) noexcept {
  const Calibration& c = calibration;
  double x = c.points.empty() ? raw * c.scale + c.offset : line_through(c.points).value(raw);
  if (!c.polynomial.empty()) {
    double sum = 0;
    for (auto one = c.polynomial.rbegin(); one != c.polynomial.rend(); ++one) sum = sum * x + *one;
    x = sum;
  }
  if (!c.table.empty()) {
    const auto& table = c.table;
    if (!(x >= table.front()[0] && x <= table.back()[0])) {
      if (c.outside == OutsideTable::refuse) return std::nan("");
      if (c.outside == OutsideTable::clamp) return (x < table.front()[0] ? table.front() : table.back())[1] - c.tare;
    }
    std::size_t n = 0;
    while (n + 2 < table.size() && table[n + 1][0] <= x) ++n;
    x = table[n][1] + (table[n + 1][1] - table[n][1]) * ((x - table[n][0]) / (table[n + 1][0] - table[n][0]));
  }
  return x - c.tare;
}

void check_config(const FieldProcessing& config, const ConfigItem& item, Problems& problems) {
  for (const ProcessingMistake& mistake : mistakes_in("", config)) {
    detail::add_mistake({mistake.key, mistake.why, mistake.advice}, item, problems);
  }
  const ConfigItem* const points = item.find("calibration.points");
  if (points != nullptr && points->is_array() && points->size() == 0)
    problems.add(points->problem("bad-value", "it has 0 points; use 2 to " + std::to_string(most_points)));
}

std::shared_ptr<const Description> processed(const std::shared_ptr<const Description>& description,
                                             const Processing& processing, const std::string& sensor) {
  std::vector<ProcessingMistake> mistakes;
  std::vector<std::string_view> known;
  for (const Leaf& leaf : description->leaves()) known.push_back(leaf.path);
  std::vector<Field> fields = description->fields();
  std::vector<Field> added;
  std::set<const Leaf*> taken;
  for (const auto& entry : processing) {
    const std::string& path = entry.first;
    const FieldProcessing& what = entry.second;
    Finder finder{path, mistakes};
    finder.look_at(what);
    const Field* const before = detail::field_at(description->fields(), path);
    if (!finder.fits(before, what, known)) continue;
    for (const Leaf* leaf : detail::leaves_of(*description, path)) {
      if (taken.insert(leaf).second) continue;
      finder.add("", leaf->path + " is named twice", "name the array or its elements");
      break;
    }
    const bool is_whole_array = before->is_array && !path.ends_with(']');
    const auto presence = before->optional != nullptr ? DescriptionBuilder::Presence::optional
                                                      : DescriptionBuilder::Presence::always;
    const auto add = [&](const char* name, Kind kind, std::string unit, DescriptionBuilder::Presence is_there) {
      Field field = detail::plain_field(path + "." + name, kind, std::move(unit));
      if (is_whole_array) field = detail::array_of(std::move(field), before->count);
      added.push_back(detail::finished(std::move(field), is_there));
    };
    const std::string unit = what.unit.value_or(before->unit);
    if (detail::changes_value(what)) {
      auto& field = const_cast<Field&>(*detail::field_at(fields, path));
      if (path.find('[') != std::string::npos && unit != before->unit)
        finder.add("unit", "the elements of an array have one unit", "name the whole array");
      field.unit = unit;
      if (detail::is_integer_kind(field.kind)) {
        Field number = detail::plain_field(field.name, Kind::f64, unit);
        if (field.is_array) number = detail::array_of(std::move(number), field.count);
        field = detail::finished(std::move(number), presence);
      }
      add("raw", before->kind, before->unit, presence);
    }
    if (detail::has_rate(what)) add("rate", Kind::f64, unit + "/s", DescriptionBuilder::Presence::optional);
  }
  if (!mistakes.empty()) throw ProcessingError(sensor, std::move(mistakes));
  if (added.empty()) return description;
  for (Field& field : added) fields.push_back(std::move(field));
  const auto layout = lay_out_again(fields, description->name()).or_throw();
  if (layout.size > most_bytes) {
    throw ProcessingError(sensor,
                          {{processing.begin()->first, "",
                            "with the raw values and rates, the payload has " + std::to_string(layout.size) + " bytes",
                            "a payload has at most 4 KiB: process fewer fields"}});
  }
  return Description::make(description->name(), std::move(fields), layout.size, layout.alignment).or_throw();
}

}  // namespace rtdata
