// The part of verify that compares rows, gaps and schedule of an origin.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "rtdata/recording/recording.hpp"

namespace rtdata::detail {

/// For an origin whose reads each gave one sample with the time of the read, in a closed run: each tick of its schedule
/// is a row or lies in exactly one gap. The n-th row begins at its tick (the n-th tick outside gaps) or later, and
/// before the tick after the next taken one; each read without a new sample allows one tick more. If each row has
/// exactly one possible tick, the number of late rows and the sum of their lateness must equal the ledger.
class TickCheck {
 public:
  static constexpr std::size_t most_sentences = 5;

  /// True if the rows of this origin can be compared with its ticks.
  static bool is_held(const LedgerEntry& entry);
  /// `segments` and `gaps`: those of this origin, in order of time. `line`: of the run; outlives this.
  TickCheck(const LedgerEntry& entry, const std::vector<const RecordedSegment*>& segments,
            const std::vector<const RecordedGap*>& gaps, const UtcLine& line);

  void add(std::int64_t time, std::uint64_t sequence);
  /// The lateness of the rows, only if the tick of each row is known and no row is missing.
  struct Lateness {
    std::uint64_t late;
    std::uint64_t sum;
  };
  std::optional<Lateness> lateness() const noexcept {
    if (!is_exact_ || rows_ != taken_) return std::nullopt;
    return lateness_;
  }
  const std::vector<std::string>& sentences() const noexcept { return sentences_; }
  std::uint64_t more() const noexcept { return mistakes_ - sentences_.size(); }

 private:
  /// Consecutive ticks of one segment. `taken` of them were read: all, or all except those in joined gaps, whose places
  /// are unknown.
  struct Stretch {
    std::size_t segment;
    std::int64_t first;  // due
    std::int64_t period;
    std::uint64_t ticks;
    std::uint64_t taken;
    std::uint64_t before;  // taken in all earlier stretches
    std::int64_t late_after;
    std::int64_t earliest(std::uint64_t n) const noexcept {
      return first + static_cast<std::int64_t>(n - before) * period;
    }
    std::int64_t latest(std::uint64_t n) const noexcept {
      return first + static_cast<std::int64_t>(ticks - taken + n - before) * period;
    }
  };
  /// `before`: gaps that begin then or later belong to another segment.
  void add_segment(std::size_t number, const Segment& segment, Time before, const std::vector<const RecordedGap*>& gaps,
                   std::size_t& next_gap);
  void add_stretch(std::size_t segment, const Segment& of, std::int64_t first_tick, std::uint64_t ticks,
                   std::uint64_t missing);
  /// The stretch with the n-th taken tick; null when there are fewer.
  const Stretch* find(std::uint64_t n, std::size_t& near) const;
  void mistake(std::string sentence);
  std::string utc(Time recorded) const { return to_iso8601(line_->utc(recorded)); }
  std::string utc(std::int64_t recorded) const { return utc(from_nanoseconds(recorded)); }
  std::string describe(const RecordedGap& gap) const {
    return "the gap of " + utc(gap.first) + " (" + gap.kind + ", " + gap.reason + ")";
  }

  const UtcLine* line_;
  std::vector<Stretch> stretches_;
  std::uint64_t taken_ = 0;
  std::uint64_t first_sequence_;
  std::uint64_t carried_;
  std::uint64_t more_ticks_;  // ticks that were taken and brought nothing to publish
  std::size_t lower_ = 0, upper_ = 0;
  std::vector<std::string> sentences_;
  std::uint64_t mistakes_ = 0;
  bool is_exact_;  // the tick of each row is known
  std::uint64_t rows_ = 0;
  Lateness lateness_{};
};

}  // namespace rtdata::detail
