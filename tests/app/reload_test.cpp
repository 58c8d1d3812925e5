// SIGHUP: a running program reads its configuration again. The real programs.
#include <doctest/doctest.h>

#include "app/process.hpp"
#include "paths.hpp"
#include "sinks/sqlite/database.hpp"

using rtdata::test::built;
using rtdata::test::Folder;
using rtdata::test::Process;

namespace {

bool has(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

std::string rig(const std::string& rate, const std::string& more) {
  return R"({"buses": {"wire": {"type": "loopback"}}, "sensors": [
    {"name": "a", "type": "tallied", "rate": ")" +
         rate + R"("}, {"name": "w", "type": "wired", "bus": "wire", "rate": "10 Hz"})" + more +
         R"(], "sinks": [{"type": "discard"}]})";
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
    REQUIRE(run.wait_for("what is refused can be done by starting the program again"));
    CHECK(has(run.err, "configuration: name: refused: the program is started with it"));

    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK(has(run.out, "ledger balances"));
    CHECK(has(folder.read("rig.log"), "sensor new: added"));
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

  TEST_CASE("US-5 events of a recording that a reload closes before it could store them are not forgotten at the end") {
    const Folder folder;
    const auto text = [](const std::string& rate, const std::string& sinks) {
      return R"({"sensors": [{"name": "a", "type": "tallied", "rate": ")" + rate + R"("}], "sinks": [)" + sinks + "]}";
    };
    const std::string recording = R"({"type": "sqlite", "path": "run.db", "close_deadline": "100 ms"})";
    folder.write("rig.json", text("100 Hz", recording));
    Process run(folder, built("rtdata_test_program"), {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    {
      auto other = rtdata::sqlite::Database::open(folder.path() + "/run.db", rtdata::sqlite::Database::Mode::write)
                       .or_throw();
      other.execute("BEGIN IMMEDIATE").or_throw();
      folder.write("rig.json", text("200 Hz", recording));  // while which ticks pass
      run.signal(SIGHUP);
      REQUIRE(run.wait_for("rig.json is applied"));
      folder.write("rig.json", text("200 Hz", R"({"type": "discard"})"));
      run.signal(SIGHUP);
      REQUIRE(run.wait_for("sink run.db: removed"));
      run.signal(SIGTERM);
      CHECK(run.end() == 1);
    }
    CHECK(has(run.out, "NOT stored"));
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
  }
}
