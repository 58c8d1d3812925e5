// The peer of a sink as its configuration names it, in a form in which two that are the same are equal.
#pragma once

#include <string>
#include <string_view>

#include "rtdata/data/config_item.hpp"

namespace rtdata::app {

/// A value as it is written; empty: there is none.
std::string text_of(const ConfigItem& item, std::string_view key);

/// Of one of the keys that say who the peer is (`url`, `host`, `port`, `database`, `path`, `type`): defaults are filled
/// in, and left out of a URL; names of hosts are in lower case; paths have no "." and "..". Blocks nothing.
std::string peer_form(const ConfigItem& sink, std::string_view key);

}  // namespace rtdata::app
