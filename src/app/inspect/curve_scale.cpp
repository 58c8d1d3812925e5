#include "app/inspect/curve_scale.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <type_traits>

#include "app/core/figures.hpp"

namespace rtdata::app {
namespace {

/// How many characters of "2026-03-01T12:00:00.123456789Z" are needed so that times one step apart differ.
std::size_t end_of_time(Duration step) {
  using namespace std::chrono_literals;
  return step >= 1s ? 19 : step >= 1ms ? 23 : step >= 1us ? 26 : 29;
}

}  // namespace

bool is_finite(const Number& number) {
  const double* const real = std::get_if<double>(&number);
  return real == nullptr || std::isfinite(*real);
}

double as_double(const Number& number) {
  return std::visit([](auto held) { return static_cast<double>(held); }, number);
}

double fraction(const Number& number, const Number& least, const Number& most) {
  if (least == most) return 0.5;
  if (const double* const real = std::get_if<double>(&number)) {
    const double low = std::get<double>(least), high = std::get<double>(most);
    if (!std::isfinite(*real)) return *real > 0 ? 1 : 0;
    if (std::isfinite(high - low)) return (*real - low) / (high - low);
    return (*real / 2 - low / 2) / (high / 2 - low / 2);
  }
  const auto bits = [](const Number& of) {  // differences of which are right modulo 2^64
    const auto* const whole = std::get_if<std::int64_t>(&of);
    return whole != nullptr ? static_cast<std::uint64_t>(*whole) : std::get<std::uint64_t>(of);
  };
  return static_cast<double>(bits(number) - bits(least)) / static_cast<double>(bits(most) - bits(least));
}

Number middle(const Number& least, const Number& most) {
  if (const double* const low = std::get_if<double>(&least)) return *low / 2 + std::get<double>(most) / 2;
  if (const auto* const low = std::get_if<std::uint64_t>(&least))
    return *low + (std::get<std::uint64_t>(most) - *low) / 2;
  const std::int64_t low = std::get<std::int64_t>(least), high = std::get<std::int64_t>(most);
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(low) +
                                   (static_cast<std::uint64_t>(high) - static_cast<std::uint64_t>(low)) / 2);
}

Scale::Scale(const Curve& curve) {
  for (const CurveStep& step : curve.steps) {
    if (step.numbers == 0) continue;
    for (const Number& number : {step.least, step.most}) {
      has_infinite = has_infinite || !is_finite(number);
      if (!is_finite(number)) continue;
      if (!least || number < *least) least = number;
      if (!most || *most < number) most = number;
    }
    numbers += step.numbers;
    weigh_in(mean, step.mean, static_cast<double>(step.numbers) / static_cast<double>(numbers));
  }
  if (!least) return;
  const double low = as_double(*least), high = as_double(*most);
  const double largest = std::max(std::abs(low), std::abs(high)), range = high / 2 - low / 2;
  if (!(range > 0)) return;
  const double before = std::floor(std::log10(largest)), after = std::floor(std::log10(range));
  digits = static_cast<int>(std::clamp(before - after + 3, before < 15 ? std::max(before + 1, 3.0) : 3.0, 17.0));
  if (curve.kind == Kind::f32) digits = std::min(digits, 9);
}

std::string Scale::text(double number) const {
  std::array<char, 40> to{};
  std::snprintf(to.data(), to.size(), "%.*g", digits, number == 0 ? 0.0 : number);  // no "-0"
  return to.data();
}

std::string Scale::text(const Number& number) const {
  return std::visit(
      [&](auto held) {
        if constexpr (std::is_same_v<decltype(held), double>) {
          return text(held);
        } else {
          return std::to_string(held);
        }
      },
      number);
}

std::string exact_text(const Number& number, Kind kind) {
  return std::visit(
      [&](auto held) {
        std::array<char, 40> to{};
        if (held == 0) held = 0;  // no "-0"
        const auto end = kind == Kind::f32 ? std::to_chars(to.data(), to.data() + to.size(), static_cast<float>(held))
                                           : std::to_chars(to.data(), to.data() + to.size(), held);
        return std::string(to.data(), end.ptr);
      },
      number);
}

