// rtdata seal: closes the account of runs that were killed, without recording again.
#include <ostream>

#include "app/core/recording_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "rtdata/recording/runs.hpp"

namespace rtdata::app {

int seal(const std::string& database, std::ostream& out, std::ostream& err) {
  const auto sealed = rtdata::seal(database);
  if (!sealed) {
    print_error(err, sealed.error());
    return status_after(sealed.error());
  }
  if (sealed->empty()) out << database << ": nothing to seal: no run ended without closing\n";
  for (const std::string& remark : *sealed) out << database << ": sealed: " << remark << "\n";
  return 0;
}

}  // namespace rtdata::app
