// Limits the size of gaps, errors and health in a recording.
#pragma once

#include <array>
#include <cstdint>

#include "recording/account_sums.hpp"

namespace rtdata::sqlite {

/// The rows of these tables are not deleted with old data, and a device that is faulty for months has one for each
/// minute. If they take more than their share, neighbouring rows of the largest object are joined, the oldest first.
/// The ledger stays exact, and no rows of other objects are lost. Thread: the writer's.
class AccountShare {
 public:
  static constexpr std::uint64_t part = 8;  // of the limit
  /// An object with fewer rows is not changed. The newer half of the rows is never joined, because it contains the
  /// current ones.
  static constexpr std::int64_t least_rows = 64;

  AccountShare() noexcept = default;
  /// `max_bytes`: the recording's limit; 0: none.
  explicit AccountShare(std::uint64_t max_bytes) : most_(static_cast<std::int64_t>(max_bytes / part)) {}

  /// Within a transaction: joins rows if needed, as many as one transaction may write.
  void hold(Database& database, AccountSums& sums);
  /// Finalizes the statements, before the database is closed.
  void close() noexcept { newest_ = {}; }

 private:
  static constexpr std::size_t tables = 3;
  std::int64_t most_ = 0;                     // bytes
  std::array<Statement, tables> newest_;      // row number
  std::array<std::int64_t, tables> known_{};  // row numbers at the last look
  bool has_looked_ = false;
  bool has_more_ = false;
};

}  // namespace rtdata::sqlite
