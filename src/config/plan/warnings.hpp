// Warnings about a valid configuration, from the declarations of its parameters. Private to src/config.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "rtdata/detail/config/parameter_info.hpp"

namespace rtdata::config_detail {

/// Calls `use` for each text value of a parameter in the item, also in nested lists and objects.
void for_each_text(
    const std::vector<ParameterInfo>& parameters, const ConfigItem& item,
    const std::function<void(const ParameterInfo& parameter, const std::string& text, const ConfigItem& at)>& use);
/// Warns about units that are not UCUM, unknown placeholders, and parameters without effect.
void warn_of(const std::vector<ParameterInfo>& parameters, const ConfigItem& item, Problems& warnings);
/// Warns about plain texts under keys for secrets, anywhere below the item.
void warn_of_plain_secrets(const ConfigItem& item, Problems& warnings);
/// Reports files that cannot be written.
void check_output_files(const std::vector<ParameterInfo>& parameters, const ConfigItem& item, Problems& problems);
/// Resolves all references to secrets again; skips those that fail.
void collect_secrets(const std::vector<ParameterInfo>& parameters, const ConfigItem& item,
                     std::vector<std::string>& secrets);

}  // namespace rtdata::config_detail
