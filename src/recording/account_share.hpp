// Keeps what a recording says of gaps, errors and health within a share of its limit.
#pragma once

#include <array>
#include <cstdint>

#include "recording/account_sums.hpp"

namespace rtdata::sqlite {

/// The rows of these tables are not deleted with old data, and a device that is faulty for months has as many as there
/// were minutes. When all of them take more than their share, two neighbours of the object that takes most are joined
/// into one, the oldest first: the ledger stays exact, and no other object's rows or data go for them. Thread: the
/// writer's.
class AccountShare {
 public:
  static constexpr std::uint64_t part = 8;  // of the limit
  /// An object with fewer is left alone. The newer half of its rows stays as it is: what is under way is among them.
  static constexpr std::int64_t least_rows = 64;

  AccountShare() noexcept = default;
  /// `max_bytes`: the recording's limit; 0: none.
  explicit AccountShare(std::uint64_t max_bytes) : most_(static_cast<std::int64_t>(max_bytes / part)) {}

  /// Within a transaction: joins as much as one may write, if anything is to be joined.
  void hold(Database& database, AccountSums& sums);
  /// The statements are gone; before the database is closed.
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
