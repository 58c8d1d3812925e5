// What the program shows of a run.
#include "app/control/account.hpp"

#include <doctest/doctest.h>

#include <optional>

#include "app/control/status_source.hpp"
#include "app/control/status_view.hpp"
#include "app/core/table.hpp"
#include "app/core/terminal_text.hpp"
#include "has.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;
using namespace rtdata::literals;

namespace {

using rtdata::test::has;

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("the tables say what sinks dropped of each topic, while it runs and at the end") {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    const auto script = std::make_shared<ScriptedWriter::Script>();
    app::StatusSource source(loop, {.name = "rig", .configuration = "rig.json"});
    (void)source.take(0);  // from here on it watches
    Sink sink(loop, {.name = "script", .batch_rows = 10}, std::make_unique<ScriptedWriter>(script));
    script->refused_value = 4;
    for (int i = 1; i <= 10; ++i) loop.topic<Number>("some/a").publish({static_cast<double>(i)});
    for (int i = 0; i < 3; ++i) loop.topic<Number>("some/b").publish({10});
    loop.advance(2s);
    const auto dropped = [&](const app::Status& status, std::string_view topic) {
      for (const app::Status::Account& one : status.topics)
        if (one.name == topic) return one.dropped;
      return std::uint64_t{999};
    };
    app::Status account = source.take(0);
    CHECK(dropped(account, "some/a") == 1);
    CHECK(dropped(account, "some/b") == 0);
    CHECK(account.total.dropped == 1);
    CHECK(app::lines_of(account, 100, 24)[1] == "13 events, 0 queued; LOST: 1 dropped by sinks");
    CHECK(has(app::summary(account, 0),
              "topic   events  late  missed  failed  lost  dropped  health\n"
              "some/a      10     0       0       0     0        1  ok\n"
              "some/b       3     0       0       0     0        0  ok\n"));

    // What is never stored counts for its topic too.
    script->failures = 1'000'000;
    for (int i = 0; i < 5; ++i) loop.topic<Number>("some/b").publish({20});
    CHECK(loop.close(1s) == 5);
    account = app::status_of(loop.runtime());
    CHECK(dropped(account, "some/a") == 1);
    CHECK(dropped(account, "some/b") == 5);
    CHECK(account.total.dropped == 6);
  }

  TEST_CASE("what a sensor lost that was removed while it ran is in the sums, the table and the verdict") {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    const Sensor<Number> stays(loop, {.name = "stays", .rate = 2_Hz}, [] { return Number{1}; });
    std::optional<Sensor<Number>> fails, brings;
    const auto make = [&](double value) {
      fails.emplace(loop, SensorConfig{.name = "fails", .rate = 10_Hz}, []() -> Result<Number> {
        return Error{Errc::io_failed, "cannot read", "x", "", ""};
      });
      brings.emplace(loop, SensorConfig{.name = "brings", .rate = 5_Hz}, [value] { return Number{value}; });
    };
    make(1);
    loop.advance(1s);
    fails.reset();
    brings.reset();
    loop.advance(1s);
    const auto failed = [&](const app::Status& status, std::string_view topic) {
      for (const app::Status::Account& one : status.topics)
        if (one.name == topic) return one.failed;
      return std::uint64_t{999};
    };
    app::Status account = app::status_of(loop.runtime());
    CHECK(account.total.failed == 11);
    CHECK(failed(account, "fails") == 11);
    CHECK(failed(account, "brings") == 0);
    CHECK(account.mute == std::vector<std::string>{"fails"});
    CHECK(app::verdict(account, {.has_loss = loop.runtime().has_loss()}) ==
          "NO EVENT ever came from fails; LOST: 11 ticks failed (fails); taken: 11 events; ledger balances");

    make(2);  // of the same names: their counts go on, and count once
    loop.advance(450ms);
    account = app::status_of(loop.runtime());
    CHECK(account.total.failed == 16);
    CHECK(failed(account, "fails") == 16);
    CHECK(account.mute == std::vector<std::string>{"fails"});
  }

