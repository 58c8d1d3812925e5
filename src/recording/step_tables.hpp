// Writes the steps of a topic in the transaction of its rows.
//
// Open steps are kept in memory, and written again by each transaction that adds to them: so committed steps always
// agree with committed rows, whatever ends the program. Those of an origin begin once a step has
// `first_events` events, with the step before it.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "recording/account_sums.hpp"
#include "recording/database.hpp"
#include "recording/step.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::sqlite {

/// The open steps of a run, by slot, which outlive the tables: as the current transaction leaves them, and as
/// committed.
class OpenSteps {
 public:
  struct Origin {
    explicit Origin(std::size_t fields) : steps(fields), before{Step(fields), Step(fields)} {}
    OriginSteps steps;
    std::array<Step, step_lengths.size()> before;  // of an origin that has no steps yet, the last that has ended
    std::array<std::uint64_t, step_lengths.size()> from{};  // as in the ledger
  };
  struct Change {
    Origin& origin;
    bool is_first;  ///< of the transaction under way
  };
  /// The open steps of an origin whose events are added.
  Change change(std::uint32_t slot, std::size_t fields);
  void committed();
  void rolled_back();
  /// At most this many tables of steps are made in a transaction: the more there are, the longer SQLite takes for each.
  bool may_make_table() noexcept { return tables_made_++ < most_new_tables; }
  void warn(Error warning) { warning_ = std::move(warning); }
  std::optional<Error> take_warning() { return std::exchange(warning_, std::nullopt); }

 private:
  static constexpr int most_new_tables = 100;
  struct Kept {
    Origin now, committed;
    bool is_changed = false;
  };
  std::vector<std::unique_ptr<Kept>> origins_;  // by slot
  std::vector<Kept*> changed_;
  int tables_made_ = 0;
  std::optional<Error> warning_;
};

class StepTables {
 public:
  /// `leaves` in the order of the columns of the topic's table, called so. What is passed by reference outlives this.
  StepTables(Database& database, AccountSums& sums, OpenSteps& open, std::string table, std::int64_t run,
             const std::vector<const Leaf*>& leaves);
  /// True if a topic with these fields has steps.
  static bool has_steps(const std::vector<const Leaf*>& leaves);
  /// The columns of fields that a table has got.
  static void add_columns(Database& database, const std::string& table, const std::vector<const Leaf*>& leaves);

  void add(const Record& record);
  /// At the end of the transaction.
  void flush();

 private:
  struct Changed {
    OpenSteps::Origin* origin;
    const SlotInfo* slot;
  };
  /// A step that has ended: it is written if the origin has steps, otherwise kept as the one before.
  void end(const Changed& of, std::size_t length, Step& step);
  /// Writes an open step.
  void keep(const Changed& of, std::size_t length, const Step& step);
  /// True if the origin has steps of this length from now on.
  bool begin(const Changed& of, std::size_t length, const Step& step);
  void write(const SlotInfo& slot, std::size_t length, const Step& step);
  /// False: there is none, and none can be made now.
  bool prepare(std::size_t length);

  Database& database_;
  AccountSums& sums_;
  OpenSteps& open_;
  const std::string table_;
  const std::int64_t run_;
  const std::vector<StepField> fields_;
  bool are_doubles_ = true;  // all of them, and always there: most of all recordings
  std::array<Statement, step_lengths.size()> insert_;
  std::array<bool, step_lengths.size()> is_refused_{};  // there is something else of the table's name
  std::vector<Changed> changed_;                        // by the transaction under way
  const SlotInfo* last_slot_ = nullptr;
  OpenSteps::Origin* last_origin_ = nullptr;
  Step whole_minute_;
  RowHash hash_;
};

}  // namespace rtdata::sqlite
