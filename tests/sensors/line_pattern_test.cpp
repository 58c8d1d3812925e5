// Lines whose fields a regular expression finds.
#ifdef RTDATA_WITH_PATTERN
#include <doctest/doctest.h>

#include <ctime>
#include <string>

#include "has.hpp"
#include "sensors/decoded_line.hpp"
#include "sensors/lines/device_clock.hpp"
#include "sensors/lines/line_config.hpp"
#include "sensors/lines/line_decoder.hpp"

using namespace rtdata;
using rtdata::test::has;

namespace {

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
    CHECK(values_of_line(config, "12:00 T: -12.5C ok [RUN] load=12530") == "-12.5 RUN 12.53");
    CHECK(values_of_line(config, "T:7 C[]") == "7  absent");
    CHECK(has(values_of_line(config, "T: 12.5F [RUN]"), "`pattern` does not match"));
    CHECK(has(values_of_line(config, "T: 1.2.3C [RUN]"), "\"1.2.3\" is not a number"));
    CHECK(values_of_line(config, std::string("T: 1C\0[x]", 10)) == "1 x absent");
    // A group that took no part, of a field that is always there.
    config.fields[2].optional = false;
    CHECK(has(values_of_line(config, "T:7 C[]"), "but without this group"));
    // Signs between values without another separator, as of SDI-12; each branch may have the group.
    const LineConfig signs{.format = LineFormat::pattern,
                           .fields = {{.name = "a"}, {.name = "b"}},
                           .pattern = R"(^\d(?<a>[+-][\d.]+)(?<b>[+-][\d.]+)$)"};
    CHECK(values_of_line(signs, "0+12.3-4.5") == "12.3 -4.5");
    const LineConfig either{
        .format = LineFormat::pattern, .fields = {{.name = "v"}}, .pattern = R"((?J)A=(?<v>\d+)|B=(?<v>\d+))"};
    CHECK(values_of_line(either, "A=1") == "1");
    CHECK(values_of_line(either, "B=2") == "2");
  }

  TEST_CASE("US-13 lines are chosen, and known as unreadable, by a regular expression") {
    const LineConfig config{.fields = {{.name = "", .type = Kind::text}, {.name = "v"}},
                            .only = LineMatch{.column = 1, .pattern = "^T[0-9]$"},
                            .unreadable_if = LineMatch{.pattern = "(?i)err(or)?"}};
    CHECK(values_of_line(config, "T1,5") == "5");
    CHECK(values_of_line(config, "T12,5") == "left out");
    CHECK(has(values_of_line(config, "T2,Error"), "unreadable_if"));
  }

  TEST_CASE("US-13 a regular expression that cannot be is refused with its place, and with its names") {
    LineConfig config{.format = LineFormat::pattern, .fields = {{.name = "v"}}, .pattern = "v=(?<v>"};
    CHECK(has(refusal_of_pattern(config), "pattern: at character 7: missing closing parenthesis"));
    config.pattern = "v=(?<w>.*)";
    CHECK(has(refusal_of_pattern(config), "`pattern` has a group \"w\""));
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
    CHECK(has(values_of_line(config, line), "too many steps"));
    CHECK(static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC < 2);  // without a limit: longer than the universe
    // Many starts, and many bytes a step: PCRE2's own limit counts neither.
    const auto seconds_of = [](const char* pattern, const std::string& text) {
      const LineConfig slow{.format = LineFormat::pattern, .fields = {{.name = "v"}}, .pattern = pattern};
      detail::LineDecoder decoder(slow);
      const std::clock_t from = std::clock();
      CHECK(has(decoder.decode(text).error().why, "too many steps"));
      return static_cast<double>(std::clock() - from) / CLOCKS_PER_SEC;
    };
    std::string groups;
    for (int i = 0; i < 22; ++i) groups += std::string(180, '1') + ",";
    CHECK(seconds_of(R"((?<v>\d*\d*\d*)[XY])", groups) < 0.2);
    CHECK(seconds_of(R"((?<v>\d+)[XY])", std::string(65'000, '1')) < 0.5);
    CHECK(seconds_of(R"((?<v>[0-9]+)[XY])", std::string(1'048'576, '1')) < 4);
    // A long line that is meant has the steps that it needs.
    const LineConfig far{.format = LineFormat::pattern, .fields = {{.name = "v"}}, .pattern = "a.*=(?<v>[0-9]+)$"};
    CHECK(values_of_line(far, "a" + std::string(4000, ' ') + "=7") == "7");
    // Whether it is meant is not known: it is not left out without a word, nor taken.
    const LineConfig chosen{.fields = {{.name = "v"}, {.name = "w"}}, .only = LineMatch{.pattern = "^(a+)+$|^OK"}};
    CHECK(has(values_of_line(chosen, std::string(100, 'a') + "b,3"), "the pattern of `only` takes too many steps"));
    CHECK(values_of_line(chosen, "7,3") == "left out");
    const LineConfig utf{.format = LineFormat::pattern, .fields = {{.name = "v"}}, .pattern = "(*UTF)(?<v>.)"};
    CHECK(has(refusal_of_pattern(utf), "pattern: at character"));
  }
}
#endif