  TEST_CASE("the verdict names what was lost, of whom, and what is there; late is not lost") {
    using app::verdict;
    app::Status account;
    account.total.published = 4177;
    CHECK(verdict(account, {}) == "nothing lost: 4177 events; ledger balances");
    account.total.late = 131;
    CHECK(verdict(account, {}) == "nothing lost: 4177 events, 131 reads late; ledger balances");
    account.topics = {{.name = "host/cpu", .missed = 6}, {.name = "host/process", .missed = 660}};
    account.total.missed = 666;
    CHECK(verdict(account, {.has_loss = true}) ==
          "LOST: 666 ticks missed (host/process 660, host/cpu 6); taken: 4177 events, 131 reads late; ledger balances");
    account.topics.push_back({.name = "board", .failed = 1, .outages = {2, 6300ms}});
    account.topics.push_back({.name = "x", .missed = 7, .dropped = 3});
    account.topics[3].name = "gps";
    account.total.missed = 673;
    account.total.failed = 1;
    account.total.dropped = 3;
    account.total.outages = {2, 6300ms};
    account.total.late = 0;
    account.mute = {"gps"};
    CHECK(app::progress(account) ==
          "4177 events, 0 late, 673 missed, 1 failed, 2 outages of 6.3 s together, 3 dropped, 0 queued");
    CHECK(verdict(account, {.has_loss = true}) ==
          "NO EVENT ever came from gps; LOST: 673 ticks missed (host/process 660, gps 7 and 1 "
          "more), 1 tick failed (board), 2 outages of 6.3 s together (board), 3 events dropped by sinks (gps); taken: "
          "4177 events; ledger balances");
    app::Status dropping;
    dropping.total.published = 9;
    dropping.topics = {{.name = "gps", .lost = 1, .dropped = 5}};
    dropping.total.lost = 1;
    dropping.total.dropped = 5;
    dropping.sinks.resize(2);
    dropping.sinks[1].dropped[0] = 5;
    dropping.not_detectable = {"board"};
    CHECK(verdict(dropping, {.has_loss = true}) ==
          "LOST: 1 lost by its source (gps), 5 events dropped by sinks (gps): queue full; taken: 9 events; ledger "
          "balances; not detectable: what the source of board lost itself");
    dropping.sinks[0].dropped[2] = 2;
    dropping.total.dropped = 7;
    CHECK(has(verdict(dropping, {}), "7 events dropped by sinks (gps): 5 queue full, 2 refused; taken"));
    app::Status bad;  // what is unreadable at failed ticks is lost once
    bad.topics = {{.name = "adc", .failed = 40, .unreadable = 40, .failed_unreadable = 40}};
    bad.total = bad.topics[0];
    CHECK(has(verdict(bad, {.has_loss = true}), "LOST: 40 ticks failed, 40 of them unreadable (adc); taken: "));
    CHECK(has(app::progress(bad), "40 failed, 0 dropped"));
    bad.topics.push_back({.name = "fifo", .unreadable = 2});
    bad.total.unreadable = 42;
    CHECK(has(verdict(bad, {.has_loss = true}), "40 of them unreadable (adc), 2 unreadable (fifo); taken: "));
    app::Status none;
    none.mute = {"board"};
    CHECK(verdict(none, {}) == "NO EVENT ever came from board; nothing lost that is known: 0 events; ledger balances");
    none.mute.clear();
    none.total.published = 1;
    CHECK(verdict(none, {.balances = false}) == "nothing lost: 1 event; the ledger does NOT balance");
    CHECK(has(verdict(none, {.balances = false, .unknown = "tier fast"}), "the account is NOT complete: tier fast; "));
    CHECK(has(verdict(none, {.has_loss = true, .not_stored = 5}), "5 events were NOT stored; LOST: "));
    CHECK(has(verdict(none, {.has_loss = true, .not_stored = 1}), "1 event was NOT stored; LOST: "));
    CHECK(has(verdict(none, {.not_closed = {"run.db"}}), "run.db was NOT closed; nothing lost that is known: "));
    none.waiting = 1;
    CHECK(has(verdict(none, {}), "1 event; 1 waits in a recording to be sent; ledger"));
    none.waiting = 12;
    CHECK(has(verdict(none, {}), "1 event; 12 wait in a recording to be sent; ledger"));
    none.waiting = 0;
    none.total.first_lines = 1;
    none.topics = {{.name = "button", .first_lines = 1}};
    CHECK(verdict(none, {}) == "nothing lost: 1 event; 1 first line discarded (button); ledger balances");
    none.total.first_lines = 3;
    none.topics.push_back({.name = "board", .first_lines = 2});
    CHECK(verdict(none, {}) == "nothing lost: 1 event; 3 first lines discarded (board 2, button 1); ledger balances");
  }

