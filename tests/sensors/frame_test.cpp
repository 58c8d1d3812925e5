// Checksums, chosen lines, frames: by their published examples, and broken in every way.
#include <doctest/doctest.h>

#include <random>
#include <string>
#include <vector>

#include "data/hex_bytes.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "rtdata/data/event.hpp"
#include "rtdata/sensors/serial_line.hpp"
#include "sensors/decoded_line.hpp"
#include "sensors/fixture.hpp"
#include "sensors/lines/checksum.hpp"
#include "sensors/lines/frame_cutter.hpp"
#include "sensors/lines/line_config.hpp"
#include "sensors/lines/line_decoder.hpp"
#include "sensors/pty.hpp"
#include "sensors/termios2.hpp"

using namespace rtdata;
using rtdata::test::has;
using namespace std::chrono_literals;

namespace {

/// Why such settings are refused.
std::string refusal_of(const LineConfig& config) {
  try {
    const detail::LineDecoder decoder(config);
    if (config.frame) detail::FrameCutter(*config.frame, config.max_line);
  } catch (const SetupError& error) {
    return error.error().where + ": " + error.error().why;
  }
  return "";
}

/// What a sensor makes of bytes that come in pieces of `piece` bytes: its events, and its counts at the end.
struct Heard {
  std::vector<std::string> events = {};
  SensorCounts counts = {};
  std::vector<std::string> errors = {};
};
Heard hear(LineConfig config, const std::string& bytes, std::size_t piece, std::uint64_t expected) {
  ScratchDirectory folder;
  Pty pty(folder.file("tty"));
  pty.plug_in();
  Loop loop;
  be_quiet(loop);
  Heard heard;
  config.first_line = FirstLine::keep;
  const auto subscription = loop.subscribe("line", [&](const EventView& event) {
    std::string text;
    for (const Leaf& leaf : event.description().leaves())
      text += (text.empty() ? "" : " ") + to_string(event.value(leaf));
    heard.events.push_back(text);
  });
  SerialLineSensor sensor(loop, {.name = "line"}, {.device = pty.path(), .lines = std::move(config)});
  sensor.on_error([&](const ErrorReport& report) { heard.errors.push_back(report.error.why); });
  for (std::size_t at = 0; at < bytes.size();) {
    at += pty.send(bytes.substr(at, piece));
    loop.poll();
  }
  for (int i = 0; i < 5000 && sensor.counts().received < expected; ++i) loop.run_for(1ms);
  loop.run_for(5ms);
  heard.counts = sensor.counts();
  CHECK(heard.counts.balances());
  return heard;
}

/// A frame of a PMS5003 (data manual V2.3, appendix I): 0x42 0x4d, length 28, thirteen words, the sum of all before.
std::string particles(unsigned pm25) {
  std::string frame("\x42\x4d\x00\x1c", 4);
  const unsigned words[13] = {1, 2, 3, 4, pm25, 6, 700, 8, 9, 10, 11, 12, 0x9700};
  for (const unsigned word : words) {
    frame += static_cast<char>(word >> 8);
    frame += static_cast<char>(word & 0xff);
  }
  unsigned sum = 0;
  for (const char c : frame) sum += static_cast<unsigned char>(c);
  frame += static_cast<char>(sum >> 8);
  frame += static_cast<char>(sum & 0xff);
  return frame;
}
const LineConfig pms5003{.format = LineFormat::binary,
                         .fields = {{.name = "pm25", .type = Kind::u16, .at = 12},
                                    {.name = "ten", .unit = "1", .scale = 0.1, .at = 16, .wire = Kind::u16}},
                         .frame = LineFrame{.start_hex = "42 4d", .length_at = 2, .length_bytes = 2, .length_adds = 4},
                         .checksum = LineChecksum{.type = ChecksumType::sum16, .form = ChecksumForm::big}};

}  // namespace

