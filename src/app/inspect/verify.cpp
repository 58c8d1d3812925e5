#include "rtdata/recording/verify.hpp"
#include "app/core/terminal_text.hpp"

#include <ostream>
#include <vector>

#include "app/core/recording_commands.hpp"
#include "rtdata/recording/runs.hpp"

#ifdef RTDATA_WITH_POSTGRESQL
#include "rtdata/postgresql/recording.hpp"
#endif

namespace rtdata::app {
namespace {

Result<VerifyReport> report_of(const std::string& database) {
#ifdef RTDATA_WITH_POSTGRESQL
  if (is_server_url(database)) return verify_server({.url = database});
#endif
  auto recording = Recording::open(database);
  if (!recording) return std::move(recording).error();
  return rtdata::verify(*recording);
}

}  // namespace

int verify(const VerifyOptions& options, std::ostream& out, std::ostream& err) {
  auto report = report_of(options.database);
  if (!report) {
    print_error(err, report.error());
    return 2;
  }
  if (options.run) {
    std::vector<RunInfo> runs;
    for (const RunReport& run : report->runs) runs.push_back(run.info);
    const auto wanted = find_run(runs, *options.run, options.database);
    if (!wanted) {
      print_error(err, wanted.error());
      return 1;
    }
    std::erase_if(report->runs, [&](const RunReport& run) { return run.info.run != wanted->run; });
    report->deleted.reset();
  }
  out << (options.show_as == ShowAs::json ? report->to_json() + "\n" : report->text());
  return report->exit_code();
}

}  // namespace rtdata::app