RangeTexts range_texts(const Curve& curve, const Scale& scale) {
  if (scale.numbers == 0) return {};
  bool has_below = false, has_above = false;
  for (const CurveStep& step : curve.steps) {
    if (step.numbers == 0) continue;
    has_below = has_below || (!is_finite(step.least) && std::get<double>(step.least) < 0);
    has_above = has_above || (!is_finite(step.most) && std::get<double>(step.most) > 0);
  }
  RangeTexts texts;
  texts.least = has_below ? "-inf" : scale.least ? scale.text(*scale.least) : "inf";
  texts.most = has_above ? "inf" : scale.most ? scale.text(*scale.most) : "-inf";
  const bool is_whole = scale.least && !std::holds_alternative<double>(*scale.least);
  const bool is_exact = !is_whole ||
                        std::max(std::abs(as_double(*scale.least)), std::abs(as_double(*scale.most))) < 0x1p53;
  if (!scale.has_infinite && is_exact) texts.mean = scale.text(scale.mean);
  return texts;
}

std::int64_t floor_of(std::int64_t value, std::int64_t of) { return value / of - (value % of < 0 ? 1 : 0); }

std::string clock_text(Time time, Duration step) { return to_iso8601(time).substr(11, end_of_time(step) - 11); }

std::string date_text(Time time) { return to_iso8601(time).substr(0, 10); }

std::string instant_text(Time time, Time beside, Duration step) {
  const std::string date = date_text(time);
  return (date == date_text(beside) ? "" : date + " ") + clock_text(time, step);
}

Duration two_digits(Duration least) {
  std::int64_t power = 1;
  while (least.count() / power >= 100) power *= 10;
  return Duration{(least.count() + power - 1) / power * power};
}

Duration distance_of_marks(Duration least) {
  using namespace std::chrono_literals;
  for (Duration power{1}; power < 1s; power *= 10)
    for (const int factor : {1, 2, 5})
      if (power * factor >= least) return power * factor;
  for (const Duration one : {Duration{1s}, Duration{2s}, Duration{5s}, Duration{10s}, Duration{15s}, Duration{30s},
                             Duration{1min}, Duration{2min}, Duration{5min}, Duration{10min}, Duration{15min},
                             Duration{30min}, Duration{1h}, Duration{2h}, Duration{3h}, Duration{6h}, Duration{12h}})
    if (one >= least) return one;
  constexpr Duration day = 24h;
  return day * ((least + day - Duration{1}) / day);
}

std::string mark_text(Time time, Duration distance, Time from, Time until) {
  constexpr Duration day = std::chrono::hours{24};
  const std::string text = to_iso8601(time);
  const bool is_midnight = time.time_since_epoch() % day == Duration{0};
  const bool has_years = date_text(from).substr(0, 4) != date_text(until).substr(0, 4);
  if (distance >= day && has_years) return text.substr(0, 10);
  if (is_midnight && date_text(from) != date_text(until)) return text.substr(5, 5);
  return text.substr(11, distance >= std::chrono::minutes{1} ? 5 : end_of_time(distance) - 11);
}

void join(const CurveStep& step, CurveStep& to) {
  to.events += step.events;
  if (step.numbers == 0) return;
  const bool is_first = to.numbers == 0;
  to.numbers += step.numbers;
  if (is_first || step.least < to.least) to.least = step.least;
  if (is_first || to.most < step.most) to.most = step.most;
  weigh_in(to.mean, step.mean, static_cast<double>(step.numbers) / static_cast<double>(to.numbers));
}

std::string gap_text(const std::string& kind, const std::string& reason) {
  const std::string text = kind == "joined" ? "several gaps joined" : kind;
  return reason.empty() || reason == kind ? text : text + ": " + reason;
}

}  // namespace rtdata::app
