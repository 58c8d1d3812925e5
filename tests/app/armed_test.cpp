// What is armed and disarmed by command, over kills and reloads of the real program.
#include <doctest/doctest.h>
#include <signal.h>

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "app/process.hpp"
#include "app/runtime_folder.hpp"
#include "has.hpp"
#include "outputs/terminal.hpp"
#include "paths.hpp"
#include "recording/database.hpp"
#include "rtdata/process/expression.hpp"

using namespace std::chrono_literals;
using outputs_test::Terminal;
using rtdata::test::built;
using rtdata::test::Folder;
using rtdata::test::Process;

namespace {

using rtdata::test::has;

/// A machine that arms its igniter on the pad and fires it in `fly`, which resumes.
class Bench {
 public:
  Bench() { write(""); }
  void write(const std::string& output, const std::string& batch_time = "20 s", const std::string& topics = "#") {
    folder.write("rig.json", R"({"name": "rig",
      "outputs": [{"name": "igniter", "type": "serial", "device": ")" +
                                 line.name + R"(", "text": "<{value}>", "armed": "by command")" + output + R"(}],
      "machines": [{"name": "m", "start": "pad",
        "states": [{"name": "pad", "arm": ["igniter"]}, {"name": "fly", "set": [{"output": "igniter"}]}],
        "transitions": [{"from": "pad", "to": "fly", "event": "go"}, {"from": "fly", "to": "pad", "event": "back"}],
        "resume": {"recording": "run.db", "max_age": "5 min", "unknown_age": "start"}}],
      "sinks": [{"type": "sqlite", "path": "run.db", "topics": [")" +
                                 topics + R"("], "batch_time": ")" + batch_time + "\"}]}");
  }
  void start() {
    process = std::make_unique<Process>(folder, built("rtdata"), std::vector<std::string>{"run", "rig.json"});
    REQUIRE(process->wait_for("running rig"));
  }
  void kill_and_start() {
    process->signal(SIGKILL);
    CHECK(process->end() == 128 + SIGKILL);
    start();
  }
  std::string ctl(std::vector<std::string> words, int status = 0) const {
    words.insert(words.begin(), "ctl");
    Process one(folder, built("rtdata"), words);
    CHECK(one.end() == status);
    return one.out + one.err;
  }
  void end() {
    process->signal(SIGTERM);
    CHECK(process->end() == 0);
    CHECK(Process(folder, built("rtdata"), {"verify", "run.db"}).end() == 0);
  }

  const rtdata::test::RuntimeFolder runtime;
  const Folder folder;
  Terminal line;
  std::unique_ptr<Process> process;
};

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-35 US-41 an output that was armed or disarmed by command is so after a kill at once") {
    Bench b;
    b.start();
    CHECK(b.ctl({"arm", "igniter"}) == "output igniter is armed\n");
    b.kill_and_start();
    CHECK(b.ctl({"arm", "igniter"}) == "output igniter is armed already\n");
    CHECK(b.ctl({"event", "m", "go"}) == "machine m has got the event go\n");
    CHECK(b.line.reads("<1>"));
    // Disarmed while it is on: recorded when the device has answered.
    CHECK(has(b.ctl({"disarm", "igniter"}), "output igniter is disarmed"));
    CHECK(b.line.reads("<0>"));
    b.kill_and_start();
    CHECK(has(b.ctl({"set", "igniter", "1"}, 1), "it is disarmed"));
    CHECK(b.ctl({"event", "m", "back"}) == "machine m has got the event back\n");
    CHECK(b.ctl({"arm", "igniter"}) == "output igniter is armed\n");
    CHECK(b.ctl({"disarm", "igniter"}) == "output igniter is disarmed: it has its safe value\n");
    b.kill_and_start();
    b.line.got.clear();
    CHECK(b.ctl({"event", "m", "go"}) == "machine m has got the event go\n");
    CHECK_FALSE(b.line.reads_within("<1>", 500ms));
    b.end();
  }

  TEST_CASE("US-35 US-41 who arms and disarms is told when a kill would undo that") {
    Bench b;
    b.start();
    CHECK(b.ctl({"arm", "igniter"}) == "output igniter is armed\n");
    {
      auto other = rtdata::sqlite::Database::open(b.folder.path() + "/run.db", rtdata::sqlite::Database::Mode::write);
      other.execute("BEGIN IMMEDIATE");
      CHECK(has(b.ctl({"disarm", "igniter"}, 1),
                "output igniter is disarmed: it has its safe value; but that is not on the disk in run.db, after 3 s: "
                "after a kill or a power failure now, machine m would arm it again"));
      CHECK(has(b.ctl({"arm", "igniter"}, 1),
                "output igniter is armed; but that is not on the disk in run.db, after 3 s: after a kill or a power "
                "failure now, machine m would not arm it again"));
    }
    // A second command waits for it anew.
    CHECK(b.ctl({"arm", "igniter"}) == "output igniter is armed already\n");
    b.kill_and_start();
    CHECK(b.ctl({"arm", "igniter"}) == "output igniter is armed already\n");
    CHECK(has(b.ctl({"disarm", "igniter"}), "output igniter is disarmed"));
    b.end();
    // A recording without the output: no machine arms it again.
    b.write("", "20 s", "m");
    b.start();
    CHECK(b.ctl({"arm", "igniter"}) == "output igniter is armed\n");
    b.kill_and_start();
    CHECK(b.ctl({"disarm", "igniter"}) == "output igniter is disarmed: it has its safe value\n");
    CHECK(b.ctl({"arm", "igniter"}) == "output igniter is armed\n");
    b.end();
  }

