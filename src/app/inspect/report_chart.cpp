#include "app/inspect/report_chart.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <optional>
#include <set>

#include "app/inspect/curve_scale.hpp"
#include "app/inspect/html.hpp"

namespace rtdata::app {
namespace {

// The sizes of a picture, in its own units. The curve has a separate viewport: a column is 1 wide, and 1000 high.
constexpr double left = 76, width = 640, top = 4, height = 84;
constexpr int inner = 1000, edge = 30;

/// "12.5", with a tenth at most.
std::string tenths(double value) {
  std::array<char, 40> text{};
  std::snprintf(text.data(), text.size(), "%.1f", value);
  std::string made = text.data();
  if (made.ends_with(".0")) made.resize(made.size() - 2);
  return made;
}

/// The range of values between the lower and the upper edge of a picture.
struct Range {
  std::optional<Number> low, high;

  Range(const Scale& scale, const std::vector<double>& limits) : low(scale.least), high(scale.most) {
    if (!low || !std::holds_alternative<double>(*low)) return;
    // Limits far away would make the curve flat.
    const double least = std::get<double>(*low), most = std::get<double>(*high), room = most - least;
    for (const double limit : limits) {
      if (room > 0 && (limit < least - room || limit > most + room)) continue;
      low = std::min(std::get<double>(*low), limit);
      high = std::max(std::get<double>(*high), limit);
    }
  }

  int y_of(double share) const { return inner - edge - static_cast<int>(std::lround(share * (inner - 2 * edge))); }
  int y_of(const Number& number) const {
    if (!is_finite(number)) return y_of(std::get<double>(number) > 0 ? 1.0 : 0.0);
    return y_of(fraction(number, *low, *high));
  }
  /// None: it is not in the picture.
  std::optional<int> y_of_limit(double limit) const {
    if (!low || *low == *high) return std::nullopt;
    const double least = as_double(*low), most = as_double(*high);
    if (limit < least || limit > most) return std::nullopt;
    return y_of((limit - least) / (most - least));
  }
};

/// A line through points, from the one before.
class Path {
 public:
  void move(std::int64_t x, int y) {
    path_ += "M" + std::to_string(x) + " " + std::to_string(y);
    x_ = x;
    y_ = y;
  }
  void line(std::int64_t x, int y) {
    path_ += "l" + std::to_string(x - x_) + (y < y_ ? "" : " ") + std::to_string(y - y_);
    x_ = x;
    y_ = y;
  }
  void close() { path_ += "z"; }
  std::string take() { return std::move(path_); }

