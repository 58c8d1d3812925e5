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
  Result<void> open(const std::string& path);
  /// Sees to half an event at the end; `what`: how, empty when there was none. Once per opening, before `begin`.
  Result<void> repair(Codec& codec, std::string& what);
  /// Compares the header of a file with content, or sees to it that the first batch begins with it.
  Result<void> begin(const std::string& header);
  /// Whether a file of this path, if there is one, can go on with this header. Opens it for reading only.
  static Result<void> check_header(const std::string& path, const std::string& header);
  bool is_open() const noexcept { return fd_ >= 0; }
  bool has_begun() const noexcept { return has_begun_; }
  const std::string& path() const noexcept { return path_; }

  void begin_batch();
  std::vector<std::byte> buffer;
  /// Writes the buffer and empties it.
  Result<void> write_out();
  /// All of the batch is written.
  void end_batch() noexcept;
  Result<void> sync();
  enum class Gone { no, deleted, moved };
  /// A file that is no longer where it was is closed.
  Gone close_if_gone();
  void close() noexcept;

 private:
  Result<void> move_aside(std::span<const std::byte> tail);
  Error failed(int errno_value, const char* what) const;
  Result<void> append(const std::byte* data, std::size_t size, std::size_t& written);

  std::string path_;
  int fd_ = -1;
  off_t size_at_open_ = 0;
  std::string header_;  // to stand before the first batch
  bool writes_header_ = false;
  bool has_begun_ = false;
  std::uint64_t passed_ = 0;  // bytes of this batch that went through the buffer in this pass
  std::uint64_t done_ = 0;    // bytes of this batch in the file
};

}  // namespace rtdata::detail
