// `rtdata ctl`: a running instance is commanded, and each command is recorded. The real programs.
#include <doctest/doctest.h>

#include <nlohmann/json.hpp>

#include "app/control/commands.hpp"
#include "app/control/control_socket.hpp"
#include "app/runtime_folder.hpp"
#include "has.hpp"
#include "paths.hpp"

using rtdata::app::ControlClient;
using rtdata::app::running_instances;
using rtdata::test::built;
using rtdata::test::Folder;
using rtdata::test::Process;
using rtdata::test::RuntimeFolder;
using namespace std::chrono_literals;

namespace {

using rtdata::test::program;

using rtdata::test::has;

std::string rig(const std::string& rate) {
  return R"({"name": "rig", "sensors": [
    {"name": "load", "type": "host", "quantity": "load", "rate": ")" +
         rate + R"("},
    {"name": "alarm", "type": "limit", "on": "load", "field": "tasks", "high": 0, "latched": true}],
    "sinks": [{"type": "file", "name": "lines", "path": "out.jsonl", "format": "jsonl"}]})";
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("ctl commands a running instance, says what came of it, and records it") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig("100 Hz"));
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    const auto ctl = [&](std::vector<std::string> words, int status) {
      words.insert(words.begin(), "ctl");
      Process one(folder, program, words);
      CHECK(one.end() == status);
      return one.out + one.err;
    };
    CHECK(ctl({"rate", "load", "50 Hz"}, 0) == "sensor load is read at 50 Hz\n");
    CHECK(ctl({"rig", "stop", "load"}, 0) == "sensor load is stopped\n");
    CHECK(ctl({"stop", "load"}, 0) == "sensor load has stopped already\n");
    CHECK(ctl({"start", "load"}, 0) == "sensor load is started\n");
    CHECK(ctl({"note", "the",
               "valve is \xc3\xbc"
               "ber"},
              0) == "noted\n");
    CHECK(has(ctl({"note", std::string(1000, 'x')}, 1), "it has 1005 bytes, more than 240"));
    CHECK(has(ctl({"note", "two\nlines"}, 1), "it has a control character"));
    CHECK(has(ctl({"acknowledge", "alarm"}, 2), "there is no command \"acknowledge\""));
    CHECK(ctl({"ack", "alarm"}, 0) == "the alarm of alarm is acknowledged\n");
    CHECK(ctl({"ack", "alarm"}, 0) == "there is no alarm of alarm to acknowledge\n");
    // What cannot be done is refused with the reason, and changes nothing.
    CHECK(has(ctl({"ack", "load"}, 1), "sensor load is not a limit"));
    CHECK(has(ctl({"start", "laod"}, 1), "did you mean \"load\"?"));
    CHECK(has(ctl({"rate", "load", "fast"}, 1), "fast"));
    CHECK(has(ctl({"rate", "alarm", "5 Hz"}, 1), "the sensor is fed, not sampled"));
    CHECK(has(ctl({"rate", "load"}, 1), "write it as `rate SENSOR RATE`"));
    CHECK(has(ctl({"restart"}, 2), "there is no command \"restart\""));
    CHECK(has(ctl({}, 2), "rtdata: which command? [bad-argument]\ncommands:\n"));
    CHECK(has(ctl({"rog", "stop", "load"}, 1), "no running instance is called \"rog\""));
    // Reload: the same file, another, one with a mistake.
    CHECK(has(ctl({"reload"}, 0), "sensor load: changed while it runs (rate)") == false);
    folder.write("rig.json", rig("20 Hz"));
    CHECK(has(ctl({"reload"}, 0), "sensor load: changed while it runs (rate)"));
    folder.write("rig.json", rig("20 Herz"));
    const std::string refused = ctl({"reload"}, 1);
    CHECK(has(refused, "nothing was changed: 1 mistake in rig.json"));
    CHECK(has(refused, "sensors[0].rate"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);

    std::vector<nlohmann::json> commands;
    std::istringstream lines(folder.read("out.jsonl"));
    for (std::string line; std::getline(lines, line);) {
      const auto event = nlohmann::json::parse(line);
      if (event.contains("topic") && event["topic"] == rtdata::app::command_topic) commands.push_back(event);
    }
    REQUIRE(commands.size() == 17);
    CHECK(has(commands[0].dump(), "rate load 50 Hz"));
    CHECK(has(commands[0].dump(), "uid " + std::to_string(::geteuid()) + ", pid "));
    CHECK(has(commands[4].dump(),
              "note the valve is \xc3\xbc"
              "ber"));
    CHECK(has(commands[5].dump(), "xxx..."));
    CHECK(has(commands[9].dump(), "sensor load is not a limit"));
    CHECK(has(folder.read("rig.log"), "`rate load 50 Hz` by uid"));
    CHECK(Process(folder, program, {"ctl", "note", "x"}).end() == 1);  // nothing runs any more
  }

  TEST_CASE("NFR-1 a command that does not come back from a tier is answered, and what needs that tier is refused") {
    const RuntimeFolder runtime;
    const Folder folder;
    const std::string begin = R"({"name": "rig", "tiers": {"fast": {}},
      "sensors": [ {"name": "a", "type": "absent", "rate": "10 Hz", "hangs": true, "start": false, "tier": "fast"},
                   {"name": "b", "type": "tallied", "rate": "100 Hz"} ], "sinks": [ {"type": "discard"})";
    folder.write("rig.json", begin + " ] }");
    Process run(folder, built("rtdata_test_program"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    Process start(folder, program, {"ctl", "start", "a"});
    CHECK(start.end() == 1);
    CHECK(has(start.err, "the loop has begun to do what was asked, and may still finish"));
    Process stop(folder, program, {"ctl", "stop", "a"});
    CHECK(stop.end() == 1);
    Process other(folder, program, {"ctl", "stop", "b"});  // the main loop is not held
    CHECK(other.end() == 0);
    folder.write("rig.json", begin + R"(, {"type": "discard", "name": "second"} ] })");
    Process reload(folder, program, {"ctl", "reload"});
    CHECK(reload.end() == 1);
    CHECK(has(reload.err, "cannot apply the configuration: tier fast"));
    CHECK(has(reload.err, "nothing was changed"));
    run.signal(SIGTERM);
    CHECK(run.end() == 1);
    CHECK(has(run.err, "ended though it hangs: tier fast"));
  }

  TEST_CASE("garbage on the control socket is answered, many commands are all done, and nothing is lost") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig("1 Hz"));
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    REQUIRE(running_instances().size() == 1);
    auto client = ControlClient::connect(running_instances()[0].path);
    REQUIRE(client);
    const auto ask = [&](const std::string& line) {
      const auto answer = client->ask(line, 30s);
      REQUIRE(answer);
      return *answer;
    };
    for (const char* garbage :
         {"", "x", "{}", R"({"request":"command"})", R"({"request":"command","words":"stop"})",
          R"({"request":"command","words":[]})", R"({"request":"command","words":[1]})", R"({"request":["command"]})",
          "\xff\xfe", R"({"request":"command","words":["note","x"])"})
      CHECK(has(ask(garbage), "\"error\""));
    CHECK(has(ask(R"({"request":"command","words":["note"]})"), "refused"));
    CHECK(has(ask(R"({"request":"command","words":["rate","load","50 Hz","now"]})"), "refused"));
    for (int i = 0; i < 200; ++i)
      CHECK(ask(R"({"request":"command","words":["note",")" + std::to_string(i) + "\"]}") == R"({"done":"noted"})");
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK(has(run.out, "nothing lost"));
  }
}
