// One item of a configuration becomes the plan of a part. Private to src/config.
#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/config/registry.hpp"

namespace rtdata::config_detail {

class PartReader {
 public:
  /// What is wrong with the item by itself is added to `problems`: then the plan has no `make`, and as much else as is
  /// known of it, to be compared with the others. `name`: of a part that is written by name.
  PartPlan read(const PartKind& kind, const std::string& name, const ConfigItem& item, Problems& problems);
  /// What items of this one's type can be configured with; when there is no such type, what is common to all.
  const std::vector<ParameterInfo>& parameters_of_item(const PartKind& kind, const ConfigItem& item);

 private:
  std::map<std::pair<std::string, std::string>, std::vector<ParameterInfo>>
      parameters_;  // of (kind, type), once asked for
};

/// The kind of that name; null for "tier" and "topic", which have no types.
const PartKind* find_kind(const Registry& registry, std::string_view name);

}  // namespace rtdata::config_detail
