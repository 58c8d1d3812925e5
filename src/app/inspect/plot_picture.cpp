#include "app/inspect/plot_picture.hpp"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <map>
#include <optional>
#include <set>
#include <string_view>

#include "app/control/terminal.hpp"
#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/curve_scale.hpp"

namespace rtdata::app {
namespace {

using Lines = std::vector<std::string>;

std::string_view variable(const char* name) {
  const char* const value = std::getenv(name);
  return value == nullptr ? std::string_view() : value;
}

/// True if programs should write UTF-8: the first of these variables that is set decides.
bool is_utf8_locale() {
  for (const char* const name : {"LC_ALL", "LC_CTYPE", "LANG"}) {
    const std::string_view value = variable(name);
    if (value.empty()) continue;
    for (const std::string_view utf8 : {"UTF-8", "utf-8", "UTF8", "utf8"})
      if (value.find(utf8) != std::string_view::npos) return true;
    return false;
  }
  return false;
}

constexpr std::size_t widest_label = 12;  // of the values left of the axis, with a blank
constexpr std::size_t least_rows = 2;     // of a panel

bool is_braille(const PlotStyle& style) { return style.characters == PlotStyle::Characters::braille; }

/// How the columns of the terminal are used: labels, the axis, the curve.
struct Across {
  explicit Across(const PlotStyle& style)
      : labels(std::min(widest_label, style.columns / 4)),
        cells(std::max<std::size_t>(style.columns, labels + 2) - labels - 1),
        dots(cells * (is_braille(style) ? 2 : 1)) {}
  std::size_t labels, cells, dots;
};

/// "20.1 to 21.3, mean 20.7"
std::string range_text(const Curve& curve, const Scale& scale) {
  if (scale.numbers == 0) return "no values";
  if (scale.is_constant()) return "always " + exact_text(*scale.least, curve.kind);
  const RangeTexts of = range_texts(curve, scale);
  return of.least + " to " + of.most + (of.mean.empty() ? "" : ", mean " + of.mean);
}

// ---- columns

/// Which step of the plot, 0 to dots - 1.
std::size_t column_of(Time time, const Plot& plot, std::size_t dots) {
  const std::int64_t step = plot.step.count();
  const std::int64_t first = floor_of(to_nanoseconds(plot.from), step);
  const std::int64_t column = floor_of(to_nanoseconds(time), step) - first;
  return static_cast<std::size_t>(std::clamp<std::int64_t>(column, 0, static_cast<std::int64_t>(dots) - 1));
}

// ---- drawing

/// Dots, of which each character holds some: 2 x 4 in braille, 1 x 3 in ASCII. 0, 0 is below on the left.
class Canvas {
 public:
  Canvas(std::size_t columns, std::size_t rows, bool is_of_braille)
      : is_braille_(is_of_braille),
        width_(columns * (is_of_braille ? 2 : 1)),
        height_(rows * (is_of_braille ? 4 : 3)),
        dots_(width_ * height_) {}

  std::size_t height() const { return height_; }

  void column(std::size_t x, std::size_t from, std::size_t to) {
    for (std::size_t y = std::min(from, to); y <= std::max(from, to); ++y) dots_[y * width_ + x] = true;
  }

  /// Whose dots touch each other.
  void line(std::size_t x, std::size_t y, std::size_t to_x, std::size_t to_y) {
    const double slope = (static_cast<double>(to_y) - static_cast<double>(y)) / static_cast<double>(to_x - x);
    std::size_t before = y;
    for (std::size_t at = x; at <= to_x; ++at) {
      const auto now = static_cast<std::size_t>(
          std::lround(static_cast<double>(y) + slope * static_cast<double>(at - x)));
      column(at, now > before ? before + 1 : now < before ? before - 1 : now, now);
      before = now;
    }
  }

  /// From the top; without blanks at its end.
  std::string row(std::size_t row) const {
    std::string text;
    std::size_t filled = 0;
    for (std::size_t x = 0; x < width_; x += is_braille_ ? 2 : 1) {
      const std::string cell = is_braille_ ? braille(x, row) : ascii(x, row);
      text += cell;
      if (cell != " ") filled = text.size();
    }
    text.resize(filled);
    return text;
  }

 private:
  bool dot(std::size_t x, std::size_t from_top) const { return dots_[(height_ - 1 - from_top) * width_ + x]; }

