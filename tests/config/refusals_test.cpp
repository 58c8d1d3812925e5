// What `run` refuses without touching a device, `check` refuses: for every shipped type, with many mistakes.
#include <doctest/doctest.h>
#include <stdlib.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <optional>

#include "app/process.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/recording/sqlite.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using test::Folder;
using test::Process;

namespace {

using rtdata::test::has;

/// An item of each type that is right; `FOLDER` stands for a directory of the test.
const std::map<std::string, std::string> right_sensors_without_driver{
    {"analog", R"({"name": "s", "type": "analog", "rate": "10 Hz", "file": "FOLDER/adc"})"},
    {"limit", R"({"name": "s", "type": "limit", "on": "other", "field": "tasks", "high": 100})"},
    {"derived", R"({"name": "s", "type": "derived", "on": "other", "expression": "running + 1"})"},
    {"trigger", R"({"name": "s", "type": "trigger", "on": "other", "when": "running > 1"})"},
    {"vertical", R"({"name": "s", "type": "vertical", "barometer": "other", "height": "running"})"},
    {"iio", R"({"name": "s", "type": "iio", "rate": "10 Hz", "device": "bmp280", "channels": ["temp"]})"},
    {"iio_buffer", R"({"name": "s", "type": "iio_buffer", "device": "mpu6050", "channels": ["accel_x"]})"},
    {"counter", R"({"name": "s", "type": "counter", "rate": "10 Hz", "line": "no-such-line"})"},
    {"edge", R"({"name": "s", "type": "edge", "line": "no-such-line"})"},
    {"encoder", R"({"name": "s", "type": "encoder", "rate": "10 Hz"})"},
    {"gpio", R"({"name": "s", "type": "gpio", "rate": "10 Hz", "lines": [{"name": "x", "line": "no-such-line"}]})"},
    {"gps", R"({"name": "s", "type": "gps"})"},
    {"host", R"({"name": "s", "type": "host", "quantity": "load", "rate": "10 Hz"})"},
    {"http",
     R"({"name": "s", "type": "http", "rate": "10 Hz", "url": "http://127.0.0.1:9/x", "fields": [{"name": "x"}]})"},
    {"mqtt", R"({"name": "s", "type": "mqtt", "host": "127.0.0.1", "port": 1, "topics": ["a/#"],
                 "fields": [{"name": "x"}]})"},
    {"pps", R"({"name": "s", "type": "pps"})"},
    {"replay", R"({"name": "s", "type": "replay", "file": "FOLDER/old.db"})"},
    {"w1", R"({"name": "s", "type": "w1", "rate": "0.5 Hz"})"},
    {"serial", R"({"name": "s", "type": "serial", "device": "FOLDER/tty", "fields": [{"name": "x"}]})"},
    {"tcp", R"({"name": "s", "type": "tcp", "host": "127.0.0.1", "port": 1, "fields": [{"name": "x"}]})"},
    {"udp", R"({"name": "s", "type": "udp", "port": 1, "fields": [{"name": "x"}]})"},
    {"command", R"({"name": "s", "type": "command", "run": ["true"], "fields": [{"name": "x"}]})"}};
const std::map<std::string, std::string> right_sinks{{"sqlite", R"({"type": "sqlite", "path": "FOLDER/run.db"})"},
                                                     {"file", R"({"type": "file", "path": "FOLDER/run.jsonl"})"},
                                                     {"console", R"({"type": "console", "descriptor": 2})"},
                                                     {"http", R"({"type": "http", "url": "http://127.0.0.1:9/x"})"},
                                                     {"postgresql", R"({"type": "postgresql", "host": "FOLDER"})"},
                                                     {"mqtt", R"({"type": "mqtt", "host": "127.0.0.1", "port": 1})"},
                                                     {"tcp", R"({"type": "tcp", "host": "127.0.0.1", "port": 1})"},
                                                     {"udp", R"({"type": "udp", "host": "127.0.0.1", "port": 1})"}};

// None of their devices is there: what is away is not what `check` could know.
const std::map<std::string, std::string> right_outputs{
    {"command", R"({"name": "o", "type": "command", "run": ["true", "{value}"]})"},
    {"gpio", R"({"name": "o", "type": "gpio", "line": "no-such-line", "on": "other", "expression": "running > 1"})"},
    {"http", R"({"name": "o", "type": "http", "url": "http://127.0.0.1:9/{value}", "timeout": "10 ms"})"},
    {"mqtt", R"({"name": "o", "type": "mqtt", "host": "127.0.0.1", "port": 1, "to": "a", "timeout": "10 ms"})"},
    {"pwm", R"({"name": "o", "type": "pwm", "root": "FOLDER", "on": "other", "expression": "running",
                "hysteresis": {"on": 2, "off": 1}})"},
    {"serial", R"({"name": "o", "type": "serial", "device": "FOLDER/tty"})"}};
const std::map<std::string, std::string> right_machines{{"machine", R"({"name": "m", "inputs": ["other"], "start": "a",
         "states": [{"name": "a"}, {"name": "b"}, {"name": "c", "final": true}],
         "transitions": [{"from": "a", "to": "b", "when": "running > 1", "for": "1 s"}, {"from": "b", "to": "a", "event": "x"},
                         {"from": "b", "to": "c", "after": "1 s", "cause": "because"}]})"}};

#ifdef RTDATA_WITH_MODBUS
constexpr const char* modbus_bus = R"("plc": {"type": "modbus", "device": "/no/such/rs485"},)";
#else
constexpr const char* modbus_bus = "";
#endif

std::string in_folder(std::string text, const Folder& folder) {
  for (auto at = text.find("FOLDER"); at != std::string::npos; at = text.find("FOLDER"))
    text.replace(at, 6, folder.path());
  return text;
}

/// One for all: making it takes longer than anything that is asked of it here.
const Registry& registry() {
  static const Registry made = standard_registry();
  return made;
}

SystemPlan planned(const std::string& text) { return plan_system(registry(), parse_config(text, "f.json")); }

/// Those of drivers are made of their samples.
std::map<std::string, std::string> right_sensors() {
  const std::map<std::string, std::string> buses{
      {"i2c", "i2c1"}, {"spi", "spi0"}, {"serial", "tty"}, {"modbus", "plc"}};
  std::map<std::string, std::string> all = right_sensors_without_driver;
  for (const TypeInfo& type : registry().sensors().types()) {
    if (type.page.bus.empty()) continue;
    REQUIRE_MESSAGE(!type.page.samples.empty(), "the driver states no sample: " << type.name);
    const std::string members(type.page.samples[0].members);
    all.emplace(type.name, R"({"name": "s", "type": ")" + type.name + R"(", "rate": "2 Hz", "bus": ")" +
                               buses.at(type.page.bus) + "\"" + (members.empty() ? "" : ", ") + members + "}");
  }
  return all;
}

/// Whether it is about what is not there, which `check` does not look at.
bool is_of_device(const Error& error) {
  for (const Errc code : {Errc::not_found, Errc::not_permitted, Errc::disconnected, Errc::timed_out, Errc::io_failed})
    if (error.code == code) return true;
  return false;
}

/// What making the system says; empty: it was made.
std::string refusal_of_making(const SystemPlan& plan, bool may_be_of_device = false) {
  try {
    Runtime runtime(plan.runtime_config());
    runtime.on_log([](const LogRecord&) {});
    Loop loop(runtime, plan.loop_config());
    const System system(loop, registry(), plan);
    return "";
  } catch (const SetupError& error) {
    return may_be_of_device && is_of_device(error.error()) ? "" : error.what();
  }
}

/// Values that are wrong for one parameter or another.
std::vector<ConfigItem> odd_values() {
  return parse_config(
             R"([null, true, 0, 1, -1, 0.5, 1e300, 63, 300, 99999999999, "", " ", "x", "a b", "#", "a/b", "/", "$x",
      ".", "/no/such/folder/x", "nul\u0000here", "0 s", "1 ns", "1 ms", "-1 ms", "1 d", "200 d", "1 Hz", "1 MHz", "2 MHz", "1 GHz",
      "csv", "json", "nmea", "raw", "two_point", "disk", "network", "temperature", "fifo", [], [""], ["x"], ["a b"], ["a/#/b"], {},
      {"env": "RTDATA_TEST_NO_SUCH_VARIABLE"}, {"file": "/no/such/file"}, {"env": 3}, {"env": "A", "file": "B"},
      [{"name": ""}], [{"name": "time"}], [{"name": "x"}, {"name": "X"}], [{"name": "x", "type": "record"}],
      [{"name": "x", "type": "text", "length": 0}], [{"name": "x", "scale": 2, "type": "int8"}], [{"key": "x"}],
      {"x": {"calibration": {}}}, "labels", "binary", {"start": "x", "length": 9}, {"end": "y"}, {"begins": "x"},
      {"column": 1, "is": ["x"]}, {"key": "x", "is": ["y"]}, {"type": "xor8"}, {"type": "sum6", "form": "character"},
      {"type": "crc32", "form": "big", "after": "*", "optional": true}, "\r"])",
             "values.json")
      .or_throw()
      .get<std::vector<ConfigItem>>();
}

