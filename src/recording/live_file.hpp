// What is known of a run and not yet in its recording: a small mapped file in memory, written while the run goes on,
// which survives a kill of the program. A power cut takes it, and then what was lost is not known. It lies in a folder
// that only its user can write (private_folder.hpp), is named by the run's uuid, and its pages are set aside before
// they are written, so that a full file system is an error and never a signal.
#pragma once

#include <array>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <type_traits>

#include "rtdata/data/error.hpp"
#include "rtdata/sinks/recording_writer.hpp"

namespace rtdata::sqlite {

/// A value that a kill in the middle of writing leaves as it was before. One writer. All zero is a value that was never
/// written.
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

/// An origin's account as it stood when something happened that an event does not tell. Each event after it is one read
/// in time with one sample, as far as the origin has a schedule.
struct LiveAccount {
  SensorCounts sensor;
  std::uint64_t first_sequence;  ///< 0: none
  Segment segment;               ///< under way, or the last that ended; period 0: none
  LiveGap under_way;
  LiveGap closed;  ///< those that may be in no account of the recording, as one
};

/// What lies apart from the counts of each event, because it is touched less often.
struct alignas(64) LiveSlot {
  std::uint64_t committed;    ///< rows of the run that the recording has, or had; the lane's
  Kept<LiveAccount> account;  ///< the loop's
};

class LiveFile {
 public:
  static constexpr std::uint32_t first_block = 64;
  static constexpr std::uint32_t most_blocks = 14;  // each twice as large as the one before
  static constexpr std::uint32_t most_slots = first_block * ((1u << most_blocks) - 1);

  LiveFile() = default;
  /// Makes the one of a run that begins, with room for `first_block` slots. `recording` is the real path of its file.
  /// Errors: why there is none in any folder; the run's counts are kept in its own memory then.
  static Result<LiveFile> make(const std::string& recording, const std::string& uuid);
  /// What a run has left; nothing when it did not survive or belongs to another file (a copy). `noted`: where it was,
  /// as its lock says. Errors: busy when the run goes on.
  static Result<std::optional<LiveFile>> find(const std::string& recording, const std::string& uuid,
                                              const std::string& noted);
  /// Removes what is left of runs of recordings that are gone, and of this one, whose lock the caller holds and whose
  /// runs are sealed.
  static void remove_left(const std::string& recording);
  LiveFile(LiveFile&& other) noexcept;
  LiveFile& operator=(LiveFile&& other) noexcept;
  /// The file stays unless `remove` was called.
  ~LiveFile();
  explicit operator bool() const noexcept { return fd_ >= 0; }
  const std::string& path() const noexcept { return path_; }

  /// Sets pages aside for this slot; slots are reserved in order. What fails once fails from then on: `is_complete` is
  /// false, in the file too.
  Result<void> reserve(std::uint32_t slot);
  bool has(std::uint32_t slot) const noexcept { return block_of(slot) < most_blocks && blocks_[block_of(slot)].counts; }
  /// Why there is no place for a slot.
  Error no_room() const;
  /// How many slots were reserved.
  std::uint32_t slots() const noexcept;
  /// All that was counted before the file was there is in it, and what follows will be. A kill before that leaves a run
  /// of which it is not known what was published.
  void begin_counting() noexcept;
  /// As before `begin_counting`.
  void pause_counting() noexcept;
  /// Some slots have found no place here.
  bool lacks_room() const noexcept;
  /// Whether all that was counted is here: of each slot, from the beginning on.
  bool is_complete() const noexcept;

  // The slot must exist.
  LiveCounts& counts(std::uint32_t slot) noexcept { return blocks_[block_of(slot)].counts[offset_of(slot)]; }
  LiveSlot& slot(std::uint32_t slot) noexcept { return blocks_[block_of(slot)].slots[offset_of(slot)]; }

  /// Deletes the file, once its counts are in the recording. They stay readable until destruction.
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
  static std::optional<LiveFile> open(const std::string& path, bool& is_held);

  std::string path_;
  int fd_ = -1;
  Header* header_ = nullptr;
  std::array<Block, most_blocks> blocks_{};
};

}  // namespace rtdata::sqlite
