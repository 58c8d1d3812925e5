// The row source of a sink with `through`: committed rows of a recording that the sink has not stored yet.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::detail {

class SinkQueue;

struct RowFeedConfig {
  std::string sink;                 ///< the name of the sink, under which its position is stored
  std::vector<std::string> topics;  ///< patterns
  From from = From::now;
  /// The times of its rows: as recorded, or UTC as known when they are read.
  enum class Times { recorded, utc } times = Times::recorded;
  std::size_t rows = 0;  ///< about how many are put into the queue at a time
};

/// Rows, since the sink was attached.
struct FeedCounts {
  std::uint64_t offered = 0;  ///< committed, of its topics; those that waited when it was attached too
  std::uint64_t removed = 0;  ///< deleted by a limit of the recording before they were stored
  std::uint64_t backlog = 0;  ///< wait in the recording
  std::uint64_t bytes = 0;    ///< of those, their payloads
  Time oldest{};              ///< of those; 0: none
  bool is_known = false;      ///< it has looked into the recording
};

/// Thread: the sink's lane, or its loop while the lane is idle. The loop may call `counts` at any time.
class RowFeed {
 public:
  virtual ~RowFeed() = default;
  /// Called before all other calls and before the writer is opened, so that "now" does not depend on the peer. Called
  /// again while the peer is away, to update the backlog.
  virtual Result<void> attach() = 0;
  /// Puts the next rows into the queue; no batch may be in progress. False: there are none.
  virtual Result<bool> fill(SinkQueue& queue) = 0;
  /// The first `rows` rows of the last `fill` are done and need not come again.
  virtual void settled(std::size_t rows) noexcept = 0;
  /// One row was refused. May be called again for the same row.
  virtual void refused(const SlotInfo& slot, std::uint64_t sequence, const Error& why) = 0;
  /// The recording has committed something: counts it. While the lane is idle.
  virtual void note_committed() = 0;
  /// Unsettled rows of the queue will be supplied again.
  virtual void forget() noexcept = 0;
  virtual FeedCounts counts() const noexcept = 0;
  /// The file of the recording.
  virtual const std::string& path() const noexcept = 0;
  /// To be called on the recording's lane once that is closed and has its last account. What it returns goes to the
  /// log.
  virtual void at_end(std::function<std::string()> call) = 0;
  /// Remarks for the user although nothing failed. Called after each job.
  virtual std::vector<std::string> take_remarks() = 0;
};

}  // namespace rtdata::detail
