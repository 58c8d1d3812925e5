// Data for a recording besides events and counts, between two accounts. Loop's thread.
#pragma once

#include <algorithm>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/sinks/recording_writer.hpp"

namespace rtdata::detail {

/// Bounded, even if storage stalls: then gaps of one origin are joined, and equal errors are counted. Data that does
/// not fit is counted in a separate error.
class SinkNotes {
 public:
  static constexpr std::size_t most_segments = 16384;
  static constexpr std::size_t most_clock_pairs = 16384;  // a replay gives those of a whole boot at once
  static constexpr std::size_t most_health_changes = 1024;
  static constexpr std::size_t most_configurations = 1024;
  static constexpr std::size_t most_configuration_bytes = std::size_t{16} << 20;
  static constexpr std::size_t most_made_of = 16384;
  static constexpr std::size_t most_errors = 512;  // from half of it on, equal errors are counted

  void add(std::uint32_t slot, const Gap& gap, std::size_t slots) {
    std::uint32_t& last = last_gap(slot);
    if (gaps_.size() >= std::max<std::size_t>(4096, 2 * slots) && last < gaps_.size() && gaps_[last].slot == slot) {
      Gap& grown = gaps_[last].gap;
      grown.kind = Gap::Kind::joined;
      grown.first = std::min(grown.first, gap.first);
      grown.last = std::max(grown.last, gap.last);
      grown.count = std::max<std::uint64_t>(grown.count, 1) + std::max<std::uint64_t>(gap.count, 1);
      if (grown.reason != gap.reason) grown.reason = "several";
      return;
    }
    last = static_cast<std::uint32_t>(gaps_.size());
    gaps_.push_back({slot, gap});
  }

  void add(std::uint32_t slot, const Segment& segment) {
    last_gap(slot) = no_gap;  // gaps that are joined lie in one segment
    if (segments_.size() == most_segments) {
      ++lost_segments_;
    } else {
      segments_.push_back({slot, segment});
    }
  }

  void add(Time first, Time last, std::string_view object, const Error& error, std::uint64_t count) {
    for (auto& entry : errors_) {
      if (errors_.size() < most_errors / 2) break;
      if (entry.object == object && entry.id == error.id()) {
        entry.count += count;
        entry.last = std::max(entry.last, last);
        return;
      }
    }
    if (errors_.size() == most_errors) {
      lost_errors_ += count;
      return;
    }
    errors_.push_back({first, std::string(object), std::string(error.id()), error.text(), count, last});
  }

  void add(const ClockPair& pair) {
    if (clock_.size() == most_clock_pairs) {  // the newest says most about later times
      ++lost_clock_pairs_;
      clock_.pop_back();
    }
    clock_.push_back(pair);
  }
  void add(Time first, Time last, const HealthChange& change, std::uint64_t count) {
    if (health_.size() == most_health_changes) {
      lost_health_changes_ += count;
    } else {
      health_.push_back({first, change, count, last});
    }
  }
  void add(const ConfigurationChange& change) {
    const std::size_t bytes = change.object.size() + change.text.size();
    if (configurations_.size() == most_configurations || configuration_bytes_ + bytes > most_configuration_bytes) {
      ++lost_configurations_;
      return;
    }
    configurations_.push_back(change);
    configuration_bytes_ += bytes;
  }
  /// Sets the source topics of a slot's events, from now on.
  void add_made_of(std::uint32_t slot, std::string topics) {
    if (made_of_.size() == most_made_of) {
      ++lost_made_of_;
    } else {
      made_of_.push_back({slot, std::move(topics)});
    }
  }
  bool is_empty() const noexcept {
    return gaps_.empty() && segments_.empty() && errors_.empty() && clock_.empty() && health_.empty() &&
           configurations_.empty() && made_of_.empty();
  }
  bool has_end() const noexcept { return !clock_.empty() && std::string_view(clock_.back().occasion) == "end"; }

  /// Adds an error for data that did not fit. It throws when there is no memory: `move_into`, which is noexcept, must
  /// not call it.
  void report_lost(Time at) {
    report_lost(at, lost_segments_, "segments of schedules");
    report_lost(at, lost_errors_, "errors");
    report_lost(at, lost_clock_pairs_, "pairs of clocks");
    report_lost(at, lost_health_changes_, "changes of health");
    report_lost(at, lost_configurations_, "changes of the configuration");
    report_lost(at, lost_made_of_, "topics of which others are made");
  }
  void move_into(Account& account) noexcept {
    move(gaps_, account.gaps);
    move(segments_, account.segments);
    move(errors_, account.errors);
    move(clock_, account.clock);
    move(health_, account.health);
    move(configurations_, account.configurations);
    move(made_of_, account.made_of);
    configuration_bytes_ = 0;
  }

 private:
  static constexpr std::uint32_t no_gap = ~std::uint32_t{0};
  void report_lost(Time at, std::uint64_t& count, const char* what) {
    if (count == 0) return;
    const Error error{Errc::io_failed, "not kept", what, "too many came while nothing could be stored",
                      "check the storage"};
    errors_.push_back({at, "sink", std::string(error.id()), error.text(), count, at});
    count = 0;
  }
  /// Where in `gaps_` the last one is; anywhere when there is none.
  std::uint32_t& last_gap(std::uint32_t slot) {
    if (slot >= last_gaps_.size()) last_gaps_.resize(2 * std::size_t{slot} + 2, no_gap);
    return last_gaps_[slot];
  }
  template <class T>
  static void move(std::vector<T>& from, std::vector<T>& to) noexcept {
    to.swap(from);  // the memory goes round
    from.clear();
  }

  std::vector<Account::GapEntry> gaps_;
  std::vector<std::uint32_t> last_gaps_;
  std::vector<Account::SegmentEntry> segments_;
  std::vector<Account::ErrorEntry> errors_;
  std::vector<ClockPair> clock_;
  std::uint64_t lost_segments_ = 0;
  std::uint64_t lost_errors_ = 0;
  std::vector<Account::HealthEntry> health_;
  std::uint64_t lost_clock_pairs_ = 0;
  std::uint64_t lost_health_changes_ = 0;
  std::vector<ConfigurationChange> configurations_;
  std::size_t configuration_bytes_ = 0;
  std::uint64_t lost_configurations_ = 0;
  std::vector<Account::MadeOfEntry> made_of_;
  std::uint64_t lost_made_of_ = 0;
};

}  // namespace rtdata::detail
