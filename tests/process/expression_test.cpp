#include "rtdata/process/expression.hpp"

#include <doctest/doctest.h>

#include <array>
#include <cfenv>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <limits>
#include <optional>
#include <random>
#include <string>
#include <vector>

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

using State = ExpressionResult::State;

constexpr Time start = from_nanoseconds(1'700'000'000'000'000'000);

double value_of(std::string_view text) {
  Expression expression(text, {});
  const ExpressionResult result = expression.evaluate(start);
  REQUIRE_MESSAGE(result.has_value(), text, ": ", expression.why());
  return result.value;
}

/// Events of one name x, a second apart; NaN stands for no value.
class Series {
 public:
  explicit Series(std::string_view text) : expression(text, {"x"}) {}
  ExpressionResult take(double x, Duration after = 1s) {
    time += after;
    expression.set(0, x);
    return expression.evaluate(time);
  }
  Expression expression;
  Time time = start;
};

ExpressionMistake mistake_in(std::string_view text,
                             const std::vector<std::string>& names = {"x", "imu.x", "altitude"}) {
  const auto mistake = Expression::check(text, names);
  REQUIRE_MESSAGE(mistake.has_value(), text, " has no mistake");
  return *mistake;
}

}  // namespace

TEST_SUITE_BEGIN("process");

TEST_CASE("expressions compute as mathematics does") {
  CHECK(value_of("1 + 2 * 3") == 7);
  CHECK(value_of("(1 + 2) * 3") == 9);
  CHECK(value_of("2 ^ 3 ^ 2") == 512);
  CHECK(value_of("-2 ^ 2") == -4);
  CHECK(value_of("2 ^ -1") == 0.5);
  CHECK(value_of("10 - 4 - 3") == 3);
  CHECK(value_of("12 / 3 / 2") == 2);
  CHECK(value_of("- -3") == 3);
  CHECK(value_of("1e3 + .5") == 1000.5);
  CHECK(value_of("max(1, 5, 3) + min(4, 2) + sum(1, 2) + average(2, 4)") == 13);
  CHECK(value_of("sqrt(3^2 + 4^2)") == 5);
  CHECK(value_of("floor(2.7) + ceil(2.1) + round(2.5) + sign(-8) + abs(-1)") == 8);
  CHECK(value_of("ln(e) + log10(1000) + log2(8)") == doctest::Approx(7));
  CHECK(value_of("sin(pi / 2)") == 1);
  CHECK(value_of("atan2(1, 1)") == doctest::Approx(std::atan(1.0)));
}

TEST_CASE("conditions in a beginner's spelling and in that of programs") {
  for (const char* text : {"1 < 2 and 2 < 3", "1 < 2 && 2 < 3", "false or true", "false || true", "not 1 > 2",
                           "!(1 > 2)", "1 == 1", "1 != 2", "2 >= 2 and 2 <= 2", "not false and true",
                           "true ? true : false", "not (1 > 2 or 2 > 3)", "1 < 2 ? 2 < 3 : 1 > 2"}) {
    CAPTURE(text);
    CHECK(value_of(text) == 1);
    CHECK(Expression(text, {}).is_condition());
  }
  CHECK(value_of("true or false and false") == 1);
  CHECK(value_of("(1 < 2) * 5 + (true and false)") == 5);
  CHECK(value_of("2 and 3") == 1);
  CHECK_FALSE(Expression("1 + 2", {}).is_condition());
  CHECK_FALSE(Expression("true ? 1 : false", {}).is_condition());
}

