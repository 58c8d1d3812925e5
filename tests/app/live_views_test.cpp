// Fields of a running program, as curves and as a table: real programs, real recordings.
#include <doctest/doctest.h>
#include <signal.h>

#include <string>

#include "app/inspect/live_curves.hpp"
#include "app/process.hpp"
#include "app/runtime_folder.hpp"
#include "has.hpp"
#include "paths.hpp"

using rtdata::test::Folder;
using rtdata::test::has;
using rtdata::test::Process;
using rtdata::test::RuntimeFolder;

namespace {

const std::string program_of_views = rtdata::test::built("rtdata_test_program");

std::string rig_of_views(const std::string& sinks) {
  return R"({"name": "rig",
    "sensors": [ {"name": "a", "type": "tallied", "rate": "50 Hz", "topic": "count/a"},
                 {"name": "b", "type": "tallied", "rate": "50 Hz", "topic": "count/a"} ],
    "sinks": [ )" +
         sinks + " ]}";
}

/// What a command says, and its status before it.
struct Said {
  Said(const Folder& folder, std::vector<std::string> words, Process::Output output = Process::Output::pipes)
      : process(folder, program_of_views, std::move(words), output), status(process.end()) {}
  Process process;
  int status;
};

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("NFR-5 plot of a running instance says what the sensors lost, and calls what sinks dropped so") {
    using namespace std::chrono_literals;
    rtdata::app::LiveCurves curves({"t.x"}, {"t"}, 60s);
    curves.take(R"({"topic": "t", "origin": "s", "time": 1000000000, "until": 2000000000, "count": 1,
                    "data": {"x": {"count": 1, "least": 1, "most": 1, "mean": 1, "last": 1}}})");
    rtdata::app::Status status;
    status.topics.push_back({.name = "t", .dropped = 118});
    rtdata::app::Curve curve = curves.plot(1s, status).curves.at(0);
    CHECK(curve.verdict == "all there so far, sinks dropped 118");
    CHECK_FALSE(curve.has_loss);
    status.topics[0] = {.name = "t", .missed = 3, .failed = 2, .unreadable = 3, .failed_unreadable = 2};
    curve = curves.plot(1s, status).curves.at(0);
    CHECK(curve.verdict == "6 lost since the start");
    CHECK(curve.has_loss);
  }

  TEST_CASE("NFR-5 plot draws a running instance from its recording on, and says what was lost") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig_of_views(R"({"type": "sqlite", "name": "rec", "path": "rig.db"})"));
    Process run(folder, program_of_views, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    for (const auto& words : {std::vector<std::string>{"plot", "count/a.number"},
                              std::vector<std::string>{"plot", "rig", "count/a", "--last", "10s"}}) {
      const Said said(folder, words);
      CHECK_MESSAGE(said.status == 0, said.process.err);
      CHECK(has(said.process.out, "rig, live"));
      CHECK(has(said.process.out, "count/a.number of a"));
      CHECK(has(said.process.out, "count/a.number of b"));
      CHECK((has(said.process.out, "all there so far") || has(said.process.out, "since the start")));
    }
    {
      const Said all(folder, {"plot"}), named(folder, {"plot", "rig"});
      CHECK_MESSAGE(all.status == 0, all.process.err);
      CHECK(has(all.process.out, "count/a: number\n"));
      CHECK(all.process.out.ends_with("such as: rtdata plot count/a.number\n"));
      CHECK(named.process.out.ends_with("such as: rtdata plot rig count/a.number\n"));
    }
    {  // the nearest name
      const Said topic(folder, {"plot", "cuont/a.number"}), field(folder, {"plot", "count/a.nubmer"});
      CHECK(topic.status == 1);
      CHECK(has(topic.process.err, "did you mean count/a?"));
      CHECK(field.status == 1);
      CHECK(has(field.process.err, "there is no such field: did you mean number?"));
    }
    CHECK(Said(folder, {"plot", "nothing.db", "x"}).status != 0);
    CHECK(has(Said(folder, {"plot", "count/a", "--run", "1"}).process.err, "--run works only with recordings"));
    CHECK(has(Said(folder, {"plot", "count/a", "--last", "2 d"}).process.err, "1 s to 1 h"));
    {  // until it ends
      Process seen(folder, program_of_views, {"plot", "rig", "count/a"}, Process::Output::one_terminal);
      REQUIRE(seen.wait_for("q ends"));
      run.signal(SIGTERM);
      CHECK(run.end() == 0);
      CHECK(seen.end() == 0);
      CHECK(has(seen.out, "has ended"));
    }
    CHECK(Said(folder, {"plot", "count/a"}).status == 1);
  }

  TEST_CASE("NFR-5 what is not recorded is drawn from now on; top shows one topic with its fields") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("rig.json", rig_of_views(R"({"type": "file", "name": "text", "path": "rig.jsonl"})"));
    Process run(folder, program_of_views, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    const Said plotted(folder, {"plot", "count/a", "--last", "1s"});
    CHECK(plotted.status == 0);
    CHECK(has(plotted.process.out, "count/a.number of a"));
    const Said all(folder, {"plot"});
    CHECK_MESSAGE(all.status == 0, all.process.err);
    CHECK(has(all.process.out, "count/a: number\n"));
    const Said shown(folder, {"top", "rig", "--topic", "count/a", "--once"});
    CHECK_MESSAGE(shown.status == 0, shown.process.err);
    CHECK(has(shown.process.out, "number of a"));
    CHECK(has(shown.process.out, "number of b"));
    CHECK(has(shown.process.out, "50.0 Hz"));
    CHECK_FALSE(has(shown.process.out, "stored"));
    const Said wrong(folder, {"top", "--topic", "count/b", "--once"});
    CHECK(wrong.status == 1);
    CHECK(has(wrong.process.err, "did you mean count/a?"));
    CHECK(Said(folder, {"top", "--topic", "count/a", "--json"}).status != 0);
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
  }
}
