// The implementation of Sink: takes events and the accounts of their origins on the loop; its lane stores them.
// Loop's thread, except the job's `run`.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "data/backoff.hpp"
#include "loop/core/handler.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sinks/sink.hpp"
#include "sinks/core/catch_up.hpp"
#include "sinks/core/sink_account.hpp"
#include "sinks/core/sink_queue.hpp"
#include "sinks/core/transfer.hpp"

namespace rtdata::detail {

class SinkNode final : public Node, public Recorder, public RateMember, public Transfer::Owner {
 public:
  SinkNode(LoopCore& loop, SinkConfig config, std::unique_ptr<Writer> writer);

  /// Takes the topics that there are, and begins to open a writer that is opened at set-up; while the loop does not
  /// run, waits for that. Throws SetupError.
  void attach();

  // ---- Recorder
  Result<void> on_topic(TopicCore& topic) override;
  void on_refusal(const Error& error) override;
  void on_gap(OriginCore& origin, const Gap& gap) override;
  void on_segment(OriginCore& origin, const Segment& segment) override;
  void on_clock(const ClockPair& pair) override;
  void on_configuration(const ConfigurationChange& change) override;
  void on_made_of(OriginCore& origin) override;
  void on_error(Time first, Time last, std::string_view object, const Error& error, std::uint64_t count) override;
  void on_health(Time first, Time last, const HealthChange& change, std::uint64_t count) override;
  SinkStatus status() const override;
  void drain(MonotonicTime deadline, Callback<void(std::uint64_t)> done) override;
  /// The same, for its own `close_deadline`.
  void finish(Callback<void(std::uint64_t)> done) {
    drain(later(loop()->now(), config_.close_deadline), std::move(done));
  }
  /// Sinks of this name that are made from now on are `held` until this one has ended.
  void end_before(const std::string& successor) { comes_before_.push_back(successor); }
  bool wants(std::string_view topic) const noexcept override;
  SinkNode* as_sink() noexcept override { return this; }

  // ---- batches by time
  void tick(const Tick&) override;
  bool is_idle() const noexcept override;
  std::string blame_name() const override { return object_name(); }
  bool report_times(CallbackStatus& status) const override;

  // ---- called by the taps
  enum class Hand { rows, rows_and_account };
  /// Passes the queue to the lane, now or when the lane is free.
  void hand_over(Hand what);
  /// Stores the queue; calls `done` when it survives a power failure.
  void sync(Callback<void()> done);
  /// Starts the lane, unless it works already or waits for a retry.
  void start_work();
  /// Makes the next account soon. Called for a new origin, schedule or configuration, so that a kill soon after it does
  /// not lose it.
  void account_is_due();
  /// The run of a topic's events for peers: that of the first recording that takes it, otherwise the program's. Empty
  /// for a recording and for a sink with `through`.
  std::string run_of(const TopicCore& topic) const;

  Handler<ErrorReport> on_error_;
  const std::string& name() const noexcept override { return config_.name; }
  SinkCounts counts() const noexcept override { return last_ ? last_->counts : queue_->counts(); }
  Health health() const noexcept { return health_; }
  std::error_code obstacle() const noexcept { return obstacle_; }
  /// True if it waits for its peer's answer, or for a retry while its queue fills. Events in a recording are safe and
  /// do not count.
  bool needs_real_time() const noexcept {
    if (work_ == Work::sending) return !is_fed() || !transfer_->is_waiting();
    return is_attached() && is_waiting() && !is_fed();
  }

 private:
  /// The states of the sink's life, in this order.
  enum class Life {
    made,      // not on the runtime yet, or could not be opened
    attached,  // takes events
    closing,   // takes no more events; the queued ones are stored
    closed,    // the writer is closed
    left,      // off the runtime: the last counts hold
  };
  /// The state of the lane.
  enum class Work {
    idle,
    opening,
    storing,
    sending,             // nothing: the loop sends what it has encoded
    waiting,             // for the retry after an error
    waiting_for_thread,  // the same, after the system gave none
    held,                // until the sinks have ended that use its file
  };
  /// A job of the lane. Shared with the lane's thread, which may be abandoned with it.
  class Job final : public LaneJob {
   public:
    explicit Job(std::shared_ptr<SinkQueue> queue) : queue_(std::move(queue)) {}
    void run() noexcept override {
      result = queue_->work(turn);
      turn.pause = Duration{0};
    }
    void done(Outcome outcome) override {
      if (sink != nullptr) sink->work_done(outcome);
    }
    SinkNode* sink = nullptr;  // null once the sink is gone
    // The lane's from submission until `done`.
    SinkTurn turn;
    SinkTurnResult result;