TEST_CASE("names are those of topics and fields") {
  Expression all("imu.x + room.climate.temperature + imu.accel[1] + 'tank-1/level.value' + '2nd'",
                 {"imu.x", "room/climate.temperature", "imu.accel[1]", "tank-1/level.value", "2nd", "unused"});
  for (std::size_t i = 0; i < 5; ++i) {
    CHECK(all.evaluate(start).state == State::waiting);
    CHECK(all.uses(i));
    all.set(i, std::pow(10, i));
  }
  CHECK(all.evaluate(start).value == 11111);
  CHECK_FALSE(all.uses(5));
  CHECK_FALSE(all.uses(6));
  all.set(99, 1);
  all.set_unknown(2);
  CHECK(all.evaluate(start).state == State::waiting);
  CHECK(all.why() == "imu.accel[1] has no value yet");
  CHECK(Expression::names_in("b.c + 'a/b' * highest(b.c) - pi").or_throw() == std::vector<std::string>{"b.c", "a.b"});
  CHECK_FALSE(Expression::names_in("a +").has_value());

  Expression hidden("e + pi", {"e"});
  hidden.set(0, 1);
  CHECK(hidden.evaluate(start).value == doctest::Approx(1 + 3.14159265358979));
  CHECK_THROWS_WITH_AS(Expression("1", {"a/b", "a.b"}),
                       "cannot make an expression: \"1\": two names are the same: a/b and a.b: give each name once "
                       "[bad-argument]",
                       SetupError);
  Expression functions_too("rate + rate(rate)", {"rate"});
  functions_too.set(0, 1);
  CHECK(functions_too.evaluate(start).state == State::waiting);
}

TEST_CASE("each mistake has its column, a reason and what was meant") {
  const auto shows = [](std::string_view text, std::size_t column, std::string_view why, std::string_view meant = "") {
    CAPTURE(text);
    const ExpressionMistake mistake = mistake_in(text);
    CHECK(mistake.column == column);
    CHECK_MESSAGE(mistake.why.find(why) != std::string::npos, mistake.why);
    CHECK(mistake.suggestion == meant);
  };
  shows("altitud > 5", 1, "there is no name `altitud`", "altitude");
  shows("5 < zzz", 5, "there is no name `zzz`; available: x imu.x altitude");
  shows("x = 5", 3, "write `==`");
  shows("x == 5 = 3", 8, "write `==`");
  shows("1 < x < 5", 7, "a second comparison");
  shows("hihgest(x)", 1, "there is no function `hihgest`", "highest");
  shows("2 * highest(x, 2)", 5, "`highest` takes 1 argument, not 2");
  shows("mean(x)", 1, "`mean` takes 2 arguments: a value and seconds, not 1");
  shows("mean(x, x)", 9, "the seconds of `mean` must be a constant");
  shows("rate()", 1, "`rate` takes 1 argument, or 2: a value and seconds, not 0");
  shows("sin(x, 2)", 1, "`sin` takes 1 argument, not 2");
  shows("atan2(x)", 1, "`atan2` takes 2 arguments, not 1");
  shows("max()", 1, "`max` takes 2 arguments or more");
  shows("2 + max(x)", 5, "for one value over time use `highest`");
  shows("highest(3)", 9, "has no field in it");
  shows("log(x)", 1, "write `ln` or `log10`");
  shows("if(x > 3, 1, 2)", 1, "there is no `if`");
  shows("pow(x, 2)", 1, "a power is `^`");
  shows("x ** 2", 3, "a power is `^`");
  shows("x % 2", 3, "there is no `%`");
  shows("x <> 2", 3, "write `!=`");
  shows("x & 2", 3, "write `and`");
  shows("x + ", 5, "the expression ends, but a value is missing");
  shows("", 1, "it is empty");
  shows("  ", 3, "it is empty");
  shows("(x + 1", 1, "the `(` is not closed");
  shows("x + 1)", 6, "a `)` without its `(`");
  shows("sin(x", 4, "the `(` is not closed");
  shows("x 5", 3, "`5` is not possible here");
  shows("2x", 1, "is not a number");
  shows("5 m", 3, "`m` is not possible here");
  shows("0x10", 1, "is not a number");
  shows("1e400", 1, "too large");
  shows("x ? 1", 6, "the `:` of the `?` is missing");
  shows("and x", 1, "`and` has no value on its left");
  shows("x.", 2, "a word is missing behind the dot");
  shows("x[a]", 2, "an index is a number in brackets");
  shows("'x", 1, "the single quote is not closed");
  shows("''", 1, "there is no name in the quotes");
  shows("\"x\"", 1, "single quotes");
  shows("x, 2", 2, "`,` is not possible here");
  shows("\xc2\xb0 + zzz", 1, "\xc2\xb0` is not possible");
  CHECK(mistake_in("'\xc2\xb5' + zzz", {"\xc2\xb5"}).column == 7);
  shows("'\xc2\xb5' + x", 1, "there is no name `\xc2\xb5`");
  shows(std::string("x\0y", 3), 2, "a control character");
  CHECK_FALSE(Expression::check("x > 5 and altitude < highest(altitude) - 5", {"x", "altitude"}));
  CHECK_FALSE(Expression::check("x.5", {"x.5"}));
}

