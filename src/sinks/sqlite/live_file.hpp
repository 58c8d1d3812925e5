// The small mapped file that counts what was published while a recording is open, and that locks it. It lies in /dev/shm,
// named by the recording's device and inode: there a store never waits for a disk, as it may in a mapped file beside the
// recording, and it survives a kill. A power cut takes it, and then what was lost is not known. Where there is no /dev/shm,
// it lies beside the recording.
#pragma once

#include <cstdint>
#include <string>

#include "rtdata/data/error.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::sqlite {

class LiveFile {
 public:
  static constexpr std::uint32_t most_slots = 1u << 20;

  LiveFile() = default;
  /// Locks the recording at `path`, which exists. Errors: busy, naming the pid of the process that records into it; to
  /// learn it may take 1 s.
  static Result<LiveFile> open(const std::string& path);
  LiveFile(LiveFile&& other) noexcept;
  LiveFile& operator=(LiveFile&& other) noexcept;
  ~LiveFile();

  /// What the last run left: true when it was `uuid`'s.
  bool belongs_to(const std::string& uuid) const noexcept;
  /// Begins a new run with all counts at zero.
  void begin(const std::string& uuid);
  /// The run is closed: what it counted is in the recording. Unlocks; the counts stay readable until destruction.
  void remove() noexcept;
  LiveCounts& counts(std::uint32_t slot) noexcept;

 private:
  struct Content;
  void unlock() noexcept;
  std::string path_;
  int fd_ = -1;
  Content* content_ = nullptr;
};

}  // namespace rtdata::sqlite
