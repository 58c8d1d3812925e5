// Counts of a run that are not yet in its recording: a small memory-mapped file that survives a kill of the program. It
// is made before the recording is opened, so that a run which is killed before it has a row there is counted too. A
// power failure destroys it; the losses are then unknown. It lies in a folder that only its user can write
// (private_folder.hpp) and is named by the run's uuid. Its pages are allocated before they are written, so that a full
// file system is an error and never a signal.
#pragma once

#include <array>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/sinks/recording_writer.hpp"

namespace rtdata::sqlite {

/// A value that keeps its old content if a kill interrupts a write. One writer. All zero means never written.
template <class T>
class Kept {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  void set(const T& value) noexcept {
    const std::uint64_t next = which_.load(std::memory_order_relaxed) == 1 ? 2 : 1;
    copies_[next - 1] = value;
    std::atomic_signal_fence(std::memory_order_seq_cst);
    which_.store(next, std::memory_order_release);
  }
  std::optional<T> value() const noexcept {
    const std::uint64_t which = which_.load(std::memory_order_acquire);
    return which == 0 ? std::nullopt : std::optional<T>(copies_[which - 1]);
  }

 private:
  std::atomic<std::uint64_t> which_;  // 0: none; 1: the first copy; 2: the second
  std::array<T, 2> copies_;
};

struct LiveGap {
  Gap::Kind kind;
  bool is_there;
  char reason[54];
  std::int64_t first;
  std::int64_t last;
  std::uint64_t count;
};

/// An origin's account at the last change without an event. With a schedule, each later event counts as one timely read
/// with one sample.
struct LiveAccount {
  SensorCounts sensor;
  std::uint64_t first_sequence;  ///< 0: none
  Segment segment;               ///< the current one, or the last that ended; period 0: none
  LiveGap under_way;
  LiveGap closed;  ///< gaps that may be missing in the recording's accounts, joined
};

/// Data that is used less often than the counts of each event.
struct alignas(64) LiveSlot {
  std::uint64_t committed;    ///< committed rows of the run, including deleted ones; the lane's
  Kept<LiveAccount> account;  ///< the loop's
};

/// How a run is named in the recording.
struct RunInfo {
  std::string uuid;
  std::string name;
  std::string notes;
  std::string configuration;
  std::string boot_id;
  Time started{};
  Duration clock_offset{0};
  std::int64_t pid = 0;
};

class LiveFile {
 public:
  static constexpr std::uint32_t first_block = 64;
  static constexpr std::uint32_t most_blocks = 14;  // each twice as large as the one before
  static constexpr std::uint32_t most_slots = first_block * ((1u << most_blocks) - 1);

  LiveFile() = default;
  /// Makes the file of a new run, with space for `first_block` slots. `path` of its recording is absolute; its disk is
  /// not accessed, since it may be slow. Errors: no folder can be used; the run's counts are then kept in its own
  /// memory.
  static Result<LiveFile> make(const std::string& path, const RunInfo& run);
  /// The recording, whose lock the caller holds, has this real path.
  void set_recording(const std::string& recording) noexcept;
  /// The recording has a row of the run.
  void set_has_row() noexcept;
  /// Finds the files of ended runs of this recording, whose lock the caller holds, that had no row when they ended.
  /// `noted`: as for `find`.
  static std::vector<LiveFile> without_row(const std::string& recording, const std::string& noted);
  /// The run, without its notes and its configuration.
  RunInfo run() const;
  /// Finds the file of an ended run; empty if it did not survive or belongs to another recording (a copy). `noted`: its
  /// path from the lock file. Errors: busy if the run still runs.
  static Result<std::optional<LiveFile>> find(const std::string& recording, const std::string& uuid,
                                              const std::string& noted);
  /// Removes old files of deleted recordings, and of this recording, whose lock the caller holds and whose runs are
  /// sealed.
  static void remove_left(const std::string& recording);
  LiveFile(LiveFile&& other) noexcept;
  LiveFile& operator=(LiveFile&& other) noexcept;
  /// The file stays unless `remove` was called.
  ~LiveFile();
  explicit operator bool() const noexcept { return fd_ >= 0; }
  const std::string& path() const noexcept { return path_; }

  /// Allocates pages for this slot; slots are reserved in order. After one failure all later calls fail: `is_complete`
  /// is false, in the file too.
  Result<void> reserve(std::uint32_t slot);
  bool has(std::uint32_t slot) const noexcept { return block_of(slot) < most_blocks && blocks_[block_of(slot)].counts; }
  /// The error of a slot without room.
  Error no_room() const;
  /// How many slots were reserved.
  std::uint32_t slots() const noexcept;
  /// True if the file had no room for some slots.
  bool lacks_room() const noexcept;

  // The slot must exist.
  LiveCounts& counts(std::uint32_t slot) noexcept { return blocks_[block_of(slot)].counts[offset_of(slot)]; }
  LiveSlot& slot(std::uint32_t slot) noexcept { return blocks_[block_of(slot)].slots[offset_of(slot)]; }

  /// Deletes the file. Call it when the counts are in the recording; they stay readable until destruction.
  void remove() noexcept;

 private:
  struct Header;
  struct Block {
    LiveCounts* counts = nullptr;
    LiveSlot* slots = nullptr;
  };
  static std::uint32_t block_of(std::uint32_t slot) noexcept {
    return static_cast<std::uint32_t>(std::bit_width(slot / first_block + 1)) - 1;
  }
  static std::uint32_t offset_of(std::uint32_t slot) noexcept {
    return slot - first_block * ((1u << block_of(slot)) - 1);
  }
  static std::size_t bytes_of(std::uint32_t block) noexcept;
  Result<void> map_block(std::uint32_t block);
  /// Calls it with each file in these folders that no process holds.
  template <class Function>
  static void for_each_left(const std::vector<std::string>& places, Function&& function);
  static std::optional<LiveFile> open(const std::string& path, bool& is_held);
  /// True if the header is that of this version's files.
  bool is_readable() const noexcept;

  std::string path_;
  int fd_ = -1;
  Header* header_ = nullptr;
  std::array<Block, most_blocks> blocks_{};
};

}  // namespace rtdata::sqlite
