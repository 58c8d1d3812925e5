// What `rtdata plot` draws: steps in, lines of text out.
#include "app/inspect/plot_picture.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <functional>
#include <limits>

#include "app/core/table.hpp"
#include "app/inspect/curve_scale.hpp"

using namespace rtdata;
using namespace rtdata::app;
using namespace std::chrono_literals;

namespace {

const Time noon = parse_iso8601("2026-03-01T12:00:00Z").or_throw();
constexpr PlotStyle small{.columns = 40, .rows = 12};
constexpr PlotStyle ascii{.columns = 40, .rows = 12, .characters = PlotStyle::Characters::ascii};

/// 10 s from noon on.
Plot plot_in(const PlotStyle& style) {
  Plot plot;
  plot.title = "bench.db, run 1";
  plot.from = noon;
  plot.until = noon + 10s;
  plot.step = step_for(plot.from, plot.until, style);
  return plot;
}

CurveStep step_at(const Plot& plot, Duration at, Number least, Number most) {
  const Time begin = noon + at - (noon + at).time_since_epoch() % plot.step;
  const double mean = std::visit([](auto held) { return static_cast<double>(held); }, least) / 2 +
                      std::visit([](auto held) { return static_cast<double>(held); }, most) / 2;
  return {begin, 1, 1, least, most, mean};
}

Curve named(const std::string& name) {
  Curve curve;
  curve.name = name;
  curve.topic = name;
  curve.verdict = "all there";
  return curve;
}

/// A value every so often, from the beginning to the end.
Curve curve_of(const Plot& plot, Duration every, const std::function<Number(double)>& value_at) {
  Curve curve = named("value");
  for (Duration at{0}; noon + at < plot.until; at += every) {
    const Number value = value_at(std::chrono::duration<double>(at).count());
    CurveStep step = step_at(plot, at, value, value);
    if (curve.steps.empty() || curve.steps.back().begin != step.begin) curve.steps.push_back(step);
  }
  return curve;
}

std::string shown(const Plot& plot, const PlotStyle& style) {
  std::string text;
  for (const std::string& line : picture_of(plot, style)) text += line + "\n";
  return text;
}

std::string shown(Plot plot, const Curve& curve, const PlotStyle& style) {
  plot.curves = {curve};
  return "\n" + shown(plot, style);
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("FW-5 plot: a curve with its range, labels, axis and time") {
    const Plot plot = plot_in(small);
    Curve wave = curve_of(plot, 10ms, [](double at) { return 20 + 2 * std::sin(at); });
    wave.name = "room/climate.temperature";
    wave.unit = "Cel";
    CHECK(shown(plot, wave, small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
room/climate.temperature [Cel]  18 to
  22, mean 20.37
  all there
       22 ┤  ⡠⠊⠉⠑⠢⡀           ⢠⠔⠉⠉⠒⢄
          │⡠⠊     ⠈⢆        ⢀⠔⠁     ⠱⡀
          │         ⠱⡀     ⡠⠊        ⠈⢆
       18 ┤          ⠈⠢⢄⣀⡠⠊
          └┬────────────┬───────────────
           12:00:00     12:00:05
)");
    const Plot coarse = plot_in(ascii);
    wave.steps = curve_of(coarse, 10ms, [](double at) { return 20 + 2 * std::sin(at); }).steps;
    CHECK(shown(coarse, wave, ascii) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 360 ms a column
room/climate.temperature [Cel]  18 to
  22, mean 20.37
  all there
       22 +  .-''-.            :''':
          |.-'     :.        :'     ':
          |         ':     .:         :
       18 +           :...-'
          ++------------+---------------
           12:00:00     12:00:05
)");
  }

  TEST_CASE("FW-5 plot: all from the least to the most of a step is filled, and neighbours touch") {
    const Plot plot = plot_in(ascii);
    Curve curve = named("pulse");
    for (int i = 0; i < 10; ++i) {
      const double most = i == 4 ? 9 : 1;
      curve.steps.push_back(step_at(plot, 1s * i, 0.0, most));
    }
    CHECK(shown(plot, curve, ascii) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 360 ms a column
pulse  0 to 9, mean 0.9        all there
        9 +           |
          |           |
          |           |
          |           |
          |           |
        0 +|-|--|--|--|-|--|--|--|--|
          ++------------+---------------
           12:00:00     12:00:05
)");
  }

  TEST_CASE("FW-5 plot: what is not there is empty, with a letter below and the reason") {
    const Plot plot = plot_in(small);
    Curve curve = curve_of(plot, 10ms, [](double at) { return at; });
    curve.verdict = "202 lost";
    curve.has_loss = true;
    std::erase_if(curve.steps, [](const CurveStep& step) { return step.begin > noon + 4s && step.begin < noon + 6s; });
    curve.gaps = {{noon + 4s, noon + 6s, 200, "missed: loop held"},
                  {noon + 8s, noon + 8s, 1, "failed: io-failed"},
                  {noon + 9s, noon + 9s, 1, "failed: io-failed"}};
    CHECK(shown(plot, curve, small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  0 to 9.9, mean 4.93      202 lost
      9.9 ┤                 ⣀⠤⠤⠤⠤⠒⠒⠒⠒⠉⠉
        0 ┤⣀⣀⠤⠤⠤⠤⠒⠒⠒⠒⠉⠁
                      aaaaaa     b  b
          └┬────────────┬───────────────
           12:00:00     12:00:05
a  12:00:04.000 to 12:00:06.000 missed:
   loop held, 200 lost
b  12:00:08.000 failed: io-failed, 2
   lost, the first of 2 gaps
)");
    // Of what comes rarely, two values are joined unless something between them is lost.
    curve = curve_of(plot, 1s, [](double at) { return std::int64_t(at) % 2; });
    curve.gaps = {{noon + 4500ms, noon + 4500ms, 0, "silent"}};
    CHECK(shown(plot, curve, small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  0 to 1, mean 0.5        all there
        1 ┤  ⡸⢆   ⢀⠷⡀   ⠈⢆   ⢀⠷⡀   ⢠⠃
          │ ⢠⠃⠘⡄  ⡜ ⢣    ⠘⡄  ⡜ ⢣  ⢀⠎
          │ ⡎  ⠸⡀⢰⠁  ⢇    ⠸⡀⢰⠁  ⢇ ⡜
        0 ┤⡸    ⢱⠇   ⠈⡆    ⢱⠇   ⠈⡾
                       a
          └┬────────────┬───────────────
           12:00:00     12:00:05
a  12:00:04.500 silent
)");
  }

  TEST_CASE("FW-5 plot: two reasons at one place, and a gap that began the day before") {
    const Plot plot = plot_in(small);
    Curve curve = curve_of(plot, 10ms, [](double at) { return at; });
    std::erase_if(curve.steps, [](const CurveStep& step) { return step.begin < noon + 5s; });
    curve.gaps = {{noon - 24h, noon + 4s, 0, "disconnected"}, {noon + 3s, noon + 5s, 2, "not stored"}};
    CHECK(shown(plot, curve, small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  5.04 to 9.9, mean 7.47  all there
      9.9 ┤                     ⣀⣀⠤⠤⠒⠒⠉
     5.04 ┤              ⣀⠤⠤⠒⠒⠉⠉
           aaaaaaaa****bb
          └┬────────────┬───────────────
           12:00:00     12:00:05
a  2026-02-28 12:00:00.000 to
   12:00:04.000 disconnected
b  12:00:03.000 to 12:00:05.000 not
   stored, 2 lost
*  several of these
)");
  }

  TEST_CASE("FW-5 plot: NaN and absent values break the curve, and are counted") {
    const Plot plot = plot_in(small);
    Curve curve = curve_of(plot, 10ms, [](double at) { return at; });
    for (CurveStep& step : curve.steps) {
      step.events = 3;
      step.numbers = step.begin >= noon + 2s && step.begin < noon + 3s ? 0 : 3;
    }
    curve.steps.back().numbers = 2;
    CHECK(shown(plot, curve, small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  0 to 9.9, mean 5.16     all there
      9.9 ┤                   ⣀⣀⡠⠤⠤⠒⠒⠊⠉
          │         ⣀⣀⡠⠤⠤⠒⠒⠊⠉⠉
        0 ┤⣀⡠⠤⠤⠒⠒  ⠈
                 aaa                  a
          └┬────────────┬───────────────
           12:00:00     12:00:05
a  12:00:02.160 no number: absent, or
   NaN, 16 events, the first of 6 steps
)");
    for (CurveStep& step : curve.steps) step.numbers = 0;
    CHECK(shown(plot, curve, small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  no values               all there
          │
          │
           aaaaaaaaaaaaaaaaaaaaaaaaaaaa
          └┬────────────┬───────────────
           12:00:00     12:00:05
a  12:00:00.000 no number: absent, or
   NaN, 168 events, the first of 56
   steps
)");
  }

  TEST_CASE("FW-5 plot: infinite values are at the edge, and do not stretch the scale") {
    const Plot plot = plot_in(small);
    constexpr double infinite = std::numeric_limits<double>::infinity();
    Curve curve = curve_of(plot, 10ms, [](double at) { return at >= 2 && at < 3 ? infinite : at; });
    curve.steps.back().least = -infinite;
    CHECK(shown(plot, curve, small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  -inf to inf             all there
      9.9 ┤      ⡏⠉⢱          ⣀⣀⡠⠤⠤⠒⠒⠊⢹
          │      ⡇ ⢸⣀⣀⡠⠤⠤⠒⠒⠊⠉⠉        ⢸
        0 ┤⣀⡠⠤⠤⠒⠒⠁ ⠈                  ⢸
                 aaa                  a
          └┬────────────┬───────────────
           12:00:00     12:00:05
a  12:00:02.160 infinite, the first of 6
   steps
)");
    curve = curve_of(plot, 10ms, [](double at) { return at < 5 ? -infinite : infinite; });
    CHECK(shown(plot, curve, small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  -inf to inf             all there
          │              ⡏⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉
          │              ⡇
          │⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⠇
           aaaaaaaaaaaaaaaaaaaaaaaaaaaa
          └┬────────────┬───────────────
           12:00:00     12:00:05
a  12:00:00.000 infinite, the first of
   56 steps
)");
  }

  TEST_CASE("FW-5 plot: constant values, one value, none") {
    const Plot plot = plot_in(small);
    Curve curve = curve_of(plot, 10ms, [](double) { return 0.1F; });
    curve.kind = Kind::f32;
    CHECK(shown(plot, curve, small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  always 0.1              all there
          │
          │
      0.1 ┤⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀
          │
          │
          │
          └┬────────────┬───────────────
           12:00:00     12:00:05
)");
    curve = named("once");
    curve.steps = {step_at(plot, 5s, -0.0, -0.0)};
    CHECK(shown(plot, curve, small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
once  always 0                 all there
          │
          │
        0 ┤             ⢀
          │
          │
          │
          └┬────────────┬───────────────
           12:00:00     12:00:05
)");
    CHECK(shown(plot, named("never"), small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
never  no values               all there
          │
          │
          │
          │
          │
          │
          └┬────────────┬───────────────
           12:00:00     12:00:05
)");
  }

  TEST_CASE("FW-5 plot: tiny ranges, huge ones, negative numbers, integers beyond 2^53") {
    const Plot plot = plot_in(small);
    const auto of = [&](const std::function<Number(double)>& value) {
      return shown(plot, curve_of(plot, 1s, value), small);
    };
    CHECK(of([](double at) { return 1e9 + at * 1e-4; }) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  1000000000 to 1000000000.0009,
       mean 1000000000.00045
  all there
          │                  ⢀⣀⡠⠤⠤⠒⠊⠁
          │            ⢀⣀⡠⠤⠒⠊⠁
          │      ⢀⡠⠤⠒⠊⠉⠁
          │⣀⠤⠒⠒⠉⠉⠁
          └┬────────────┬───────────────
           12:00:00     12:00:05
)");
    CHECK(of([](double at) { return (at - 4.5) * 0x1p1021; }) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  -1.01e+308 to 1.01e+308, mean 0
  all there
1.01e+308 ┤                    ⣀⡠⠤⠒⠊⠁
          │              ⢀⣀⠤⠔⠊⠉
          │          ⢀⡠⠔⠊⠁
          │     ⣀⡠⠔⠒⠉⠁
          │⣀⠤⠒⠊⠉
          └┬────────────┬───────────────
           12:00:00     12:00:05
)");
    CHECK(of([](double at) { return std::int64_t(-9 + at); }) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  -9 to 0, mean -4.5      all there
        0 ┤                     ⢀⡠⠔⠊⠁
          │                 ⣀⠤⠒⠉⠁
          │            ⢀⡠⠔⠒⠉
          │        ⣀⠤⠔⠊⠁
          │   ⢀⣀⠤⠒⠉
       -9 ┤⡠⠔⠊⠁
          └┬────────────┬───────────────
           12:00:00     12:00:05
)");
    CHECK(of([](double at) { return (std::int64_t{1} << 53) + 1 + std::int64_t(at) % 2; }) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  9007199254740993 to
       9007199254740994
  all there
          │  ⡸⢆   ⢀⠷⡀   ⡸⢆   ⢀⠷⡀   ⢠⠃
          │ ⢠⠃⠘⡄  ⡜ ⢣  ⢠⠃⠘⡄  ⡜ ⢣  ⢀⠎
          │ ⡎  ⠸⡀⢰⠁  ⢇ ⡎  ⠸⡀⢰⠁  ⢇ ⡜
          │⡸    ⢱⠇   ⠈⡾    ⢱⠇   ⠈⡾
          └┬────────────┬───────────────
           12:00:00     12:00:05
)");
    CHECK(of([](double at) { return std::numeric_limits<std::uint64_t>::max() - std::uint64_t(at) % 3; }) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  18446744073709551613 to
       18446744073709551615
  all there
          │⠑⡄     ⢀⠗⢄      ⡜⢢      ⢠⠃
          │ ⠈⢆    ⡜  ⠣⡀   ⡰⠁ ⠱⡀   ⢀⠎
          │   ⠱⡀ ⢰⠁   ⠘⢄ ⢠⠃   ⠈⢆  ⡜
          │    ⠈⢆⠇     ⠈⢢⠇      ⠱⡸
          └┬────────────┬───────────────
           12:00:00     12:00:05
)");
    CHECK(of([](double at) {
            return at < 5 ? std::numeric_limits<std::int64_t>::min() : std::numeric_limits<std::int64_t>::max();
          }) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
value  -9223372036854775808 to
       9223372036854775807
  all there
          │             ⡸⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠁
          │            ⢠⠃
          │            ⡎
          │⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⣀⡸
          └┬────────────┬───────────────
           12:00:00     12:00:05
)");
  }

  TEST_CASE("FW-5 plot: the mean of steps near the largest numbers is a number") {
    const Plot plot = plot_in(small);
    const Curve curve = curve_of(plot, 1s, [](double at) { return at < 4.5 ? -1.6e308 : 1.6e308; });
    const Scale scale(curve);
    CHECK(std::abs(scale.mean) < 1e294);
    CurveStep both;
    for (const CurveStep& step : curve.steps) join(step, both);
    CHECK(std::abs(both.mean) < 1e294);
    CHECK(both.numbers == 10);
  }

  TEST_CASE("FW-5 plot: a panel for each field, gaps of one source are told once") {
    Plot plot = plot_in(small);
    for (const char* name : {"imu.x", "imu.y"}) {
      Curve& curve = plot.curves.emplace_back(curve_of(plot, 10ms, [](double at) { return at; }));
      curve.name = name;
      curve.topic = "imu";
      curve.gaps = {{noon + 3s, noon + 4s, 7, "missed: still reading"}};
    }
    plot.notes = {"lost of imu in run 1: missed 7"};
    CHECK("\n" + shown(plot, small) == R"(
bench.db, run 1: 2026-03-01 12:00:00.000
  to 12:00:10.000 UTC, 180 ms a dot
imu.x  0 to 9.9, mean 4.95     all there
      9.9 ┤              ⣀⣀⣀⣀⠤⠤⠤⠤⠒⠒⠒⠒⠉⠉
        0 ┤⣀⣀⠤⠤⠤⠤⠒⠒⠒⠒⠉⠉⠉⠉
                   aaaa
imu.y  0 to 9.9, mean 4.95     all there
      9.9 ┤              ⣀⣀⣀⣀⠤⠤⠤⠤⠒⠒⠒⠒⠉⠉
        0 ┤⣀⣀⠤⠤⠤⠤⠒⠒⠒⠒⠉⠉⠉⠉
                   aaaa
          └┬────────────┬───────────────
           12:00:00     12:00:05
a  12:00:03.000 to 12:00:04.000 missed:
   still reading, 7 lost
lost of imu in run 1: missed 7
)");
  }

  TEST_CASE("FW-5 plot: colours are only around curves, marks and verdicts") {
    PlotStyle style = small;
    Plot plot = plot_in(style);
    plot.curves = {curve_of(plot, 10ms, [](double at) { return at; })};
    plot.curves[0].gaps = {{noon, noon, 1, "missed"}};
    const std::string plain = shown(plot, style);
    style.colours = PlotStyle::Colours::some;
    std::string coloured = shown(plot, style);
    CHECK(coloured.find("\x1b[32mall there\x1b[0m") != std::string::npos);
    CHECK(coloured.find("\x1b[31ma\x1b[0m") != std::string::npos);
    for (const std::string code : {"\x1b[0m", "\x1b[31m", "\x1b[32m", "\x1b[36m"})
      for (std::size_t at; (at = coloured.find(code)) != std::string::npos;) coloured.erase(at, code.size());
    CHECK(coloured == plain);
  }

  TEST_CASE("FW-5 plot: control characters of names and reasons do not reach the terminal") {
    Plot plot = plot_in(small);
    plot.title = "a\x1b[2J.db";
    plot.curves = {named("x\x1b]0;y\x07")};
    plot.curves[0].gaps = {{noon, noon, 1, "failed: \x1b[31m"}};
    plot.notes = {"note \x1b[0m"};
    CHECK(shown(plot, small).find('\x1b') == std::string::npos);
  }

  TEST_CASE("FW-5 plot: 20 columns and 500 columns") {
    for (const auto characters : {PlotStyle::Characters::ascii, PlotStyle::Characters::braille}) {
      for (const std::size_t columns : {20, 21, 79, 500}) {
        const PlotStyle style{columns, 24, characters};
        Plot plot = plot_in(style);
        plot.curves = {curve_of(plot, 10ms, [](double at) { return std::sin(at); })};
        plot.curves[0].gaps = {{noon + 9s, noon + 10s, 1, "missed: loop held"}};
        const auto lines = picture_of(plot, style);
        CHECK(lines.size() == 23);
        for (const std::string& line : lines) CHECK(width_of(line) <= columns);
        // The last step is at the right edge, or within a tenth of the width from it.
        std::size_t widest = 0;
        for (const std::string& line : lines) widest = std::max(widest, width_of(line));
        CHECK(widest == columns);
      }
    }
    const PlotStyle narrow{20, 12, PlotStyle::Characters::ascii};
    CHECK(shown(plot_in(narrow), curve_of(plot_in(narrow), 1s, [](double at) { return at; }), narrow) == R"(
bench.db, run 1:
  2026-03-01
  12:00:00.000 to
  12:00:10.000 UTC,
  770 ms a column
value  0 to 9, mean
       4.5
  all there
   9 +      ...--''
   0 +.---''
     ++-------------
      12:00:00
)");
  }

  TEST_CASE("FW-5 plot: the steps of any time fit into the picture, and are of two digits") {
    for (const std::size_t columns : {20, 80, 500}) {
      const PlotStyle style{columns, 24};
      const auto labels = static_cast<std::int64_t>(std::min<std::size_t>(12, columns / 4));
      const std::int64_t dots = 2 * (static_cast<std::int64_t>(columns) - labels - 1);
      for (Duration span = 1ns; span < 100 * 365 * 24h; span += span / 2 + 1ns) {
        for (const Duration later : {Duration{0}, span / 3}) {
          const Time from = noon + later, until = from + span;
          const std::int64_t step = step_for(from, until, style).count();
          const std::int64_t steps = (to_nanoseconds(until) - 1) / step - to_nanoseconds(from) / step + 1;
          CHECK(steps <= dots);
          CHECK((steps > dots * 8 / 10 || span < 100ns * dots));
          std::int64_t digits = step;
          while (digits % 10 == 0) digits /= 10;
          CHECK(digits < 100);
        }
      }
    }
  }

  TEST_CASE("FW-5 plot: times of the axis, from nanoseconds to years") {
    const PlotStyle style{60, 8, PlotStyle::Characters::ascii};
    const auto axis_of = [&](Time from, Duration span) {
      Plot plot;
      plot.from = from;
      plot.until = from + span;
      plot.step = step_for(plot.from, plot.until, style);
      plot.curves = {named("x")};
      std::string names = picture_of(plot, style).back();
      return names.substr(names.find_first_not_of(' '));
    };
    CHECK(axis_of(noon, 40ns) == "12:00:00.000000000  12:00:00.000000020");
    CHECK(axis_of(noon, 3ms) == "12:00:00.000   12:00:00.001   12:00:00.002");
    CHECK(axis_of(noon, 10s) == "12:00:00              12:00:05");
    CHECK(axis_of(noon, 1h) == "12:00   12:10  12:20   12:30   12:40  12:50");
    CHECK(axis_of(noon - 2h, 24h) == "12:00      18:00       03-02      06:00");
    CHECK(axis_of(noon, 30 * 24h) == "03-03   03-08  03-13   03-18  03-23   03-28");
    CHECK(axis_of(noon, 50 * 365 * 24h) == "2036-07-23  2049-11-14  2063-03-08");
  }
}
