#include "rtdata/data/parameter.hpp"

#include <doctest/doctest.h>

#include <nlohmann/json.hpp>

#include "rtdata/config/format.hpp"
#include "rtdata/config/read.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

enum class Parity { none, even, odd };
constexpr auto describe(type_tag<Parity>) {
  return enumeration("parity", value("none", Parity::none), value("even", Parity::even), value("odd", Parity::odd));
}
enum class Edge { rising, falling };  // without a describe

struct Common {
  std::string name;
  Rate rate = 10_Hz;
  friend constexpr auto parameters(type_tag<Common>) {
    return parameter_list(parameter("name", &Common::name, "what it is called", required),
                          parameter("rate", &Common::rate, "how often it is read", range(0.1_Hz, 10_kHz)));
  }
};

struct Window {
  int size = 5;
  double limit = 1.5;
  friend constexpr auto parameters(type_tag<Window>) {
    return parameter_list(parameter("size", &Window::size, "samples", range(1, 99)),
                          parameter("limit", &Window::limit, "largest step"));
  }
  friend void check_config(const Window& window, const ConfigItem& item, Problems& problems) {
    if (window.limit > window.size) problems.add(item.problem("bad-value", "\"limit\" must not be above \"size\""));
  }
};

struct Serial {
  std::uint32_t baud = 9600;
  Parity parity = Parity::none;
  friend constexpr auto parameters(type_tag<Serial>) {
    return parameter_list(parameter("baud", &Serial::baud, "speed", unit("Bd"), range(50, 4000000)),
                          parameter("parity", &Serial::parity, "parity bit"));
  }
};

struct Config : Common {
  std::string file;
  double volts = 3.3;
  std::uint8_t bits = 12;
  bool invert = false;
  char separator = ',';
  Duration timeout = 100ms;
  Duration offset{};
  std::chrono::milliseconds settle{5};
  Edge edge = Edge::rising;
  std::string policy = "other";
  std::optional<double> scale;
  std::vector<std::string> topics{"#"};
  std::array<double, 3> axes{1, 2, 3};
  std::vector<Parity> parities;
  Window window;
  std::vector<Window> windows;
  std::map<std::string, double> factors;
  std::optional<Window> extra;
  ConfigItem later;
  Serial serial;
  friend constexpr auto parameters(type_tag<Config>) {
    return parameter_list(
        include<Common>, parameter("file", &Config::file, "the kernel's ADC file", required),
        parameter("volts", &Config::volts, "voltage at full scale", unit("V"), range(0.001, 1000.0)),
        parameter("bits", &Config::bits, "resolution", at_most(32)),
        parameter("invert", &Config::invert, "upside down"),
        parameter("separator", &Config::separator, "between two values"),
        parameter("timeout", &Config::timeout, "longest wait", range(1ms, 1h)),
        parameter("offset", &Config::offset, "shift of the time", may_be_negative, at_least(-1s)),
        parameter("settle", &Config::settle, "wait before reading"),
        parameter("edge", &Config::edge, "which edge",
                  choices(value("rising", Edge::rising), value("falling", Edge::falling))),
        parameter("policy", &Config::policy, "scheduling", choices("other", "fifo", "rr")),
        parameter("scale", &Config::scale, "factor", at_least(0.0)),
        parameter("topics", &Config::topics, "what is recorded"),
        parameter("axes", &Config::axes, "weights", range(0, 10)), parameter("parities", &Config::parities, "to try"),
        parameter("window", &Config::window, "a filter"), parameter("windows", &Config::windows, "more filters"),
        parameter("factors", &Config::factors, "by name", at_least(0)),
        parameter("extra", &Config::extra, "one more filter"), parameter("later", &Config::later, "anything"),
        include_member(&Config::serial));
  }
};

Problems mistakes(std::string_view text) {
  const ConfigDocument document = parse_config(text, "f.json");
  REQUIRE_MESSAGE(document.good(), document.report());
  Config config;
  Problems problems;
  const bool good = read_config(document.root, config, problems);
  CHECK(good == problems.empty());
  return problems;
}

/// The mistake of one value under a key; the value begins at column 29.
std::string mistake(std::string_view key, std::string_view json) {
  std::string text = "{\"name\": \"n\", \"file\": \"f\",\n\"" + std::string(key) + "\":";
  text += std::string(28 - (key.size() + 3), ' ') + std::string(json) + "}";
  return mistakes(text).text();
}

}  // namespace

