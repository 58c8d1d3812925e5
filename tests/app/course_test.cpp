// `rtdata info` tells notes, alarms and changes of state.
#include <doctest/doctest.h>

#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

#include "app/control/commands.hpp"
#include "app/core/recording_commands.hpp"
#include "has.hpp"
#include "rtdata/fsm/machine.hpp"
#include "rtdata/sensors/limit.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using recordings::Climate;
using rtdata::test::has;

TEST_SUITE("app") {
  TEST_CASE("US-26 US-41 info tells the notes, alarms and changes of state of a run, in order, with UTC") {
    const recordings::Folder folder;
    const std::string path = folder / "run.db";
    for (const bool has_any : {true, false}) {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = path});
      Feed<Climate> board(loop, {.name = "board"});
      const LimitSensor limit(loop, {.name = "heat"}, {.on = "board", .field = "temperature", .high = 50});
      Feed<app::CommandRecord> commands(loop, {.name = "rtdata-commands", .topic = app::command_topic});
      if (has_any) {
        fsm::Machine machine(loop, {.name = "door", .start = "shut"});
        machine.add_state("shut");
        machine.add_state("open");
        machine.add_transition({.from = "shut", .to = "open", .on = "knock", .cause = "somebody"});
        machine.start();
        board.publish({20, 1});
        loop.advance(1s);
        board.publish({61.5, 1});
        loop.advance(1s);
        commands.publish({"note it is hot", "uid 7", true, "noted"});
        commands.publish({"note too long", "uid 7", false, "it has 265 bytes, more than 240"});
        commands.publish({"ack heat", "uid 7", true, "done"});
        machine.raise("knock");
        loop.advance(1s);
        board.publish({30, 1});
        loop.advance(1s);
      }
      loop.close();
    }
    std::ostringstream out, err;
    CHECK(app::info({.database = path, .run = "1"}, out, err) == 0);
    const std::string text = out.str();
    CHECK_MESSAGE(has(text, "\nnotes in run 1\n  2023-11-14T22:13:22Z uid 7: it is hot\n"), text);
    CHECK(has(text, "\nalarms in run 1\n"));
    CHECK(has(text, "  2023-11-14T22:13:21Z heat: high, at 61.5, limit 50\n"));
    CHECK(has(text, "  2023-11-14T22:13:23Z heat: normal, at 30\n"));
    CHECK(has(text,
              "\nchanges of state in run 1\n  2023-11-14T22:13:20Z door: shut (start)\n"
              "  2023-11-14T22:13:22Z door: shut -> open (somebody)\n"));
    CHECK_FALSE(has(text, "ack heat"));
    CHECK_FALSE(has(text, "too long"));

    out.str("");
    CHECK(app::info({.database = path, .run = "1", .show_as = app::ShowAs::json}, out, err) == 0);
    const auto json = nlohmann::json::parse(out.str());
    REQUIRE(json["notes"].size() == 1);
    CHECK(json["notes_count"] == 1);
    CHECK(json["notes"][0]["text"] == "it is hot");
    CHECK(json["notes"][0]["by"] == "uid 7");
    REQUIRE(json["states"].size() == 2);
    CHECK(json["states"][1]["machine"] == "door");
    CHECK(json["states"][1]["from"] == "shut");
    CHECK(json["states"][1]["to"] == "open");
    CHECK(json["states"][1]["utc"].get<std::string>().starts_with("2023-11-14T22:13:22"));
    CHECK(json["states_count"] == 2);
    bool is_high = false;
    for (const auto& alarm : json["alarms"])
      is_high = is_high || (alarm["alarm"] == "high" && alarm["value"] == 61.5 && alarm["is_active"] == true);
    CHECK(is_high);

    out.str("");
    CHECK(app::info({.database = path}, out, err) == 0);  // of the last run, which has none
    CHECK_FALSE(has(out.str(), "notes in"));
    CHECK_FALSE(has(out.str(), "changes of state in"));
    CHECK(err.str().empty());
  }
}
