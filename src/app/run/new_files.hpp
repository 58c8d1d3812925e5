// The files that a change of the configuration begins to write.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "rtdata/config/change.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::app {

/// One that a part of the next plan writes, and none of the plan before it.
struct NewFile {
  std::string object;  ///< "sink log"
  std::string path;
  std::function<Result<void>(const std::string& file)> check_openable;
};

/// Of the parts that `changes` adds or makes anew. The disk is not asked. Any thread.
std::vector<NewFile> new_files(const std::vector<const PartPlan*>& now, const SystemPlan& next,
                               const PlanChange& changes);

/// Why the file cannot be written now, such as by another process that writes it; empty: it can. Makes and changes
/// nothing. Any thread; blocks on the disk.
std::string obstacle_to_write(const NewFile& file);

}  // namespace rtdata::app