  TEST_CASE("US-32 the table at the end says of each sink what waits for its peer, and for how long") {
    app::Status account;
    account.sinks.resize(2);
    account.sinks[0].name = "collector";
    account.sinks[0].stored = 30;
    account.sinks[0].queued = 1200;
    account.sinks[0].health = Health::faulted;
    account.sinks[0].reason = "cannot connect";
    account.sinks[0].backlog = Backlog{9600, Time{1s}, 12min};
    account.sinks[1].name = "copy";
    account.sinks[1].backlog = Backlog{};
    CHECK(app::summary(account, 0) ==
          "sink       stored  dropped  health   where\n"
          "collector      30        0  faulted  -\n"
          "  ! cannot connect; 1200 events (9.6 kB) wait, the oldest for 12 min\n"
          "copy            0        0  ok       -\n");
  }

  TEST_CASE("what is looked at again and again shows what is not well first, with its reason, and rates as they are") {
    Loop loop{Loop::Manual{}};
    loop.runtime().on_log([](const LogRecord&) {});
    loop.on_error([](const ErrorReport&) {});
    app::StatusSource source(loop, {.name = "rig", .configuration = "rig.json"});
    std::vector<Sensor<Number>> sensors;
    for (int i = 0; i < 30; ++i) {
      const bool is_bad = i == 20;
      sensors.emplace_back(loop, SensorConfig{.name = "s" + std::to_string(100 + i), .rate = i == 0 ? 1_Hz : 2_Hz},
                           [is_bad]() -> Result<Number> {
                             if (is_bad) return Error{Errc::not_found, "cannot open", "/dev/nothing", "it is away", ""};
                             return Number{1};
                           });
    }
    const auto frame = [&](std::size_t rows) {
      std::string text;
      for (const std::string& line : app::lines_of(source.take(0), 79, rows)) text += line + "\n";
      return text;
    };
    loop.advance(1ms);
    CHECK(has(frame(60), "s100           main       1.0 Hz          -"));  // of one event there is no rate
    for (int i = 0; i < 20; ++i) {
      loop.advance(500ms);
      const std::string now = frame(60);
      if (i < 3) continue;
      INFO(now);
      CHECK(has(now, "s100           main       1.0 Hz     1.0 Hz"));
      CHECK(has(now, "s101           main       2.0 Hz     2.0 Hz"));
    }
    const std::string small = frame(24);
    const auto bad = small.find("s120           main");
    REQUIRE(bad != std::string::npos);
    CHECK(bad < small.find("s100"));
    CHECK(has(small, "! faulted: cannot open: /dev/nothing: it is away"));
    CHECK(has(small, " more, all well"));
    CHECK(has(small, "LOST: 21 failed"));
    // A sensor that has stopped has no rate for long.
    sensors[1].stop();
    loop.advance(60s);
    CHECK(has(frame(60), "s101           main       2.0 Hz     0.0 Hz"));
  }

