#include "rtdata/recording/verify.hpp"

#include <ostream>

#include "app/core/recording_commands.hpp"

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
    err << "rtdata: " << report.error().text() << "\n";
    return 2;
  }
  if (options.run) {
    std::erase_if(report->runs, [&](const RunReport& run) { return run.info.run != *options.run; });
    report->deleted.reset();
    if (report->runs.empty()) {
      err << "rtdata: " << options.database << ": there is no run " << *options.run
          << "; `rtdata verify` without --run has them all\n";
      return 1;
    }
  }
  out << (options.show_as == ShowAs::json ? report->to_json() + "\n" : report->text());
  return report->exit_code();
}

}  // namespace rtdata::app
