#include "recording/account_sums.hpp"

#include "recording/schema.hpp"

namespace rtdata::sqlite {

int hashed_columns(sqlite3_stmt* rows) noexcept {
  const int columns = sqlite3_column_count(rows);
  return columns - (sqlite3_column_name(rows, columns - 1) == std::string_view(checksum_column) ? 1 : 0);
}

void AccountSums::run(Statement& statement, Rows rows) {
  const struct Reset {  // also without memory for a sum: a statement that is not reset refuses values
    ~Reset() { of.reset(); }
    Statement& of;
  } reset{statement};
  const int end = hashed_columns(statement.raw());
  while (statement.step()) {
    const bool has_run = sqlite3_column_type(statement.raw(), 0) == SQLITE_INTEGER;  // "1x" reads as 1
    const std::uint64_t hash = hash_of(hash_, statement.raw(), has_run ? 1 : 0, end);
    changes_[statement.integer(0)] += rows == Rows::come ? hash : -hash;
  }
}

void AccountSums::replace(Statement& before, Statement& change) {
  run(before, Rows::go);
  run(change);
}

void AccountSums::add_run(const Database& database, std::int64_t run_number, Rows rows) {
  for (const std::string_view table : account_tables) {
    auto query = database.prepare("SELECT * FROM " + std::string(table) + " WHERE run = ?");
    query.bind(1, run_number);
    run(query, rows);
  }
}

void AccountSums::add_topic(const Database& database, std::string_view table, Rows rows) {
  auto topic = database.prepare("SELECT * FROM rtdata_topic WHERE table_name = ?");
  const bool row = topic.bind(1, table).step();
  hash_.begin();
  for (int column = 0; row && column < sqlite3_column_count(topic.raw()); ++column) hash_.column(topic.raw(), column);
  auto columns = columns_of(database, table);
  for (const std::string& name : columns) hash_.text(name);
  changes_[all_runs] += rows == Rows::come ? hash_.hash() : -hash_.hash();
}

void AccountSums::write(Database& database) {
  for (const auto& [number, change] : changes_) {
    const bool is_run = number != all_runs && number != of_senders;
    const std::string sum = is_run ? quoted(checksum_column) : number == all_runs ? "sum" : "senders";
    const std::string where = is_run ? " WHERE run = " + std::to_string(number) : "";
    const std::string table = is_run ? "rtdata_run" : "rtdata_checksum";
    auto before = database.integer("SELECT " + sum + " FROM " + table + where);
    auto update = database.prepare("UPDATE " + table + " SET " + sum + " = ?" + where);
    update.bind(1, static_cast<std::int64_t>(static_cast<std::uint64_t>(before) + change));
    update.run();
  }
  changes_.clear();
}

}  // namespace rtdata::sqlite
