// One member of a configuration's text is changed; comments, order and layout stay.
#include <doctest/doctest.h>

#include <string>

#include "rtdata/config/format.hpp"
#include "rtdata/data/config_value.hpp"

using namespace rtdata;

namespace {

/// With a member of "a" set; what is made must read as the same tree with that member.
std::string with(const std::string& text, const char* key, const char* value) {
  const ConfigDocument document = parse_config(text, "f.json");
  REQUIRE_MESSAGE(document.good(), document.report());
  const ConfigItem wanted = parse_config(value).root;
  const std::string changed = with_member(document, document.root.at("a"), key, wanted);
  ConfigItem expected = document.root;
  expected.at("a").set(key, wanted);
  const ConfigDocument after = parse_config(changed, "f.json");
  CHECK_MESSAGE(after.good(), after.report());
  CHECK(after.root == expected);
  return changed;
}

std::string without(const std::string& text, const char* key) {
  const ConfigDocument document = parse_config(text, "f.json");
  REQUIRE_MESSAGE(document.good(), document.report());
  const std::string changed = without_member(document, document.root.at("a"), key);
  ConfigItem expected = document.root;
  expected.at("a").remove(key);
  const ConfigDocument after = parse_config(changed, "f.json");
  CHECK_MESSAGE(after.good(), after.report());
  CHECK(after.root == expected);
  return changed;
}

}  // namespace

TEST_SUITE("config") {
  TEST_CASE("US-17 a member is set in the text of a configuration, and all else stays") {
    CHECK(with(R"({"a": {"x": 1, "p": [1, {"y": "}"}], /* c */ "y": 2}})", "p", "[[1, 2.5]]") ==
          R"({"a": {"x": 1, "p": [[1, 2.5]], /* c */ "y": 2}})");
    CHECK(with(R"({"a": {}})", "p", "7") == R"({"a": {"p": 7}})");
    CHECK(with(R"({"a": {"x": 1}})", "p", R"({"q": 7})") == R"({"a": {"x": 1, "p": {"q": 7}}})");
    CHECK(with("{\n  // head\n  \"a\": {\n    \"x\": 1,  // of x\n    \"y\": 2  // of y\n  }\n}\n", "p", "7") ==
          "{\n  // head\n  \"a\": {\n    \"x\": 1,  // of x\n    \"y\": 2,  // of y\n    \"p\": 7\n  }\n}\n");
    CHECK(with("{\r\n  \"a\": {\r\n    \"\xc3\xbc\": \"\xc3\xbc,}\" /* z */\r\n  }\r\n}\r\n", "p", "7") ==
          "{\r\n  \"a\": {\r\n    \"\xc3\xbc\": \"\xc3\xbc,}\", /* z */\r\n    \"p\": 7\r\n  }\r\n}\r\n");
    CHECK(with("\xef\xbb\xbf{\"a\": {\"x\": 1 // one\n}}", "p", "7") ==
          "\xef\xbb\xbf{\"a\": {\"x\": 1, \"p\": 7 // one\n}}");
    CHECK(with("{\"a\": {\n\"x\": 1 /* begins\n and ends */}}", "p", "7") ==
          "{\"a\": {\n\"x\": 1,\n\"p\": 7 /* begins\n and ends */}}");
    CHECK(with(R"({"a": { // nothing
}})",
               R"(q"u\o)", "7") == R"({"a": {"q\"u\\o": 7 // nothing
}})");
  }

  TEST_CASE("US-17 a member is taken out of the text of a configuration, and comments stay") {
    CHECK(without(R"({"a": {"x": 1, "p": [1, [2]], "y": 2}})", "p") == R"({"a": {"x": 1, "y": 2}})");
    CHECK(without(R"({"a": {"x": 1, "p": 2}})", "p") == R"({"a": {"x": 1}})");
    CHECK(without(R"({"a": {"p": 2}})", "p") == R"({"a": {}})");
    CHECK(without(R"({"a": {"x": 2}})", "p") == R"({"a": {"x": 2}})");
    CHECK(without("{\"a\": {\n  \"x\": 1,\n  \"p\": 2,\n  \"y\": 3\n}}", "p") ==
          "{\"a\": {\n  \"x\": 1,\n  \"y\": 3\n}}");
    CHECK(without("{\"a\": {\n  \"x\": 1,  // of x\n  // about p\n  \"p\": {\n    \"z\": 1\n  }\n}}", "p") ==
          "{\"a\": {\n  \"x\": 1  // of x\n  // about p\n}}");
    CHECK(without("{\"a\": {\n  \"p\": 1 /* of p */, // more\n  \"y\": 3}}", "p") ==
          "{\"a\": {\n  /* of p */ // more\n  \"y\": 3}}");
  }

  TEST_CASE("US-17 whatever the layout, a changed text reads as the changed tree") {
    const char* const blanks[] = {"", " ", "\n  ", " // c\n", "/* } , \" */", "\r\n\t"};
    for (const std::string first : blanks)
      for (const std::string second : blanks)
        for (const std::string third : blanks) {
          const std::string text = "{" + first + "\"a\":" + second + "{" + third + "\"x\"" + first + ":" + second +
                                   "1" + third + "," + first + "\"p\":" + first + "[1,\"]\"]" + second + "}" + third +
                                   "}";
          CAPTURE(text);
          with(text, "p", "7");
          with(text, "q", "[7]");
          without(text, "p");
          without(text, "x");
        }
  }
}
