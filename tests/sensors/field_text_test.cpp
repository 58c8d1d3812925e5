// What stands around numbers in the lines of devices.
#include <doctest/doctest.h>

#include <string>
#include <string_view>
#include <vector>

#include "has.hpp"
#include "rtdata/data/codec.hpp"
#include "sensors/lines/line_decoder.hpp"

using namespace rtdata;
using rtdata::test::has;

namespace {

/// The values of a line, with blanks between; or "ID: why".
std::string values_of(const LineConfig& config, std::string_view line) {
  detail::LineDecoder decoder(config);
  if (const Result<void> done = decoder.decode(line); !done)
    return std::string(done.error().id()) + ": " + done.error().why;
  const EventView event("line", {}, *decoder.description(), {decoder.payload(), decoder.description()->size()}, "");
  std::string text;
  for (const Leaf& leaf : event.description().leaves())
    text += (text.empty() ? "" : " ") + to_string(event.value(leaf));
  return text;
}

std::string refusal_of(LineField field) {
  field.name = "x";
  try {
    LineConfig config;
    config.fields = {field};
    const detail::LineDecoder decoder(config);
  } catch (const SetupError& error) {
    return error.error().why;
  }
  return "";
}

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-13 text around a number is taken off, field by field") {
    // A scale of A&D: "ST,+  12.345 kg".
    const LineConfig scale{.fields = {{.name = "state", .type = Kind::text, .length = 2},
                                      {.name = "weight", .unit = "kg", .suffix = "kg", .sign_blanks = true}}};
    CHECK(values_of(scale, "ST,+  12.345 kg") == "ST 12.345");
    CHECK(values_of(scale, "US,-   0.5 kg") == "US -0.5");
    CHECK(values_of(scale, "ST,+  12.345 lb") == R"(bad-data: "+  12.345 lb" does not end with its `suffix`)");
    CHECK(has(values_of(scale, "ST,+  kg"), "not-a-number"));
    CHECK(has(values_of(scale, "ST,   kg"), R"("kg" has no number)"));

    const LineConfig german{.fields = {{.name = "t", .prefix = "T=", .decimal = ','},
                                       {.name = "p", .suffix = "Pa", .decimal = ',', .thousands = "."}},
                            .separator = ';'};
    CHECK(values_of(german, "T=-3,25; 101.325,5 Pa") == "-3.25 101325.5");
    CHECK(has(values_of(german, "T=-3.25;1 Pa"), "has a point, but its `decimal` is a comma"));
    CHECK(has(values_of(german, "t=1;1 Pa"), "does not begin with its `prefix`"));
    // Never a number of another size: a point is either the mark of thousands or a mistake.
    CHECK(values_of(german, "T=1;1.234.567,5 Pa") == "1 1234567.5");
    for (const char* const wrong : {"1.23", "12.34.5", "1234.567", ".123", "1.234.", "1..234", "1.2345", "0.5"})
      CHECK(has(values_of(german, "T=1;" + std::string(wrong) + " Pa"), "not before a group of three digits"));

