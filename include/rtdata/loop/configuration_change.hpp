/// ConfigurationChange: what the configuration of a run says from a time on, as recordings keep it
/// (rtdata_configuration).
///
/// Values; any thread.
#pragma once

#include <string>

#include "rtdata/data/time.hpp"

namespace rtdata {

struct ConfigurationChange {
  Time time{};
  std::string object;  ///< "sensor chamber": the part that was added, changed or removed; empty: the whole
  std::string text;    ///< of the part or of the whole; empty: the part was removed
};

}  // namespace rtdata
