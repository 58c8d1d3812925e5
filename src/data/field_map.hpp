// Converts payloads of one description to another, with fields matched by name.
#pragma once

#include <cstddef>
#include <vector>

#include "rtdata/data/description.hpp"
#include "rtdata/data/error.hpp"

namespace rtdata::detail {

/// The source of each leaf of the wanted payload.
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

/// Error: description-differs, with only `why` set: it names each missing or different field.
Result<FieldMap> map_fields(const Description& have, const Description& wanted);

}  // namespace rtdata::detail
