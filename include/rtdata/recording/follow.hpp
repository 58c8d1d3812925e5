/// Follow: the rows of a recording in the order in which they were stored, some at a time, also while it is written.
///
///     auto rows = rtdata::RecordingFollower::open("run.db", {.topics = {"room/#"}, .from = launch}).or_throw();
///     const auto print_row = [](const rtdata::RecordedRow& row) {
///       print(row.run(), row.event());
///       return rtdata::RecordingFollower::Goes::on;
///     };
///     while (rows.read(100ms, print_row).or_throw()) {
///     }
///     // Later, what was stored since: rows.read(100ms, print_row)
///
/// Each call reads in its own transaction, so the writer cannot copy and truncate its WAL file during a call. Within
/// a call, rows come in order of run and time; in each table the next call continues after the last row read, so a row
/// that was stored late is not missed. A row that a limit deleted before it was read does not come: the sequence of
/// its origin then has a hole.
///
/// Owner: the holder. Thread: one at a time. Times are as they were recorded. Errors: those of Recording; damaged,
/// which names the row.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/data/time.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata {

class RecordingFollower {
 public:
  struct Config {
    std::vector<std::string> topics = {"#"};  ///< patterns; topics of "$rtdata/" only when written out
    Time from = Time::min();                  ///< the first time taken
  };
  static Result<RecordingFollower> open(const std::string& path, Config config);
  RecordingFollower(RecordingFollower&&) noexcept;
  RecordingFollower& operator=(RecordingFollower&&) noexcept;
  ~RecordingFollower();

  /// Calls `take` with the next rows, each valid for the call, for about this long, or until it says that it has
  /// enough. True: there are more by now.
  enum class Goes { on, enough };
  Result<bool> read(Duration at_most, const std::function<Goes(const RecordedRow& row)>& take);
  /// What it reads.
  const Recording& recording() const noexcept;

 private:
  struct Core;
  explicit RecordingFollower(std::unique_ptr<Core> core);
  std::unique_ptr<Core> core_;
};

}  // namespace rtdata
