// Calibration and filters in configurations: what is read, and that each mistake is told at its place.
#include <doctest/doctest.h>

#include "config/test_types.hpp"
#include "has.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/topic.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

Registry registry() {
  Registry registry = standard_registry();
  test::add_test_types(registry);
  return registry;
}

SystemPlan planned(const std::string& process) {
  return plan_system(registry(), parse_config(R"({"sensors": [{"name": "a", "type": "tallied", "rate": "10 Hz",
  "process": {)" + process + R"(}}], "sinks": [{"type": "discard"}]})",
                                              "f.json"));
}

/// The only problem of a configuration with this processing.
std::string problem(const std::string& process) {
  const SystemPlan plan = planned(process);
  CHECK(plan.problems.size() == 1);
  return plan.problems.text();
}

using rtdata::test::has;

}  // namespace

TEST_SUITE("process") {
  TEST_CASE("US-17 every setting of a processing is read from a file") {
    Problems problems;
    SensorConfig config;
    const ConfigItem item = parse_config(R"({"name": "x", "rate": "1 Hz", "process": {"a": {
        "calibration": {"version": "7", "scale": 2, "offset": -1, "polynomial": [0, 1.5], "least": 0, "most": 9},
        "filters": [{"type": "median", "of": 5}, {"type": "mean", "of": 4}, {"type": "exponential", "weight": 0.5},
                    {"type": "clamp", "least": 1, "most": 8}, {"type": "throttle", "time": "1 s"},
                    {"type": "delta", "by": 0.25}, {"type": "rate_of_change"}], "unit": "bar"},
        "b": {"calibration": {"table": [[0, 1], [2, 3]], "outside": "clamp"}},
        "c": {"calibration": {"points": [[9, 1], [2, 3]], "tare": 0.5}}}, "warm_up": "30 s"})",
                                         "f.json")
                                .or_throw();
    REQUIRE_MESSAGE(read_config(item, config, problems, UnknownKeys::ignore), problems.text());
    const FieldProcessing& a = config.process.at("a");
    CHECK(a.calibration->version == "7");
    CHECK(a.calibration->scale == 2);
    CHECK(a.calibration->offset == -1);
    CHECK(a.calibration->polynomial == std::vector<double>{0, 1.5});
    CHECK(a.calibration->least == 0.0);
    CHECK(a.calibration->most == 9.0);
    REQUIRE(a.filters.size() == 7);
    CHECK(a.filters[0].of == 5u);
    CHECK(a.filters[2].weight == 0.5);
    CHECK(a.filters[3].most == 8.0);
    CHECK(a.filters[4].time == Duration{1s});
    CHECK(a.filters[5].by == 0.25);
    CHECK(a.filters[6].type == FilterType::rate_of_change);
    CHECK(a.unit == "bar");
    CHECK(config.process.at("b").calibration->table == std::vector<std::array<double, 2>>{{0, 1}, {2, 3}});
    CHECK(config.process.at("b").calibration->outside == OutsideTable::clamp);
    CHECK(config.process.at("c").calibration->points == std::vector<std::array<double, 2>>{{9, 1}, {2, 3}});
    CHECK(config.process.at("c").calibration->tare == 0.5);
    CHECK(config.warm_up == Duration{30s});
  }

  TEST_CASE("US-17 US-27 a configured sensor of any type is processed, one without a schedule too") {
    const SystemPlan plan = plan_system(registry(), parse_config(R"({"sensors": [
        {"name": "a", "type": "tallied", "rate": "10 Hz", "process": {"number": {"filters": [{"type": "delta", "by": 3}]}}},
        {"name": "b", "type": "fed", "process": {"number": {"calibration": {"scale": 0.5}}}}],
        "sinks": [{"type": "discard"}]})",
                                                                 "f.json"));
    REQUIRE_MESSAGE(plan.good(), plan.report());
    Loop loop{Loop::Manual{}, plan.loop_config()};
    System system(loop, registry(), plan);
    loop.advance(995ms);
    CHECK(system.sensor("a").counts().received == 10);
    CHECK(system.sensor("a").counts().published == 4);
    CHECK(system.sensor("a").counts().filtered == 6);
    const auto topics = loop.runtime().topics();
    REQUIRE(topics.size() >= 2);
    for (const TopicStatus& topic : topics)
      if (topic.name == "b") CHECK(topic.description->find("number.raw")->kind == Kind::u64);
  }

  TEST_CASE("US-17 each mistake in a processing is told at its place") {
    CHECK(planned(R"("number": {"calibration": {}})").good());
    CHECK(has(problem(R"("numbr": {"calibration": {}})"),
              "f.json:2:15: sensors[0].process.numbr: there is no such field; did you mean number?"));
    CHECK(has(problem(R"("number": {})"), "sensors[0].process.number: there is nothing to do"));
    CHECK(has(problem(R"("number": {"calibration": {"scael": 2}})"), "(did you mean \"scale\"?)"));
    CHECK(has(problem(R"("number": {"calibration": {"scale": 0}})"), "process.number.calibration.scale: "));
    CHECK(has(problem(R"("number": {"calibration": {"table": [[0, 0], [1, 5], [1, 6]]}})"),
              "f.json:2:68: sensors[0].process.number.calibration.table[2]: the table is not in ascending order here"));
    CHECK(has(problem(R"("number": {"calibration": {"table": [[0, 0], [1]]}})"), "calibration.table[1]"));
    CHECK(has(problem(R"("number": {"calibration": {"polynomial": [1,2,3,4,5,6,7,8,9,10,11]}})"),
              "calibration.polynomial: it has 11 coefficients; use 2 to 10"));
    CHECK(has(problem(R"("number": {"filters": [{"type": "delta", "by": 1}, {"type": "median", "of": 6}]})"),
              "process.number.filters[1].of: 6 samples are not possible, for a median; give it an odd number from 3"));
    CHECK(has(problem(R"("number": {"filters": [{"type": "median", "of": 1001}]})"), "1001 samples are not possible"));
    CHECK(has(problem(R"("number": {"filters": [{"type": "mean"}]})"), "filters[0]: the number of samples is missing"));
    CHECK(has(problem(R"("number": {"filters": [{"of": 3}]})"), "filters[0]"));
    CHECK(has(problem(R"("number": {"filters": [{"type": "throttle", "time": "0 s"}]})"), "filters[0].time"));
    CHECK(has(problem(R"("number": {"filters": [{"type": "delta", "by": -1}]})"), "filters[0].by"));
    CHECK(has(problem(R"("number": {"filters": [{"type": "median", "of": 3}], "unit": "V"})"),
              "process.number.unit: a value without a calibration keeps its unit"));
    // Points.
    const auto points = [](const std::string& text) {
      return problem(R"("number": {"calibration": {"points": )" + text + "}}");
    };
    CHECK(planned(R"("number": {"calibration": {"points": [[623.4, 98.1], [123.4, 0]]}})").good());
    CHECK(has(points("[]"), "calibration.points: it has 0 points; use 2 to 1000"));
    CHECK(has(points("[[1, 2]]"), "calibration.points: it has 1 point; use 2 to 1000"));
    CHECK(has(points("[[1, 2], [3, 4], [1, 2.5]]"),
              "f.json:2:69: sensors[0].process.number.calibration.points[2]: it has the raw value of points[0]; use "
              "each raw value once"));
    CHECK(has(points("[[1, 2], [3, 2]]"), "calibration.points: their line gives the same value for every raw value"));
    CHECK(has(points("[[0, 0], [1e-308, 1e308]]"), "calibration.points: the numbers of their line are not finite"));
    CHECK(has(points("[[1, 2], [3]]"), "calibration.points[1]"));
    for (const char* other :
         {R"("scale": 2)", R"("offset": 1)", R"("table": [[0, 0], [1, 1]])", R"("polynomial": [0, 2])"})
      CHECK(has(points("[[1, 2], [3, 4]], " + std::string(other)),
                "calibration.points: with `points`, there can be no `scale`, `offset`, `polynomial` or `table`"));
    std::string many = "[[0, 0]";
    for (int i = 1; i <= 1000; ++i) many += ", [" + std::to_string(i) + ", " + std::to_string(i) + "]";
    CHECK(has(points(many + "]"), "calibration.points: it has 1001 points"));
    // Several at once.
    CHECK(planned(R"("number": {"calibration": {"scale": 0}}, "x": {"filters": [{"type": "mean", "of": 1}]})")
              .problems.size() == 2);
    // A field that is no number.
    const SystemPlan text = plan_system(registry(), parse_config(R"({"sensors": [{"name": "a", "type": "serial",
        "device": "/dev/null", "fields": [{"name": "x", "type": "text", "length": 9}],
        "process": {"x": {"calibration": {}}}}], "sinks": [{"type": "discard"}]})",
                                                                 "f.json"));
    CHECK(has(text.problems.text(), "sensors[0].process.x: it is of type text; only numbers can be calibrated"));
    // Two sensors of one topic are compared by what they publish.
    const SystemPlan two = plan_system(registry(), parse_config(R"({"sensors": [
        {"name": "a", "type": "tallied", "rate": "1 Hz", "topic": "t"},
        {"name": "b", "type": "tallied", "rate": "1 Hz", "topic": "t", "process": {"number": {"calibration": {}}}}],
        "sinks": [{"type": "discard"}]})",
                                                                "f.json"));
    CHECK(has(two.problems.text(), "number"));
  }

  TEST_CASE("US-17 what means nothing, or is no unit, is a warning") {
    const auto warnings = [](const std::string& process) {
      const SystemPlan plan = planned(process);
      CHECK_MESSAGE(plan.good(), plan.report());
      return plan.warnings.text();
    };
    CHECK(warnings(R"("number": {"calibration": {"scale": 2}, "unit": "bar"})").empty());
    CHECK(has(warnings(R"("number": {"calibration": {"scale": 2}, "unit": "bars"})"),
              "sensors[0].process.number.unit: \"bars\" is not a unit of UCUM"));
    CHECK(has(problem(R"("number": {"filters": [{"type": "median", "of": 3, "by": 2}]})"),
              "a filter of this type has no such setting"));
  }
}
