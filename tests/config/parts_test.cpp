// Parts of a configuration beside each other: buses as a kind that a program registers, uses, their order, and parts
// that are added at run time.
#include <doctest/doctest.h>

#include <ctime>
#include <fstream>
#include <nlohmann/json.hpp>

#include "app/process.hpp"
#include "config/test_types.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using test::Count;
using test::refusal;

namespace {

/// What was made and closed, in order.
using Journal = std::vector<std::string>;

/// A bus as a program would bring it: a device on it answers with a number. Not copied and not moved.
class Wire {
 public:
  Wire(Journal& journal, std::string name, int first) : journal_(journal), name_(std::move(name)), next_(first) {
    journal_.push_back("make " + name_);
  }
  ~Wire() { journal_.push_back("close " + name_); }
  Wire(const Wire&) = delete;
  Wire& operator=(const Wire&) = delete;
  std::uint64_t transfer() { return static_cast<std::uint64_t>(next_++); }

 private:
  Journal& journal_;
  std::string name_;
  int next_;
};
struct WireConfig {
  std::string device;
  int first = 1;
  friend constexpr auto parameters(type_tag<WireConfig>) {
    return parameter_list(
        parameter("device", &WireConfig::device, "the device of the kernel", required, TextIs::device),
        parameter("first", &WireConfig::first, "what it answers first"));
  }
};

/// A device on a wire.
struct ProbeConfig {
  std::string bus;
  friend constexpr auto parameters(type_tag<ProbeConfig>) {
    return parameter_list(
        parameter("bus", &ProbeConfig::bus, "the bus that it is on", required, names_part("bus", "wire")));
  }
};
struct Probe {
  Wire* wire;
  Journal* journal;
  std::string name;
  std::shared_ptr<void> end = {};
  Result<Count> read() { return Count{wire->transfer()}; }
};
std::shared_ptr<void> closing(Journal& journal, const std::string& name) {
  journal.push_back("make " + name);
  return {nullptr, [&journal, name](void*) { journal.push_back("close " + name); }};
}

/// Names other parts, of many kinds.
struct FollowerConfig {
  std::string follows;
  std::string source;
  std::vector<std::string> recordings;
  friend constexpr auto parameters(type_tag<FollowerConfig>) {
    return parameter_list(parameter("follows", &FollowerConfig::follows, "another sensor", names_part("sensor")),
                          parameter("source", &FollowerConfig::source, "a topic", names_part("topic")),
                          parameter("recordings", &FollowerConfig::recordings, "sinks", names_part("sink", "discard")));
  }
};

struct Types {
  Journal journal;
  Registry registry;

  Types() {
    test::add_test_types(registry);
    registry.add_bus<WireConfig>("wire", "one wire, of a test",
                                 [this](Runtime&, const std::string& name, const WireConfig& config) {
                                   return Wire(journal, name, config.first);
                                 });
    registry.add_bus<NoParameters>("other", "another bus",
                                   [](Runtime&, const std::string&, const NoParameters&) { return 3; });
    registry.add_sensor<ProbeConfig>(
        "probe", "a device on a wire", [](const ProbeConfig&) { return description_of<Count>(); },
        [this](Loop& loop, const SensorConfig& common, const ProbeConfig& config, const Parts& parts) {
          return Sensor<Count>(
              loop, common,
              Probe{&parts.get<Wire>("bus", config.bus), &journal, common.name, closing(journal, common.name)});
        });
    registry.add_sensor<FollowerConfig>(
        "follower", "names others", [](const FollowerConfig&) { return description_of<Count>(); },
        [this](Loop& loop, const FeedConfig& common, const FollowerConfig& config, const Parts& parts) {
          journal.push_back("make " + common.name);
          if (!config.follows.empty()) (void)parts.get<AnySensor>("sensor", config.follows);
          for (const std::string& name : config.recordings) (void)parts.get<Sink>("sink", name);
          return Feed<Count>(loop, common);
        });
    registry.add_sink<test::DiscardConfig>(
        "topics", "a file for each topic", [](const test::DiscardConfig& config) { return config.path; },
        [](Loop& loop, const test::DiscardConfig& config) {
          return Sink(loop, config.sink, std::make_unique<test::Discard>(config));
        });
  }