TEST_CASE("what is wrong whatever the values are is a mistake") {
  CHECK(mistake_in("x > 0 ? x : 1 / 0").why.find("division by zero") != std::string::npos);
  CHECK(mistake_in("x > 0 ? x : 1 / 0").column == 15);
  CHECK(mistake_in("x + 1 / (1 / 0)").column == 7);
  CHECK(mistake_in("1 / 0 > x").column == 3);
  CHECK(mistake_in("x/0").why == "this is a division by zero, whatever the values are");
  CHECK(mistake_in("2 + x / 0").column == 7);
  CHECK(mistake_in("1 + (x - 1) / (2 - 2)").column == 13);
  CHECK(mistake_in("highest(x / -0.0)").column == 11);
  CHECK_FALSE(Expression::check("x / (x - 1) + 0 / x", {"x"}));
  CHECK(mistake_in("x + sqrt(-1)").why.find("not a number") != std::string::npos);
  CHECK(mistake_in("x + 10 ^ 400").why.find("too large") != std::string::npos);
  CHECK(mistake_in("x + ln(0)").why.find("logarithm of 0") != std::string::npos);
  CHECK(mistake_in("mean(x, 0)").column == 9);
  CHECK(mistake_in("mean(x, 1 / 0)").column == 11);
  CHECK(mistake_in("mean(x, 1e9)").why.find("a week") != std::string::npos);
}

TEST_CASE("an expression of a megabyte, or too deep, is refused and harmless") {
  const std::string long_one = "x" + std::string(1 << 20, ' ') + "+ 1";
  CHECK(mistake_in(long_one).why == "it has 1048580 bytes: an expression has at most 4096");
  CHECK(std::string(ExpressionError(long_one, mistake_in(long_one)).what()).size() < 300);
  for (const char* opening : {"(", "sin(", "-", "not ", "x ? x : ", "2 ^ ", "highest(", "x + (", "! "}) {
    CAPTURE(opening);
    std::string deep;
    while (deep.size() < 4000) deep += opening;
    CHECK(mistake_in(deep).why.find("within each other") != std::string::npos);
    std::string megabyte;
    while (megabyte.size() < (1U << 20)) megabyte += opening;
    CHECK(mistake_in(megabyte).why.find("at most 4096") != std::string::npos);
  }
  std::string many = "rate(x)";
  for (int i = 0; i < 32; ++i) many += " + rate(x)";
  CHECK(mistake_in(many).why == "more than 32 functions with a memory");
}

TEST_CASE("a long sum is no deep one") {
  std::string sum = "x";
  for (int i = 0; i < 2000; ++i) sum += "+x";
  Series series(sum);
  CHECK(series.take(1).value == 2001);
  std::string either = "x>2";
  for (int i = 0; i < 500; ++i) either += " or x>2";
  Series condition(either);
  CHECK_FALSE(condition.take(1).is_true());
  CHECK(condition.take(3).is_true());
}

TEST_CASE("highest, lowest, previous, delta") {
  Series highest("highest(x)"), lowest("lowest(x)"), previous("previous(x)"), delta("delta(x)");
  CHECK(previous.take(3).state == State::waiting);
  CHECK(previous.expression.why() == "previous in column 1 has no value yet");
  CHECK(delta.take(3).state == State::waiting);
  CHECK(previous.take(5).value == 3);
  CHECK(delta.take(5).value == 2);
  CHECK(previous.take(4).value == 5);
  CHECK(delta.take(4).value == -1);
  const double values[] = {-3, 5, 2, -7, 4};
  const double most[] = {-3, 5, 5, 5, 5};
  const double least[] = {-3, -3, -3, -7, -7};
  for (std::size_t i = 0; i < 5; ++i) {
    CHECK(highest.take(values[i]).value == most[i]);
    CHECK(lowest.take(values[i]).value == least[i]);
  }
  highest.expression.reset();
  CHECK(highest.expression.evaluate(highest.time).state == State::waiting);
  CHECK(highest.take(-9).value == -9);
}

