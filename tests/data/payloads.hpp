/// Payloads for the tests of the data layer.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>

#include "rtdata/data/describe.hpp"

namespace payloads {

struct Climate {
  double temperature = 0;
  double humidity = 0;
  friend constexpr auto describe(rtdata::type_tag<Climate>) {
    return rtdata::record("climate", rtdata::field("temperature", &Climate::temperature, "Cel"),
                          rtdata::field("humidity", &Climate::humidity, "%RH"));
  }
  bool operator==(const Climate&) const = default;
};

struct Nothing {
  RTDATA_FIELDS(Nothing)
  bool operator==(const Nothing&) const = default;
};

enum class State : std::int16_t { idle, running, broken = -7 };
constexpr auto describe(rtdata::type_tag<State>) {
  return rtdata::enumeration("state", rtdata::value("idle", State::idle), rtdata::value("running", State::running),
                             rtdata::value("broken", State::broken));
}

struct Point {
  double x = 0;
  std::int8_t label = 0;
  RTDATA_FIELDS(Point, (x, "m"), (label))
  bool operator==(const Point&) const = default;
};

/// Every kind, and everything a kind can be in.
struct Everything {
  bool flag = false;
  char letter = 'a';
  std::int8_t i8 = 0;
  std::int16_t i16 = 0;
  std::int32_t i32 = 0;
  std::int64_t i64 = 0;
  std::uint8_t u8 = 0;
  std::uint16_t u16 = 0;
  std::uint32_t u32 = 0;
  std::uint64_t u64 = 0;
  float f32 = 0;
  double f64 = 0;
  rtdata::text<7> name;
  State state = State::idle;
  std::optional<double> maybe;
  std::optional<rtdata::text<5>> maybe_name;
  std::optional<State> maybe_state;
  std::optional<bool> maybe_flag;
  std::array<float, 3> numbers{};
  std::array<rtdata::text<3>, 2> names{};
  std::array<State, 2> states{};
  std::array<std::optional<std::uint32_t>, 2> maybes{};
  Point origin_point;
  std::array<Point, 2> points{};

  friend constexpr auto describe(rtdata::type_tag<Everything>) {
    using E = Everything;
    using rtdata::field;
    return rtdata::record(
        "everything", field("flag", &E::flag), field("letter", &E::letter), field("i8", &E::i8), field("i16", &E::i16),
        field("i32", &E::i32), field("i64", &E::i64), field("u8", &E::u8), field("u16", &E::u16), field("u32", &E::u32),
        field("u64", &E::u64), field("f32", &E::f32, "V"), field("f64", &E::f64, "Cel"), field("name", &E::name),
        field("state", &E::state), field("maybe", &E::maybe, "K"), field("maybe_name", &E::maybe_name),
        field("maybe_state", &E::maybe_state), field("maybe_flag", &E::maybe_flag),
        field("numbers", &E::numbers, "m/s2"), field("names", &E::names), field("states", &E::states),
        field("maybes", &E::maybes), field("origin_point", &E::origin_point), field("points", &E::points));
  }
  bool operator==(const Everything&) const = default;
};

/// Nothing absent, and values that are easily lost.
inline Everything full() {
  Everything e;
  e.flag = true;
  e.letter = '\xe4';
  e.i8 = -128;
  e.i16 = -32768;
  e.i32 = std::numeric_limits<std::int32_t>::min();
  e.i64 = std::numeric_limits<std::int64_t>::min();
  e.u8 = 255;
  e.u16 = 65535;
  e.u32 = std::numeric_limits<std::uint32_t>::max();
  e.u64 = std::numeric_limits<std::uint64_t>::max();
  e.f32 = 0.1F;
  e.f64 = -0.0;
  e.name = "a\"\n\xc3\xa4\\";
  e.state = State::broken;
  e.maybe = 5e-324;
  e.maybe_name = rtdata::text<5>("");
  e.maybe_state = State::running;
  e.maybe_flag = false;
  e.numbers = {1e-45F, std::numeric_limits<float>::max(), -16777216.0F};
  e.names = {"", "x,y"};
  e.states = {State::running, static_cast<State>(-9)};
  e.maybes = {7U, 8U};
  e.origin_point = {std::numeric_limits<double>::max(), 1};
  e.points = {Point{-1.5, 2}, Point{9007199254740993.0, -3}};
  return e;
}

}  // namespace payloads
