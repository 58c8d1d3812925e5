// The files that a change of the configuration begins to write.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "rtdata/config/change.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// A file that a part of the next plan writes, but no part of the old plan.
struct NewFile {
  std::string object;  ///< "sink log"
  std::string path;
  std::function<Result<void>(const std::string& file)> check_openable;
};

/// The new files of the parts that `changes` adds or restarts. Does not access the disk. Any thread.
std::vector<NewFile> new_files(const std::vector<const PartPlan*>& now, const SystemPlan& next,
                               const PlanChange& changes);

/// Why the file cannot be written now, for example because another process writes it; empty: it can. Creates and
/// changes nothing. Any thread; blocks on the disk.
std::string obstacle_to_write(const NewFile& file);

}  // namespace rtdata::app
