// What a recording holds besides events and counts, between two accounts. Loop's thread.
#pragma once

#include <algorithm>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/sinks/sink.hpp"

namespace rtdata::detail {

/// Bounded, however long storage stalls: then gaps of one origin become one, and errors alike are counted.
class SinkNotes {
 public:
  void add(std::uint32_t slot, const Gap& gap, std::size_t slots) {
    if (gaps_.size() >= std::max<std::size_t>(4096, 2 * slots)) {
      for (auto entry = gaps_.rbegin(); entry != gaps_.rend(); ++entry) {
        if (entry->slot != slot || entry->gap.kind != gap.kind) continue;
        entry->gap.last = gap.last;
        entry->gap.count += gap.count;
        if (entry->gap.reason != gap.reason) entry->gap.reason = "several";
        return;
      }
    }
    gaps_.push_back({slot, gap});
  }

  void add(std::uint32_t slot, const Segment& segment) { segments_.push_back({slot, segment}); }

  void add(Time time, std::string_view object, const Error& error, std::uint64_t count) {
    constexpr std::size_t most_errors = 256;
    for (auto& entry : errors_) {
      if (errors_.size() < most_errors) break;
      if (entry.object == object && entry.id == error.id()) {
        entry.count += count;
        return;
      }
    }
    if (errors_.size() >= 2 * most_errors) return;
    errors_.push_back({time, std::string(object), std::string(error.id()), error.text(), count});
  }

  void add(const ClockPair& pair) { clock_.push_back(pair); }
  bool has_end() const noexcept { return !clock_.empty() && std::string_view(clock_.back().source) == "end"; }

  void move_into(Account& account) {
    move(gaps_, account.gaps);
    move(segments_, account.segments);
    move(errors_, account.errors);
    move(clock_, account.clock);
  }

 private:
  template <class T>
  static void move(std::vector<T>& from, std::vector<T>& to) {
    to.swap(from);  // the memory goes round
    from.clear();
  }

  std::vector<Account::GapEntry> gaps_;
  std::vector<Account::SegmentEntry> segments_;
  std::vector<Account::ErrorEntry> errors_;
  std::vector<ClockPair> clock_;
};

}  // namespace rtdata::detail
