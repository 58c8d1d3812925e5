#include "rtdata/sensors/serial_line.hpp"

#include <doctest/doctest.h>

#include <concepts>
#include <cstdlib>
#include <fstream>
#include <map>
#include <sstream>
#include <thread>
#include <utility>

#include "has.hpp"
#include "io/tty.hpp"
#include "paths.hpp"
#include "recording/database.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/read.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "sensors/fixture.hpp"
#include "sensors/lines/line_decoder.hpp"
#include "sensors/pty.hpp"
#include "sensors/termios2.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using rtdata::test::has;

TEST_SUITE_BEGIN("sensors" * doctest::skip(!terminals_can_be_set_up()));

namespace {

/// A loop with a serial sensor at the end of a pty, and what comes out.
struct SerialLineBench {
  explicit SerialLineBench(LineConfig lines = {}, SerialSettings settings = {}) : pty(directory.file("tty")) {
    be_quiet(loop);
    pty.plug_in();
    make(std::move(lines), settings);
  }
  explicit SerialLineBench(std::nullptr_t) : pty(directory.file("tty")) { be_quiet(loop); }
  void make(LineConfig lines, SerialSettings settings = {}) {
    if (lines.fields.empty()) lines.fields = {{.name = "value"}};
    lines.retry_first = lines.retry_longest = 2ms;
    heard = loop.subscribe("line", [this](const EventView& event) {
      std::string text;
      for (const Leaf& leaf : event.description().leaves())
        text += (text.empty() ? "" : " ") + to_string(event.value(leaf));
      events.push_back(text);
      times.push_back(event.time());
    });
    sensor = SerialLineSensor(loop, {.name = "line"},
                              {.device = pty.path(), .serial = settings, .lines = std::move(lines)});
    sensor.on_error([this](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
  }
  /// Sends it all, running the loop, until `done`; gives up when nothing more happens for 10 s.
  template <std::predicate Done>
  void run(std::string_view text, Done done) {
    std::size_t sent = 0;
    Timer limit(loop, 60s, [&] { loop.stop(); });
    constexpr std::uint64_t most_queued = 200;  // a busy machine is to drop none
    Ticker feeder(loop, 1ms, [&](const Tick&) {
      while (sent < text.size() && sensor.counts().published < events.size() + most_queued) {
        const std::size_t now = pty.send(text.substr(sent, 4096));
        if (now == 0) break;
        sent += now;
        limit.start(60s);
      }
      if (sent == text.size() && done()) loop.stop();
    });
    loop.run();
  }
  void run(std::string_view text, std::uint64_t received) {
    run(text, [&] { return sensor.counts().received >= received && events.size() >= sensor.counts().published; });
  }

  ScratchDirectory directory;
  Pty pty;
  Loop loop;
  Subscription heard;
  SerialLineSensor sensor;
  std::vector<std::string> events;
  std::vector<Time> times;
  std::vector<std::string> errors;
};

struct Row {
  bool on = false;
  char c = 'x';
  std::int64_t n = 0;
  std::uint8_t small = 0;
  double x = 0;
  float f = 0;
  text<32> s;
  std::optional<double> maybe;
  std::optional<text<8>> word;
  RTDATA_FIELDS(Row, (on), (c), (n), (small), (x), (f), (s), (maybe), (word))
};

using Texts = std::vector<std::string>;

std::string id_of(detail::LineDecoder& decoder, std::string_view line) {
  const Result<void> done = decoder.decode(line);
  return done ? "ok" : std::string(done.error().id());
}

}  // namespace

TEST_CASE("US-17 US-35 what waited before a serial line was opened is not new") {
  for (const FirstLine first : {FirstLine::discard, FirstLine::keep}) {
    SerialLineBench b(nullptr);
    b.pty.plug_in();
    const std::string before = "1\n2\n3\n";
    REQUIRE(b.pty.send(before) == before.size());
    b.make({.first_line = first});
    b.run("4\n5\n6\n", first == FirstLine::keep ? 3 : 2);
    CHECK(b.events == (first == FirstLine::keep ? Texts{"4", "5", "6"} : Texts{"5", "6"}));
    CHECK(b.errors.empty());
  }
}

TEST_CASE("US-17 US-35 of a line whose beginning had waited the rest is no line, however long the device is silent") {
  for (const FirstLine first : {FirstLine::discard, FirstLine::keep}) {
    SerialLineBench b(nullptr);
    b.pty.plug_in();
    const std::string before = "1\n2\n3";
    REQUIRE(b.pty.send(before) == before.size());
    b.make({.first_line = first});
    b.loop.run_for(300ms);
    b.run("4\n5\n6\n", 2);
    CHECK(b.events == Texts{"5", "6"});
  }
}

TEST_CASE("US-17 a CSV line is decoded by its fields, and says what is wrong with it") {
  detail::LineDecoder decoder({.fields = {{.name = "a", .type = Kind::i16},
                                          {},
                                          {.name = "b", .scale = 0.5},
                                          {.name = "t", .type = Kind::text, .length = 4},
                                          {.name = "on", .type = Kind::boolean}}});
  REQUIRE(decoder.decode("-5, ignored ,+3, \"a,b\",1"));
  const auto value = [&](const char* path) {
    return to_string(read(*decoder.description()->find(path), decoder.payload()));
  };
  CHECK(value("a") == "-5");
  CHECK(value("b") == "1.5");
  CHECK(value("t") == "a,b");
  CHECK(value("on") == "true");
  CHECK(id_of(decoder, "40000,x,1,t,0") == "out-of-range");
  CHECK(id_of(decoder, "1,x,abc,t,0") == "not-a-number");
  CHECK(id_of(decoder, "1.5,x,1,t,0") == "not-a-number");
  CHECK(id_of(decoder, "1,x,1e999,t,0") == "out-of-range");
  CHECK(id_of(decoder, "1,x,,t,0") == "not-a-number");
  CHECK(id_of(decoder, "1,x,1,texts,0") == "does-not-fit");
  CHECK(id_of(decoder, "1,x,1,t,2") == "bad-data");
  CHECK(id_of(decoder, "1,x,1,t") == "bad-data");
  CHECK(id_of(decoder, "1,x,1,t,0,") == "bad-data");
  CHECK(id_of(decoder, std::string_view("1,\0,1,t,0", 9)) == "ok");
  CHECK(decoder.is_skipped("  \t"));
  CHECK(decoder.is_skipped("# comment"));
}

TEST_CASE("US-17 a CSV line is read as RFC 4180 writes it") {
  detail::LineDecoder decoder({.fields = {{.name = "a", .type = Kind::text}, {.name = "b", .type = Kind::text}}});
  const auto values = [&](std::string_view line) {
    const auto done = decoder.decode(line);
    if (!done) return std::string(done.error().why);
    const auto value = [&](const char* path) {
      return to_string(read(*decoder.description()->find(path), decoder.payload()));
    };
    return value("a") + "|" + value("b");
  };
  CHECK(values(R"("say ""hi"", please","")") == "say \"hi\", please|");
  CHECK(values(R"(" blanks " , "x")") == " blanks |x");
  CHECK(values(R"("""",b)") == "\"|b");
  CHECK(values(R"(6" pipe,b "quoted" b)") == "6\" pipe|b \"quoted\" b");
  CHECK(values(R"("a,b)") == "its quote is not closed");
  CHECK(values(R"("a"b,c)") == "\"b\" follows its quotes");
}

TEST_CASE("US-17 values as users write them, and cells without one") {
  detail::LineDecoder decoder({.fields = {{.name = "on", .type = Kind::boolean, .optional = true},
                                          {.name = "n", .type = Kind::u8, .optional = true},
                                          {.name = "x", .optional = true},
                                          {.name = "s", .type = Kind::text, .optional = true},
                                          {.name = "f", .type = Kind::f32},
                                          {.name = "c", .type = Kind::character, .optional = true}}});
  const auto values = [&](std::string_view line) {
    const auto done = decoder.decode(line);
    if (!done) return std::string(done.error().id());
    std::string all;
    for (const Leaf& leaf : decoder.description()->leaves()) all += to_string(read(leaf, decoder.payload())) + " ";
    return all;
  };
  CHECK(values("TRUE,-0,1e-400,t,1e-50,z") == "true 0 0 t 0 z ");
  CHECK(values("False,+7,-0,\"\",-1e-400,\xc3\xa4") == "false 7 -0  -0 \xc3\xa4 ");
  CHECK(values(",,,,1,") == "absent absent absent absent 1 absent ");
  CHECK(values(" , ,,\"\",1,") == "absent absent absent  1 absent ");
  CHECK(values("0,1,2,x,,c") == "not-a-number");
  CHECK(values("\"\",1,2,x,1,c") == "bad-data");
  CHECK(values("0,1,1e400,x,1,c") == "out-of-range");
  detail::LineDecoder json(
      {.format = LineFormat::json,
       .fields = {{.name = "a", .optional = true}, {.name = "b", .type = Kind::u8, .optional = true}}});
  const auto of_json = [&](std::string_view line) {
    REQUIRE(json.decode(line));
    return to_string(read(*json.description()->find("a"), json.payload())) + " " +
           to_string(read(*json.description()->find("b"), json.payload()));
  };
  CHECK(of_json(R"({"a":-0,"b":-0})") == "-0 0");
  CHECK(of_json(R"({"a":null})") == "absent absent");
  CHECK(of_json(R"({"b":3,"a":1e-400})") == "0 3");
  // As rt-data itself writes what is no number of JSON, and as nobody else does.
  CHECK(of_json(R"({"b":3,"a":"NaN"})") == "nan 3");
  CHECK(of_json(R"({"b":3,"a":"Infinity"})") == "inf 3");
  CHECK(of_json(R"({"b":3,"a":"-Infinity"})") == "-inf 3");
  CHECK(id_of(json, R"({"b":"NaN"})") == "not-a-number");
  CHECK(id_of(json, R"({"a":"none"})") == "not-a-number");
  CHECK(id_of(json, R"({"a":"1"})") == "ok");
  CHECK(id_of(json, R"({"a":1e400})") == "out-of-range");
  CHECK_THROWS_AS(
      detail::LineDecoder({.fields = {{.name = "n", .type = Kind::u8, .optional = true}}, .sequence_field = "n"}),
      SetupError);
}

TEST_CASE("a line that is separated by something else, or is a greeting, is answered with what to set") {
  const auto advice = [](const detail::LineDecoder& decoder, std::string_view line) {
    auto done = const_cast<detail::LineDecoder&>(decoder).decode(line);
    REQUIRE_FALSE(done);
    return done.error().text();
  };
  const detail::LineDecoder two({.fields = {{.name = "a"}, {.name = "b"}}});
  CHECK(advice(two, "123.7;20.1").find("the line seems to be separated by \";\": set `separator`") !=
        std::string::npos);
  CHECK(advice(two, "123.7 20.1").find("separated by blanks") != std::string::npos);
  CHECK(advice(two, "123.7\t20.1").find("separated by tabs") != std::string::npos);
  CHECK(advice(two, "1,2;3").find("separated") == std::string::npos);
  const std::string greeting = advice(detail::LineDecoder({.fields = {{.name = "a"}}}), "HX711 ready");
  CHECK(greeting.find("\"HX711 ready\" is not a number") != std::string::npos);
  CHECK(greeting.find("`skip_lines` or `comment`") != std::string::npos);
}

TEST_CASE("US-17 our own CSV comes back equal from a serial line") {
  std::vector<LineField> fields{
      {.name = "time", .type = Kind::i64},     {.name = "origin", .type = Kind::text},
      {.name = "sequence", .type = Kind::u64}, {.name = "on", .type = Kind::boolean},
      {.name = "c", .type = Kind::character},  {.name = "n", .type = Kind::i64},
      {.name = "small", .type = Kind::u8},     {.name = "x"},
      {.name = "f", .type = Kind::f32},        {.name = "s", .type = Kind::text},
      {.name = "maybe", .optional = true},     {.name = "word", .type = Kind::text, .optional = true}};
  for (LineField& field : fields) {  // events have these themselves
    if (field.name == "time" || field.name == "origin" || field.name == "sequence") field.name = "its_" + field.name;
  }
  detail::LineDecoder decoder({.fields = fields});
  const auto codec = make_csv_codec();
  std::vector<Row> rows(5);
  rows[1] = {true, '\xe4', -5, 255, -0.0, 1e-45F, "a,\"b\" ", 1e-300, ""};
  rows[2] = {
      false, '"', std::numeric_limits<std::int64_t>::min(), 0, std::numeric_limits<double>::infinity(), 0.1F, "\"",
      {},    ","};
  rows[3] = {false, ' ', 1, 1, std::numeric_limits<double>::denorm_min(), -0.0F, " # \xc3\xa4\t", 0.1, {}};
  rows[4] = {true, ',', 7, 9, std::numeric_limits<double>::quiet_NaN(), 3, "\xe2\x82\xac", {}, {}};
  for (const Row& row : rows) {
    std::vector<std::byte> bytes;
    encode(*codec, "t", Event<Row>{{Time{5s}, 3, "o, \"p\""}, row}, bytes).or_throw();
    const std::string line(reinterpret_cast<const char*>(bytes.data()), bytes.size() - 1);
    CAPTURE(line);
    REQUIRE(decoder.decode(line));
    const auto& leaves = description_of<Row>()->leaves();
    for (std::size_t i = 0; i < leaves.size(); ++i) {
      const Value sent = read(leaves[i], reinterpret_cast<const std::byte*>(&row));
      const Value got = read(decoder.description()->leaves()[3 + i], decoder.payload());
      CAPTURE(leaves[i].path);
      CHECK(to_string(got) == to_string(sent));
    }
    CHECK(to_string(read(decoder.description()->leaves()[1], decoder.payload())) == "o, \"p\"");
  }
}

TEST_CASE("US-17 columns may be separated by blanks") {
  detail::LineDecoder decoder({.fields = {{.name = "a"}, {.name = "b"}}, .separator = ' '});
  REQUIRE(decoder.decode("  1    2.5  "));
  CHECK(to_string(read(*decoder.description()->find("b"), decoder.payload())) == "2.5");
  CHECK(id_of(decoder, "1 2 3") == "bad-data");
}

TEST_CASE("US-17 a JSON line is decoded by keys, nested ones too, and says what is wrong with it") {
  detail::LineDecoder decoder({.format = LineFormat::json,
                               .fields = {{.name = "ax", .key = "imu.ax"},
                                          {.name = "n", .type = Kind::u8},
                                          {.name = "s", .type = Kind::text},
                                          {.name = "on", .type = Kind::boolean}}});
  REQUIRE(decoder.decode(
      R"({"x":[1,{"n":9},[2]],"s":"h\u00e9","imu":{"ay":1,"ax":-1.25e1},"n":255,"on":true,"more":{"n":3}})"));
  const auto value = [&](const char* path) {
    return to_string(read(*decoder.description()->find(path), decoder.payload()));
  };
  CHECK(value("ax") == "-12.5");
  CHECK(value("n") == "255");
  CHECK(value("s") == "h\u00e9");
  CHECK(value("on") == "true");
  for (const char* bad :
       {"", "5", "null", "[1]", "{", "{}", "{]", R"({"imu":1,"n":1,"s":"","on":true})",
        R"({"imu":{"ax":1},"n":1,"s":"","on":true} x)", R"({"imu":{"ax":1},"n":1,"n":1,"s":"","on":true})",
        R"({"imu":{"ax":1},"n":1,"s":5,"on":true})"}) {
    CAPTURE(bad);
    CHECK(id_of(decoder, bad) == "bad-data");
  }
  CHECK(id_of(decoder, R"({"imu":{"ax":1},"n":256,"s":"","on":true})") == "out-of-range");
  CHECK(id_of(decoder, R"({"imu":{"ax":"x"},"n":1,"s":"","on":true})") == "not-a-number");
  CHECK(id_of(decoder, R"({"imu":{"ax":null},"n":1,"s":"","on":true})") == "not-a-number");
  CHECK(id_of(decoder, std::string(5000, '[')) == "bad-data");
  CHECK(id_of(decoder, "{\"a\":\"\xff\xfe\"}") == "bad-data");
}

TEST_CASE("US-17 numbers of lines tell what was lost and what was repeated") {
  const auto steps = [](Kind kind, std::initializer_list<const char*> lines) {
    detail::LineDecoder decoder({.fields = {{.name = "n", .type = kind}}, .sequence_field = "n"});
    std::string text;
    for (const char* line : lines) {
      REQUIRE(decoder.decode(line));
      const auto step = decoder.step();
      text += step.is_repeated ? "r " : std::to_string(step.lost) + " ";
    }
    return text;
  };
  CHECK(steps(Kind::u32, {"7", "8", "8", "12", "13"}) == "0 0 r 3 0 ");
  CHECK(steps(Kind::u8, {"254", "255", "0", "2"}) == "0 0 0 1 ");
  CHECK(steps(Kind::u32, {"5000000", "0", "1"}) == "0 0 0 ");  // started again
  CHECK(steps(Kind::u32, {"4294967290", "0", "1"}) == "0 5 0 ");
  CHECK(steps(Kind::i32, {"-2", "-1", "0", "3"}) == "0 0 0 2 ");
  CHECK(steps(Kind::i32, {"100", "0"}) == "0 0 ");
  CHECK(steps(Kind::u64, {"18446744073709551615", "0"}) == "0 0 ");
}

TEST_CASE("US-17 fields and settings that cannot work are refused") {
  Loop loop{Loop::Manual{}};
  const auto refuses = [&](SerialConfig config) {
    CHECK_THROWS_AS(SerialLineSensor(loop, {.name = "bad"}, std::move(config)), SetupError);
  };
  refuses({.lines = {.fields = {{.name = "a"}}}});
  refuses({.device = "/dev/x"});
  refuses({.device = "/dev/x", .lines = {.fields = {{}}}});
  refuses({.device = "/dev/x", .lines = {.fields = {{.name = "a"}, {.name = "A"}}}});
  refuses({.device = "/dev/x", .lines = {.fields = {{.name = "time"}}}});
  refuses({.device = "/dev/x", .lines = {.fields = {{.name = "a", .type = Kind::record}}}});
  refuses({.device = "/dev/x", .lines = {.fields = {{.name = "a", .type = Kind::i32, .scale = 2}}}});
  refuses({.device = "/dev/x", .lines = {.fields = {{.name = "a"}}, .sequence_field = "a"}});
  refuses({.device = "/dev/x", .lines = {.fields = {{.name = "a"}}, .sequence_field = "b"}});
  refuses({.device = "/dev/x", .serial = {.character_size = 4}, .lines = {.fields = {{.name = "a"}}}});
  refuses({.device = "/nowhere/tty", .lines = {.fields = {{.name = "a"}}}, .required = true});
}

TEST_CASE("US-13 the line is raw, at any speed, and this program's alone") {
  for (const unsigned speed : {9600u, 115200u, 250000u, 74880u}) {
    CAPTURE(speed);
    SerialLineBench bench({}, {.baud_rate = speed});
    const TerminalSettings settings = terminal_settings(bench.pty.device());
    CHECK(settings.output_speed == speed);
    CHECK(settings.input_speed == speed);
    CHECK(settings.local_flags == 0);
    CHECK(settings.is_exclusive);
    const auto second = detail::open_tty(bench.pty.path(), {});
    REQUIRE(!second);
    CHECK(second.error().code == Errc::busy);
    bench.sensor.stop();
    CHECK(!terminal_settings(bench.pty.device()).is_exclusive);
    const auto third = detail::open_tty(bench.pty.path(), {});
    REQUIRE(third);
    detail::close_tty(*third);
  }
}

TEST_CASE("US-5 lines come out as events, the half line at the start does not") {
  SerialLineBench bench;
  bench.run("alf\n1.5\r\r\n\n# comment\n-2\n3", 2);
  CHECK(bench.events == Texts{"1.5", "-2"});
  bench.run("5\n", 3);
  CHECK(bench.events == Texts{"1.5", "-2", "35"});
  CHECK(bench.errors.empty());
  CHECK(bench.sensor.counts().received == 3);
  CHECK(bench.sensor.counts().published == 3);
  CHECK(bench.sensor.counts().first_lines == 1);
  CHECK(!bench.sensor.counts().lost_is_known);
  CHECK(bench.sensor.counts().balances());
  CHECK(std::is_sorted(bench.times.begin(), bench.times.end()));
}

TEST_CASE("US-5 the first line is kept where nothing came for 100 ms after the opening, or is thrown away and told") {
  SerialLineBench button;
  button.run("", [&, end = MonotonicTime{}]() mutable {
    if (end == MonotonicTime{}) end = button.loop.now() + 150ms;
    return button.loop.now() >= end;
  });
  button.run("1\n0\n", 2);
  CHECK(button.events == Texts{"1", "0"});
  CHECK(button.sensor.counts().first_lines == 0);

  SerialLineBench slow;  // half of a line, and the rest later
  slow.run("5", [&, end = MonotonicTime{}]() mutable {
    if (end == MonotonicTime{}) end = slow.loop.now() + 150ms;
    return slow.loop.now() >= end;
  });
  slow.run("0\n2\n", 1);
  CHECK(slow.events == Texts{"2"});
  CHECK(slow.sensor.counts().first_lines == 1);

  SerialLineBench held;  // when it came is not known
  held.pty.send("50\n");
  std::this_thread::sleep_for(150ms);
  held.run("2\n", 1);
  CHECK(held.events == Texts{"2"});
  CHECK(held.sensor.counts().first_lines == 1);
  CHECK_FALSE(held.loop.runtime().has_loss());
  CHECK(held.sensor.counts().balances());
}

TEST_CASE("US-5 a first line that was thrown away is in the recording, and no loss") {
  ScratchDirectory folder;
  const std::string path = folder.file("run.db");
  const auto record = [&] {
    SerialLineBench bench;
    bench.pty.send("5\n1\n2\n");  // at once: after 100 ms of silence a first line is kept
    SqliteSink sink(bench.loop, {.path = path});
    bench.run("", 2);
    bench.sensor.close();
    sink.close();
  };
  record();
  const auto first_lines = [&](std::int64_t run) {
    return Recording::open(path).or_throw().ledger(run).or_throw().at(0).sensor.first_lines;
  };
  CHECK(first_lines(1) == 1);
  const VerifyReport report = verify(Recording::open(path).or_throw()).or_throw();
  CHECK(report.verdict() == Verdict::balanced);
  CHECK(report.runs.at(0).losses.empty());
  CHECK(report.runs.at(0).first_lines == std::map<std::string, std::uint64_t>{{"line", 1}});
  CHECK(has(report.text(), "nothing lost: 2 rows"));
  CHECK(has(report.text(), "1 first line of line discarded: the port was opened in the middle of a line"));
  CHECK(has(report.to_json(), R"("first_lines": {)"));
  CHECK(summary(Recording::open(path).or_throw(), 1).or_throw().at(0).first_lines == 1);
}

TEST_CASE("US-5 the first lines can be kept, or skipped as a heading") {
  SerialLineBench keep({.first_line = FirstLine::keep});
  keep.run("1\n2\n", 2);
  CHECK(keep.events == Texts{"1", "2"});
  SerialLineBench skip({.skip_lines = 2, .first_line = FirstLine::keep});
  skip.run("value\nvolts\n3\n", 1);
  CHECK(skip.events == Texts{"3"});
}

TEST_CASE("US-5 a byte order mark before the first line does not count") {
  SerialLineBench bench({.first_line = FirstLine::keep});
  bench.run(
      "\xef\xbb\xbf"
      "1\n2\n\xef\xbb\xbf"
      "3\n",
      3);
  CHECK(bench.events == Texts{"1", "2"});
  CHECK(bench.errors == Texts{"not-a-number"});
}

TEST_CASE("US-5 bad lines are counted and reported, and cost no other line anything") {
  SerialLineBench bench({.first_line = FirstLine::keep, .max_line = 64});
  bench.run("1\ngarbage\n2\n1,2\n\xff\xfe\n1e999\n3\n" + std::string(65, '1') + "\n" + std::string(64, '0') + "\n", 9);
  CHECK(bench.events == Texts{"1", "2", "3", "0"});
  CHECK(bench.errors == Texts{"not-a-number", "bad-data", "not-a-number", "out-of-range", "does-not-fit"});
  CHECK(bench.sensor.counts().unreadable == 5);
  CHECK(bench.sensor.counts().failed == 0);
  CHECK(bench.sensor.counts().balances());
  CHECK(bench.sensor.health() == Health::ok);
}

TEST_CASE("US-5 a line of a megabyte is one error") {
  SerialLineBench bench({.first_line = FirstLine::keep});
  bench.run("1\n" + std::string(1 << 20, 'x') + "\n2\n", 3);
  CHECK(bench.events == Texts{"1", "2"});
  CHECK(bench.errors == Texts{"does-not-fit"});
  CHECK(bench.sensor.counts().received == 3);
  CHECK(bench.sensor.counts().balances());
}

TEST_CASE("US-5 the device's own numbers say what was lost") {
  SerialLineBench bench({.fields = {{.name = "n", .type = Kind::u32}, {.name = "value"}},
                         .first_line = FirstLine::keep,
                         .sequence_field = "n"});
  bench.run("1,1\n2,2\n2,2\n6,6\n", 4);
  CHECK(bench.events == Texts{"1 1", "2 2", "6 6"});
  CHECK(bench.sensor.counts().lost == 3);
  CHECK(bench.sensor.counts().lost_is_known);
  CHECK(bench.sensor.counts().repeated == 1);
  CHECK(bench.sensor.counts().balances());
}

TEST_CASE("US-5 a wrong digit in a number is one line that cannot be used, and nothing is lost") {
  struct Case {
    const char* what;
    const char* lines;
    Texts events;
    std::uint64_t lost, unreadable;
  };
  const std::vector<Case> cases{
      {"a digit is lost", "1149,1\n150,2\n1151,3\n1152,4\n", {"1149 1", "1151 3", "1152 4"}, 0, 1},
      {"a digit is wrong", "1149,1\n9150,2\n1151,3\n", {"1149 1", "1151 3"}, 0, 1},
      {"and lines are lost as well", "1149,1\n9150,2\n1155,3\n1156,4\n", {"1149 1", "1155 3", "1156 4"}, 4, 1},
      {"two wrong ones", "1,1\n92,2\n83,3\n4,4\n5,5\n", {"1 1", "4 4", "5 5"}, 0, 2},
      {"lines are lost", "1149,1\n1200,2\n1201,3\n", {"1149 1", "1200 2", "1201 3"}, 50, 0},
      {"the device starts again", "1149,1\n1,2\n2,3\n", {"1149 1", "1 2", "2 3"}, 0, 0},
      {"the jump comes last", "1149,1\n1200,2\n", {"1149 1", "1200 2"}, 50, 0},
      {"it is said twice", "1149,1\n1200,2\n1200,2\n", {"1149 1", "1200 2"}, 50, 0},
      {"unreadable ones beside it", "1,1\n3,x\n99,3\nx\n5,5\n", {"1 1", "5 5"}, 0, 3},
  };
  for (const Case& one : cases) {
    CAPTURE(one.what);
    SerialLineBench bench({.fields = {{.name = "n", .type = Kind::u32}, {.name = "value"}},
                           .first_line = FirstLine::keep,
                           .sequence_field = "n",
                           .silence = 20ms});
    const std::string_view lines = one.lines;
    bench.run(lines, static_cast<std::uint64_t>(std::count(lines.begin(), lines.end(), '\n')));
    CHECK(bench.events == one.events);
    CHECK(bench.sensor.counts().lost == one.lost);
    CHECK(bench.sensor.counts().unreadable == one.unreadable);
    CHECK(bench.sensor.counts().balances());
    CHECK(std::is_sorted(bench.times.begin(), bench.times.end()));
  }
}

TEST_CASE("US-5 a numbered line that is held is published at a stop") {
  SerialLineBench bench(
      {.fields = {{.name = "n", .type = Kind::u32}}, .first_line = FirstLine::keep, .sequence_field = "n"});
  bench.run("1\n", 1);
  bench.pty.send("5\n");
  bench.loop.run_for(50ms);
  CHECK(bench.sensor.counts().received == 1);
  bench.sensor.stop();
  CHECK(bench.sensor.counts().received == 2);
  CHECK(bench.sensor.counts().lost == 3);
  CHECK(bench.sensor.counts().balances());
}

TEST_CASE("US-5 a numbered line that cannot be used is unreadable, and not lost too") {
  SerialLineBench bench({.fields = {{.name = "n", .type = Kind::u32}, {.name = "value"}},
                         .first_line = FirstLine::keep,
                         .max_line = 64,
                         .sequence_field = "n"});
  // 2 and 3 are no use; of 5 to 8 one came, too long; what came beside the numbers explains none that are missing
  // later.
  bench.run("1,1\n2,x\n3\n4,4\n6," + std::string(80, '6') + "\n9,9\nnoise\n10,10\n12,12\n", 9);
  CHECK(bench.events == Texts{"1 1", "4 4", "9 9", "10 10", "12 12"});
  const SensorCounts counts = bench.sensor.counts();
  CHECK(counts.unreadable == 4);
  CHECK(counts.lost == 3 + 1);
  CHECK(counts.received == 9);
  CHECK(counts.balances());
}

TEST_CASE("US-5 a device that ends no line, as at the wrong speed, is degraded, and recovers") {
  for (const FirstLine first : {FirstLine::discard, FirstLine::keep}) {
    SerialLineBench bench({.first_line = first, .max_line = 64});
    bench.run(std::string(4096 + 2000, '\x7f'), [&] { return bench.sensor.health() == Health::degraded; });
    CHECK(bench.errors.size() == 1);
    CHECK(bench.sensor.counts().unreadable == 1);
    CHECK(bench.sensor.counts().balances());
    bench.run("\n7\n", [&] { return bench.events == Texts{"7"}; });
    CHECK(bench.sensor.health() == Health::ok);
    CHECK(bench.errors.size() == 1);
  }
}

TEST_CASE("US-5 a device that never ended a line is told of at the end, though little came") {
  for (const FirstLine first : {FirstLine::discard, FirstLine::keep}) {
    SerialLineBench bench({.first_line = first});
    std::size_t turns = 0;
    bench.run("\x7f\x7f\x7f\x7f", [&] { return ++turns > 20; });
    CHECK(bench.errors.empty());  // the rest of the line may still come
    bench.sensor.stop();
    CHECK(bench.errors == Texts{"bad-data"});
    CHECK(bench.sensor.health() == Health::degraded);
    CHECK(bench.sensor.counts().unreadable == 1);
    CHECK(bench.sensor.counts().balances());
    CHECK(bench.loop.runtime().has_loss());
  }
  SerialLineBench bench({.first_line = FirstLine::keep});  // half a line after others is none
  bench.run("1\n2", 1);
  bench.loop.close();
  CHECK(bench.errors.empty());
}

TEST_CASE("US-5 a line unplugged, or silent for too long, has gaps in the recording") {
  ScratchDirectory folder;
  SerialLineBench bench({.first_line = FirstLine::keep, .silence = 20ms});
  const std::string path = folder.file("run.db");
  {
    SqliteSink sink(bench.loop, {.path = path});
    bench.run("1\n", 1);
    bench.run("", [&] { return bench.sensor.health() == Health::degraded; });
    CHECK(bench.errors.back() == "timed-out");
    bench.run("2\n", [&] { return bench.events.size() == 2 && bench.sensor.health() == Health::ok; });
    bench.pty.unplug();
    bench.run("", [&] { return bench.sensor.health() == Health::faulted; });
    bench.pty.plug_in();
    bench.run("3\n", 3);
    CHECK(bench.sensor.status().outages.number >= 2);
    CHECK(bench.sensor.status().outages.time >= 20ms);
    CHECK(bench.loop.runtime().has_loss());
    bench.sensor.close();
    sink.close();
  }
  const auto recording = Recording::open(path).or_throw();
  const auto gaps = recording.gaps(1).or_throw();
  REQUIRE(gaps.size() >= 2);
  CHECK(gaps[0].kind == "silent");
  CHECK(gaps[0].last - gaps[0].first >= 20ms);
  CHECK(std::any_of(gaps.begin(), gaps.end(), [](const RecordedGap& gap) {
    return gap.kind == "disconnected" && gap.reason == "disconnected" && gap.last > gap.first;
  }));
  for (const RecordedGap& gap : gaps) CHECK(gap.count == 0);
  CHECK(verify(recording).or_throw().problems.empty());
  CHECK(verify(recording).or_throw().verdict() == Verdict::balanced);
}

TEST_CASE("US-5 a line that brings halves of lines before it is lost again was absent all the time") {
  ScratchDirectory folder;
  SerialLineBench bench({.first_line = FirstLine::keep});
  const std::string path = folder.file("run.db");
  {
    SqliteSink sink(bench.loop, {.path = path});
    const auto lose = [&] {
      bench.pty.unplug();
      bench.run("", [&] { return bench.sensor.health() == Health::faulted; });
      bench.pty.plug_in();
    };
    bench.run("1\n", 1);
    lose();
    for (int round = 0; round < 2; ++round) {
      int turns = 0;
      bench.run("2", [&] { return ++turns > 30; });
      lose();
    }
    bench.run("3\n", 2);
    lose();  // and one that brings nothing, which may be: nobody has pressed the button
    int turns = 0;
    bench.run("", [&] { return ++turns > 30; });
    lose();
    bench.run("4\n", 3);
    bench.sensor.close();
    sink.close();
  }
  const auto gaps = Recording::open(path).or_throw().gaps(1).or_throw();
  REQUIRE(gaps.size() == 5);
  CHECK(gaps[1].first == gaps[0].last);
  CHECK(gaps[1].last - gaps[1].first >= 20ms);
  CHECK(gaps[2].first == gaps[1].last);
  CHECK(gaps[4].first - gaps[3].last >= 20ms);
  CHECK(verify(Recording::open(path).or_throw()).or_throw().verdict() == Verdict::balanced);
}

TEST_CASE("NFR-1 an unplugged line is faulted, and goes on when it is plugged in again") {
  SerialLineBench bench({.first_line = FirstLine::keep});
  for (int round = 1; round <= 3; ++round) {
    CAPTURE(round);
    bench.run("1\n2\n", static_cast<std::uint64_t>(2 * round));
    CHECK(bench.sensor.health() == Health::ok);
    bench.pty.unplug();
    bench.errors.clear();
    bench.run("", [&] { return bench.errors.size() >= 3; });
    CHECK(bench.sensor.health() == Health::faulted);
    CHECK(bench.errors[0] == "disconnected");
    CHECK(bench.errors[2] == "not-found");
    bench.pty.plug_in();
    // What is sent before the sensor has opened the line waits in the kernel.
  }
  bench.run("7\n", 7);
  CHECK(bench.events.size() == 7);
  CHECK(bench.sensor.counts().unreadable == 0);
  CHECK(bench.sensor.counts().balances());
}

TEST_CASE("lines that are not there are not tried in step, after delays that double") {
  Loop loop{Loop::Manual{}};
  be_quiet(loop);
  const std::string names[] = {"one", "two", "three"};
  std::map<std::string, std::vector<Duration>> delays;
  std::vector<SerialLineSensor> sensors;
  for (const std::string& name : names) {
    SerialConfig config{.device = "/nowhere/tty",
                        .lines = {.fields = {{.name = "value"}}, .retry_first = 1s, .retry_longest = 4s}};
    auto& sensor = sensors.emplace_back(SerialLineSensor(loop, {.name = name}, std::move(config)));
    sensor.on_error([&, name, last = loop.now()](const ErrorReport&) mutable {
      delays[name].push_back(loop.now() - std::exchange(last, loop.now()));
    });
  }
  loop.advance(1min);
  for (const std::string& name : names) {
    CAPTURE(name);
    REQUIRE(delays[name].size() > 4);
    for (std::size_t i = 0; i < delays[name].size(); ++i) {
      const Duration longest = i == 0 ? 1s : i == 1 ? 2s : 4s;
      CHECK(delays[name][i] <= longest);
      CHECK(delays[name][i] >= longest * 3 / 4);
    }
  }
  CHECK(delays["one"] != delays["two"]);
  CHECK(delays["two"] != delays["three"]);
}

TEST_CASE("US-7 a line that is not there at the start is opened when it is") {
  SerialLineBench bench(nullptr);
  bench.make({.first_line = FirstLine::keep});
  CHECK(bench.sensor.health() == Health::faulted);
  bench.run("", [&] { return bench.errors.size() >= 2; });
  bench.pty.plug_in();
  bench.run("4\n", 1);
  CHECK(bench.events == Texts{"4"});
  CHECK(bench.sensor.health() == Health::ok);
}

TEST_CASE("US-9 stopping and closing from its own callbacks is possible, and nothing comes afterwards") {
  SerialLineBench bench({.first_line = FirstLine::keep});
  bench.sensor.on_error([&](const ErrorReport&) { bench.sensor.stop(); });
  bench.run("1\nx\n3\n", [&] { return !bench.sensor.is_running(); });
  bench.loop.poll();
  CHECK(bench.events.empty());  // "1" was queued, and is cancelled
  CHECK(bench.sensor.counts().received == 2);
  bench.sensor.start();
  bench.run("5\n", [&] { return !bench.events.empty(); });
  CHECK(bench.events == Texts{"5"});
  bench.sensor.on_error([&](const ErrorReport&) { bench.sensor.close(); });
  bench.run("x\n6\n", [&] { return !bench.sensor.is_open(); });
  bench.loop.poll();
  CHECK(bench.events == Texts{"5"});
  CHECK(bench.loop.runtime().balances());
}

TEST_CASE("US-17 every parameter of a serial line can be set from a file") {
  const ConfigItem item = parse_config(R"({
    "device": "/dev/ttyUSB0", "baud_rate": 250000, "character_size": 7, "parity": "mark", "stop_bits": 2, "format": "json",
    "fields": [{"name": "a", "type": "uint32", "key": "x.a"}, {"name": "b", "unit": "V", "scale": 0.1}, {"name": "c", "type": "text", "length": 9}],
    "separator": ";", "comment": "//", "skip_lines": 3, "first_line": "keep", "max_line": 128, "sequence_field": "a",
    "silence": "10 s", "retry_first": "1 s", "retry_longest": "1 min", "required": true, "start": false})")
                              .root;
  const auto config = read_config<SerialConfig>(item);
  CHECK(config.device == "/dev/ttyUSB0");
  CHECK(config.serial.baud_rate == 250000);
  CHECK(config.serial.character_size == 7);
  CHECK(config.serial.parity == Parity::mark);
  CHECK(config.serial.stop_bits == 2);
  const LineConfig& lines = config.lines;
  CHECK(lines.format == LineFormat::json);
  REQUIRE(lines.fields.size() == 3);
  CHECK(lines.fields[0].type == Kind::u32);
  CHECK(lines.fields[0].key == "x.a");
  CHECK(lines.fields[1].scale == 0.1);
  CHECK(lines.fields[2].length == 9);
  CHECK(lines.separator == ';');
  CHECK(lines.comment == "//");
  CHECK(lines.skip_lines == 3);
  CHECK(lines.first_line == FirstLine::keep);
  CHECK(lines.max_line == 128);
  CHECK(lines.sequence_field == "a");
  CHECK(lines.silence == 10s);
  CHECK(lines.retry_first == 1s);
  CHECK(lines.retry_longest == 1min);
  CHECK(config.required);
  CHECK(!lines.start);
  CHECK(parameters_of<SerialConfig>().size() == 31);
}

TEST_CASE("US-5 every row of a real flight comes out of the line") {
  const char* const from_outside = std::getenv("RTDATA_TEST_DATA");
  const std::string folder = from_outside != nullptr ? from_outside : rtdata::test::in_source("../shared/data");
  std::ifstream file(folder + "/flight/tars_barometer.csv");
  if (!file) {
    MESSAGE("skipped: no flight data in " << folder << " (RTDATA_TEST_DATA names another folder)");
    return;
  }
  std::string text;
  Texts rows;
  for (std::string line; std::getline(file, line); text += line + "\n") rows.push_back(line);
  rows.erase(rows.begin());  // the heading, thrown away as the half line that it could be
  SerialLineBench bench({.fields = {{.name = "stamp", .type = Kind::u64, .unit = "us"},
                                    {.name = "has_data", .type = Kind::boolean},
                                    {.name = "temperature", .unit = "Cel"},
                                    {.name = "altitude", .unit = "m"},
                                    {.name = "pressure", .unit = "hPa"}}},
                        {.baud_rate = 115200});
  bench.run(text, rows.size());
  REQUIRE(bench.events.size() == rows.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const auto column = [&](std::size_t number) {
      std::size_t begin = 0;
      while (number-- != 0) begin = rows[i].find(',', begin) + 1;
      return std::strtod(rows[i].c_str() + begin, nullptr);
    };
    std::istringstream event(bench.events[i]);
    double stamp = 0, temperature = 0, altitude = 0, pressure = 0;
    std::string has_data;
    event >> stamp >> has_data >> temperature >> altitude >> pressure;
    if (stamp == column(0) && temperature == column(2) && altitude == column(3) && pressure == column(4)) continue;
    FAIL_CHECK("row " << i << ": " << rows[i] << " came out as " << bench.events[i]);
  }
  CHECK(bench.sensor.counts().failed == 0);
  CHECK(bench.sensor.counts().balances());
}

TEST_CASE("US-13 a device that sends only after a request is asked at each opening") {
  ScratchDirectory folder;
  Pty pty(folder.file("tty"));
  pty.plug_in();
  Loop loop;
  be_quiet(loop);
  SerialLineSensor sensor(loop, {.name = "s"},
                          {.device = pty.path(),
                           .at_open = {"SI\r\n"},
                           .at_open_hex = {"01 c8 00"},
                           .lines = {.fields = {{.name = "v"}}, .retry_first = 10ms, .retry_longest = 10ms}});
  std::string got;
  const auto heard = [&](const std::string& wanted) {
    for (int i = 0; i < 5000 && got.size() < wanted.size(); ++i) {
      loop.run_for(1ms);
      char bytes[64];
      if (const ssize_t size = ::read(pty.master(), bytes, sizeof bytes); size > 0)
        got.append(bytes, static_cast<std::size_t>(size));
    }
    return got == wanted;
  };
  const std::string wanted("SI\r\n\x01\xc8\x00", 7);
  CHECK(heard(wanted));
  pty.unplug();
  for (int i = 0; i < 5000 && sensor.health() != Health::faulted; ++i) loop.run_for(1ms);
  pty.plug_in();
  got.clear();
  CHECK(heard(wanted));
  SerialConfig wrong{.device = pty.path(), .at_open_hex = {"1"}, .lines = {.fields = {{.name = "v"}}}};
  CHECK_THROWS_AS(SerialLineSensor(loop, {.name = "w"}, wrong), SetupError);
}

TEST_CASE("US-13 sensors of one device share it: each takes its own lines, and none misses any when another stops") {
  ScratchDirectory folder;
  Pty pty(folder.file("tty"));
  pty.plug_in();
  Loop loop;
  be_quiet(loop);
  std::vector<std::string> events;
  const auto heard = loop.subscribe("#", [&](const EventView& event) {
    if (!event.topic().starts_with("$"))
      events.push_back(std::string(event.topic()) + to_string(event.value(event.description().leaves()[0])));
  });
  const auto config = [&](const char* word) {
    return SerialConfig{.device = pty.path(),
                        .lines = {.fields = {{.name = ""}, {.name = "v"}},
                                  .only = LineMatch{.column = 1, .is = {word}},
                                  .first_line = FirstLine::keep,
                                  .retry_first = 10ms,
                                  .retry_longest = 10ms}};
  };
  SerialLineSensor wind(loop, {.name = "wind"}, config("W"));
  SerialLineSensor depth(loop, {.name = "depth"}, config("D"));
  SerialConfig other = config("X");
  other.serial.baud_rate = 4800;
  other.required = true;
  CHECK_THROWS_AS(SerialLineSensor(loop, {.name = "other"}, other), SetupError);
  const auto send = [&](const std::string& text, std::size_t count) {
    REQUIRE(pty.send(text) == text.size());
    for (int i = 0; i < 5000 && events.size() < count; ++i) loop.run_for(1ms);
  };
  send("W,1\nD,2\nW,3\nZ,0\nD,", 3);
  send("4\n", 4);
  std::sort(events.begin(), events.end());
  CHECK(events == std::vector<std::string>{"depth2", "depth4", "wind1", "wind3"});
  CHECK(wind.counts().filtered == 3);
  CHECK(depth.counts().filtered == 3);
  wind.stop();  // it has opened the line
  send("D,5\nW,6\nD,7\n", 6);
  CHECK(events.size() == 6);
  CHECK(events.back() == "depth7");
  wind.start();  // it finds the line open, and drops none of what the other one is still to read
  send("W,8\nD,9\n", 8);
  CHECK(std::count(events.begin(), events.end(), "wind8") == 1);
  CHECK(std::count(events.begin(), events.end(), "depth9") == 1);
  // One that closes another while bytes are given.
  auto last = std::make_unique<SerialLineSensor>(loop, FeedConfig{.name = "last"}, config("L"));
  const auto closing = loop.subscribe("wind", [&](const EventView&) { last.reset(); });
  send("L,1\n", 9);
  send("W,10\nL,2\nD,11\n", 12);
  CHECK(last == nullptr);
  CHECK(std::count(events.begin(), events.end(), "depth11") == 1);
  pty.unplug();
  for (int i = 0; i < 5000 && (wind.health() != Health::faulted || depth.health() != Health::faulted); ++i)
    loop.run_for(1ms);
  CHECK(wind.health() == Health::faulted);
  CHECK(depth.health() == Health::faulted);
  pty.plug_in();
  const std::uint64_t wind_before = wind.counts().published, depth_before = depth.counts().published;
  for (int i = 0; i < 500; ++i) {
    pty.send("W,0\nD,0\n");
    loop.run_for(10ms);
    if (wind.counts().published > wind_before && depth.counts().published > depth_before) break;
  }
  loop.run_for(50ms);
  CHECK(wind.health() == Health::ok);
  CHECK(depth.health() == Health::ok);
  const std::size_t before = events.size();
  send("W,12\nD,13\n", before + 2);
  CHECK(events.size() == before + 2);
  wind.close();
  depth.close();
  CHECK(loop.runtime().balances());
}
TEST_SUITE_END();
