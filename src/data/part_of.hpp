// Whether one description is a part of another.
#pragma once

#include <algorithm>

#include "rtdata/data/description.hpp"

namespace rtdata::detail {

/// Every leaf of `part` is in `whole`, with the same meaning.
inline bool is_part_of(const Description& part, const Description& whole) {
  const auto are_same = [](const Leaf& a, const Leaf& b) {
    return a.path == b.path && a.kind == b.kind && a.unit == b.unit &&
           (a.optional == nullptr) == (b.optional == nullptr) && a.field->values == b.field->values;
  };
  return std::all_of(part.leaves().begin(), part.leaves().end(), [&](const Leaf& leaf) {
    return std::any_of(whole.leaves().begin(), whole.leaves().end(),
                       [&](const Leaf& other) { return are_same(leaf, other); });
  });
}

}  // namespace rtdata::detail
