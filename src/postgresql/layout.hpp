// The tables rtdata_* of a server: runs, topics, and how far each origin of each run has come.
//
//   rtdata_run       a row per run: its number here, its uuid, its machine, and its data from the recording
//   rtdata_topic     which table holds which topic, with its description
//   rtdata_position  a row per run, topic and origin: what the server has of it, changed in the transaction that adds
//   rows
//
// The tables of the account (rtdata_ledger, rtdata_gap ...) are made with the first account: account_copy.hpp.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>

#include "postgresql/connection.hpp"

namespace rtdata::postgresql {

inline constexpr int layout_version = 1;

/// Checks that this version knows the layout in rtdata_layout. Throws newer-version.
void check_layout(std::int64_t version);
/// Makes the schema and the tables if missing. Throws newer-version.
void make_layout(Connection& connection, const std::string& schema);

/// Calls `work` in a transaction that waits for other programs that change tables. After an exception the caller must
/// roll back or close the connection.
template <class Work>
void in_transaction(Connection& connection, Work&& work) {
  connection.run("BEGIN;SELECT pg_advisory_xact_lock(5927036115)");  // the key is ours alone
  work();
  connection.run("COMMIT");
}

/// Adds the run if it is missing.
void add_run(Connection& connection, const std::string& uuid, const std::string& machine);
/// The number of a run; 0: it is not there.
std::int64_t number_of_run(Connection& connection, const std::string& uuid);

/// The row of rtdata_position of an origin.
struct Position {
  bool is_there = false;
  std::uint64_t first = 0, last = 0, rows = 0, sum = 0;
};
/// By topic and origin.
using Positions = std::map<std::pair<std::string, std::string>, Position>;
Positions positions_of(Connection& connection, std::int64_t run);

/// The columns of a table and their types, in order; none: it is not there.
Reply columns_of(Connection& connection, const std::string& table);

}  // namespace rtdata::postgresql
