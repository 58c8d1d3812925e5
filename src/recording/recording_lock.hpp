// The lock of a recording: one process at a time records into it, whatever its user. The lock is a file beside the
// recording, "run.db-lock", which only users who may write the recording may open. The kernel drops it with its
// process; after a clean end the file is gone, after a kill it stays and says where the counts of the run that was
// killed are.
#pragma once

#include <string>
#include <string_view>

#include "recording/database.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/detail/io/descriptor.hpp"

namespace rtdata::sqlite {

/// Its destructor unlocks. The file stays unless `remove` was called.
class RecordingLock {
 public:
  RecordingLock() = default;
  /// Locks the recording, which exists. `recording` is its real path, without symbolic links, so that all of its names
  /// have one lock. Errors: busy, naming the pid of the process that records into it; not-permitted.
  static Result<RecordingLock> take(const std::string& recording);
  /// Checks that `take` would succeed, ignoring locks of this process. Makes and locks nothing. Errors: of `take`.
  static Result<void> check_free(const std::string& recording);
  /// True if nobody records into it, as far as this user can see.
  static bool is_free(const std::string& recording) noexcept;

  /// The last line of `note`, possibly from an ended process; empty: none. Any user with write permission may have
  /// written it, so check its content.
  const std::string& noted() const noexcept { return noted_; }
  /// Writes a line for the next holder. Without it, that one searches itself.
  void note(std::string_view line) noexcept;
  /// Unlocks, and the file is gone.
  void remove() noexcept;

 private:
  std::string path_;
  std::string noted_;
  detail::Descriptor fd_;
};

/// Locks the file itself, so that nobody records into it under another name (a bind mount, as of a container). It is
/// SQLite's RESERVED lock, which nothing else takes on a file with a WAL file; it lasts as long as the connection. On a
/// file without a WAL file it lasts until the next use: call this again then. Errors: busy.
Result<void> hold_file(const Database& database);

}  // namespace rtdata::sqlite
