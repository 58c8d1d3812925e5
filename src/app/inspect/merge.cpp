// rtdata merge: one recording of the runs of several.
#include <ostream>

#include "app/core/recording_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "rtdata/recording/runs.hpp"

namespace rtdata::app {

int merge(const MergeOptions& options, std::ostream& out, std::ostream& err) {
  const auto merged = rtdata::merge(options.sources, options.database);
  if (!merged) {
    print_error(err, merged.error());
    return status_after(merged.error());
  }
  int status = 0;
  out << options.database << ": " << merged->runs.size() << (merged->runs.size() == 1 ? " run\n" : " runs\n");
  for (const MergedRun& run : merged->runs) {
    out << "  run " << run.run << ": run " << run.source_run << " of " << run.source << ", " << run.rows
        << (run.rows == 1 ? " row\n" : " rows\n");
    for (const std::string& copy : run.copies) out << "    " << copy << "\n";
    for (const std::string& difference : run.differences) {
      print_error(err, options.database + ", run " + std::to_string(run.run) + ": " + difference, "damaged");
      status = 1;
    }
  }
  for (const std::string& note : merged->notes) err << "rtdata: warning: " << note << "\n";
  return status;
}

}  // namespace rtdata::app
