// Takes the events of a sink's topics and the accounts of their origins. Loop's thread.
#pragma once

#include <cstddef>
#include <memory>
#include <set>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "sinks/core/sink_notes.hpp"
#include "sinks/core/sink_queue.hpp"
#include "sinks/core/sink_tap.hpp"

namespace rtdata::detail {

class SinkAccount {
 public:
  explicit SinkAccount(std::shared_ptr<SinkQueue> queue) : queue_(std::move(queue)) {}

  /// Takes the events of a topic from now on. Errors: the writer's.
  Result<void> add_topic(TopicCore& topic, SinkNode& sink);
  /// Counts its events as refused from now on.
  void refuse_topic(TopicCore& topic, SinkNode& sink) { add_tap(topic, sink, SinkTap::Takes::none); }
  /// Also stores the accounts of the source topics of a taken origin, and of their sources, without rows. Only for
  /// recordings.
  void follow(OriginCore& origin, SinkNode& sink);
  /// The same for all present origins. The data of tiers so far must have been taken.
  void follow_all(SinkNode& sink);
  /// A topic has been made that is not taken: it may be one of them.
  void follow_new(TopicCore& topic, SinkNode& sink);
  /// One of them is counted on another loop already, and `follow_all` is to be called. Asked once.
  bool is_follow_due() noexcept { return std::exchange(is_follow_due_, false); }
  /// Gives the writer, which was opened at set-up, the account of each origin.
  void keep_all(LoopCore& loop) noexcept;
  /// A recording has begun, or ended.
  void look_at_runs() {
    for (const auto& tap : taps_) tap->look_at_run();
  }
  /// Takes no more events.
  void end() noexcept;

  /// Records the current gaps as ended. Those of another loop end there.
  void close_gaps() noexcept;

  void add(OriginCore& origin, const Gap& gap);
  void add(OriginCore& origin, const Segment& segment);
  /// True if there is a schedule, whose ticks change the account even without events.
  bool goes_on_by_itself() const noexcept;
  SinkNotes notes;  ///< other data to record

  /// A part of the account, or all, for origins that changed since the last one.
  enum class Part { first, next, last };  // the last one has all origins at once
  struct Enqueued {
    bool is_something = false;  ///< there was something to account for, and the queue has it
    bool has_more = false;      ///< another part follows
  };
  /// True if `enqueue` may be called: not while the queue holds too many parts. There is always space for the last one.
  bool has_room() const noexcept { return queue_->has_account(); }
  /// Puts a part of the account into the queue. `at`: now; `until`: ticks are counted up to then; `unknown`: which
  /// counts the account lacks, and why, or empty.
  /// Throws when there is no memory, with nothing changed.
  Enqueued enqueue(Part part, Time at, MonotonicTime until, const std::string& unknown);

 private:
  void add_tap(TopicCore& topic, SinkNode& sink, SinkTap::Takes takes);
  SinkTap* find_tap(const OriginCore& origin) const;
  enum class Tiers { caught_up, ahead };
  void follow(OriginCore& origin, SinkNode& sink, Tiers tiers);
  void follow(TopicCore& topic, SinkNode& sink, Tiers tiers);

  const std::shared_ptr<SinkQueue> queue_;
  std::vector<std::unique_ptr<SinkTap>> taps_;
  std::unordered_map<const TopicCore*, SinkTap*> tap_of_;
  std::set<std::string, std::less<>> awaited_;  // source topics that do not exist yet
  bool is_follow_due_ = false;
  std::uint64_t accounts_ = 0;  // handed over
  std::size_t next_topic_ = 0;  // where the next part begins
  std::size_t next_origin_ = 0;
};

}  // namespace rtdata::detail