TEST_CASE("rate: the change a second since the value before, or over some seconds") {
  Series rate("rate(x)");
  CHECK(rate.take(1).state == State::waiting);
  CHECK(rate.take(2, 500ms).value == 2);
  CHECK(rate.take(2, 1s).value == 0);
  CHECK(rate.take(9, 0s).value == 7);  // several at one time: the last of them stands for it
  CHECK(rate.take(3, 1s).value == -6);
  Series over("rate(x, 2)");
  CHECK(over.take(0).state == State::waiting);
  CHECK(over.take(1).value == 1);
  CHECK(over.take(4).value == 2);
  CHECK(over.take(5).value == 2);       // since the value of 2 s ago, 1
  CHECK(over.take(9, 10s).value == 2);  // the others are too old: as before
  CHECK(over.take(10).value == 1);
  Series many("rate(x, 1)");
  for (int i = 0; i <= 100000; ++i) many.take(i, 10us);
  CHECK(many.take(100001, 10us).value == doctest::Approx(100000).epsilon(0.002));
}

TEST_CASE("lines that USB brings in bundles, 1 ns apart, are one instant: no rate of a ns") {
  // 1 kHz in bundles of 16 every 16 ms; p grows by 62.8 a second.
  Expression rate("rate(p)", {"p"}), over("rate(p, 0.1)", {"p"}), area("integral(p)", {"p"}), mean("mean(p, 1)", {"p"});
  double highest = 0, most_over = 0, last = 0, last_area = 0, last_mean = 0;
  double right_area = 0, sum_of_last = 0, before = 0;
  constexpr int bundles = 50;
  for (int bundle = 0; bundle < bundles; ++bundle) {
    for (int line = 0; line < 16; ++line) {
      const double p = 62.8 * (bundle * 16 + line) / 1000;
      const Time time = start + bundle * 16ms + Duration{line};
      for (Expression* const one : {&rate, &over, &area, &mean}) one->set(0, p);
      const ExpressionResult now = rate.evaluate(time), wide = over.evaluate(time);
      if (now.state == State::value) highest = std::max(highest, std::abs(last = now.value));
      if (wide.state == State::value) most_over = std::max(most_over, std::abs(wide.value));
      last_area = area.evaluate(time).value;
      last_mean = mean.evaluate(time).value;
      if (line != 15) continue;
      if (bundle > 0) right_area += (before + p) / 2 * 0.016;
      before = p;
      sum_of_last += p;
    }
  }
  CHECK(highest == doctest::Approx(62.8));
  CHECK(last == doctest::Approx(62.8));
  CHECK(most_over < 63);
  CHECK(last_area == doctest::Approx(right_area));
  CHECK(last_mean == doctest::Approx(sum_of_last / bundles));
}

TEST_CASE("mean: of what came in the last seconds, in a bounded memory") {
  Series mean("mean(x, 3)");
  CHECK(mean.take(1).value == 1);
  CHECK(mean.take(2).value == 1.5);
  CHECK(mean.take(6).value == 3);
  CHECK(mean.take(7).value == 5);
  CHECK(mean.take(4, 0s).value == 4);  // in the place of 7
  CHECK(mean.take(1, 1h).value == 1);
  CHECK(mean.take(1e300).value == doctest::Approx(5e299));
  mean.take(2);
  mean.take(2);
  CHECK(mean.take(2).value == 2);  // nothing of it is left behind

  // Against all values kept: exact up to 1000 of them a window, beyond that off by a thousandth of the window.
  std::mt19937 random(7);
  for (const Duration apart : {Duration{2ms}, Duration{20us}}) {
    Series one("mean(x, 1)");
    std::vector<std::pair<Time, double>> all;
    for (int i = 0; i < 120000; ++i) {
      const double value = static_cast<double>(random() % 1000) / 10;
      const double got = one.take(value, apart).value;
      all.emplace_back(one.time, value);
      if (i % 997 != 0) continue;
      double sum = 0;
      int count = 0;
      for (auto past = all.rbegin(); past != all.rend() && one.time - past->first < 1s; ++past, ++count)
        sum += past->second;
      CHECK(got == doctest::Approx(sum / count).epsilon(apart == 2ms ? 1e-12 : 2e-3));
    }
  }
}

