/// download, verify_server: reading back from a PostgreSQL server. `download` makes a recording of its data, for every
/// function that reads recordings, and `verify_server` checks the data as `verify` checks a recording.
///
///     rtdata::VerifyReport report = rtdata::verify_server({.url = "postgresql://rt@db.example/plant"}).or_throw();
///     std::cout << report.text();
///     return report.exit_code();
///
/// If the sink sends `through` a recording, the server also has the recording's account, and the server's rows are
/// checked against it like the recording's own. In addition, the rows of each origin are checked against
/// rtdata_position, which has the number, the range and a checksum of the rows sent. For a run whose events came from
/// memory only this second check is possible: the report says that there is no account and that the run is not sealed.
///
/// All rows go through a temporary file in $TMPDIR, which needs about as much space as a recording of them and is
/// removed with the object. Thread: any; blocks. Errors: those of the connection (see PostgresqlSink); not-a-recording
/// (the database has no tables of rtdata).
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/postgresql/sink.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata {

/// True if the text is the URL of a server, as for `rtdata verify`, and not a file.
bool is_server_url(std::string_view text) noexcept;
/// The URL without its password, for messages.
std::string shown_url(const std::string& url);

struct ServerRecording {
  std::shared_ptr<const void> folder;  ///< of the temporary file
  Recording recording;
  /// Differences from rtdata_position, by run, a sentence each.
  std::vector<std::pair<std::int64_t, std::string>> problems;
  /// Notes, by run.
  std::vector<std::pair<std::int64_t, std::string>> notes;
};

/// `config.url` may contain a password here; it is never shown.
Result<ServerRecording> download(const PostgresqlConfig& config);
Result<VerifyReport> verify_server(const PostgresqlConfig& config);

}  // namespace rtdata