  TEST_CASE("a machine that cannot read whether an output was armed says so, and leaves it disarmed") {
    Bench b;
    b.start();
    CHECK(b.ctl({"arm", "igniter"}) == "output igniter is armed\n");
    b.process->signal(SIGKILL);
    CHECK(b.process->end() == 128 + SIGKILL);
    rtdata::sqlite::Database::open(b.folder.path() + "/run.db", rtdata::sqlite::Database::Mode::write)
        .execute("UPDATE igniter SET armed = 'x'");
    b.start();
    CHECK_MESSAGE(has(b.process->err,
                      "error: machine m: output igniter is not armed again: the program could not read its last state"),
                  b.process->err);
    CHECK(has(b.ctl({"set", "igniter", "1"}, 1), "it is disarmed"));
    b.process->signal(SIGTERM);
    CHECK(b.process->end() == 0);
  }

  TEST_CASE("US-35 US-41 a reload of what a machine uses fires nothing again, and leaves what is armed alone") {
    Bench b;
    b.write(R"(, "lease": "200 ms")");
    b.start();
    CHECK(b.ctl({"arm", "igniter"}) == "output igniter is armed\n");
    CHECK(b.ctl({"event", "m", "go"}) == "machine m has got the event go\n");
    CHECK(b.line.reads("<0><1><0>"));
    b.write(R"(, "lease": "200 ms")", "10 s");
    const std::string reloaded = b.ctl({"reload"});
    CHECK_MESSAGE(has(reloaded, "machine m: restarted (it uses sink run.db)"), reloaded);
    CHECK_FALSE(b.line.reads_within("<1>", 500ms));
    b.write(R"(, "lease": "300 ms")", "10 s");
    const std::string refused = b.ctl({"reload"}, 1);
    CHECK(has(refused, "output igniter: refused: it is armed; disarm it first"));
    CHECK(has(refused, "nothing was changed"));
    CHECK(b.ctl({"set", "igniter", "1"}) == "output igniter is being set to 1\n");
    CHECK(b.line.reads("<0><1><0><1><0>"));
    CHECK(has(b.ctl({"disarm", "igniter"}), "output igniter is disarmed"));
    CHECK(has(b.ctl({"reload"}), "output igniter: restarted (lease)"));
    CHECK(b.line.got.find("<1>", 13) == std::string::npos);
    b.end();
  }

  TEST_CASE(
      "US-35 a machine that a reload adds again arms nothing, though its recording is the second of the program") {
    Bench b;
    const auto write = [&](const std::string& machines, const std::string& batch_time) {
      b.folder.write("rig.json", R"({"name": "rig",
        "outputs": [{"name": "igniter", "type": "serial", "device": ")" +
                                     b.line.name + R"(", "text": "<{value}>", "armed": "by command"}],
        "machines": [)" + machines + R"(],
        "sinks": [{"name": "first", "type": "sqlite", "path": "first.db"},
                  {"name": "second", "type": "sqlite", "path": "second.db", "batch_time": ")" +
                                     batch_time + R"("}]})");
    };
    const std::string machine = R"({"name": "m", "start": "pad",
      "states": [{"name": "pad", "arm": ["igniter"]}, {"name": "fly", "set": [{"output": "igniter"}]}],
      "transitions": [{"from": "pad", "to": "fly", "event": "go"}, {"from": "fly", "to": "pad", "event": "back"}],
      "resume": {"recording": "second", "max_age": "5 min", "unknown_age": "start"}})";
    write(machine, "20 s");
    b.start();
    CHECK(b.ctl({"arm", "igniter"}) == "output igniter is armed\n");
    CHECK(b.ctl({"event", "m", "go"}) == "machine m has got the event go\n");
    CHECK(b.line.reads("<0><1>"));
    write("", "21 s");  // the recording is closed and opened again: that it was armed is stored, in a run that ended
    CHECK(has(b.ctl({"reload"}), "machine m: removed"));
    b.ctl({"disarm", "igniter"});  // not yet stored
    write(machine, "21 s");
    CHECK(has(b.ctl({"reload"}), "machine m: added"));
    const std::string refused = b.ctl({"set", "igniter", "1"}, 1);
    CHECK_MESSAGE(has(refused, "armed"), refused);
    CHECK(b.line.got.find("<1>", 6) == std::string::npos);
    b.process->signal(SIGTERM);
    CHECK(b.process->end() == 0);
    CHECK(Process(b.folder, built("rtdata"), {"verify", "second.db"}).end() == 0);
  }
}
