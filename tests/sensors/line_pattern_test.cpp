// Lines whose fields a regular expression finds.
#ifdef RTDATA_WITH_PATTERN
#include <doctest/doctest.h>

#include <ctime>
#include <string>

#include "has.hpp"
#include "rtdata/data/event.hpp"
#include "sensors/lines/device_clock.hpp"
#include "sensors/lines/line_config.hpp"
#include "sensors/lines/line_decoder.hpp"

using namespace rtdata;
using rtdata::test::has;

namespace {

std::string found_in(const LineConfig& config, std::string_view line) {
  detail::LineDecoder decoder(config);
  if (!decoder.is_meant(line)) return "left out";
  if (const Result<void> done = decoder.decode(line); !done) return done.error().why;
  const EventView event("line", {}, *decoder.description(), {decoder.payload(), decoder.description()->size()}, "");
  std::string all;
  for (const Leaf& leaf : event.description().leaves()) all += (all.empty() ? "" : " ") + to_string(event.value(leaf));
  return all;
}

std::string refusal_of_pattern(const LineConfig& config) {
  try {
    const detail::LineDecoder decoder(config);
  } catch (const SetupError& error) {
    return error.error().where + ": " + error.error().why;
  }
  return "";
}

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-13 a regular expression takes fields out of any line") {
    LineConfig config{.format = LineFormat::pattern,
                      .fields = {{.name = "temp", .unit = "Cel"},
                                 {.name = "state", .type = Kind::text},
                                 {.name = "load", .unit = "g", .scale = 0.001, .optional = true}},
                      .pattern = R"(T:\s*(?<temp>[-+0-9.]+) ?C.*\[(?<state>\w*)\](?: load=(?<load>[0-9]+))?)"};
    CHECK(found_in(config, "12:00 T: -12.5C ok [RUN] load=12530") == "-12.5 RUN 12.53");
    CHECK(found_in(config, "T:7 C[]") == "7  absent");
    CHECK(has(found_in(config, "T: 12.5F [RUN]"), "`pattern` is not found"));
    CHECK(has(found_in(config, "T: 1.2.3C [RUN]"), "\"1.2.3\" is not a number"));
    CHECK(found_in(config, std::string("T: 1C\0[x]", 10)) == "1 x absent");
    // A group that took no part, of a field that is always there.
    config.fields[2].optional = false;
    CHECK(has(found_in(config, "T:7 C[]"), "its group is in no part"));
    // Signs between values without another separator, as of SDI-12; each branch may have the group.
    const LineConfig signs{.format = LineFormat::pattern,
                           .fields = {{.name = "a"}, {.name = "b"}},
                           .pattern = R"(^\d(?<a>[+-][\d.]+)(?<b>[+-][\d.]+)$)"};
    CHECK(found_in(signs, "0+12.3-4.5") == "12.3 -4.5");
    const LineConfig either{
        .format = LineFormat::pattern, .fields = {{.name = "v"}}, .pattern = R"((?J)A=(?<v>\d+)|B=(?<v>\d+))"};
    CHECK(found_in(either, "A=1") == "1");
    CHECK(found_in(either, "B=2") == "2");
  }

  TEST_CASE("US-13 lines are chosen, and known as unreadable, by a regular expression") {
    const LineConfig config{.fields = {{.name = "", .type = Kind::text}, {.name = "v"}},
                            .only = LineMatch{.column = 1, .pattern = "^T[0-9]$"},
                            .unreadable_if = LineMatch{.pattern = "(?i)err(or)?"}};
    CHECK(found_in(config, "T1,5") == "5");
    CHECK(found_in(config, "T12,5") == "left out");
    CHECK(has(found_in(config, "T2,Error"), "unreadable_if"));
  }

  TEST_CASE("US-13 a regular expression that cannot be is refused with its place, and with its names") {
    LineConfig config{.format = LineFormat::pattern, .fields = {{.name = "v"}}, .pattern = "v=(?<v>"};
    CHECK(has(refusal_of_pattern(config), "pattern: at character 7: missing closing parenthesis"));
    config.pattern = "v=(?<w>.*)";
    CHECK(has(refusal_of_pattern(config), "no field is named \"w\""));
    config.pattern = "v=(.*)";
    CHECK(has(refusal_of_pattern(config), "`pattern` has no group of this name"));
    config.pattern = "";
    CHECK(has(refusal_of_pattern(config), "there is no regular expression"));
    config = {.fields = {{.name = "v"}}, .only = LineMatch{.pattern = "["}};
    CHECK(has(refusal_of_pattern(config), "only: at character"));
  }

  TEST_CASE("NFR-1 a regular expression that would try for ever ends after its steps") {
    const LineConfig config{.format = LineFormat::pattern,
                            .fields = {{.name = "v", .type = Kind::text, .length = 255}},
                            .pattern = "(?<v>(a+)+)$"};
    const std::string line = std::string(4000, 'a') + "b";
    const std::clock_t begin = std::clock();
    CHECK(has(found_in(config, line), "too many steps"));
    CHECK(static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC < 2);  // without a limit: longer than the universe
    // It is not left out without a word.
    const LineConfig chosen{.fields = {{.name = "v", .type = Kind::text, .length = 255}},
                            .only = LineMatch{.pattern = "(a+)+$"}};
    CHECK(found_in(chosen, std::string(100, 'a') + "b") != "left out");
  }
}
#endif