    const LineConfig hex{
        .fields = {{.name = "a", .type = Kind::u16, .base = 16}, {.name = "b", .scale = 0.5, .base = 16}}};
    CHECK(values_of(hex, "ffff,0x10") == "65535 8");
    // Of a signed type the digits are its bytes.
    const LineConfig bytes{.fields = {{.name = "a", .type = Kind::i16, .base = 16},
                                      {.name = "b", .type = Kind::i64, .optional = true, .base = 16}}};
    CHECK(values_of(bytes, "FFEC,ffffffffffffffff") == "-20 -1");
    CHECK(values_of(bytes, "8000,8000000000000000") == "-32768 -9223372036854775808");
    CHECK(values_of(bytes, "7fff,7fffffffffffffff") == "32767 9223372036854775807");
    CHECK(values_of(bytes, "-0014,") == "-20 absent");
    CHECK(has(values_of(bytes, "10000,0"), "out-of-range"));
    CHECK(has(values_of(bytes, "-FFEC,0"), "out-of-range"));
    CHECK(has(values_of(hex, "10000,1"), "out-of-range"));
    CHECK(has(values_of(hex, "-1,1"), "not-a-number"));
    CHECK(has(values_of(hex, "fg,1"), "is not a number in its `base`"));
    CHECK(has(values_of(hex, "0x,1"), "is not a number in its `base`"));
    CHECK(has(values_of(hex, "fffffffffffffffff,1"), "is not a number in its `base`"));
  }

  TEST_CASE("US-13 blanks within the quotes of a number do not count, those of a text do") {
    const LineConfig table{.fields = {{.name = "n", .type = Kind::u32}, {.name = "t", .type = Kind::text}}};
    CHECK(values_of(table, "\"4407 \",\" a \"") == "4407  a ");
    CHECK(values_of(table, "\"   4406 \",b") == "4406 b");
  }

  TEST_CASE("US-13 texts and numbers that stand for no value make a field absent; words stand for numbers") {
    const LineConfig meter{.fields = {{.name = "v", .scale = 1000, .no_value = {"OL", "---", "-9999", "9.9e37"}},
                                      {.name = "on", .type = Kind::u8, .words = {{"ON", 1}, {"OFF", 0}}}}};
    CHECK(values_of(meter, "1.5,ON") == "1500 1");
    for (const char* const none : {"OL", " --- ", "-9999", "-9999.0", "+9.90000000E+37", ""})
      CHECK(values_of(meter, std::string(none) + ",OFF") == "absent 0");
    CHECK(values_of(meter, "-9998,1") == "-9998000 1");
    CHECK(has(values_of(meter, "ol,OFF"), "not-a-number"));
    CHECK(has(values_of(meter, "1,on"), "not-a-number"));
    // A number of words is not scaled; a bool and a text have words and what is none, too.
    CHECK(values_of({.fields = {{.name = "x", .scale = 10, .words = {{"half", 0.5}}}}}, "half") == "0.5");
    CHECK(values_of({.fields = {{.name = "x", .type = Kind::boolean, .words = {{"open", 1}}}}}, "open") == "true");
    CHECK(values_of({.fields = {{.name = "x", .type = Kind::text, .prefix = "<", .suffix = ">", .no_value = {"N/A"}}}},
                    "<abc>") == "abc");
    CHECK(values_of({.fields = {{.name = "x", .type = Kind::text, .no_value = {"N/A"}}}}, "N/A") == "absent");
  }

  TEST_CASE("US-13 the same in JSON, where such a value may be a text or a number") {
    const LineConfig json{.format = LineFormat::json,
                          .fields = {{.name = "w", .suffix = " W", .no_value = {"n/a", "-1"}}, {.name = "plain"}}};
    CHECK(values_of(json, R"({"w": "12.5 W", "plain": 1})") == "12.5 1");
    CHECK(values_of(json, R"({"w": "n/a", "plain": 1})") == "absent 1");
    CHECK(values_of(json, R"({"w": -1, "plain": 1})") == "absent 1");
    CHECK(values_of(json, R"({"plain": 1})") == "absent 1");
    CHECK(has(values_of(json, R"({"w": 3, "plain": 1})"), "suffix"));
    CHECK(has(values_of(json, R"({"w": "3 W", "plain": "1 W"})"), "not-a-number"));
  }

  TEST_CASE("US-13 settings of fields that exclude each other are refused with the reason") {
    CHECK(has(refusal_of({.type = Kind::text, .decimal = ','}), "only numbers have"));
    CHECK(has(refusal_of({.decimal = ';'}), "a point or a comma"));
    CHECK(has(refusal_of({.thousands = "."}), "another meaning"));
    CHECK(has(refusal_of({.thousands = ", "}), "more than one character"));
    CHECK(has(refusal_of({.decimal = ',', .base = 16}), "cannot have `decimal` or `thousands`"));
    CHECK(has(refusal_of({.type = Kind::text, .words = {{"a", 1}}}), "this field is a text"));
    CHECK(has(refusal_of({.type = Kind::u8, .words = {{"a", 0.5}}}), "not a whole number"));
    CHECK(has(refusal_of({.decimal = ','}), "has this character within its numbers"));  // the separator is a comma, too
    CHECK(has(refusal_of({.thousands = ","}), "has this character within its numbers"));
    CHECK(has(refusal_of({.type = Kind::i32, .decimal = ','}), "a whole number cannot have `decimal`"));
    CHECK(refusal_of({.thousands = "'", .no_value = {""}}).empty());
  }

  TEST_CASE("US-13 any bytes in such fields are a value or an error, and allocate nothing that lasts") {
    const LineConfig config{.fields = {{.name = "a",
                                        .prefix = "x",
                                        .suffix = "y",
                                        .decimal = ',',
                                        .thousands = ".",
                                        .sign_blanks = true,
                                        .no_value = {"-", "1,5"}},
                                       {.name = "b", .type = Kind::i8, .base = 16, .words = {{"z", 3}}}},
                            .separator = ';'};
    detail::LineDecoder decoder(config);
    std::uint64_t state = 1;
    constexpr std::string_view alphabet = "xy,.;-+ 0159aFzE\"\0\xff";
    std::size_t good = 0;
    for (int i = 0; i < 50'000; ++i) {
      std::string line = i % 2 == 0 ? "x" : "";
      for (std::uint64_t left = (state = state * 6364136223846793005U + 1442695040888963407U) >> 60; left > 0; --left) {
        state = state * 6364136223846793005U + 1442695040888963407U;
        line += alphabet[(state >> 33) % alphabet.size()];
      }
      good += decoder.decode(i % 3 == 0 ? line + "y;z" : line) ? 1 : 0;
    }
    CHECK(good > 20);
    CHECK(decoder.decode(std::string("x") + std::string(100'000, '1') + "y;1").error().code == Errc::bad_data);
  }
}