TEST_CASE("since: seconds since the condition last became true") {
  Series since("since(x > 3)");
  CHECK(since.take(1).state == State::waiting);
  CHECK(since.take(4).value == 0);
  CHECK(since.take(9).value == 1);
  CHECK(since.take(0).value == 2);  // it goes on when the condition is no longer true
  CHECK(since.take(5, 500ms).value == 0);
  since.time += 2s;
  CHECK(since.expression.evaluate(since.time).value == 2);  // time alone goes on
  CHECK(Series("since(x > 3)").take(4).value == 0);
  Series held("since(x > 3) >= 2 and x > 3");
  CHECK_FALSE(held.take(4).is_true());
  CHECK_FALSE(held.take(4).is_true());
  CHECK(held.take(4).is_true());
}

TEST_CASE("a memory takes in each event, whatever is chosen around it") {
  for (const char* text : {"x < 0 ? highest(x) : -1", "x < 0 and highest(x) == 8", "x >= 0 or highest(x) == 8"}) {
    CAPTURE(text);
    Series series(text);
    series.take(8);
    series.take(3);
    CHECK(series.take(-1).is_true());
  }
  Series chosen("x < 0 ? highest(x) : -1");
  chosen.take(8);
  CHECK(chosen.take(-2).value == 8);
}

TEST_CASE("a memory takes a value in when a name in its argument was set") {
  Expression both("delta(x) + 0 * y", {"x", "y"});
  both.set(0, 1);
  both.set(1, 0);
  both.evaluate(start);
  both.set(0, 4);
  CHECK(both.evaluate(start + 1s).value == 3);
  both.set(1, 5);
  CHECK(both.evaluate(start + 2s).value == 3);  // y alone is new
  both.set(0, 4);
  CHECK(both.evaluate(start + 3s).value == 0);
}

TEST_CASE("integral: the area under what came, across gaps") {
  Expression area("integral(x)", {"x"});
  const auto take = [&](Duration at, double x) {
    area.set(0, x);
    return area.evaluate(start + at).value;
  };
  CHECK(area.evaluate(start).state == State::waiting);
  CHECK(take(0s, 4) == 0);
  CHECK(take(1s, 6) == 5);
  CHECK(area.evaluate(start + 2s).value == 5);  // nothing new
  CHECK(take(3s, 0) == 11);
  CHECK(take(3s, 8) == 19);  // at one time: in its place
  CHECK(take(4s, -8) == 19);
  area.set_unknown(0);
  CHECK(area.evaluate(start + 5s).state == State::waiting);
  CHECK(take(6s, -8) == 3);
  area.reset();
  CHECK(take(7s, 1) == 0);
  CHECK(take(8s, 1) == 1);
}

TEST_CASE("age: seconds since a value came, also of one that never came or fails") {
  Expression age("age(x)", {"x"});
  CHECK(age.evaluate(start).value == 0);
  CHECK(age.evaluate(start + 2s).value == 2);
  age.set(0, 5);
  CHECK(age.evaluate(start + 3s).value == 0);
  CHECK(age.evaluate(start + 4s).value == 1);
  age.set_unknown(0);
  CHECK(age.evaluate(start + 5s).value == 2);
  age.set(0, std::numeric_limits<double>::quiet_NaN());
  CHECK(age.evaluate(start + 6s).value == 3);
  age.set(0, 5);
  CHECK(age.evaluate(start + 7s).value == 0);
  age.reset();
  CHECK(age.evaluate(start + 9s).value == 0);
  Expression silent("age(x) > 2 or x > 100", {"x"});
  CHECK_FALSE(silent.evaluate(start).is_true());
  CHECK(silent.evaluate(start + 3s).is_true());
}

