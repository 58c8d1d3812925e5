// Common checks of the settings of senders.
#pragma once

#include <memory>
#include <string>

#include "data/setting_mistake.hpp"
#include "net/host_lookup.hpp"
#include "rtdata/data/codec.hpp"

namespace rtdata::detail {

/// Why events of this format cannot be sent; empty: they can. Formats that the registry does not have are not checked.
std::string obstacle_of_format(const std::string& format);
/// Throws SetupError for the reasons above, and if there is no such format.
void require_host(const char* what, const std::string& host, std::uint16_t port);
std::unique_ptr<Codec> codec_to_send(const char* what, const std::string& format, const CodecRegistry& formats);

}  // namespace rtdata::detail
