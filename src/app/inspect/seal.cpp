// rtdata seal: closes the account of runs that were killed, without recording again.
#include <ostream>

#include "app/core/recording_commands.hpp"
#include "rtdata/recording/runs.hpp"

namespace rtdata::app {

int seal(const std::string& database, std::ostream& out, std::ostream& err) {
  if (const auto recording = Recording::open(database); !recording) {
    err << "rtdata: " << recording.error().text() << "\n";
    return 2;
  }
  const auto sealed = rtdata::seal(database);
  if (!sealed) {
    err << "rtdata: " << sealed.error().text() << "\n";
    return sealed.error().code == make_error_code(Errc::damaged) ? 2 : 1;
  }
  if (sealed->empty()) out << database << ": nothing to seal: no run ended without closing\n";
  for (const std::string& remark : *sealed) out << database << ": sealed: " << remark << "\n";
  return 0;
}

}  // namespace rtdata::app
