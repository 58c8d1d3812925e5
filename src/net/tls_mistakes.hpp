// Mistakes in the settings of TLS.
#pragma once

#include <vector>

#include "data/setting_mistake.hpp"
#include "rtdata/net/tls.hpp"

namespace rtdata::detail {

/// A certificate without a key, a file that cannot be read. Opens the files; sends nothing. Keys: "tls.certificate".
std::vector<SettingMistake> mistakes_of(const TlsConfig& config);

}  // namespace rtdata::detail
