// What is worth saying of a configuration that has no mistake, by what the parameters declare. Private to src/config.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "rtdata/detail/config/parameter_info.hpp"

namespace rtdata::config_detail {

/// Calls `use` for each text that the item has for a parameter, also those in lists and in objects below.
void for_each_text(
    const std::vector<ParameterInfo>& parameters, const ConfigItem& item,
    const std::function<void(const ParameterInfo& parameter, const std::string& text, const ConfigItem& at)>& use);
/// Units that are no UCUM, unknown placeholders, parameters that mean nothing beside the others.
void warn_of(const std::vector<ParameterInfo>& parameters, const ConfigItem& item, Problems& warnings);
/// Texts under keys that secrets are kept under, anywhere below the item.
void warn_of_plain_secrets(const ConfigItem& item, Problems& warnings);
/// Files that cannot be written: mistakes.
void check_output_files(const std::vector<ParameterInfo>& parameters, const ConfigItem& item, Problems& problems);
/// Resolves all references to secrets once more; what cannot be is left out.
void collect_secrets(const std::vector<ParameterInfo>& parameters, const ConfigItem& item,
                     std::vector<std::string>& secrets);

}  // namespace rtdata::config_detail
