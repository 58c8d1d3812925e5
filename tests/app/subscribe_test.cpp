// Readers of a running program: real programs, real recordings.
#include <doctest/doctest.h>
#include <signal.h>

#include <algorithm>

#include <map>
#include <nlohmann/json.hpp>
#include <optional>

#include "app/control/control_socket.hpp"
#include "app/runtime_folder.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "rtdata/sensors/feed.hpp"

using namespace rtdata;
using rtdata::app::ControlClient;
using rtdata::app::running_instances;
using rtdata::test::Folder;
using rtdata::test::has;
using rtdata::test::Process;
using rtdata::test::RuntimeFolder;
using namespace std::chrono_literals;
using nlohmann::json;

namespace {

const std::string program = rtdata::test::built("rtdata_test_program");

constexpr const char* rig = R"({
  "name": "rig",
  "sensors": [ {"name": "a", "type": "tallied", "rate": "200 Hz", "topic": "count/a"},
               {"name": "b", "type": "tallied", "rate": "20 Hz", "topic": "count/b"},
               {"name": "c", "type": "tallied", "rate": "20 Hz", "topic": "other"} ],
  "sinks": [ {"type": "sqlite", "name": "rec", "path": "rig.db"} ]
})";

struct PastRow {
  std::uint64_t number = 0;
  RTDATA_FIELDS(PastRow, (number))
};

/// An alarm or a gap, which every reader gets.
bool is_beside(const json& line) { return line["topic"].get<std::string>().starts_with("$"); }

/// Looks that every event of an origin comes once, or is told as dropped.
struct Sequences {
  std::map<std::string, std::uint64_t> last;  // 0: none came
  std::uint64_t dropped = 0, events = 0;
  void add(const json& line) {
    dropped += line.value("dropped", std::uint64_t{0});
    if (!line.contains("data") || is_beside(line)) return;
    const std::string origin = line["origin"];
    const std::uint64_t first = line["sequence"].is_array() ? line["sequence"][0] : line["sequence"];
    if (last[origin] != 0) CHECK(first - (last[origin] + 1) <= dropped);
    last[origin] = line["sequence"].is_array() ? line["sequence"][1] : line["sequence"];
    events += line.value("count", std::uint64_t{1});
  }
};

/// A reader that hears lines.
class Listener {
 public:
  explicit Listener(const std::string& request) : client_(connected()) { client_.send(request); }
  /// The next line; none: it was disconnected, or nothing came for half a minute.
  std::optional<json> next() {
    auto line = client_.receive(30s);
    if (!line || !*line) return std::nullopt;
    return json::parse(**line);
  }
  /// The next line with this key.
  json next(const char* key) {
    for (;;) {
      auto line = next();
      REQUIRE(line);
      if (line->contains(key)) return *line;
    }
  }
  /// The next event or step of the topics that it names; others are added to what came: on a loaded machine ticks are
  /// missed, and events dropped.
  json next_of_topics(Sequences& came) {
    for (;;) {
      auto line = next();
      REQUIRE(line);
      if (line->contains("data") && !is_beside(*line)) return *line;
      came.add(*line);
    }
  }
  json next_event(const std::string& topic) {
    for (;;) {
      json line = next("data");
      if (line["topic"] == topic) return line;
    }
  }

 private:
  static ControlClient connected() {
    const auto instances = running_instances();
    REQUIRE(instances.size() == 1);
    auto client = ControlClient::connect(instances[0].path);
    REQUIRE(client);
    return *std::move(client);
  }
  ControlClient client_;
};