  TEST_CASE("top shows the rate at which a sensor is read whose filters hold most of it back") {
    Loop loop{Loop::Manual{}};
    app::StatusSource source(loop, {.name = "rig", .configuration = "rig.json"});
    unsigned reads = 0;
    const auto made = [&](const char* name, std::vector<Filter> filters) {
      return Sensor<Number>(loop,
                            {.name = name, .rate = 20_Hz, .process = {{"value", {.filters = std::move(filters)}}}},
                            [&reads] { return Number{static_cast<double>(++reads / 60)}; });
    };
    const Sensor<Number> throttled = made("throttled", {Filter::throttle(900ms)}),
                         changed = made("changed", {Filter::delta(1)});
    for (int i = 0; i < 40; ++i) {
      loop.advance(i % 2 == 0 ? 330ms : 410ms);
      const app::Status status = source.take(0);
      if (i < 4) continue;
      for (const app::Status::Sensor& sensor : status.sensors) {
        REQUIRE(sensor.reached_hz);
        CHECK_MESSAGE(*sensor.reached_hz > 19.5, sensor.name);
        CHECK_MESSAGE(*sensor.reached_hz < 20.5, sensor.name);
      }
    }
  }

  TEST_CASE("a table that is too wide gives long names a line of their own") {
    app::Table table({"name", ">count", "health"});
    table.add({"a/very/long/name/of/a/topic", "1", "ok"});
    table.add({"short", "2", "faulted"}, "because it is so and so");
    CHECK(table.text() ==
          "name                         count  health\n"
          "a/very/long/name/of/a/topic      1  ok\n"
          "short                            2  faulted\n"
          "  ! because it is so and so\n");
    CHECK(table.text("", 24) ==
          "name      count  health\n"
          "a/very/long/name/of/a/topic\n"
          "              1  ok\n"
          "short         2  faulted\n"
          "  ! because it is so and\n"
          "    so\n");
  }

  TEST_CASE("lines are broken at blanks, and hang under what they go on with") {
    using app::wrapped;
    CHECK(wrapped("one two three\n", 0) == "one two three\n");
    CHECK(wrapped("one two three\nfour", 9) == "one two\n  three\nfour");
    CHECK(wrapped("  key  what it does and why", 20) == "  key  what it does\n       and why");
    CHECK(wrapped("a /path/that/is/longer/than/a/line b", 12) == "a\n  /path/that/is/longer/than/a/line\n  b");
    CHECK(wrapped("\x1b[K one two three four", 9) == "\x1b[K one two three four");
    CHECK(wrapped("\xc3\xa9\xc3\xa9\xc3\xa9 \xc3\xa9\xc3\xa9\xc3\xa9", 7) ==
          "\xc3\xa9\xc3\xa9\xc3\xa9 \xc3\xa9\xc3\xa9\xc3\xa9");
    CHECK(wrapped("\n\na\n", 9) == "\n\na\n");
  }

  TEST_CASE("what would command a terminal is shown, in tables too, and what goes elsewhere is not touched") {
    using app::for_terminal;
    CHECK(for_terminal("a\x1b[31m\tb\r\nc\x7f", 80) == "a\\x1b[31m\tb\\x0d\nc\\x7f");
    CHECK(for_terminal("\xc2\x9b"
                       "31m \xc3\xa9 \xff",
                       80) == "\\xc2\\x9b31m \xc3\xa9 \\xff");
    CHECK(for_terminal("a\x1b[31m\n", 0) == "a\x1b[31m\n");
    CHECK(app::fitted("a\x1b\xc2\x9b"
                      "b",
                      10) == "a??b");
    app::Table table({"name", ">count"});
    table.add({"a\x1b[2J\nb", "1"}, "it says \x1b[31m");
    CHECK(table.text() == "name           count\na\\x1b[2J\\x0ab      1\n  ! it says \\x1b[31m\n");
  }
}