  SystemPlan planned(const std::string& text) const { return plan_system(registry, parse_config(text, "f.json")); }
  std::string problems_of(const std::string& text) const { return planned(text).problems.text(); }
};

ConfigItem item(std::string_view text) { return parse_config(text, "item.json").or_throw(); }

constexpr const char*
    probes = R"({"buses": {"w1": {"type": "wire", "device": "/dev/w1", "first": 7}, "w2": {"type": "wire", "device": "/dev/w2"}},
 "sensors": [{"name": "a", "type": "probe", "rate": "10 Hz", "bus": "w1"},
             {"name": "b", "type": "probe", "rate": "10 Hz", "bus": "w2"}],
 "sinks": [{"type": "discard"}]})";

}  // namespace

TEST_SUITE("config") {
  TEST_CASE("NFR-6 a bus is a kind of part: sensors name it, are made after it and closed before it") {
    Types types;
    {
      const SystemPlan plan = types.planned(probes);
      CHECK(plan.problems.text() == "");
      CHECK(plan.warnings.text() == "");
      Loop loop{Loop::Manual{}};
      System system(loop, types.registry, plan);
      CHECK(types.journal == Journal{"make w1", "make w2", "make a", "make b"});
      std::vector<std::uint64_t> seen;
      const auto subscription = loop.subscribe<Count>("a", [&](const Event<Count>& e) { seen.push_back(e->number); });
      loop.advance(250ms);
      CHECK(seen == std::vector<std::uint64_t>{7, 8, 9});
      CHECK(system.parts().names("bus") == std::vector<std::string>{"w1", "w2"});
      CHECK(system.parts().get<Wire>("bus", "w1").transfer() == 10);
      CHECK_THROWS_WITH_AS(system.parts().get<Wire>("bus", "w3"), doctest::Contains("no such bus"), SetupError);
      CHECK_THROWS_WITH_AS(system.parts().get<Sink>("bus", "w1"), doctest::Contains("cannot use the bus w1"),
                           SetupError);
      types.journal.clear();
    }
    CHECK(types.journal == Journal{"close b", "close a", "close w2", "close w1"});
  }

  TEST_CASE("NFR-6 a bus that is not there, has another type, or the name of another part is told with both places") {
    const Types types;
    CHECK(types.problems_of(R"({"tiers": {"t": {}}, "buses": {"w1": {"type": "wire", "device": "x"},
  "o": {"type": "other"}, "w1": {"type": "other"}, "l": {"type": "i2c"}, "": {"type": "other"}, "n": {"type": "other", "name": "n"}},
 "sensors": [{"name": "a", "type": "probe", "rate": "1 Hz", "bus": "w11"},
  {"name": "b", "type": "probe", "rate": "1 Hz", "bus": "o"},
  {"name": "c", "type": "probe", "rate": "1 Hz", "bus": "t", "tier": "t"},
  {"name": "d", "type": "probe", "rate": "1 Hz"},
  {"name": "e", "type": "tallied", "rate": "1 Hz", "bus": "w1"},
  {"name": "f", "type": "probe", "rate": "2 MHz", "bus": "gone"},
  {"name": "g", "type": "probe", "rate": "1 Hz", "bus": "l"}]})") ==
          "f.json:2:27: buses.w1: this key is already at f.json:1:32 [duplicate-key]\n"
          "f.json:2:66: buses.l.type: there is no bus type \"i2c\"; available: loopback, wire, other [unknown-type]\n"
          "f.json:2:74: buses[\"\"]: a name has 1 to 200 characters of UTF-8 and no control characters [bad-name]\n"
          "f.json:2:120: buses.n.name: unknown key; known here are type [unknown-key]\n"
          "f.json:3:68: sensors[0].bus: there is no bus \"w11\" in `buses` (did you mean \"w1\"?) [unknown-bus]\n"
          "f.json:4:57: sensors[1].bus: the bus \"o\", at f.json:2:3, is of type other; this needs wire [wrong-part]\n"
          "f.json:5:57: sensors[2].bus: there is no bus \"t\" in `buses`; that is the name of a tier, at f.json:1:12 "
          "[unknown-bus]\n"
          "f.json:6:3: sensors[3]: \"bus\" is missing: the bus that it is on [missing-key]\n"
          "f.json:7:52: sensors[4].bus: unknown key; known here are fail_every, faulted_after, first, hang_at, hold, "
          "late_after, name, on_overrun, phase, process, rate, read_time, required, retry_first, retry_longest, start, "
          "starve_at, tier, "
          "topic, type, warm_up [unknown-key]\n"
          "f.json:8:42: sensors[5].rate: 2 MHz is out of range: at most 1000000 Hz [out-of-range]\n"
          "f.json:8:58: sensors[5].bus: there is no bus \"gone\" in `buses` [unknown-bus]\n");
  }

  TEST_CASE("NFR-6 two buses on one device are told with both places, also by another name of it") {
    const Types types;
    CHECK(types.problems_of(R"({"buses": {"w1": {"type": "wire", "device": "/dev/w1"},
 "w2": {"type": "wire", "device": "/dev/../dev/w1"}, "w3": {"type": "wire", "device": "/dev/w3"}}})") ==
          "f.json:2:35: buses.w2.device: bus w1, at f.json:1:18, has this device already; one bus is enough for "
          "all devices on it [duplicate-place]\n");
  }

  TEST_CASE("NFR-6 without types of buses an empty list of them is fine, and one of any type is of an unknown one") {
    const Registry registry;
    const auto problems = [&](const char* text) {
      return plan_system(registry, parse_config(text, "f.json")).problems.text();
    };
    CHECK(problems(R"({"buses": []})") == "");
    CHECK(problems(R"({"buses": {}})") == "");
    CHECK(problems(R"({"buses": [3]})") == "f.json:1:11: buses: expected an object, got a list [wrong-type]\n");
    CHECK(problems(R"({"buses": {"w": {"type": "wire"}}})") ==
          "f.json:1:26: buses.w.type: there is no bus type \"wire\"; there are none [unknown-type]\n");
    CHECK(problems(R"({"buses": {"w": {}}})") ==
          "f.json:1:17: buses.w: \"type\" is missing: the type of the bus, of which there are none [missing-key]\n");
  }

  TEST_CASE("US-22 the schema knows buses") {
    const Types types;
    const auto schema = nlohmann::json::parse(types.registry.schema());
    const auto& forms = schema["properties"]["buses"]["anyOf"];
    CHECK(forms[0]["additionalProperties"]["properties"]["type"]["enum"] ==
          nlohmann::json{"loopback", "wire", "other"});
    CHECK(forms[0]["additionalProperties"]["allOf"][1]["then"]["required"] == nlohmann::json{"type", "device"});
    CHECK(forms[1]["maxItems"] == 0);
    CHECK(parameters_of<ProbeConfig>()[0].names_part.kind == "bus");
  }

  TEST_CASE("NFR-6 a bus that cannot be made says where it is configured, and nothing is left") {
    Types types;
    types.registry.add_bus<WireConfig>(
        "torn", "cannot be opened", [](Runtime&, const std::string& name, const WireConfig& config) -> int {
          throw SetupError({Errc::not_found, "cannot open " + name, config.device, "", ""});
        });
    Loop loop{Loop::Manual{}};
    const SystemPlan plan = types.planned(R"({"buses": {"w1": {"type": "wire", "device": "x"},
 "w2": {"type": "torn", "device": "/dev/w2"}}, "sensors": [], "sinks": [{"type": "discard"}]})");
    CHECK(refusal([&] { System(loop, types.registry, plan); }) ==
          "cannot open w2: f.json:2:8: bus w2: /dev/w2 [not-found]");
    CHECK(types.journal == Journal{"make w1", "close w1"});
    CHECK(loop.runtime().sinks().empty());
  }

  TEST_CASE("NFR-6 a part is made after those that it names, in whatever order they are written") {
    Types types;
    const SystemPlan plan = types.planned(R"({"sensors": [
  {"name": "a", "type": "follower", "follows": "c", "recordings": ["s"]},
  {"name": "b", "type": "follower", "source": "x/c"},
  {"name": "c", "type": "follower", "topic": "x/c"}],
 "sinks": [{"type": "discard", "name": "s"}]})");
    CHECK(plan.problems.text() == "");
    Loop loop{Loop::Manual{}};
    System system(loop, types.registry, plan);
    CHECK(types.journal == Journal{"make c", "make a", "make b"});
    CHECK(refusal([&] { system.remove_sink("s"); }) ==
          "cannot remove the sink s: f.json:2:68: sensor a uses it: remove that first [busy]");
    system.remove_sensor("a");
    system.remove_sink("s");
    system.remove_sensor("c");
    CHECK(system.sensor_names() == std::vector<std::string>{"b"});
  }

  TEST_CASE("NFR-6 parts that use each other in a circle are told with all places") {
    const Types types;
    CHECK(
        types.problems_of(R"({"sensors": [
  {"name": "a", "type": "follower", "follows": "b"},
  {"name": "b", "type": "follower", "source": "x/c"},
  {"name": "c", "type": "follower", "topic": "x/c", "follows": "a"},
  {"name": "d", "type": "follower", "follows": "d"},
  {"name": "e", "type": "follower", "source": "x/d", "follows": "A"},
  {"name": "f", "type": "follower", "recordings": ["k", "s"]}], "sinks": [{"type": "topics", "name": "k"}]})") ==
        "f.json:4:64: sensors[2].follows: it uses itself: sensor a uses sensor b, at f.json:2:48, which uses sensor c, "
        "at "
        "f.json:3:47, which uses sensor a, at f.json:4:64 [uses-itself]\n"
        "f.json:5:48: sensors[3].follows: it uses itself: sensor d uses sensor d, at f.json:5:48 [uses-itself]\n"
        "f.json:6:47: sensors[4].source: nothing of this configuration publishes on \"x/d\" (did you mean \"x/c\"?) "
        "[unknown-topic]\n"
        "f.json:6:65: sensors[4].follows: there is no sensor \"A\" in `sensors` (did you mean \"a\"?) "
        "[unknown-sensor]\n"
        "f.json:7:52: sensors[5].recordings[0]: the sink \"k\", at f.json:7:102, is of type topics; this needs "
        "discard [wrong-part]\n"
        "f.json:7:57: sensors[5].recordings[1]: there is no sink \"s\" in `sinks` [unknown-sink]\n");
  }

  TEST_CASE("US-7 what is added to a running system is compared with all that is there, files too") {
    Types types;
    const test::Folder folder;
    const std::string file = folder.path() + "/x.out";
    const SystemPlan plan = types.planned(R"({"log": {"file": ")" + folder.path() +
                                          R"(/the.log"}, "buses": {"w1": {"type": "wire", "device": "x"}},
 "sensors": [{"name": "a", "type": "tallied", "rate": "1 Hz", "topic": "x/a"}],
 "sinks": [{"type": "discard", "path": ")" +
                                          file + R"("}]})");
    REQUIRE(plan.problems.text() == "");
    Loop loop{Loop::Manual{}};
    System system(loop, types.registry, plan);
    const auto add_sensor = [&](const char* text) { return refusal([&] { system.add_sensor(item(text)); }); };
    const auto add_sink = [&](const std::string& text) { return refusal([&] { system.add_sink(item(text)); }); };
    CHECK(add_sink(R"({"type": "discard", "name": "s", "path": ")" + file + "\"}") ==
          "item.json:1:42: path: the sink at f.json:3:12 writes \"" + file +
              "\" already; two writers on one file destroy it; choose another [duplicate-path]\n");
    CHECK(add_sink(R"({"type": "discard", "name": "s", "path": ")" + folder.path() + "/the.log\"}")
              .find("item.json:1:42: path: the log writes") == 0);
    CHECK(add_sink(R"({"type": "discard", "name": ")" + file + "\"}") ==
          "item.json:1:29: name: there is a sink \"" + file +
              "\" already, at f.json:3:12; give each a `name` of its own [duplicate-name]\n");
    CHECK(add_sensor(R"({"name": "a", "type": "absent", "rate": "1 Hz", "topic": "x/a", "tier": "t"})")
              .find("item.json:1:58: topic: the topic \"x/a\" carries \"count\" of sensor a, at f.json:2:72, and "
                    "\"level\"") != std::string::npos);
    CHECK(add_sensor(R"({"name": "b", "type": "tallied", "rate": "1 Hz", "tier": "t"})") ==
          "item.json:1:58: tier: there is no tier \"t\" in `tiers` [unknown-tier]\n");
    CHECK(add_sensor(R"({"name": "X/a", "type": "tallied", "rate": "1 Hz"})") ==
          "item.json:1:10: name: the topic \"X/a\" differs in case only from \"x/a\", at f.json:2:72 [bad-name]\n");
    CHECK(add_sensor(R"({"name": "p", "type": "probe", "rate": "1 Hz", "bus": "w2"})") ==
          "item.json:1:55: bus: there is no bus \"w2\" in `buses` (did you mean \"w1\"?) [unknown-bus]\n");
    CHECK(add_sensor(R"({"name": "f", "type": "follower", "follows": "f"})") ==
          "item.json:1:46: follows: there is no sensor \"f\" in `sensors` [unknown-sensor]\n");
    CHECK(system.sensor_names() == std::vector<std::string>{"a"});
    CHECK(system.sink_names() == std::vector<std::string>{file});

    // What is refused is no neighbour, nor is what was removed.
    system.add_bus("w2", item(R"({"type": "wire", "device": "y"})"));
    CHECK(refusal([&] { system.add_bus("w2", item(R"({"type": "other"})")); }) ==
          "item.json:1:1: there is a bus \"w2\" already, at item.json:1:1; give each a `name` of its own "
          "[duplicate-name]\n");
    system.add_sensor(item(R"({"name": "p", "type": "probe", "rate": "1 Hz", "bus": "w2"})"));
    CHECK(refusal([&] { system.remove_bus("w2"); }) ==
          "cannot remove the bus w2: item.json:1:55: sensor p uses it: remove that first [busy]");
    system.remove_sensor("p");
    system.remove_bus("w2");
    CHECK(types.journal.back() == "close w2");
    system.remove_sink(file);
    CHECK(add_sink(R"({"type": "discard", "path": ")" + file + "\"}") == "");
    system.remove_sensor("a");
    CHECK(add_sensor(R"({"name": "a", "type": "tallied", "rate": "1 Hz", "topic": "x/a"})") == "");
  }

  TEST_CASE("US-7 a sensor that is added must go into a file together with those that are in it") {
    const Registry registry = standard_registry();
    const test::Folder folder;
    Loop loop{Loop::Manual{}};
    System system(loop, registry,
                  parse_config(R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "1 Hz"}],
                                   "sinks": [{"type": "file", "format": "csv", "path": ")" +
                                   folder.path() + "/x.csv\"}]}",
                               "f.json"));
    const char* const other = R"({"name": "b", "type": "host", "quantity": "load", "rate": "1 Hz"})";
    CHECK(refusal([&] { system.add_sensor(item(other)); }).find("cannot record topic b") != std::string::npos);
    loop.advance(3s);
    CHECK(loop.runtime().sinks()[0].counts.all_dropped() == 0);
  }

  TEST_CASE("US-7 a sensor that is added is compared with those that were added before it") {
    Types types;
    Loop loop{Loop::Manual{}};
    System system(loop, types.registry, parse_config("{}", "f.json"));
    system.add_sensor(item(R"({"name": "a", "type": "tallied", "rate": "1 Hz", "topic": "x"})"));
    CHECK(
        refusal([&] {
          system.add_sensor(item(R"({"name": "b", "type": "absent", "rate": "1 Hz", "topic": "x"})"));
        }).find("item.json:1:58: topic: the topic \"x\" carries \"count\" of sensor a, at item.json:1:59, and \"level\"") ==
        0);
    // Its device cannot be opened: then it was never there.
    const char* const missing = R"({"name": "c", "type": "absent", "rate": "1 Hz", "topic": "y", "required": true})";
    CHECK(refusal([&] { system.add_sensor(item(missing)); }).find("cannot open the device: item.json:1:1: sensor c") ==
          0);
    system.add_sensor(item(R"({"name": "c", "type": "absent", "rate": "1 Hz", "topic": "y"})"));
    CHECK(system.sensor_names() == std::vector<std::string>{"a", "c"});
  }

  TEST_CASE("NFR-5 telling many mistakes takes a time that grows with their number, not with its square") {
    const Types types;
    const auto seconds = [&](std::size_t count, const char* line_end) {
      std::string text = "{\"sensors\": [";
      for (std::size_t i = 0; i < count; ++i) {
        const std::string number = std::to_string(i);
        text += (i == 0 ? "" : ",") + std::string(line_end) + R"({"name": "a)" + number +
                R"(", "type": "probe", "rtae": 3, "bus": "b)" + number + R"(", "tier": "t)" + number + "\"}";
      }
      const std::clock_t begin = std::clock();
      const SystemPlan plan = types.planned(text + "]}");
      const std::string report = plan.report();
      const double took = static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;  // of the processor
      CHECK(plan.problems.size() == 3 * count);
      CHECK(std::count(report.begin(), report.end(), '^') == static_cast<std::ptrdiff_t>(3 * count));
      return took;
    };
    for (const char* const line_end : {"\n", ""}) {  // a line each, and all in one
      (void)seconds(50, line_end);
      const double few = seconds(150, line_end);
      CHECK(seconds(1500, line_end) < 30 * few + 0.1);  // a square would be 100
    }
  }
}