void end_well(Process& run, const Folder& folder, const std::string& file) {
  run.signal(SIGTERM);
  CHECK(run.end() == 0);
  const VerifyReport report = verify(Recording::open(folder.path() + "/" + file).or_throw()).or_throw();
  CHECK(report.verdict() == Verdict::balanced);
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("NFR-5 two readers of a run get each event of the topics that they name, and steps of them") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig);
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    Listener each(R"({"request":"subscribe","topics":["count/+"]})");
    Listener steps(R"({"request":"subscribe","step":"100 ms"})");
    const auto hello = each.next();
    REQUIRE(hello);
    CHECK((*hello)["subscribed"] == json({"count/+"}));
    CHECK((*hello)["version"] == 1);
    Sequences of_each, of_steps;
    while (of_each.last["b"] < 20) {
      const json line = each.next_of_topics(of_each);
      CHECK(line["topic"].get<std::string>().starts_with("count/"));
      of_each.add(line);
    }
    CHECK(of_each.last["a"] > 100);
    CHECK(of_each.last.size() == 2);
    while (of_steps.last["c"] < 20) {
      const json line = steps.next_of_topics(of_steps);
      of_steps.add(line);
      CHECK(line["time"].get<std::int64_t>() % 100'000'000 == 0);
      CHECK(line["data"]["number"]["count"] == line["count"]);
    }
    CHECK(of_steps.last.size() == 3);
    end_well(run, folder, "rig.db");
    while (const auto line = each.next()) of_each.add(*line);
  }

  TEST_CASE("NFR-5 a reader from the beginning gets what is recorded and goes over to live, each event once") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig);
    {
      Process before(folder, program, {"run", "rig.json", "--for", "500ms"});
      CHECK(before.end() == 0);
    }
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    {  // some of it is recorded
      Listener live(R"({"request":"subscribe","topics":["other"]})");
      while (live.next_event("other")["sequence"] < 30) {
      }
    }
    std::vector<std::string> runs;
    for (const RunInfo& one : Recording::open(folder.path() + "/rig.db").or_throw().runs().or_throw())
      runs.push_back(one.uuid);
    REQUIRE(runs.size() == 2);
    // A reader of what comes live is told the same run.
    CHECK(Listener(R"({"request":"subscribe","topics":["other"]})").next("subscribed")["run"] == runs.back());
    std::vector<std::unique_ptr<Listener>> readers;
    for (int i = 0; i < 3; ++i)
      readers.push_back(std::make_unique<Listener>(R"({"request":"subscribe","topics":["#"],"from":0})"));
    readers.push_back(std::make_unique<Listener>(R"({"request":"subscribe","from":"-1 h","of":"rec","step":"50 ms"})"));
    for (auto& reader : readers) {
      Sequences before, now;
      const json hello = reader->next("subscribed");
      CHECK(hello["of"] == "rec");
      CHECK_FALSE(hello.contains("run"));
      std::string of_run;
      bool is_live = false;
      while (!is_live || now.last["b"] < 100) {
        const auto line = reader->next();
        REQUIRE(line);
        if (line->contains("run")) {
          CHECK(std::find(runs.begin(), runs.end(), (*line)["run"]) == runs.begin() + (of_run.empty() ? 0 : 1));
          of_run = (*line)["run"];
        }
        if (line->contains("live")) is_live = true;
        (of_run == runs.back() ? now : before).add(*line);
      }
      CHECK(of_run == runs.back());
      for (Sequences* one : {&before, &now}) {
        CHECK(one->dropped == 0);
        CHECK(one->last.size() == 3);
      }
      CHECK(before.events == before.last["a"] + before.last["b"] + before.last["c"]);
      CHECK(now.events == now.last["a"] + now.last["b"] + now.last["c"]);
    }
    readers.clear();
    end_well(run, folder, "rig.db");
  }

  TEST_CASE("NFR-5 a reader from an instant gets nothing that was before, and no recording is asked that has nothing") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig);
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    Listener live(R"({"request":"subscribe","topics":["count/a"]})");
    while (live.next_event("count/a")["sequence"] < 100) {
    }
    const json begin = live.next_event("count/a");
    Listener past(R"({"request":"subscribe","topics":["count/a"],"from":)" + begin["time"].dump() + "}");
    CHECK(past.next_event("count/a") == begin);
    Listener none(R"({"request":"subscribe","topics":["count/a"],"from":0,"of":"other"})");
    CHECK(has(none.next("error").dump(), "there is no recording of a sink"));
    end_well(run, folder, "rig.db");
  }

  TEST_CASE("NFR-5 a reader that is still in the past when the run ends is told so, and where the rest is") {
    const RuntimeFolder runtime;
    const Folder folder;
    {
      Loop loop{Loop::Manual{}};
      SqliteSink sink(loop, {.path = folder.path() + "/rig.db"});
      Feed<PastRow> feed(loop, {.name = "past"});
      for (std::uint64_t i = 0; i < 50'000; ++i) {
        feed.publish({i});
        if (i % 100 == 0) loop.advance(10ms);
      }
      CHECK(loop.close(5s) == 0);
    }
    folder.write("rig.json", rig);
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    Listener slow(R"({"request":"subscribe","from":0})");
    Listener live(R"({"request":"subscribe"})");
    slow.next("subscribed");
    while (live.next_event("other")["sequence"] < 10) {
    }
    run.signal(SIGTERM);
    live.next("ended");
    json last;
    std::uint64_t rows = 0;
    while (const auto line = slow.next()) {
      last = *line;
      if (line->contains("data") && (*line)["topic"] == "past") ++rows;
    }
    CHECK(run.end() == 0);
    CHECK(rows < 50'000);
    CHECK_FALSE(last.contains("ended"));
    // A busy machine may not send it in the time of an end.
    if (last.contains("error")) CHECK(has(last["error"].get<std::string>(), "the recording has the rest"));
  }

  TEST_CASE("NFR-5 readers that stop reading cost nothing, the one too many is refused, and who goes makes room") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", R"({
      "name": "rig", "control": {"readers": 3},
      "sensors": [ {"name": "a", "type": "tallied", "rate": "2 kHz", "topic": "count/a"} ],
      "sinks": [ {"type": "sqlite", "path": "rig.db"} ] })");
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    Listener stopped(R"({"request":"subscribe"})");
    REQUIRE(stopped.next("data").contains("data"));
    Listener reads(R"({"request":"subscribe"})");
    {
      Listener third(R"({"request":"subscribe"})");
      REQUIRE(third.next("data").contains("data"));
      Listener fourth(R"({"request":"subscribe"})");
      CHECK(has(fourth.next("error").dump(), "3 readers are connected, and no more are served"));
    }
    Sequences all;
    while (all.last["a"] < 10'000) {  // far more than what waits for the one that stopped
      const auto line = reads.next();
      REQUIRE(line);
      all.add(*line);
    }
    Sequences late;
    for (;;) {
      const json line = *stopped.next();
      late.add(line);
      if (line.contains("dropped") && line["of"] == "count/a") {
        const json held = stopped.next_event("count/a");
        CHECK(held["count"] == line["dropped"]);
        late.add(held);
        break;
      }
    }
    late.add(stopped.next_event("count/a"));
    // The third has gone, which is seen when it is sent something.
    for (int i = 0;; ++i) {
      REQUIRE(i < 100);
      Listener again(R"({"request":"subscribe"})");
      const auto line = again.next();
      REQUIRE(line);
      if (line->contains("subscribed")) break;
      CHECK(line->contains("error"));
      all.add(reads.next("data"));
    }
    end_well(run, folder, "rig.db");
  }

  TEST_CASE("NFR-5 garbage is answered in words, and the connection can be used again") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig);
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    const auto instances = running_instances();
    REQUIRE(instances.size() == 1);
    auto client = ControlClient::connect(instances[0].path);
    REQUIRE(client);
    for (const char* wrong :
         {R"({"request":"subscribe","topics":["a//"]})", R"({"request":"subscribe","version":9})",
          R"({"request":"subscribe","step":"\u0000"})", R"({"request":"subscribe"}})", R"({"request":"subscribed"})"}) {
      const auto answer = client->ask(wrong, 30s);
      REQUIRE(answer);
      CHECK(has(*answer, "\"error\""));
    }
    const auto answer = client->ask(R"({"request":"subscribe"})", 30s);
    REQUIRE(answer);
    CHECK(has(*answer, "\"subscribed\""));
    client->send("what is sent now is not read");
    const auto next = client->receive(30s);
    REQUIRE(next);
    end_well(run, folder, "rig.db");
  }

  TEST_CASE("NFR-5 a reader hears of gaps, health and alarms, and of topics that a reload adds and removes") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", R"({ "name": "rig",
      "sensors": [ {"name": "a", "type": "tallied", "rate": "50 Hz", "topic": "count/a", "fail_every": 5},
                   {"name": "high", "type": "limit", "on": "count/a", "field": "number", "high": 20} ],
      "sinks": [ {"type": "sqlite", "path": "rig.db"} ] })");
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    Listener reader(R"({"request":"subscribe"})");
    bool has_gap = false, has_alarm = false;
    while (!has_gap || !has_alarm) {
      const json line = reader.next("data");
      if (line["topic"] == "$rtdata/gaps") {
        CHECK(line["data"]["name"] == "a");
        CHECK(line["data"]["topic"] == "count/a");
        CHECK(line["data"]["kind"] == "failed");
        CHECK(line["data"]["count"] >= 1);
        has_gap = true;
      }
      if (line["topic"] == "high" && line["data"]["is_active"] == true) has_alarm = true;
    }
    folder.write("rig.json", R"({ "name": "rig",
      "sensors": [ {"name": "n", "type": "tallied", "rate": "50 Hz", "topic": "new"},
                   {"name": "gone", "type": "absent", "rate": "10 Hz"} ],
      "sinks": [ {"type": "sqlite", "path": "rig.db"} ] })");
    Process reload(folder, program, {"ctl", "reload"});
    CHECK(reload.end() == 0);
    Sequences of_new;
    bool is_faulted = false;
    while (of_new.last["n"] < 20 || !is_faulted) {
      const json line = reader.next("data");
      if (line["topic"] == "new") of_new.add(line);
      if (line["topic"] == "$rtdata/health" && line["data"]["name"] == "gone")
        is_faulted = line["data"]["state"] == "faulted";
    }
    for (int i = 0; i < 20; ++i) CHECK(reader.next("data")["topic"] != "count/a");
    end_well(run, folder, "rig.db");
  }

  TEST_CASE("NFR-5 tail prints events as they come, and ends with the run") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig);
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    Process tail(folder, program, {"tail", "rig", "count/a"});
    REQUIRE(tail.wait_for(" count/a number="));
    Process steps(folder, program, {"tail", "--step", "200ms", "count/#"});
    REQUIRE(steps.wait_for("events: number="));
    Process past(folder, program, {"tail", "--step", "200ms", "--from", "-1min", "--json", "count/#"});
    REQUIRE(past.wait_for("{\"live\":"));  // it could not end well before
    Process json_lines(folder, program, {"tail", "--json"});
    REQUIRE(json_lines.wait_for(R"("topic":"other")"));
    Process wrong(folder, program, {"tail", "--step", "soon"});
    CHECK(wrong.end() == 1);
    CHECK(has(wrong.err, "\"step\""));
    Process mistyped(folder, program, {"tail", "rig", "cuont/a"});
    CHECK(mistyped.wait_for("did you mean \"count/a\"?"));
    Process none(folder, program, {"tail", "rig", "a//b"});
    CHECK(none.end() == 1);
    end_well(run, folder, "rig.db");
    CHECK(tail.end() == 0);
    CHECK(has(tail.err, "has ended"));
    CHECK_FALSE(has(tail.out, "count/b"));
    CHECK(steps.end() == 0);
    CHECK(past.end() == 0);
    CHECK(has(past.out, R"("least":)"));
    CHECK(json_lines.end() == 0);
    CHECK(has(json_lines.out, R"({"ended":"the run has ended"})"));
  }
}