TEST_SUITE("config") {
  TEST_CASE("US-17 a config is read from its parameters, the rest keeps its defaults") {
    const auto text = R"({"name": "chamber", "rate": "50 Hz", "file": "adc0", "volts": 5, "bits": 16, "invert": true,
      "separator": ";", "timeout": "2 s", "offset": "-5 ms", "settle": "7 ms", "edge": "falling", "policy": "fifo",
      "scale": null, "topics": ["a", "b"], "axes": [0, 1.5, 3], "parities": ["odd", "none"], "window": {"size": 7},
      "windows": [{}, {"limit": 0.5}], "factors": {"k": 2}, "extra": {"size": 9}, "later": {"x": [1]},
      "baud": 115200, "parity": "even"})";
    const auto config = read_config<Config>(parse_config(text).or_throw());
    CHECK(config.name == "chamber");
    CHECK(config.rate == 50_Hz);
    CHECK(config.file == "adc0");
    CHECK(config.volts == 5.0);
    CHECK(config.bits == 16);
    CHECK(config.invert);
    CHECK(config.separator == ';');
    CHECK(config.timeout == 2s);
    CHECK(config.offset == -5ms);
    CHECK(config.settle == 7ms);
    CHECK(config.edge == Edge::falling);
    CHECK(config.policy == "fifo");
    CHECK_FALSE(config.scale);
    CHECK(config.topics == std::vector<std::string>{"a", "b"});
    CHECK(config.axes == std::array{0.0, 1.5, 3.0});
    CHECK(config.parities == std::vector{Parity::odd, Parity::none});
    CHECK(config.window.size == 7);
    CHECK(config.window.limit == 1.5);
    CHECK(config.windows.at(1).limit == 0.5);
    CHECK(config.factors.at("k") == 2.0);
    CHECK(config.extra.value().size == 9);
    CHECK(config.later.at("x[0]").get<int>() == 1);
    CHECK(config.later.path() == "later");
    CHECK(config.serial.baud == 115200);
    CHECK(config.serial.parity == Parity::even);

    const auto defaults = read_config<Config>(parse_config(R"({"name": "n", "file": "f"})").or_throw());
    CHECK(defaults.volts == 3.3);
    CHECK(defaults.rate == 10_Hz);
    CHECK(defaults.topics == std::vector<std::string>{"#"});
  }

  TEST_CASE("US-17 what is written from a config reads back as the same") {
    Config config;
    config.name = "n";
    config.file = "f";
    config.offset = -250ms;
    config.edge = Edge::falling;
    config.extra = Window{7, 2};
    config.parities = {Parity::even};
    config.factors["a"] = 0.5;
    config.later.set("x", 1);
    const ConfigItem item = write_config(config);
    CHECK(item.find("scale") == nullptr);
    const auto again = read_config<Config>(parse_config(item.to_json()).or_throw());
    CHECK(write_config(again) == item);
    CHECK(again.offset == -250ms);
    CHECK(again.extra.value().size == 7);
  }

  TEST_CASE("US-20 each class of mistake is told with line, column, path and suggestion") {
    CHECK(mistake("volst", "5") == "f.json:2:1: volst: unknown key (did you mean \"volts\"?) [unknown-key]\n");
    CHECK(mistake("volts", "\"5\"") == "f.json:2:29: volts: expected a number, got the string \"5\" [wrong-type]\n");
    CHECK(mistake("volts", "5000.0") ==
          "f.json:2:29: volts: 5000.0 V is out of range: 0.001 V to 1000 V [out-of-range]\n");
    CHECK(mistake("bits", "33") == "f.json:2:29: bits: 33 is out of range: at most 32 [out-of-range]\n");
    CHECK(mistake("bits", "300") == "f.json:2:29: bits: 300 is out of range: 0 to 255 [out-of-range]\n");
    CHECK(mistake("bits", "12.5") == "f.json:2:29: bits: expected a whole number, got the number 12.5 [wrong-type]\n");
    CHECK(mistake("invert", "1") == "f.json:2:29: invert: expected true or false, got the number 1 [wrong-type]\n");
    CHECK(mistake("separator", "\"ab\"") ==
          "f.json:2:29: separator: expected a string of one character, got the string \"ab\" [wrong-type]\n");
    CHECK(
        mistake("timeout", "10") ==
        "f.json:2:29: timeout: expected a duration with its unit, such as \"10 ms\", got the number 10 [wrong-type]\n");
    CHECK(mistake("timeout", "\"2 h\"") == "f.json:2:29: timeout: 2 h is out of range: 1 ms to 1 h [out-of-range]\n");
    CHECK(mistake("timeout", "\"-5 ms\"") ==
          "f.json:2:29: timeout: -5 ms is out of range: it must not be negative [out-of-range]\n");
    CHECK(mistake("offset", "\"-2 s\"") == "f.json:2:29: offset: -2 s is out of range: at least -1 s [out-of-range]\n");
    CHECK(mistake("rate", "100") ==
          "f.json:2:29: rate: expected a rate with its unit, such as \"100 Hz\", got the number 100 [wrong-type]\n");
    CHECK(mistake("rate", "\"20 kHz\"") ==
          "f.json:2:29: rate: 20 kHz is out of range: 0.1 Hz to 10000 Hz [out-of-range]\n");
    CHECK(mistake("rate", "\"10 kHz\"") == "");
    CHECK(mistake("rate", "\"0.1 Hz\"") == "");
    CHECK(mistake("edge", "\"fallign\"") ==
          "f.json:2:29: edge: expected one of rising, falling, got the string \"fallign\" (did you mean \"falling\"?) "
          "[unknown-choice]\n");
    CHECK(mistake("parity", "\"evne\"") ==
          "f.json:2:29: parity: expected one of none, even, odd, got the string \"evne\" (did you mean \"even\"?) "
          "[unknown-choice]\n");
    CHECK(mistake("policy", "7") ==
          "f.json:2:29: policy: expected one of other, fifo, rr, got the number 7 [wrong-type]\n");
    CHECK(mistake("scale", "-1") == "f.json:2:29: scale: -1 is out of range: at least 0 [out-of-range]\n");
    CHECK(mistake("topics", "\"#\"") == "f.json:2:29: topics: expected a list, got the string \"#\" [wrong-type]\n");
    CHECK(mistake("topics", "[\"a\", 1]") ==
          "f.json:2:35: topics[1]: expected a string, got the number 1 [wrong-type]\n");
    CHECK(mistake("axes", "[1, 2]") == "f.json:2:29: axes: expected a list of 3, got one of 2 [wrong-length]\n");
    CHECK(mistake("axes", "[1, 11, -1]") ==
          "f.json:2:33: axes[1]: 11 is out of range: 0 to 10 [out-of-range]\n"
          "f.json:2:37: axes[2]: -1 is out of range: 0 to 10 [out-of-range]\n");
    CHECK(mistake("window", "{\"sise\": 3}") ==
          "f.json:2:30: window.sise: unknown key (did you mean \"size\"?) [unknown-key]\n");
    CHECK(mistake("window", "{\"size\": 1}") ==
          "f.json:2:29: window: \"limit\" must not be above \"size\" [bad-value]\n");
    CHECK(mistake("windows", "[{}, {\"size\": 0}]") ==
          "f.json:2:43: windows[1].size: 0 is out of range: 1 to 99 [out-of-range]\n");
    CHECK(mistake("window", "[]") == "f.json:2:29: window: expected an object, got an empty list [wrong-type]\n");
    CHECK(mistake("factors", "{\"k\": -1}") ==
          "f.json:2:35: factors.k: -1 is out of range: at least 0 [out-of-range]\n");
    CHECK(mistakes("{}").text() ==
          "f.json:1:1: \"name\" is missing: what it is called [missing-key]\n"
          "f.json:1:1: \"file\" is missing: the kernel's ADC file [missing-key]\n");
    CHECK(mistakes("[]").text() == "f.json:1:1: expected an object, got an empty list [wrong-type]\n");
    CHECK(mistakes("{\"name\": \"n\", \"fil\": \"f\"}").text() ==
          "f.json:1:15: fil: unknown key (did you mean \"file\"?) [unknown-key]\n");
    CHECK(mistakes("{\"name\": \"n\", \"file\": \"f\", \"xyzzy\": 1}")
              .text()
              .starts_with("f.json:1:28: xyzzy: unknown key; known here are axes, baud, bits, edge"));
  }

  TEST_CASE("US-20 all mistakes of a file are told at once, in its order") {
    ConfigDocument document = parse_config(
        "{\n  \"name\": 5,\n  \"fiel\": \"f\",\n  \"volts\": 0,\n  \"axes\": [1, \"x\", 2],\n"
        "  \"window\": {\"size\": 3.5, \"limti\": 1}\n}",
        "f.json");
    Config config;
    CHECK_FALSE(read_config(document.root, config, document.problems));
    document.problems.sort();
    CHECK(document.problems.text() ==
          "f.json:2:11: name: expected a string, got the number 5 [wrong-type]\n"
          "f.json:3:3: fiel: unknown key (did you mean \"file\"?) [unknown-key]\n"
          "f.json:4:12: volts: 0 V is out of range: 0.001 V to 1000 V [out-of-range]\n"
          "f.json:5:15: axes[1]: expected a number, got the string \"x\" [wrong-type]\n"
          "f.json:6:22: window.size: expected a whole number, got the number 3.5 [wrong-type]\n"
          "f.json:6:27: window.limti: unknown key (did you mean \"limit\"?) [unknown-key]\n");
    CHECK_THROWS_WITH_AS((void)read_config<Config>(document.root),
                         "unknown key (and 5 more): f.json:3:3: fiel: did you mean \"file\"? [bad-configuration]",
                         ConfigError);
    CHECK(document.report().find(
              "f.json:3:3: fiel: unknown key (did you mean \"file\"?) [unknown-key]\n    \"fiel\": \"f\",\n    ^\n") !=
          std::string::npos);
  }

  TEST_CASE("US-17 the parameters are listed with type, unit, default and range") {
    std::string list;
    for (const ParameterInfo& p : parameters_of<Config>()) {
      list += p.key + "|" + p.type.name() + "|" + p.unit + "|" + p.default_text() + "|" + p.type.range() + "|";
      for (const std::string& choice : p.type.choices) list += choice + " ";
      list += (p.required ? "|required\n" : "|\n");
    }
    CHECK(list ==
          "name|string|||||required\n"
          "rate|rate||10 Hz|0.1 Hz to 10000 Hz||\n"
          "file|string|||||required\n"
          "volts|number|V|3.3|0.001 to 1000||\n"
          "bits|integer||12|0 to 32||\n"
          "invert|boolean||false|||\n"
          "separator|character||,|||\n"
          "timeout|duration||100 ms|1 ms to 1 h||\n"
          "offset|duration||0 s|at least -1 s||\n"
          "settle|duration||5 ms|||\n"
          "edge|choice||rising||rising falling |\n"
          "policy|choice||other||other fifo rr |\n"
          "scale|number|||at least 0||\n"
          "topics|list of string||[\"#\"]|||\n"
          "axes|list of 3 number||[1.0, 2.0, 3.0]|0 to 10||\n"
          "parities|list of choice||[]|||\n"
          "window|object||{\"size\": 5, \"limit\": 1.5}|||\n"
          "windows|list of object||[]|||\n"
          "factors|map of number||{}|at least 0||\n"
          "extra|object|||||\n"
          "later|any|||||\n"
          "baud|integer|Bd|9600|50 to 4000000||\n"
          "parity|choice||none||none even odd |\n");
  }

  TEST_CASE("US-17 the schema says the same as the reading") {
    const auto schema = nlohmann::json::parse(schema_of<Config>("analog", "a sensor"));
    CHECK(schema["$schema"] == "http://json-schema.org/draft-07/schema#");
    CHECK(schema["title"] == "analog");
    CHECK(schema["additionalProperties"] == false);
    CHECK(schema["required"] == nlohmann::json({"name", "file"}));
    const auto& properties = schema["properties"];
    CHECK(properties.size() == 23);
    const auto volts = nlohmann::json::parse(
        R"json({"type": "number", "minimum": 0.001, "maximum": 1000, "description": "voltage at full scale (V)", "default": 3.3})json");
    CHECK(properties["volts"] == volts);
    CHECK(properties["bits"]["minimum"] == 0);
    CHECK(properties["bits"]["maximum"] == 32);
    CHECK(properties["edge"]["enum"] == nlohmann::json({"rising", "falling"}));
    CHECK(properties["timeout"]["description"] == "longest wait, 1 ms to 1 h");
    CHECK(properties["scale"]["anyOf"][1]["type"] == "null");
    CHECK(properties["axes"]["minItems"] == 3);
    CHECK(properties["axes"]["items"]["maximum"] == 10);
    CHECK(properties["parities"]["items"]["enum"].size() == 3);
    CHECK(properties["window"]["properties"]["size"]["maximum"] == 99);
    CHECK(properties["factors"]["additionalProperties"]["type"] == "number");
    CHECK(properties["window"]["additionalProperties"] == false);
    CHECK_FALSE(properties["later"].contains("type"));
  }

  TEST_CASE("US-17 keys that somebody else reads are not unknown") {
    const ConfigItem item = parse_config(R"({"name": "n", "size": 3, "limit": 1})").or_throw();
    Window window;
    Problems problems;
    CHECK(read_config(item, window, problems, UnknownKeys::report, {"name"}));
    CHECK(read_config(item, window, problems, UnknownKeys::ignore));
    CHECK_FALSE(read_config(item, window, problems));
    CHECK(problems.text() == "configuration.json:1:2: name: unknown key; known here are limit, size [unknown-key]\n");
  }

  TEST_CASE("US-20 an enumeration with a describe is a value like any other") {
    const ConfigItem item = parse_config(R"(["odd", "oddd"])").or_throw();
    CHECK(item.at(0).get<Parity>() == Parity::odd);
    CHECK_THROWS_AS((void)item.at(1).get<Parity>(), ConfigError);
    CHECK(ConfigItem::of(Parity::even).get<std::string>() == "even");
    CHECK(ConfigItem::of(static_cast<Parity>(9)).is_null());
  }
}
