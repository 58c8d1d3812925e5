// Estimates when a backlog is empty, at the speed of the last seconds. Loop's thread.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "data/saturating.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::detail {

class CatchUp {
 public:
  /// Notes the number of waiting events; may be called at any rate.
  void note(MonotonicTime now, std::uint64_t waits) noexcept {
    if (count_ > 0 && span_between(looks_[(count_ - 1) % looks_.size()].at, now) < step) return;
    looks_[count_++ % looks_.size()] = {now, waits};
  }
  /// Restarts the estimate after a failure of sending.
  void restart() noexcept { count_ = 0; }
  /// Empty: the backlog does not shrink, or this is not known yet.
  std::optional<Duration> at(MonotonicTime now, std::uint64_t waits) const noexcept {
    if (waits == 0) return Duration{0};
    for (std::size_t i = count_ > looks_.size() ? count_ - looks_.size() : 0; i < count_; ++i) {
      const Look& then = looks_[i % looks_.size()];
      const Duration span = span_between(then.at, now);
      if (span > reach) continue;
      if (span < step || then.waits <= waits) return std::nullopt;
      const double pace = static_cast<double>(then.waits - waits) / static_cast<double>(span.count());
      const double ns = static_cast<double>(waits) / pace;
      if (ns > static_cast<double>(Duration::max().count()) / 2) return std::nullopt;
      return Duration{static_cast<Duration::rep>(ns)};
    }
    return std::nullopt;
  }

 private:
  static constexpr Duration step = std::chrono::seconds{1};
  static constexpr Duration reach = std::chrono::seconds{20};
  struct Look {
    MonotonicTime at{};
    std::uint64_t waits = 0;
  };
  std::array<Look, 16> looks_{};
  std::size_t count_ = 0;  // of all looks; the last of them are kept
};

}  // namespace rtdata::detail
