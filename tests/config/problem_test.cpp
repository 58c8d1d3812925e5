#include "rtdata/data/problem.hpp"

#include <doctest/doctest.h>

using namespace rtdata;

TEST_SUITE("config") {
  TEST_CASE("a problem reads file:line:column: path: message, without its empty parts") {
    const Problem full{"unknown-key", {"a.json", 7, 43}, "sensors[0].rtae", "unknown key", "rate"};
    CHECK(full.text() == "a.json:7:43: sensors[0].rtae: unknown key (did you mean \"rate\"?)");
    CHECK(full.text_with_id() == full.text() + " [unknown-key]");
    CHECK(full.error().text() == "unknown key: a.json:7:43: sensors[0].rtae: did you mean \"rate\"?");
    CHECK(full.error().id() == "bad-configuration");
    CHECK(Problem{"empty", {"a.json", 0, 0}, "", "it is empty", ""}.text() == "a.json: it is empty");
    CHECK(Problem{"wrong-type", {}, "a.b", "no number", ""}.text() == "a.b: no number");
    CHECK(Problem{"wrong-type", {"", 2, 3}, "", "no number", ""}.text() == "line 2:3: no number");
  }

  TEST_CASE("problems are ordered by place, and those of one place stay in order") {
    Problems problems;
    const auto add = [&](std::size_t line, std::size_t column, const char* message) {
      problems.add("x", {"f", line, column}, "", message);
    };
    add(2, 1, "c");
    add(1, 9, "b");
    add(1, 2, "a");
    add(1, 9, "b2");
    problems.sort();
    CHECK(problems.text() == "f:1:2: a [x]\nf:1:9: b [x]\nf:1:9: b2 [x]\nf:2:1: c [x]\n");
  }

  TEST_CASE("the nearest name is found only when it is near") {
    const std::vector<std::string> names{"rate", "name", "type", "span_voltage", "zero_voltage", "quantization_bits",
                                         "baud"};
    CHECK(nearest_name("rtae", names) == "rate");
    CHECK(nearest_name("raet", names) == "rate");
    CHECK(nearest_name("Rate", names) == "rate");
    CHECK(nearest_name("rates", names) == "rate");
    CHECK(nearest_name("ate", names) == "rate");
    CHECK(nearest_name("span-voltage", names) == "span_voltage");
    CHECK(nearest_name("spanvoltage", names) == "span_voltage");
    CHECK(nearest_name("span_volatge", names) == "span_voltage");
    CHECK(nearest_name("quant", names) == "quantization_bits");
    CHECK(nearest_name("baud_rate", names) == "");
    CHECK(nearest_name("xyzzy", names) == "");
    CHECK(nearest_name("r", names) == "");
    CHECK(nearest_name("", names) == "");
    CHECK(nearest_name("rate", {}) == "");
    CHECK(nearest_name(std::string(100000, 'a'), names) == "");
    CHECK(nearest_name("aa", {"bb", "a"}) == "");
  }
}
