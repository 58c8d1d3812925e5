// A recording that somebody else than its recorder changes: after its runs.
#pragma once

#include <string>

#include "recording/account_sums.hpp"
#include "recording/database.hpp"
#include "recording/recording_lock.hpp"

namespace rtdata::sqlite {

class ChangedFile {
 public:
  /// Opens and locks it. `doing`: "cannot seal", for errors. Throws SetupError: busy, not-permitted, those of
  /// `Recording::open`.
  ChangedFile(const std::string& path, const char* doing);
  ChangedFile(const ChangedFile&) = delete;

  Database& database() noexcept { return database_; }
  RecordingLock& lock() noexcept { return lock_; }
  /// Without symbolic links.
  const std::string& real_path() const noexcept { return real_path_; }
  /// Does this in one transaction, with the checksums of the account. Throws what it throws, and SetupError: then
  /// nothing is changed.
  template <class Work>
  void transaction(Work&& work) {
    AccountSums sums;
    database_.execute("BEGIN IMMEDIATE");
    try {
      work(sums);
      sums.write(database_);
      database_.execute("COMMIT");
    } catch (...) {
      if (sqlite3_get_autocommit(database_.raw()) == 0)
        sqlite3_exec(database_.raw(), "ROLLBACK", nullptr, nullptr, nullptr);
      throw;
    }
  }
  /// Brings the log into the file, and gives pages back that are free. What fails is done by the next writer.
  void tidy() noexcept;

 private:
  RecordingLock lock_;  // given up last
  Database database_;
  std::string real_path_;
};

}  // namespace rtdata::sqlite
