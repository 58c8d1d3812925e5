// Runs that are killed while something is lacking: what was going on is in the recording afterwards.
#include <doctest/doctest.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <random>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "recording/sqlite_writer.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sensors/serial_line.hpp"
#include "sensors/pty.hpp"
#include "sinks/killed.hpp"
#include "sinks/recordings.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;
using namespace rtdata::literals;
using recordings::number;

namespace {

/// Nothing in it is approximate but for what the seal says.
void check_sealed(const std::string& path) {
  const VerifyReport report = recordings::verified(path);
  INFO(recordings::problems_of(report));
  CHECK(report.verdict() == Verdict::sealed);
  for (const RunReport& run : report.runs) {
    for (const std::string& note : run.notes) {
      INFO(note);
      CHECK(note.find("left open") == std::string::npos);
      CHECK(note.find("are in no gap") == std::string::npos);
    }
  }
}

/// What survives a kill is in a folder of this test's.
struct LiveFolder {
  LiveFolder() { ::setenv("RUNTIME_DIRECTORY", directory.path.c_str(), 1); }
  ~LiveFolder() { ::unsetenv("RUNTIME_DIRECTORY"); }
  void forget() const {
    for (const auto& entry : std::filesystem::directory_iterator(directory.path)) std::filesystem::remove(entry.path());
  }
  Directory directory;
};

const std::string run_1 = " FROM rtdata_gap WHERE run = 1 AND origin = 'a'";

/// Each tick of the schedule is a read or in a gap. How many are in gaps.
std::int64_t check_ticks(const std::string& path) {
  const auto of = [&](const std::string& columns) {
    return number(path, "SELECT " + columns + " FROM rtdata_ledger WHERE run = 1 AND origin = 'a'");
  };
  CHECK(of("scheduled") == of("taken + missed + failed + in_flight"));
  CHECK(of("in_flight") == 0);
  CHECK(of("scheduled") == number(path, "SELECT total(scheduled) FROM rtdata_schedule WHERE run = 1"));
  const std::int64_t without = number(path, "SELECT total(count)" + run_1);
  CHECK(of("missed + failed") == without);
  CHECK(of("missed") >= number(path, "SELECT total(count)" + run_1 + " AND kind = 'missed'"));
  CHECK(of("failed") >= number(path, "SELECT total(count)" + run_1 + " AND kind = 'failed'"));
  return without;
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("a device that is absent until the kill leaves its gap") {
    for (const bool is_cut : {false, true}) {  // the power too
      CAPTURE(is_cut);
      const LiveFolder live;
      Directory directory;
      const std::string path = directory / "run.db";
      killed_in([&] {
        Loop loop{Loop::Manual{}};
        loop.on_error([](const ErrorReport&) {});
        loop.runtime().on_log([](const LogRecord&) {});
        SqliteSink sink(loop, {.path = path});
        Sensor<Number> sensor(loop, {.name = "a", .topic = "a", .rate = 100_Hz}, []() -> Result<Number> {
          return Error{Errc::not_found, "cannot open", "device", "", ""};
        });
        loop.advance(8500ms);
        ::raise(SIGKILL);
      });
      if (is_cut) live.forget();
      recordings::start_again(path);
      // Up to the last account, which is some seconds old when little happens; up to the kill.
      const std::int64_t ticks = is_cut ? number(path, "SELECT failed FROM rtdata_ledger WHERE run = 1") : 851;
      CHECK(ticks >= 300);
      CHECK(number(path, "SELECT failed FROM rtdata_ledger WHERE run = 1") == ticks);
      CHECK(number(path, "SELECT scheduled FROM rtdata_ledger WHERE run = 1") == ticks);
      CHECK(number(path, "SELECT scheduled FROM rtdata_schedule WHERE run = 1") == ticks);
      CHECK(number(path, "SELECT count(*)" + run_1) == 1);
      CHECK(number(path, "SELECT count" + run_1) == ticks);
      CHECK(number(path, "SELECT (last - first) / 10000000 + 1" + run_1) == ticks);
      CHECK(number(path, "SELECT lost IS NULL FROM rtdata_run WHERE run = 1") == (is_cut ? 1 : 0));
      CHECK(recordings::verified(path).verdict() == Verdict::sealed);
      if (!is_cut) check_sealed(path);
    }
  }

  TEST_CASE("a device on another tier that fails until the kill leaves its gap") {
    const LiveFolder live;
    Directory directory;
    const std::string path = directory / "run.db";
    killed_in([&] {
      Loop loop;
      loop.on_error([](const ErrorReport&) {});
      loop.runtime().on_log([](const LogRecord&) {});
      Tier fast(loop, {.name = "fast"});
      SqliteSink sink(loop, {.path = path, .sink = {.batch_time = 10ms}});
      Sensor<Number> sensor(fast.loop(), {.name = "a", .topic = "a", .rate = 1_kHz, .faulted_after = 1000000},
                            [n = 0]() mutable -> Result<Number> {
                              if (++n > 20) return Error{Errc::not_found, "cannot open", "device", "", ""};
                              return Number{1};
                            });
      sensor.on_error([](const ErrorReport&) {});
      const auto heard_of = [&] {  // by the main loop
        std::uint64_t failed = 0;
        for (const SensorStatus& one : loop.runtime().sensors()) failed += one.counts.failed;
        return failed;
      };
      while (heard_of() < 300) loop.run_for(1ms);
      ::raise(SIGKILL);
    });
    recordings::start_again(path);
    check_sealed(path);
    // Under load, ticks are missed too.
    CHECK(check_ticks(path) >= 300);
    CHECK(number(path, "SELECT failed FROM rtdata_ledger WHERE run = 1 AND origin = 'a'") >= 300);
    CHECK(number(path, "SELECT taken FROM rtdata_ledger WHERE run = 1 AND origin = 'a'") == 20);
    CHECK(number(path, "SELECT published FROM rtdata_ledger WHERE run = 1 AND origin = 'a'") == 20);
  }

  TEST_CASE(
      "a device on another tier whose reads fail now and then, until the kill: its gaps are newer than its counts") {
    struct Told {
      std::atomic<std::int64_t> failed, published;
    };
    auto* const told = static_cast<Told*>(
        ::mmap(nullptr, sizeof(Told), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
    REQUIRE(told != MAP_FAILED);
    for (const int stored : {1, 2, 10, 47, 150}) {
      CAPTURE(stored);
      told->failed = told->published = 0;
      const LiveFolder live;
      Directory directory;
      const std::string path = directory / "run.db";
      killed_in([&] {
        Loop loop;
        loop.on_error([](const ErrorReport&) {});
        loop.runtime().on_log([](const LogRecord&) {});
        Tier fast(loop, {.name = "fast"});
        SqliteSink sink(loop, {.path = path, .sink = {.batch_time = 10ms}});
        Sensor<Number> sensor(fast.loop(),
                              {.name = "a", .topic = "a", .rate = 1_kHz, .retry_first = 1ms, .retry_longest = 1ms},
                              [&, n = 0]() mutable -> Result<Number> {
                                if (++n % 5 < 3) {
                                  ++told->failed;
                                  return Error{Errc::io_failed, "no answer", "", "", ""};
                                }
                                ++told->published;
                                return Number{1};
                              });
        sensor.on_error([](const ErrorReport&) {});
        while (sink.counts().stored < static_cast<std::uint64_t>(stored)) loop.run_for(1ms);
        ::raise(SIGKILL);
      });
      recordings::start_again(path);
      check_sealed(path);
      const std::int64_t published = number(path, "SELECT published FROM rtdata_ledger WHERE run = 1");
      CHECK(published >= stored);
      CHECK(published <= told->published);
      CHECK(number(path, "SELECT taken FROM rtdata_ledger WHERE run = 1") == published);
      const std::int64_t failed = number(path, "SELECT failed FROM rtdata_ledger WHERE run = 1");
      // Two fail before the first event. Gaps that are many are joined, and what is told of one that is under way is up
      // to a tenth of a second old.
      CHECK(failed >= 2);
      CHECK(check_ticks(path) >= failed);
    }
    ::munmap(told, sizeof(Told));
  }

  TEST_CASE("a line that is silent or unplugged until the kill leaves its gap") {
    for (const bool is_unplugged : {false, true}) {
      CAPTURE(is_unplugged);
      const LiveFolder live;
      Directory directory;
      const std::string path = directory / "run.db";
      killed_in([&] {
        Pty pty(directory / "tty");
        pty.plug_in();
        Loop loop;
        loop.on_error([](const ErrorReport&) {});
        loop.runtime().on_log([](const LogRecord&) {});
        SqliteSink sink(loop, {.path = path, .sink = {.batch_time = 10ms}});
        SerialConfig config{.device = pty.path(),
                            .lines = {.fields = {{.name = "value"}}, .first_line = FirstLine::keep}};
        if (!is_unplugged) config.lines.silence = 50ms;
        SerialLineSensor line(loop, {.name = "a", .topic = "a"}, config);
        line.on_error([](const ErrorReport&) {});
        pty.send("1\n2\n");
        while (line.counts().received < 2) loop.run_for(1ms);
        if (is_unplugged) pty.unplug();
        while (line.health() == Health::ok) loop.run_for(1ms);
        while (sink.counts().stored < 2) loop.run_for(1ms);
        loop.run_for(200ms);
        ::raise(SIGKILL);
      });
      recordings::start_again(path);
      check_sealed(path);
      CHECK(number(path, "SELECT count(*)" + run_1) == 1);
      CHECK(number(path, "SELECT count(*)" + run_1 + " AND count IS NULL AND kind = '" +
                             (is_unplugged ? "disconnected'" : "silent'")) == 1);
      // Up to the end of what is known of the run, which nothing else has made longer.
      CHECK(number(path, "SELECT last - first > 0" + run_1) == 1);
      CHECK(number(path, "SELECT last = (SELECT ended FROM rtdata_run WHERE run = 1)" + run_1) == 1);
      CHECK(number(path, "SELECT count(*) FROM a") == 2);
    }
  }

  TEST_CASE("a run that is killed in its first second has its schedule") {
    const LiveFolder live;
    Directory directory;
    const std::string path = directory / "run.db";
    killed_in([&] {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Sensor<Number> sensor(loop, {.name = "a", .topic = "a", .rate = 100_Hz}, [] { return Number{1}; });
      loop.advance(300ms);
      ::raise(SIGKILL);
    });
    recordings::start_again(path);
    CHECK(number(path, "SELECT scheduled FROM rtdata_schedule WHERE run = 1 AND origin = 'a' AND period = 10000000") ==
          31);
    CHECK(number(path, "SELECT scheduled FROM rtdata_ledger WHERE run = 1") == 31);
    CHECK(number(path, "SELECT taken FROM rtdata_ledger WHERE run = 1") == 31);
    CHECK(number(path, "SELECT lost FROM rtdata_run WHERE run = 1") == 31);
    check_sealed(path);
  }

  TEST_CASE(
      "the summary of a sealed run has the rate at which it was recorded, and says whether its counts are whole") {
    for (const bool is_cut : {false, true}) {  // the power too
      CAPTURE(is_cut);
      const LiveFolder live;
      Directory directory;
      const std::string path = directory / "run.db";
      killed_in([&] {
        Loop loop{Loop::Manual{}};
        SqliteSink sink(loop, {.path = path});
        Sensor<Number> sensor(loop, {.name = "a", .topic = "a", .rate = 10_Hz}, [] { return Number{1}; });
        loop.advance(8500ms);
        ::raise(SIGKILL);
      });
      if (is_cut) live.forget();
      recordings::start_again(path);
      const TopicSummary summed = summary(Recording::open(path).or_throw(), 1).or_throw().at(0);
      CHECK(summed.rows >= 70);
      CHECK(summed.wanted_hertz == doctest::Approx(10));
      // What waited for its transaction at the kill is lost, and nothing else.
      CHECK(summed.reached_hertz <= 10.01);
      CHECK(summed.reached_hertz >= 8.0);
      CHECK(summed.is_complete == !is_cut);
      if (!is_cut) CHECK(summed.rows + summed.dropped == 86);
    }
  }

  TEST_CASE("the summary counts what was pruned among what was reached") {
    Directory directory;
    const std::string path = directory / "run.db";
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path, .max_age = 10s});
      Sensor<Number> sensor(loop, {.name = "a", .topic = "a", .rate = 100_Hz}, [] { return Number{1}; });
      loop.advance(60s);
      loop.close();
    }
    const TopicSummary summed = summary(Recording::open(path).or_throw(), 1).or_throw().at(0);
    CHECK(summed.pruned > 3000);
    CHECK(summed.rows + summed.pruned == 6001);
    CHECK(summed.reached_hertz == doctest::Approx(100).epsilon(0.001));
    std::ostringstream out, err;
    CHECK(app::info({.database = path}, out, err) == 0);
    CHECK(out.str().find(std::to_string(summed.pruned) + " more rows were pruned") != std::string::npos);
  }

