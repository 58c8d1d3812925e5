// Writes the account of a run into its recording. Thread: the writer's.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "recording/database.hpp"
#include "recording/topic_table.hpp"
#include "rtdata/sinks/recording_writer.hpp"

namespace rtdata::sqlite {

using TopicTables = std::vector<std::unique_ptr<TopicTable>>;  // by topic number; null: it has none yet

/// All functions except `prepare`, `slots_committed`, `committed` and `close` must be called in a transaction; the
/// caller tells when it has committed. A rolled-back transaction leaves no state here.
class AccountWriter {
 public:
  /// Makes missing statements. `database` must outlive them, see `close`; `sums` gets their changes.
  void prepare(Database& database, AccountSums& sums, std::int64_t run, const std::string& boot_id);
  /// Writes the ledger row of each origin before its first data row, because sealing finds the live counts by slot.
  void write_slots(const Batch& batch, const TopicTables& tables);
  void write(const Batch& batch, const Account& account, const TopicTables& tables);
  /// The rows of `write_slots` are committed; more of the batch may follow.
  void slots_committed() noexcept { known_slots_ = slots_in_transaction_; }
  /// The whole batch is committed.
  void committed(const Batch& batch) noexcept;
  /// Releases the database.
  void close() noexcept;

 private:
  enum class GapIs { closed, under_way };
  void write_gap(std::uint32_t number, const SlotInfo& slot, const Gap& gap, GapIs what);

  Database* database_ = nullptr;
  AccountSums* sums_ = nullptr;
  std::int64_t run_ = 0;
  std::string boot_id_;
  Statement slot_;
  Statement ledger_;
  Statement schedule_;
  Statement gap_;
  Statement grown_gap_;
  Statement clock_;
  Statement error_;
  Statement health_;
  Statement configuration_;
  Statement run_end_;
  Statement made_of_;
  // The rows as they were before.
  Statement ledger_before_;
  Statement schedule_before_;
  Statement gap_before_;
  Statement run_before_;
  // Open gaps in the recording, by slot: their begin and row.
  using GrownGaps = std::unordered_map<std::uint32_t, std::pair<Time, std::int64_t>>;
  GrownGaps grown_gaps_;
  GrownGaps next_gaps_;                     // as the transaction under way leaves them
  std::uint32_t known_slots_ = 0;           // those that are in the ledger
  std::uint32_t slots_in_transaction_ = 0;  // the same, once the transaction under way is committed
};

}  // namespace rtdata::sqlite