  std::string braille(std::size_t x, std::size_t row) const {
    constexpr unsigned bits[2][4] = {{0x01, 0x02, 0x04, 0x40}, {0x08, 0x10, 0x20, 0x80}};
    unsigned pattern = 0;
    for (std::size_t i = 0; i < 2; ++i)
      for (std::size_t j = 0; j < 4; ++j)
        if (dot(x + i, row * 4 + j)) pattern |= bits[i][j];
    if (pattern == 0) return " ";
    return {'\xe2', static_cast<char>(0xa0 | pattern >> 6), static_cast<char>(0x80 | (pattern & 0x3f))};  // U+28xx
  }

  std::string ascii(std::size_t x, std::size_t row) const {
    // Index by the set dots: upper 4, middle 2, lower 1.
    constexpr std::string_view shapes = " .-:'::|";
    const unsigned pattern = (dot(x, row * 3) ? 4U : 0U) | (dot(x, row * 3 + 1) ? 2U : 0U) |
                             (dot(x, row * 3 + 2) ? 1U : 0U);
    return std::string(1, shapes[pattern]);
  }

  const bool is_braille_;
  const std::size_t width_, height_;
  std::vector<bool> dots_;
};

// ---- missing data

constexpr const char* no_number = "no number: absent, or NaN";
constexpr const char* infinite = "infinite";
constexpr char several = '*';

/// One mark for two.
char both(char a, char b) { return a == ' ' || a == b ? b : b == ' ' ? a : several; }

/// The reasons of all curves: each has a letter, and is shown once.
class Reasons {
 public:
  explicit Reasons(const Plot& plot) : plot_(plot) {}

  /// The marks of a curve, one per step; a blank where nothing is missing.
  std::string marks_of(const Curve& curve, std::size_t dots) {
    std::string marks(dots, ' ');
    // Curves of one source have the same gaps.
    const bool is_counted = sources_.insert(curve.topic + " " + curve.origin).second;
    for (const CurveGap& gap : curve.gaps) mark(marks, {gap.first, gap.last, gap.lost, gap.reason}, is_counted);
    for (const CurveStep& step : curve.steps) {
      if (step.numbers < step.events)
        mark(marks, {step.begin, step.begin, step.events - step.numbers, no_number}, true);
      if (step.numbers != 0 && (!is_finite(step.least) || !is_finite(step.most)))
        mark(marks, {step.begin, step.begin, 0, infinite}, true);
    }
    return marks;
  }

  /// "a  12:03:04.100 to 12:03:06.200 missed: loop held, 12 lost", in the order of the letters.
  Lines lines() const {
    Lines lines;
    for (const Reason& reason : reasons_) {
      std::string line(1, reason.letter);
      const std::string first = instant_text(reason.first.first, plot_.from, plot_.step);
      const std::string last = instant_text(reason.first.last, plot_.from, plot_.step);
      line += "  " + first + (last == first ? "" : " to " + last) + " " + printable(reason.first.reason);
      const bool is_gap = reason.first.reason != no_number && reason.first.reason != infinite;
      if (reason.lost != 0)
        line += ", " + std::to_string(reason.lost) + (is_gap ? " lost" : reason.lost == 1 ? " event" : " events");
      if (reason.count > 1) line += ", the first of " + std::to_string(reason.count) + (is_gap ? " gaps" : " steps");
      lines.push_back(std::move(line));
    }
    if (more_ != 0)
      lines.push_back(std::string(1, last_letter) + "  " + std::to_string(more_) + " gaps for other reasons");
    return lines;
  }

 private:
  static constexpr char last_letter = 'z';
  struct Reason {
    char letter;
    CurveGap first;
    std::uint64_t count = 0, lost = 0;
  };

  void mark(std::string& marks, const CurveGap& gap, bool is_counted) {
    const char letter = letter_of(gap, is_counted);
    const std::size_t last = column_of(gap.last, plot_, marks.size());
    for (std::size_t x = column_of(gap.first, plot_, marks.size()); x <= last; ++x) marks[x] = both(marks[x], letter);
  }

  char letter_of(const CurveGap& gap, bool is_counted) {
    const auto [known, is_new] = places_.try_emplace(gap.reason, reasons_.size());
    if (is_new) {
      if (reasons_.size() + 'a' >= last_letter) {
        known->second = none;
      } else {
        reasons_.push_back({static_cast<char>('a' + reasons_.size()), gap, 0, 0});
      }
    }
    if (known->second == none) {
      more_ += is_counted ? 1 : 0;
      return last_letter;
    }
    Reason& reason = reasons_[known->second];
    if (is_counted) {
      ++reason.count;
      reason.lost += gap.lost;
      if (gap.first < reason.first.first) reason.first = gap;
    }
    return reason.letter;
  }

