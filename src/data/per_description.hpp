// Data that a codec computes once for each description.
#pragma once

#include <cstdint>
#include <unordered_map>

#include "rtdata/data/description.hpp"

namespace rtdata::detail {

/// `Plan` is made from a description. One thread at a time.
template <class Plan>
class PerDescription {
 public:
  /// Valid until the next call.
  const Plan& of(const Description& description) {
    if (last_serial_ == description.serial()) return *last_;
    if (plans_.size() >= 256) plans_.clear();  // for a program that always makes new descriptions
    last_ = &plans_.try_emplace(description.serial(), description).first->second;
    last_serial_ = description.serial();
    return *last_;
  }

 private:
  std::unordered_map<std::uint64_t, Plan> plans_;
  std::uint64_t last_serial_ = 0;  // serials start at 1
  const Plan* last_ = nullptr;
};

}  // namespace rtdata::detail
