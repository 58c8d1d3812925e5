// The work of a sink's lane: stores what is queued.
#pragma once

#include <memory>
#include <optional>
#include <utility>

#include "rtdata/loop/lane.hpp"
#include "sinks/sink_queue.hpp"

namespace rtdata::detail {

class SinkNode;

class StoreJob final : public LaneJob {
 public:
  explicit StoreJob(std::shared_ptr<SinkQueue> queue_) : queue(std::move(queue_)) {}
  void run() noexcept override {
    if (pause.count() > 0) queue->pause(std::exchange(pause, Duration{0}));
    result = queue->process();
    if (result && closing) result = queue->close_writer();
    has_ended = queue->has_ended();
    refused = queue->take_refusals(refusal);
    try {
      topic_fault = queue->topic_fault();
      warning = queue->writer().take_warning();
    } catch (...) {  // a warning less
    }
  }
  void done(Outcome outcome) override;

  std::shared_ptr<SinkQueue> queue;
  SinkNode* owner = nullptr;  // null once the sink is gone
  bool closing = false;
  Duration pause{0};  // before the work
  bool has_ended = false;
  Result<void> result;
  std::uint64_t refused = 0;
  Error refusal;
  std::string topic_fault;  // why a topic can never be stored; empty: all can
  std::optional<Error> warning;
};

}  // namespace rtdata::detail
