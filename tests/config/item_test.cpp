#include "rtdata/data/config_item.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <deque>
#include <list>
#include <map>
#include <unordered_map>

#include "rtdata/config/format.hpp"

using namespace rtdata;
using namespace rtdata::literals;

namespace {

ConfigItem parse(std::string_view text) { return parse_config(text, "t.json").or_throw(); }

/// The text of the one problem that reading this item as T has.
template <class T>
std::string mistake(const ConfigItem& item) {
  try {
    (void)item.get<T>();
  } catch (const ConfigError& error) {
    return error.problems()[0].text();
  }
  return "none";
}

}  // namespace

TEST_SUITE("config") {
  TEST_CASE("US-19 every JSON type is read, with its kind") {
    const ConfigItem root = parse(R"({"n": null, "b": true, "i": -3, "u": 18446744073709551615, "d": 3.0, "e": 1e3,
                                      "s": "a\u00e9\n", "a": [1, "x", []], "o": {"k": {}}})");
    using Kind = ConfigItem::Kind;
    CHECK(root.kind() == Kind::object);
    CHECK(root.at("n").kind() == Kind::null);
    CHECK(root.at("b").kind() == Kind::boolean);
    CHECK(root.at("i").kind() == Kind::integer);
    CHECK(root.at("u").kind() == Kind::integer);
    CHECK(root.at("d").kind() == Kind::number);
    CHECK(root.at("e").kind() == Kind::number);
    CHECK(root.at("s").kind() == Kind::string);
    CHECK(root.at("a").kind() == Kind::array);
    CHECK(root.at("o").kind() == Kind::object);
    CHECK(root.at("s").get<std::string>() == "a\xc3\xa9\n");
    CHECK(root.at("u").get<std::uint64_t>() == 18446744073709551615u);
    CHECK(root.keys() == std::vector<std::string>{"n", "b", "i", "u", "d", "e", "s", "a", "o"});
  }

  TEST_CASE("US-20 children are reached by keys, indexes and paths") {
    const ConfigItem root = parse(
        R"({"sensors": [{}, {"rate": 5}, {"rate": 7, "a.b": [[1, 2]]}], "x/y": {"z": true}})");
    CHECK(root.at("sensors", 2, "rate").get<int>() == 7);
    CHECK(root.at("sensors[2].rate").get<int>() == 7);
    CHECK(root.at("sensors", "[1].rate").get<int>() == 5);
    CHECK(root.at("x/y.z").get<bool>());
    CHECK(root.at("sensors[2][\"a.b\"][0][1]").get<int>() == 2);
    CHECK(root.at("sensors", 2, "a.b", 0, 1).path() == "sensors[2][\"a.b\"][0][1]");
    CHECK(root.at(root.at("sensors", 2, "a.b", 0, 1).path()).get<int>() == 2);
    for (const char* nothing :
         {"", ".", "[", "[]", "[0]", "sensors.", "sensors[", "sensors[x]", "sensors[3]", "sensors[-1]",
          "sensors[99999999999999999999]", "sensors[2]rate", "sensors[2].", ".sensors", "x/y[0]", "[\"",
          "sensors..rate", "sensors[2].rate.x", "sensors[2].rate[0]"})
      CHECK_MESSAGE(root.find(nothing) == nullptr, nothing);
    CHECK(root.find(1)->path() == "x/y");
    CHECK(root.find(2) == nullptr);
  }

  TEST_CASE("US-20 what is not there is an error with its place and the nearest name") {
    const ConfigItem root = parse("{\n  \"sensors\": [{\"rate\": 5}]\n}");
    CHECK_THROWS_WITH_AS(
        (void)root.at("sensors", 0, "rtae"),
        "there is no \"rtae\" in an object: t.json:2:15: sensors[0]: did you mean \"rate\"? [bad-configuration]",
        ConfigError);
    CHECK_THROWS_WITH_AS((void)root.at("sensors", 3),
                         "there is no element 3 in a list of 1: t.json:2:14: sensors [bad-configuration]", ConfigError);
    CHECK_THROWS_WITH_AS((void)root.at("sensors", -1),
                         "there is no element -1 in a list of 1: t.json:2:14: sensors [bad-configuration]",
                         ConfigError);
  }

  TEST_CASE("US-20 children are iterated with their keys, in the order of the file") {
    const ConfigItem root = parse(R"({"z": 1, "a": 2, "list": ["x", "y"]})");
    std::string seen;
    for (const auto& [key, item] : root.children())
      seen += key + "=" + item.to_json(ConfigItem::Layout::one_line) + ";";
    for (const auto& [key, item] : root.at("list").children()) seen += key + item.get<std::string>();
    CHECK(seen == "z=1;a=2;list=[\"x\", \"y\"];xy");
    CHECK(root.at("z").children().empty());
    CHECK(root.at("list").size() == 2);
  }

  TEST_CASE("US-20 a value is had as every standard type") {
    const ConfigItem root = parse(R"({"b": true, "i": -100, "u": 200, "whole": 3.0, "thousand": 1e3, "d": 0.1, "c": "x",
      "s": "text", "list": [1, 2, 3], "flags": [true, false], "map": {"a": 1, "b": 2}, "n": null, "chars": ["a", "b"],
      "nested": {"x": [[1.5], []]}, "t": "1.5 s", "r": "2 kHz", "maybe": [1, null]})");
    CHECK(root.at("b").get<bool>());
    CHECK(root.at("i").get<std::int8_t>() == -100);
    CHECK(root.at("i").get<std::int16_t>() == -100);
    CHECK(root.at("i").get<int>() == -100);
    CHECK(root.at("i").get<long>() == -100);
    CHECK(root.at("i").get<long long>() == -100);
    CHECK(root.at("u").get<unsigned char>() == 200);
    CHECK(root.at("u").get<std::uint16_t>() == 200);
    CHECK(root.at("u").get<unsigned>() == 200);
    CHECK(root.at("u").get<std::size_t>() == 200);
    CHECK(root.at("whole").get<int>() == 3);
    CHECK(root.at("thousand").get<std::uint16_t>() == 1000);
    CHECK(root.at("d").get<double>() == 0.1);
    CHECK(root.at("d").get<float>() == 0.1f);
    CHECK(root.at("i").get<double>() == -100.0);
    CHECK(root.at("c").get<char>() == 'x');
    CHECK(root.at("s").get<std::string>() == "text");
    CHECK(root.at("s").get<std::string_view>() == "text");
    CHECK(root.at("list").get<std::array<int, 3>>() == std::array{1, 2, 3});
    CHECK(root.at("list").get<std::vector<double>>() == std::vector{1.0, 2.0, 3.0});
    CHECK(root.at("list").get<std::deque<int>>() == std::deque{1, 2, 3});
    CHECK(root.at("list").get<std::list<long>>() == std::list{1L, 2L, 3L});
    CHECK(root.at("flags").get<std::vector<bool>>() == std::vector{true, false});
    CHECK(root.at("chars").get<std::array<char, 2>>() == std::array{'a', 'b'});
    CHECK(root.at("map").get<std::map<std::string, int>>() == std::map<std::string, int>{{"a", 1}, {"b", 2}});
    CHECK(root.at("map").get<std::unordered_map<std::string, double>>().at("b") == 2.0);
    CHECK(root.at("n").get<std::optional<int>>() == std::nullopt);
    CHECK(root.at("u").get<std::optional<int>>() == 200);
    CHECK(root.at("maybe").get<std::vector<std::optional<int>>>() == std::vector<std::optional<int>>{1, std::nullopt});
    CHECK(root.at("nested").get<std::map<std::string, std::vector<std::vector<float>>>>().at("x")[0][0] == 1.5f);
    CHECK(root.at("t").get<Duration>() == 1500ms);
    CHECK(root.at("t").get<std::chrono::milliseconds>() == 1500ms);
    CHECK(root.at("t").get<std::chrono::duration<double>>().count() == 1.5);
    CHECK(root.at("r").get<Rate>() == 2_kHz);
    CHECK(root.at("nested").get<ConfigItem>() == root.at("nested"));
    CHECK(root.value_or("u", 5) == 200);
    CHECK(root.value_or("v", 5) == 5);
    CHECK(root.value_or("nested.y", std::string("none")) == "none");
    CHECK(root.at("u").try_get<int>().value() == 200);
    CHECK(root.at("s").try_get<int>().error().code == Errc::bad_configuration);
  }

  TEST_CASE("US-20 nothing is narrowed in silence, and the error has place and path") {
    const ConfigItem root = parse(
        "{\"a\": {\n  \"half\": 3.7, \"big\": 1e10, \"yes\": true, \"b300\": 300, \"minus\": -1,\n"
        "  \"huge\": 18446744073709551616, \"s\": \"12\", \"n\": null, \"u\": 18446744073709551615,\n"
        "  \"list\": [1, \"x\", 2.5], \"t\": \"1500 us\", \"odd\": 9007199254740993}}");
    const ConfigItem& a = root.at("a");
    CHECK(mistake<int>(a.at("half")) == "t.json:2:11: a.half: expected a whole number, got the number 3.7");
    CHECK(mistake<std::int32_t>(a.at("big")) == "t.json:2:23: a.big: 1e10 is out of range: -2147483648 to 2147483647");
    CHECK(a.at("big").get<std::int64_t>() == 10000000000);
    CHECK(mistake<int>(a.at("yes")) == "t.json:2:36: a.yes: expected a whole number, got true");
    CHECK(mistake<double>(a.at("yes")) == "t.json:2:36: a.yes: expected a number, got true");
    CHECK(mistake<std::uint8_t>(a.at("b300")) == "t.json:2:50: a.b300: 300 is out of range: 0 to 255");
    CHECK(mistake<unsigned>(a.at("minus")) == "t.json:2:64: a.minus: -1 is out of range: 0 to 4294967295");
    CHECK(mistake<std::uint64_t>(a.at("huge")) ==
          "t.json:3:11: a.huge: 18446744073709551616 is out of range: 0 to 18446744073709551615");
    CHECK(mistake<std::int64_t>(a.at("u")) ==
          "t.json:3:60: a.u: 18446744073709551615 is out of range: -9223372036854775808 to 9223372036854775807");
    CHECK(mistake<int>(a.at("s")) == "t.json:3:38: a.s: expected a whole number, got the string \"12\"");
    CHECK(mistake<bool>(a.at("s")) == "t.json:3:38: a.s: expected true or false, got the string \"12\"");
    CHECK(mistake<char>(a.at("s")) == "t.json:3:38: a.s: expected a string of one character, got the string \"12\"");
    CHECK(mistake<std::string>(a.at("n")) == "t.json:3:49: a.n: expected a string, got null");
    CHECK(mistake<std::vector<int>>(a.at("n")) == "t.json:3:49: a.n: expected a list, got null");
    CHECK(mistake<std::map<std::string, int>>(a.at("list")) == "t.json:4:11: a.list: expected an object, got a list");
    CHECK(mistake<std::array<double, 2>>(a.at("list")) == "t.json:4:11: a.list: expected a list of 2, got one of 3");
    CHECK(mistake<std::chrono::milliseconds>(a.at("t")) ==
          "t.json:4:31: a.t: the string \"1500 us\" is finer or longer than the type of this value keeps");
    CHECK(mistake<double>(a.at("odd")) ==
          "t.json:4:49: a.odd: 9007199254740993 has more digits than the type of this value keeps");
    CHECK(mistake<float>(ConfigItem::of(1e39)) == "1e+39 is out of range: -3.4e38 to 3.4e38");
    CHECK(mistake<Duration>(a.at("b300")) ==
          "t.json:2:50: a.b300: expected a duration with its unit, such as \"10 ms\", got the number 300");
    CHECK(mistake<Rate>(a.at("b300")) ==
          "t.json:2:50: a.b300: expected a rate with its unit, such as \"100 Hz\", got the number 300");
    CHECK(mistake<Duration>(a.at("s")).starts_with(
        "t.json:3:38: a.s: the string \"12\" is not a duration: it has no unit"));
    CHECK(mistake<Rate>(a.at("s")).starts_with("t.json:3:38: a.s: the string \"12\" is not a rate: it has no unit"));
    CHECK_THROWS_AS((void)root.value_or("a.s", 5), ConfigError);
  }

  TEST_CASE("US-20 every mistake of a list is told") {
    const ConfigItem list = parse("[1, \"x\", 2.5]");
    try {
      (void)list.get<std::vector<int>>();
      FAIL("no error");
    } catch (const ConfigError& error) {
      CHECK(error.problems().text() ==
            "t.json:1:5: [1]: expected a whole number, got the string \"x\" [wrong-type]\n"
            "t.json:1:10: [2]: expected a whole number, got the number 2.5 [wrong-type]\n");
      CHECK(std::string(error.what()) ==
            "expected a whole number, got the string \"x\" (and 1 more): t.json:1:5: [1] [bad-configuration]");
    }
  }

  TEST_CASE("US-21 an item is set to any standard type without side effects") {
    ConfigItem root = parse(R"({"a": {"x": 1, "y": [1, 2]}, "b": "keep"})");
    const ConfigItem before = root;
    ConfigItem& x = root.at("a", "x");
    const auto check_alone = [&](std::string_view json) {
      CHECK(x.to_json(ConfigItem::Layout::one_line) == json);
      CHECK(x.path() == "a.x");
      CHECK(x.place() == ConfigPlace{"t.json", 1, 13});
      CHECK(root.at("a", "y") == before.at("a", "y"));
      CHECK(root.at("b") == before.at("b"));
      CHECK(root.at("a").keys() == before.at("a").keys());
      CHECK(parse(root.to_json()) == root);
    };
    x.set(true);
    check_alone("true");
    x.set(-5);
    check_alone("-5");
    x.set(std::int8_t{-5});
    check_alone("-5");
    x.set(std::uint64_t{18446744073709551615u});
    check_alone("18446744073709551615");
    x.set(2.5);
    check_alone("2.5");
    x.set(3.0);
    check_alone("3.0");
    x.set(0.1f);
    check_alone("0.1");
    x.set('c');
    check_alone("\"c\"");
    x.set("literal");
    check_alone("\"literal\"");
    x.set(std::string("a \"quoted\"\n"));
    check_alone("\"a \\\"quoted\\\"\\n\"");
    x.set(std::string_view("view"));
    check_alone("\"view\"");
    x.set(nullptr);
    check_alone("null");
    x.set(std::optional<int>());
    check_alone("null");
    x.set(std::optional<int>(4));
    check_alone("4");
    x.set(std::array{1, 2});
    check_alone("[1, 2]");
    x.set(std::vector<std::string>{"p", "q"});
    check_alone("[\"p\", \"q\"]");
    x.set(std::vector<bool>{true});
    check_alone("[true]");
    x.set(std::map<std::string, double>{{"k", 0.5}});
    check_alone("{\"k\": 0.5}");
    x.set(250ms);
    check_alone("\"250 ms\"");
    x.set(-Duration(250ms));
    check_alone("\"-250 ms\"");
    x.set(100_Hz);
    check_alone("\"100 Hz\"");
    x.set(root.at("a", "y"));
    check_alone("[1, 2]");
    CHECK(root.at("a", "x", 1).path() == "a.x[1]");
    CHECK(before.at("a.x").get<int>() == 1);
    CHECK_THROWS_AS(x.set(std::nan("")), SetupError);
    check_alone("[1, 2]");
  }

  TEST_CASE("US-21 what is set reads back as the same value") {
    ConfigItem item;
    item.set(1234567890123456789);
    CHECK(item.get<std::int64_t>() == 1234567890123456789);
    item.set(0.1f);
    CHECK(item.get<float>() == 0.1f);
    item.set(1e300);
    CHECK(parse(std::string("[").append(item.to_json()).append("]")).at(0).get<double>() == 1e300);
    item.set(std::vector<Duration>{1ns, 1h});
    CHECK(item.get<std::vector<Duration>>() == std::vector<Duration>{1ns, 1h});
    item.set(-Duration(5ms));
    CHECK(item.get<Duration>() == -5ms);
  }

  TEST_CASE("US-21 children are added and removed, and paths follow") {
    ConfigItem root;
    root.set("name", "bench");
    root.set("rate", 50_Hz);
    root.set("name", "other");
    ConfigItem& sensors = root.at("name");
    CHECK_THROWS_WITH_AS(sensors.set("x", 1),
                         "cannot set \"x\": name: it is the string \"other\", not an object [bad-argument]",
                         SetupError);
    CHECK_THROWS_AS(sensors.push_back(1), SetupError);
    ConfigItem list;
    list.push_back(1);
    list.push_back(ConfigItem::object()).set("deep", 2);
    root.set("list", list);
    CHECK(root.at("list[1].deep").path() == "list[1].deep");
    CHECK(root.at("list").remove(0));
    CHECK(root.at("list[0].deep").path() == "list[0].deep");
    CHECK(list.size() == 2);
    CHECK(root.remove("rate"));
    CHECK_FALSE(root.remove("rate"));
    CHECK_FALSE(root.remove(7));
    CHECK(root.to_json(ConfigItem::Layout::one_line) == R"({"name": "other", "list": [{"deep": 2}]})");
    root.set("self", root);
    CHECK(root.at("self.list[0].deep").path() == "self.list[0].deep");
  }

  TEST_CASE("US-21 a copy keeps its place and path, and is a tree of its own") {
    ConfigItem root = parse("{\"a\":\n {\"b\": [5]}}");
    ConfigItem copy = root.at("a");
    copy.at("b", 0).set(6);
    CHECK(root.at("a.b[0]").get<int>() == 5);
    CHECK(copy.at("b[0]").place().text() == "t.json:2:9");
    CHECK(copy.at("b[0]").path() == "a.b[0]");
    const ConfigItem moved = std::move(root);
    CHECK(moved.at("a.b[0]").get<int>() == 5);
  }

  TEST_CASE("US-22 the tree is written as JSON that reads back equal, numbers as they were written") {
    const std::string text = R"({
  "a": [
    1.50,
    3.0,
    3,
    1e3,
    {},
    []
  ],
  "é\u0001": null
})";
    const ConfigItem root = parse(text);
    CHECK(root.to_json() == text);
    CHECK(parse(root.to_json(ConfigItem::Layout::one_line)) == root);
    CHECK(root != parse("{}"));
    CHECK(parse(R"({"a": 1, "b": 2})") == parse(R"({"b": 2, "a": 1})"));
    CHECK(parse("[1, 2]") != parse("[2, 1]"));
    CHECK(parse("[1]") != parse("[1.0]"));
  }
}
