// Fields of a frame by their place in it.
#pragma once

#include <cstddef>
#include <string_view>
#include <vector>

#include "rtdata/sensors/lines.hpp"
#include "sensors/lines/field_text.hpp"

namespace rtdata::detail {

class BinaryFields {
 public:
  /// SetupError (bad-argument): a field without a place, or whose types do not go together. `order`: of their bytes.
  /// `length`: of all frames; 0: not always the same.
  BinaryFields(const std::vector<LineField>& fields, const Description& description, WireOrder order,
               std::size_t length);

  /// Errors: bad-data (the frame is too short). No allocation when good.
  Result<void> decode(std::string_view frame, const std::vector<FieldText>& texts, std::byte* payload) const;

 private:
  struct Place {
    const Leaf* leaf = nullptr;
    std::size_t at = 0, size = 0;
    Kind wire = Kind::f64;
    double scale = 1;
    bool is_converted = false;
  };
  std::vector<Place> places_;
  bool is_big_;
};

}  // namespace rtdata::detail