/// One that can be replayed.
std::string old_recording() {
  static const Folder folder;
  static const std::string path = [] {
    const std::string file = folder.path() + "/old.db";
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = file});
    loop.topic<HealthChange>("old").publish({});
    loop.close();
    return file;
  }();
  return path;
}

/// What a sensor that is derived from others needs.
constexpr const char* other_sensor = R"({"name": "other", "type": "host", "quantity": "load", "rate": "10 Hz"})";

/// A system of this one item in each of its odd kinds: what is not refused can be made. A parameter that several types
/// have is tried with all values in the first of them, and with each fifth, another one each time, in the others (all
/// of them: script/soak).
void try_all(const TypeRegistryBase& types, const char* list, const std::map<std::string, std::string>& right) {
  const std::vector<ConfigItem> values = odd_values();
  const bool is_whole = std::getenv("RTDATA_TEST_SEEDS") != nullptr;
  std::map<std::string, std::size_t> tried;  // types with the parameter, by its key
  std::size_t refused = 0, made = 0;
  for (const TypeInfo& type : types.types()) {
    REQUIRE_MESSAGE(right.contains(type.name), "give the test an item of type " << type.name);
    const bool is_sensor = std::string(list) == "sensors", needs_other = has(right.at(type.name), "\"other\"");
    for (const ParameterInfo& parameter : type.parameters) {
      const std::size_t types_before = tried[parameter.key]++;
      const std::size_t step = types_before == 0 || is_whole ? 1 : 5;
      std::optional<Folder> own;
      for (std::size_t at = step == 1 ? 0 : types_before % step; at < values.size(); at += step) {
        const ConfigItem& value = values[at];
        if (!own || std::string(list) == "sinks") {  // which find what another has left
          own.emplace();
          own->write("adc", "7\n");
          if (has(right.at(type.name), "old.db")) std::filesystem::copy_file(old_recording(), own->path() + "/old.db");
        }
        const Folder& folder = *own;
        ConfigItem item = parse_config(in_folder(right.at(type.name), folder), "item.json").or_throw();
        item.set(parameter.key, value);
        const std::string text = R"({"buses": {"i2c1": {"type": "i2c", "device": "/no/such/adapter"},
            "spi0": {"type": "spi", "device": "/no/such/controller"},)" +
                                 std::string(modbus_bus) +
                                 R"("tty": {"type": "serial", "device": "/no/such/line"}}, ")" + std::string(list) +
                                 "\": [" + item.to_json() +
                                 (needs_other && is_sensor ? "," + std::string(other_sensor) : "") + "]" +
                                 (needs_other && !is_sensor ? ", \"sensors\": [" + std::string(other_sensor) + "]"
                                                            : "") +
                                 "}";
        CAPTURE(text);
        const SystemPlan plan = planned(text);
        ++(plan.good() ? made : refused);
        if (!plan.good()) continue;
        if (parameter.key == "required") continue;  // what it refuses is the device's doing
        if (parameter.key == "path" && !value.as_string()->starts_with("/")) continue;  // would be made right here
        const std::string refusal = refusal_of_making(plan, std::string(list) == "outputs");
        CHECK_MESSAGE(refusal.empty(), refusal);
      }
    }
  }
  CHECK(refused > 20 * types.types().size());
  CHECK(made > 20 * types.types().size());
}

}  // namespace