   private:
    const std::shared_ptr<SinkQueue> queue_;
  };

  ~SinkNode() override = default;
  bool is_attached() const noexcept { return life_ >= Life::attached && life_ <= Life::closed; }
  bool is_closing() const noexcept { return life_ >= Life::closing; }
  bool is_fed() const noexcept { return queue_->feed() != nullptr; }
  bool is_at_work() const noexcept { return work_ == Work::opening || work_ == Work::storing; }
  bool is_waiting() const noexcept { return work_ == Work::waiting || work_ == Work::waiting_for_thread; }
  std::string object_name() const { return "sink " + config_.name; }
  Result<void> take_topic(TopicCore& topic);
  bool records(std::string_view topic) const noexcept {
    return queue_->is_recording() && is_attached() && !is_closing() && wants(topic);
  }
  /// This recording has begun, or ended: tells the other sinks.
  void report_run() noexcept;

  /// Calls a function that needs memory for a report; without memory the account is marked as incomplete.
  template <class Function>
  void note(Function&& function) noexcept {
    try {
      function();
    } catch (...) {
      had_no_memory_ = true;
    }
  }

  // ---- health and reports: sink_node.cpp
  /// Sets a permanent fault: the first reason stays.
  void fault_for_good(const std::string& reason) noexcept;
  void set_reason(const Error& error) noexcept;
  void report_health();
  void report(const Error& error, std::uint64_t count) noexcept;

  // ---- the account: sink_accounting.cpp
  /// Storing an account costs some pages, however little it contains: while only counts change, one is made now and
  /// then.
  bool is_account_worth_it() const noexcept;
  /// Queues the account of all changes since the last one, or its first part; the others follow. False: nothing was
  /// queued.
  bool begin_account();
  /// Queues a part of the account, or all. False: nothing to report, or no memory; then it is due again.
  bool enqueue_account(SinkAccount::Part part) noexcept;
  void account_timer_fired();
  void follow_timer_fired();
  /// Starts it for what is next, if anything.
  void set_account_timer();

  // ---- storing: sink_storing.cpp
  void wait_for_opening();
  SinkTurn::Task next_task() const noexcept;
  Duration to_utc() noexcept;
  bool is_sync_due() const noexcept;
  std::vector<Callback<void()>> take_synced(const SinkTurnResult& turn);
  /// Waits longer after each failure before the lane is put to work again.
  void retry_later(Work why);
  void stop_waiting();
  void work_timer_fired();
  void work_done(LaneJob::Outcome outcome);
  /// Updates the state after a job and continues storing. Calls no user code.
  void go_on_after(const SinkTurnResult& turn);
  /// Reports and logs the result. Handlers may do anything to this sink, its closing included.
  void report_result(const SinkTurnResult& turn, Health before);
  Error no_thread() const;

  // ---- sending: sink_sending.cpp
  void begin_sending();
  void rows_settled(std::size_t parcel, std::size_t first, std::size_t last,
                    std::span<const RefusedRow> refused) override;
  void all_settled() override;
  void sending_failed(const Error& error) override;
  void sender_threw(const Error& error) override;

  // ---- through a recording: sink_through.cpp
  /// Finds the recording, and is fed by it from now on. Throws SetupError.
  void follow_recording();
  void take_over(const std::string& recording) noexcept;
  void leave_recording() noexcept;
  /// For a recording: the sinks that go through it get no more rows.
  void leave_followers(const char* why) noexcept;
  void commit_within(Duration time);
  /// The recording has committed something.
  void rows_came();
  void note_backlog() noexcept;
  /// For a recording: tells the sinks that go through it.
  void notify_followers();
  void give_up();
  /// For a recording that closes: nothing more is committed until the last account. Not yet due while others still go
  /// through it.
  bool is_end_due() const noexcept { return followers_.empty(); }

