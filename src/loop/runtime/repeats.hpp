// Rate limiting of repeated reports: too many equal reports are held back and reported later as one.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "loop/events/allowance.hpp"

namespace rtdata::detail {

/// Several equal reports, joined into one.
template <class What>
struct Joined {
  What what;  // the last of them
  MonotonicTime first{}, last{};
  std::uint64_t count = 0;
};

template <class What>
class Repeats {
 public:
  /// `apart`: the shortest time between two reports of the same key; those in between are joined.
  explicit Repeats(Duration apart) : apart_(apart) {}

  /// The report to make now, joined with held-back ones; empty: this one is held back too.
  std::optional<Joined<What>> take(const std::string& key, What what, MonotonicTime now) {
    auto found = entries_.find(key);
    if (found == entries_.end()) {
      if (entries_.size() >= most) forget_idle(now);
      if (entries_.size() >= most) return Joined<What>{std::move(what), now, now, 1};
      found = entries_.try_emplace(key).first;
    }
    Entry& entry = found->second;
    if (entry.held.count == 0) entry.held.first = now;
    entry.held.what = std::move(what);
    entry.held.last = now;
    ++entry.held.count;
    if (may_report(entry, now)) return spend(entry, now);
    held_until_ = due(entry);
    return std::nullopt;
  }
  /// When the report held back last may be made.
  MonotonicTime held_until() const noexcept { return held_until_; }
  /// Held-back reports that may be made now, in no order.
  std::vector<Joined<What>> take_due(MonotonicTime now) {
    std::vector<Joined<What>> taken;
    for (auto& [key, entry] : entries_) {
      if (entry.held.count != 0 && may_report(entry, now)) taken.push_back(spend(entry, now));
    }
    return taken;
  }
  /// All held-back reports; resets the limits.
  std::vector<Joined<What>> take_all() {
    std::vector<Joined<What>> all;
    for (auto& [key, entry] : entries_) {
      if (entry.held.count != 0) all.push_back(std::move(entry.held));
    }
    entries_.clear();
    return all;
  }
  /// When the first held-back report may be made. Searches all.
  std::optional<MonotonicTime> next_due() const {
    std::optional<MonotonicTime> next;
    for (const auto& [key, entry] : entries_) {
      if (entry.held.count == 0) continue;
      if (!next || due(entry) < *next) next = due(entry);
    }
    return next;
  }

 private:
  static constexpr std::size_t most = 16384;
  struct Entry {
    Allowance allowance;
    MonotonicTime reported{MonotonicTime::min().time_since_epoch() / 2};
    Joined<What> held;
  };
  MonotonicTime due(const Entry& entry) const noexcept {
    return std::max(later(entry.reported, apart_), MonotonicTime{entry.allowance.has_some_from()});
  }
  bool may_report(Entry& entry, MonotonicTime now) const noexcept {
    return span_between(entry.reported, now) >= apart_ && entry.allowance.has_some(now.time_since_epoch());
  }
  static Joined<What> spend(Entry& entry, MonotonicTime now) {
    entry.reported = now;
    entry.allowance.spend(now.time_since_epoch());
    return std::exchange(entry.held, Joined<What>{});
  }
  void forget_idle(MonotonicTime now) {
    for (auto& [key, entry] : entries_) (void)entry.allowance.has_some(now.time_since_epoch());
    std::erase_if(entries_,
                  [](const auto& one) { return one.second.held.count == 0 && one.second.allowance.is_whole(); });
  }

  const Duration apart_;
  MonotonicTime held_until_{};
  std::unordered_map<std::string, Entry> entries_;
};

}  // namespace rtdata::detail
