// The sending side of a bridge.
#pragma once

#include <cstdint>
#include <deque>
#include <string>
#include <string_view>
#include <unordered_map>

#include "loop/core/deadline.hpp"
#include "loop/events/listener.hpp"
#include "loop/tier/channel.hpp"

namespace rtdata::detail {

struct Announcement;
class Bridge;
class LoopCore;

/// Thread: the sending loop's. It runs no user code and keeps reports for later.
class BridgeSender final : public Listener {
 public:
  BridgeSender(Bridge& bridge, LoopCore& from, LoopCore& to, ByteRing& ring);
  ~BridgeSender();
  BridgeSender(const BridgeSender&) = delete;
  BridgeSender& operator=(const BridgeSender&) = delete;

  Result<void> on_topic(TopicCore& topic) override;
  void on_gap(OriginCore& origin, const Gap& gap) override;
  void on_segment(OriginCore& origin, const Segment& segment) override;
  void on_made_of(OriginCore& origin) override;
  void on_error(Time first, Time last, std::string_view object, const Error& error, std::uint64_t count) override;
  void on_health(Time first, Time last, const HealthChange& change, std::uint64_t count) override;

  /// This loop has claimed the name: announces that it publishes under it. std::bad_alloc.
  void open(OriginCore& origin);
  /// Sends the sensors' state at the end of this turn.
  void send_soon() noexcept { next_accounts_ = {}; }

  /// Makes sent data visible to the other side and wakes it.
  void wake() noexcept;
  /// The end of a turn: sends accounts, and wakes the other side.
  void turn_done();
  /// Sends the state of all sensors now. Returns how many are left because the ring is full.
  std::size_t send_accounts();
  struct AccountsSent {
    std::size_t left;      // as `send_accounts` returns it
    std::size_t position;  // the ring position up to which the other side must take data
  };
  /// Sends the complete accounts of all sensors, including current gaps.
  AccountsSent send_all_accounts();
  /// False: there is no room for the count of drops.
  bool send_drops(Passage& passage, ByteRing::Room room) noexcept;
  /// Wakes the other side before the end of the turn if much waits, so that both work at the same time.
  void make_known(std::size_t before) noexcept {
    if (ring_.completes_burst(before)) wake();
  }
  void report_lost_entries(LoopCore& on);

 private:
  using Sort = BridgeRecord::Sort;
  Channel* channel_of(const TopicCore& topic) noexcept;
  /// Null: it has none.
  Passage* passage_of(const OriginCore& origin) noexcept;
  /// `room`: `all` also takes the eighth of the ring that events cannot fill. It is for gaps, segments, and accounts
  /// that must be sent now.
  template <class RecordType>
  RecordType* reserve(Sort sort, const Passage& passage, ByteRing::Room room) noexcept;
  /// False: there is no room for it.
  bool send_account(Passage& passage, ByteRing::Room room) noexcept;
  void send_some_accounts();
  AccountSummary summary_of(const OriginCore& origin) const noexcept;
  void take_snapshot(const OriginCore& origin, OriginSnapshot& to) const noexcept;
  void add_entry(const OriginCore& origin, const std::variant<Gap, Segment>& entry);
  bool send_entry(const LedgerEntry& entry) noexcept;
  bool send_waiting_entries() noexcept;
  void announce(Announcement announcement);

  Bridge& bridge_;
  LoopCore& from_;
  LoopCore& to_;
  ByteRing& ring_;
  const bool is_to_main_;  // true: the other loop is the main loop, which has the sinks
  std::deque<Channel> channels_;
  std::unordered_map<const TopicCore*, Channel*> channel_by_topic_;
  std::deque<Passage> passages_;
  bool has_announced_ = false;  // since the other side was woken
  /// Accounts are sent some time after a change, and not without changes.
  struct Reminder final : Deadline {
    explicit Reminder(BridgeSender& sender_) : sender(sender_) {}
    void fire(MonotonicTime) override;
    BridgeSender& sender;
  };
  Reminder reminder_{*this};
  bool is_reminded_ = false;
  MonotonicTime next_accounts_{};
  std::size_t next_account_ = 0;
  std::size_t accounts_left_ = 0;    // to be looked at since something happened last
  std::deque<LedgerEntry> waiting_;  // found no room yet; before any account
  std::uint64_t entries_lost_ = 0;   // too many waited
};

}  // namespace rtdata::detail
