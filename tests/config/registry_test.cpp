#include "rtdata/detail/config/type_registry.hpp"

#include <doctest/doctest.h>

#include <memory>
#include <nlohmann/json.hpp>

#include "rtdata/config/format.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

struct Shared {
  std::string name;
  friend constexpr auto parameters(type_tag<Shared>) {
    return parameter_list(parameter("name", &Shared::name, "what it is called"));
  }
};
struct Analog {
  std::string file;
  double volts = 3.3;
  friend constexpr auto parameters(type_tag<Analog>) {
    return parameter_list(parameter("file", &Analog::file, "the ADC file", required),
                          parameter("volts", &Analog::volts, "full scale", unit("V")));
  }
};
struct Gps {
  std::uint16_t port = 2947;
  friend constexpr auto parameters(type_tag<Gps>) {
    return parameter_list(parameter("port", &Gps::port, "of the daemon"));
  }
};

using Made = std::unique_ptr<std::string>;
using Sensors = TypeRegistry<Made, int&>;

Sensors sensors() {
  Sensors registry("sensor", parameters_of<Shared>());
  registry.add<Analog>("analog", "an analog sensor", [](int& count, const Analog& config) {
    ++count;
    if (config.file == "gone") throw SetupError({Errc::not_found, "cannot open", "gone", "No such file", ""});
    return std::make_unique<std::string>("analog " + config.file);
  });
  registry.add<Gps>("gpsd", "a GPS receiver", [](int& count, const Gps& config) {
    ++count;
    return std::make_unique<std::string>("gps " + std::to_string(config.port));
  });
  return registry;
}

std::string problems_of(std::string_view text) {
  const ConfigItem item = parse_config(text, "f.json").or_throw();
  Problems problems;
  const bool good = sensors().check(item, problems);
  CHECK(good == problems.empty());
  int count = 0;
  if (!problems.empty()) CHECK_THROWS_AS((void)sensors().create(item, count), ConfigError);
  CHECK(count == 0);
  return problems.text();
}

}  // namespace

TEST_SUITE("config") {
  TEST_CASE("US-17 a registry makes what an item's type names") {
    const Sensors registry = sensors();
    int count = 0;
    const auto make = [&](std::string_view text) { return *registry.create(parse_config(text).or_throw(), count); };
    CHECK(make(R"({"type": "analog", "name": "a", "file": "adc0"})") == "analog adc0");
    CHECK(make(R"({"type": "gpsd"})") == "gps 2947");
    CHECK(count == 2);
  }

  TEST_CASE("US-17 checking an item tells every mistake and makes nothing") {
    CHECK(problems_of(R"({"type": "analog", "file": "x"})") == "");
    CHECK(problems_of(R"({"type": "analgo"})") ==
          "f.json:1:10: type: there is no sensor type \"analgo\" (did you mean \"analog\"?) [unknown-type]\n");
    CHECK(problems_of(R"({"type": "lidar"})") ==
          "f.json:1:10: type: there is no sensor type \"lidar\"; available: analog, gpsd [unknown-type]\n");
    CHECK(problems_of(R"({"name": "x"})") ==
          "f.json:1:1: \"type\" is missing: the type of the sensor, one of analog, gpsd [missing-key]\n");
    CHECK(problems_of(R"({"type": 5})") == "f.json:1:10: type: expected a string, got the number 5 [wrong-type]\n");
    CHECK(problems_of(R"([])") == "f.json:1:1: expected an object, got an empty list [wrong-type]\n");
    CHECK(problems_of(R"({"type": "gpsd", "port": 70000, "naem": "x"})") ==
          "f.json:1:33: naem: unknown key (did you mean \"name\"?) [unknown-key]\n"
          "f.json:1:26: port: 70000 is out of range: 0 to 65535 [out-of-range]\n");
  }

  TEST_CASE("an error of a factory gets the place of its item") {
    int count = 0;
    const ConfigItem root = parse_config("[\n {\"type\": \"analog\", \"file\": \"gone\"}]", "f.json").or_throw();
    CHECK_THROWS_WITH_AS((void)sensors().create(root.at(0), count),
                         "cannot open: f.json:2:2: [0]: gone: No such file [not-found]", SetupError);
  }

  TEST_CASE("a type cannot be added twice") {
    Sensors registry = sensors();
    CHECK_THROWS_WITH_AS(
        registry.add<Gps>("gpsd", "", [](int&, const Gps&) { return Made(); }),
        "cannot add the sensor type \"gpsd\": there is one of this name already: choose another name [bad-argument]",
        SetupError);
  }

  TEST_CASE("US-17 a type that the program was built without is told apart from one that nobody knows") {
    Sensors registry = sensors();
    registry.leave_out("modbus", "this program was built without libmodbus");
    const auto problems_of_type = [&registry](const std::string& type) {
      const ConfigItem item = parse_config("{\"type\": \"" + type + "\"}", "f.json").or_throw();
      Problems problems;
      (void)registry.check(item, problems);
      return problems.text();
    };
    CHECK(problems_of_type("modbus").find("no sensor type \"modbus\": this program was built without libmodbus") !=
          std::string::npos);
    CHECK(problems_of_type("modbas").find("built without") == std::string::npos);
    CHECK(registry.types().size() == 2);
    registry.add<Gps>("modbus", "one of the program's own", [](int&, const Gps&) { return Made(); });
    CHECK(problems_of_type("modbus").empty());
  }

  TEST_CASE("US-17 types are listed with parameters and schema") {
    const Sensors registry = sensors();
    REQUIRE(registry.types().size() == 2);
    CHECK_FALSE(registry.find("gps").has_value());
    const TypeInfo analog = registry.find("analog").value();
    CHECK(analog.doc == "an analog sensor");
    CHECK(analog.parameters.size() == 3);
    CHECK(analog.parameters[0].key == "name");
    const auto one = nlohmann::json::parse(analog.schema());
    CHECK(one["properties"]["type"]["const"] == "analog");
    CHECK(one["required"] == nlohmann::json({"type", "file"}));
    const auto all = nlohmann::json::parse(registry.schema());
    CHECK(all["properties"]["type"]["enum"] == nlohmann::json({"analog", "gpsd"}));
    CHECK(all["allOf"][1]["then"]["properties"]["port"]["maximum"] == 65535);
  }

  TEST_CASE("a registry without context and with a movable product") {
    TypeRegistry<int> registry("thing");
    registry.add<Gps>("gps", "", [](const Gps& config) { return static_cast<int>(config.port); });
    CHECK(registry.create(parse_config(R"({"type": "gps", "port": 5})").or_throw()) == 5);
    Problems problems;
    CHECK_FALSE(TypeRegistry<int>("filter").check(parse_config(R"({"type": "x"})").or_throw(), problems));
    CHECK(problems[0].message == "there is no filter type \"x\"; there are none");
  }
}
