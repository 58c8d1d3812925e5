// Changes a recording after its runs, when its recorder has ended.
#pragma once

#include <string>
#include <utility>

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
  /// Leaves no file beside the recording, except a lock file that names the counts of a killed run.
  ~ChangedFile();

  Database& database() noexcept { return database_; }
  RecordingLock& lock() noexcept { return lock_; }
  /// The path without symbolic links.
  const std::string& real_path() const noexcept { return real_path_; }
  /// Runs `work` in one transaction, which also writes the checksums of the account. Throws what `work` throws, and
  /// SetupError; then nothing is changed.
  template <class Work>
  void transaction(Work&& work) {
    AccountSums sums;
    try {
      database_.execute("BEGIN IMMEDIATE");
      work(sums);
      sums.write(database_);
      database_.execute("COMMIT");
    } catch (const SetupError& error) {
      roll_back();
      Error why = error.error();
      if (why.what == "cannot use the recording") why.what = doing_;
      if (why.code == Errc::storage_full) why.advice = "make room; nothing was changed";
      throw SetupError(std::move(why));
    } catch (...) {
      roll_back();
      throw;
    }
  }
  /// Releases free pages, and moves the WAL file into the recording. If that fails, the next writer does it.
  void tidy() noexcept;

 private:
  void roll_back() noexcept;

  const char* const doing_;
  RecordingLock lock_;  // released last
  Database database_;
  std::string real_path_;
};

}  // namespace rtdata::sqlite
