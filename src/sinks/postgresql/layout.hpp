// The tables rtdata_* of a server: runs, topics, and how far each origin of each run has come.
//
//   rtdata_run       a row a run: its number here, its uuid, its machine, and what the recording says of it
//   rtdata_topic     which table holds which topic, with its description
//   rtdata_position  a row a run, topic and origin: what the server has of it, changed in the transaction that adds
//   rows
//
// The tables of the account (rtdata_ledger, rtdata_gap ...) are made with the first account: account_copy.hpp.
#pragma once

#include <cstdint>
#include <string>
#include <type_traits>

#include "sinks/postgresql/connection.hpp"

namespace rtdata::postgresql {

inline constexpr int layout_version = 1;

/// Whether this version knows the tables as rtdata_layout says that they are. Errors: newer-version.
Result<void> check_layout(std::int64_t version);
/// Makes the schema and the tables where they are not there. Errors: newer-version, those of the connection.
Result<void> make_layout(Connection& connection, const std::string& schema);

/// In a transaction that waits for those of other programs that change tables.
template <class Work>
auto in_transaction(Connection& connection, Work&& work) -> std::invoke_result_t<Work> {
  constexpr const char* begin = "BEGIN;SELECT pg_advisory_xact_lock(5927036115)";  // the key is ours alone
  if (auto begun = connection.run(begin); !begun) {
    connection.roll_back();
    return std::move(begun).error();
  }
  auto result = work();
  if (!result) {
    connection.roll_back();
    return result;
  }
  if (auto done = connection.run("COMMIT"); !done) {
    connection.roll_back();
    return std::move(done).error();
  }
  return result;
}

}  // namespace rtdata::postgresql
