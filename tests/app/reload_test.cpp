// SIGHUP: a running program reads its configuration again. The real programs.
#include <doctest/doctest.h>
#include <sys/stat.h>

#include <chrono>
#include <filesystem>
#include <set>
#include <sstream>
#include <string>
#include <thread>

#include "app/process.hpp"
#include "app/runtime_folder.hpp"
#include "app/stick.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "recording/database.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/recording/recording.hpp"

using rtdata::test::built;
using rtdata::test::Folder;
using rtdata::test::Process;

namespace {

using rtdata::test::has;

std::string rig(const std::string& rate, const std::string& more) {
  return R"({"buses": {"wire": {"type": "loopback"}}, "sensors": [
    {"name": "a", "type": "tallied", "rate": ")" +
         rate + R"("}, {"name": "w", "type": "wired", "bus": "wire", "rate": "10 Hz"})" + more +
         R"(], "sinks": [{"type": "discard"}]})";
}

/// What `rtdata ctl reload` with these words says, with this status.
std::string reloaded(const Folder& folder, const std::string& asked, std::vector<std::string> words, int status) {
  words.insert(words.begin(), {"ctl", "reload"});
  Process ctl(folder, asked, words);
  CHECK_MESSAGE(ctl.end() == status, ctl.err);
  return ctl.out + ctl.err;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-5 SIGHUP applies what has changed in the file, and tells what became of each part") {
    const Folder folder;
    folder.write("rig.json", rig("100 Hz", ""));
    Process run(folder, built("rtdata_test_program"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig: 2 sensors, 1 sink"));
    folder.write("rig.json", rig("50 Hz", R"(, {"name": "new", "type": "tallied", "rate": "10 Hz"})"));
    run.signal(SIGHUP);
    REQUIRE(run.wait_for("rig.json is applied"));
    CHECK(has(run.err, "configuration: sensor a: changed while it runs (rate)"));
    CHECK(has(run.err, "configuration: sensor new: added"));
    CHECK_FALSE(has(run.err, "sensor w:"));

    folder.write("rig.json", rig("50 Hz", R"(, {"name": "new", "type": "tallie", "rate": "10 Hz"})"));
    run.signal(SIGHUP);
    REQUIRE(run.wait_for("nothing was changed: 1 mistake in rig.json"));
    CHECK(has(run.err, "did you mean \"tallied\"?"));

    folder.write("rig.json", R"({"name": "other", )" + rig("20 Hz", "").substr(1));
    run.signal(SIGHUP);
    REQUIRE(run.wait_for("a restart of the program applies the refused changes"));
    CHECK(has(run.err, "configuration: name: refused: the program reads it only when it starts"));

    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK(has(run.out, "ledger balances"));
    CHECK(has(folder.read("rig.log"), "sensor new: added"));
  }

  TEST_CASE("US-5 US-27 a reload that changes an identity restarts the sensor; log, recording and report tell of it") {
    const rtdata::test::RuntimeFolder runtime;
    const Folder folder;
    const auto text = [](const std::string& identity) {
      return R"({"buses": {"b": {"type": "i2c", "device": "/nowhere/i2c-1"}}, "sensors": [
        {"name": "imu", "type": "imu", "rate": "10 Hz", "bus": "b")" +
             identity + R"(}, {"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"}],
        "sinks": [{"type": "sqlite", "path": "rig.db"}]})";
    };
    folder.write("rig.json", text(R"(, "identity": "0x98")"));
    Process run(folder, built("rtdata"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    const std::string said = "takes a chip of identity 0x98 by the user's word, in place of 0x68 of an MPU-6050";
    CHECK_MESSAGE(has(run.err, "warning: sensor imu: " + said), run.err);
    const auto reloads = [&](const std::string& identity) {
      folder.write("rig.json", text(identity));
      return reloaded(folder, built("rtdata"), {}, 0);
    };
    CHECK(has(reloads(R"(, "identity": 112)"), "sensor imu: restarted (identity)"));
    CHECK(has(reloads(""), "sensor imu: restarted (identity)"));
    run.signal(SIGTERM);
    (void)run.end();
    CHECK(has(folder.read("rig.log"), said));
    Process info(folder, built("rtdata"), {"info", "rig.db"});
    CHECK(info.end() == 0);
    for (const char* line : {"identity of sensor imu: 0x98 by the user's word, in place",
                             "identity of sensor imu: 0x70 by the user's word", "identity of sensor imu: removed"})
      CHECK_MESSAGE(has(info.out, line), info.out);
    Process report(folder, built("rtdata"), {"report", "rig.db"});
    CHECK(report.end() == 0);
    CHECK(has(folder.read("rig.html"), "0x98 by the user"));
  }

  TEST_CASE("NFR-1 US-5 a device that never answers while a reload makes it on a tier holds nothing else") {
    const rtdata::test::RuntimeFolder runtime;
    const Folder folder;
    const std::string begin = R"({"tiers": {"fast": {}},
      "sensors": [{"name": "b", "type": "tallied", "rate": "100 Hz"})";
    const std::string rest = R"(], "sinks": [{"type": "discard"}]})";
    folder.write("rig.json", begin + rest);
    Process run(folder, built("rtdata_test_program"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    folder.write("rig.json", begin +
                                 R"(, {"name": "a", "type": "absent", "rate": "10 Hz", "hangs": true, "tier": "fast"},
      {"name": "c", "type": "tallied", "rate": "10 Hz"})" +
                                 rest);
    const std::string said = reloaded(folder, built("rtdata"), {}, 1);
    CHECK_MESSAGE(has(said, "rig.json is applied, except for this: not made: sensor a ("), said);
    CHECK(has(said, "the loop has begun to do what was asked, and may still finish"));
    for (const char* sensor : {"b", "c"}) {  // the main loop goes on, and has what comes after it
      Process stop(folder, built("rtdata"), {"ctl", "stop", sensor});
      CHECK(stop.end() == 0);
    }
    run.signal(SIGTERM);
    CHECK(run.end() == 1);
    CHECK(has(run.err, "ended though it hangs: tier fast in the making of sensor a"));
    CHECK_MESSAGE(has(run.out, "NOT made by a reload: sensor a; "), run.out);
  }

  TEST_CASE("US-5 a run of which a reload could not make a part again ends with status 1, and its account names it") {
    const rtdata::test::RuntimeFolder runtime;
    const Folder folder;
    const auto text = [](const char* path) {
      return R"({"sensors": [{"name": "a", "type": "tallied", "rate": "10 Hz"}], "sinks": [
        {"type": "discard", "name": "far", "once": true, "path": ")" +
             std::string(path) + R"("}, {"type": "discard", "name": "near"}]})";
    };
    folder.write("rig.json", text("one"));
    Process run(folder, built("rtdata_test_program"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    folder.write("rig.json", text("two"));
    const std::string said = reloaded(folder, built("rtdata"), {}, 1);
    CHECK_MESSAGE(has(said, "the earlier parts are running again, but not sink far ("), said);
    // Without it, all that the file says is there; what it had to store meanwhile it has not.
    folder.write("rig.json", R"({"sensors": [{"name": "a", "type": "tallied", "rate": "10 Hz"}], "sinks": [
        {"type": "discard", "name": "near"}]})");
    CHECK(has(reloaded(folder, built("rtdata"), {}, 0), "rig.json is applied"));
    run.signal(SIGTERM);
    CHECK(run.end() == 1);
    CHECK_MESSAGE(has(run.out, "NOT made by a reload: sink far; nothing lost that is known: "), run.out);
    CHECK(has(run.out, "; ledger balances"));
    CHECK(has(folder.read("rig.log"), "error program: NOT made by a reload: sink far; "));
    CHECK(has(folder.read("rig.log"), "ended with status 1"));
  }

  TEST_CASE("US-5 a reload that comes while another is applied waits for it, and the last one holds") {
    const Folder folder;
    const auto many = [](int count) {
      std::string more;
      for (int i = 0; i < count; ++i)
        more += R"(, {"name": "s)" + std::to_string(i) + R"(", "type": "tallied", "rate": "1 Hz"})";
      return rig("100 Hz", more);
    };
    folder.write("rig.json", many(0));
    Process run(folder, built("rtdata_test_program"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig: 2 sensors, 1 sink"));
    for (int round = 0; round < 5; ++round) {
      folder.write("rig.json", many(800));
      run.signal(SIGHUP);
      std::this_thread::sleep_for(std::chrono::milliseconds{5 + 15 * round});
      folder.write("rig.json", many(3 + round));
      run.signal(SIGHUP);
      REQUIRE(run.wait_for("rig.json is applied: " + std::to_string(5 + round) + " sensors, 1 sink"));
    }
    CHECK_FALSE(has(run.err, "nothing was changed: another"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK(has(run.out, "ledger balances"));
  }

  TEST_CASE("US-5 a recording goes on over SIGHUP, has both texts, and balances") {
    const Folder folder;
    const auto text = [](const std::string& rate, const std::string& file) {
      return R"({"sensors": [{"name": "l", "type": "host", "quantity": "load", "rate": ")" + rate +
             R"("}, {"name": "u", "type": "host", "quantity": "memory", "rate": "20 Hz"}], "sinks": [{"type": "sqlite", "name": "db", "path": ")" +
             file + R"("}]})";
    };
    const std::string program = built("rtdata");
    folder.write("rig.json", text("20 Hz", "run.db"));
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    folder.write("rig.json", text("10 Hz", "run.db"));
    run.signal(SIGHUP);
    REQUIRE(run.wait_for("rig.json is applied"));
    folder.write("rig.json", text("10 Hz", "second.db"));
    run.signal(SIGHUP);
    REQUIRE(run.wait_for("sink db: restarted (path)"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK(has(run.out, "ledger balances"));
    for (const char* file : {"run.db", "second.db"}) {
      Process verify(folder, program, {"verify", file});
      CHECK(verify.end() == 0);
      INFO(verify.out);
      CHECK(has(verify.out, "balanced"));
    }
    Process info(folder, program, {"info", "run.db"});
    CHECK(info.end() == 0);
    CHECK(has(info.out, "changes of the configuration in run 1"));
    CHECK(has(info.out, "a new text of"));
  }

  TEST_CASE("US-5 a reload that would close a recording which cannot store what it has changes nothing, until it can") {
    const Folder folder;
    const auto text = [](const std::string& rate, const std::string& sinks) {
      return R"({"sensors": [{"name": "a", "type": "tallied", "rate": ")" + rate + R"("}], "sinks": [)" + sinks + "]}";
    };
    const std::string recording = R"({"type": "sqlite", "path": "run.db", "close_deadline": "100 ms"})";
    folder.write("rig.json", text("100 Hz", recording));
    Process run(folder, built("rtdata_test_program"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    {
      auto other = rtdata::sqlite::Database::open(folder.path() + "/run.db", rtdata::sqlite::Database::Mode::write);
      other.execute("BEGIN IMMEDIATE");
      folder.write("rig.json", text("200 Hz", recording));  // while which ticks pass
      run.signal(SIGHUP);
      REQUIRE(run.wait_for("rig.json is applied"));
      folder.write("rig.json", text("200 Hz", R"({"type": "discard"})"));
      run.signal(SIGHUP);
      REQUIRE(run.wait_for("nothing was changed: the reload would close run.db, which cannot store its queue now"));
      REQUIRE(run.wait_for("fix the cause"));
    }
    run.signal(SIGHUP);
    REQUIRE(run.wait_for("sink run.db: removed"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK_FALSE(has(run.out, "dropped by"));  // the machine may have missed a tick
    CHECK(has(run.out, "ledger balances"));
  }

  TEST_CASE("US-5 a reload leaves a disk that does not answer: the run goes on elsewhere, and says what is lost") {
    for (const bool is_hanging : {false, true}) {
      CAPTURE(is_hanging);
      const rtdata::test::RuntimeFolder runtime;
      const Folder folder;
      const rtdata::test::Stick stick(folder);
      if (!stick) {
        MESSAGE(rtdata::test::why_no_stick);
        return;
      }
      const std::string program = built("rtdata");
      const auto text = [](const char* file, const char* batch_time) {
        return R"({"sensors": [{"name": "l", "type": "host", "quantity": "load", "rate": "50 Hz"}], "sinks": [
        {"type": "sqlite", "name": "db", "close_deadline": "500 ms", "path": ")" +
               std::string(file) + R"(", "batch_time": ")" + batch_time + R"("}]})";
      };
      folder.write("rig.json", text("stick/first.db", "50 ms"));
      Process run(folder, program, {"run", "rig.json"});
      REQUIRE(run.wait_for("running rig"));
      const struct Thaw {
        const rtdata::test::Stick& stick;
        ~Thaw() { stick.thaw(); }  // or the run cannot be ended
      } at_the_end{stick};
      REQUIRE((is_hanging ? stick.freeze() : stick.pull()));
      // On the same file nothing is won.
      folder.write("rig.json", text("stick/first.db", "100 ms"));
      run.signal(SIGHUP);
      REQUIRE(run.wait_for("nothing was changed: the reload would close db, which cannot store its queue now"));
      REQUIRE(run.wait_for("if the disk does not answer, give the sink a file on another disk"));

      folder.write("rig.json", text("second.db", "50 ms"));
      run.signal(SIGHUP);
      REQUIRE(run.wait_for(
          "sink db is left alone, because its disk does not answer: what the sink has not stored in 500 ms, its "
          "`close_deadline`, is lost, and counted"));
      REQUIRE(run.wait_for("sink db: restarted (path"));
      REQUIRE(run.wait_for("sink db: lost "));
      REQUIRE((!is_hanging || stick.thaw()));  // the thread that is left behind comes back
      run.signal(SIGTERM);
      CHECK(run.end() == 1);  // not all is stored
      CHECK_FALSE(has(run.out, "not_balanced"));
      Process second(folder, program, {"verify", "second.db"});
      CHECK(second.end() == 0);
      CHECK(has(second.out, "balanced"));
    }
  }

  TEST_CASE("US-5 US-32 a reload that removes a sender says what waits for it") {
    const rtdata::test::RuntimeFolder runtime;
    const Folder folder;
    const auto text = [](const std::string& sender) {
      return R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "50 Hz"}], "sinks": [
        {"type": "sqlite", "name": "db", "path": "run.db", "batch_time": "50 ms"})" +
             sender + "]}";
    };
    folder.write("rig.json",
                 text(R"(, {"type": "tcp", "name": "far", "host": "127.0.0.1", "port": 1, "through": "db"})"));
    Process run(folder, built("rtdata"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    for (int i = 0; i < 6000; ++i) {  // until something waits for the peer that is not there
      std::this_thread::sleep_for(std::chrono::milliseconds{10});
      const auto opened = rtdata::Recording::open(folder.path() + "/run.db");
      const auto topics = opened ? opened->topics().or_throw() : std::vector<rtdata::RecordedTopic>{};
      if (!topics.empty()) break;
    }
    folder.write("rig.json", text(""));
    run.signal(SIGHUP);
    REQUIRE(run.wait_for(" in the recording db for the sink \"far\", which is removed: they are not sent"));
    REQUIRE(run.wait_for("rig.json is applied"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
  }

  TEST_CASE(
      "US-5 US-32 a disk that does not answer is left though a sender goes through it; what waits there is told") {
    const rtdata::test::RuntimeFolder runtime;
    const Folder folder;
    rtdata::test::Stick stick(folder);
    if (!stick) {
      MESSAGE(rtdata::test::why_no_stick);
      return;
    }
    const std::string program = built("rtdata");
    const auto text = [](const char* file) {
      return R"({"name": "rig", "sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "100 Hz"}], "sinks": [
        {"type": "sqlite", "name": "db", "path": ")" +
             std::string(file) + R"(", "batch_time": "50 ms", "close_deadline": "500 ms"},
        {"type": "tcp", "name": "far", "host": "127.0.0.1", "port": 1, "through": "db", "retry_longest": "200 ms"}]})";
    };
    const auto waiting_in = [&](const std::string& file) {
      std::uint64_t events = 0;
      for (const auto& backlog : rtdata::Recording::open(folder.path() + "/" + file).or_throw().backlogs().or_throw())
        events += backlog.events;
      return events;
    };
    folder.write("rig.json", text("stick/first.db"));
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    const auto reload = [&] { return reloaded(folder, program, {}, 0); };
    for (int i = 0; i < 6000; ++i) {  // until something waits for the peer that is not there
      std::this_thread::sleep_for(std::chrono::milliseconds{10});
      if (const auto opened = rtdata::Recording::open(folder.path() + "/stick/first.db"); opened && opened->topics())
        if (const auto all = opened->backlogs(); all && !all->empty() && all->front().events > 10) break;
    }
    REQUIRE(stick.pull());
    folder.write("rig.json", text("second.db"));
    std::string told = reload();
    REQUIRE(run.wait_for("sink db: lost "));
    INFO(told);
    CHECK(has(told, "sink db is left alone, because its disk does not answer"));
    CHECK(has(told, "sink db: restarted (path)"));
    CHECK(has(told, "sink far: restarted"));
    const auto stays_in = [](const std::string& file) {
      return "events that wait for sinks in " + file + " stay there: `rtdata info " + file +
             "` counts them, and `rtdata forward " + file + " FILE` sends them, with a FILE that has these sinks";
    };
    CHECK(has(told, stays_in("stick/first.db")));

    // And from a disk that is well: what the recording stores when it closes waits, too, and `info` tells it.
    folder.write("rig.json", text("third.db"));
    told = reload();
    CHECK(has(told, stays_in("second.db")));
    Process info(folder, program, {"info", "second.db"});
    CHECK(info.end() == 0);
    CHECK_MESSAGE(has(info.out, "far"), info.out);
    CHECK_MESSAGE(has(info.out, std::to_string(waiting_in("second.db")) + " events"), info.out);
    folder.write("rig.json", R"({"name": "rig", "sensors": [], "sinks": []})");
    Process check(folder, program, {"check", "rig.json", "--against", "old.json"});
    CHECK(check.end() == 2);  // there is none yet
    folder.write("old.json", text("third.db"));
    told = reload();
    CHECK(has(told, stays_in("third.db")));
    Process compared(folder, program, {"check", "rig.json", "--against", "old.json"});
    CHECK(compared.end() == 0);
    CHECK(has(compared.out, "warning: " + stays_in("third.db")));
    run.signal(SIGTERM);
    CHECK(run.end() == 1);  // not all is stored
    // The table has the file that each had.
    for (const char* file : {"stick/first.db", "second.db", "third.db"}) {
      const std::string& out = run.out;
      std::size_t rows = 0;
      for (std::size_t at = out.find("\ndb "); at != std::string::npos; at = out.find("\ndb ", at + 1)) {
        const std::string row = out.substr(at + 1, out.find('\n', at + 1) - at - 1);
        if (row.ends_with(file)) ++rows;
      }
      CHECK_MESSAGE(rows == 1, file << "\n" << out);
      CHECK(has(out, " in " + std::string(file) + "\n"));
    }
  }

  TEST_CASE("US-32 what a sender has queued goes out after a reload has restarted it, each event once") {
    const rtdata::test::RuntimeFolder runtime;
    const Folder folder;
    // A peer that acknowledges each line, a few of a connection at a time.
    folder.write("peer.py", R"(
import socket, threading, time
server = socket.create_server(("127.0.0.1", 0))
open("port", "w").write(str(server.getsockname()[1]))
lines = open("lines", "w")
def serve(client):
    file = client.makefile("rwb")
    for line in file:
        lines.write(line.decode()); lines.flush()
        time.sleep(0.002)
        file.write(b"ok\n"); file.flush()
while True:
    client, _ = server.accept()
    threading.Thread(target=serve, args=(client,), daemon=True).start()
)");
    Process peer(folder, "/usr/bin/env", {"python3", "peer.py"});
    std::string port;
    for (int i = 0; i < 6000 && port.empty(); ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds{10});
      port = folder.read("port");
    }
    REQUIRE(!port.empty());
    const auto text = [&](const std::string& window) {
      return R"({"name": "rig", "sensors": [{"name": "a", "type": "tallied", "rate": "200 Hz"}],
        "sinks": [{"type": "tcp", "name": "far", "host": "127.0.0.1", "port": )" +
             port + R"(, "format": "jsonl", "acknowledge": "line", "batch_time": "200 ms", "window": )" + window +
             "}]}";
    };
    folder.write("rig.json", text("4"));
    Process run(folder, built("rtdata_test_program"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    for (const char* window : {"3", "2", "4"}) {
      std::this_thread::sleep_for(std::chrono::milliseconds{300});
      folder.write("rig.json", text(window));
      Process reload(folder, built("rtdata"), {"ctl", "reload"});
      CHECK(reload.end() == 0);
      CHECK(has(reload.out, "sink far: restarted (window)"));
    }
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK_MESSAGE(!has(run.out, "dropped by"), run.out);  // the machine may have missed a tick
    std::set<std::string> sequences;
    std::istringstream lines(folder.read("lines"));
    std::size_t count = 0;
    for (std::string line; std::getline(lines, line); ++count) {
      const std::size_t at = line.find("\"sequence\":");
      REQUIRE(at != std::string::npos);
      const bool is_command = has(line, "rtdata/commands");  // which have sequences of their own
      sequences.insert((is_command ? "command " : "") + line.substr(at, line.find_first_of(",}", at) - at));
    }
    CHECK(count == sequences.size());
    CHECK(sequences.size() > 100);
    CHECK(has(run.out, std::to_string(sequences.size()) + " events"));
    peer.signal(SIGTERM);
    (void)peer.end();
  }

  TEST_CASE("US-41 a reload keeps the state of a machine that resumes, though its recording does not have it yet") {
    const rtdata::test::RuntimeFolder runtime;
    const Folder folder;
    const auto text = [](const std::string& cause) {
      return R"({"name": "rig", "machines": [{"name": "m", "start": "a",
        "states": [{"name": "a"}, {"name": "b"}],
        "transitions": [{"from": "a", "to": "b", "event": "go", "cause": ")" +
             cause + R"("},
                        {"from": "b", "to": "a", "event": "back"}],
        "resume": {"recording": "run.db", "max_age": "5 min", "unknown_age": "start", "wait": "100 ms"}}],
        "sinks": [{"type": "sqlite", "path": "run.db"}]})";
    };
    folder.write("rig.json", text("one"));
    Process run(folder, built("rtdata"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    const auto ctl = [&](std::vector<std::string> words) {
      words.insert(words.begin(), "ctl");
      Process one(folder, built("rtdata"), words);
      CHECK(one.end() == 0);
      return one.out;
    };
    {
      auto other = rtdata::sqlite::Database::open(folder.path() + "/run.db", rtdata::sqlite::Database::Mode::write);
      other.execute("BEGIN IMMEDIATE");
      CHECK(has(ctl({"event", "m", "back"}), "in the state a nothing waits for it"));
      CHECK(ctl({"event", "m", "go"}) == "machine m has got the event go\n");
      folder.write("rig.json", text("two"));
      CHECK(has(ctl({"reload"}), "machine m: restarted (transitions)"));
    }
    CHECK(ctl({"event", "m", "back"}) == "machine m has got the event back\n");
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    auto recorded = rtdata::sqlite::Database::open(folder.path() + "/run.db", rtdata::sqlite::Database::Mode::read);
    auto rows = recorded.prepare("SELECT \"to\" FROM m ORDER BY sequence");
    std::string states;
    while (rows.step()) states += std::string(rows.text(0));
    CHECK(states == "abba");

    // What was commanded is commanded again.
    std::string again = text("two");
    again.replace(again.rfind("run.db"), 6, "new.db");
    folder.write("again.json", again);
    Process replay(folder, built("rtdata"),
                   {"replay", "run.db", "again.json", "--topic", "rtdata/commands", "--speed", "max"});
    CHECK(replay.end() == 0);
    auto replayed = rtdata::sqlite::Database::open(folder.path() + "/new.db", rtdata::sqlite::Database::Mode::read);
    auto changes = replayed.prepare("SELECT \"to\" FROM m ORDER BY sequence");
    states.clear();
    while (changes.step()) states += std::string(changes.text(0));
    CHECK(states == "aba");
  }

  TEST_CASE("US-5 a reload to a file that another process writes is refused as a whole, and check says so before") {
    const rtdata::test::RuntimeFolder runtime;
    const Folder folder;
    const std::string program = built("rtdata");
    const auto text = [](const std::string& sink) {
      return R"({"sensors": [{"name": "l", "type": "host", "quantity": "load", "rate": "50 Hz"}], "sinks": [)" + sink +
             "]}";
    };
    const auto recording = [&](const char* file) {
      return text(R"({"type": "sqlite", "path": ")" + std::string(file) + R"("})");
    };
    const auto lines = [&](const char* file) {
      return text(R"({"type": "file", "path": ")" + std::string(file) + R"(", "format": "csv", "topics": ["l"]})");
    };
    folder.write("other.json", text(R"({"type": "sqlite", "path": "other.db"},
      {"type": "file", "path": "other-{topic}.csv", "format": "csv"})"));
    folder.write("rig.json", recording("own.db"));
    folder.write("now.json", recording("own.db"));
    Process other(folder, program, {"run", "other.json"});
    REQUIRE(other.wait_for("running other"));
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    // Made with the first batch.
    for (int looks = 0; looks < 6000 && !folder.has("other-l.csv"); ++looks)
      std::this_thread::sleep_for(std::chrono::milliseconds{10});
    REQUIRE(folder.has("other-l.csv"));
    const auto reload = [&](int status) {
      Process ctl(folder, program, {"ctl", "rig", "reload"});
      CHECK_MESSAGE(ctl.end() == status, ctl.err);
      return ctl.out + ctl.err;
    };
    for (const char* file : {"other.db", "other-l.csv"}) {
      CAPTURE(file);
      const bool is_recording = std::string(file) == "other.db";
      folder.write("rig.json", is_recording ? recording(file) : lines(file));
      const std::string said = reload(1);
      CHECK_MESSAGE(has(said, "nothing was changed: sink " + std::string(file) + ": cannot record into"), said);
      CHECK(has(said, is_recording ? " records into it" : " writes it"));
      CHECK_FALSE(has(said, "sink own.db: removed"));
      Process check(folder, program, {"check", "rig.json", "--against", "now.json"});
      CHECK(check.end() == 1);
      CHECK(has(check.out, std::string("sink ") + file + ": refused: cannot record into"));
    }
    folder.write("rig.json", lines("other-{topic}.csv"));  // the topic's file, which the path does not say
    CHECK(has(reload(1), "nothing was changed: sink other-{topic}.csv: cannot record into"));
    // What it has itself, or has just closed, is no obstacle.
    for (const char* file : {"next.db", "own.db", "next.db", "own.db"}) {
      folder.write("rig.json", recording(file));
      CHECK(has(reload(0), "rig.json is applied"));
    }
    other.signal(SIGTERM);
    CHECK(other.end() == 0);
    folder.write("rig.json", recording("other.db"));
    CHECK(has(reload(0), "sink other.db: added"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK_FALSE(has(run.out, "dropped by"));
    for (const char* file : {"own.db", "next.db", "other.db"}) {
      Process verify(folder, program, {"verify", file});
      CHECK(verify.end() == 0);
      CHECK(has(verify.out, "balanced"));
    }
  }

  TEST_CASE("US-5 a reload tells which sink could not open its file") {
    const rtdata::test::RuntimeFolder runtime;
    const Folder folder;
    const std::string program = built("rtdata");
    const auto text = [](const std::string& file) {
      return R"({"sensors": [{"name": "l", "type": "host", "quantity": "load", "rate": "50 Hz"}], "sinks": [
        {"type": "sqlite", "path": ")" +
             file + R"(", "close_deadline": "100 ms"}]})";
    };
    folder.write("rig.json", text("first.db"));
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    auto other = rtdata::sqlite::Database::open(folder.path() + "/second.db", rtdata::sqlite::Database::Mode::write);
    other.execute("BEGIN IMMEDIATE");  // no program that records, and so without its lock
    folder.write("rig.json", text("second.db"));
    const std::string said = reloaded(folder, program, {}, 0);
    CHECK_MESSAGE(has(said, "sink second.db stores nothing yet"), said);
    CHECK(has(said, "sink second.db: added"));
    other.execute("ROLLBACK");
    run.signal(SIGTERM);
    run.end();
    CHECK(has(run.out, "ledger balances"));
  }

  TEST_CASE("US-5 a reload leaves the locks alone by which SQLite knows that a recording is open") {
    const Folder folder;
    const std::string program = built("rtdata");
    folder.write("rig.json", R"({"sensors": [{"name": "l", "type": "host", "quantity": "load", "rate": "50 Hz"}],
      "sinks": [{"type": "sqlite", "path": "run.db"}]})");
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    run.signal(SIGHUP);
    REQUIRE(run.wait_for("rig.json is applied"));
    {
      // The last one that closes a database removes its log: another program must see that this is not the last.
      const auto reader = rtdata::sqlite::Database::open(folder.path() + "/run.db",
                                                         rtdata::sqlite::Database::Mode::write);
      CHECK(reader.integer("SELECT count(*) FROM rtdata_run") == 1);
    }
    CHECK(folder.has("run.db-wal"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    Process verify(folder, program, {"verify", "run.db"});
    CHECK(verify.end() == 0);
  }

  TEST_CASE("US-5 SIGHUP with a file that is a FIFO is refused, and the run goes on and ends as always") {
    const Folder folder;
    folder.write("rig.json", rig("100 Hz", ""));
    Process run(folder, built("rtdata_test_program"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    REQUIRE(std::filesystem::remove(folder.path() + "/rig.json"));
    REQUIRE(::mkfifo((folder.path() + "/rig.json").c_str(), 0600) == 0);
    run.signal(SIGHUP);
    REQUIRE(run.wait_for("nothing was changed: 1 mistake in rig.json"));
    CHECK(has(run.err, "cannot read the configuration: it is not a regular file"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK(has(run.out, "ledger balances"));
  }

  TEST_CASE("US-5 while a reload hangs in reading the file, a signal sets outputs safe and ends the run in time") {
    const rtdata::test::RuntimeFolder runtime;
    for (const bool by_ctl : {false, true}) {
      CAPTURE(by_ctl);
      const Folder folder;
      const auto text = [](const std::string& more) {
        return R"({"sensors": [{"name": "a", "type": "tallied", "rate": "100 Hz"})" + more + R"(],
          "outputs": [{"name": "valve", "type": "command", "run": ["sh", "-c", "echo {value} >> valve.txt"]}],
          "sinks": [{"type": "sqlite", "path": "run.db"}]})";
      };
      const std::string program = built("rtdata_test_program");
      folder.write("rig.json", text(""));
      Process run(folder, program, {"run", "rig.json"});
      REQUIRE(run.wait_for("running rig"));
      Process set(folder, program, {"ctl", "set", "valve", "1"});
      CHECK_MESSAGE(set.end() == 0, set.err);
      folder.write("rig.json", text(R"(, {"name": "b", "type": "absent", "rate": "1 Hz", "check_hangs": true})"));
      Process ctl(folder, program, {"ctl", by_ctl ? "reload" : "show"});
      if (!by_ctl) run.signal(SIGHUP);
      REQUIRE(run.wait_for("it hangs now"));
      run.signal(SIGTERM);
      const auto begin = std::chrono::steady_clock::now();
      CHECK(run.end() == 1);
      CHECK(std::chrono::steady_clock::now() - begin < std::chrono::seconds{5});
      CHECK_MESSAGE(has(run.err, "ended though it hangs: reading rig.json"), run.err);
      CHECK(has(run.out, "ledger balances"));
      CHECK(folder.read("valve.txt").ends_with("0\n"));
      ctl.end();
      if (const std::string said = ctl.err + ctl.out; by_ctl) CHECK_MESSAGE(has(said, "it ends already"), said);
      Process verify(folder, program, {"verify", "run.db"});
      CHECK(verify.end() == 0);
    }
  }

  TEST_CASE("US-5 check says what becomes of each part of a running system") {
    const Folder folder;
    folder.write("now.json", rig("100 Hz", ""));
    folder.write("next.json", rig("50 Hz", ""));
    folder.write("other.json", R"({"name": "other", )" + rig("50 Hz", "").substr(1));
    const std::string program = built("rtdata_test_program");
    Process same(folder, program, {"check", "now.json", "--against", "now.json"});
    CHECK(same.end() == 0);
    CHECK(has(same.out, "nothing changes"));
    Process live(folder, program, {"check", "next.json", "--against", "now.json"});
    CHECK(live.end() == 0);
    CHECK(has(live.out, "sensor a: changed while it runs (rate)"));
    Process refused(folder, program, {"check", "other.json", "--against", "now.json"});
    CHECK(refused.end() == 1);
    CHECK(has(refused.out, "name: refused"));
    // As the reload says it: the guard of outputs begins before the loops.
    std::string first = rig("100 Hz", "");
    first.insert(first.rfind('}'), R"(, "outputs": [{"name": "o", "type": "serial", "device": "/dev/null"}])");
    folder.write("first.json", first);
    Process guarded(folder, program, {"check", "first.json", "--against", "now.json"});
    CHECK(guarded.end() == 1);
    CHECK(has(guarded.out,
              "output o: refused: the guard of outputs starts only with the program: start the program again"));
    Process second(folder, program, {"check", "first.json", "--against", "first.json"});
    CHECK(second.end() == 0);
  }
}
