/// What a PostgreSQL server has, read back: rtdata::download makes a recording of it, which everything that reads
/// recordings takes, and rtdata::verify_server says of it what `verify` says of a recording.
///
///     rtdata::VerifyReport report = rtdata::verify_server({.url = "postgresql://rt@db.example/plant"}).or_throw();
///     std::cout << report.text();
///     return report.exit_code();
///
/// Each run is on the server with the account of its recording when its sink goes `through` one; the server's rows are
/// held to it as the recording's own are. Beside that each origin's rows are held to what rtdata_position says was
/// sent: how many, from which to which, with which values (a sum of hashes that was made when they were sent). Of a run
/// whose events came from memory that is all: the report says that no account came along, and that it is not sealed.
///
/// All rows go through a temporary file ($TMPDIR), which needs about as much room as a recording of them, and is
/// removed with the object. Thread: any; blocks. Errors: those of the connection (see PostgresqlSink); not-a-recording:
/// the database has no tables of ours.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/postgresql/sink.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata {

/// Whether a text names a server, as `rtdata verify` takes it, and not a file.
bool is_server_url(std::string_view text) noexcept;
/// The URL without its password, for people.
std::string shown_url(const std::string& url);

struct ServerRecording {
  std::shared_ptr<const void> folder;  ///< of the temporary file
  Recording recording;
  /// What does not agree with rtdata_position, by run: a sentence each.
  std::vector<std::pair<std::int64_t, std::string>> problems;
  /// Worth knowing, by run.
  std::vector<std::pair<std::int64_t, std::string>> notes;
};

/// `config.url` may hold a password here; it is shown nowhere.
Result<ServerRecording> download(const PostgresqlConfig& config);
Result<VerifyReport> verify_server(const PostgresqlConfig& config);

}  // namespace rtdata