TEST_SUITE("config") {
  TEST_CASE(
      "check says what a beginner meant: a shell's ~, a port of Windows, a name alone, a comma, and warnings too") {
    const Folder folder;
    const auto said = [&](const std::string& text) {
      folder.write("b.json", text);
      Process check(folder, test::program, {"check", "b.json"});
      CHECK(check.end() != 0);
      return check.out;
    };
    const auto line = [](const std::string& more) {
      return R"({"sensors": [{"name": "s", "type": "serial", "device": "/dev/ttyS0", "fields": [)"
             R"({"name": "x"}])" +
             more + "}]}";
    };
    ::setenv("HOME", "/home/ann", 1);
    CHECK(has(said(R"({"sinks": [{"type": "sqlite", "path": "~/bench.db"}]})"),
              "this program does not: write \"/home/ann/bench.db\""));
    CHECK(has(said(R"({"sinks": [{"type": "file", "path": "~/bench.csv"}]})"), "write \"/home/ann/bench.csv\""));
    for (const char* port : {"COM3", "com12"})
      CHECK(
          has(said(R"({"buses": {"b": {"type": "serial", "device": ")" + std::string(port) + "\"}}}"),
              "\"" + std::string(port) + "\" is a Windows name; here a serial device has a name such as /dev/ttyUSB0"));
    CHECK(has(said(R"({"sensors": [{"name": "s", "type": "serial", "device": "/dev/ttyS0", "fields": ["force"]}]})"),
              "sensors[0].fields[0]: expected an object, got the string \"force\"; write {\"name\": \"force\"}"));
    CHECK(has(said(line(R"(, "rate": "10 Hz")")), "a serial line takes every line that comes: it has no rate"));
    CHECK(has(said(R"({"sensors": [{"name": "s", "type": "host", "quantity": "load", "rate": "2,5 Hz"}]})"),
              "its decimals come after a comma; write a point"));
    const std::string schema = said(
        R"({"sinks": [{"type": "postgresql", "url": "postgresql://rt@db.example/plant", "schema": "pg_x"}]})");
    if (!has(schema, "there is no sink type"))
      CHECK(has(schema, "sinks[0].schema: names that begin with pg_ are reserved for the server; choose another"));
    // A unit that is none is a warning, which is not held back until the mistake is mended.
    const std::string both = said(R"({"sensors": [{"name": "s", "type": "serial", "device": "/dev/ttyS0", "fields": [)"
                                  R"({"name": "x", "unit": "Bar"}], "rat": 1}]})");
    CHECK(has(both, "unknown key"));
    CHECK(has(both, "warning: "));
    CHECK(has(both, "Bar"));
    CHECK(has(both, "\n1 problem\n"));
    folder.write("b.json", line(""));
    Process check(folder, test::program, {"check", "b.json"});
    CHECK(check.end() == 0);
    CHECK(has(check.out, "`rtdata doctor` does that\n"));
  }

  TEST_CASE("NFR-5 what check takes can be made: each parameter of each sensor with each of many odd values") {
    try_all(standard_registry().sensors(), "sensors", right_sensors());
  }

  TEST_CASE("NFR-5 what check takes can be made: each parameter of each sink with each of many odd values") {
    try_all(standard_registry().sinks(), "sinks", right_sinks);
  }

  TEST_CASE(
      "NFR-5 what check takes can be made: each parameter of each output and machine with each of many odd values") {
    const Registry registry = standard_registry();
    for (const PartKind& kind : registry.kinds()) {
      if (kind.name == "output") try_all(kind.types, "outputs", right_outputs);
      if (kind.name == "machine") try_all(kind.types, "machines", right_machines);
    }
  }

  TEST_CASE("NFR-5 each parameter of each type says what it takes, also to the schema") {
    const std::function<void(const std::string&, const ParameterType&)> look = [&](const std::string& path,
                                                                                   const ParameterType& type) {
      CHECK_MESSAGE(type.kind != ParameterType::Kind::any, path);
      for (const ParameterType& element : type.element) look(path + "[]", element);
      for (const ParameterInfo& member : type.members) look(path + "." + member.key, member.type);
    };
    const Registry registry = standard_registry();
    std::size_t types = 0;
    for (const PartKind& kind : registry.kinds()) {
      for (const TypeInfo& type : kind.types.types()) {
        ++types;
        for (const ParameterInfo& parameter : type.parameters) look(type.name + "." + parameter.key, parameter.type);
      }
    }
    CHECK(types > 20);
    CHECK(has(registry.schema(), R"("string",)"));
    const auto good = [&](const std::string& address) {
      return planned(R"({"buses": {"i2c1": {"type": "i2c", "device": "/no/such/adapter"}},
          "sensors": [{"name": "s", "type": "lm75", "rate": "1 Hz", "bus": "i2c1", "address": )" +
                     address + "}]}")
          .good();
    };
    for (const char* address : {"8", "119", R"("0x08")", R"("0X77")", R"("119")", R"("072")"}) CHECK(good(address));
    for (const char* address : {"7", "120", R"("0x78")", R"("0x7")", R"("120")", R"("")", "null", "true"})
      CHECK_FALSE(good(address));
  }

#ifdef RTDATA_WITH_MQTT
  TEST_CASE("filters of one mqtt sensor of which a message could match two are refused, others not") {
    const auto good = [](const std::string& topics) {
      return planned(R"({"sensors": [{"name": "s", "type": "mqtt", "host": "127.0.0.1", "topics": )" + topics +
                     R"(, "fields": [{"name": "x"}]}]})")
          .good();
    };
    for (const char* both :
         {R"(["a", "a"])", R"(["a/#", "a"])", R"(["#", "a/b"])", R"(["+/b", "a/+"])", R"(["+", "#"])",
          R"(["$share/g/a/#", "a/b"])", R"(["$share/g/a/+", "$share/h/+/b"])", R"(["$SYS/#", "$SYS/+"])"})
      CHECK_MESSAGE(!good(both), both);
    for (const char* apart : {R"(["a", "b"])", R"(["a/#", "ab"])", R"(["+/b", "a/+/b"])", R"(["#", "$SYS/#"])",
                              R"(["+/x", "$SYS/x"])", R"(["a/+", "a"])", R"(["$share/g/a/#", "b/#"])"})
      CHECK_MESSAGE(good(apart), apart);
  }
#endif

  TEST_CASE("NFR-5 check and run refuse the same mistakes, with the same words, both with 2") {
    const Folder folder;
    std::filesystem::create_directory(folder.path() + "/folder");
    folder.write("text.txt",
                 "no recording, and long enough that it cannot be the beginning of one: one hundred bytes and more");
    folder.write("other.csv", "time,origin,sequence,speed\n");
    folder.write("short.txt", "x,y\n1,2\n");
    folder.write("recorded.db", std::string("SQLite format 3\0", 16) + std::string(84, '\0'));
    folder.write("recorded-a.csv", folder.read("recorded.db"));
    folder.write("open.db", "a database that is open has a log beside it");
    folder.write("open.db-wal", "");
    std::filesystem::create_symlink("/nope/x", folder.path() + "/dangling");
    const std::string load = R"({"name": "a", "type": "host", "quantity": "load", "rate": "1 Hz"})";
    const auto serial = [](const std::string& more) {
      return R"({"sensors": [{"name": "a", "type": "serial", "device": "/dev/null", "fields": [{"name": "x", "type": "int32"}])" +
             more + "}]}";
    };
    const auto process = [](const std::string& fields) {
      return R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "1 Hz", "process": {)" + fields +
             "}}]}";
    };
    const auto on_i2c = [](const std::string& timeout, const std::string& what) {
      return R"({"buses": {"i2c1": {"type": "i2c", "device": "/no/such/adapter", "timeout": ")" + timeout +
             R"("}}, "sensors": [{"name": "a", "bus": "i2c1", "rate": "1 Hz", )" + what + "}]}";
    };
    const auto sinks = [&](const std::string& list) {
      return R"({"sensors": [)" + load + R"(], "sinks": [)" + list + "]}";
    };
    const auto beside = [](const std::string& type, const std::string& path, const std::string& other_type,
                           const std::string& other) {
      return R"({"type": ")" + type + R"(", "path": ")" + path + R"("}, {"type": ")" + other_type + R"(", "path": ")" +
             other + "\"}";
    };
    std::filesystem::create_symlink("x", folder.path() + "/x-link");  // to what is not there
    std::filesystem::create_symlink("nothing.db", folder.path() + "/link.db");
    folder.write("hard1", "");
    std::filesystem::create_hard_link(folder.path() + "/hard1", folder.path() + "/hard2");
    folder.write("h.db-wal", "");
    std::filesystem::create_hard_link(folder.path() + "/h.db-wal", folder.path() + "/hard-wal");
    struct Mistake {
      std::string text;
      std::string words;
    };
    const std::vector<Mistake> mistakes{
        {serial(R"(, "sequence_field": "y")"), "\"y\" is not an integer among the fields"},
        {R"({"sensors": [{"name": "a", "type": "serial", "device": "/dev/null", "fields": [{"name": "x"}], "sequence_field": "x"}]})",
         "\"x\" is not an integer among the fields"},
        {R"({"sensors": [{"name": "a", "type": "serial", "device": "", "fields": [{"name": "x"}]}]})",
         "device: it is empty"},
        {R"({"sensors": [{"name": "a", "type": "serial", "device": "/dev/null", "format": "json", "fields": [{"name": "x"}, {"type": "int8"}]}]})",
         "a field of JSON has no name"},
        {R"({"sensors": [{"name": "a", "type": "host", "quantity": "disk", "rate": "1 Hz"}]})", "`device` is missing"},
        {R"({"sensors": [{"name": "a", "type": "host", "quantity": "network", "rate": "1 Hz", "device": ""}]})",
         "set `device`, such as eth0"},
        {R"({"sensors": [{"name": "a", "type": "analog", "rate": "1 Hz", "file": "x", "span_voltage": 0}]})",
         "span_voltage: it must not be 0"},
        {R"({"sensors": [{"name": "a", "type": "analog", "rate": "1 Hz", "file": "x", "span_value_voltage": 0}]})",
         "the sensor's range has the width 0"},
        {R"({"sensors": [{"name": "a", "type": "analog", "rate": "1 Hz", "file": "x", "conversion": "two_point",
             "zero_value_voltage": 1, "span_value_voltage": 1}]})",
         "the sensor's range has the width 0"},
        {R"({"sensors": [{"name": "a", "type": "analog", "rate": "1 Hz", "file": ""}]})", "file: it is empty"},
        {R"({"sensors": [{"name": "a b", "type": "host", "quantity": "load", "rate": "1 Hz"}]})",
         "\"a b\" is not a topic name"},
        {sinks(R"({"type": "file", "path": "x", "format": "jsnol"})"),
         "there is no format \"jsnol\" (did you mean \"jsonl\"?)"},
        {sinks(R"({"type": "tcp", "host": "a", "port": 1, "format": "jsnol"})"), "did you mean \"jsonl\"?"},
        {sinks(R"({"type": "tcp", "host": "a", "port": 1, "format": "csv"})"), "do not contain the topic"},
        {sinks(R"({"type": "tcp", "host": "http://a", "port": 1})"), "it is a URL"},
        {sinks(R"({"type": "tcp", "host": "a", "port": 0})"), "port"},
        {sinks(R"({"type": "udp", "host": "a b"})"), "it is neither a host name nor an address"},
        {sinks(R"({"type": "udp", "host": ""})"), "there is no host"},
        {sinks(R"({"type": "tcp", "host": "127.0.0.1:80", "port": 1})"),
         "it contains a port: write the port as `port`"},
        {sinks(R"({"type": "tcp", "host": "[::1]", "port": 1})"), "it has brackets"},
        {sinks(R"({"type": "tcp", "host": "::1::", "port": 1})"), "it is neither a host name nor an address"},
        {R"({"sensors": [{"name": "a\\", "type": "host", "quantity": "load", "rate": "1 Hz", "topic": "a"}],
             "sinks": [{"type": "tcp", "host": "127.0.0.1", "port": 1, "format": "influx"}]})",
         "cannot be in the lines of InfluxDB"},
