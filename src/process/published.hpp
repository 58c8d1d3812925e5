// The published fields of a processing.
#pragma once

#include <string_view>
#include <vector>

#include "rtdata/process/processing.hpp"

namespace rtdata::detail {

/// True if the published value may differ from the raw one, which is then published too.
bool changes_value(const FieldProcessing& processing) noexcept;
bool has_rate(const FieldProcessing& processing) noexcept;

/// The values of a field of a processing: one, or the elements of an array.
std::vector<const Leaf*> leaves_of(const Description& description, std::string_view path);

}  // namespace rtdata::detail