  static constexpr std::size_t none = static_cast<std::size_t>(-1);
  const Plot& plot_;
  std::vector<Reason> reasons_;
  std::map<std::string, std::size_t> places_;
  std::set<std::string> sources_;
  std::size_t more_ = 0;
};

// ---- panels

/// The text in a colour, if the terminal has colours.
std::string coloured(const std::string& text, const char* code, const PlotStyle& style) {
  if (style.colours == PlotStyle::Colours::none || text.empty()) return text;
  return "\x1b[" + std::string(code) + "m" + text + "\x1b[0m";
}
constexpr const char* red = "31";
constexpr const char* green = "32";
constexpr const char* cyan = "36";

void add_wrapped(Lines& lines, const std::string& text, std::size_t columns) {
  std::string rest = wrapped(text, columns);
  while (!rest.empty()) {
    const std::size_t end = std::min(rest.find('\n'), rest.size());
    lines.push_back(rest.substr(0, end));
    rest.erase(0, end + 1);
  }
}

/// Name, unit and range, and the verdict on the right.
Lines title_of(const Curve& curve, const Scale& scale, const PlotStyle& style) {
  const std::string text = printable(curve.name + (curve.unit.empty() ? "" : " [" + curve.unit + "]")) + "  " +
                           range_text(curve, scale);
  const std::string verdict = coloured(curve.verdict, curve.has_loss ? red : green, style);
  const std::size_t used = width_of(text) + width_of(curve.verdict);
  if (used + 2 <= style.columns) return {text + std::string(style.columns - used, ' ') + verdict};
  Lines lines;
  add_wrapped(lines, text, style.columns);
  lines.push_back("  " + verdict);
  return lines;
}

Canvas drawn(const Curve& curve, const Scale& scale, const Plot& plot, const std::string& marks, std::size_t rows,
             const PlotStyle& style) {
  Canvas canvas(Across(style).cells, rows, is_braille(style));
  const auto top = static_cast<double>(canvas.height() - 1);
  const auto height_of = [&](const Number& number) {
    const bool is_there = is_finite(number);
    const double at = is_there ? fraction(number, *scale.least, *scale.most) : std::get<double>(number) > 0 ? 1 : 0;
    return static_cast<std::size_t>(std::lround(at * top));
  };
  struct Column {
    std::size_t x, low, high;
  };
  std::optional<Column> before;
  for (const CurveStep& step : curve.steps) {
    if (step.numbers == 0) continue;
    const Column now{column_of(step.begin, plot, marks.size()), height_of(step.least), height_of(step.most)};
    canvas.column(now.x, now.low, now.high);
    const bool is_joined = before && before->x < now.x && marks.find_first_not_of(' ', before->x + 1) >= now.x;
    if (is_joined && before->high < now.low) {
      canvas.line(before->x, before->high, now.x, now.low);
    } else if (is_joined && before->low > now.high) {
      canvas.line(before->x, before->low, now.x, now.high);
    } else if (is_joined) {
      const std::size_t shared = (std::max(before->low, now.low) + std::min(before->high, now.high)) / 2;
      canvas.line(before->x, shared, now.x, shared);
    }
    before = now;
  }
  return canvas;
}

/// The text left of each row of a panel; empty if there is none, or no room: the title has the range.
Lines labels_of(const Curve& curve, const Scale& scale, std::size_t rows, std::size_t room) {
  Lines labels(rows);
  if (!scale.least) return labels;
  const bool is_one = *scale.least == *scale.most;
  const auto put = [&](std::size_t row, const Number& number) {
    const std::string text = is_one ? exact_text(number, curve.kind) : scale.text(number);
    if (text.size() < room) labels[row] = text;
  };
  constexpr std::size_t rows_for_three = 7;
  if (is_one || rows >= rows_for_three) put((rows - 1) / 2, middle(*scale.least, *scale.most));
  if (is_one) return labels;
  put(0, *scale.most);
  put(rows - 1, *scale.least);
  return labels;
}

/// The time axis, and the texts of its marks.
Lines axis_of(const Plot& plot, const PlotStyle& style) {
  const Across across(style);
  const bool is_drawn = is_braille(style);
  const std::size_t dots_a_cell = across.dots / across.cells;
  const auto text_of = [&](Time time, Duration distance) { return mark_text(time, distance, plot.from, plot.until); };
  Duration distance{0};
  for (const std::size_t width : {5, 8, 10, 12, 15, 18}) {
    distance = distance_of_marks(plot.step * static_cast<std::int64_t>(dots_a_cell * (width + 2)));
    if (text_of(plot.until - Duration{1}, distance).size() <= width) break;
  }
  std::vector<bool> is_mark(across.cells);
  std::string names;
  const bool has_marks = plot.from > Time::min() + distance && plot.until < Time::max() - distance;
  const std::int64_t before = floor_of(to_nanoseconds(plot.from) - 1, distance.count());
  for (Time time{distance * (before + 1)}; has_marks && time < plot.until; time += distance) {
    const std::size_t cell = column_of(time, plot, across.dots) / dots_a_cell;
    is_mark[cell] = true;
    const std::string text = text_of(time, distance);
    if (cell + text.size() > across.cells || (!names.empty() && names.size() + 1 > cell)) continue;
    names.append(cell - names.size(), ' ');
    names += text;
  }
  const std::string blanks(across.labels, ' ');
  std::string axis = blanks + (is_drawn ? "└" : "+");
  for (const bool mark : is_mark) axis += is_drawn ? (mark ? "┬" : "─") : (mark ? "+" : "-");
  return {axis, blanks + " " + names};
}

}  // namespace

Duration step_for(Time from, Time until, const PlotStyle& style) {
  const auto dots = static_cast<std::int64_t>(Across(style).dots);
  const std::int64_t span = std::max<std::int64_t>((until - from).count(), 1);
  return two_digits(Duration{span / std::max<std::int64_t>(dots - 1, 1) + 1});
}

Lines picture_of(const Plot& plot, const PlotStyle& style) {
  const Across across(style);
  const std::size_t dots_a_cell = across.dots / across.cells;
  struct Panel {
    const Curve& curve;
    Scale scale;
    Lines title;
    std::string marks;  // one per step
    std::string cells;  // one per character; empty: nothing is missing
  };
  std::vector<Panel> panels;
  Reasons reasons(plot);
  bool has_several = false;
  for (const Curve& curve : plot.curves) {
    const Scale scale(curve);
    Panel panel{curve, scale, title_of(curve, scale, style), reasons.marks_of(curve, across.dots), ""};
    for (std::size_t x = 0; x < across.dots; x += dots_a_cell)
      panel.cells += both(panel.marks[x], panel.marks[x + dots_a_cell - 1]);
    panel.cells.erase(panel.cells.find_last_not_of(' ') + 1);
    has_several = has_several || panel.cells.find(several) != std::string::npos;
    panels.push_back(std::move(panel));
  }

  Lines lines, below;
  add_wrapped(lines,
              printable(plot.title) + ": " + date_text(plot.from) + " " + clock_text(plot.from, plot.step) + " to " +
                  instant_text(plot.until, plot.from, plot.step) + " UTC, " + to_string(plot.step) +
                  (is_braille(style) ? " a dot" : " a column"),
              style.columns);
  for (const std::string& line : reasons.lines()) add_wrapped(below, line, style.columns);
  if (has_several) below.push_back(std::string(1, several) + "  several of these");
  for (const std::string& note : plot.notes) add_wrapped(below, printable(note), style.columns);

  std::size_t fixed = lines.size() + below.size() + 3;  // the axis, and the line where the terminal continues
  for (const Panel& panel : panels) fixed += panel.title.size() + (panel.cells.empty() ? 0 : 1);
  const std::size_t rows = std::max(
      least_rows, (style.rows - std::min(style.rows, fixed)) / std::max<std::size_t>(panels.size(), 1));
  const std::string beside(across.labels + 1, ' ');
  for (const Panel& panel : panels) {
    lines.insert(lines.end(), panel.title.begin(), panel.title.end());
    const Canvas canvas = drawn(panel.curve, panel.scale, plot, panel.marks, rows, style);
    const Lines labels = labels_of(panel.curve, panel.scale, rows, across.labels);
    for (std::size_t row = 0; row < rows; ++row) {
      const std::string& label = labels[row];
      std::string line(across.labels - label.size() - (label.empty() ? 0 : 1), ' ');
      line += label + (label.empty() ? "" : " ");
      line += is_braille(style) ? (label.empty() ? "│" : "┤") : (label.empty() ? "|" : "+");
      lines.push_back(line + coloured(canvas.row(row), cyan, style));
    }
    if (!panel.cells.empty()) lines.push_back(beside + coloured(panel.cells, red, style));
  }
  for (const std::string& line : axis_of(plot, style)) lines.push_back(line);
  lines.insert(lines.end(), below.begin(), below.end());
  return lines;
}

PlotStyle terminal_style() {
  PlotStyle style;
  style.characters = is_utf8_locale() ? PlotStyle::Characters::braille : PlotStyle::Characters::ascii;
  const std::size_t columns = columns_of(STDOUT_FILENO);
  if (columns == 0) return style;
  style.columns = columns;
  style.rows = terminal_size().rows;
  if (variable("NO_COLOR").empty() && variable("TERM") != "dumb") style.colours = PlotStyle::Colours::some;
  return style;
}

}  // namespace rtdata::app
