// What `rtdata top` shows where there is little room.
#include "app/control/top_view.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

using Json = nlohmann::ordered_json;

namespace {

Json health(const std::string& state, const std::string& reason = "") { return {{"state", state}, {"reason", reason}}; }

Json sensor(const std::string& name) {
  return {{"name", name},       {"loop", "main"},  {"running", true},     {"wanted_hz", 10},       {"reached_hz", 10},
          {"late", 0},          {"missed", 0},     {"failed", 0},         {"unreadable", 0},       {"outages", 0},
          {"outage_time_s", 0}, {"lost", nullptr}, {"value", "21.5 Cel"}, {"health", health("ok")}};
}

Json status(int sensors, int sinks) {
  Json all{
      {"instance", {{"name", "rig"}, {"pid", 4711}, {"running_for_s", 12.3}, {"configuration", "rig.json"}}},
      {"loops",
       {{{"name", "main"},
         {"policy", "other"},
         {"priority", 0},
         {"load_percent", 0.5},
         {"lateness_ns", nullptr},
         {"warnings", Json::array()},
         {"hangs_in", nullptr}}}},
      {"sensors", Json::array()},
      {"sinks", Json::array()},
      {"parts", {{{"kind", "bus"}, {"name", "i2c1"}, {"type", "i2c"}, {"users", {"sensor s1"}}}}},
      {"callbacks", {{{"name", "sensor s1"}, {"loop", "main"}, {"count", 9}, {"total_ns", 1000}, {"max_ns", 500}}}}};
  for (int i = 1; i <= sensors; ++i) all["sensors"].push_back(sensor("s" + std::to_string(i)));
  for (int i = 1; i <= sinks; ++i)
    all["sinks"].push_back(
        {{"name", "sink" + std::to_string(i)}, {"queued", 0}, {"stored", 9}, {"dropped", 0}, {"health", health("ok")}});
  return all;
}

std::size_t line_of(const std::vector<std::string>& lines, const std::string& start) {
  const auto found = std::find_if(lines.begin(), lines.end(),
                                  [&](const auto& line) { return line.starts_with(start); });
  return static_cast<std::size_t>(found - lines.begin());
}

std::vector<std::string> shown(const Json& of, std::size_t rows = 23) {
  std::vector<std::string> lines = rtdata::app::lines_of_status(of.dump(), 79, rows);
  for (const std::string& line : lines) CHECK(line.size() <= 79);
  return lines;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-32 top says what waits in the recording that a sink goes through, for how long, and until when") {
    Json of = status(1, 3);
    const auto shown_of = [&](Json backlog) {
      of["sinks"][0]["backlog"] = std::move(backlog);
      const std::vector<std::string> lines = shown(of, 40);
      const std::size_t at = line_of(lines, "sink1 ");
      return at + 1 < lines.size() ? lines[at + 1] : std::string();
    };
    CHECK(shown_of(nullptr).starts_with("sink2 "));
    CHECK(shown_of({{"events", 0}, {"bytes", 0}, {"age_s", 0}, {"catch_up_s", 0}}).starts_with("sink2 "));
    CHECK(shown_of({{"events", 1200}, {"bytes", 9600}, {"age_s", 720.0}, {"catch_up_s", 40.0}}) ==
          "  - 1200 events (9.6 kB) wait, the oldest for 12 min; sent in about 40 s");
    CHECK(shown_of({{"events", 1}, {"bytes", 8}, {"age_s", 3.0}, {"catch_up_s", nullptr}}) ==
          "  - 1 event (8 B) waits, the oldest for 3.0 s; it does not become less");
  }

  TEST_CASE("NFR-5 top says what a source repeated, which is no loss") {
    Json of = status(2, 1);
    of["sensors"][0]["repeated"] = 12;
    of["sensors"][1]["repeated"] = 0;
    const std::vector<std::string> lines = shown(of, 40);
    const std::size_t at = line_of(lines, "s1 ");
    REQUIRE(at + 2 < lines.size());
    CHECK(lines[at + 1] == "  - 12 repeated by the source, which is no loss");
    CHECK(lines[at + 2].starts_with("s2 "));
  }