#ifdef RTDATA_WITH_MQTT
        {sinks(R"({"type": "mqtt", "host": "127.0.0.1", "topic": "x/{nosuch}"})"), "there is no {nosuch}"},
        {sinks(R"({"type": "mqtt", "host": "127.0.0.1", "client_id": "a\u0001b"})"), "it has a control character"},
        {sinks(R"({"type": "mqtt", "host": "127.0.0.1", "client_id": ")" + std::string(65536, 'c') + "\"}"),
         "it has 65536 bytes, but a text in MQTT has at most 65535"},
        {sinks(R"({"type": "mqtt", "host": "127.0.0.1", "password": "secret"})"), "`password` needs a `user`"},
        {R"({"sensors": [{"name": "s", "type": "mqtt", "host": "127.0.0.1", "client_id": "a\u0000b",
             "topics": ["a"], "fields": [{"name": "x"}]}]})",
         "it has a control character"},
        {R"({"sensors": [{"name": "s", "type": "mqtt", "host": "127.0.0.1", "topics": ["ov/+/b", "ov/a/#"],
             "fields": [{"name": "x"}]}]})",
         "both match \"ov/a/b\""},
#endif
        {sinks(R"({"type": "file", "path": ""})"), "the path is empty; name a file"},
        {sinks(R"({"type": "file", "path": "folder"})"), "\"folder\" is a folder"},
        {sinks(R"({"type": "file", "path": "folder/"})"), "is a folder"},
        {sinks(R"({"type": "sqlite", "path": "folder"})"), "\"folder\" is a folder"},
        {sinks(R"({"type": "sqlite", "path": "nowhere/run.db"})"), "there is no folder \"nowhere\": make it first"},
        {sinks(R"({"type": "sqlite", "path": "/dev/null"})"), "\"/dev/null\" is not a regular file"},
        {sinks(R"({"type": "file", "path": "x.csv", "from": "beginning"})"), "it has no effect without `through`"},
        {sinks(R"({"type": "sqlite", "path": "text.txt"})"), "it is not an SQLite file"},
        {sinks(R"({"type": "file", "path": "recorded.db"})"), "it is a recording, or another SQLite database"},
        {sinks(R"({"type": "file", "path": "recorded.db", "format": "csv"})"), "it is a recording, or another SQLite"},
        {sinks(R"({"type": "file", "path": "recorded-{topic}.csv", "format": "csv"})"),
         "it is a recording, or another SQLite database"},
        {sinks(R"({"type": "file", "path": "recorded-{topic}.csv"})"), "it is a recording, or another SQLite database"},
        {sinks(R"({"type": "file", "path": "open.db"})"), "it is a recording, or another SQLite database"},
        {sinks(R"({"type": "file", "path": "short.txt", "format": "cbor"})"), "its content is not a valid cbor"},
        {sinks(R"({"type": "file", "path": "text.txt", "format": "cbor"})"), "its content is not a valid cbor"},
        {sinks(R"({"type": "file", "path": "text.txt", "format": "raw"})"), "its content is not a valid raw"},
        {sinks(R"({"type": "sqlite", "path": "dangling"})"),
         "there is no folder \"/nope\", to which \"dangling\" is a symbolic link: make it first"},
        {sinks(R"({"type": "file", "path": "dangling"})"), "there is no folder \"/nope\", to which \"dangling\" is"},
        {sinks(R"({"type": "file", "path": "{topic}/x.csv"})"), "a placeholder is in the name of a folder"},
        {sinks(R"({"type": "file", "path": "other.csv", "format": "csv", "rotate": {"time": "1 d"}})"),
         "its header is \"time,origin,sequence,speed\""},
        {sinks(R"({"type": "file", "path": "bad.json"})"), "this is the configuration; choose another file"},
        {sinks(R"({"type": "file", "path": "x"}, {"type": "sqlite", "path": "./folder/../x"})"),
         "writes \"x\" already"},
        {R"({"log": {"file": "run.db"}, "sensors": [)" + load +
             R"(], "sinks": [{"type": "sqlite", "path": "./run.db"}]})",
         "two writers on one file destroy it; choose another for the log"},
        {sinks(R"({"type": "sqlite", "path": "bad.log"})"), "the log would be \"bad.log\": the sink at "},
        // The files beside those that are written.
        {sinks(beside("sqlite", "x.db", "file", "x.db-wal")), "\"x.db-wal\" is a file that the sink at "},
        {sinks(beside("file", "x.db-wal", "sqlite", "x.db")), "would be taken for a file beside \"x.db\""},
        {sinks(beside("sqlite", "x.db", "file", "./x.db-shm")), "keeps beside \"x.db\"; choose another"},
        {sinks(beside("sqlite", "x.db", "sqlite", "x.db-lock")), "\"x.db-lock\" is a file that the sink at "},
        {sinks(beside("sqlite", "x.db", "file", "x.db-journal")), "\"x.db-journal\" is a file that the sink at "},
        {sinks(beside("file", "x.csv", "sqlite", "x.csv.half")), "\"x.csv.half\" is a file that the sink at "},
        {sinks(R"({"type": "file", "path": "r.csv", "rotate": {"time": "1 h"}, "keep": 1},
                  {"type": "sqlite", "path": "r-00000001.csv"})"),
         "\"r-00000001.csv\" is a file that the sink at "},
        {sinks(R"({"type": "file", "path": "{topic}.db-wal"}, {"type": "sqlite", "path": "a.db"})"),
         "the events of topic \"a\" go to \"a.db-wal\": \"a.db-wal\" is a file that "},
        {sinks(beside("file", "x", "file", "x-link")), "writes \"x\" already"},
        {sinks(beside("sqlite", "link.db", "file", "nothing.db-wal")),
         "\"nothing.db-wal\" is a file that the sink at "},
        {sinks(beside("sqlite", "link.db", "file", "link.db-lock")), "\"link.db-lock\" is a file that the sink at "},
        {sinks(beside("file", "hard1", "file", "hard2")), "writes \"hard1\" already"},
        {sinks(beside("sqlite", "h.db", "file", "hard-wal")), "\"hard-wal\" is a file that the sink at "},
        {R"({"log": {"file": "a.log", "max_bytes": 4096}, "sensors": [)" + load +
             R"(], "sinks": [{"type": "file", "path": "a.log.1"}]})",
         "\"a.log.1\", which the sink at "},
        {sinks(R"({"type": "file", "path": "bad.log.5"})"), "\"bad.log.5\", which the sink at "},
        {R"({"log": {"file": "x.db-wal"}, "sensors": [)" + load +
             R"(], "sinks": [{"type": "sqlite", "path": "x.db"}]})",
         "\"x.db-wal\" is a file that the sink at "},
        {R"({"log": {"file": "hard2"}, "sensors": [)" + load + R"(], "sinks": [{"type": "file", "path": "hard1"}]})",
         "two writers on one file destroy it"},
