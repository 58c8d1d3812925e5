/// A disk whose power can be cut: SQLite's own file system, which keeps what is written in memory too, and makes the
/// files that a power cut at any moment since could have left.
#pragma once

#include <sqlite3.h>

#include <cstddef>
#include <cstdint>
#include <map>
#include <mutex>
#include <random>
#include <string>
#include <vector>

namespace power_cut {

/// Registered as SQLite's default file system while it lives. Of each database, its rollback journal and its log it
/// notes every change. What is synced is only noted to be so: nothing waits for the real disk.
///
/// A power cut leaves, of each file, all that was written before its last sync, and of each later write all, nothing or
/// some of its sectors of 512 bytes, whatever became of the others: so in any order. Names of files that were made or
/// removed are there for certain once the folder was synced, which SQLite does with the first sync of a new journal or
/// log.
class Disk {
 public:
  Disk();
  ~Disk();
  Disk(const Disk&) = delete;
  Disk& operator=(const Disk&) = delete;

  /// A database is there from before, with its journal and its log if any, as they are. To be told before it is opened.
  void has(const std::string& path);
  /// How much has happened: a moment at which the power may be cut.
  std::size_t now() const;
  /// The files that a power cut at that moment leaves, made in `folder` under their names.
  void cut(std::size_t moment, std::mt19937& random, const std::string& folder) const;
  /// Ends this process by SIGKILL after so many changes and one more.
  void kill_at(std::size_t moment) { killed_at_ = moment; }

 private:
  enum class What { made, removed, written, truncated, synced, names_synced };
  struct Change {
    What what;
    std::size_t file;  // of those ever made
    std::string name;  // of made, removed
    std::int64_t at;   // of what is written, or the size
    std::string bytes;
  };
  struct File {
    sqlite3_file base;
    Disk* disk;
    sqlite3_file* real;
    std::size_t number;
    bool is_noted;
    bool syncs_names;
  };
  static File* of(sqlite3_file* file) { return reinterpret_cast<File*>(file); }
  static sqlite3_file* real(sqlite3_file* file) { return of(file)->real; }
  int open(const char* name, File* file, int flags, int* out);
  int remove(const char* name, int syncs_names);
  int write(File* file, const void* from, int bytes, std::int64_t at);
  int truncate(File* file, std::int64_t size);
  void sync(File* file);
  void note(Change change);
  std::string content_after(std::size_t file, std::size_t moment, std::mt19937& random) const;

  sqlite3_vfs* base_;
  sqlite3_vfs vfs_{};
  sqlite3_io_methods methods_{};
  mutable std::mutex mutex_;
  std::vector<Change> changes_;
  std::map<std::string, std::size_t> files_;  // by name, those that are there
  std::size_t made_ = 0;
  std::size_t killed_at_ = SIZE_MAX;
};

}  // namespace power_cut