 private:
  std::string path_;
  std::int64_t x_ = 0;
  int y_ = 0;
};

/// How much of a curve is missing, by reason.
struct Missing {
  std::uint64_t gaps = 0, lost = 0;
};

std::string missing_text(const std::string& reason, const Missing& of) {
  return reason + (of.lost != 0 ? ", " + std::to_string(of.lost) + " lost" : "") + " in " + std::to_string(of.gaps) +
         (of.gaps == 1 ? " gap" : " gaps");
}

std::vector<double> values_of(const std::vector<TimedLimits>& limits) {
  std::vector<double> values;
  for (const auto& [one, from, until] : limits)
    for (const std::optional<double>& limit : {one.low_low, one.low, one.high, one.high_high})
      if (limit) values.push_back(*limit);
  return values;
}

}  // namespace

const char* ReportCharts::style() {
  // Elements that a picture reuses from the first one match no selector with an element outside.
  return "svg{display:block;width:100%;height:auto;font:9px sans-serif}"
         "svg svg{overflow:hidden}"
         "path{fill:none;vector-effect:non-scaling-stroke;stroke-linejoin:round;stroke-linecap:round}"
         ".all{fill:#9cc3e6;stroke:#9cc3e6;stroke-width:1}"
         ".mean{stroke:#0b4f8a;stroke-width:1.1}"
         ".gap rect{fill:#d9534f;fill-opacity:.28}"
         "rect.warn{fill:#f0ad4e;fill-opacity:.16}path.warn{stroke:#c77c11;stroke-width:.8;stroke-dasharray:4 3}"
         "rect.crit{fill:#d9534f;fill-opacity:.16}path.crit{stroke:#b52b27;stroke-width:.8;stroke-dasharray:4 3}"
         ".frame{stroke:#999;stroke-width:.8}.grid{stroke:#ddd;stroke-width:.6}"
         "text{fill:#444}.y{text-anchor:end}.x{text-anchor:middle}"
         ".note,.command,.alarm,.state{stroke-width:.9;stroke-dasharray:2 2}"
         ".note{stroke:#2a7f3b}.command{stroke:#7a4fb5}.alarm{stroke:#c9302c}.state{stroke:#666}"
         ".n{font-size:7px;text-anchor:middle}";
}

ReportCharts::ReportCharts(const Plot& plot, const std::vector<ChartMark>& marks) : plot_(plot) {
  const std::int64_t span = (plot.until - plot.from).count();
  columns_ = static_cast<std::size_t>((span + plot.step.count() - 1) / plot.step.count());
  columns_ = std::max<std::size_t>(columns_, 1);
  std::string grid, texts;
  const Duration distance = distance_of_marks(Duration{static_cast<std::int64_t>(static_cast<double>(span) / 8)});
  const std::int64_t before = floor_of(to_nanoseconds(plot.from) - 1, distance.count());
  const bool has_marks = plot.from > Time::min() + distance && plot.until < Time::max() - distance;
  for (Time time{distance * (before + 1)}; has_marks && time < plot.until; time += distance) {
    const std::string x = tenths(x_of(time));
    grid += "M" + x + " " + tenths(top) + "v" + tenths(height + 3);
    texts += "<text class=\"x\" x=\"" + x + "\" y=\"" + tenths(top + height + 12) + "\">" +
             html_text(mark_text(time, distance, plot.from, plot.until)) + "</text>";
  }
  common_ = "<path class=\"grid\" d=\"" + grid + "\"/><path class=\"frame\" d=\"M" + tenths(left) + " " + tenths(top) +
            "v" + tenths(height) + "h" + tenths(width) + "\"/>" + texts;
  std::set<std::pair<std::size_t, std::string>> drawn;
  double last_number = 0;
  for (const ChartMark& mark : marks) {
    if (mark.at < plot.from || mark.at >= plot.until) continue;
    const double at = x_of(mark.at);
    const std::string x = tenths(at);
    if (drawn.emplace(column_of(mark.at), mark.kind).second)
      common_ += "<path class=\"" + std::string(mark.kind) + "\" d=\"M" + x + " " + tenths(top) + "v" + tenths(height) +
                 "\"/>";
    if (mark.number == 0 || at < last_number + 9) continue;  // one would hide the other
    common_ += "<text class=\"n\" x=\"" + tenths(std::min(at, left + width - 4)) + "\" y=\"" + tenths(top + 7) + "\">" +
               std::to_string(mark.number) + "</text>";
    last_number = at;
  }
}

std::size_t ReportCharts::column_of(Time time) const {
  const std::int64_t column = floor_of((time - plot_.from).count(), plot_.step.count());
  return static_cast<std::size_t>(std::clamp<std::int64_t>(column, 0, static_cast<std::int64_t>(columns_) - 1));
}

double ReportCharts::x_of(Time time) const {
  const double all = static_cast<double>(plot_.step.count()) * static_cast<double>(columns_);
  return left + width * static_cast<double>((time - plot_.from).count()) / all;
}

/// Neighbouring columns with the same reason are one shade.
std::string ReportCharts::gaps_of(const Curve& curve) {
  if (curve.gaps.empty()) return "";
  const auto [known, is_new] = gaps_.try_emplace({curve.topic, curve.origin}, gaps_.size());
  const std::string id = "gap" + std::to_string(known->second);
  if (!is_new) return "<use href=\"#" + id + "\"/>";
  struct Shade {
    const CurveGap* first = nullptr;
    Time last{};
    std::uint64_t gaps = 0, lost = 0;
  };
  std::vector<Shade> shades(columns_);
  for (const CurveGap& gap : curve.gaps) {
    const std::size_t first = column_of(gap.first), last = column_of(gap.last);
    for (std::size_t column = first; column <= last; ++column) {
      Shade& shade = shades[column];
      if (shade.first == nullptr) shade.first = &gap;
      shade.last = std::max(shade.last, gap.last);
    }
    ++shades[first].gaps;
    shades[first].lost += gap.lost;
  }
  std::string text = "<g class=\"gap\" id=\"" + id + "\">";
  for (std::size_t column = 0; column < columns_; ++column) {
    Shade shade = shades[column];
    if (shade.first == nullptr) continue;
    std::size_t end = column + 1;
    for (; end < columns_ && shades[end].first != nullptr && shades[end].first->reason == shade.first->reason; ++end) {
      shade.gaps += shades[end].gaps;
      shade.lost += shades[end].lost;
      shade.last = std::max(shade.last, shades[end].last);
    }
    const std::string from = instant_text(shade.first->first, plot_.from, plot_.step);
    const std::string until = instant_text(shade.last, plot_.from, plot_.step);
    text += "<rect x=\"" + std::to_string(column) + "\" width=\"" + std::to_string(end - column) + "\" height=\"" +
            std::to_string(inner) + "\"><title>" +
            html_text(from + (from == until ? "" : " to " + until) + " " +
                      missing_text(shade.first->reason, {std::max<std::uint64_t>(shade.gaps, 1), shade.lost})) +
            "</title></rect>";
    column = end - 1;
  }
  return text + "</g>";
}

/// Shades the areas beyond the limits, for as long as these held.
std::string ReportCharts::bands_of(const TimedLimits& limits,
                                   const std::function<std::optional<int>(double)>& y_of) const {
  const std::size_t first = column_of(limits.from);
  const std::size_t end = limits.until < plot_.until ? std::max(column_of(limits.until), first + 1) : columns_;
  const std::string x = std::to_string(first), wide = std::to_string(end - first);
  std::string text;
  const auto add = [&](const std::optional<double>& limit, bool is_high, const char* kind) {
    if (!limit) return;
    const auto y = y_of(*limit);
    if (!y) return;
    text += "<rect class=\"" + std::string(kind) + "\" x=\"" + x + "\" y=\"" + std::to_string(is_high ? 0 : *y) +
            "\" width=\"" + wide + "\" height=\"" + std::to_string(is_high ? *y : inner - *y) + "\"/><path class=\"" +
            kind + "\" d=\"M" + x + " " + std::to_string(*y) + "h" + wide + "\"/>";
  };
  add(limits.limits.low, false, "warn");
  add(limits.limits.high, true, "warn");
  add(limits.limits.low_low, false, "crit");
  add(limits.limits.high_high, true, "crit");
  return text;
}

std::string ReportCharts::chart_of(const Curve& curve, const std::vector<TimedLimits>& limits) {
  const Scale scale(curve);
  const Range range(scale, values_of(limits));
  std::vector<bool> is_gap(columns_ + 1);
  for (const CurveGap& gap : curve.gaps)
    std::fill(is_gap.begin() + static_cast<std::ptrdiff_t>(column_of(gap.first)),
              is_gap.begin() + static_cast<std::ptrdiff_t>(column_of(gap.last)) + 1, true);
  Path all, mean;
  std::vector<const CurveStep*> part;  // neighbours with nothing missing between them
  const auto draw = [&] {
    if (part.empty()) return;
    const auto x_of_step = [&](const CurveStep& step) { return static_cast<std::int64_t>(column_of(step.begin)); };
    const bool is_line = std::all_of(part.begin(), part.end(), [](auto* step) { return step->least == step->most; });
    for (std::size_t i = 0; i < part.size() && !is_line; ++i)
      i == 0 ? all.move(x_of_step(*part[i]), range.y_of(part[i]->most))
             : all.line(x_of_step(*part[i]), range.y_of(part[i]->most));
    for (std::size_t i = part.size(); i > 0 && !is_line; --i)
      all.line(x_of_step(*part[i - 1]), range.y_of(part[i - 1]->least));
    if (!is_line) all.close();
    for (std::size_t i = 0; i < part.size(); ++i) {
      const CurveStep& step = *part[i];
      // If there is no finite mean, draws the middle between least and most.
      const bool has_mean = std::isfinite(step.mean) && scale.least && *range.low != *range.high;
      const double low = scale.least ? as_double(*range.low) : 0, high = scale.least ? as_double(*range.high) : 0;
      const int y = step.least == step.most ? range.y_of(step.least)
                    : has_mean && std::isfinite(high - low)
                        ? range.y_of(std::clamp((step.mean - low) / (high - low), 0.0, 1.0))
                        : (range.y_of(step.least) + range.y_of(step.most)) / 2;
      i == 0 ? mean.move(x_of_step(step), y) : mean.line(x_of_step(step), y);
    }
    if (part.size() == 1) mean.line(x_of_step(*part[0]), range.y_of(part[0]->most));  // a dot, or a stroke
    part.clear();
  };
  for (const CurveStep& step : curve.steps) {
    if (step.numbers == 0) continue;
    if (!part.empty()) {
      const auto from = is_gap.begin() + static_cast<std::ptrdiff_t>(column_of(part.back()->begin)) + 1;
      const auto until = is_gap.begin() + static_cast<std::ptrdiff_t>(column_of(step.begin));
      if (from < until && std::find(from, until, true) != until) draw();
    }
    part.push_back(&step);
  }
  draw();

  std::string labels;
  const auto label = [&](const Number& number, const std::string& text) {
    const double y = top + height * range.y_of(number) / inner + 3;
    labels += "<text class=\"y\" x=\"" + tenths(left - 4) + "\" y=\"" + tenths(y) + "\">" + html_text(text, 14) +
              "</text>";
  };
  if (range.low && *range.low == *range.high) {
    label(*range.low, exact_text(*range.low, curve.kind));
  } else if (range.low) {
    label(*range.low, scale.text(*range.low));
    label(*range.high, scale.text(*range.high));
  }
  std::string bands;
  for (const TimedLimits& one : limits) bands += bands_of(one, [&](double limit) { return range.y_of_limit(limit); });
  std::string text = "<svg viewBox=\"0 0 720 104\" role=\"img\" aria-label=\"" + html_text(curve.name) + "\">";
  text += is_first_ ? "<g id=\"axis\">" + common_ + "</g>" : "<use href=\"#axis\"/>";
  is_first_ = false;
  text += labels + "<svg x=\"" + tenths(left) + "\" y=\"" + tenths(top) + "\" width=\"" + tenths(width) +
          "\" height=\"" + tenths(height) + "\" viewBox=\"0 0 " + std::to_string(columns_) + " " +
          std::to_string(inner) + "\" preserveAspectRatio=\"none\">" + bands + gaps_of(curve);
  const std::string filled = all.take(), line = mean.take();
  if (!filled.empty()) text += "<path class=\"all\" d=\"" + filled + "\"/>";
  if (!line.empty()) text += "<path class=\"mean\" d=\"" + line + "\"/>";
  return text + "</svg></svg>";
}

std::string gaps_text(const Curve& curve) {
  constexpr std::size_t most = 4;
  std::map<std::string, Missing> by_reason;
  std::vector<std::string> order;
  for (const CurveGap& gap : curve.gaps) {
    const auto [known, is_new] = by_reason.try_emplace(gap.reason);
    if (is_new) order.push_back(gap.reason);
    ++known->second.gaps;
    known->second.lost += gap.lost;
  }
  std::string text;
  for (std::size_t i = 0; i < order.size() && i < most; ++i)
    text += (i == 0 ? "" : "; ") + missing_text(order[i], by_reason[order[i]]);
  if (order.size() > most) text += "; " + std::to_string(order.size() - most) + " more reasons";
  return text;
}

}  // namespace rtdata::app
