#include "sinks/postgresql/layout.hpp"

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

Result<void> check_layout(std::int64_t version) {
  if (version <= layout_version) return {};
  return Error{Errc::newer_version, "cannot use the tables of the server", "rtdata_layout",
               "a newer version made them (" + std::to_string(version) + ", this one knows " +
                   std::to_string(layout_version) + ")",
               "update rt-data, or choose another `schema`"};
}

Result<void> make_layout(Connection& connection, const std::string& schema) {
  if (!schema.empty()) {
    auto there = connection.query("SELECT to_regnamespace($1) IS NULL", {{quoted_name(schema)}});
    if (!there) return std::move(there).error();
    // Asking first: who may not make schemas may well use one that is there.
    if (there->text(0, 0) == "t") {
      if (auto made = connection.run("CREATE SCHEMA IF NOT EXISTS " + quoted_name(schema)); !made)
        return std::move(made).error();
    }
  }
  // Reading a table makes the server look what others have made meanwhile; to_regclass alone may answer from before.
  const auto version = [&]() -> Result<std::int64_t> {
    auto there = connection.run("SELECT to_regclass('rtdata_layout') IS NULL FROM pg_catalog.pg_class LIMIT 1");
    if (!there) return std::move(there).error();
    if (there->text(0, 0) == "t") return 0;
    auto said = connection.run("SELECT coalesce(max(version), 0) FROM rtdata_layout");
    if (!said) return std::move(said).error();
    return said->integer(0, 0);
  };
  auto now = version();
  if (!now) return std::move(now).error();
  if (auto known = check_layout(*now); !known) return known;
  if (*now == layout_version) return {};
  return in_transaction(connection, [&]() -> Result<void> {
    auto meanwhile = version();
    if (!meanwhile) return std::move(meanwhile).error();
    if (*meanwhile != 0) return {};
    auto made = connection.run(std::string(tables) + "INSERT INTO rtdata_layout VALUES(" +
                               std::to_string(layout_version) + ")");
    if (!made) return std::move(made).error();
    return {};
  });
}

}  // namespace rtdata::postgresql
