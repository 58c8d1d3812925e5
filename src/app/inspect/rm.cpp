// rtdata rm: deletes a run of a recording; the sums of its account stay.
#include <ostream>

#include "app/core/recording_commands.hpp"
#include "rtdata/recording/runs.hpp"

namespace rtdata::app {

int remove_run(const RemoveOptions& options, std::ostream& out, std::ostream& err) try {
  auto recording = Recording::open(options.database);
  if (!recording) {
    err << "rtdata: " << recording.error().text() << "\n";
    return 2;
  }
  const RunInfo run = find_run(recording->runs().or_throw(), options.run, options.database).or_throw();
  recording = Error{};  // it has the file open
  const RunDeletion deleted = delete_run(options.database, run.run, options.unsent).or_throw();
  out << options.database << ": deleted run " << run.run << (run.name.empty() ? "" : " \"" + run.name + "\"") << ", "
      << deleted.rows << (deleted.rows == 1 ? " row" : " rows")
      << "; the sums of its account stay, `rtdata verify` has them\n";
  for (const auto& [sink, count] : deleted.unsent)
    out << "LOST: " << count << (count == 1 ? " event" : " events") << " that the peer of sink " << sink
        << " does not have\n";
  return 0;
} catch (const SetupError& error) {
  err << "rtdata: " << error.what() << "\n";
  return error.error().code == make_error_code(Errc::damaged) ? 2 : 1;
}

}  // namespace rtdata::app
