// The real program, as a user runs it.
#include <doctest/doctest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>
#include <thread>
#include <vector>

#include "app/control/control_socket.hpp"
#include "app/runtime_folder.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "recording/database.hpp"
#include "sanitized.hpp"

using rtdata::app::ControlClient;
using rtdata::app::running_instances;
using rtdata::test::Folder;
using rtdata::test::Process;
using rtdata::test::RuntimeFolder;

namespace {

const std::string program = rtdata::test::built("rtdata_test_program");
const std::string shipped = rtdata::test::built("rtdata");

constexpr const char* bench = R"({
  "sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz", "topic": "count/a"} ],
  "sinks": [ {"type": "file", "path": "bench.jsonl"}, {"type": "discard"} ]
})";

std::size_t count_of(const std::string& text, const std::string& part) {
  std::size_t count = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + part.size())) ++count;
  return count;
}

using rtdata::test::has;

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-17 run --for records, prints a table and exits 0 when the ledger balances") {
    const Folder folder;
    folder.write("bench.json", bench);
    Process run(folder, program, {"run", "bench.json", "--for", "300ms"});
    CHECK(run.end() == 0);
    CHECK(has(run.out, "ledger balances"));
    CHECK(has(run.out, "count/a"));
    CHECK(has(run.out, "bench.jsonl"));
    CHECK(has(run.err, "running bench: 1 sensor, 2 sinks, for 300 ms; log bench.log"));
    // What the table says was stored is in the file.
    const std::string lines = folder.read("bench.jsonl");
    const auto at = run.out.find("\nbench.jsonl  ");
    REQUIRE(at != std::string::npos);
    CHECK(std::stoul(run.out.substr(at + 13)) == count_of(lines, "\n"));
    CHECK(count_of(lines, "\n") > 0);
    CHECK(has(folder.read("bench.log"), "info program: ended with status 0\n"));
  }

  TEST_CASE("NFR-6 a bus that a program of one's own has is listed, checked and run; two tiers share it") {
    const Folder folder;
    Process types(folder, program, {"types"});
    CHECK(types.end() == 0);
    CHECK(has(types.out, "bus types\n"));
    CHECK(has(types.out, "\n  loopback       answers with how often it was asked\n"));
    folder.write("bench.json", R"({"tiers": {"fast": {}}, "buses": {"b": {"type": "loopback"}}, "sensors": [
  {"name": "x", "type": "wired", "bus": "b", "rate": "100 Hz", "topic": "x"},
  {"name": "y", "type": "wired", "bus": "b", "rate": "100 Hz", "topic": "y", "tier": "fast"}],
  "sinks": [{"type": "file", "path": "bench.jsonl", "rotate": {"bytes": 1000000}, "keep": 3}]})");
    Process check(folder, program, {"check", "bench.json"});
    CHECK(check.end() == 0);
    CHECK(has(check.out, "ok: 2 sensors, 1 sink\n"));
    Process run(folder, program, {"run", "bench.json", "--for", "300ms"});
    CHECK(run.end() == 0);
    std::istringstream lines(folder.read("bench.jsonl"));
    std::set<std::uint64_t> numbers;  // of both: each was asked for once
    std::size_t count = 0;
    for (std::string line; std::getline(lines, line); ++count) {
      const auto at = line.find("\"number\":");
      REQUIRE(at != std::string::npos);
      numbers.insert(std::stoull(line.substr(at + 9)));
    }
    CHECK(count > 2);
    CHECK(numbers.size() == count);
    folder.write("wrong.json", R"({"buses": {"b": {"type": "loopbak"}}, "sensors": [
  {"name": "x", "type": "wired", "bus": "c", "rate": "100 Hz"}], "sinks": [{"type": "discard"}]})");
    for (const char* const verb : {"check", "run"}) {
      Process wrong(folder, program, {verb, "wrong.json"});
      CHECK(wrong.end() == 2);
      CHECK(has(wrong.out + wrong.err, "buses.b.type: there is no bus type \"loopbak\" (did you mean \"loopback\"?)"));
      CHECK(has(wrong.out + wrong.err, "sensors[0].bus: there is no bus \"c\" in `buses`"));
    }
  }

  TEST_CASE("US-9 SIGINT and SIGTERM drain and close") {
    for (const int signal : {SIGINT, SIGTERM}) {
      const Folder folder;
      folder.write("bench.json", bench);
      Process run(folder, program, {"run", "bench.json"});
      REQUIRE(run.wait_for("running bench"));
      run.signal(signal);
      CHECK(run.end() == 0);
      CHECK(has(run.err, "stopping on SIG"));
      CHECK(has(run.out, "ledger balances"));
      CHECK(has(folder.read("bench.log"), "info program: stopping on SIG"));
    }
  }

  TEST_CASE("US-9 a SIGPIPE does not end a run, which stores what it has") {
    const Folder folder;
    folder.write("rig.json", R"({"sensors": [{"name": "l", "type": "host", "quantity": "load", "rate": "50 Hz"}],
      "sinks": [{"type": "sqlite", "path": "run.db"}]})");
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    run.signal(SIGPIPE);
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK(run.out.find("ledger balances") != std::string::npos);
    CHECK(run.out.find("dropped by") == std::string::npos);
  }

  TEST_CASE("US-9 a second signal ends at once and says what was lost") {
    const Folder folder;
    folder.write("bench.json", R"({
      "sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz"} ],
      "sinks": [ {"type": "discard", "stalls": true, "batch_time": "10 ms", "close_deadline": "1 h"} ] })");
    Process run(folder, program, {"run", "bench.json"});
    REQUIRE(run.wait_for("it stalls on purpose"));
    run.signal(SIGINT);
    REQUIRE(run.wait_for("stopping on SIGINT"));
    run.signal(SIGINT);
    CHECK(run.end() == 1);
    CHECK(has(run.err, "ended at once by a second SIGINT: "));
    CHECK(has(run.err, " queued events were not stored"));
    CHECK_FALSE(has(run.err, ": 0 queued events"));
    CHECK(has(folder.read("bench.log"), "error program: ended at once by a second SIGINT"));
  }

  TEST_CASE("US-9 a second signal ends a run whose loop is held, and does not pretend to know what was lost") {
    const Folder folder;
    folder.write("bench.json", R"({
      "sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz", "hang_at": 3} ], "sinks": [ {"type": "discard"} ] })");
    Process run(folder, program, {"run", "bench.json"});
    REQUIRE(run.wait_for("it hangs now"));
    run.signal(SIGINT);
    run.signal(SIGTERM);
    CHECK(run.end() == 1);
    CHECK(has(run.err, "ended at once by a second SIGTERM: how many queued events were not stored is not known"));
  }

  TEST_CASE("NFR-5 a live view on a terminal, 80 columns wide, with the cursor shown again at the end") {
    const Folder folder;
    folder.write("bench.json", bench);
    Process run(folder, program, {"run", "bench.json"}, Process::Output::terminal);
    REQUIRE(run.wait_for("sensor         loop       wanted    reached"));
    CHECK(has(run.out, "\x1b[?25l"));
    run.signal(SIGINT);
    CHECK(run.end() == 0);
    CHECK(has(run.out, "Ctrl-C ends it"));
    CHECK(has(run.out, "count/a"));
    const auto shown = run.out.rfind("\x1b[?25h");
    REQUIRE(shown != std::string::npos);
    CHECK(run.out.rfind("\x1b[?25l") < shown);
    CHECK(run.out.find("ledger balances") > shown);
    // No line of the view is wider than the terminal.
    const std::string view = run.out.substr(0, shown);
    for (std::size_t begin = 0, end; (end = view.find("\r\n", begin)) != std::string::npos; begin = end + 2) {
      std::string line = view.substr(begin, end - begin);
      for (std::size_t escape; (escape = line.find('\x1b')) != std::string::npos;)
        line.erase(escape, line.find_first_of("ABCDEFGHIJKlmh", escape) - escape + 1);
      CHECK(line.size() <= 80);
    }
  }

  TEST_CASE("US-17 check prints every problem with its place, and exits 2") {
    const Folder folder;
    folder.write("bad.json",
                 "{\n  \"sensors\": [ {\"name\": \"a\", \"type\": \"tallie\"},\n    {\"name\": \"b\", \"type\": "
                 "\"tallied\", \"rtae\": \"1 Hz\"} ]\n}\n");
    Process check(folder, program, {"check", "bad.json"});
    CHECK(check.end() == 2);
    CHECK(has(check.out,
              "bad.json:2:38: sensors[0].type: there is no sensor type \"tallie\" (did you mean \"tallied\"?) "
              "[unknown-type]\n"));
    CHECK(has(check.out, "bad.json:3:38: sensors[1].rtae: unknown key (did you mean \"rate\"?) [unknown-key]\n"));
    CHECK(has(check.out, "^\n"));
    CHECK(has(check.out, "2 problems"));
    folder.write("good.json", R"({
  "sensors": [ {"name": "a", "type": "tallied", "rate": "0.1 Hz", "topic": "count/a"} ],
  "sinks": [ {"type": "file", "path": "bench.jsonl"}, {"type": "discard"} ]
})");  // slow enough for any disk: no warning of a disk that fills
    Process good(folder, program, {"check", "good.json"});
    CHECK(good.end() == 0);
    CHECK(good.out.starts_with(
        "how long readings may hold each loop at worst, as a part of its shortest period:\n"
        "  main: 1 sensor, whose types do not say how long a reading takes; the shortest period is 10 s\n"
        "bench.jsonl: about "));
    CHECK(good.out.ends_with("\nok: 1 sensor, 2 sinks\n"));
    CHECK_FALSE(folder.has("bench.jsonl"));
  }

  TEST_CASE("NFR-4 check and run say how loaded each tier is, and warn of one that is overloaded") {
    const Folder folder;
    folder.write("bench.json", R"({"tiers": {"fast": {}},
      "sensors": [ {"name": "a", "type": "tallied", "rate": "500 Hz", "tier": "fast", "read_time": "1 ms"},
                   {"name": "b", "type": "tallied", "rate": "500 Hz", "tier": "fast", "read_time": "800 us"},
                   {"name": "c", "type": "analog", "file": "/tmp/no converter", "rate": "10 Hz", "read_time": "5 ms"} ],
      "sinks": [ {"type": "discard"} ] })");
    Process check(folder, program, {"check", "bench.json"});
    CHECK(check.end() == 0);
    CHECK(has(check.out, "  main: 1 sensor, worst 50 us of 100 ms, 0 %\n    lane /tmp/no converter: 1 sensor, 5 %\n"));
    CHECK(has(check.out, "fast: 2 sensors, worst 1.8 ms of 2 ms, 90 %\n"));
    CHECK(has(check.out,
              "warning: bench.json:2:61: sensors[0].rate: the readings of tier \"fast\" take too much of its time"));
    Process run(folder, program, {"run", "bench.json", "--for", "10ms"});
    CHECK(run.end() == 0);
    CHECK(has(run.err,
              "warning: configuration: bench.json:2:61: sensors[0].rate: the readings of tier \"fast\" take too much "
              "of its time"));
    CHECK(has(run.err, "[overloaded-loop]"));
    CHECK(has(run.err, "rtdata: readings may hold fast: 2 sensors, worst 1.8 ms of 2 ms, 90 %\n"));
  }

  TEST_CASE("NFR-7 a run of a wrong configuration exits 2 with every problem in the log file") {
    const Folder folder;
    folder.write("bad.json", R"({"sensors": [{"name": "a", "type": "tallie"}, {"name": "b", "type": "tallied"}]})");
    Process run(folder, program, {"run", "bad.json"});
    CHECK(run.end() == 2);
    CHECK(has(run.err, "nothing was started: 2 mistakes in bad.json"));
    const std::string log = folder.read("bad.log");
    CHECK(has(log, "[unknown-type]"));
    CHECK(has(log, "[missing-key]"));
    CHECK(has(log, "ended with status 2"));
  }

  TEST_CASE("US-17 what check accepts, run can start: names of tiers and empty paths are mistakes for both") {
    const Folder folder;
    folder.write("bad.json", R"({"tiers": {"main": {}}, "sensors": [],
      "sinks": [{"type": "file", "path": ""}, {"type": "sqlite", "path": "", "name": "second"}]})");
    for (const char* command : {"check", "run"}) {
      Process wrong(folder, program, {command, "bad.json"});
      CHECK(wrong.end() == 2);
      const std::string told = wrong.out + wrong.err;
      CHECK(has(told, "bad.json:1:12: tiers.main: the main loop has that name"));
      CHECK(has(told, "bad.json:2:42: sinks[0].path: "));
      if (!has(told, "there is no sink type")) CHECK(has(told, "sinks[1].path: the path is empty"));
    }
  }

  TEST_CASE("US-17 a file that is missing, a directory, unreadable or empty is told") {
    const Folder folder;
    folder.write("empty.json", "");
    folder.write("secret.json", bench);
    ::chmod((folder.path() + "/secret.json").c_str(), 0);
    ::mkdir((folder.path() + "/folder.json").c_str(), 0755);
    for (const char* file : {"missing.json", "folder.json", "empty.json", "secret.json"}) {
      if (std::string(file) == "secret.json" && ::geteuid() == 0) continue;  // root may read it
      for (const char* command : {"run", "check"}) {
        Process run(folder, program, {command, file});
        CHECK_MESSAGE(run.end() == 2, command, " ", file);
        CHECK(has(run.out + run.err, file));
      }
    }
  }

  TEST_CASE("US-17 --fail-on-loss exits 3 when something failed, and 0 without it") {
    const Folder folder;
    folder.write(
        "bench.json",
        R"({"sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz", "fail_every": 3} ], "sinks": [{"type": "discard"}]})");
    Process strict(folder, program, {"run", "bench.json", "--for", "1s", "--fail-on-loss"});
    CHECK(strict.end() == 3);
    CHECK(has(strict.out, "\nLOST: "));
    CHECK(has(strict.out, " ticks failed (a); taken: "));
    CHECK(has(strict.out, "; ledger balances\n"));
    CHECK(has(strict.err + folder.read("bench.log"), " warning program: LOST: "));
    Process mild(folder, program, {"run", "bench.json", "--for", "200ms"});
    CHECK(mild.end() == 0);
  }

  TEST_CASE("US-17 --fail-on-loss exits 3 for a topic that comes while it runs and that a sink cannot take") {
    const Folder folder;
    // Its own topics are no sensor's, so that `check` cannot know of them; this one comes with the first change of
    // health.
    folder.write("bench.json", R"({
      "sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz", "topic": "count/a"},
                   {"name": "gone", "type": "absent", "rate": "10 Hz", "topic": "gone"} ],
      "sinks": [ {"type": "file", "path": "run.csv", "format": "csv", "topics": ["count/a", "$rtdata/health"]} ] })");
    Process check(folder, program, {"check", "bench.json"});
    CHECK(check.end() == 0);
    for (const bool is_strict : {true, false}) {
      std::vector<std::string> arguments{"run", "bench.json", "--for", "300ms"};
      if (is_strict) arguments.emplace_back("--fail-on-loss");
      Process run(folder, program, arguments);
      CHECK(run.end() == (is_strict ? 3 : 0));
      CHECK(has(run.err, "sink run.csv: cannot record topic $rtdata/health: "));
      CHECK(has(run.out, " (refused)"));
      CHECK_FALSE(has(run.out, ", 0 dropped"));
    }
  }

  TEST_CASE("US-17 an outage is a loss: the verdict tells it, --fail-on-loss exits 3, verify and info have it too") {
    const Folder folder;
    folder.write("u.json", R"({
      "sensors": [ {"name": "board", "type": "serial", "device": "nothing_here", "fields": [{"name": "value"}], "topic": "lab/board"},
                   {"name": "a", "type": "tallied", "rate": "100 Hz"} ],
      "sinks": [ {"type": "sqlite", "path": "u.db"} ] })");
    Process strict(folder, program, {"run", "u.json", "--for", "1s", "--fail-on-loss"});
    CHECK(strict.end() == 3);
    CHECK(has(strict.out, "\nNO EVENT ever came from board; LOST: "));
    CHECK(has(strict.out, "  ! cannot open the serial line: nothing_here"));
    CHECK(has(strict.out, "1 outage of "));  // and perhaps ticks that were missed
    CHECK(has(strict.out, " s (lab/board); taken: "));
    CHECK(has(strict.out, "; ledger balances\n"));
    Process mild(folder, program, {"run", "u.json", "--for", "300ms"});
    CHECK(mild.end() == 0);
    Process quiet(folder, program, {"run", "u.json", "--for", "300ms", "-q"});
    CHECK(quiet.end() == 0);
    CHECK(quiet.out.empty());
    CHECK(has(quiet.err, "rtdata: warning: NO EVENT ever came from board"));
    // The error is told once, with its reason, though it is that of its health too and comes again; the log has all.
    CHECK(count_of(quiet.err, "cannot open the serial line: nothing_here") == 1);
    CHECK(has(quiet.err, "sensor board: faulted [not-found]\n"));
    CHECK(count_of(folder.read("u.log"), "cannot open the serial line: nothing_here") > 2);
    Process verify(folder, program, {"verify", "u.db"});
    CHECK(verify.end() == 0);
    CHECK(count_of(verify.out, "\n  LOST: 1 outage of ") + count_of(verify.out, " and 1 outage of ") == 3);  // a run
    CHECK(count_of(verify.out, "1 outage of ") == 6);
    CHECK(has(verify.out, ": board on\n"));
    Process info(folder, program, {"info", "u.db"});
    CHECK(info.end() == 0);
    CHECK(has(info.out, "    ! 1 outage of "));
  }

  TEST_CASE("NFR-5 whatever the program prints for people fits a terminal of 80 columns") {
    const RuntimeFolder runtime;
    const Folder folder;
    const std::string sinks = R"("sinks": [ {"type": "sqlite", "path": "run.db"}, {"type": "discard"} ] })";
    folder.write("rig.json", R"({
      "sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz", "topic": "a/rather/long/name/for/a/topic/of/a/sensor/a"},
                   {"name": "failing", "type": "tallied", "rate": "100 Hz", "fail_every": 3},
                   {"name": "away", "type": "absent", "rate": "10 Hz", "device": "/dev/a_device_that_is_not_there"},
                   {"name": "board", "type": "serial", "device": "/dev/nor_is_this_device", "fields": [{"name": "value"}]} ],)" +
                                 sinks);
    folder.write(
        "wrong.json",
        R"({"colour": "red", "sensors": [ {"name": "a", "type": "tallie", "rate": "100 Hz", "topic": "a/rather/long/name/for/a/topic", "tier": "nowhere"},
      {"name": "b", "type": "serial", "device": "/dev/ttyUSB0", "fields": [{"name": "value"}], "baudrate": 9600, "sixth": "a long line"} ],)" +
            sinks);
    const auto check = [&](std::vector<std::string> arguments, int status) {
      const std::string command = arguments[0] + (arguments.size() > 1 ? " " + arguments[1] : "");
      Process one(folder, program, std::move(arguments), Process::Output::one_terminal);
      CHECK_MESSAGE(one.end() == status, command);
      CHECK_FALSE(one.out.empty());
      std::string text = one.out;
      std::replace(text.begin(), text.end(), '\r', '\n');
      std::istringstream lines(text);
      for (std::string line; std::getline(lines, line);) {
        for (std::size_t escape; (escape = line.find('\x1b')) != std::string::npos;)
          line.erase(escape, line.find_first_of("ABCDEFGHIJKlmh", escape) - escape + 1);
        const auto width = std::count_if(line.begin(), line.end(), [](char c) { return (c & 0xc0) != 0x80; });
        CHECK_MESSAGE(width <= 80, command, ": ", line);
      }
      return one.out;
    };
    check({"--help"}, 0);
    for (const char* command : {"init", "run", "top", "bench", "check", "types", "verify", "info", "export", "import"})
      check({command, "--help"}, 0);
    check({"rnu"}, 1);
    check({"run", "rig.json", "--fro", "2s"}, 1);
    check({"types"}, 0);
    check({"types", "serial"}, 0);
    check({"types", "seriel"}, 1);
    check({"check", "rig.json"}, 0);
    check({"check", "wrong.json"}, 2);
    check({"run", "wrong.json"}, 2);
    check({"run", "rig.json", "--for", "1s"}, 0);
    check({"run", "rig.json", "--for", "1s", "--quiet"}, 0);
    check({"init", "rig.json"}, 1);
    check({"verify", "run.db"}, 0);
    check({"verify", "nothing_that_is_there.db"}, 2);
    check({"info", "run.db"}, 0);
    check({"info", "run.db", "--gaps"}, 0);
    check({"export", "run.db", "--topic", "nothing/at/all"}, 1);
    check({"top", "--once"}, 1);
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    check({"top", "--once"}, 0);
    check({"top", "nobody"}, 1);
    run.signal(SIGINT);
    CHECK(run.end() == 0);
    check({"bench", "--for", "200ms"}, 0);
  }

  TEST_CASE(
      "NFR-5 Ctrl-C on a terminal is answered at once, before the tables; a run whose time is over says what it does") {
    const Folder folder;
    folder.write("bench.json", R"({
      "sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz"} ],
      "sinks": [ {"type": "discard", "stalls": true, "batch_time": "10 ms", "close_deadline": "2 s"} ] })");
    Process run(folder, program, {"run", "bench.json"}, Process::Output::one_terminal);
    REQUIRE(run.wait_for("queued; "));
    run.signal(SIGINT);
    REQUIRE(run.wait_for("stopping on SIGINT: storing the queued events"));
    CHECK_FALSE(has(run.out, "\x1b[?25h"));  // in the view, not after it
    CHECK(run.end() == 1);
    CHECK(run.out.rfind("stopping on SIGINT") < run.out.rfind("ledger balances"));
    CHECK(run.out.rfind("stopping on SIGINT") < run.out.rfind("health  where"));
    Process timed(folder, program, {"run", "bench.json", "--for", "300ms"});
    CHECK(timed.end() == 1);
    CHECK(has(timed.err, "storing the queued events: "));
    CHECK(has(timed.err, " events, for at most 2 s"));
  }

  TEST_CASE("what somebody else's recording says does not command the terminal") {
    const Folder folder;
    const std::string program = rtdata::test::built("rtdata");
    folder.write("rig.json", R"({"notes": "a note\u001b[31m\nof two lines", "sensors": [
      {"name": "l", "type": "host", "quantity": "load", "rate": "20 Hz"}],
      "sinks": [{"type": "sqlite", "path": "run.db"}]})");
    Process run(folder, program, {"run", "rig.json", "--for", "200ms"});
    CHECK(run.end() == 0);
    {
      auto other = rtdata::sqlite::Database::open(folder.path() + "/run.db", rtdata::sqlite::Database::Mode::write);
      other.execute("UPDATE rtdata_run SET name = name || char(27) || '[2J' || char(155)");
    }
    for (const char* command : {"info", "verify"}) {
      CAPTURE(command);
      Process told(folder, program, {command, "run.db"}, Process::Output::one_terminal);
      (void)told.end();
      INFO(told.out);
      CHECK(told.out.find('\x1b') == std::string::npos);
      CHECK(told.out.find("\xc2\x9b") == std::string::npos);
      if (std::string(command) == "info") CHECK(has(told.out, "\\x1b[2J\\xc2\\x9b"));
    }
  }

  TEST_CASE("NFR-7 errors are in the log file after SIGTERM, and with --quiet on the terminal too") {
    const Folder folder;
    folder.write("bench.json", R"({"log": {"file": "errors.log", "level": "warning"},
      "sensors": [ {"name": "a", "type": "absent", "rate": "10 Hz", "device": "/dev/missing_thing"} ], "sinks": [{"type": "discard"}]})");
    Process run(folder, program, {"run", "bench.json", "-q"});
    REQUIRE(run.wait_for("/dev/missing_thing"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK(run.out.empty());
    CHECK_FALSE(has(run.err, "stopping"));
    const std::string log = folder.read("errors.log");
    CHECK(has(log,
              "error sensor a: cannot open the device: /dev/missing_thing: No such file or directory: plug it in "
              "[not-found]\n"));
    CHECK_FALSE(has(log, " info "));
  }

  TEST_CASE("NFR-7 a fatal signal is in the log file, behind the errors before it") {
    for (const int signal : {SIGSEGV, SIGABRT, SIGBUS}) {
      const Folder folder;
      folder.write("bench.json", R"({"sensors": [ {"name": "a", "type": "absent", "rate": "10 Hz"} ]})");
      Process run(folder, program, {"run", "bench.json"});
      REQUIRE(run.wait_for("running bench"));
      REQUIRE(run.wait_for("cannot open the device"));
      run.signal(signal);
      const int status = run.end();
      CHECK(status != 0);  // the signal, or what a sanitizer makes of it
      const std::string log = folder.read("bench.log");
      CHECK(log.find("cannot open the device") < log.find("error program: fatal signal " + std::to_string(signal)));
      CHECK(has(log, "error program: fatal signal " + std::to_string(signal)));
    }
  }

  TEST_CASE("NFR-7 where there is no memory the program says so and ends, and the next start seals its recording") {
    if (rtdata::test::sanitized) {
      MESSAGE("skipped: a sanitizer ends the program itself where it cannot allocate");
      return;
    }
    const Folder folder;
    folder.write("bench.json", R"({
      "sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz", "starve_at": 20} ],
      "sinks": [ {"type": "sqlite", "path": "run.db"} ] })");
    Process run(folder, program, {"run", "bench.json"});
    CHECK(run.end() == 1);
    const std::string line = "there is no memory: the program ends; free some, or raise its limit\n";
    CHECK(has(run.err, "rtdata: fatal: " + line));
    CHECK(has(folder.read("bench.log"), " error program: " + line));
    folder.write("next.json", R"({"sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz"} ],
      "sinks": [ {"type": "sqlite", "path": "run.db"} ] })");
    Process next(folder, program, {"run", "next.json", "--for", "50ms"});
    CHECK(next.end() == 0);
    Process verify(folder, program, {"verify", "run.db", "--run", "1"});
    CHECK(verify.end() == 0);
    CHECK(has(verify.out, "sealed"));
  }

  TEST_CASE("NFR-4 stopped by a debugger and continued: the ticks are missed, in one stretch, and none is caught up") {
    const Folder folder;
    folder.write("bench.json", bench);
    const RuntimeFolder runtime;
    Process run(folder, program, {"run", "bench.json"});
    REQUIRE(run.wait_for("running bench"));
    auto client = ControlClient::connect(running_instances().at(0).path);
    REQUIRE(client);
    const auto wait_for_more = [&](std::uint64_t events) {
      std::uint64_t first = 0;
      for (std::uint64_t published = 0; published < first + events;) {
        const auto answer = client->ask(R"({"request":"status"})", std::chrono::seconds{30});
        REQUIRE(answer);
        published = nlohmann::json::parse(*answer)["sensors"][0]["published"].get<std::uint64_t>();
        if (first == 0) first = published;
      }
    };
    wait_for_more(10);
    // Real time on purpose: a process that is stopped has no virtual one.
    run.signal(SIGSTOP);
    std::this_thread::sleep_for(std::chrono::milliseconds{1500});
    run.signal(SIGCONT);
    wait_for_more(10);
    run.signal(SIGINT);
    CHECK(run.end() == 0);
    CHECK(has(run.out, "ledger balances"));
    std::vector<std::int64_t> times;
    std::istringstream lines(folder.read("bench.jsonl"));
    for (std::string line; std::getline(lines, line);)
      times.push_back(nlohmann::json::parse(line).at("time").get<std::int64_t>());
    REQUIRE(times.size() > 2);
    unsigned long_gaps = 0;
    std::size_t gap = 0;
    for (std::size_t i = 1; i < times.size(); ++i) {
      if (times[i] - times[i - 1] < 1'490'000'000) continue;
      ++long_gaps;
      gap = i;
    }
    REQUIRE(long_gaps == 1);
    CHECK(times.size() - gap >= 10);
    CHECK(static_cast<std::int64_t>(times.size() - gap) <= (times.back() - times[gap]) / 10'000'000 + 2);
  }

  TEST_CASE("NFR-7 a log file that cannot be written is a warning, not the end") {
    const Folder folder;
    folder.write("bench.json", bench);
    Process run(folder, program, {"run", "bench.json", "--for", "50ms", "--log", "/nonexistent/x.log"});
    CHECK(run.end() == 0);
    CHECK(has(run.err, "warning: log: cannot write the log file: /nonexistent/x.log: No such file or directory"));
    Process full(folder, program, {"run", "bench.json", "--for", "700ms", "--log", "/dev/full"});
    CHECK(full.end() == 0);
    CHECK(has(full.err, "No space left on device"));
  }

  TEST_CASE("NFR-7 an error that ends the start is in the log file") {
    const Folder folder;
    folder.write("bench.json",
                 R"({"sensors": [ {"name": "a", "type": "absent", "rate": "10 Hz", "required": true} ]})");
    Process run(folder, program, {"run", "bench.json"});
    CHECK(run.end() == 1);
    CHECK(has(folder.read("bench.log"),
              "bench.json:1:15: sensor a: /dev/absent: No such file or directory: plug it in [not-found]"));
  }

  TEST_CASE("NFR-1 a run whose tier hangs ends by its deadline, names the callback, and verify says what is known") {
    const Folder folder;
    folder.write("bench.json", R"({"tiers": {"fast": {}},
      "sensors": [ {"name": "a", "type": "tallied", "rate": "200 Hz", "hang_at": 20, "tier": "fast"},
                   {"name": "b", "type": "tallied", "rate": "100 Hz"} ],
      "sinks": [ {"type": "sqlite", "path": "run.db", "close_deadline": "1 s"} ] })");
    Process run(folder, program, {"run", "bench.json"});
    REQUIRE(run.wait_for("it hangs now"));
    run.signal(SIGTERM);
    CHECK(run.end() == 1);
    CHECK(has(run.err,
              "error: tier fast: did not stop in time: it has not returned from sensor a: check what blocks there"));
    CHECK(has(run.err,
              "the account is NOT complete: tier fast did not return from sensor a: what its sensors did after 20") !=
          has(run.out,
              "the account is NOT complete: tier fast did not return from sensor a: what its sensors did after 20"));
    CHECK(has(run.err, "ended though it hangs: tier fast in sensor a"));
    CHECK(has(folder.read("bench.log"), "info program: ended with status 1\n"));

    Process verify(folder, program, {"verify", "run.db"});
    CHECK(verify.end() == 0);
    CHECK(has(verify.out, "sealed"));
    CHECK(has(verify.out, "tier fast did not return from sensor a"));
    // The recording goes on in the next run, which does not seal it again.
    folder.write("next.json", R"({"sensors": [ {"name": "b", "type": "tallied", "rate": "100 Hz"} ],
      "sinks": [ {"type": "sqlite", "path": "run.db"} ] })");
    Process next(folder, program, {"run", "next.json", "--for", "50ms"});
    CHECK(next.end() == 0);
    CHECK_FALSE(has(next.err, "ended without closing"));
  }

  TEST_CASE("NFR-1 a device that does not come out of its opening at the start is named, and a signal ends the run") {
    const Folder folder;
    folder.write("bench.json", R"({"sensors": [ {"name": "a", "type": "absent", "rate": "10 Hz", "hangs": true} ],
      "sinks": [ {"type": "discard"} ] })");
    Process run(folder, program, {"run", "bench.json"});
    REQUIRE(run.wait_for("it has not returned from the making of sensor a"));
    CHECK(has(run.err, "warning: program: does not run yet after 3 s"));
    run.signal(SIGTERM);
    CHECK(run.end() == 1);
    CHECK(has(run.err, "ended by SIGTERM though it hangs: the main loop has not returned from the making of sensor a"));
  }

  TEST_CASE("US-9 after kill -9 the next run goes on") {
    const Folder folder;
    folder.write("bench.json", bench);
    {
      Process run(folder, program, {"run", "bench.json"});
      REQUIRE(run.wait_for("running bench"));
      run.signal(SIGKILL);
      CHECK(run.end() == 128 + SIGKILL);
    }
    Process again(folder, program, {"run", "bench.json", "--for", "100ms"});
    CHECK(again.end() == 0);
    CHECK(has(again.out, "ledger balances"));
  }

  TEST_CASE("US-5 a reading that holds the loop is missed ticks, not a hung program") {
    const Folder folder;
    folder.write(
        "bench.json",
        R"({"sensors": [ {"name": "slow", "type": "tallied", "rate": "100 Hz", "hold": "35 ms"} ], "sinks": [{"type": "discard"}]})");
    Process run(folder, program, {"run", "bench.json", "--for", "400ms", "--fail-on-loss"});
    CHECK(run.end() == 3);
    CHECK(has(run.err, "held the loop"));
    CHECK(has(folder.read("bench.log"), "[held-too-long]"));
  }

  TEST_CASE("US-22 types lists every type with its parameters, and --schema is JSON") {
    const Folder folder;
    Process lines(folder, program, {"types"});
    CHECK(lines.end() == 0);
    CHECK(has(lines.out, "\n  accelerometer  acceleration of an ADXL345, ADXL375 or LIS3DH"));
    CHECK(lines.out.starts_with("sensor types\n"));
    CHECK(has(lines.out, "\nsink types\n  console "));
    CHECK_FALSE(has(lines.out, "quantization_bits"));
    std::istringstream each(lines.out);
    for (std::string line; std::getline(each, line);) CHECK_MESSAGE(line.size() <= 80, line);
    Process all(folder, program, {"types", "--all"});
    CHECK(all.end() == 0);
    for (const char* type : {"\nanalog  ", "\nhost  ", "\nserial  ", "\ntallied  ", "\nfile  ", "\nconsole  ",
                             "quantization_bits", "batch_rows"})
      CHECK_MESSAGE(has(all.out, type), type);
    Process one(folder, program, {"types", "tallied"});
    CHECK(one.end() == 0);
    CHECK(one.out.starts_with("tallied  counts its readings\n"));
    Process wrong(folder, program, {"types", "tallie"});
    CHECK(wrong.end() == 1);
    CHECK(has(wrong.err, "did you mean \"tallied\"?"));
    Process schema(folder, program, {"types", "--schema"});
    CHECK(schema.end() == 0);
    CHECK(nlohmann::json::parse(schema.out)["properties"].contains("sinks"));
  }

  TEST_CASE("US-22 types and the mistake of check find a type by its chip and by what people call such a thing") {
    const Folder folder;
    const std::pair<const char*, const char*> one_type[] = {
        {"bme280", "bme280: type barometer, with \"model\": \"bme280\"\n"},
        {"MPU-6050", "MPU-6050: type imu, with \"model\": \"mpu6050\"\n"},
        {"ads1115", "type ads1x15, with \"model\": \"ads1115\""},
        {"sht31", "sht31: type sht\n"},
        {"pt100", "pt100: type max31865\n"},
        {"ds18b20", "ds18b20: type w1\n"},
        {"scpi", "scpi: type query\n"},
        {"gyro", "gyro: type imu\n"},
        {"gy-521", "gy-521: type imu\n"},
        {"dht22", "dht22: type iio\n"},
        {"HX711", "HX711: type analog\n"}};
    for (const auto& [word, says] : one_type) {
      Process found(folder, shipped, {"types", word});
      CHECK(found.end() == 0);
      CHECK_MESSAGE(has(found.out, says), found.out);
      CHECK(has(found.out, "  parameter "));
    }
    Process arduino(folder, shipped, {"types", "arduino"});
    CHECK(arduino.end() == 0);
    CHECK(has(arduino.out, "arduino: type serial\n"));
    Process can(folder, shipped, {"types", "can"});
    CHECK(can.end() == 0);  // the bus; as a verb it is in many descriptions
    CHECK(has(can.out, "can: type command\n"));
    Process several(folder, shipped, {"types", "thermocouple"});
    CHECK(several.end() == 0);
    CHECK(has(several.out, "types for thermocouple\n  max31855 "));
    CHECK(has(several.out, "\n  max31856 "));
    Process csv(folder, shipped, {"types", "csv"});
    CHECK(csv.end() == 0);
    CHECK(has(csv.out, "\n  serial "));
    CHECK(has(csv.out, "\n  file "));
#ifdef RTDATA_WITH_GPIO
    Process relay(folder, shipped, {"types", "relay"});
    CHECK(relay.end() == 0);
    CHECK_MESSAGE(has(relay.out, "gpio"), relay.out);
#endif
    Process absent(folder, shipped, {"scan", "--root", "/nonexistent"});
    CHECK(absent.end() == 1);
    CHECK_MESSAGE(has(absent.err, "/nonexistent: No such file or directory"), absent.err);
    Process none(folder, shipped, {"types", "warp-drive"});
    CHECK(none.end() == 1);
    folder.write("words.json", R"({"buses": {"i": {"type": "i2c", "device": "/dev/i2c-1"}},
      "sensors": [{"name": "a", "type": "bme280", "bus": "i", "rate": "1 Hz"},
                  {"name": "b", "type": "pt100", "bus": "i", "rate": "1 Hz"},
                  {"name": "c", "type": "thermocouple", "bus": "i", "rate": "1 Hz"}],
      "sinks": [{"type": "csv", "path": "a.csv"}]})");
    Process check(folder, shipped, {"check", "words.json"});
    CHECK(check.end() == 2);
    CHECK(has(check.out,
              "there is no sensor type \"bme280\"; it is type \"barometer\" with \"model\": \"bme280\" (did you "
              "mean \"barometer\"?)"));
    CHECK(has(check.out, "there is no sensor type \"pt100\" (did you mean \"max31865\"?)"));
    CHECK(has(check.out, "there is no sensor type \"thermocouple\"; available: max31855, max31856 [unknown-type]\n"));
    CHECK(has(check.out, "there is no sink type \"csv\" (did you mean \"file\"?)"));
  }

  TEST_CASE("US-22 check says where a key belongs that is in the wrong place") {
    const Folder folder;
    folder.write("keys.json", R"({"buses": {"i": {"type": "i2c", "device": "/dev/i2c-1", "address": "0x48"}},
      "sensors": [{"name": "a", "type": "lm75", "bus": "i", "rate": "1 Hz", "calibration": {"offset": 1}, "timeout": "1 s"},
                  {"name": "b", "type": "lm75", "device": "/dev/i2c-1", "interval": "1 s"},
                  {"name": "c", "type": "counter", "pin": 17, "rate": "1 Hz", "filter": "median"}],
      "sinks": [{"type": "file", "filename": "a.csv", "topic": "#"}]})");
    Process check(folder, shipped, {"check", "keys.json"});
    CHECK(check.end() == 2);
    INFO(check.out);
    CHECK(has(check.out, "buses.i.address: unknown key here: it belongs to the sensor that is on this bus"));
    CHECK(has(check.out, "sensors[0].calibration: unknown key here: it belongs in `process`, below the field's name"));
    CHECK(has(check.out, "sensors[0].timeout: unknown key here: it belongs to the bus"));
    CHECK(has(check.out, "sensors[1].device: unknown key here: a chip names its bus with `bus`"));
    CHECK_FALSE(has(check.out, "\"rate\" is missing"));  // it is there, under another name
    CHECK(has(check.out, "sensors[1].interval: unknown key here: set how often it is read with `rate`"));
    CHECK(has(check.out, "sinks[0].filename: unknown key here: the file is named by `path`"));
    CHECK(has(check.out, "sinks[0].topic: unknown key here: a sink has `topics`"));
