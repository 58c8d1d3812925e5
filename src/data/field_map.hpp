// The way from payloads of one description to those of another: fields are found by their names.
#pragma once

#include <cstddef>
#include <vector>

#include "rtdata/data/description.hpp"
#include "rtdata/data/error.hpp"

namespace rtdata::detail {

/// Where each leaf of the wanted payload comes from.
struct FieldMap {
  struct Copy {
    std::size_t from;
    std::size_t to;
    std::size_t size;
  };
  std::vector<Copy> copies;
  bool is_identity = false;  ///< both lie in memory alike

  void apply(const std::byte* from, std::byte* to) const noexcept;
};

/// Error: description-differs, of which only `why` is set: it names each field that is missing or another.
Result<FieldMap> map_fields(const Description& have, const Description& wanted);

}  // namespace rtdata::detail