TEST_CASE("memories within memories") {
  Series steepest("highest(rate(x))");
  CHECK(steepest.take(0).state == State::waiting);
  CHECK(steepest.take(5).value == 5);
  CHECK(steepest.take(6).value == 5);
  Series falling("x < highest(x) - 5 and since(x < highest(x) - 5) >= 1");
  for (const double x : {1.0, 20.0, 18.0}) CHECK_FALSE(falling.take(x).is_true());
  CHECK_FALSE(falling.take(14).is_true());
  CHECK(falling.take(13).is_true());
}

TEST_CASE("a number that is not finite on the way is a failure, not a value") {
  const auto fails = [](std::string_view text, double x, ExpressionFailure failure, std::string_view why) {
    CAPTURE(text);
    Series series(text);
    const ExpressionResult result = series.take(x);
    CHECK(result.has_failed());
    CHECK(result.failure == failure);
    CHECK(result.value == 0);
    CHECK_FALSE(result.is_true());
    CHECK(series.expression.why() == why);
    CHECK(series.take(1).has_value());  // of the next event nothing is left
  };
  using Failure = ExpressionFailure;
  const std::string division = "division by zero, or the logarithm of 0, in column ";
  fails("1 / x", 0, Failure::division_by_zero, division + "3");
  fails("5 < 1 / x", 0, Failure::division_by_zero, division + "7");
  fails("1 / (1 / x)", 0, Failure::division_by_zero, division + "3");
  fails("max(1, 1 / x)", 0, Failure::division_by_zero, division + "10");
  fails("exp(-1 / x)", 0, Failure::division_by_zero, division + "8");
  fails("ln(x)", 0, Failure::division_by_zero, division + "1");
  fails("ln(x) < 5", -1, Failure::undefined, "no number, such as the root of a negative one, in column 7");
  fails("sqrt(x) == sqrt(x)", -1, Failure::undefined, "no number, such as the root of a negative one, in column 9");
  fails("x / x", 0, Failure::undefined, "no number, such as the root of a negative one, in column 3");
  fails("x * 1e300 < 1", 1e300, Failure::too_large, "too large for a double, in column 11");
  fails("x", std::numeric_limits<double>::quiet_NaN(), Failure::not_finite, "x is not a finite number");
  fails("x > 5", std::numeric_limits<double>::infinity(), Failure::not_finite, "x is not a finite number");
  fails("highest(x)", -std::numeric_limits<double>::infinity(), Failure::not_finite, "x is not a finite number");
  fails("highest(1 / x)", 0, Failure::division_by_zero, division + "11");
  fails("not (1 / x > 5)", 0, Failure::division_by_zero, division + "8");
  fails("(1 / x > 5 ? 1 : 2) + 1", 0, Failure::division_by_zero, division + "4");
}

TEST_CASE("a memory keeps what it has when its argument fails") {
  Series series("highest(1 / x)");
  CHECK(series.take(0.25).value == 4);
  CHECK(series.take(0).has_failed());
  CHECK(series.take(1).value == 4);
  Series difference("delta(x)");
  difference.take(-1e308);
  CHECK(difference.take(1.5e308).failure == ExpressionFailure::too_large);
  CHECK(difference.expression.why() == "too large for a double, in column 1");
  CHECK(difference.take(1.5e308).value == 0);
}

TEST_CASE("a side that decides alone does, whatever the other is") {
  Expression abort("since(x > 3) > 10 or y", {"x", "y"});
  abort.set(0, 1);
  abort.set(1, 1);
  CHECK(abort.evaluate(start).is_true());
  abort.set(1, 0);
  CHECK(abort.evaluate(start).state == State::waiting);
  for (const char* text : {"x != 0 and 1 / x > 5", "1 / x > 5 and x != 0"}) {
    CAPTURE(text);
    Series guarded(text);
    const ExpressionResult result = guarded.take(0);
    CHECK(result.has_value());
    CHECK(result.value == 0);
    CHECK(guarded.take(0.1).is_true());
  }
  Series failed("1 / x > 5 or previous(x) > 5");
  CHECK(failed.take(0).has_failed());  // a failure wins over waiting
  Series choice("x == 0 ? 0 : 1 / x");
  CHECK(choice.take(0).has_value());
}

