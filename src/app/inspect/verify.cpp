#include "rtdata/sinks/verify.hpp"

#include <ostream>

#include "app/core/recording_commands.hpp"

namespace rtdata::app {

int verify(const VerifyOptions& options, std::ostream& out, std::ostream& err) {
  auto recording = Recording::open(options.database);
  if (!recording) {
    err << "rtdata: " << recording.error().text() << "\n";
    return 2;
  }
  auto report = rtdata::verify(*recording);
  if (!report) {
    err << "rtdata: " << report.error().text() << "\n";
    return 2;
  }
  out << (options.output == Output::json ? report->to_json() + "\n" : report->text());
  return report->exit_code();
}

}  // namespace rtdata::app
