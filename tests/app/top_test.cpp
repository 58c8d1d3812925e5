// `rtdata top` and what it looks at: the real programs.
#include <doctest/doctest.h>

#include <nlohmann/json.hpp>

#include "app/control/control_socket.hpp"
#include "app/runtime_folder.hpp"
#include "has.hpp"
#include "paths.hpp"

using rtdata::app::ControlClient;
using rtdata::app::Instance;
using rtdata::app::running_instances;
using rtdata::test::Folder;
using rtdata::test::Process;
using rtdata::test::RuntimeFolder;
using namespace std::chrono_literals;

namespace {

const std::string program = rtdata::test::built("rtdata_test_program");

constexpr const char* rig = R"({
  "name": "rig",
  "sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz", "topic": "count/a"},
               {"name": "gone", "type": "absent", "rate": "10 Hz", "device": "/dev/missing_thing"} ],
  "sinks": [ {"type": "discard"} ]
})";

using rtdata::test::has;

nlohmann::json ask(ControlClient& client) {
  auto answer = client.ask(R"({"request":"status"})", 30s);
  REQUIRE(answer);
  return nlohmann::json::parse(*answer);
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("NFR-6 top shows a bus with its type and what uses it") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("bus.json", R"({"buses": {"wire": {"type": "loopback"}, "idle": {"type": "loopback"}},
      "sensors": [{"name": "w", "type": "wired", "bus": "wire", "rate": "10 Hz"}], "sinks": [{"type": "discard"}]})");
    Process run(folder, program, {"run", "bus.json"});
    REQUIRE(run.wait_for("running bus"));
    Process top(folder, program, {"top", "--once"});
    CHECK(top.end() == 0);
    CHECK(has(top.out, "bus wire                       loopback         sensor w"));
    CHECK(has(top.out, "bus idle                       loopback         -"));
  }

  TEST_CASE("NFR-1 top and the log say what each chip has cost its bus, and how often it failed") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("bus.json", R"({"buses": {"i2c9": {"type": "i2c", "device": "/no/such/adapter"}},
      "sensors": [{"name": "t", "type": "lm75", "bus": "i2c9", "rate": "100 Hz"}], "sinks": [{"type": "discard"}]})");
    Process run(folder, program, {"run", "bus.json"});
    REQUIRE(run.wait_for("faulted"));
    Process top(folder, program, {"top", "--once"});
    CHECK(top.end() == 0);
    CHECK(has(top.out, "  - address 0x48: "));
    CHECK(has(top.out, " failed, 0 retries"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    const std::string log = folder.read("bus.log");
    CHECK(has(log, "bus i2c9: address 0x48: "));
  }

  TEST_CASE("NFR-5 top shows an alarm that was raised before it looked, until it is acknowledged") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("air.txt", "3000\n");
    folder.write("hot.json", R"({"sensors": [
      {"name": "air", "type": "analog", "file": "air.txt", "rate": "50 Hz", "quantization_bits": 12, "scale": 100},
      {"name": "overheat", "type": "limit", "on": "air", "field": "value", "high_high": 60, "latched": true}],
      "sinks": [{"type": "sqlite", "path": "hot.db"}]})");
    Process run(folder, program, {"run", "hot.json"});
    REQUIRE(run.wait_for("running hot"));
    std::string shown;
    for (int i = 0; i < 100 && !has(shown, "alarm"); ++i) {
      Process top(folder, program, {"top", "--once"});
      CHECK(top.end() == 0);
      shown = top.out;
    }
    CAPTURE(shown);
    CHECK(has(shown, "  ! alarm high_high, not acknowledged: rtdata ctl ack overheat"));
    CHECK(shown.find("overheat") < shown.find("\nair"));  // what is not well comes first
    Process ack(folder, program, {"ctl", "ack", "overheat"});
    CHECK(ack.end() == 0);
    Process again(folder, program, {"top", "--once"});
    CHECK(again.end() == 0);
    CHECK(has(again.out, "  ! alarm high_high, acknowledged"));
    Process json(folder, program, {"top", "--once", "--json"});
    CHECK(json.end() == 0);
    CHECK(has(json.out, R"("value":"high_high at 73.24)"));
    CHECK(has(json.out, R"("alarm":{"alarm":"high_high","active":true,"acknowledged":true})"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
  }

  TEST_CASE("NFR-5 a run answers on its socket how its sensors and sinks do") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig);
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    const std::vector<Instance> instances = running_instances();
    REQUIRE(instances.size() == 1);
    auto client = ControlClient::connect(instances[0].path);
    REQUIRE(client);
    nlohmann::json first = ask(*client);
    CHECK(first["instance"]["name"] == "rig");
    CHECK(first["instance"]["pid"] == instances[0].pid);
    CHECK(first["instance"]["configuration"] == "rig.json");
    CHECK(first["sensors"][0]["reached_hz"].is_null());
    nlohmann::json status;
    do {
      status = ask(*client);
    } while (status["sensors"][0]["value"].is_null() || status["sensors"][1]["health"]["state"] != "faulted");
    const nlohmann::json& sensor = status["sensors"][0];
    CHECK(sensor["name"] == "a");
    CHECK(sensor["topic"] == "count/a");
    CHECK(sensor["loop"] == "main");
    CHECK(sensor["wanted_hz"] == 100);
    CHECK(sensor["reached_hz"].is_number());
    CHECK(sensor["failed"] == 0);
    CHECK(sensor["health"]["state"] == "ok");
    CHECK(std::stoull(sensor["value"].get<std::string>()) <= sensor["published"].get<std::uint64_t>());
    CHECK(sensor["lateness_ns"]["p50"] <= sensor["lateness_ns"]["max"]);
    const nlohmann::json& gone = status["sensors"][1];
    CHECK(gone["failed"] > 0);
    CHECK(has(gone["health"]["reason"].get<std::string>(), "/dev/missing_thing"));
    CHECK(gone["value"].is_null());
    const nlohmann::json& sink = status["sinks"][0];
    CHECK(sink["offered"].get<std::uint64_t>() ==
          sink["stored"].get<std::uint64_t>() + sink["queued"].get<std::uint64_t>());
    CHECK(sink["dropped"] == 0);
    CHECK(status["loops"][0]["name"] == "main");
    CHECK(status["loops"][0]["load_percent"].is_number());
    CHECK(status["topics"][0]["name"] == "count/a");
    bool has_sensor = false;
    for (const auto& callback : status["callbacks"]) {
      if (callback["name"] != "sensor a") continue;
      has_sensor = true;
      CHECK(callback["count"] > 0);
      CHECK(callback["max_ns"] <= callback["total_ns"]);
    }
    CHECK(has_sensor);
    // Of what does not change any more, every command says the same.
    for (const std::string name : {"a", "gone"})
      CHECK(client->ask(R"({"request":"command","words":["stop",")" + name + R"("],"version":1})", 30s));
    do {
      status = ask(*client);
    } while (status["queued"] != 0);
    const std::string events = status["total"]["published"].dump(), failed = status["total"]["failed"].dump();
    Process once(folder, program, {"top", "--once"});
    CHECK(once.end() == 0);
    CHECK(has(once.out, "\n" + events + " events, 0 queued; LOST: "));
    CHECK(has(once.out, failed + " failed"));
    run.signal(SIGINT);
    CHECK(run.end() == 0);
    CHECK(has(run.out, failed + " tick"));
    CHECK(has(run.out, "taken: " + events + " events"));
    CHECK(has(run.out, "ledger balances"));
    CHECK(runtime.sockets() == 0);
  }

  TEST_CASE("NFR-5 callbacks of every tier are listed, and a tier that hangs is said to, without waiting for it") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", R"({ "name": "rig", "tiers": { "fast": {}, "slow": {} },
      "sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz", "tier": "fast", "hold": "1 ms"},
                   {"name": "b", "type": "tallied", "rate": "100 Hz", "tier": "slow", "hang_at": 200},
                   {"name": "c", "type": "tallied", "rate": "100 Hz"} ],
      "sinks": [ {"type": "discard", "close_deadline": "100 ms"} ] })");
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    auto client = ControlClient::connect(running_instances().at(0).path);
    REQUIRE(client);
    const auto loop_of = [](const nlohmann::json& status, const std::string& name) {
      for (const auto& callback : status["callbacks"]) {
        if (callback["name"] == name) return callback["loop"].get<std::string>();
      }
      return std::string();
    };
    nlohmann::json status = ask(*client);
    const auto is_listed = [&](const char* name) { return !loop_of(status, name).empty(); };
    while (!is_listed("sensor a") || !is_listed("sensor b") || !is_listed("sensor c")) status = ask(*client);
    CHECK(loop_of(status, "sensor a") == "fast");
    CHECK(loop_of(status, "sensor b") == "slow");
    CHECK(loop_of(status, "sensor c") == "main");
    CHECK(status["loops"].at(1)["hangs_in"].is_null());
    while (status["loops"].at(2)["hangs_in"].is_null()) status = ask(*client);
    CHECK(status["loops"].at(2)["hangs_in"] == "sensor b");
    CHECK(status["loops"].at(1)["hangs_in"].is_null());
    CHECK(loop_of(status, "sensor a") == "fast");
    CHECK(loop_of(status, "sensor b") == "slow");  // as it was told last
    const auto health_of = [](const nlohmann::json& from, const std::string& name) {
      for (const auto& sensor : from["sensors"])
        if (sensor["name"] == name) return sensor["health"]["state"].get<std::string>();
      return std::string();
    };
    while (health_of(status, "b") != "faulted") status = ask(*client);
    CHECK(health_of(status, "a") == "ok");
    Process once(folder, program, {"top", "--once"});
    CHECK(once.end() == 0);
    CHECK(has(once.out, "\n  ! the loop does not turn: it has not returned from sensor b\n"));
    CHECK(has(once.out, "\nsensor a                       fast "));
    run.signal(SIGTERM);
    CHECK(run.end() == 1);
    CHECK(runtime.sockets() == 0);
  }

  TEST_CASE("NFR-5 top shows an instance once in 80 columns, as JSON, and on a terminal until q or Ctrl-C") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig);
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    REQUIRE(run.wait_for("faulted"));
    Process once(folder, program, {"top", "--once"});
    CHECK(once.end() == 0);
    CHECK(once.out.starts_with("rig  pid "));
    CHECK(has(once.out, "\na              main       100 Hz"));
    CHECK(has(once.out, "\n  ! faulted: cannot open the device: /dev/missing_thing"));
    CHECK(has(once.out, "\ndiscard "));
    CHECK(has(once.out, "\nsensor a "));
    CHECK_FALSE(has(once.out, "\x1b"));
    std::istringstream lines(once.out);
    for (std::string line; std::getline(lines, line);) CHECK(line.size() <= 80);

    Process json(folder, program, {"top", "rig", "--once", "--json"});
    CHECK(json.end() == 0);
    CHECK(std::count(json.out.begin(), json.out.end(), '\n') == 1);
    CHECK(nlohmann::json::parse(json.out)["sensors"].size() == 2);

    Process live(folder, program, {"top"}, Process::Output::terminal);
    REQUIRE(live.wait_for("q ends"));
    live.signal(SIGINT);
    CHECK(live.end() == 0);
    CHECK(live.out.find("\x1b[?25l") < live.out.find("rig  pid"));
    CHECK(live.out.find("\x1b[?25h") > live.out.find("q ends"));

    Process quits(folder, "/bin/sh", {"-c", "printf q | " + program + " top"});
    CHECK(quits.end() == 0);
    CHECK(quits.out.empty());
    run.signal(SIGINT);
    CHECK(run.end() == 0);
  }

  TEST_CASE("NFR-5 top ends well with the run that it looks at, and not with one that was killed") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig);
    for (const int signal : {SIGTERM, SIGKILL}) {
      CAPTURE(signal);
      Process run(folder, program, {"run", "rig.json"});
      REQUIRE(run.wait_for("running rig"));
      Process text(folder, program, {"top"});
      Process json(folder, program, {"top", "--json"});
      REQUIRE(text.wait_for("rig  pid "));
      REQUIRE(json.wait_for("{\"version\""));
      run.signal(signal);
      CHECK(run.end() == (signal == SIGKILL ? 128 + SIGKILL : 0));
      CHECK(text.end() == (signal == SIGKILL ? 1 : 0));
      CHECK(json.end() == (signal == SIGKILL ? 1 : 0));
      CHECK(has(text.err, signal == SIGKILL ? "no answer: instance: the instance has ended, or serves 8 later clients"
                                            : " has ended\n"));
    }
  }

  TEST_CASE("NFR-5 top without an instance says so; with several it lists them, and takes a name or pid") {
    const RuntimeFolder runtime;
    const Folder folder;
    Process none(folder, program, {"top", "--once"});
    CHECK(none.end() == 1);
    CHECK(has(none.err, "no instance is running"));

    folder.write("rig.json", rig);
    folder.write("other.json", R"({"sensors": [ {"name": "b", "type": "tallied", "rate": "10 Hz"} ]})");
    Process first(folder, program, {"run", "rig.json"});
    Process second(folder, program, {"run", "other.json"});
    REQUIRE(first.wait_for("running rig"));
    REQUIRE(second.wait_for("running other"));
    const std::vector<Instance> instances = running_instances();
    REQUIRE(instances.size() == 2);
    Process several(folder, program, {"top", "--once"});
    CHECK(several.end() == 2);
    for (const Instance& one : instances) CHECK(has(several.err, std::to_string(one.pid)));
    CHECK(has(several.err, "rig.json"));
    CHECK(has(several.err, "other.json"));
    Process named(folder, program, {"top", "other", "--once"});
    CHECK(named.end() == 0);
    CHECK(named.out.starts_with("other  pid "));
    Process by_pid(folder, program, {"top", std::to_string(instances[0].pid), "--once"});
    CHECK(by_pid.end() == 0);
    CHECK(has(by_pid.out, "pid " + std::to_string(instances[0].pid)));
    Process wrong(folder, program, {"top", "nobody", "--once"});
    CHECK(wrong.end() == 1);
    CHECK(has(wrong.err, "no running instance is called \"nobody\""));
  }

  TEST_CASE("top tells of an instance that does not answer, and looks at the others") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig);
    folder.write("other.json", R"({"sensors": [ {"name": "b", "type": "tallied", "rate": "10 Hz"} ]})");
    Process rig_run(folder, program, {"run", "rig.json"});
    REQUIRE(rig_run.wait_for("running rig"));
    const Instance stopped = running_instances().at(0);
    const std::string pid = std::to_string(stopped.pid);
    Process other(folder, program, {"run", "other.json"});
    REQUIRE(other.wait_for("running other"));
    rig_run.signal(SIGSTOP);
    Process live(folder, program, {"top", pid}, Process::Output::terminal);
    CHECK(live.wait_for("pid " + pid + " does not answer"));
    live.signal(SIGTERM);
    CHECK(live.end() == 0);
    Process once(folder, program, {"top", pid, "--once"});
    CHECK(once.end() == 1);
    CHECK(has(once.err, "pid " + pid + ": no status: instance: it does not answer: check whether it is stopped"));
    Process healthy(folder, program, {"top", "other", "--once"});
    CHECK(healthy.end() == 0);
    CHECK(healthy.out.starts_with("other  pid "));
    // So many connections wait for the one that is stopped that it takes no more.
    for (int i = 0; i < 10; ++i) (void)ControlClient::connect(stopped.path);
    Process several(folder, program, {"top", "--once"});
    CHECK(several.end() == 2);
    CHECK(has(several.err, pid + "  -      (does not answer)\n"));
    Process wrong(folder, program, {"top", "rig", "--once"});
    CHECK(wrong.end() == 1);
    CHECK(has(wrong.err, "no running instance that answers is called \"rig\""));
    CHECK(has(wrong.err, "name one that does not answer by its pid"));
    rig_run.signal(SIGCONT);
    rig_run.signal(SIGINT);
    CHECK(rig_run.end() == 0);
  }

  TEST_CASE("NFR-5 the socket of a killed run is skipped by top and removed by the next run") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig);
    {
      Process run(folder, program, {"run", "rig.json"});
      REQUIRE(run.wait_for("running rig"));
      run.signal(SIGKILL);
      CHECK(run.end() == 128 + SIGKILL);
    }
    CHECK(runtime.sockets() == 1);
    Process top(folder, program, {"top", "--once"});
    CHECK(top.end() == 1);
    Process next(folder, program, {"run", "rig.json"});
    REQUIRE(next.wait_for("running rig"));
    CHECK(runtime.sockets() == 1);
    CHECK(running_instances().size() == 1);
  }

  TEST_CASE("NFR-5 top sees a run that has a runtime directory of its own, as services have, beside others") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig);
    folder.write("other.json", R"({"sensors": [ {"name": "b", "type": "tallied", "rate": "10 Hz"} ]})");
    Process other(folder, program, {"run", "other.json"});
    REQUIRE(other.wait_for("running other"));
    const std::string own = runtime.path() + "/bench";
    Process service(folder, "/usr/bin/env",
                    {"-u", "RTDATA_RUNTIME_DIR", "RUNTIME_DIRECTORY=" + own + ":/run/another", program, "run",
                     "rig.json"});  // as systemd does
    REQUIRE(service.wait_for("running rig"));
    const std::vector<Instance> instances = running_instances();
    REQUIRE(instances.size() == 2);
    CHECK(std::count_if(instances.begin(), instances.end(), [&](const Instance& one) {
            return one.path == own + "/" + std::to_string(one.pid) + ".sock";
          }) == 1);
    Process top(folder, program, {"top", "rig", "--once"});
    CHECK(top.end() == 0);
    CHECK(top.out.starts_with("rig  pid "));
  }

  TEST_CASE("NFR-5 who may not look into a service's folder is told where it is") {
    const RuntimeFolder runtime;
    const std::string closed = runtime.path() + "/bench";
    std::filesystem::create_directories(closed);
    std::filesystem::permissions(closed, std::filesystem::perms::none);
    for (const std::filesystem::path& up :
         {std::filesystem::path(closed).parent_path(), std::filesystem::path(runtime.path()).parent_path()})
      std::filesystem::permissions(up, std::filesystem::perms{0755});
    CHECK(running_instances().empty());
    constexpr uid_t nobody = 65534;
    const bool is_root = ::geteuid() == 0;
    if (is_root) REQUIRE(::seteuid(nobody) == 0);
    const std::vector<std::string> found = rtdata::app::closed_folders();
    if (is_root) REQUIRE(::seteuid(0) == 0);
    CHECK(found == std::vector{closed});
    std::filesystem::permissions(closed, std::filesystem::perms{0700});
  }

  TEST_CASE("a run without a folder for its socket warns, and runs") {
    const Folder folder;
    ::setenv("RTDATA_RUNTIME_DIR", "/proc/nowhere", 1);
    folder.write("rig.json", rig);
    Process run(folder, program, {"run", "rig.json", "--for", "100ms"});
    CHECK(run.end() == 0);
    ::unsetenv("RTDATA_RUNTIME_DIR");
    CHECK(has(run.err, "cannot open the control socket"));
    CHECK(has(run.out, "ledger balances"));
  }
}