TEST_CASE("time that goes back stands still") {
  Series series("since(x > 0)");
  CHECK(series.take(1).value == 0);
  CHECK(series.take(1, 5s).value == 5);
  CHECK(series.take(1, -3s).value == 5);
  CHECK(series.take(1, 4s).value == 6);
  Expression extremes("mean(x, 604800) + rate(x, 1)", {"x"});
  extremes.set(0, 1);
  extremes.evaluate(Time::min());
  extremes.set(0, 1);
  CHECK(extremes.evaluate(Time::max()).state == State::waiting);
}

TEST_CASE("expressions can be moved; empty ones wait") {
  Expression empty;
  CHECK(empty.evaluate(start).state == State::waiting);
  CHECK(empty.text().empty());
  CHECK(empty.names().empty());
  empty.set(0, 1);
  empty.set_unknown(0);
  empty.reset();
  Expression a("x + highest(x)", {"x"});
  a.set(0, 2);
  a.evaluate(start);
  Expression b(std::move(a));
  b.set(0, 1);
  CHECK(b.evaluate(start).value == 3);
  a = std::move(b);
  CHECK(a.evaluate(start).value == 3);
  CHECK(b.evaluate(start).state == State::waiting);  // NOLINT: harmless after it was moved
}

namespace {

/// An expression made at random of x, y, z and numbers, and what it gives: nothing where it fails.
struct RandomExpression {
  using Value = std::optional<double>;
  struct Made {
    std::string text;
    std::function<Value()> value;
    bool is_constant = false;  // plain arithmetic without names
  };

  explicit RandomExpression(unsigned seed) : random(seed), made(make(5)) {}

  unsigned up_to(unsigned count) { return static_cast<unsigned>(random() % count); }
  double number() {
    static constexpr double all[] = {0, 1, 2, 3, 0.5, 1e-3, 7.25, 1e154, 1.7e308, 1e308, 1e-308, 12345};
    return all[up_to(12)];
  }

  /// `compute` with what the processor says of it.
  template <class Compute>
  static Value finite(Compute compute) {
    std::feclearexcept(FE_ALL_EXCEPT);
    const volatile double value = compute();
    const bool is_good = std::fetestexcept(FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW) == 0 && std::isfinite(value);
    return is_good ? Value(value) : Value();
  }

  Made plain(Made a, Made b, std::string text, double (*compute)(double, double)) {
    const auto value = [a = a.value, b = b.value, compute]() -> Value {
      const Value left = a(), right = b();
      return left && right ? finite([&] { return compute(*left, *right); }) : Value();
    };
    const bool is_constant = a.is_constant && b.is_constant;
    has_mistake = has_mistake || (is_constant && !value());
    return {std::move(text), value, is_constant};
  }

