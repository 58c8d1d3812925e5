// The live view of a run on a terminal: a line for each topic, redrawn in place.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include "app/account.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::app {

/// Keeps the last event of each topic, by a subscription of its own. Thread: the loop's.
class LiveView {
 public:
  explicit LiveView(Loop& loop);

  /// What to write to a terminal of so many columns and rows so that it shows how things stand, over what was shown
  /// before. `note`: a last line, such as the last error; may be empty.
  std::string frame(const RunAccount& account, std::size_t columns, std::size_t rows, std::string_view note);
  /// What to write at the end: the view goes, and the cursor is seen again.
  std::string end();

 private:
  struct Last {
    std::vector<std::byte> payload;
    const Description* description = nullptr;  // the runtime's topic keeps it alive
    std::uint64_t events_before = 0;
  };
  static std::string value_text(const Last& last, std::size_t width);

  Loop& loop_;
  std::map<std::string, Last, std::less<>> last_;
  MonotonicTime started_;
  MonotonicTime drawn_{};
  std::size_t lines_ = 0;
  Subscription subscription_;
};

}  // namespace rtdata::app
