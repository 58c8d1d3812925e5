// The runtime's interface of sensors and feeds.
#pragma once

#include <optional>
#include <string_view>

#include "rtdata/loop/handle.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

class OriginCore;

/// A sensor or feed in the runtime's list.
class SensorEntry : public Node {
 public:
  using Node::Node;
  virtual void stop() = 0;
  virtual const OriginCore& origin() const noexcept = 0;
  virtual Duration schedule_period() const noexcept = 0;
  virtual bool is_active() const noexcept = 0;
  virtual Health health() const noexcept = 0;
  virtual std::string_view reason() const noexcept = 0;
  /// Ends the schedule at `end`, with all ticks counted; a running read may finish and be published.
  virtual void stop_schedule(MonotonicTime end) = 0;
  virtual bool is_reading() const noexcept = 0;
  /// Counts a read on the stack, if there is one, as in flight in the account.
  virtual void count_read_begun() noexcept {}
  /// Empty for a feed, which is not read.
  virtual std::optional<SensorLoad> load() const { return {}; }

  std::uint32_t place = 0;  ///< in the runtime's list
};

SensorStatus status_of(const SensorEntry& sensor);

}  // namespace rtdata::detail
