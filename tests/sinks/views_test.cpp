// What people read a recording with: views in SQL, and `rtdata info`.
#include <doctest/doctest.h>

#include <nlohmann/json.hpp>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace recordings;

namespace {

std::vector<std::string> rows_of(const std::string& path, const std::string& query) {
  const auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
  auto statement = database.prepare(query);
  std::vector<std::string> rows;
  while (statement.step()) {
    std::string& row = rows.emplace_back();
    for (int i = 0; i < sqlite3_column_count(statement.raw()); ++i) {
      if (i > 0) row += "|";
      row += statement.text(i);
    }
  }
  return rows;
}

/// A clock that is set right in the middle: what came before gets the right UTC too.
std::string make_with_clock(const Folder& folder) {
  const std::string path = folder / "run.db";
  Loop loop{Loop::Manual{}};
  loop.on_error([](const ErrorReport&) {});
  loop.manual_clock().set_realtime(Time{5s});
  SqliteSink sink(loop, {.path = path});
  int tick = 0;
  Sensor<Climate> room(loop, {.name = "room", .topic = "room/climate", .rate = 1_Hz}, [&]() -> Result<Climate> {
    if (++tick == 2 || tick == 3) return Error{Errc::io_failed, "no answer", "", "", ""};
    return Climate{1, 2};
  });
  loop.advance(3500ms);
  loop.manual_clock().set_realtime(Time{1'800'000'000s} + loop.now().time_since_epoch());
  loop.advance(3500ms);
  room.close();
  loop.close();
  return path;
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("gaps, health and errors have views with UTC") {
    const Folder folder;
    const std::string path = make_with_clock(folder);
    CHECK(rows_of(
              path,
              "SELECT origin, kind, count, first_utc, last_utc, last_utc_ns - first_utc_ns FROM \"rtdata_gap~utc\"") ==
          std::vector<std::string>{
              "room|failed|2|2027-01-15T08:00:01.000000000Z|2027-01-15T08:00:02.000000000Z|1000000000"});
    CHECK(rows_of(path, "SELECT name, state, utc FROM \"rtdata_health~utc\" ORDER BY time") ==
          std::vector<std::string>{"room|degraded|2027-01-15T08:00:01.000000000Z",
                                   "room|ok|2027-01-15T08:00:03.000000000Z"});
    const auto errors = rows_of(path, "SELECT object, id, utc FROM \"rtdata_error~utc\"");
    REQUIRE(!errors.empty());
    CHECK(errors[0] == "sensor room|io-failed|2027-01-15T08:00:01.000000000Z");
    // All columns of the tables, whatever they are.
    for (const char* table : {"rtdata_gap", "rtdata_health", "rtdata_error"}) {
      const std::string name = table;
      CHECK(number(path, "SELECT count(*) FROM pragma_table_info('" + name + "') a LEFT JOIN pragma_table_info('" +
                             name + "~utc') b ON a.name = b.name WHERE b.name IS NULL") == 0);
    }
  }

  TEST_CASE("a view has all fields with their types and units") {
    const Folder folder;
    const std::string path = make(folder);
    CHECK(rows_of(path, "SELECT number, field, type, unit, optional FROM rtdata_field WHERE topic = 'room/climate'") ==
          std::vector<std::string>{"1|temperature|double|Cel|0", "2|humidity|double|%RH|0"});
    std::vector<std::string> wanted;
    for (const Leaf& leaf : description_of<Everything>()->leaves()) {
      wanted.push_back(leaf.path + "|" + leaf.unit + "|" + (leaf.optional != nullptr ? "1" : "0"));
    }
    CHECK(rows_of(path, "SELECT field, unit, optional FROM rtdata_field WHERE topic = 'every/thing' ORDER BY number") ==
          wanted);
    // They are the columns of the table.
    CHECK(number(path,
                 "SELECT count(*) FROM rtdata_field f LEFT JOIN pragma_table_info(f.table_name) c ON c.name = f.field "
                 "WHERE c.name IS NULL") == 0);
  }

  TEST_CASE("info lists gaps in UTC, as text and as JSON") {
    const Folder folder;
    const std::string path = make_with_clock(folder);
    std::ostringstream out, json, err;
    CHECK(app::info({.database = path, .gaps = app::InfoOptions::Gaps::listed}, out, err) == 0);
    const std::string text = out.str();
    CHECK(text.find(
              "gaps of run 1 (UTC)\n  2027-01-15T08:00:01.000000000Z to 2027-01-15T08:00:02.000000000Z room on\n") !=
          std::string::npos);
    CHECK(text.find("failed 2: io-failed\n") != std::string::npos);
    const auto told = [&](const std::string& kind, const std::string& reason) {
      sql(path, "UPDATE rtdata_gap SET kind = '" + kind + "', reason = '" + reason + "'");
      std::ostringstream changed;
      CHECK(app::info({.database = path, .gaps = app::InfoOptions::Gaps::listed}, changed, err) == 0);
      return changed.str();
    };
    CHECK(told("joined", "several").find("several gaps joined, 2 together, for several reasons\n") !=
          std::string::npos);
    CHECK(told("joined", "timed-out").find("several gaps joined, 2 together: timed-out\n") != std::string::npos);
    CHECK(told("disconnected", "disconnected").find("disconnected 2\n") != std::string::npos);
    CHECK(told("failed", "io-failed").find("failed 2: io-failed\n") != std::string::npos);
    CHECK(app::info({.database = path, .show_as = app::ShowAs::json, .gaps = app::InfoOptions::Gaps::listed}, json,
                    err) == 0);
    const auto tree = nlohmann::json::parse(json.str());
    REQUIRE(tree["gaps"].size() == 1);
    CHECK(tree["gaps"][0]["count"] == 2);
    CHECK(tree["gaps"][0]["first_utc"] == "2027-01-15T08:00:01.000000000Z");
  }
}