  TEST_CASE("US-5 top says that the first line of a port was thrown away") {
    Json of = status(2, 1);
    of["sensors"][0]["first_lines"] = 2;
    const std::vector<std::string> lines = shown(of, 40);
    const std::size_t at = line_of(lines, "s1 ");
    REQUIRE(at + 2 < lines.size());
    CHECK(lines[at + 1] == "  - 2 first lines thrown away");
    CHECK(lines[at + 2].starts_with("s2 "));
  }

  TEST_CASE("NFR-5 top has all where there is room, and without callbacks and parts where there is less") {
    const std::vector<std::string> all = shown(status(3, 1), 40);
    CHECK(line_of(all, "s3 ") < all.size());
    CHECK(line_of(all, "bus i2c1") < all.size());
    CHECK(line_of(all, "sensor s1") < all.size());
    const std::vector<std::string> fewer = shown(status(12, 1));
    CHECK(fewer.size() <= 23);
    CHECK(line_of(fewer, "s12 ") < fewer.size());
    CHECK(line_of(fewer, "sink1") < fewer.size());
    CHECK(line_of(fewer, "bus i2c1") == fewer.size());
    CHECK(line_of(fewer, "sensor s1") == fewer.size());
  }

  TEST_CASE("NFR-5 top on 24 rows shows first which sensors are not well and why, and counts the rest") {
    Json many = status(40, 2);
    many["sensors"][20]["missed"] = 5;
    many["sensors"][30]["lost"] = 7;
    many["sensors"][35]["health"] = health(
        "faulted",
        "cannot open the device: /dev/i2c-1: No such file or directory: switch I2C on: `sudo raspi-config` "
        "or dtparam=i2c_arm=on in /boot/firmware/config.txt, then start again");
    many["sensors"][37]["health"] = health("degraded", "a value out of range");
    const std::vector<std::string> lines = shown(many);
    CHECK(lines.size() <= 23);
    const std::size_t first = line_of(lines, "sensor  ") + 1;
    REQUIRE(first + 8 < lines.size());
    CHECK(lines[first].starts_with("s36 "));
    CHECK(lines[first + 1].starts_with("  ! faulted: cannot open the device: /dev/i2c-1"));
    CHECK(lines[first + 2].find("raspi-config") != std::string::npos);
    CHECK(line_of(lines, "s38 ") < line_of(lines, "s21 "));
    CHECK(line_of(lines, "s21 ") < line_of(lines, "s31 "));
    CHECK(lines[line_of(lines, "s31 ") + 1] == "  - 7 lost by the source");
    CHECK(line_of(lines, "s31 ") < line_of(lines, "s1 "));
    const std::size_t rest = line_of(lines, "and ");
    REQUIRE(rest < lines.size());
    CHECK(lines[rest].ends_with(" more, all well"));
    std::size_t named = 0;
    for (std::size_t i = first; i < rest; ++i) named += lines[i].starts_with("s") ? 1 : 0;
    CHECK(lines[rest] == "and " + std::to_string(40 - named) + " more, all well");
    CHECK(line_of(lines, "sink1") < lines.size());
    CHECK(line_of(lines, "sink2") < lines.size());
  }

  TEST_CASE("NFR-5 top says how many are not well where not even those find room") {
    Json many = status(40, 9);
    for (Json& one : many["sensors"]) one["health"] = health("faulted", "away");
    many["sinks"][7]["health"] = health("faulted", "disk full");
    for (const std::size_t rows : {23u, 14u}) {
      CAPTURE(rows);
      const std::vector<std::string> lines = shown(many, rows);
      CHECK(lines.size() <= rows);
      CHECK(line_of(lines, "s1 ") < lines.size());
      const std::size_t rest = line_of(lines, "and ");
      REQUIRE(rest < lines.size());
      CHECK(lines[rest].ends_with(" of them not well"));
      CHECK(line_of(lines, "sink8") < lines.size());
    }
  }
}