TEST_SUITE("sensors" * doctest::skip(!terminals_can_be_set_up())) {
  TEST_CASE("US-13 checksums are those of the catalogue") {
    // The check values for "123456789" of Greg Cook's catalogue of CRC algorithms.
    const auto of = [](ChecksumType type) {
      return detail::Checksum({.type = type, .form = ChecksumForm::hex}).of("123456789");
    };
    CHECK(of(ChecksumType::crc8) == 0xf4);
    CHECK(of(ChecksumType::crc8_maxim) == 0xa1);
    CHECK(of(ChecksumType::crc8_nrsc5) == 0xf7);
    CHECK(of(ChecksumType::crc8_dvb_s2) == 0xbc);
    CHECK(of(ChecksumType::crc8_4d) == 0xc3);  // not in the catalogue; computed bit by bit
    CHECK(of(ChecksumType::crc16_x25) == 0x906e);
    CHECK(of(ChecksumType::crc16_mcrf4xx) == 0x6f91);
    CHECK(of(ChecksumType::fletcher16) == 0xdd15);
    CHECK(detail::Checksum({.type = ChecksumType::sum16, .complement = Complement::twos}).of("123456789") == 0xfe23);
    CHECK(detail::Checksum({.type = ChecksumType::sum8, .complement = Complement::ones}).of("123456789") == 0x22);
    CHECK(detail::Checksum({.type = ChecksumType::crc16_mcrf4xx, .append_hex = "38 39"}).of("1234567") == 0x6f91);
    CHECK(of(ChecksumType::crc16_arc) == 0xbb3d);
    CHECK(of(ChecksumType::crc16_modbus) == 0x4b37);
    CHECK(of(ChecksumType::crc16_ccitt) == 0x29b1);
    CHECK(of(ChecksumType::crc16_xmodem) == 0x31c3);
    CHECK(of(ChecksumType::crc32) == 0xcbf43926);
    CHECK(of(ChecksumType::sum8) == 0xdd);
    CHECK(of(ChecksumType::sum16) == 0x1dd);
    CHECK(of(ChecksumType::xor8) == 0x31);
    CHECK(of(ChecksumType::lrc) == 0x23);
  }

  TEST_CASE("US-13 checksums of real frames: a lidar, a battery, a receiver") {
    const auto checked = [](LineChecksum checksum, std::string_view hex) {
      const std::string bytes = detail::bytes_of_hex(hex).value();
      const detail::Checksum of(checksum);
      std::string damaged = bytes;
      damaged[8] = static_cast<char>(damaged[8] ^ 1);
      return of.checked(bytes).has_value() && !of.checked(damaged).has_value();
    };
    // LDROBOT LD19 development manual, its example of a packet.
    CHECK(checked({.type = ChecksumType::crc8_4d, .form = ChecksumForm::big},
                  "54 2c 68 08 ab 7e e0 00 e4 dc 00 e2 d9 00 e5 d5 00 e3 d3 00 e4 d0 00 e9 cd 00 e4 ca 00 e2 c7 00 "
                  "e9 c5 00 e5 c2 00 e5 c0 00 e5 be 82 3a 1a 50"));
    // A battery's controller of JBD, as a public capture has it: the sum of status, length and data, negative.
    CHECK(checked(
        {.type = ChecksumType::sum16, .form = ChecksumForm::big, .from = 2, .behind = 1, .complement = Complement::twos},
        "dd 03 00 1b 05 28 00 00 1b b2 2a ef 00 02 29 0a 00 00 00 00 00 00 25 41 03 04 02 0b 74 0b 6b fc "
        "39 77"));
    // u-blox NAV-PVT, from a public log.
    CHECK(checked({.type = ChecksumType::fletcher16, .form = ChecksumForm::big, .from = 2},
                  "b5 62 01 07 5c 00 f8 5a 79 10 ea 07 09 1e 04 2e 0a 37 27 00 00 00 22 ed bd 23 03 01 ea 15 ea 08 "
                  "96 43 25 4b bc 0d 54 3c 00 00 5f 50 00 00 b4 05 00 00 ec 08 00 00 f4 ff ff ff fd ff ff ff e9 ff "
                  "ff ff 0d 00 00 00 b0 30 c7 01 d2 00 00 00 80 a8 12 01 a9 00 00 00 5c 41 4f 21 00 00 00 00 00 00 "
                  "00 00 1c 47"));
  }

  TEST_CASE("US-13 frames are chosen by bytes at a place") {
    const LineConfig config{.format = LineFormat::binary,
                            .fields = {{.name = "a", .type = Kind::u8, .at = 3}},
                            .frame = LineFrame{.start_hex = "b5", .length = 4},
                            .only = LineMatch{.at = 1, .is_hex = {"01 07", "0a"}}};
    const auto of = [&](std::string_view hex) { return values_of_line(config, detail::bytes_of_hex(hex).value()); };
    CHECK(of("b5 01 07 09") == "9");
    CHECK(of("b5 0a ff 08") == "8");
    CHECK(of("b5 01 08 09") == "left out");
    CHECK(of("b5") == "left out");
    LineConfig wrong = config;
    wrong.only = LineMatch{.is = {"x"}};
    CHECK(has(refusal_of(wrong), "only: binary frames have no text"));
    wrong.only = LineMatch{.at = 1};
    CHECK(has(refusal_of(wrong), "it does not say what the bytes are"));
    wrong.only = LineMatch{.is_hex = {"0"}};
    CHECK(has(refusal_of(wrong), "`is_hex` is not bytes"));
    wrong.only = LineMatch{.at = 3, .is_hex = {"00", "01 07"}};
    CHECK(has(refusal_of(wrong), "its bytes end beyond the frame"));
    wrong = config;
    wrong.checksum = LineChecksum{.type = ChecksumType::sum8, .form = ChecksumForm::big, .from = 4};
    CHECK(has(refusal_of(wrong), "checksum: `from` is beyond the end of the frame"));
    CHECK(has(refusal_of({.fields = {{.name = "a"}}, .only = LineMatch{.is_hex = {"00"}}}), "only binary frames have"));
  }

  TEST_CASE("US-13 a line with a wrong checksum is unreadable, never a value") {
    // A sentence of NMEA read as CSV: any sentence's fields by their place.
    const LineConfig wind{
        .fields = {{.name = "kind", .type = Kind::text}, {.name = "angle"}, {}, {.name = "speed"}, {}, {}},
        .comment = "",
        .only = LineMatch{.column = 1, .is = {"$WIMWV", "$IIMWV"}},
        .checksum = LineChecksum{.type = ChecksumType::xor8, .after = "*", .from = 1}};
    CHECK(values_of_line(wind, "$WIMWV,214.8,R,0.1,K,A*28") == "$WIMWV 214.8 0.1");
    CHECK(has(values_of_line(wind, "$WIMWV,214.9,R,0.1,K,A*28"), "its checksum is 28, but should be 29"));
    CHECK(has(values_of_line(wind, "$WIMWV,214.8,R,0.1,K,A"), "it has no checksum after \"*\""));
    CHECK(has(values_of_line(wind, "$WIMWV,214.8,R,0.1,K,A*2"), "cut off"));
    CHECK(has(values_of_line(wind, "$WIMWV,214.8,R,0.1,K,A*2x"), "cut off"));
    CHECK(values_of_line(wind, "$WIXDR,A,1*00") == "left out");
    LineConfig lenient = wind;
    lenient.checksum->optional = true;
    CHECK(values_of_line(lenient, "$WIMWV,214.8,R,0.1,K,A") == "$WIMWV 214.8 0.1");
    CHECK(has(values_of_line(lenient, "$WIMWV,214.8,R,0.1,K,A*00"), "should be 28"));
  }

  TEST_CASE("US-13 lines are chosen by a column, a key or their text, and some say that there is no value") {
    const LineConfig scale{.fields = {{}, {.name = "weight", .suffix = "g", .sign_blanks = true}},
                           .unreadable_if = LineMatch{.column = 1, .is = {"OL", "US"}}};
    CHECK(values_of_line(scale, "ST,+ 12.5 g") == "12.5");
    CHECK(has(values_of_line(scale, "US,+ 12.5 g"), "unreadable_if"));
    const LineConfig board{.format = LineFormat::json,
                           .fields = {{.name = "value"}},
                           .only = LineMatch{.key = "sensor.kind", .is = {"t"}}};
    CHECK(values_of_line(board, R"({"value": 1, "sensor": {"kind": "t"}})") == "1");
    CHECK(values_of_line(board, R"({"value": "x", "sensor": {"kind": "p"}})") == "left out");
    CHECK(values_of_line(board, R"({"value": 1})") == "left out");
    CHECK(values_of_line(board, "ets Jun  8 2016 rst:0x1") == "left out");
    const LineConfig text{.fields = {{.name = "t", .prefix = "T="}},
                          .only = LineMatch{.begins = "T=", .contains = "1"}};
    CHECK(values_of_line(text, "T=1") == "1");
    CHECK(values_of_line(text, "T=2") == "left out");
    CHECK(values_of_line(text, "P=1") == "left out");
  }

  TEST_CASE("US-13 JSON: values in arrays have their index in the key") {
    const LineConfig meter{.format = LineFormat::json,
                           .fields = {{.name = "a", .key = "emeters.0.power"},
                                      {.name = "b", .key = "emeters.1.power"},
                                      {.name = "c", .key = "list.1.0"}}};
    CHECK(
        values_of_line(
            meter, R"({"x": [1, {"y": 2}], "emeters": [{"power": 1.5}, {"power": -2}], "list": [[7], [8, 9], 10]})") ==
        "1.5 -2 8");
    CHECK(
        has(values_of_line(meter, R"({"emeters": [{"power": 1}], "list": [[], [3]]})"), "has no \"emeters.1.power\""));
    const LineConfig top{.format = LineFormat::json,
                         .fields = {{.name = "a", .key = "1.v"}, {.name = "b", .key = "2"}}};
    CHECK(values_of_line(top, R"([{"v": 1}, {"v": 2}, 3])") == "2 3");
    CHECK(has(values_of_line(top, "[]"), "has no"));
    CHECK(has(values_of_line(top, "3"), "not a JSON object"));
    CHECK(has(values_of_line(top, "[[[["), "not JSON"));
  }

  TEST_CASE("US-13 JSON: the object of an array is chosen by a member, wherever that stands; numbers may be texts") {
    const LineConfig config{.format = LineFormat::json,
                            .fields = {{.name = "pm10", .key = "values[type=P1].value"},
                                       {.name = "pm25", .key = "values[type=P2].value", .optional = true}}};
    const auto of = [&](std::string_view line) { return values_of_line(config, line); };
    CHECK(of(R"({"values": [{"type": "P1", "value": "10.5"}, {"value": 2.5, "type": "P2"}]})") == "10.5 2.5");
    CHECK(of(R"({"values": [{"value": 7, "type": "T"}, {"value": 2.5, "type": "P1"}]})") == "2.5 absent");
    CHECK(of(R"({"values": [{"value": 7, "type": "P1"}, {"value": 8, "type": "P1"}]})") == "7 absent");
    CHECK(of(R"({"values": [{"type": "P2", "value": 1}]})") == "the line has no \"values[type=P1].value\"");
    CHECK(of(R"({"values": {"type": "P1", "value": 1}})") == "the line has no \"values[type=P1].value\"");
    const LineConfig at_top{.format = LineFormat::json, .fields = {{.name = "v", .key = "[id=2].v"}}};
    CHECK(values_of_line(at_top, R"([{"id": 1, "v": 1}, {"id": 2, "v": 5}])") == "5");
    const LineConfig plain{.format = LineFormat::json,
                           .fields = {{.name = "a"}, {.name = "b", .type = Kind::i32, .optional = true}}};
    CHECK(values_of_line(plain, R"({"a": "1.87", "b": ""})") == "1.87 absent");
    CHECK(values_of_line(plain, R"({"a": "1.87", "b": "12"})") == "1.87 12");
    CHECK(values_of_line(plain, R"({"a": "many", "b": 1})") == "\"many\" is not a number");
    CHECK(values_of_line(plain, R"({"a": "", "b": 1})") == "\"\" is not a number");
  }

  TEST_CASE("US-13 damaged JSON is unreadable, also where a key chooses the lines, and behind a NUL") {
    const LineConfig plain{.format = LineFormat::json, .fields = {{.name = "v"}}};
    CHECK(has(values_of_line(plain, std::string_view("{\"v\":2}\0{\"v\":3}", 15)), "not JSON from byte 8 on"));
    const LineConfig chosen{
        .format = LineFormat::json, .fields = {{.name = "v"}}, .only = LineMatch{.key = "type", .is = {"t"}}};
    CHECK(values_of_line(chosen, R"({"v":2,"type":"t"})") == "2");
    CHECK(values_of_line(chosen, R"({"v":2,"type":"u"})") == "left out");
    CHECK(values_of_line(chosen, R"({"v":2})") == "left out");
    for (const char* const damaged : {R"({"v":2#"type":"t"})", R"({"v":3,"typ)", "{"})
      CHECK(has(values_of_line(chosen, damaged), "not JSON from byte"));
  }

  TEST_CASE("US-13 a label may hold the separator") {
    const LineConfig config{
        .format = LineFormat::labels,
        .fields = {{.name = "one", .key = R"(temp{chip="a",label="Sensor 1"})"}, {.name = "two", .key = "up"}},
        .separator = ' '};
    CHECK(values_of_line(config, "temp{chip=\"a\",label=\"Sensor 1\"} 3.5\nup 1\n") == "3.5 1");
    CHECK(has(values_of_line(config, "temp{chip=\"a\",label=\"Sensor 1\"}x 3.5\nup 1\n"), "the line has no"));
  }

  TEST_CASE("US-13 rows of labels: DSMR, Teleinfo, VE.Direct") {
    // DSMR 5.0.2 P1, chapter 6: a telegram from "/" to "!", then CRC16 over both.
    const LineConfig meter{
        .format = LineFormat::labels,
        .fields = {{.name = "power", .unit = "kW", .key = "1-0:1.7.0", .suffix = "*kW)"},
                   {.name = "gas", .unit = "m3", .key = "0-1:24.2.1", .suffix = "*m3)", .column = 2}},
        .separator = '(',
        .frame = LineFrame{.start = "/", .end = "!", .after_end = 4},
        .checksum = LineChecksum{.type = ChecksumType::crc16_arc, .after = "!", .covers_after = true}};
    const std::string
        body = "/ISk5\\2MT382-1000\r\n\r\n1-0:1.7.0(01.193*kW)\r\n0-1:24.2.1(101209112500W)(12785.123*m3)\r\n!";
    char crc[5];
    std::snprintf(crc, sizeof crc, "%04X", detail::Checksum({.type = ChecksumType::crc16_arc}).of(body));
    const std::string telegram = body + crc + "\r\n";
    Heard heard = hear(meter, telegram + telegram + telegram, 7, 3);
    CHECK(heard.events == std::vector<std::string>(3, "1.193 12785.123"));
    CHECK(heard.errors.empty());
    std::string wrong = telegram;
    wrong[body.find("193")] = '7';
    heard = hear(meter, wrong + telegram, 1000, 2);
    CHECK(heard.events == std::vector<std::string>{"1.193 12785.123"});
    CHECK(heard.counts.unreadable == 1);

    // Teleinfo in its historic mode (Enedis-NOI-CPT_02E, 5.3): STX, rows of label, value and checksum, ETX.
    const LineConfig teleinfo{
        .format = LineFormat::labels,
        .fields = {{.name = "base", .type = Kind::u32, .key = "BASE"},
                   {.name = "power", .type = Kind::u16, .key = "PAPP"}},
        .separator = ' ',
        .frame = LineFrame{.start_hex = "02", .end_hex = "03"},
        .checksum = LineChecksum{
            .type = ChecksumType::sum6, .form = ChecksumForm::character, .before = 1, .of = ChecksumOf::row}};
    const auto row = [](const std::string& text) {
      return "\n" + text + " " +
             static_cast<char>(
                 detail::Checksum({.type = ChecksumType::sum6, .form = ChecksumForm::character}).of(text)) +
             "\r";
    };
    CHECK(row("PAPP 00430") == "\nPAPP 00430 (\r");
    const std::string frame = "\x02" + row("ADCO 031528254512") + row("BASE 002815235") + row("PAPP 00430") + "\x03";
    heard = hear(teleinfo, frame + frame, 5, 2);
    CHECK(heard.events == std::vector<std::string>(2, "2815235 430"));
    std::string broken = frame;
    broken[broken.find("00430") + 3] = '9';
    heard = hear(teleinfo, broken + frame, 100, 2);
    CHECK(heard.events == std::vector<std::string>{"2815235 430"});
    CHECK(heard.counts.unreadable == 1);
    REQUIRE_FALSE(heard.errors.empty());
    CHECK(has(heard.errors.front(), "its checksum is"));

    // VE.Direct's text mode: rows, the last "Checksum" and a byte which makes the sum of all 0.
    const LineConfig battery{.format = LineFormat::labels,
                             .fields = {{.name = "voltage", .unit = "V", .scale = 0.001, .key = "V"},
                                        {.name = "current", .unit = "A", .scale = 0.001, .key = "I"}},
                             .separator = '\t',
                             .frame = LineFrame{.end = "Checksum\t", .after_end = 1},
                             .checksum = LineChecksum{.type = ChecksumType::lrc, .form = ChecksumForm::big}};
    std::string block = "\r\nPID\t0x203\r\nV\t26201\r\nI\t-150\r\nChecksum\t";
    block += static_cast<char>(detail::Checksum({.type = ChecksumType::lrc}).of(block));
    heard = hear(battery, block + block + block, 11, 3);
    CHECK(heard.events == std::vector<std::string>(3, "26.201 -0.15"));
    CHECK(heard.errors.empty());
  }

  TEST_CASE("US-13 frames of bytes: cut anywhere, after garbage, damaged, one within another") {
    const std::string a = particles(35), b = particles(36);
    for (const std::size_t piece : {1, 2, 3, 31, 32, 33, 500}) {
      CAPTURE(piece);
      const Heard heard = hear(pms5003, a + b + a, piece, 3);
      CHECK(heard.events == std::vector<std::string>{"35 70", "36 70", "35 70"});
      CHECK(heard.errors.empty());
    }
    Heard heard = hear(pms5003, "junk" + a + "xx\x42yy" + b, 6, 4);
    CHECK(heard.events == std::vector<std::string>{"35 70", "36 70"});
    CHECK(heard.counts.unreadable == 2);
    REQUIRE(heard.errors.size() == 2);
    CHECK(heard.errors[0] == "4 bytes are discarded");
    CHECK(heard.errors[1] == "5 bytes are discarded");
    for (std::size_t at = 0; at < a.size(); ++at) {  // one byte is wrong, or missing: the next frame is there
      CAPTURE(at);
      std::string wrong = a;
      wrong[at] = static_cast<char>(wrong[at] ^ 0x10);
      heard = hear(pms5003, b + wrong + b + b, 64, 4);
      CHECK(heard.events.size() >= 2);
      for (const std::string& event : heard.events) CHECK(event == "36 70");
      CHECK(heard.counts.unreadable >= 1);
    }
    heard = hear(pms5003, a.substr(0, 20) + b, 1000, 2);  // the device started again
    CHECK(heard.events == std::vector<std::string>{"36 70"});
    CHECK(heard.counts.unreadable == 1);
  }

  TEST_CASE("US-13 any bytes in frames are values or counted, and nothing is lost behind them") {
    std::mt19937 random(7);
    for (int round = 0; round < 20; ++round) {
      std::string bytes;
      while (bytes.size() < 3000) bytes += static_cast<char>(random() & 0xff);
      const Heard heard = hear(pms5003, bytes + std::string(64, '\n') + particles(35) + particles(35), 700, 2);
      REQUIRE(heard.events.size() >= 1);
      CHECK(heard.events.back() == "35 70");
    }
    // A length that never comes true ends at the longest frame.
    LineConfig small = pms5003;
    small.max_line = 64;
    const Heard heard = hear(small, std::string("\x42\x4d\xff\xff", 4) + particles(35), 3, 2);
    CHECK(heard.events == std::vector<std::string>{"35 70"});
  }

  TEST_CASE("US-13 the rest of a frame that is too long is none, whatever the pieces are") {
    const LineConfig marks{.fields = {{.name = "v"}}, .frame = LineFrame{.end = "#"}, .max_line = 32};
    for (const std::size_t piece : {1, 7, 33, 200}) {
      CAPTURE(piece);
      const Heard heard = hear(marks, "1#" + std::string(60, '8') + "2#3#", piece, 3);
      CHECK(heard.events == std::vector<std::string>{"1", "3"});
      CHECK(heard.counts.unreadable == 1);
    }
  }

  TEST_CASE("US-13 what is damaged is unreadable and holds nothing up: no value, no length, many starts") {
    // A row of a label and its checksum, whose value was lost.
    const LineConfig rows{.format = LineFormat::labels,
                          .fields = {{.name = "p", .key = "P"}},
                          .separator = '=',
                          .checksum = LineChecksum{.after = "=", .of = ChecksumOf::row}};
    Heard heard = hear(rows, "P=50\nP=50\n", 100, 2);
    CHECK(heard.counts.unreadable == 2);
    CHECK(has(heard.errors.front(), "no value"));
    // A length of 0.
    const LineConfig lengths{.format = LineFormat::binary,
                             .fields = {{.name = "v", .type = Kind::u8, .at = 2}},
                             .frame = LineFrame{.start_hex = "aa", .length_at = 1}};
    const std::string good("\xaa\x03\x07", 3);
    heard = hear(lengths, good + std::string("\xaa\x00\x07", 3) + good + good, 4, 4);
    CHECK(heard.events == std::vector<std::string>(3, "7"));
    CHECK(heard.counts.unreadable == 1);
    // A burst of starts: not all of them are tried.
    const LineConfig many{.fields = {{.name = "v"}}, .frame = LineFrame{.start = "<", .end = ">"}};
    heard = hear(many, std::string(3000, '<') + ">" + "<5>", 5000, 2);
    CHECK(heard.events == std::vector<std::string>{"5"});
    CHECK(heard.counts.unreadable >= 1);
    CHECK(heard.counts.unreadable <= 20);
    // A byte of the checksum that is as what stands before it.
    const LineConfig stars{
        .fields = {{.name = "v"}},
        .checksum = LineChecksum{.type = ChecksumType::sum8, .form = ChecksumForm::big, .after = "*"}};
    CHECK(values_of_line(stars, "9***") == "its checksum is 2a, but should be 63 (hexadecimal)");
    std::string sum = "123400";
    for (char last = '0'; last <= '9'; ++last)
      for (char before = '0'; before <= '9'; ++before) {
        sum[4] = before, sum[5] = last;
        const std::string line = sum + "*" +
                                 static_cast<char>(
                                     detail::Checksum({.type = ChecksumType::sum8, .form = ChecksumForm::big}).of(sum));
        CHECK(values_of_line(stars, line) == std::to_string(std::stoi(sum)));
      }
    // A damaged line is not one that is not meant.
    const LineConfig chosen{.fields = {{}, {.name = "v"}},
                            .only = LineMatch{.column = 1, .is = {"$W"}},
                            .checksum = LineChecksum{.after = "*", .from = 1}};
    heard = hear(chosen, "$V,2*00\n$V,2\n", 100, 2);
    CHECK(heard.counts.unreadable == 1);
    CHECK(heard.counts.filtered == 1);
  }

  TEST_CASE("US-13 a frame whose end was lost takes nothing of the next one") {
    const LineConfig framed{.fields = {{.name = "a"}, {.name = "b"}},
                            .frame = LineFrame{.start = "<a>", .end = "</a>"}};
    const Heard heard = hear(framed, "<a>1,2</a><a>3,<a>4,5</a><a>6,7</a>", 3, 4);
    CHECK(heard.events == std::vector<std::string>{"1 2", "4 5", "6 7"});
    CHECK(heard.counts.unreadable == 1);
    REQUIRE(!heard.errors.empty());
    CHECK(has(heard.errors[0], "a second frame begins inside this frame"));
  }

#ifdef RTDATA_WITH_PATTERN
  TEST_CASE("US-13 bytes of a pattern come in frames, since lines end at some of them") {
    const LineField field{.name = "v", .wire = Kind::u8};
    LineConfig lines{.format = LineFormat::pattern, .fields = {field}, .pattern = "^(?<v>.)$"};
    Loop loop;
    be_quiet(loop);
    const auto refused = [&] {
      try {
        const SerialLineSensor sensor(loop, {.name = "x"}, {.device = "/nowhere/tty", .lines = lines});
      } catch (const SetupError& error) {
        return error.error().why;
      }
      return std::string();
    };
    CHECK(has(refused(), "may contain bytes that end a line"));
    lines.frame = LineFrame{.stuffing = Stuffing::slip};
    CHECK(refused().empty());
  }
#endif

  TEST_CASE("US-13 frames that wait behind a wrong length are taken at the end, and what has no end is told") {
    ScratchDirectory folder;
    Pty pty(folder.file("tty"));
    pty.plug_in();
    Loop loop;
    be_quiet(loop);
    std::vector<std::string> events;
    const auto subscription = loop.subscribe("line", [&](const EventView& event) {
      events.push_back(to_string(event.value(event.description().leaves()[0])));
    });
    LineConfig config = pms5003;
    config.first_line = FirstLine::keep;
    SerialLineSensor sensor(loop, {.name = "line"}, {.device = pty.path(), .lines = config});
    std::string wrong = particles(35);
    wrong[2] = '\x0e';  // 3612 bytes
    const std::string all = particles(34) + wrong + particles(36) + particles(37) + "\x42\x4d";
    REQUIRE(pty.send(all) == all.size());
    for (int i = 0; i < 5000 && events.empty(); ++i) loop.run_for(1ms);
    loop.run_for(20ms);
    CHECK(events == std::vector<std::string>{"34"});
    pty.unplug();
    for (int i = 0; i < 5000 && sensor.health() != Health::faulted; ++i) loop.run_for(1ms);
    loop.run_for(5ms);
    CHECK(events == std::vector<std::string>{"34", "36", "37"});
    CHECK(sensor.counts().unreadable >= 1);
    CHECK(sensor.counts().balances());
  }

  TEST_CASE("US-13 a sensor that is stopped within a frame loses nothing; bytes outside of frames are told then") {
    CHECK(hear(pms5003, particles(35) + particles(36).substr(0, 20), 100, 1).counts.unreadable == 0);
    Heard heard = hear(pms5003, particles(35) + "no frame", 100, 1);
    CHECK(heard.counts.unreadable == 0);  // another may follow
    ScratchDirectory folder;
    Pty pty(folder.file("tty"));
    pty.plug_in();
    Loop loop;
    be_quiet(loop);
    LineConfig config = pms5003;
    config.first_line = FirstLine::keep;
    SerialLineSensor sensor(loop, {.name = "line"}, {.device = pty.path(), .lines = config});
    REQUIRE(pty.send(particles(35) + "no frame" + particles(36).substr(0, 20)) > 0);
    for (int i = 0; i < 5000 && sensor.counts().received < 2; ++i) loop.run_for(1ms);
    CHECK(sensor.counts().unreadable == 1);  // when a frame seems to begin
    REQUIRE(pty.send(particles(36).substr(20) + "garbage") > 0);
    for (int i = 0; i < 5000 && sensor.counts().published < 2; ++i) loop.run_for(1ms);
    loop.run_for(20ms);
    sensor.stop();
    CHECK(sensor.counts().published == 2);
    CHECK(sensor.counts().unreadable == 2);
  }

  TEST_CASE("US-13 bytes behind which no frame begins are told, though the device is not silent") {
    const Heard heard = hear(pms5003, particles(35) + "this is no frame", 100, 2);
    CHECK(heard.counts.unreadable == 1);
    REQUIRE(heard.errors.size() == 1);
    CHECK(heard.errors.front() == "16 bytes are discarded");
  }

  TEST_CASE("US-9 a sensor of frames that its own callback stops, or stops and starts, takes nothing twice") {
    for (const bool is_started_again : {false, true}) {
      CAPTURE(is_started_again);
      ScratchDirectory folder;
      Pty pty(folder.file("tty"));
      pty.plug_in();
      Loop loop;
      be_quiet(loop);
      LineConfig config = pms5003;
      config.first_line = FirstLine::keep;
      SerialLineSensor sensor(loop, {.name = "line"}, {.device = pty.path(), .lines = config});
      sensor.on_error([&](const ErrorReport&) {
        sensor.stop();
        if (is_started_again) sensor.start();
      });
      std::string wrong = particles(35);
      wrong.back() = static_cast<char>(wrong.back() ^ 1);
      const std::string all = particles(34) + wrong + particles(36);
      REQUIRE(pty.send(all) == all.size());
      for (int i = 0; i < 5000 && sensor.counts().received < 2; ++i) loop.run_for(1ms);
      loop.run_for(5ms);
      CHECK(sensor.counts().received == 2);
      CHECK(sensor.counts().unreadable == 1);
      if (is_started_again) {
        REQUIRE(pty.send(particles(37)) > 0);
        for (int i = 0; i < 5000 && sensor.counts().published < 2; ++i) loop.run_for(1ms);
        CHECK(sensor.counts().published == 2);
      }
      sensor.close();
      CHECK(loop.runtime().balances());
    }
  }

  TEST_CASE("US-13 texts for no value are written as the device writes its numbers") {
    const LineConfig german{
        .fields = {{.name = "v", .decimal = ',', .thousands = ".", .no_value = {"-999,9", "9.999"}}}, .separator = ';'};
    for (const char* const none : {"-999,9", "-999,90", "-0999,9", "9.999", "9999"})
      CHECK(values_of_line(german, none) == "absent");
    CHECK(values_of_line(german, "9,999") == "9.999");
    const LineConfig hex{.fields = {{.name = "v", .type = Kind::u16, .base = 16, .no_value = {"FFFF", "10"}}}};
    for (const char* const none : {"FFFF", "ffff", "0xFFFF", "10", "0x10"})
      CHECK(values_of_line(hex, none) == "absent");
    CHECK(values_of_line(hex, "0A") == "10");
    CHECK(values_of_line(hex, "16") == "22");
  }

  TEST_CASE("US-13 a line may end with another character") {
    const LineConfig lines{.fields = {{.name = "v"}}, .line_end = '\r'};
    CHECK(hear(lines, "1\r2\r\n3\r", 2, 3).events == std::vector<std::string>{"1", "2", "3"});
    const LineConfig marks{.fields = {{.name = "v"}}, .line_end = ';'};
    CHECK(hear(marks, "1;2;3;", 4, 3).events == std::vector<std::string>{"1", "2", "3"});
  }

  TEST_CASE("US-13 lines that are not meant count as filtered; settings that exclude each other are refused") {
    const LineConfig chosen{.fields = {{}, {.name = "v"}}, .only = LineMatch{.column = 1, .is = {"a"}}};
    const Heard heard = hear(chosen, "a,1\nb,x\na,2\n", 100, 3);
    CHECK(heard.events == std::vector<std::string>{"1", "2"});
    CHECK(heard.counts.filtered == 1);
    CHECK(heard.counts.unreadable == 0);

    const LineField field{.name = "v"};
    CHECK(has(refusal_of({.format = LineFormat::binary, .fields = {field}}), "frame: `format` binary needs a `frame`"));
    CHECK(has(
        refusal_of({.format = LineFormat::binary, .fields = {field}, .frame = LineFrame{.start = "x", .length = 9}}),
        "it has no place in the frame"));
    CHECK(refusal_of({.fields = {field}, .frame = LineFrame{}}) ==
          "frame: the beginning and the end of a frame are unknown");
    CHECK(has(refusal_of({.fields = {field}, .frame = LineFrame{.start = "x"}}), "the end of a frame is unknown"));
    CHECK(
        has(refusal_of({.fields = {field}, .frame = LineFrame{.start = "x", .start_hex = "78", .end = "y"}}), "both"));
    CHECK(has(refusal_of({.fields = {field}, .frame = LineFrame{.start_hex = "7", .end = "y"}}), "not bytes"));
    CHECK(has(refusal_of({.fields = {field}, .only = LineMatch{}}), "only: it does not say"));
    CHECK(has(refusal_of({.fields = {field}, .only = LineMatch{.key = "x", .is = {"1"}}}), "only JSON and labels"));
    CHECK(has(refusal_of({.format = LineFormat::json, .fields = {field}, .only = LineMatch{.column = 1, .is = {"1"}}}),
              "only CSV has columns"));
    CHECK(has(refusal_of({.fields = {field}, .checksum = LineChecksum{.type = ChecksumType::sum6}}), "one character"));
    CHECK(has(refusal_of({.fields = {field}, .checksum = LineChecksum{.optional = true}}),
              "whether a line has a checksum"));
    CHECK(has(refusal_of({.fields = {field}, .checksum = LineChecksum{.of = ChecksumOf::row}}),
              "`of` row works only with `format` labels"));
    const auto binary = [](LineField of) {
      return LineConfig{
          .format = LineFormat::binary, .fields = {std::move(of)}, .frame = LineFrame{.start = "x", .length = 4}};
    };
    CHECK(has(refusal_of(binary({.name = "v", .at = 1})), "it ends beyond the frame"));
    CHECK(has(refusal_of(binary({.name = "v", .type = Kind::u8, .at = 1, .no_value = {"256"}})),
              "its bytes or bits can never have"));
    CHECK(has(refusal_of(binary({.name = "v", .type = Kind::u8, .at = 1, .no_value = {"0xff"}})),
              "its bytes or bits can never have"));
    CHECK(has(refusal_of(binary({.name = "v", .type = Kind::u8, .optional = true, .at = 1})), "always exist"));
    CHECK(refusal_of(binary({.name = "v", .type = Kind::i8, .at = 1, .no_value = {"-128"}})).empty());
    for (LineConfig nmea : {LineConfig{.frame = LineFrame{.start = "$", .end = "x"}}, LineConfig{.line_end = '\r'},
                            LineConfig{.only = LineMatch{.begins = "$"}}, LineConfig{.checksum = LineChecksum{}}}) {
      nmea.format = LineFormat::nmea;
      CHECK_THROWS_AS((void)detail::decoder_of_lines(nmea), SetupError);
    }
    CHECK(has(refusal_of({.fields = {field}, .frame = LineFrame{.start = "xy", .length_at = 1}}), "within the start"));
    CHECK(has(refusal_of({.fields = {{.name = "v", .suffix = "kg "}}}), "never matches"));
    CHECK(has(refusal_of({.fields = {{.name = "v", .thousands = "e"}}}), "another meaning"));
    CHECK(has(refusal_of({.fields = {{.name = "v", .at = 1}}}), "only binary frames have"));
    CHECK(has(refusal_of({.fields = {{.name = "v", .column = 2}}}), "only labels have `column`"));
  }
}
