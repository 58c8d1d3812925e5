// One replay: publishes a recording's events on the topics at their times. Private to the replay.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "loop/core/deadline.hpp"
#include "loop/core/handler.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "recording/replay_source.hpp"
#include "rtdata/recording/replay.hpp"

namespace rtdata::detail {

class ReplayNode final : public SensorEntry, public Deadline {
 public:
  ReplayNode(LoopCore& loop, ReplayConfig config);

  // ---- SensorEntry
  void stop() override {
    halt();
    for (const Origin& origin : origins_)
      if (origin.core != nullptr) origin.core->topic.cancel(*origin.core);
  }
  const OriginCore& origin() const noexcept override { return *own_; }
  Duration schedule_period() const noexcept override { return Duration{0}; }
  bool is_active() const noexcept override { return !is_done_; }
  Health health() const noexcept override { return health_; }
  std::string_view reason() const noexcept override { return reason_; }
  void stop_schedule(MonotonicTime) override { halt(); }
  bool is_reading() const noexcept override { return false; }

  // ---- Deadline
  void fire(MonotonicTime now) override;

  void portion_is_ready();
  bool is_done() const noexcept { return is_done_; }
  ReplayCounts counts() const noexcept { return counts_; }
  std::int64_t run() const noexcept { return run_.run; }
  Handler<Result<void>> on_done;

 private:
  struct Topic {
    RecordedTopic recorded;
    TopicCore* core = nullptr;
  };
  struct Origin {
    OriginCore* core = nullptr;         // null: it cannot be replayed
    std::optional<LedgerEntry> ledger;  // whole, when its account is replayed
    std::vector<Segment> segments;      // then
    std::uint64_t given = 0;            // events, and those that were refused
  };

  void choose_topics(const Recording& recording);
  void find_origins(const Recording& recording, RowFilter& filter, std::vector<ReplayOrigin>& known);
  /// For a whole run, finds the topics whose accounts are replayed without events: those that have no rows, and sources
  /// of derived topics that are not chosen. False: some account cannot be replayed.
  bool find_sources(const Recording& recording, const std::vector<LedgerEntry>& ledger,
                    std::map<std::pair<std::string, std::string>, std::vector<Segment>>& segments);
  std::string renamed(const std::string& topic) const;
  std::vector<std::string> renamed(const std::vector<std::string>& topics) const;
  void add_origin(const ReplayOrigin& found, std::optional<LedgerEntry> ledger, std::vector<Segment> segments);
  void leave() noexcept;

  MonotonicTime due_of(std::int64_t time) const noexcept;
  /// Publishes due events; sets `due` for the next one. False: no event is available.
  bool give_due(MonotonicTime now);
  void give(const ReplayPortion::Entry& entry);
  void give_event(Origin& origin, const ReplayPortion::Entry& entry);
  void give_gap(Origin& origin, const Gap& gap);
  void give_health(std::int64_t up_to);
  void count_holes(Origin& origin, std::uint64_t count, std::uint64_t last);
  void refuse(const std::string& why);
  void wait_until(MonotonicTime at) noexcept;
  void read_next();
  /// True if all events were published.
  void finish(const Result<void>& how);
  /// Stops publishing.
  void halt() noexcept;
  /// Checks at the end of a whole run that all events of its accounts were published.
  Result<void> look_whether_all_came() const;
  void end_account(Origin& origin, bool is_complete) noexcept;
  /// Publishes the accounts of topics without events, for a whole run.
  void give_sources() noexcept;
  void report_end(bool is_complete);

  void on_close() noexcept override;
  void drop_callbacks() noexcept override { on_done.reset(); }

  const ReplayConfig config_;
  const std::string callback_name_;
  std::vector<std::pair<std::string, std::string>> renamings_;
  RunInfo run_;
  Time base_{};  // is given when it starts
  std::vector<Topic> topics_;
  std::vector<Origin> origins_;
  struct Source {
    LedgerEntry ledger;
    std::vector<Segment> segments;
    std::vector<Gap> gaps;
  };
  std::vector<Source> sources_;
  std::vector<RecordedHealth> health_changes_;
  std::size_t next_health_ = 0;
  OriginCore* own_ = nullptr;
  std::shared_ptr<ReplaySource> source_;
  std::shared_ptr<ReplayJob> jobs_[2];  // one is given while the other is read
  std::size_t current_ = 0;
  std::size_t next_entry_ = 0;
  bool is_portion_begun_ = false;
  std::unique_ptr<Lane> lane_;
  MonotonicTime started_{};
  Time last_given_{};
  ReplayCounts counts_;
  Health health_ = Health::ok;
  std::string reason_;
  bool is_started_ = false;
  bool is_aligned_ = false;  // the loop's time is that of the run: what is recorded again lies within its run
  bool is_done_ = false;
  bool has_told_refused_ = false;
  bool has_ref_ = false;
};

}  // namespace rtdata::detail
