// Which fields have figures (least, most, mean, a curve), and where a recorded step has them.
#pragma once

#include <vector>

#include "rtdata/data/description.hpp"

namespace rtdata::app {

/// Also of bools; not of texts, characters, enumerations.
inline bool is_number(Kind kind) noexcept {
  return kind != Kind::text && kind != Kind::character && kind != Kind::enumeration && kind != Kind::record;
}

struct Figures {
  const Leaf* of = nullptr;  ///< the field
  const Leaf *count = nullptr, *least = nullptr, *most = nullptr, *mean = nullptr;
};

/// Of all numbers of a topic, in their order. `steps`: the description of its steps (Recording::steps), whose first
/// leaf is the number of events; it and `topic` outlive what is returned.
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

}  // namespace rtdata::app
