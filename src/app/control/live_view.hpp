// The live view of a run on a terminal: a line for each topic, redrawn in place. What is not well comes first.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <string>
#include <vector>

#include "app/control/account.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::app {

/// Keeps the last event of each topic, by a subscription of its own. Thread: the loop's.
class LiveView {
 public:
  explicit LiveView(Loop& loop);

  /// The text and control sequences that draw the account over the frame before, on a terminal of this size. `note`:
  /// the last lines, such as the last error; may be empty.
  std::string frame(const RunAccount& account, std::size_t columns, std::size_t rows, std::string_view note);
  /// The control sequences that remove the view and show the cursor again.
  std::string end();

 private:
  struct Last {
    std::vector<std::byte> payload;
    const Description* description = nullptr;  // the runtime's topic keeps it alive
    // Events that came, by their numbers: those that the ring dropped are counted too.
    std::string origin;  // of the last one
    std::uint64_t sequence = 0;
    std::map<std::string, std::uint64_t, std::less<>> other_origins;
    std::uint64_t events = 0;
    MonotonicTime came_at{};
    /// Up to `rate_span` old, one for each drawing since which something came.
    struct Mark {
      std::uint64_t events;
      MonotonicTime came_at;
    };
    std::deque<Mark> marks;
  };
  void note(const EventView& event);
  static std::string value_text(const Last& last, std::size_t width);
  /// From one event to another, so that a sensor at 1 Hz is shown with 1 Hz whenever it is looked at. "-": not known
  /// yet.
  static std::string rate_text(Last& last, MonotonicTime now);

  Loop& loop_;
  std::map<std::string, Last, std::less<>> last_;
  MonotonicTime started_;
  std::size_t lines_ = 0;
  Subscription subscription_;
};

}  // namespace rtdata::app
