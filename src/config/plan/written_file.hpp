// Files that sinks and the log write, and conflicts between them. Private to src/config and src/app.
#pragma once

#include <sys/types.h>

#include <functional>
#include <optional>
#include <string>
#include <utility>

#include "rtdata/config/parts.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::config_detail {

/// Identifies a file, to compare it with other paths; the state at construction.
class FileIdentity {
 public:
  explicit FileIdentity(const std::string& path);

  /// The absolute path where it is or would be created, with all links followed.
  const std::string& target() const noexcept { return target_; }
  /// Compares also through symbolic links, even to missing targets, and hard links.
  bool is_same(const FileIdentity& other) const noexcept;
  /// True if this is a companion file of `main`, by a function like StoredTopics::is_companion_file.
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

/// Why `file` cannot be written at the same time as `known`; empty: it can.
std::string conflict(const WrittenFile& file, const WrittenFile& known);

/// True if the log's rotation renames its file to `other`.
bool is_rotated_log(const LogSettings& settings, const std::string& file, const std::string& other);

}  // namespace rtdata::config_detail
