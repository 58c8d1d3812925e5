// Fields that are bytes: of an odd size, some bits of them, within patterns; frames that were stuffed.
#include <doctest/doctest.h>

#include <optional>
#include <string>
#include <vector>

#include "data/hex_bytes.hpp"
#include "has.hpp"
#include "sensors/decoded_line.hpp"
#include "sensors/lines/frame_cutter.hpp"
#include "sensors/lines/line_decoder.hpp"

using namespace rtdata;
using rtdata::test::has;

namespace {

std::string from_hex(const std::string& hex) { return detail::bytes_of_hex(hex).value(); }

std::string refusal_of_bytes(const LineField& field, LineFormat format = LineFormat::binary) {
  try {
    const detail::LineDecoder decoder(
        {.format = format, .fields = {field}, .pattern = "(?<v>.)", .frame = LineFrame{.start = "x", .length = 9}});
  } catch (const SetupError& error) {
    return error.error().where + ": " + error.error().why;
  }
  return "";
}

/// The frames in a stream that comes in pieces, as they were before they were stuffed; "?" for one that is not.
std::vector<std::string> plain_frames(Stuffing stuffing, std::string_view stream, std::size_t piece) {
  detail::FrameCutter cutter({.stuffing = stuffing}, 1000);
  std::vector<std::string> frames;
  std::string buffer;
  for (; !stream.empty(); stream.remove_prefix(std::min(piece, stream.size()))) {
    buffer += stream.substr(0, piece);
    for (;;) {
      const auto found = cutter.next(buffer);
      if (found.size != 0) {
        const auto plain = cutter.plain(std::string_view(buffer).substr(found.skipped, found.size));
        frames.emplace_back(plain ? *plain : "?");
      }
      buffer.erase(0, found.skipped + found.size);
      if (found.size == 0) break;
    }
  }
  return frames;
}

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-13 whole numbers of 3 bytes, single bits, and some bits of a number") {
    const LineConfig big{.format = LineFormat::binary,
                         .fields = {{.name = "weight", .scale = 0.5, .at = 1, .wire = Kind::i32, .bytes = 3},
                                    {.name = "count", .type = Kind::u32, .at = 1, .bytes = 3},
                                    {.name = "valve", .type = Kind::boolean, .at = 4, .bit = 7},
                                    {.name = "pump", .type = Kind::boolean, .at = 4, .wire = Kind::u16, .bit = 0},
                                    {.name = "level", .scale = 0.1, .at = 4, .wire = Kind::u16, .mask = 0x0ff0},
                                    {.name = "mode", .type = Kind::u8, .at = 4, .mask = 0x70, .no_value = {"7"}}},
                         .frame = LineFrame{.start = "x", .length = 6}};
    CHECK(values_of_line(big, from_hex("78 ff ff fe 9a 43")) == "-1 16777214 true true 16.4 1");
    CHECK(values_of_line(big, from_hex("78 00 01 02 70 42")) == "129 258 false false 0.4 absent");
    LineConfig little = big;
    little.frame->byte_order = WireOrder::little;
    CHECK(values_of_line(little, from_hex("78 fe ff ff 9a 43")) == "-1 16777214 true false 5.7 1");
  }

  TEST_CASE("US-13 bytes that are decimal digits") {
    const LineConfig digits{.format = LineFormat::binary,
                            .fields = {{.name = "a", .type = Kind::u32, .at = 0, .bytes = 3, .bcd = true},
                                       {.name = "b", .scale = 0.01, .at = 3, .wire = Kind::u16, .bcd = true}},
                            .frame = LineFrame{.start = "x", .length = 5}};
    CHECK(values_of_line(digits, from_hex("12 34 56 98 76")) == "123456 98.76");
    CHECK(values_of_line(digits, from_hex("12 3a 56 98 76")) == "its bytes are not decimal digits");
    CHECK(values_of_line(digits, from_hex("12 34 56 f8 76")) == "its bytes are not decimal digits");
    LineConfig low_first = digits;
    low_first.frame->byte_order = WireOrder::little;
    CHECK(values_of_line(low_first, from_hex("37 18 02 13 01")) == "21837 1.13");
  }

  TEST_CASE("US-13 settings of bytes that exclude each other are refused") {
    const auto why = [](LineField field) {
      field.name = "v";
      return refusal_of_bytes(field);
    };
    CHECK(has(why({.at = 1, .bytes = 3}), "only a whole number"));
    CHECK(has(why({.at = 1, .bit = 3}), "only a whole number"));
    CHECK(has(why({.at = 1, .wire = Kind::u16, .bytes = 3}), "`bytes` is larger than its type"));
    CHECK(has(why({.at = 1, .wire = Kind::u16, .bit = 16}), "beyond its bytes"));
    CHECK(has(why({.at = 1, .wire = Kind::u16, .mask = 0x10000}), "a bit beyond them"));
    CHECK(has(why({.at = 1, .wire = Kind::u16, .mask = 0}), "has no bit"));
    CHECK(has(why({.at = 1, .wire = Kind::u16, .bit = 1, .mask = 2}), "both"));
    CHECK(has(why({.type = Kind::i16, .at = 1, .mask = 2}), "have no sign"));
    CHECK(has(why({.type = Kind::u16, .at = 1, .bit = 2, .bcd = true}), "does not work together with `bit`"));
    CHECK(has(why({.at = 1, .bcd = true}), "only a whole number"));
    CHECK(has(why({.type = Kind::boolean, .at = 1, .wire = Kind::f32}), "cannot be a number with decimals"));
    CHECK(has(why({.type = Kind::u8, .at = 1, .mask = 15, .no_value = {"255"}}), "bytes or bits can never have"));
    CHECK(has(why({.type = Kind::boolean, .at = 1, .bit = 7, .no_value = {"255"}}), "bytes or bits can never have"));
    CHECK(why({.type = Kind::u64, .at = 1, .no_value = {"18446744073709551615"}}).empty());
    CHECK(has(refusal_of_bytes({.name = "v", .base = 16, .bcd = true}, LineFormat::pattern), "only fields of bytes"));
    CHECK(has(why({.base = 16, .at = 1, .wire = Kind::u16}), "not digits of another base"));
    CHECK(has(why({.at = 7, .wire = Kind::i32}), "ends beyond the frame"));
    CHECK(why({.at = 7, .wire = Kind::u16, .mask = 0xf000}).empty());
    CHECK(has(refusal_of_bytes({.name = "v", .at = 1}, LineFormat::pattern), "only binary frames have"));
    CHECK(has(refusal_of_bytes({.name = "v", .bit = 1}, LineFormat::csv), "only fields of bytes"));
    CHECK(has(refusal_of_bytes({.name = "v", .wire = Kind::u8}, LineFormat::csv), "only binary frames have"));
    const auto of_frame = [](const LineFrame& frame) {
      try {
        const detail::FrameCutter cutter(frame, 100);
      } catch (const SetupError& error) {
        return error.error().why;
      }
      return std::string();
    };
    CHECK(has(of_frame({.end = "x", .stuffing = Stuffing::slip}), "a special byte marks the end"));
    CHECK(has(of_frame({.length = 5, .stuffing = Stuffing::cobs}), "a special byte marks the end"));
    CHECK(of_frame({.stuffing = Stuffing::hdlc}).empty());
  }

  TEST_CASE("US-13 frames that were stuffed are those that were sent, whatever the pieces are") {
    std::string most, one_more;  // 01 to fe, and to ff
    for (int i = 1; i < 256; ++i) {
      if (i < 255) most += static_cast<char>(i);
      one_more += static_cast<char>(i);
    }
    using Strings = std::vector<std::string>;
    for (const std::size_t piece : {std::size_t{1}, std::size_t{2}, std::size_t{7}, std::size_t{1000}}) {
      // The examples of the paper, and a frame that is none.
      const std::string cobs = from_hex("01 01 00 01 01 01 00 03 11 22 02 33 00 05 11 22 33 44 00") + "\xff" + most +
                               from_hex("00 01 ff") + most + from_hex("00 ff") + most + from_hex("02 ff 00 05 11 00");
      CHECK(plain_frames(Stuffing::cobs, cobs, piece) == Strings{std::string(1, '\0'), std::string(2, '\0'),
                                                                 from_hex("11 22 00 33"), from_hex("11 22 33 44"), most,
                                                                 '\0' + most, one_more, "?"});
      // A mark before and behind each, one between two, several; escapes that are none.
      const std::string marks(2000, '\xc0'), overlong(3000, 'x');  // neither takes the frame behind it along
      CHECK(plain_frames(Stuffing::slip, marks + from_hex("01 c0") + marks + from_hex("02 c0"), piece) ==
            Strings{"\x01", "\x02"});
      CHECK(plain_frames(Stuffing::slip, overlong + from_hex("c0 02 c0"), piece) == Strings{"\x02"});
      const std::string slip = from_hex("c0 01 db dc 02 db dd c0 03 c0 c0 c0 04 c0 05 db 06 c0 07 db c0 08 c0 09");
      CHECK(plain_frames(Stuffing::slip, slip, piece) ==
            Strings{from_hex("01 c0 02 db"), "\x03", "\x04", "?", "?", "\x08"});
      const std::string hdlc = from_hex("7e 00 7d 5e 7d 5d 7d 31 7d 33 7e 7e 01 7d 7e");
      CHECK(plain_frames(Stuffing::hdlc, hdlc, piece) == Strings{from_hex("00 7e 7d 11 13"), "?"});
    }
  }