  // ---- closing: sink_closing.cpp
  /// The sinks that must end before this one opens anything.
  void wait_for_predecessors();
  void release_successors() noexcept;
  /// Takes no event from here on, and hands over what is left.
  void begin_closing(MonotonicTime deadline);
  void finish_drain();
  /// Takes the sink off the runtime, counting what was not stored as refused.
  std::uint64_t leave() noexcept;
  void on_close() noexcept override;
  /// The lane waits, so the deadline also ends this wait.
  void pause_before_storing(Duration duration);
  void drop_callbacks() noexcept override {
    on_error_.reset();
    syncs_.clear();
  }

  const SinkConfig config_;
  const std::shared_ptr<SinkQueue> queue_;
  SinkAccount account_;
  const std::shared_ptr<Job> job_;
  std::unique_ptr<Lane> lane_;
  Life life_ = Life::made;
  Work work_ = Work::idle;
  Timer work_timer_;  // while the lane waits: tries again; while it opens: tells that this takes long
  Timer account_timer_;
  Timer deadline_;  // the deadline of a drain
  Timer follow_;    // for source topics, when tiers have counted some of them already

  // storing
  bool is_to_open_;                              // in a turn of its own, before anything is stored
  bool is_setting_up_ = false;                   // the constructor waits for that
  std::optional<Error> set_up_error_;            // it throws this
  Backoff backoff_;                              // of retries
  bool is_due_ = false;                          // rows are to be handed over as soon as the lane is free
  std::optional<MonotonicTime> unsynced_since_;  // the first storing since the last sync
  std::vector<Callback<void()>> syncs_;          // that are waited for
  std::size_t syncs_begun_ = 0;                  // how many of these the current turn of work does

  // account
  bool is_between_parts_ = false;          // of an account
  std::optional<MonotonicTime> early_at_;  // when the account of new origins is due
  bool is_account_due_ = false;
  bool is_last_reported_ = false;     // the final account of the run was handed over
  MonotonicTime account_at_{};        // when the latest account was begun
  MonotonicTime next_early_{};        // an early account is made no sooner
  std::uint64_t reported_slots_ = 0;  // the number of slots in the latest account
  bool had_no_news_ = false;          // there was nothing to say in it
  std::uint64_t reported_rows_ = 0;   // of those since the account before it, which are in it
  std::string unknown_;               // what is unknown in the latest account
  bool had_no_memory_ = false;        // an entry of the next account could not be allocated

  // health
  Health health_ = Health::ok;
  Health published_health_ = Health::ok;  // as last published
  std::string reason_;
  std::error_code obstacle_;             // of the last try
  std::string fault_;                    // why it stays faulted: a topic that it cannot take matches its patterns
  bool error_already_reported_ = false;  // the last error is the same as the one before it

  // sending
  std::shared_ptr<Transfer> transfer_;  // null: the writer is not a Sender
  Duration to_utc_{0};                  // from recorded times, of a sender that goes from memory

  // through a recording
  SinkNode* recording_ = nullptr;     // of this sink; null: none, or it has gone
  std::vector<SinkNode*> followers_;  // sinks that go through this recording
  bool is_readable_ = false;          // this recording is open: its rows may be read
  bool has_all_rows_ = false;         // the recording closes, and all rows are committed
  bool has_given_up_ = false;         // it closes, its peer is away, and the recording has not all rows yet
  bool are_positions_due_ = false;    // of followers: to be stored with the next batch
  CatchUp catch_up_;                  // of the backlog in its recording

  // the end
  std::vector<std::string> comes_before_;               // names
  std::vector<SinkNode*> successors_;                   // that are held until it has ended
  std::vector<SinkNode*> predecessors_;                 // sinks that this one waits for
  std::vector<Callback<void(std::uint64_t)>> drained_;  // called at the end of a drain
  std::optional<SinkStatus> last_;                      // once it has left the runtime
};

}  // namespace rtdata::detail
