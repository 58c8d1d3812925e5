// Sends the parcels of a batch: several in flight at a time, settled in order. Loop's thread.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "data/backoff.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sinks/sender.hpp"
#include "sinks/core/sink_queue.hpp"

namespace rtdata::detail {

class LoopCore;

class Transfer : public std::enable_shared_from_this<Transfer> {
 public:
  /// The sink's interface. A call may end the transfer, but not destroy it.
  class Owner {
   public:
    /// The next rows of the parcels in order: from `first` up to, but not including, `last`.
    virtual void rows_settled(std::size_t parcel, std::size_t first, std::size_t last,
                              std::span<const RefusedRow> refused) = 0;
    virtual void all_settled() = 0;
    /// Nothing is sent for a while.
    virtual void sending_failed(const Error& error) = 0;
    /// Reports an exception although no parcel depends on it.
    virtual void sender_threw(const Error& error) = 0;

   protected:
    ~Owner() = default;
  };

  Transfer(LoopCore& loop, Sender& sender, const SinkConfig& config, Owner& owner);

  /// No parcel is under way. Parcels live until all are settled or `end` was called.
  void begin(std::span<const Parcel> parcels);
  bool is_under_way() const noexcept { return settled_ < entries_.size(); }
  /// It has failed, and waits before it sends again.
  bool is_waiting() const noexcept { return blocked_until_.has_value(); }
  /// The wait is over; the delays begin anew.
  void try_now();
  /// Gives up what is under way. Nothing is sent any more.
  void end() noexcept;

 private:
  friend class rtdata::Answer;
  struct Entry {
    enum class State { waiting, sent, answered } state = State::waiting;
    std::uint64_t transmission = 0;
    MonotonicTime deadline{};
    std::size_t confirmed = 0;  // rows from the first one on, whatever becomes of the others
    std::size_t settled = 0;    // of those
    std::vector<RefusedRow> refused;
    /// The parcel is sent again, without the rows that are confirmed.
    void wait() noexcept {
      state = State::waiting;
      transmission = 0;
      std::erase_if(refused, [this](const RefusedRow& row) { return row.row >= confirmed; });
    }
  };
  Entry* awaited(std::size_t parcel, std::uint64_t transmission) noexcept;
  void acknowledge(std::size_t parcel, std::uint64_t transmission);
  void confirm(std::size_t parcel, std::uint64_t transmission, std::size_t rows);
  std::size_t confirmed(std::size_t parcel, std::uint64_t transmission) noexcept;
  void refuse(std::size_t parcel, std::uint64_t transmission, std::size_t row, Error why);
  void again(std::size_t parcel, std::uint64_t transmission, const Error& why, std::optional<Duration> after);
  /// Sends what may be sent, and settles what is answered.
  void go_on();
  void send_some();
  /// How many parcels must be settled before this one is sent: for a parcel with final accounts all others, because
  /// parcels in flight may overtake each other; otherwise none.
  std::size_t due_before(std::size_t parcel) const noexcept;
  void send(std::size_t parcel);
  void settle_some();
  void settle_rows(std::size_t parcel, std::size_t last);
  void wait_after(const Error& why, std::optional<Duration> after);
  void give_up(const Error& why);
  void timer_fired();
  void set_timer();
  /// The first parcel under way.
  std::optional<MonotonicTime> next_deadline() noexcept;
  bool begin_sender();
  /// An answer was destroyed that nobody gave.
  void left_unanswered(std::size_t parcel, std::uint64_t transmission);
  /// A call of the sender's. Returns what it threw.
  template <class Call>
  std::optional<Error> call_sender(const char* name, Call&& call) noexcept;
  void report(const std::optional<Error>& error) noexcept;

  LoopCore& loop_;
  Sender& sender_;
  const SendingConfig sending_;
  const SinkConfig& config_;
  Owner* owner_;  // null: the transfer has ended
  std::span<const Parcel> parcels_;
  std::vector<Entry> entries_;
  std::size_t next_ = 0;  // before it, none waits
  std::size_t settled_ = 0;
  std::size_t under_way_ = 0;
  std::size_t answered_ = 0;
  std::uint64_t transmissions_ = 0;
  std::uint64_t sending_now_ = 0;  // the transmission that `send` is called for
  bool is_left_unanswered_ = false;
  bool has_begun_ = false;
  bool is_going_on_ = false;
  bool is_more_to_do_ = false;
  Backoff backoff_;
  std::optional<MonotonicTime> blocked_until_;
  MonotonicTime paced_until_{};  // by the limit on bytes
  /// The sent parcels, in the order of their deadlines; those before `first_sent_`, and some in between, are no longer
  /// under way.
  struct Sent {
    std::size_t parcel;
    std::uint64_t transmission;
  };
  std::vector<Sent> sent_;
  std::size_t first_sent_ = 0;
  Timer timer_;
  std::optional<MonotonicTime> timer_at_;  // when it fires: not later than it has to
};

}  // namespace rtdata::detail