#ifdef RTDATA_WITH_PATTERN

  TEST_CASE("US-13 bytes between others, of which a regular expression says where they are") {
    // Values of tags and lengths, such as those of SML and M-Bus.
    const LineConfig tagged{.format = LineFormat::pattern,
                            .fields = {{.name = "energy", .unit = "W.h", .scale = 0.1, .wire = Kind::u64},
                                       {.name = "power", .unit = "W", .optional = true, .wire = Kind::i32}},
                            .pattern = R"((?sJ)\x08\x01(?:\x52(?<energy>.)|\x55(?<energy>.{4})|\x59(?<energy>.{8})))"
                                       R"((?:.*?\x07\x53(?<power>..))?)",
                            .frame = LineFrame{.start = "x", .end = "y"}};
    CHECK(values_of_line(tagged, from_hex("08 01 55 00 0c 13 61 00 07 53 f8 60")) == "79139.3 -1952");
    CHECK(values_of_line(tagged, from_hex("08 01 52 0a")) == "1 absent");
    LineConfig any_byte = tagged;
    any_byte.pattern = R"(\x08\x01(?<energy>.)(?<power>..)?)";
    CHECK(values_of_line(any_byte, from_hex("08 01 0a 0d 0a 08 01 07")) == "1 3338");
    CHECK(values_of_line({.format = LineFormat::pattern, .fields = {{.name = "a"}}, .pattern = "(?<a>[^;]+);"},
                         "21,;") == "\"21,\" is not a number");
    CHECK(values_of_line(tagged, from_hex("08 01 59 00 00 00 00 00 0c 13 61")) == "79139.3 absent");
    CHECK(has(values_of_line(tagged, from_hex("08 01 54 0a")), "`pattern` does not match"));
    // A beacon of a RuuviTag, format 5: the example of its description.
    const LineConfig ruuvi{
        .format = LineFormat::pattern,
        .fields = {{.name = "temp", .scale = 0.005, .base = 16, .wire = Kind::i16, .no_value = {"-32768"}},
                   {.name = "humidity", .scale = 0.0025, .base = 16, .wire = Kind::u16},
                   {.name = "battery", .type = Kind::u16, .base = 16, .wire = Kind::u16, .mask = 0xffe0}},
        .pattern = R"("data":"[0-9A-F]*FF990405(?<temp>.{4})(?<humidity>.{4}).{16}(?<battery>.{4}))"};
    CHECK(values_of_line(ruuvi, R"({"data":"0201061BFF99040512FC5394C37C0004FFFC040CAC364200CDCBB8334C884F"})") ==
          "24.3 53.49 1377");
    CHECK(values_of_line(ruuvi, R"({"data":"0201061BFF9904058000FFFFFFFF800080008000FFFFFFFFFFFFFFFFFFFFFF"})") ==
          "absent 163.8375 2047");
    CHECK(has(values_of_line(ruuvi, R"({"data":"FF99040512XC5394C37C0004FFFC040CAC36"})"), "\"12XC\" is not bytes"));
  }
#endif
}