  TEST_CASE("a schedule that ended and could not be written any more is in the sealed run") {
    const LiveFolder live;
    Directory directory;
    const std::string path = directory / "run.db";
    killed_in([&] {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = path});
      Sensor<Number> sensor(loop, {.name = "a", .topic = "a", .rate = 100_Hz}, [] { return Number{1}; });
      loop.advance(8500ms);
      sensor.stop();
      ::raise(SIGKILL);
    });
    recordings::start_again(path);
    CHECK(number(path, "SELECT scheduled FROM rtdata_schedule WHERE run = 1 AND origin = 'a'") == 851);
    CHECK(number(path, "SELECT scheduled FROM rtdata_ledger WHERE run = 1") == 851);
    check_sealed(path);
  }

  TEST_CASE("gaps under way are rows that grow, and end as they are") {
    const LiveFolder live;
    Directory directory;
    const std::string path = directory / "run.db";
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    bool is_there = false;
    Sensor<Number> sensor(loop, {.name = "a", .topic = "a", .rate = 100_Hz}, [&]() -> Result<Number> {
      if (!is_there) return Error{Errc::not_found, "cannot open", "device", "", ""};
      return Number{1};
    });
    loop.advance(1s);
    CHECK(number(path, "SELECT count" + run_1) >= 99);
    loop.advance(1s);
    CHECK(number(path, "SELECT count(*)" + run_1) == 1);
    CHECK(number(path, "SELECT count" + run_1) >= 199);
    is_there = true;
    loop.advance(10s);
    loop.close();
    CHECK(number(path, "SELECT count(*)" + run_1) == 1);
    CHECK(number(path, "SELECT count" + run_1) == number(path, "SELECT failed FROM rtdata_ledger"));
    CHECK(number(path, "SELECT published FROM rtdata_ledger") > 0);
    CHECK(recordings::verified(path).verdict() == Verdict::balanced);
  }

  TEST_CASE("killed at any moment, with failed, missed, repeated and late ticks: the sealed account is exact") {
    const char* const wanted = std::getenv("RTDATA_TEST_SEEDS");  // "FIRST COUNT", to look for more
    char* rest = nullptr;
    const unsigned long first = wanted != nullptr ? std::strtoul(wanted, &rest, 10) : 1;
    const unsigned long count = wanted != nullptr ? std::strtoul(rest, nullptr, 10) : 40;
    for (unsigned long seed = first; seed < first + count; ++seed) {
      CAPTURE(seed);
      const LiveFolder live;
      Directory directory;
      const std::string path = directory / "run.db";
      std::mt19937 random(static_cast<unsigned>(seed));
      const int ticks = 1 + static_cast<int>(random() % 400);
      const int often = 1 + static_cast<int>(random() % 60);
      int scheduled = 0;
      int failed = 0;
      int published = 0;
      std::vector<int> what;  // becomes of each tick
      for (int i = 0; i < ticks; ++i) {
        const auto dice = random() % static_cast<unsigned>(often);
        const int one = dice == 0 ? 1 : dice == 1 ? 2 : 0;
        for (unsigned n = one == 1 ? 1 + static_cast<unsigned>(random() % 5) : 1; n > 0; --n) what.push_back(one);
      }
      for (const int one : what) {
        ++scheduled;
        failed += one == 1 ? 1 : 0;
        published += one == 0 ? 1 : 0;
      }
      killed_in([&] {
        Loop loop{Loop::Manual{}};
        loop.on_error([](const ErrorReport&) {});
        loop.runtime().on_log([](const LogRecord&) {});
        SqliteSink sink(loop, {.path = path, .sink = {.batch_rows = 50}});
        std::size_t tick = 0;
        Sensor<Number> sensor(loop,
                              {.name = "a", .topic = "a", .rate = 100_Hz, .retry_first = 1ms, .retry_longest = 1ms},
                              [&]() -> Reading<Number> {
                                const int now = what[tick++];
                                if (now == 1) return Error{Errc::io_failed, "no answer", "", "", ""};
                                if (now == 2) return nothing_new;
                                return Number{1};
                              });
        loop.advance(10ms * static_cast<int>(what.size() - 1));
        ::raise(SIGKILL);
      });
      recordings::start_again(path);
      const auto of = [&](const char* column) {
        return number(path, std::string("SELECT ") + column + " FROM rtdata_ledger WHERE run = 1");
      };
      // Ticks with nothing new after the last event are in no account.
      const auto silent = std::find_if(what.rbegin(), what.rend(), [](int one) { return one != 2; }) - what.rbegin();
      CHECK(of("scheduled") >= scheduled - silent);
      CHECK(of("scheduled") <= scheduled);
      CHECK(of("failed") == failed);
      CHECK(of("published") == published);
      CHECK(of("stored + dropped_unsaved") == published);
      CHECK(number(path, "SELECT total(count)" + run_1) == failed);
      CHECK(number(path, "SELECT total(scheduled) FROM rtdata_schedule WHERE run = 1") == of("scheduled"));
      check_sealed(path);
    }
  }

  TEST_CASE("sealing a run that was killed early looks at its own rows, however many earlier runs have left") {
    // Virtual-machine steps of SQLite, summed over all statements of the seal.
    const auto steps_of_seal = [](int rows_before) {
      const LiveFolder live;
      Directory directory;
      const std::string path = directory / "run.db";
      {
        Loop loop{Loop::Manual{}};
        SqliteSink sink(loop, {.path = path});
        const auto topic = loop.topic<Number>("a");
        for (int i = 0; i < rows_before; ++i) topic.publish({1});
        loop.advance(2s);
      }
      killed_in([&] {
        Loop loop{Loop::Manual{}};
        SqliteSink sink(loop, {.path = path, .sink = {.batch_time = 1ms}});
        const auto topic = loop.topic<Number>("a");
        Feed<Number> without_rows(loop, {.name = "feed", .topic = "a"});
        without_rows.start();
        for (int i = 0; i < 20; ++i) topic.publish({1});
        loop.advance(1ms);
        for (int i = 0; i < 5; ++i) topic.publish({1});
        ::raise(SIGKILL);
      });
      std::int64_t steps = 0;
      auto database = sqlite::Database::open(path, sqlite::Database::Mode::write);
      ::sqlite3_trace_v2(
          database.raw(), SQLITE_TRACE_PROFILE,
          [](unsigned, void* sum, void* statement, void*) {
            *static_cast<std::int64_t*>(sum) += ::sqlite3_stmt_status(static_cast<sqlite3_stmt*>(statement),
                                                                      SQLITE_STMTSTATUS_VM_STEP, 1);
            return 0;
          },
          &steps);
      sqlite::AccountSums sums;
      std::vector<sqlite::LiveFile> used;
      database.execute("BEGIN");
      const auto remarks = sqlite::seal_runs(database, path, "", sums, used);
      database.execute("COMMIT");
      CHECK(remarks.size() == 1);
      CHECK(number(path, "SELECT lost FROM rtdata_run WHERE run = 2") == 5);
      CHECK(number(path, "SELECT stored FROM rtdata_ledger WHERE run = 2 AND origin <> 'feed'") == 20);
      return steps;
    };
    const std::int64_t few = steps_of_seal(10);
    const std::int64_t many = steps_of_seal(20000);
    CHECK(many < few + 1000);  // the halving
  }
}