#ifdef RTDATA_WITH_POSTGRESQL
        {sinks(R"({"type": "postgresql", "url": "postgresql://127.0.0.1/b?gssencmode=zz"})"), "gssencmode"},
        {sinks(R"({"type": "postgresql", "url": "postgresql://127.0.0.1/b?target_session_attrs=zz"})"),
         "target_session_attrs"},
        {sinks(R"({"type": "postgresql", "url": "postgresql://127.0.0.1/b?keepalives=zz"})"),
         "`keepalives` is a whole number, not \"zz\""},
#endif
        // Paths that are none.
        {sinks(R"({"type": "sqlite", "path": ":memory:"})"), "to SQLite this is not a path of a file"},
        {sinks(R"({"type": "sqlite", "path": "file:x.db?mode=memory"})"), "to SQLite this is not a path of a file"},
        {sinks(R"({"type": "sqlite", "path": "/proc/x.db"})"), "the kernel allows no new file in its folder"},
        {sinks(R"({"type": "file", "path": "/proc/x.csv"})"), "the kernel allows no new file in its folder"},
        {sinks(R"({"type": "sqlite", "path": ")" + std::string(300, 'n') + "\"}"), "its name is longer than 247 bytes"},
        {sinks(R"({"type": "file", "path": ")" + std::string(300, 'n') + "\"}"), "File name too long"},
        {sinks(R"({"type": "sqlite", "path": ")" + std::string(248, 'n') + "\"}"), "its name is longer than 247 bytes"},
        {R"({"sensors": [{"name": ")" + std::string(60, 't') +
             R"(", "type": "host", "quantity": "load", "rate": "1 Hz"}], "sinks": [{"type": "file", "path": "{topic})" +
             std::string(200, 'n') + "\"}]}",
         "the name of its file is too long"},
        {serial(R"(, "comment": ",")"), "comment: comments would begin with the separator"},
        {sinks(R"({"type": "sqlite", "path": "./)" + std::string(200, 'm') + "/" + std::string(200, 'n') + "/" +
               std::string(200, 'o') + "\"}"),
         "it is longer, with its folders, than 504 bytes"},
        // Marks that are among what they divide.
        {serial(R"(, "separator": "\"")"), "separator: this character has another meaning in CSV"},
        {serial(R"(, "separator": "\n")"), "separator: this character has another meaning in CSV"},
        {serial(R"(, "separator": "1")"), "separator: numbers may contain this character"},
        {serial(R"(, "separator": "-")"), "separator: numbers may contain this character"},
        {serial(R"(, "separator": ".")"), "separator: numbers may contain this character"},
        {serial(R"(, "separator": "#")"), "comments would begin with the separator"},
        {serial(R"(, "comment": "1")"), "comment: lines of data may begin with it"},
        {serial(R"(, "comment": "-")"), "comment: lines of data may begin with it"},
        {serial(R"(, "comment": "\"")"), "comment: lines of data may begin with it"},
        {serial(R"(, "comment": "n")"), "comment: lines of data may begin with it"},
        {serial(R"(, "comment": "I")"), "comment: lines of data may begin with it"},
        {serial(R"(, "comment": "-inf")"), "comment: lines of data may begin with it"},
        {serial(R"(, "comment": "2.5e-")"), "comment: lines of data may begin with it"},
        {R"({"sensors": [{"name": "a", "type": "serial", "device": "/dev/null", "fields": [{"name": "x", "type": "bool"}], "comment": "t"}]})",
         "comment: lines of data may begin with it"},
        {serial(R"(, "separator": "n")"), "separator: numbers may contain this character"},
        {serial(R"(, "comment": "\n")"), "comment: it contains a line end"},
        {serial(R"(, "comment": " ")"), "comment: lines of data may begin with a blank"},
        {serial(R"(, "format": "json", "comment": "{")"), "comment: each JSON object begins with {"},
        {R"({"sensors": [{"name": "a", "type": "serial", "device": "/dev/null", "fields": [{"name": "x", "scale": 0}]}]})",
         "scale: it must not be 0"},
        {R"({"sensors": [{"name": "a", "type": "analog", "rate": "1 Hz", "file": "x", "scale": 0}]})",
         "scale: it must not be 0"},
        {R"({"buses": {"spi0": {"type": "spi", "device": "/no/such/controller"}},
             "sensors": [{"name": "a", "type": "lm75", "bus": "spi0", "rate": "1 Hz"}]})",
         "is of type spi; this needs i2c"},
        {R"({"buses": {"i2c1": {"type": "i2c", "device": "/no/such/adapter"}},
             "sensors": [{"name": "a", "type": "mcp3x08", "bus": "i2c1", "rate": "1 Hz"}]})",
         "is of type i2c; this needs spi"},
        {on_i2c("50 ms", R"("type": "imu")"), "gives up after 50 ms, and this chip needs more than 135 ms at a time"},
        {on_i2c("300 ms", R"("type": "imu", "self_test": true)"), "this chip needs more than 580 ms at a time"},
        {on_i2c("100 ms", R"("type": "accelerometer", "self_test": true)"), "give the bus a longer `timeout`"},
        {on_i2c("20 ms", R"("type": "bno055")"), "this chip needs more than 26 ms at a time"},
        {on_i2c("5 ms", R"("type": "barometer", "model": "ms5611", "temperature_oversampling": 4096)"),
         "this chip needs more than 9.04 ms at a time"},
        {on_i2c("1 s", R"("type": "barometer", "humidity_oversampling": 2)"), "the BMP280 measures no humidity"},
        {on_i2c("1 s", R"("type": "imu", "model": "lsm6dso", "bandwidth": 42)"), "the LSM6DSO has no such setting"},
        {R"({"sensors": [{"name": "a", "type": "iio_buffer", "device": "3", "channels": ["accel_x"]},
                         {"name": "b", "type": "iio_buffer", "device": "/dev/iio:device3", "channels": ["accel_y"]}]})",
         "has the buffer of the IIO device iio:device3 already; list the channels of both in one"},
        {serial(R"(, "retry_first": "2 s", "retry_longest": "1 s")"), "must not be shorter than `retry_first` (2 s)"},
        {sinks(R"({"type": "sqlite", "path": "x.db", "retry_first": "2 s", "retry_longest": "1 s"})"),
         "it must not be shorter"},
        {R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "1 Hz"},
                         {"name": "b", "type": "host", "quantity": "load", "rate": "1 Hz"},
                         {"name": "c", "type": "host", "quantity": "load", "rate": "1 Hz"},
                         {"name": "d", "type": "host", "quantity": "load", "rate": "1 Hz"}],
             "sinks": [{"type": "file", "path": "all.csv"}]})",
         "cannot record topic b (and 2 more): all.csv: a file has the columns of one topic"},
        {process(R"("minutes_1": {"filters": [{"type": "throttle", "time": "1 s", "by": 3}]})"),
         "a filter of this type has no such setting"},
        {process(R"("minutes_1": {"filters": [{"type": "median", "of": 3, "weight": 0.5}]})"),
         "a filter of this type has no such setting"},
        {process(R"("minutes_1": {"calibration": {"scale": 2, "outside": "clamp"}})"),
         "there is no table that a value could be outside of"},
        {process(R"("minutes_1": {"calibration": {"scale": 2, "outside": "extend"}})"),
         "there is no table that a value could be outside of"},
