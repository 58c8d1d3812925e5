/// The origin of an item. Private to src/data and src/config.
#pragma once

#include <memory>
#include <string>

#include "rtdata/data/config_item.hpp"

namespace rtdata {

/// Immutable; shared by copies of an item. The chain up to the root gives the path, so paths need no memory.
struct ConfigItem::Origin {
  std::shared_ptr<const Origin> parent;  ///< null for the root
  std::string key;
  std::size_t index = 0;
  bool element = false;  ///< of an array
  std::shared_ptr<const std::string> file;
  std::size_t line = 0;
  std::size_t column = 0;
  std::size_t key_line = 0;
  std::size_t key_column = 0;
};

}  // namespace rtdata
