/// Payloads for the tests of the loop.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

#include "rtdata/data/describe.hpp"

namespace observed {

struct Number {
  double value = 0;
  std::int32_t index = 0;
  friend constexpr auto describe(rtdata::type_tag<Number>) {
    return rtdata::record("number", rtdata::field("value", &Number::value, "m"),
                          rtdata::field("index", &Number::index));
  }
};

struct Count {
  std::int64_t number = 0;
  RTDATA_FIELDS(Count, (number))
};

/// Has the fields of Number, elsewhere.
struct Reordered {
  float extra = 0;
  std::int32_t index = 0;
  double value = 0;
  friend constexpr auto describe(rtdata::type_tag<Reordered>) {
    return rtdata::record("reordered", rtdata::field("extra", &Reordered::extra),
                          rtdata::field("index", &Reordered::index), rtdata::field("value", &Reordered::value, "m"));
  }
};

struct WrongUnit {
  double value = 0;
  std::int32_t index = 0;
  friend constexpr auto describe(rtdata::type_tag<WrongUnit>) {
    return rtdata::record("wrong_unit", rtdata::field("value", &WrongUnit::value, "s"),
                          rtdata::field("index", &WrongUnit::index));
  }
};

/// Not trivially copyable; counts what becomes of it.
struct Tracked {
  std::string text;
  Tracked() { ++made; }
  explicit Tracked(std::string t) : text(std::move(t)) { ++made; }
  Tracked(const Tracked& other) : text(other.text) {
    ++made;
    ++copies;
  }
  Tracked(Tracked&& other) : text(std::move(other.text)) {
    if (throw_on_move) throw std::runtime_error("does not move");
    ++made;
  }
  Tracked& operator=(const Tracked&) = delete;
  ~Tracked() { ++gone; }

  static int alive() { return made - gone; }
  static void reset() { made = gone = copies = 0; }
  static inline int made = 0;
  static inline int gone = 0;
  static inline int copies = 0;
  static inline bool throw_on_move = false;
};

}  // namespace observed
