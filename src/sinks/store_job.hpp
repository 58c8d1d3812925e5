// The work of a sink's lane: stores what is queued.
#pragma once

#include <memory>
#include <optional>
#include <utility>

#include "rtdata/loop/lane.hpp"
#include "sinks/sink_queue.hpp"

namespace rtdata::detail {

class SinkNode;

/// What the lane tells of one turn of work.
struct StoreResult {
  Result<void> result;
  bool has_ended = false;    ///< the writer said that it has: nothing is tried again
  bool was_closing = false;  ///< the writer was closed, if the result is good
  bool was_syncing = false;  ///< all that was stored was synced, if the result is good
  std::uint64_t refused = 0;
  Error refusal;            ///< the first of them
  std::string topic_fault;  ///< why a topic can never be stored; empty: all can
  std::optional<Error> warning;

  bool has_closed() const noexcept { return was_closing && (result || has_ended); }
};

class StoreJob final : public LaneJob {
 public:
  explicit StoreJob(std::shared_ptr<SinkQueue> queue_) : queue(std::move(queue_)) {}
  void run() noexcept override {
    if (pause.count() > 0) queue->pause(std::exchange(pause, Duration{0}));
    StoreResult now;
    now.was_closing = closing;
    try {
      now.result = queue->process();
      if (now.result && syncing) now.result = queue->sync_writer();
      now.was_syncing = syncing;
      if (now.result && closing) now.result = queue->close_writer();
    } catch (...) {  // no memory, not even for an error: the batch is tried again
      now.result = Error{Errc::io_failed, "cannot store", "", "no memory", ""};  // texts that need none
    }
    now.has_ended = queue->has_ended();
    try {
      now.refused = queue->take_refusals(now.refusal);
      now.topic_fault = queue->topic_fault();
      now.warning = queue->writer().take_warning();
    } catch (...) {  // a warning less
    }
    came_of_it = std::move(now);
  }
  void done(Outcome outcome) override;

  std::shared_ptr<SinkQueue> queue;
  SinkNode* owner = nullptr;  // null once the sink is gone
  bool closing = false;       // the writer is closed when all is stored
  bool syncing = false;       // it is to survive a power cut when all is stored
  Duration pause{0};          // before the work

  /// What came of it. The lane's from submission until `done`, which takes it: from then on the job may be at work again.
  StoreResult came_of_it;
};

}  // namespace rtdata::detail
