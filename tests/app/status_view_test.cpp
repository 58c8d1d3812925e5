// What `rtdata top` shows where there is little room.
#include "app/control/status_view.hpp"

#include <doctest/doctest.h>

#include <algorithm>

using rtdata::Duration;
using rtdata::Health;
using rtdata::app::Status;
using namespace std::chrono_literals;

namespace {

Status status(int sensors, int sinks) {
  Status all;
  all.instance = {"rig", 4711, "2026-03-01T12:00:00Z", 12300ms, "rig.json"};
  all.loops.emplace_back().name = "main";
  all.loops[0].policy = "other";
  all.loops[0].load_percent = 0.5;
  all.parts = {{"bus", "i2c1", "i2c", {"sensor s1"}, {}}};
  all.callbacks = {{"sensor s1", "main", 9, 1us, 500ns}};
  for (int i = 1; i <= sensors; ++i) {
    Status::Sensor& one = all.sensors.emplace_back();
    one.name = "s" + std::to_string(i);
    one.loop = "main";
    one.is_running = true;
    one.wanted_hz = one.reached_hz = 10;
    one.value = "21.5 Cel";
  }
  for (int i = 1; i <= sinks; ++i) {
    Status::Sink& one = all.sinks.emplace_back();
    one.name = "sink" + std::to_string(i);
    one.stored = 9;
  }
  return all;
}

std::size_t line_of(const std::vector<std::string>& lines, const std::string& start) {
  const auto found = std::find_if(lines.begin(), lines.end(),
                                  [&](const auto& line) { return line.starts_with(start); });
  return static_cast<std::size_t>(found - lines.begin());
}

std::vector<std::string> shown(const Status& of, std::size_t rows = 23) {
  std::vector<std::string> lines = rtdata::app::lines_of(of, 79, rows);
  for (const std::string& line : lines) CHECK(line.size() <= 79);
  return lines;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-32 top says what waits in the recording that a sink goes through, for how long, and until when") {
    Status of = status(1, 3);
    const auto shown_of = [&](std::uint64_t events, std::optional<rtdata::Backlog> backlog) {
      of.sinks[0].queued = events;
      of.sinks[0].backlog = backlog;
      const std::vector<std::string> lines = shown(of, 40);
      const std::size_t at = line_of(lines, "sink1 ");
      return at + 1 < lines.size() ? lines[at + 1] : std::string();
    };
    CHECK(shown_of(0, {}).starts_with("sink2 "));
    CHECK(shown_of(0, rtdata::Backlog{}).starts_with("sink2 "));
    CHECK(shown_of(1200, rtdata::Backlog{9600, {}, 720s, 40s}) ==
          "  - 1200 events (9.6 kB) wait, the oldest for 12 min; sent in about 40 s");
    CHECK(shown_of(1, rtdata::Backlog{8, {}, 3s, {}}) ==
          "  - 1 event (8 B) waits, the oldest for 3.0 s; the backlog does not become less");
  }

  TEST_CASE("NFR-5 US-5 top says what a source repeated and which first lines were thrown away, which is no loss") {
    Status of = status(2, 1);
    of.sensors[0].repeated = 12;
    of.sensors[0].first_lines = 2;
    const std::vector<std::string> lines = shown(of, 40);
    const std::size_t at = line_of(lines, "s1 ");
    REQUIRE(at + 3 < lines.size());
    CHECK(lines[at + 1] == "  - 12 repeated by the source, which is not a loss");
    CHECK(lines[at + 2] == "  - 2 first lines discarded");
    CHECK(lines[at + 3].starts_with("s2 "));
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
    Status many = status(40, 2);
    many.sensors[20].missed = 5;
    many.sensors[30].lost = 7;
    many.sensors[35].health = Health::faulted;
    many.sensors[35].reason =
        "cannot open the device: /dev/i2c-1: No such file or directory: switch I2C on: `sudo raspi-config` "
        "or dtparam=i2c_arm=on in /boot/firmware/config.txt, then start again";
    many.sensors[37].health = Health::degraded;
    many.sensors[37].reason = "a value out of range";
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
    Status many = status(40, 9);
    for (Status::Sensor& one : many.sensors) one.health = Health::faulted, one.reason = "away";
    many.sinks[7].health = Health::faulted;
    many.sinks[7].reason = "disk full";
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
