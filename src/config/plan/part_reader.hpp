// Makes the plan of a part from its item. Private to src/config.
#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/config/registry.hpp"

namespace rtdata::config_detail {

class PartReader {
 public:
  /// Adds the item's own mistakes to `problems`; the plan then has no `make`, but all other known data for the
  /// comparison with other parts. `name`: for kinds written by name.
  PartPlan read(const PartKind& kind, const std::string& name, const ConfigItem& item, Problems& problems);
  /// The parameters of the item's type; for an unknown type, the common ones.
  const std::vector<ParameterInfo>& parameters_of_item(const PartKind& kind, const ConfigItem& item);

 private:
  std::map<std::pair<std::string, std::string>, std::vector<ParameterInfo>>
      parameters_;  // of (kind, type), once asked for
};

/// The kind of that name; null for "tier" and "topic", which have no types.
const PartKind* find_kind(const Registry& registry, std::string_view name);

}  // namespace rtdata::config_detail
