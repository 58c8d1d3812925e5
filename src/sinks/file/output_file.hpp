// One output file, appended to in batches.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "rtdata/data/codec.hpp"

namespace rtdata::detail {

/// Not for two threads at a time. A batch is encoded into `buffer` and passed on by `write_out` now and then; after a
/// failure the same batch is encoded again from its start, and what is in the file already is skipped.
class OutputFile {
 public:
  OutputFile() noexcept = default;
  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&&) = delete;
  ~OutputFile();

  /// Opens, locks and looks at the end. Nothing when it is open.
  /// `permissions`: of a file that is made, less the umask.
  Result<void> open(const std::string& path, mode_t permissions);
  /// Repairs half an event at the end; `what`: a description, empty if there was none. Once per opening, before
  /// `begin`.
  Result<void> repair(Codec& codec, std::string& what);
  /// Compares the header of an existing file, or makes the first batch begin with it.
  Result<void> begin(const std::string& header);
  /// Checks that an existing file of this path can be continued with this header. Opens it for reading only.
  static Result<void> check_header(const std::string& path, const std::string& header);
  /// Checks that an existing file of this path can be continued in this format: it is not a database, and for a binary
  /// format its beginning is valid. Opens it for reading only, and does not open a database in use.
  static Result<void> check_content(const std::string& path, const Codec& codec);
  /// Checks that a file of this path can be opened and locked now, ignoring locks of this process. Creates and changes
  /// nothing.
  static Result<void> check_openable(const std::string& path);
  bool is_open() const noexcept { return fd_ >= 0; }
  bool has_begun() const noexcept { return has_begun_; }
  /// True if an earlier run wrote more than this header into it.
  bool holds_earlier_run(const std::string& header) const;
  const std::string& path() const noexcept { return path_; }

  void begin_batch();
  std::vector<std::byte> buffer;
  /// Writes the buffer and empties it.
  Result<void> write_out();
  /// All of the batch is written.
  void end_batch() noexcept;
  /// Bytes of the file with what the buffer adds up to this place in it.
  std::uint64_t size_with(std::size_t up_to) const noexcept;
  bool has_events(std::uint64_t size) const noexcept { return size > header_.size(); }
  /// The event that begins at this place in the buffer is in the file neither as a whole nor in part.
  bool is_new(std::size_t from) const noexcept { return passed_ + from >= done_ && passed_ + buffer.size() > done_; }
  /// Renames the file and starts a new one under its own name; the buffer must be empty. The path always has a file,
  /// unless the file system cannot exchange names. After an error nothing has changed.
  Result<void> go_on_as_new(const std::string& name_of_old);
  /// When it was changed last.
  std::int64_t changed_at() const noexcept;
  Result<void> sync();
  /// `unmounted`: its disk is no longer mounted. `cut_off`: the file is shorter than before.
  enum class Gone { no, deleted, moved, unmounted, cut_off };
  /// Closes a file that was moved, deleted or cut off.
  Gone close_if_gone();
  void close() noexcept;

 private:
  Result<void> repair_lines(std::string& what);
  /// `what`: that it was done.
  Result<void> move_aside(std::span<const std::byte> tail, std::string& what);
  bool is_unmounted() const;
  /// Where the batch under way begins in the file.
  off_t batch_begins() const noexcept { return static_cast<off_t>(size_ - (done_ - done_before_)); }
  Error failed(int errno_value, const char* what) const;
  Result<void> append(const std::byte* data, std::size_t size, std::size_t& written);

  std::string path_;
  std::string mounted_at_;  // where what the file is on was mounted when it was opened first; empty: not known
  mode_t permissions_ = 0640;
  int fd_ = -1;
  off_t size_at_open_ = 0;
  std::string header_;           // to write before the first event
  std::size_t header_left_ = 0;  // of it, to be written
  bool has_begun_ = false;
  bool has_ever_begun_ = false;
  std::uint64_t size_ = 0;         // of the file
  std::uint64_t passed_ = 0;       // bytes of this batch that went through the buffer in this pass
  std::uint64_t done_ = 0;         // bytes of this batch in the file, or in those before it
  std::uint64_t done_before_ = 0;  // of them, in those before it
};

}  // namespace rtdata::detail
