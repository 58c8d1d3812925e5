// Which fields have figures (least, most, mean), and where a recorded step (a second or minute of a topic) has them.
#pragma once

#include <cmath>
#include <vector>

#include "rtdata/data/description.hpp"

namespace rtdata::app {

/// True for numbers and bools; not for texts, characters, enumerations.
inline bool is_number(Kind kind) noexcept {
  return kind != Kind::text && kind != Kind::character && kind != Kind::enumeration && kind != Kind::record;
}

struct Figures {
  const Leaf* of = nullptr;  ///< the field
  const Leaf *count = nullptr, *least = nullptr, *most = nullptr, *mean = nullptr;
};

/// The figures of all numbers of a topic, in their order. `steps`: the description of its steps (Recording::steps),
/// whose first leaf is the number of events; it and `topic` outlive what is returned.
inline std::vector<Figures> figures_of(const Description& steps, const Description& topic) {
  std::vector<Figures> all;
  const Leaf* next = steps.leaves().data() + 1;
  for (const Leaf& leaf : topic.leaves()) {
    if (!is_number(leaf.kind)) continue;
    all.push_back({&leaf, next, next + 1, next + 2, next + 3});
    next += 4;
  }
  return all;
}

/// Adds a value, or the mean of several, to a mean with this share. It does not overflow, and
/// loses no digits if all values are near each other. With an infinity the mean is that infinity, with both it is NaN.
inline void weigh_in(double& mean, double value, double share) noexcept {
  if (share == 1)
    mean = value;
  else
    mean += std::isfinite(value) && std::isfinite(mean) ? (value / 2 - mean / 2) * (2 * share) : value;
}

}  // namespace rtdata::app
