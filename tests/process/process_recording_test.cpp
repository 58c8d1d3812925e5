// What recordings keep of calibrations and filters: raw values, what was held back, and what held from when on.
#include <signal.h>

#include <functional>

#include "config/test_types.hpp"
#include "loop/virtual_time.hpp"
#include "rtdata/config/change.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/tier.hpp"
#include "sinks/killed.hpp"
#include "sinks/recordings.hpp"

using namespace recordings;

namespace {

std::string text_in(const std::string& path, const std::string& query) {
  auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
  auto statement = database.prepare(query);
  REQUIRE(statement.step());
  return std::string(statement.text(0));
}

const std::string of_rows =
    "(SELECT json_extract(c.text, '$.fields.number.version') FROM rtdata_configuration c WHERE c.run = r.run AND "
    "c.object = 'process of sensor ' || r.origin AND c.time <= r.time ORDER BY c.time DESC, c.rowid DESC LIMIT 1)";

}  // namespace

TEST_SUITE("process") {
  TEST_CASE("US-5 US-27 a recording with calibrated, filtered and unusable samples, missed and failed ticks verifies") {
    const Folder folder;
    const std::string path = folder / "run.db";
    SensorCounts counts;
    {
      Loop loop{Loop::Manual{}};
      loop.on_error([](const ErrorReport&) {});
      SqliteSink sink(loop, {.path = path});
      std::int64_t tick = 0;
      Sensor<Climate> room(loop,
                           {.name = "room",
                            .topic = "room/climate",
                            .rate = 100_Hz,
                            .process = {{"temperature",
                                         {.calibration = Calibration{.version = "lab 7", .scale = 2, .most = 3990},
                                          .filters = {Filter::median(3), Filter::rate_of_change()}}},
                                        {"humidity", {.filters = {Filter::throttle(30ms)}}}}},
                           [&]() -> Result<Climate> {
                             ++tick;
                             if (tick > 100 && tick <= 102) return Error{Errc::io_failed, "no answer", "", "", ""};
                             if (tick == 500) loop.manual_clock().pass(55ms);
                             return Climate{static_cast<double>(tick % 2000), 40};
                           });
      loop.advance(25s);
      counts = room.counts();
      room.close();
      loop.close();
      CHECK(loop.runtime().balances());
    }
    CHECK(counts.missed > 0);
    CHECK(counts.unreadable == 4);  // 1996 to 1999, doubled
    CHECK(counts.failed == 2 + 4);
    CHECK(counts.filtered > 1000);
    check_balanced(path);
    const auto in = [&](const std::string& what) { return number(path, "SELECT " + what + " FROM \"room/climate\""); };
    CHECK(in("count(*)") == static_cast<std::int64_t>(counts.published));
    CHECK(number(path, "SELECT filtered FROM rtdata_ledger WHERE origin = 'room'") ==
          static_cast<std::int64_t>(counts.filtered));
    CHECK(in("sum(\"temperature.raw\" IS NULL)") == 0);
    CHECK(in("sum(\"temperature.rate\" IS NULL)") == 4);  // at the beginning, and after each gap
    CHECK(in("max(abs(temperature - 2 * \"temperature.raw\")) <= 2") == 1);
    CHECK(in("max(temperature) <= 3990") == 1);
    CHECK(text_in(path, "SELECT unit FROM rtdata_field WHERE field = 'temperature.rate'") == "Cel/s");
    CHECK(text_in(path, "SELECT text FROM rtdata_configuration WHERE object = 'process of sensor room'") ==
          R"({"topic": "room/climate", "fields": {"humidity": {"filters": [{"type": "throttle", "time": "30 ms"}]}, )"
          R"("temperature": {"version": "lab 7", "calibration": {"scale": 2.0, "most": 3990.0}, )"
          R"("filters": [{"type": "median", "of": 3}, {"type": "rate_of_change"}]}}})");
  }

  TEST_CASE("US-5 US-27 each row is of the calibration that held at its time; a changed one is a new version") {
    const Folder folder;
    const std::string path = folder / "run.db";
    Registry types;
    test::add_test_types(types);
    types.add_sink<test::DiscardConfig>(
        "recording", "a recording", [](const test::DiscardConfig& config) { return config.path; },
        [](Loop& loop, const test::DiscardConfig& config) { return SqliteSink(loop, {.path = config.path}); });
    const auto configuration = [&](const std::string& process) {
      return R"({"sensors": [{"name": "a", "type": "tallied", "rate": "100 Hz", "process": )" + process +
             R"(}], "sinks": [{"type": "recording", "path": ")" + path + R"("}]})";
    };
    const auto planned = [&](const std::string& process) {
      return plan_system(types, parse_config(configuration(process), "f.json"));
    };
    const std::string first = R"({"number": {"calibration": {"scale": 2}}})";
    const std::string second = R"({"number": {"calibration": {"scale": 3}}})";
    {
      const SystemPlan plan = planned(first);
      REQUIRE_MESSAGE(plan.good(), plan.report());
      Loop loop{Loop::Manual{}, plan.loop_config()};
      System system(loop, types, plan);
      loop.advance(995ms);
      PlanChange done;
      loop.post([&] { done = system.apply(planned(second)); });
      loop.advance(1s);
      CHECK(done.text() == "sensor a: changed while it runs (process)\n");
      // What the topic carries stays until the end of the run.
      CHECK(system.change_to(planned("{}")).text().find("sensor a: refused: the topic a carries other values") == 0);
      CHECK(system.change_to(planned(R"({"number": {"calibration": {}, "unit": "V"}})")).count(Fate::refused) == 1);
      loop.close(1s);
      CHECK(loop.runtime().balances());
      CHECK_FALSE(loop.runtime().has_loss());
    }
    check_balanced(path);
    const auto rows = [&](const std::string& where) { return number(path, "SELECT count(*) FROM a r WHERE " + where); };
    const auto version = [&](const char* which) {
      return "(SELECT json_extract(text, '$.fields.number.version') FROM rtdata_configuration WHERE object = "
             "'process of sensor a' ORDER BY rowid " +
             std::string(which) + " LIMIT 1)";
    };
    CHECK(text_in(path, "SELECT " + version("ASC")).size() == 8);
    CHECK(rows("number = 2 * \"number.raw\"") == 100);
    CHECK(rows("number = 2 * \"number.raw\" AND " + of_rows + " = " + version("ASC")) == 100);
    CHECK(rows("number = 3 * \"number.raw\" AND " + of_rows + " = " + version("DESC")) == rows("1") - 100);
    CHECK(number(path, "SELECT " + version("ASC") + " <> " + version("DESC")) == 1);
  }

  TEST_CASE("US-27 a recording that begins later has what holds then, and the end of a processing is told") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{Loop::Manual{}};
      Processing process{{"temperature", {.filters = {Filter::delta(1)}}}};
      const auto make = [&](const Processing& with) {
        return Sensor<Climate>(loop, {.name = "room", .rate = 10_Hz, .process = with}, [] { return Climate{}; });
      };
      auto room = make(process);
      loop.advance(1s);
      SqliteSink sink(loop, {.path = path});
      loop.advance(1s);
      room.close();
      room = make({});
      loop.advance(1s);
      room.close();
      loop.close();
    }
    check_balanced(path);
    CHECK(number(path, "SELECT count(*) FROM rtdata_configuration WHERE object = 'process of sensor room'") == 2);
    CHECK(text_in(path, "SELECT text FROM rtdata_configuration ORDER BY rowid LIMIT 1")
              .starts_with(R"({"topic": "room")"));
    CHECK(text_in(path, "SELECT text FROM rtdata_configuration ORDER BY rowid DESC LIMIT 1").empty());
    CHECK(number(path, "SELECT filtered FROM rtdata_ledger") == 10);
  }

  TEST_CASE("US-26 US-27 killed in the middle of held back and unusable samples, a recording is sealed and balances") {
    const Folder folder;
    for (const Duration end : {Duration{1'234ms}, Duration{3'011ms}, Duration{7'777ms}}) {
      const std::string path = folder / (to_string(end) + ".db");
      sinks::killed_in([&] {
        Loop loop{Loop::Manual{}};
        loop.on_error([](const ErrorReport&) {});
        SqliteSink sink(loop, {.path = path});
        double value = 0;
        Sensor<Climate> room(
            loop,
            {.name = "room",
             .rate = 100_Hz,
             .process = {{"temperature",
                          {.calibration = Calibration{.scale = 2, .most = 90}, .filters = {Filter::delta(7)}}}}},
            [&] {
              value = value > 50 ? 0 : value + 1;
              return Climate{value, 0};
            });
        loop.advance(end);
        ::kill(::getpid(), SIGKILL);
      });
      start_again(path);
      const VerifyReport report = verified(path);
      INFO(problems_of(report));
      CHECK(report.verdict() == Verdict::sealed);
      CHECK(number(path, "SELECT filtered > 0 AND unreadable > 0 AND published > 0 FROM rtdata_ledger") == 1);
    }
  }

  TEST_CASE("US-26 US-27 sensors of a tier are processed there, and recorded with their calibration") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{virtual_time()};
      SqliteSink sink(loop, {.path = path});
      Tier fast(loop, {.name = "fast"});
      double value = 0;
      Sensor<Climate> room(fast.loop(),
                           {.name = "room",
                            .rate = 100_Hz,
                            .process = {{"temperature",
                                         {.calibration = Calibration{.version = "1", .table = {{0, 0}, {50, 100}}},
                                          .filters = {Filter::throttle(15ms)}}}}},
                           [&] {
                             return Climate{value += 0.5, 0};
                           });
      room.on_error([](const ErrorReport&) {});
      loop.advance(2s);
      loop.close();
      CHECK(loop.runtime().balances());
    }
    check_balanced(path);
    CHECK(number(path, "SELECT count(*) > 40 FROM room") == 1);
    CHECK(number(path, "SELECT sum(abs(temperature - 2 * \"temperature.raw\") > 1e-9) FROM room") == 0);
    CHECK(number(path, "SELECT filtered > 40 AND unreadable > 40 FROM rtdata_ledger WHERE origin = 'room'") == 1);
    CHECK(text_in(path, "SELECT text FROM rtdata_configuration WHERE object = 'process of sensor room'").size() > 50);
  }
}