#ifdef RTDATA_WITH_MODBUS
        {R"({"buses": {"plc": {"type": "modbus", "device": "/dev/ttyS9", "character_size": 7}}, "sensors": [)" + load +
             "]}",
         "Modbus RTU needs 8 bits per character, not 7"},
#endif
        {process(R"("minuts_1": {"calibration": {"scale": 2}})"), "no such field; did you mean minutes_1?"},
        {process(R"("minutes_1": {"filters": [{"type": "median", "of": 4}]})"),
         "4 samples are not possible, for a median"},
        {process(R"("minutes_1": {"calibration": {"table": [[1, 0], [0, 1]]}})"),
         "the table is not in ascending order here"},
        {process(R"("minutes_1": {"filters": [{"type": "throtle"}]})"), "(did you mean \"throttle\"?)"},
        {R"({"log": {"file": "bad.json"}, "sensors": [)" + load + "]}", "this is the configuration"},
        {sinks(R"({"type": "sqlite", "path": {"env": "RTDATA_TEST_NO_SUCH_VARIABLE"}})"),
         "there is no variable RTDATA_TEST_NO_SUCH_VARIABLE in the environment"},
        {sinks(R"({"type": "sqlite", "path": {"file": "nothing.txt"}})"), "cannot read the secret from nothing.txt"},
        {R"({"notes": {"env": "HOME"}, "sensors": [)" + load + "]}", "recordings hold this text"},
        {sinks(R"({"type": "console", "topics": ["a//b"]})"), "\"a//b\" is not a topic or pattern"},
        {R"({"tiers": {"t": {"policy": "fifo"}}, "sensors": [)" + load + "]}", "needs a `priority` from 1 to 99"},
    };
    for (const Mistake& mistake : mistakes) {
      CAPTURE(mistake.text);
      folder.write("bad.json", mistake.text);
      std::filesystem::remove(folder.path() + "/bad.log");
      Process check(folder, rtdata::test::built("rtdata"), {"check", "bad.json"});
      CHECK(check.end() == 2);
      CHECK_MESSAGE(has(check.out, mistake.words), check.out);
      Process run(folder, rtdata::test::built("rtdata"), {"run", "bad.json", "--for", "1ms"});
      CHECK(run.end() == 2);
      CHECK_MESSAGE(has(run.err, mistake.words), run.err);
      CHECK(folder.read("bad.json") == mistake.text);
    }
  }

  TEST_CASE("NFR-5 a log that would go into the configuration or a recording is refused on the command line too") {
    const Folder folder;
    const std::string text = R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "1 Hz"}],
                                 "sinks": [{"type": "sqlite", "path": "run.db"}]})";
    folder.write("good.json", text);
    for (const char* log : {"run.db", "run.db-wal", "good.json"}) {
      Process run(folder, rtdata::test::built("rtdata"), {"run", "good.json", "--for", "1ms", "--log", log});
      CHECK(run.end() == 2);
      CHECK(folder.read("good.json") == text);
      CHECK_FALSE(folder.has("run.db"));
    }
  }

  TEST_CASE("NFR-5 warnings say what has no effect, and what is not what it seems") {
    const auto warnings = [](const std::string& text) {
      const SystemPlan plan = planned(text);
      CHECK_MESSAGE(plan.good(), plan.report());
      return plan.warnings.text();
    };
    const std::string sinks = R"(, "sinks": [{"type": "console"}]})";
    const auto analog = [&](const std::string& more) {
      return R"({"sensors": [{"name": "a", "type": "analog", "rate": "1 Hz", "file": "x")" + more + "}]" + sinks;
    };
    CHECK(warnings(analog(R"(, "unit": "bar")")).empty());
    CHECK(has(warnings(analog(R"(, "unit": "degC")")),
              "\"degC\" is not a unit of UCUM (ucum.org) (did you mean \"Cel\"?)"));
    CHECK(has(warnings(analog(R"(, "unit": "m/s^2")")), "(did you mean \"m/s2\"?)"));
    const auto serial = [&](const std::string& field, const std::string& more) {
      return R"({"sensors": [{"name": "a", "type": "serial", "device": "/dev/null", "fields": [)" + field + "]" + more +
             "}]" + sinks;
    };
    CHECK(warnings(serial(R"({"name": "x", "unit": "V", "scale": 2})", R"(, "separator": ";")")).empty());
    CHECK(has(warnings(serial(R"({"name": "x", "unit": "Volts"})", "")),
              "sensors[0].fields[0].unit: \"Volts\" is not a unit"));
    // What is a temperature by its name.
    CHECK(has(warnings(serial(R"({"name": "temperature", "unit": "C"})", "")),
              "sensors[0].fields: the unit C of temperature is the coulomb; degrees are Cel [unlikely-unit]\n"));
    CHECK(has(warnings(analog(R"(, "unit": "F", "topic": "oven/Temp")")),
              "sensors[0].unit: the unit F of value is the farad; degrees are [degF] [unlikely-unit]\n"));
    CHECK(warnings(serial(R"({"name": "charge", "unit": "C"}, {"name": "temperature", "unit": "Cel"})", "")).empty());
    CHECK(has(warnings(serial(R"({"name": "x", "length": 9})", "")),
              "sensors[0].fields[0].length: it has no effect with `type` double, only with text"));
    CHECK(has(warnings(serial(R"({"name": "x"})", R"(, "format": "json", "separator": ";")")),
              "sensors[0].separator: it has no effect with `format` json, only with csv"));
    CHECK(has(
        warnings(R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "1 Hz", "device": "sda"}])" +
                 sinks),
        "sensors[0].device: it has no effect with `quantity` load"));
    const std::string load = R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "1 Hz"}])";
    CHECK(has(warnings(load + "}"), "there are no sinks"));
    CHECK(has(warnings(load + R"(, "sinks": [{"type": "console", "topics": []}]})"),
              "sinks[0].topics: the list is empty: nothing goes to this sink"));
    const auto file = [&](const std::string& type, const std::string& path) {
      return R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "1 Hz"}], "sinks": [{"type": ")" +
             type + R"(", "path": "/tmp/)" + path + "\"}]}";
    };
    CHECK(warnings(file("file", "a-{topic}.jsonl")).empty());
    CHECK(has(warnings(file("file", "a-{topci}.jsonl")), "{topci} has no meaning here, and stays in the file's name"));
    CHECK(has(warnings(file("file", "a-{topci}.jsonl")), "(did you mean \"{topic}\"?)"));
    CHECK(has(warnings(file("sqlite", "a-{topic}.db")), "{topic} has no meaning here"));
  }

  TEST_CASE("NFR-4 warnings of load are worth reading") {
    std::string sensors = R"({"name": "fast", "type": "host", "quantity": "process", "rate": "1 kHz"})";
    for (int i = 0; i < 60; ++i)
      sensors += R"(, {"name": "adc)" + std::to_string(i) +
                 R"(", "type": "analog", "rate": "50 Hz", "file": "/sys/none)" + std::to_string(i) +
                 R"(/in_voltage0_raw"})";
    const SystemPlan light = planned(R"({"sensors": [)" + sensors + R"(], "sinks": [{"type": "console"}]})");
    CHECK_MESSAGE(light.warnings.empty(), light.warnings.text());
    REQUIRE(light.loads().size() == 1);
    CHECK(light.loads()[0].share() < 0.3);
    std::string together = R"({"name": "fast", "type": "host", "quantity": "process", "rate": "1 kHz"})";
    for (int i = 0; i < 60; ++i)
      together += R"(, {"name": "h)" + std::to_string(i) + R"(", "type": "host", "quantity": "load", "rate": "50 Hz"})";
    const SystemPlan bursts = planned(R"({"sensors": [)" + together + R"(], "sinks": [{"type": "console"}]})");
    REQUIRE(bursts.warnings.size() == 1);
    CHECK(bursts.warnings[0].id == "late-readings");
    const SystemPlan busy = planned(
        R"({"sensors": [{"name": "fast", "type": "host", "quantity": "process", "rate": "1 kHz",
                                        "read_time": "900 us"}], "sinks": [{"type": "console"}]})");
    REQUIRE(busy.warnings.size() == 1);
    CHECK(busy.warnings[0].id == "overloaded-loop");
  }
}
