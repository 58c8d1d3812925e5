// Takes the events of one topic for a sink: copies each event into the queue when it is published.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "loop/events/origin_core.hpp"
#include "loop/events/topic_core.hpp"
#include "sinks/core/sink_queue.hpp"

namespace rtdata::detail {

class SinkNode;

class SinkTap final : public Tap {
 public:
  /// none: the sink cannot take the topic and counts each event as refused. account: only the account of a source topic
  /// is stored; its published events count as filtered.
  enum class Takes { all, none, account };
  /// `number`: of the topic within the sink.
  SinkTap(SinkNode& sink, std::shared_ptr<SinkQueue> queue, TopicCore& topic, std::uint32_t number, Takes takes);

  void offer(OriginCore& origin, Time time, std::uint64_t sequence, const void* payload) override;
  void miss(OriginCore& origin, std::uint64_t count, std::uint64_t last_sequence) override;
  void expect(OriginCore& origin) override;
  void note_change(OriginCore& origin) noexcept override { keep(origin, Now::between_events); }
  bool takes_events() const noexcept override { return takes_ != Takes::account; }
  /// A gap of the origin has closed. `accounts`: the number of accounts handed over so far.
  void note_closed(OriginCore& origin, const Gap& gap, std::uint64_t accounts) noexcept;
  /// A segment of the origin has ended; `segment` is the part to record. The writer keeps it until the next one begins,
  /// since no stored account may have it yet.
  void note_ended(const OriginCore& origin, const Segment& segment) noexcept;
  /// Gives the writer the account of each origin.
  void keep_all() noexcept;
  /// A recording has begun, or ended: later events may belong to another run.
  void look_at_run();
  /// From here on the origins' accounts that the writer keeps are not changed any more.
  void end() noexcept { is_ended_ = true; }

  TopicCore& topic() const noexcept { return topic_; }
  std::uint32_t slot_of(const OriginCore& origin) const noexcept { return places_[origin.index].slot; }
  /// The origin's account as it is now, with the segment under way as if it ended at `until`.
  OriginAccount account_of(const OriginCore& origin, MonotonicTime until) const noexcept;
  /// True if the origin has or may have events here.
  bool knows(const OriginCore& origin) const noexcept {
    return origin.index < places_.size() && places_[origin.index].live != nullptr;
  }
  /// The part of a segment that came due since this was attached; `scheduled` 0: none.
  Segment since_attached(const OriginCore& origin, Segment segment) const noexcept;
  /// Notes that this account is handed over. False: it equals the one handed over before.
  bool is_news(const OriginCore& origin, const OriginAccount& account);

 private:
  /// The data that each event of an origin touches.
  struct OriginSlot {
    LiveCounts* live = nullptr;  // null: it has no slot yet
    SlotStored* stored = nullptr;
    std::uint64_t first_sequence = 0;
    std::uint64_t last_sequence = 0;
    std::uint64_t course = 0;  // of its counts at the last event
    std::uint32_t slot = 0;
  };
  /// The counts of an origin when this was attached.
  struct Before {
    SensorCounts counts;
    Segment segment;  // under way
  };
  /// The gaps that have closed and may be missing from the stored accounts, joined into one.
  struct Closed {
    Gap gap;
    std::uint64_t accounts = 0;  // the number handed over when the last of them closed
    bool is_any = false;
  };
  enum class Now { at_an_event, between_events };
  void begin_slot(const OriginCore& origin);
  void keep(const OriginCore& origin, Now now) noexcept;

  SinkNode& sink_;
  const std::shared_ptr<SinkQueue> queue_;
  TopicCore& topic_;
  const std::uint32_t number_;
  const Takes takes_;
  const std::size_t payload_bytes_;
  const std::size_t record_bytes_;
  std::vector<OriginSlot> places_;        // by the origin's index within the topic, as the next
  std::vector<OriginAccount> accounted_;  // as last handed over
  std::vector<Before> before_;            // of those that were there
  std::vector<Closed> closed_;
  std::vector<Segment> ended_;  // the last one, while none is under way
  std::string run_;             // that the slots are of; of a recording, which has its own, empty
  bool is_ended_ = false;
};

}  // namespace rtdata::detail
