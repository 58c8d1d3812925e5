// rtdata merge: one recording of the runs of several.
#include <ostream>

#include "app/core/recording_commands.hpp"
#include "rtdata/recording/runs.hpp"

namespace rtdata::app {

int merge(const MergeOptions& options, std::ostream& out, std::ostream& err) {
  for (const std::string& source : options.sources) {
    if (const auto recording = Recording::open(source); !recording) {
      err << "rtdata: " << recording.error().text() << "\n";
      return 2;
    }
  }
  const auto merged = rtdata::merge(options.sources, options.database);
  if (!merged) {
    err << "rtdata: " << merged.error().text() << "\n";
    return merged.error().code == make_error_code(Errc::damaged) ? 2 : 1;
  }
  int status = 0;
  out << options.database << ": " << merged->runs.size() << (merged->runs.size() == 1 ? " run\n" : " runs\n");
  for (const MergedRun& run : merged->runs) {
    out << "  run " << run.run << ": run " << run.source_run << " of " << run.source << ", " << run.rows
        << (run.rows == 1 ? " row\n" : " rows\n");
    for (const std::string& copy : run.copies) out << "    " << copy << "\n";
    for (const std::string& difference : run.differences) {
      err << "rtdata: " << options.database << ", run " << run.run << ": " << difference << "\n";
      status = 1;
    }
  }
  for (const std::string& note : merged->notes) err << "rtdata: warning: " << note << "\n";
  return status;
}

}  // namespace rtdata::app
