// The writer of a PostgresqlSink. On the sink's lane.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "postgresql/connection.hpp"
#include "postgresql/layout.hpp"
#include "postgresql/server_table.hpp"
#include "rtdata/postgresql/sink.hpp"

namespace rtdata::postgresql {

Address address_of(const PostgresqlConfig& config);

/// It has no own account: with `through`, it copies the recording's account.
class PostgresqlWriter final : public Writer {
 public:
  explicit PostgresqlWriter(const PostgresqlConfig& config);

  Result<void> open() override;
  Result<void> write(Batch& batch) override;
  Result<void> flush() override;
  std::function<std::string()> goes_through(const std::string& recording) override;
  Result<void> close() override;

 private:
  struct Slot {
    const SlotInfo* info = nullptr;  // null: nothing is known of it since the connection was made
    std::int64_t run = 0;
    ServerTable* table = nullptr;
    Position stored, pending;
    bool is_touched = false;
  };
  /// Appends and sends all that the server has not. Throws `does_not_fit` for one row of the last transaction.
  void store(const Batch& batch);
  /// Leaves out the refused row if it was the only one of the last transaction; otherwise halves the next transactions
  /// to find it.
  void narrow(const Error& why);
  void begin_transaction();
  /// Refuses the rows that `store` skipped.
  void refuse_rows(Batch& batch);
  void prepare(Slot& slot, const SlotInfo& info);
  std::int64_t run_of(const std::string& uuid);
  /// All that was appended, in one transaction.
  void send();
  std::string positions_sql() const;
  /// In the handler of an exception from a call: rolls back, and returns the error. std::bad_alloc is passed on to the
  /// sink.
  Result<void> failed();
  /// After a failure: the server's positions must be read again.
  void forget() noexcept;

  static constexpr std::size_t every_row = std::numeric_limits<std::size_t>::max();
  const PostgresqlConfig config_;
  const Address address_;
  const std::string machine_;
  Connection connection_;
  std::map<std::string, std::int64_t, std::less<>> runs_;                // by uuid: their numbers on the server
  std::map<std::int64_t, Positions> positions_;                          // by run
  std::map<std::pair<std::string, std::uint64_t>, ServerTable> tables_;  // by topic and the serial of its description
  std::vector<Slot> slots_;
  std::vector<std::uint32_t> touched_;
  std::size_t waiting_bytes_ = 0, waiting_rows_ = 0;
  /// Rows of the batch that the server will never store, by slot and sequence: the batch may come again.
  std::map<std::pair<std::uint32_t, std::uint64_t>, Error> refused_;
  bool has_unfit_topic_ = false;
  std::size_t most_rows_ = every_row;  // of a transaction: fewer while one is looked for that the server refuses

  // with `through`: the account of the recording
  using Clock = std::chrono::steady_clock;
  std::string recording_;  // path; empty: from memory
  Clock::time_point account_due_{};
  std::shared_ptr<std::atomic<bool>> is_there_ = std::make_shared<std::atomic<bool>>(false);
};

}  // namespace rtdata::postgresql
