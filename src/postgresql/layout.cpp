#include "postgresql/layout.hpp"

namespace rtdata::postgresql {
namespace {

constexpr const char* tables = R"sql(
CREATE TABLE rtdata_layout(version integer NOT NULL);
CREATE TABLE rtdata_run(
  run bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
  uuid text NOT NULL UNIQUE,
  machine text NOT NULL,
  account_at bigint);
CREATE TABLE rtdata_topic(
  topic text NOT NULL, version bigint NOT NULL,
  table_name text NOT NULL UNIQUE,
  description text NOT NULL,
  first_run bigint NOT NULL,
  PRIMARY KEY(topic, version));
CREATE TABLE rtdata_position(
  run bigint NOT NULL, topic text NOT NULL, origin text NOT NULL,
  table_name text NOT NULL,
  first_sequence bigint NOT NULL, last_sequence bigint NOT NULL,
  rows bigint NOT NULL,
  sum bigint NOT NULL,
  stored_at timestamptz NOT NULL DEFAULT now(),
  PRIMARY KEY(run, topic, origin));
COMMENT ON TABLE rtdata_run IS 'runs of programs with rt-data; times in ns since the epoch, on the line of the run';
COMMENT ON COLUMN rtdata_run.account_at IS 'up to when the account came along; NULL: none did';
COMMENT ON TABLE rtdata_topic IS 'which table holds which topic; description: JSON with fields, types and units';
COMMENT ON TABLE rtdata_position IS 'what is here of each origin; what a sender has up to last_sequence is not sent again';
COMMENT ON COLUMN rtdata_position.sum IS 'of the hashes of the rows as they were sent, mod 2^64; rtdata verify holds them to it';
)sql";

}  // namespace

void check_layout(std::int64_t version) {
  if (version <= layout_version) return;
  throw SetupError({Errc::newer_version, "cannot use the tables of the server", "rtdata_layout",
                    "a newer version made them (" + std::to_string(version) + ", this one knows " +
                        std::to_string(layout_version) + ")",
                    "update rt-data, or choose another `schema`"});
}

void make_layout(Connection& connection, const std::string& schema) {
  // Asking first: who may not make schemas may well use one that is there.
  if (!schema.empty() &&
      connection.query("SELECT to_regnamespace($1) IS NULL", {{quoted_name(schema)}}).text(0, 0) == "t")
    connection.run("CREATE SCHEMA IF NOT EXISTS " + quoted_name(schema));
  // Reading a table makes the server look what others have made meanwhile; to_regclass alone may answer from before.
  const auto version = [&]() -> std::int64_t {
    if (connection.run("SELECT to_regclass('rtdata_layout') IS NULL FROM pg_catalog.pg_class LIMIT 1").text(0, 0) ==
        "t")
      return 0;
    return connection.run("SELECT coalesce(max(version), 0) FROM rtdata_layout").integer(0, 0);
  };
  const std::int64_t now = version();
  check_layout(now);
  if (now == layout_version) return;
  in_transaction(connection, [&] {
    if (version() != 0) return;
    connection.run(std::string(tables) + "INSERT INTO rtdata_layout VALUES(" + std::to_string(layout_version) + ")");
  });
}

void add_run(Connection& connection, const std::string& uuid, const std::string& machine) {
  connection.query("INSERT INTO rtdata_run(uuid, machine) VALUES($1, $2) ON CONFLICT (uuid) DO NOTHING",
                   {{uuid, machine}});
}

std::int64_t number_of_run(Connection& connection, const std::string& uuid) {
  const Reply found = connection.query("SELECT run FROM rtdata_run WHERE uuid = $1", {{uuid}});
  return found.rows() == 0 ? 0 : found.integer(0, 0);
}

Positions positions_of(Connection& connection, std::int64_t run) {
  const Reply rows = connection.run(
      "SELECT topic, origin, first_sequence, last_sequence, rows, sum FROM rtdata_position WHERE run = " +
      std::to_string(run));
  Positions positions;
  for (int row = 0; row < rows.rows(); ++row) {
    const auto at = [&](int column) { return static_cast<std::uint64_t>(rows.integer(row, column)); };
    positions[{std::string(rows.text(row, 0)), std::string(rows.text(row, 1))}] = {true, at(2), at(3), at(4), at(5)};
  }
  return positions;
}

Reply columns_of(Connection& connection, const std::string& table) {
  return connection.query(
      "SELECT attname, format_type(atttypid, atttypmod) FROM pg_attribute WHERE attrelid = to_regclass($1) AND attnum "
      "> 0 AND NOT attisdropped ORDER BY attnum",
      {{quoted_name(table)}});
}

}  // namespace rtdata::postgresql
