// Files that sinks and the log write, and whether two of them are in each other's way. Private to src/config and
// src/app.
#pragma once

#include <sys/types.h>

#include <functional>
#include <optional>
#include <string>
#include <utility>

#include "rtdata/config/parts.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::config_detail {

/// All that tells whether another path leads to the same file, as it was when this was made.
class FileIdentity {
 public:
  explicit FileIdentity(const std::string& path);

  /// Where it is or would be made: absolute, all links followed.
  const std::string& target() const noexcept { return target_; }
  /// Also through symbolic links, of which what they lead to need not be there, and hard links.
  bool is_same(const FileIdentity& other) const noexcept;
  /// Whether this is one of the files that go with `main`, by a function as StoredTopics::is_companion_file.
  bool is_companion_file(
      const FileIdentity& main,
      const std::function<bool(const std::string& file, const std::string& other)>& is_companion_file) const;

 private:
  using Id = std::pair<dev_t, ino_t>;
  static std::optional<Id> id_of(const std::string& path, nlink_t& links) noexcept;

  std::string name_;    // absolute, the links of its folders resolved, not its own
  std::string target_;  // its own too
  nlink_t links_ = 0;
  std::optional<Id> id_;  // what is there now
};

struct WrittenFile {
  std::string path;    ///< as it is shown
  std::string writer;  ///< such as "the sink at bench.json:3:5"
  std::function<bool(const std::string& file, const std::string& other)>
      is_companion_file;  ///< see StoredTopics; empty: none is
  FileIdentity identity{path};
};

/// A file that this part writes.
WrittenFile written_file(const PartPlan& part, const std::string& path);

/// Why `file` cannot be written while `known` is; empty: it can.
std::string conflict(const WrittenFile& file, const WrittenFile& known);

/// Whether the log renames its file to `other` when it is full.
bool is_rotated_log(const LogSettings& settings, const std::string& file, const std::string& other);

}  // namespace rtdata::config_detail
