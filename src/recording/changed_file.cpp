#include "recording/changed_file.hpp"

#include "recording/sqlite_writer.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::sqlite {

ChangedFile::ChangedFile(const std::string& path, const char* doing) : doing_(doing) {
  if (auto is_path = check_path(path); !is_path) {
    Error error = std::move(is_path).error();
    error.what = doing;
    throw SetupError(std::move(error));
  }
  (void)Recording::open(path)
      .or_throw();  // reports a file that is not a recording; opening it for writing would make one
  database_ = Database::open(path, Database::Mode::write);
  if (sqlite3_db_readonly(database_.raw(), "main") == 1)
    throw SetupError({Errc::not_permitted, doing, path, "it is read-only",
                      "check the permissions of the file and its folder, or copy it elsewhere"});
  real_path_ = sqlite3_db_filename(database_.raw(), "main");
  auto lock = RecordingLock::take(real_path_);
  const auto held = lock ? hold_file(database_) : Result<void>{};
  if (!lock || !held) {
    Error error = !lock ? std::move(lock).error() : held.error();
    if (error.code == make_error_code(Errc::busy)) {
      error.what = doing;
      error.advice = "stop that one first";
    }
    throw SetupError(std::move(error));
  }
  lock_ = *std::move(lock);
  database_.execute("PRAGMA synchronous=FULL");
}

ChangedFile::~ChangedFile() {
  database_ = {};
  if (lock_.noted().empty()) lock_.remove();
}

void ChangedFile::roll_back() noexcept {
  if (sqlite3_get_autocommit(database_.raw()) == 0)
    sqlite3_exec(database_.raw(), "ROLLBACK", nullptr, nullptr, nullptr);
}

void ChangedFile::tidy() noexcept {
  sqlite3_exec(database_.raw(), "PRAGMA incremental_vacuum", nullptr, nullptr, nullptr);
  (void)sqlite3_wal_checkpoint_v2(database_.raw(), nullptr, SQLITE_CHECKPOINT_TRUNCATE, nullptr, nullptr);
}

}  // namespace rtdata::sqlite
