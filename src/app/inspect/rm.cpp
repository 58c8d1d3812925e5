// rtdata rm: deletes a run of a recording; the sums of its account stay.
#include <ostream>

#include "app/core/recording_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "rtdata/recording/runs.hpp"

namespace rtdata::app {

int remove_run(const RemoveOptions& options, std::ostream& out, std::ostream& err) try {
  const auto runs = Recording::open(options.database).or_throw().runs().or_throw();
  const RunInfo run = find_run(runs, options.run, options.database).or_throw();
  const RunDeletion deleted = delete_run(options.database, run.run, options.unsent).or_throw();
  out << options.database << ": deleted run " << run.run << (run.name.empty() ? "" : " \"" + run.name + "\"") << ", "
      << deleted.rows << (deleted.rows == 1 ? " row" : " rows")
      << "; the sums of its account stay, `rtdata verify` has them\n";
  for (const auto& [sink, count] : deleted.unsent)
    out << "LOST: " << count << (count == 1 ? " event" : " events") << " that the peer of sink " << sink
        << " does not have\n";
  return 0;
} catch (const SetupError& error) {
  print_error(err, error.error());
  return status_after(error.error());
}

}  // namespace rtdata::app
