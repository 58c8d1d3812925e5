// The window of the memory functions mean and rate of expressions.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "data/saturating.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

/// The values of the last nanoseconds. Values closer than a thousandth of the window share one entry, so that memory is
/// bounded. Of values with the same time, the last one counts.
class TimeWindow {
 public:
  explicit TimeWindow(Duration length)
      : length_(length), spacing_((length.count() + most - 1) / most), times_(size), values_(size), counts_(size) {}

  /// The mean with this value in it.
  double take_mean(Time time, double value) noexcept {
    const bool is_same = end_ != 0 && time == newest_;
    newest_ = time;
    while (!is_same && first_ != end_ && span_between(time_at(first_), time) >= length_) drop_first();
    if (is_same) {
      values_[place(end_ - 1)] = entry_before_;
      --counts_[place(end_ - 1)];
      back_ = back_before_;
      --back_count_;
    }
    back_before_ = back_;
    entry_before_ = 0;
    if (is_same || (first_ != end_ && span_between(time_at(end_ - 1), time) < spacing_)) {
      entry_before_ = values_[place(end_ - 1)];
      values_[place(end_ - 1)] += value;
      ++counts_[place(end_ - 1)];
    } else {
      push(time, value);
    }
    back_ += value;
    ++back_count_;
    const bool has_front = first_ != middle_;
    const double sum = back_ + (has_front ? values_[place(first_)] : 0);
    return sum / static_cast<double>(back_count_ + (has_front ? counts_[place(first_)] : 0));
  }

  /// The change a second since the oldest value; false when there is none.
  bool take_rate(Time time, double value, double& rate) noexcept {
    while (first_ != end_ && span_between(time_at(first_), time) > length_) ++first_;
    const bool has_one = first_ != end_ && time > time_at(first_);
    if (has_one)
      rate = (value - values_[place(first_)]) /
             (static_cast<double>(span_between(time_at(first_), time).count()) * 1e-9);
    if (first_ == end_ || span_between(time_at(end_ - 1), time) >= spacing_) {
      push(time, value);
    } else if (time == time_at(end_ - 1)) {
      values_[place(end_ - 1)] = value;
    }
    return has_one;
  }

  void clear() noexcept {
    first_ = middle_ = end_ = 0;
    back_ = back_before_ = entry_before_ = 0;
    back_count_ = 0;
  }

 private:
  static constexpr std::int64_t most = 1000;
  static constexpr std::size_t size = 1024;
  static std::size_t place(std::uint64_t n) noexcept { return static_cast<std::size_t>(n % size); }
  Time time_at(std::uint64_t n) const noexcept { return times_[place(n)]; }

  void push(Time time, double value) noexcept {
    times_[place(end_)] = time;
    values_[place(end_)] = value;
    counts_[place(end_)] = 1;
    ++end_;
  }

  /// Entries before middle_ hold the sums from there to middle_, so that no large value leaves its rounding behind when
  /// it goes; the rest is summed in back_. The newest entry is never among the former.
  void drop_first() noexcept {
    if (first_ == middle_) {
      if (end_ - first_ == 1) {
        clear();
        return;
      }
      middle_ = end_ - 1;
      for (std::uint64_t n = middle_ - 1; n != first_; --n) {
        values_[place(n - 1)] += values_[place(n)];
        counts_[place(n - 1)] += counts_[place(n)];
      }
      back_ = values_[place(middle_)];
      back_count_ = counts_[place(middle_)];
    }
    ++first_;
  }

  Duration length_;
  Duration spacing_;
  std::vector<Time> times_;
  std::vector<double> values_;
  std::vector<std::uint64_t> counts_;
  std::uint64_t first_ = 0;
  std::uint64_t middle_ = 0;
  std::uint64_t end_ = 0;
  double back_ = 0;
  std::uint64_t back_count_ = 0;
  Time newest_{};  // of the mean, and the sums without its newest value
  double back_before_ = 0;
  double entry_before_ = 0;
};

}  // namespace rtdata::detail
