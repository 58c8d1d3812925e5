// Thousands of topics that are new in one batch.
#include <doctest/doctest.h>

#include <string>

#include "sanitized.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace recordings;

namespace {

struct Number {
  double value = 0;
  friend constexpr auto describe(type_tag<Number>) { return record("number", field("value", &Number::value, "1")); }
};

std::string topic_of(int number) { return "plant/t" + std::to_string(number); }

void publish(Loop& loop, int topics) {
  for (int i = 0; i < topics; ++i) loop.topic<Number>(topic_of(i)).publish({1.0 * i});
}

constexpr const char* views = "SELECT count(*) FROM sqlite_schema WHERE type = 'view' AND name LIKE 'plant/%~utc'";

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("FW-4 of each of many new topics there is a view with UTC, for every program that reads the file") {
    const Folder folder;
    const std::string path = folder / "run.db";
    constexpr int topics = 300;
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      publish(loop, 2);
      loop.advance(2s);
      CHECK(number(path, views) == 2);
      const auto reader = sqlite::Database::open(path, sqlite::Database::Mode::read);  // from before
      CHECK(reader.integer(views) == 2);
      sql(path, "CREATE VIEW \"plant/t7~utc\" AS SELECT 'somebody''s own' AS utc");  // gives way, as it always did
      publish(loop, topics);
      loop.advance(2s);
      CHECK(reader.integer(views) == topics);
      publish(loop, topics + 1);  // they are all known; one is not
      loop.advance(2s);
      CHECK(sink.counts().stored == 2 + topics + topics + 1);
      CHECK(loop.close() == 0);
    }
    CHECK(number(path, views) == topics + 1);
    const auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
    for (int i = 0; i <= topics; ++i) {
      const std::string rows = "SELECT count(*) FROM \"" + topic_of(i) +
                               "~utc\" WHERE utc LIKE '____-__-__T__:__:%Z' AND value = " + std::to_string(i);
      CHECK(database.integer(rows.c_str()) == (i < 2 ? 3 : i < topics ? 2 : 1));
    }
    CHECK(database.prepare("PRAGMA integrity_check").texts() == std::vector<std::string>{"ok"});
    check_balanced(path);
  }

  TEST_CASE("FW-4 a batch of many new topics that fails leaves neither tables nor views, and comes again") {
    const Folder folder;
    const std::string path = folder / "run.db";
    constexpr int topics = 100;
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    SqliteSink sink(loop, {.path = path, .sink = {.retry_longest = 1s}});
    publish(loop, 1);
    loop.advance(2s);
    sql(path, "CREATE TRIGGER no AFTER INSERT ON \"plant/t0\" BEGIN SELECT RAISE(ABORT, 'not now'); END");
    publish(loop, topics);
    loop.topic<Number>(topic_of(0)).publish({0});
    loop.advance(3s);
    CHECK(sink.health() == Health::faulted);
    CHECK(number(path, views) == 1);
    CHECK(number(path, "SELECT count(*) FROM rtdata_topic WHERE topic LIKE 'plant/%'") == 1);
    sql(path, "DROP TRIGGER no");
    loop.advance(5s);
    CHECK(sink.health() == Health::ok);
    CHECK(number(path, views) == topics);
    CHECK(loop.close() == 0);
    CHECK(number(path, "SELECT count(*) FROM \"plant/t0\"") == 3);
    check_balanced(path);
  }

  TEST_CASE("FW-4 3000 topics that are new in one second: the first are committed while the others are being made") {
    const Folder folder;
    const std::string path = folder / "run.db";
    constexpr int topics = rtdata::test::sanitized ? 1000 : 3000, refused = 700;
    const std::string rows = "SELECT count(*) FROM \"" + topic_of(0) + "\"";
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    SqliteSink sink(loop, {.path = path, .sink = {.retry_longest = 1s}});
    loop.topic<Number>(topic_of(0)).publish({0});
    loop.topic<Number>(topic_of(refused)).publish({0});
    loop.advance(2s);
    // Of this topic no row can be stored for now: what comes before it is stored, and not again later.
    sql(path, "CREATE TRIGGER no AFTER INSERT ON \"" + topic_of(refused) + "\" BEGIN SELECT RAISE(ABORT, 'no'); END");
    loop.topic<Number>(topic_of(0)).publish({0});
    publish(loop, topics);
    loop.advance(2s);
    CHECK(sink.health() == Health::faulted);
    CHECK(number(path, rows) == 3);
    CHECK(number(path, views) == 2 + 600);
    CHECK(number(path, "SELECT count(*) FROM rtdata_topic WHERE topic LIKE 'plant/%'") == 2 + 600);
    CHECK(number(path, "SELECT count(*) FROM \"plant/t600\"") == 1);
    publish(loop, 10);
    loop.advance(2s);
    CHECK(sink.health() == Health::faulted);
    CHECK(number(path, rows) == 3);  // the same batch again
    sql(path, "DROP TRIGGER no");
    loop.advance(5s);
    CHECK(sink.health() == Health::ok);
    CHECK(sink.counts().stored == 3 + topics + 10);
    CHECK(sink.counts().balances());
    CHECK(loop.close() == 0);
    CHECK(number(path, views) == topics);
    CHECK(number(path, rows) == 4);
    CHECK(number(path, "SELECT sum(stored) FROM rtdata_ledger") == 3 + topics + 10);
    check_balanced(path);
  }
}