#ifdef RTDATA_WITH_GPIO
    CHECK(has(check.out, "sensors[2].filter: unknown key here: filters belong in `process`"));
    CHECK(has(check.out, "sensors[2].pin: unknown key here: the GPIO line is named by `line`"));
#endif
  }

  TEST_CASE("NFR-5 init writes a file that runs as it is, and overwrites nothing") {
    const Folder folder;
    Process init(folder, shipped, {"init", "first.json"});
    CHECK(init.end() == 0);
    CHECK(has(folder.read("first.json"), "\"$schema\": \"rtdata.schema.json\""));
    const auto schema = nlohmann::json::parse(folder.read("rtdata.schema.json"));
    CHECK(schema["properties"]["sensors"]["items"]["properties"]["type"]["enum"].size() >= 3);
    const std::string text = folder.read("first.json");
    CHECK(has(text, "\"first.jsonl\""));
    Process check(folder, shipped, {"check", "first.json"});
    CHECK(check.end() == 0);
    CHECK_FALSE(has(check.out, "warning"));
    CHECK_FALSE(has(check.out, "without limit"));
    Process run(folder, shipped, {"run", "first.json", "--for", "300ms"});
    CHECK(run.end() == 0);
    CHECK(has(folder.read("first.jsonl"), "host/process"));
    Process again(folder, shipped, {"init", "first.json"});
    CHECK(again.end() == 1);
    CHECK(has(again.err, "first.json: File exists"));
    CHECK(folder.read("first.json") == text);
  }

  TEST_CASE("NFR-5 init writes what run reads, and says what is missing") {
    const Folder folder;
    Process other(folder, shipped, {"init", "first.yaml"});
    CHECK(other.end() == 1);
    CHECK(
        has(other.err,
            "first.yaml: `rtdata run` reads no configuration with this extension: choose a name that ends with .json"));
    CHECK(folder.read("first.yaml").empty());
    Process deep(folder, shipped, {"init", "sub/first.json"});
    CHECK(deep.end() == 1);
    CHECK(has(deep.err, "make the folder first: mkdir -p sub"));
    Process bare(folder, shipped, {"init", "first"});
    CHECK(bare.end() == 0);
    Process check(folder, shipped, {"check", "first"});
    CHECK(check.end() == 0);
  }

  TEST_CASE("NFR-5 a configuration that cannot be read leaves no log file, unless one is named") {
    const Folder folder;
    Process run(folder, shipped, {"run", "nofile.json"});
    CHECK(run.end() == 2);
    CHECK(has(run.err, "nofile.json: cannot read the configuration: No such file or directory"));
    CHECK(::access((folder.path() + "/nofile.log").c_str(), F_OK) != 0);
    Process named(folder, shipped, {"run", "nofile.json", "--log", "service.log"});
    CHECK(named.end() == 2);
    CHECK(has(folder.read("service.log"), "[cannot-read]"));
  }

  TEST_CASE("check counts its warnings, and says what grows without limit") {
    const Folder folder;
    // Slow enough for any disk: no warning of a disk that fills.
    folder.write("bench.json", R"({"sensors": [{"name": "a", "type": "tallied", "rate": "0.1 Hz", "topic": "count/a"}],
      "sinks": [{"type": "file", "path": "run.jsonl", "topics": ["count/b", "#"]}]})");
    Process check(folder, program, {"check", "bench.json"});
    CHECK(check.end() == 0);
    CHECK(has(check.out, "\nrun.jsonl: about "));
    CHECK(has(check.out, " a day, without limit\n"));
    CHECK(has(check.out, "\nok, with 1 warning: 1 sensor, 1 sink\n"));
  }

  TEST_CASE("output that is lost is told, and is exit status 1; a reader that goes away is not") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("bench.json", R"({"sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz"} ],
      "sinks": [ {"type": "sqlite", "path": "run.db"} ] })");
    Process record(folder, program, {"run", "bench.json", "--for", "100ms"});
    CHECK(record.end() == 0);
    Process run(folder, program, {"run", "bench.json"});
    REQUIRE(run.wait_for("running bench"));
    for (const char* command :
         {"--version", "--help", "types", "types --schema", "check bench.json", "info run.db", "verify run.db",
          "verify run.db --json", "export run.db --run 1", "top --once", "top --json", "bench --for 100ms --json -"}) {
      Process full(folder, "/bin/sh", {"-c", program + " " + command + " > /dev/full"});
      CHECK_MESSAGE(full.end() == 1, command);
      CHECK_MESSAGE(full.err == "rtdata: cannot write the output: No space left on device [storage-full]\n", command);
      if (std::string(command).starts_with("bench")) continue;
      Process piped(folder, "/bin/sh", {"-c", "trap '' PIPE; " + program + " " + command + " | true"});
      CHECK(piped.end() == 0);
      CHECK_MESSAGE(piped.err.empty(), command);
    }
    run.signal(SIGINT);
    CHECK(run.end() == 0);
  }

  TEST_CASE("counts of the command line that are below what there is are mistakes") {
    const Folder folder;
    folder.write("bench.json", R"({"sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz"} ],
      "sinks": [ {"type": "sqlite", "path": "run.db"} ] })");
    Process record(folder, program, {"run", "bench.json", "--for", "100ms"});
    CHECK(record.end() == 0);
    for (const auto& arguments : std::vector<std::vector<std::string>>{{"export", "run.db", "--limit", "-1"},
                                                                       {"export", "run.db", "--every", "-1"},
                                                                       {"export", "run.db", "--every", "0"},
                                                                       {"export", "run.db", "--run", "-2"},
                                                                       {"info", "run.db", "--run", "-2"}}) {
      Process wrong(folder, program, arguments);
      CHECK_MESSAGE(wrong.end() == 1, arguments[0], " ", arguments[2]);
      CHECK(wrong.out.empty());
      CHECK_MESSAGE((has(wrong.err, " must be a whole number from ") || has(wrong.err, "there is no run -2")),
                    wrong.err);
    }
  }

  TEST_CASE("NFR-5 runs are named by number, from the end and by name, whatever is done with them") {
    const Folder folder;
    for (const std::string name : {"cold", "hot"}) {
      folder.write(name + ".json", R"({"name": ")" + name + R"(", "sensors": [
        {"name": "a", "type": "tallied", "rate": "100 Hz"} ], "sinks": [ {"type": "sqlite", "path": "run.db"} ] })");
      Process record(folder, program, {"run", name + ".json", "--for", "200ms"});
      CHECK(record.end() == 0);
    }
    const auto said = [&](std::vector<std::string> arguments, int status) {
      Process command(folder, program, arguments);
      const int ended = command.end();
      CHECK_MESSAGE(ended == status, command.out, command.err);
      return command.out + command.err;
    };
    CHECK(has(said({"runs", "run.db"}, 0), "2  hot"));
    CHECK(has(said({"verify", "run.db", "--run", "-1"}, 0), "run 2 \"hot\""));
    CHECK(has(said({"info", "run.db", "--run", "cold"}, 0), "\nrun 1\n"));
    CHECK(!said({"export", "run.db", "--run", "-2", "--limit", "1"}, 0).empty());
    CHECK(has(said({"plot", "run.db", "a", "--run", "-2"}, 0), "run.db, run 1 \"cold\": "));
    CHECK(has(said({"plot", "run.db", "a", "--run", "hod"}, 1), "did you mean \"hot\"?"));
    CHECK(said({"tail", "run.db", "--run", "cold"}, 0) == said({"tail", "run.db", "--run", "1"}, 0));
    CHECK(said({"tail", "run.db", "--run", "-1"}, 0) != said({"tail", "run.db", "--run", "1"}, 0));
    CHECK(has(said({"tail", "run.db", "--run", "7"}, 1), "there is no run 7; its runs are 1 \"cold\", 2 \"hot\""));
    CHECK(has(said({"replay", "run.db", "--run", "cold", "--speed", "max"}, 0), " a "));
    CHECK(has(said({"replay", "run.db", "--run", "hod"}, 1), "did you mean \"hot\"?"));
    CHECK(has(said({"compare", "run.db", "-2", "-1"}, 0), "2: run 2 \"hot\" from "));
    CHECK(has(said({"seal", "run.db"}, 0), "nothing to seal"));
    CHECK(has(said({"merge", "run.db", "-o", "all.db"}, 0), "all.db: 2 runs\n"));
    CHECK(has(said({"merge", "run.db"}, 1), "--output"));
    CHECK(has(said({"rm", "all.db"}, 1), "--run"));
    CHECK(has(said({"rm", "all.db", "--run", "-1"}, 0), "deleted run 2 \"hot\""));
    CHECK(has(said({"rm", "all.db", "--run", "cold"}, 0), "deleted run 1 \"cold\""));
    said({"verify", "all.db"}, 0);
    for (const char* command : {"runs", "seal"}) said({command, "none.db"}, 2);
    said({"rm", "none.db", "--run", "1"}, 2);
    said({"compare", "none.db", "1", "2"}, 2);
    said({"merge", "none.db", "-o", "b.db"}, 2);
  }

  TEST_CASE("NFR-5 the command line explains itself") {
    const Folder folder;
    Process help(folder, shipped, {"--help"});
    CHECK(help.end() == 0);
    for (const char* word : {"init", "run", "check", "types", "examples:"}) CHECK(has(help.out, word));
    CHECK(has(help.out, "verify, info, export: the recording"));
    Process version(folder, shipped, {"--version"});
    CHECK(version.end() == 0);
    CHECK(version.out.starts_with("rtdata "));
    for (const auto& arguments : std::vector<std::vector<std::string>>{{},
                                                                       {"rnu"},
                                                                       {"run"},
                                                                       {"run", "x.json", "--for", "10"},
                                                                       {"run", "x.json", "--for", "0s"},
                                                                       {"run", "x.json", "--fro", "1s"}}) {
      Process wrong(folder, shipped, arguments);
      CHECK(wrong.end() == 1);
      CHECK_FALSE(wrong.err.empty());
    }
  }

  TEST_CASE("NFR-5 what is mistyped on the command line is named, with what was probably meant") {
    const Folder folder;
#ifdef RTDATA_WITH_PAGE
    const std::string view = "view, ";
#else
    const std::string view;
#endif
    const std::vector<std::pair<std::vector<std::string>, std::string>> cases{
        {{"vrify", "bench.db"},
         "rtdata: there is no command \"vrify\" (did you mean \"verify\"?); `rtdata --help` explains them "
         "[bad-argument]\n"},
        {{"measure", "x"},
         "rtdata: there is no command \"measure\"; available: init, run, top, tail, ctl, scan, doctor, bench, check, "
         "calibrate, graph, types, explain, verify, info, plot, report, runs, seal, rm, merge, compare, " +
             view +
             "export, replay, import, forward; "
             "`rtdata --help` explains them [bad-argument]\n"},
        {{"bench.json"},
         "rtdata: there is no command \"bench.json\"; to run that configuration: rtdata run bench.json "
         "[bad-argument]\n"},
        {{"bench.db"},
         "rtdata: there is no command \"bench.db\"; to sum up that recording: rtdata info bench.db [bad-argument]\n"},
        {{"run", "--fro", "2s"},
         "rtdata: there is no option --fro (did you mean --for?); `rtdata run --help` lists what there is "
         "[bad-argument]\n"},
        {{"run", "x.json", "--fro=2s"},
         "rtdata: there is no option --fro (did you mean --for?); `rtdata run --help` lists what there is "
         "[bad-argument]\n"},
        {{"info", "bench.db", "--zz"},
         "rtdata: there is no option --zz; `rtdata info --help` lists what there is [bad-argument]\n"},
        {{"check", "a.json", "b.json"},
         "rtdata: there is one argument too many: b.json; `rtdata check --help` lists what there is [bad-argument]\n"}};
    for (const auto& [arguments, told] : cases) {
      Process wrong(folder, shipped, arguments);
      CHECK(wrong.end() == 1);
      CHECK(wrong.err == told);
    }
    // Each command's help has examples of its own.
    for (const char* command :
         {"init", "check", "verify", "info", "report", "export", "import", "run", "top", "bench", "types", "explain"}) {
      Process help(folder, shipped, {command, "--help"});
      CHECK(help.end() == 0);
      CHECK_MESSAGE(has(help.out, std::string("\n  rtdata ") + command), command);
      CHECK_MESSAGE(!has(help.out, "look at it while it runs"), command);
    }
  }

  TEST_CASE("NFR-5 explain says what an error means, by the id that stands behind it") {
    const Folder folder;
    Process unknown_key(folder, shipped, {"explain", "[unknown-key]"});
    CHECK(unknown_key.end() == 0);
    CHECK(unknown_key.out.starts_with("unknown-key\n"));
    CHECK(unknown_key.out.find_first_of("`*#") == std::string::npos);
    Process ids(folder, shipped, {"explain"});
    CHECK(ids.end() == 0);
    CHECK(has(ids.out, "\nnot-permitted\n"));
    for (std::size_t begin = 0; begin < ids.out.size(); begin = ids.out.find('\n', begin) + 1) {
      const std::string id = ids.out.substr(begin, ids.out.find('\n', begin) - begin);
      Process one(folder, shipped, {"explain", id});
      CAPTURE(id);
      CHECK(one.end() == 0);
      CHECK(one.out.size() > id.size() + 20);
    }
    Process wrong(folder, shipped, {"explain", "not-permited"});
    CHECK(wrong.end() == 1);
    CHECK(wrong.err == "rtdata: no error has the id \"not-permited\"; did you mean \"not-permitted\"? [not-found]\n");
  }

  TEST_CASE("NFR-5 types host says what this machine has") {
    const Folder folder;
    Process types(folder, shipped, {"types", "host"});
    CHECK(types.end() == 0);
    CHECK(has(types.out, "\n  on this machine:\n"));
    CHECK(has(types.out, "\n    process\n"));
    CHECK(has(types.out, "\n    memory\n"));
    folder.write("host.json", R"({"sensors": [{"name": "f", "type": "host", "quantity": "network", "device": "none",
      "rate": "10 Hz"}], "sinks": [{"type": "console"}]})");
    Process run(folder, shipped, {"run", "host.json", "--for", "50ms"});
    run.end();
    CHECK(has(run.err, "`rtdata types host` lists the devices"));
  }

  TEST_CASE("NFR-5 types NAME says all of a driver: wiring and limits, parameters, fields with units") {
    const Folder folder;
    Process one(folder, shipped, {"types", "lm75"});
    CHECK(one.end() == 0);
    CHECK(has(one.out, "lm75  temperature of"));
    CHECK(has(one.out, "\n  - Addresses `0x48` to `0x4f`"));
    CHECK(has(one.out, "\n  address "));
    CHECK(has(one.out, "\n  temperature  double  Cel\n"));
    Process page(folder, shipped, {"types", "lm75", "--markdown"});
    CHECK(page.end() == 0);
    CHECK(has(page.out, "## `lm75`\n\nTemperature of"));
    CHECK(has(page.out, "\n| `address` | string or integer |  | `0x48` |  | 7-bit address of the chip"));
    CHECK(has(page.out, "\n| `temperature` | double | Cel |\n"));
    CHECK(!has(page.out, "`retry_first`"));  // every sensor has it
    Process all(folder, shipped, {"types", "--markdown"});
    CHECK(all.end() == 0);
    CHECK(has(all.out, "\n# Sensors on `i2c`\n\n## `"));
    CHECK(has(all.out, "\n# Sinks\n"));
    CHECK(has(all.out, "\n| `fields.scale` | number |  | `1.0` |"));  // of a member
    CHECK(has(all.out, "\n| `conversion` | `default`, `two_point` |"));
    Process none(folder, shipped, {"types", "lm57", "--markdown"});
    CHECK(none.end() == 1);
    CHECK(has(none.err, "did you mean \"lm75\"?"));
  }

  TEST_CASE("NFR-5 a time without its zone, and a size with a unit, are answered with what to write") {
    const Folder folder;
    folder.write("bench.json", R"({"sensors": [{"name": "a", "type": "tallied", "rate": "100 Hz"}],
      "sinks": [{"type": "file", "path": "a.jsonl", "rotate": {"bytes": "2 MB"}},
                {"type": "file", "path": "b.jsonl", "rotate": {"bytes": "much"}}]})");
    Process check(folder, program, {"check", "bench.json"});
    CHECK(check.end() == 2);
    CHECK(has(check.out,
              "sinks[0].rotate.bytes: expected a whole number, got the string \"2 MB\": write 2000000 [wrong-type]\n"));
    CHECK(has(check.out, "sinks[1].rotate.bytes: expected a whole number, got the string \"much\" [wrong-type]\n"));
    folder.write("good.json", R"({"sensors": [{"name": "a", "type": "tallied", "rate": "100 Hz"}],
      "sinks": [{"type": "sqlite", "path": "run.db"}]})");
    Process run(folder, program, {"run", "good.json", "--for", "100ms"});
    REQUIRE(run.end() == 0);
    CHECK(has(run.err, "running good: 1 sensor, 1 sink, for"));
    Process from(folder, "/bin/sh", {"-c", "TZ=XYZ-2 " + shipped + " export run.db --from '2026-03-01 12:00'"});
    CHECK(from.end() == 1);
    CHECK(has(from.err,
              "its time zone is missing: write \"2026-03-01 12:00Z\" for UTC, or \"2026-03-01 12:00+02:00\", "
              "as this machine's is"));
    Process format(folder, shipped, {"export", "run.db", "--format", "jsn"});
    CHECK(format.end() == 1);
    CHECK(has(format.err, "did you mean json? (json and jsonl are one: an object a line)"));
  }
}
