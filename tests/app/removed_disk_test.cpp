// A disk that is taken away while it is recorded onto: a small ext4 in a file, mounted, and shut down or unmounted.
#include <doctest/doctest.h>
#include <sys/mount.h>

#include <map>
#include <nlohmann/json.hpp>

#include "app/control/control_socket.hpp"
#include "app/runtime_folder.hpp"
#include "app/stick.hpp"
#include "has.hpp"
#include "paths.hpp"

using rtdata::app::ControlClient;
using rtdata::app::running_instances;
using rtdata::test::Folder;
using rtdata::test::Process;
using rtdata::test::RuntimeFolder;
using rtdata::test::Stick;

namespace {

const std::string program = rtdata::test::built("rtdata_test_program");

using rtdata::test::has;

std::size_t count_of(const std::string& text, const std::string& part) {
  std::size_t count = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + part.size())) ++count;
  return count;
}

/// How many events each sink has stored.
std::map<std::string, std::uint64_t> stored(ControlClient& client) {
  const auto answer = client.ask(R"({"request":"status"})", std::chrono::seconds{30});
  REQUIRE(answer);
  std::map<std::string, std::uint64_t> counts;
  const auto status = nlohmann::json::parse(*answer);
  for (const auto& sink : status["sinks"])
    counts[sink["name"].get<std::string>()] = sink["stored"].get<std::uint64_t>();
  return counts;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE(
      "US-26 a disk that is pulled out or unmounted while it is recorded onto costs its own sinks only, and is told") {
    for (const bool is_pulled : {true, false}) {
      CAPTURE(is_pulled);
      const Folder folder;
      Stick stick(folder);
      if (!stick) {
        MESSAGE(rtdata::test::why_no_stick);
        return;
      }
      folder.write("bench.json", R"({ "loop": {"hold_limit": "1 min"},
        "sensors": [ {"name": "a", "type": "tallied", "rate": "200 Hz", "topic": "count/a"} ],
        "sinks": [ {"type": "sqlite", "path": "stick/run.db", "batch_time": "20 ms", "profile": "safe", "close_deadline": "1 s"},
                   {"type": "file", "path": "stick/run.jsonl", "batch_time": "20 ms", "close_deadline": "1 s"},
                   {"type": "sqlite", "path": "good.db"} ] })");
      const RuntimeFolder runtime;
      Process run(folder, program, {"run", "bench.json", "--fail-on-loss"});
      REQUIRE(run.wait_for("running bench"));
      auto client = ControlClient::connect(running_instances().at(0).path);
      REQUIRE(client);
      for (auto now = stored(*client); now["stick/run.db"] < 50 || now["stick/run.jsonl"] < 50;) now = stored(*client);
      REQUIRE((is_pulled ? stick.pull() : stick.detach()));
      REQUIRE(run.wait_for("sink stick/run.db"));
      REQUIRE(run.wait_for("sink stick/run.jsonl"));
      const std::uint64_t then = stored(*client)["good.db"];
      while (stored(*client)["good.db"] < then + 100) {
      }
      run.signal(SIGINT);
      CHECK(run.end() == 3);
      CHECK(has(run.out, "LOST: "));
      CHECK(has(run.out, "; ledger balances\n"));
      CHECK(count_of(run.err, "error: sink good.db") == 0);
      CHECK_FALSE(has(run.err, "malformed"));
      const std::string error = is_pulled ? "error: sink stick/run.db: cannot use the recording: "
                                          : "error: sink stick/run.db: recording has ended: stick/run.db: the file was "
                                            "deleted or moved: do not move or delete it during recording";
      CHECK(has(run.err, error));
      CHECK(has(run.err, is_pulled
                             ? "error: sink stick/run.jsonl: cannot write the file: stick/run.jsonl: Input/output error"
                             : "error: sink stick/run.jsonl: the disk of the file was removed: stick/run.jsonl"));
      if (!is_pulled) CHECK(std::filesystem::is_empty(stick.path()));             // nothing is written beside it
      if (!is_pulled) CHECK(count_of(run.err, "error: sink stick/run.db") == 1);  // the other is tried again and again

      // The recording on the good disk has all of it, what happened to the others too.
      Process good(folder, program, {"verify", "good.db"});
      CHECK(good.end() == 0);
      CHECK(has(good.out, "balanced"));
      Process errors(folder, program, {"info", "good.db"});
      CHECK(errors.end() == 0);

      // What is on the disk is a recording: the next start says what it lacks.
      REQUIRE(((!is_pulled || ::umount2(stick.path().c_str(), MNT_DETACH) == 0) && stick.mount()));
      Process again(folder, program, {"run", "bench.json", "--for", "100ms"});
      CHECK(again.end() == 0);
      CHECK(has(again.err, "ended without closing"));
      Process verify(folder, program, {"verify", "stick/run.db"});
      // A disk that is shut down in the middle of a sync may have said that rows are on it which are not there
      // afterwards: what the program knows of them has survived, and the seal counts them among the lost.
      CHECK(verify.end() == 0);
      INFO(verify.out);
      CHECK(has(verify.out, "sealed"));
      CHECK_FALSE(has(verify.out, "not balanced"));
    }
  }
}
