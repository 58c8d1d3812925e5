// Mistakes in the settings of TLS.
#pragma once

#include <vector>

#include "data/setting_mistake.hpp"
#include "rtdata/net/tls.hpp"

namespace rtdata::detail {

/// A certificate without a key, a file that cannot be read. Opens the files; sends nothing. `keys_in`: where they are
/// in the configuration.
std::vector<SettingMistake> mistakes_of(const TlsConfig& config, const std::string& keys_in = "tls.");

}  // namespace rtdata::detail