  Made make(unsigned depth) {
    const unsigned kind = depth == 0 ? up_to(2) : up_to(10);
    if (kind == 0) {
      const double value = number();
      std::array<char, 40> text{};
      std::snprintf(text.data(), text.size(), "%.17g", value);
      return {text.data(), [value] { return Value(value); }, true};
    }
    if (kind == 1) {
      const unsigned name = up_to(3);
      return {std::string(1, static_cast<char>('x' + name)), [this, name] { return Value(values[name]); }};
    }
    Made a = make(depth - 1), b = kind == 7 ? a : make(depth - 1);
    if (kind < 6) {
      struct Operator {
        const char* text;
        double (*compute)(double, double);
      };
      static constexpr Operator all[] = {{" + ", [](double l, double r) { return l + r; }},
                                         {" - ", [](double l, double r) { return l - r; }},
                                         {" * ", [](double l, double r) { return l * r; }},
                                         {" / ", [](double l, double r) { return l / r; }},
                                         {" ^ ", [](double l, double r) { return std::pow(l, r); }}};
      const Operator& one = all[up_to(5)];
      if (one.text[1] == '/' && b.is_constant && b.value() == Value(0)) has_mistake = true;
      return plain(a, b, "(" + a.text + one.text + b.text + ")", one.compute);
    }
    if (kind == 6) {
      struct Function {
        const char* name;
        double (*compute)(double, double);
      };
      static constexpr Function all[] = {{"max(", [](double l, double r) { return l < r ? r : l; }},
                                         {"min(", [](double l, double r) { return r < l ? r : l; }},
                                         {"sum(", [](double l, double r) { return l + r; }},
                                         {"average(", [](double l, double r) { return (l + r) / 2; }},
                                         {"atan2(", [](double l, double r) { return std::atan2(l, r); }}};
      const Function& one = all[up_to(5)];
      return plain(a, b, one.name + a.text + ", " + b.text + ")", one.compute);
    }
    if (kind == 7) {
      struct Function {
        const char* name;
        double (*compute)(double, double);
      };
      static constexpr Function all[] = {{"sqrt(", [](double l, double) { return std::sqrt(l); }},
                                         {"ln(", [](double l, double) { return std::log(l); }},
                                         {"exp(", [](double l, double) { return std::exp(l); }},
                                         {"abs(", [](double l, double) { return std::fabs(l); }},
                                         {"tanh(", [](double l, double) { return std::tanh(l); }}};
      const Function& one = all[up_to(5)];
      return plain(a, b, one.name + a.text + ")", one.compute);
    }
    if (kind == 8) {
      const bool is_less = up_to(2) == 0;
      return plain(
          a, b, "(" + a.text + (is_less ? " < " : " == ") + b.text + ")",
          is_less ? [](double l, double r) { return l < r ? 1.0 : 0.0; }
                  : [](double l, double r) { return l == r ? 1.0 : 0.0; });
    }
    if (up_to(2) == 0) {
      Made c = make(depth - 1);
      return {"(" + a.text + " ? " + b.text + " : " + c.text + ")", [a = a.value, b = b.value, c = c.value] {
                const Value chosen = a();
                return chosen ? (*chosen != 0 ? b() : c()) : chosen;
              }};
    }
    const bool decides = up_to(2) == 0;
    return {"(" + a.text + (decides ? " or " : " and ") + b.text + ")", [a = a.value, b = b.value, decides]() -> Value {
              const Value left = a(), right = b();
              for (const Value& side : {left, right})
                if (side && (*side != 0) == decides) return decides ? 1 : 0;
              return left && right ? Value(decides ? 0 : 1) : Value();
            }};
  }

  std::mt19937 random;
  std::array<double, 3> values{};
  bool has_mistake = false;  // whatever the values are
  Made made;
};

}  // namespace

TEST_CASE("11 074 expressions at random give what the same gives in C++, also near the largest number") {
  std::size_t values = 0, failures = 0, mistakes = 0;
  for (unsigned seed = 0; seed < 11074; ++seed) {
    RandomExpression random(seed);
    CAPTURE(random.made.text);
    if (const auto mistake = Expression::check(random.made.text, {"x", "y", "z"})) {
      if (mistake->why.starts_with("it has ") || mistake->why.starts_with("more than ")) continue;  // too long
      REQUIRE_MESSAGE(random.has_mistake, mistake->why);
      CHECK(mistake->why.ends_with("whatever the values are"));
      ++mistakes;
      continue;
    }
    REQUIRE_FALSE(random.has_mistake);
    Expression expression(random.made.text, {"x", "y", "z"});
    for (int event = 0; event < 4; ++event) {
      for (std::size_t i = 0; i < 3; ++i)
        expression.set(i, random.values[i] = random.number() * (random.up_to(2) == 0 ? 1 : -1));
      const std::optional<double> wanted = random.made.value();
      const ExpressionResult result = expression.evaluate(start);
      REQUIRE(result.has_failed() == !wanted);
      REQUIRE(result.value == wanted.value_or(0));
      ++(wanted ? values : failures);
    }
  }
  CHECK(values > 20000);
  CHECK(failures > 5000);
  CHECK(mistakes > 500);
}

TEST_SUITE_END();
