// One file that is appended to, a batch at a time.
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
  /// Sees to half an event at the end; `what`: how, empty when there was none. Once per opening, before `begin`.
  Result<void> repair(Codec& codec, std::string& what);
  /// Compares the header of a file with content, or sees to it that the first batch begins with it.
  Result<void> begin(const std::string& header);
  /// Whether a file of this path, if there is one, can go on with this header. Opens it for reading only.
  static Result<void> check_header(const std::string& path, const std::string& header);
  /// Whether what is in a file of this path, if there is one, can be added to in this format: it is no database, and of
  /// a format of bytes its beginning is one of such. Opens it for reading only, and not a database that is open.
  static Result<void> check_content(const std::string& path, const Codec& codec);
  /// Whether a file of this path can be opened and locked now, but for what this process itself has locked. Makes and
  /// changes nothing.
  static Result<void> check_openable(const std::string& path);
  bool is_open() const noexcept { return fd_ >= 0; }
  bool has_begun() const noexcept { return has_begun_; }
  /// Whether what is in it was written before this object wrote any of it: by an earlier run, and more than this
  /// header.
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
  /// Gives the file this name and goes on with a new one under its own; nothing waits in the buffer. There is a file of
  /// the path at each moment, unless the file system cannot exchange names. After an error all is as before.
  Result<void> go_on_as_new(const std::string& name_of_old);
  /// When it was changed last.
  std::int64_t changed_at() const noexcept;
  Result<void> sync();
  /// `unmounted`: what it is on is mounted there no longer. `cut_off`: it is shorter than it was.
  enum class Gone { no, deleted, moved, unmounted, cut_off };
  /// A file that is no longer where it was, or as it was, is closed.
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
  std::string header_;           // to stand before the first event
  std::size_t header_left_ = 0;  // of it, to be written
  bool has_begun_ = false;
  bool has_ever_begun_ = false;
  std::uint64_t size_ = 0;         // of the file
  std::uint64_t passed_ = 0;       // bytes of this batch that went through the buffer in this pass
  std::uint64_t done_ = 0;         // bytes of this batch in the file, or in those before it
  std::uint64_t done_before_ = 0;  // of them, in those before it
};

}  // namespace rtdata::detail
