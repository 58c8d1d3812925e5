// What one reader gets, line by line, and the ring that its events come through.
#include "app/control/event_stream.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <thread>

#include "app/control/live_feed.hpp"
#include "app/inspect/event_printer.hpp"
#include "has.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/data/text.hpp"
#include "rtdata/loop/gaps.hpp"
#include "rtdata/loop/loop.hpp"

using namespace rtdata;
using namespace rtdata::app;
using namespace std::chrono_literals;
using nlohmann::json;
using rtdata::test::has;

namespace {

struct RoomReading {
  double value = 0;
  text<40> remark;
  std::optional<std::int32_t> count{};
  friend constexpr auto describe(type_tag<RoomReading>) {
    return record("reading", field("value", &RoomReading::value, "Cel"), field("remark", &RoomReading::remark),
                  field("count", &RoomReading::count));
  }
};

/// As another run has it.
struct OtherReading {
  double value = 0;
  friend constexpr auto describe(type_tag<OtherReading>) {
    return record("reading", field("value", &OtherReading::value, "K"));
  }
};

/// A stream, fed by hand.
struct Fed {
  explicit Fed(const std::string& request) : stream(stream_request(request).or_throw(), "0-0", "") {}
  template <class T>
  void give(std::string_view topic, Time time, std::uint64_t sequence, const T& data, std::string_view origin = "o") {
    put(topic, {time, sequence, origin}, description_of<T>().get(), std::as_bytes(std::span<const T, 1>(&data, 1)));
  }
  void put(std::string_view topic, const EventHeader& header, const Description* description,
           std::span<const std::byte> payload) {
    std::vector<std::byte> bytes(PackedEvent::bytes_of(topic, header.origin, payload.size()));
    PackedEvent::put(bytes.data(), topic, header, description, payload, 0);
    const auto& event = *reinterpret_cast<const PackedEvent*>(bytes.data());
    line.set(event);
    stream.take(event, origins.of(event), line);
  }
  /// The lines that it has by now, which are then sent.
  std::vector<json> lines() {
    std::vector<json> all;
    std::string text(stream.text());
    stream.sent(text.size());
    for (std::size_t at = 0; at < text.size();) {
      const std::size_t end = text.find('\n', at);
      REQUIRE(end != std::string::npos);
      all.push_back(json::parse(text.substr(at, end - at)));
      at = end + 1;
    }
    return all;
  }

  EventStream stream;
  StreamOrigins origins;
  EventLine line;
};

Time at(Duration since) { return from_nanoseconds(1'700'000'000'000'000'000) + since; }

std::string why_refused(const std::string& request) {
  const auto made = stream_request(request);
  return made ? "" : made.error().why;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("NFR-5 a stream gives each event as a line, with its units once, of the topics that match") {
    Fed fed(R"({"request":"subscribe","topics":["room/+"]})");
    fed.give("room/a", at(0s), 7, RoomReading{21.5, "ok", 3});
    fed.give("other", at(0s), 1, RoomReading{});
    fed.give("room/a", at(1s), 8, RoomReading{22, "", std::nullopt});
    const auto lines = fed.lines();
    REQUIRE(lines.size() == 4);
    CHECK(lines[0] == json::parse(R"({"subscribed":["room/+"],"version":1,"run":"0-0"})"));
    CHECK(lines[1] == json::parse(R"({"units":{"value":"Cel","remark":"","count":""},"of":"room/a"})"));
    CHECK(lines[2] == json::parse(R"({"topic":"room/a","time":1700000000000000000,"origin":"o","sequence":7,
                                      "data":{"value":21.5,"remark":"ok","count":3}})"));
    CHECK(lines[3]["data"] == json::parse(R"({"value":22,"remark":"","count":null})"));
  }

  TEST_CASE("NFR-5 a stream tells units again when they are others: in another run, live, after a reload") {
    for (const char* const request : {R"({"request":"subscribe"})", R"({"request":"subscribe","step":"1 s"})"}) {
      Fed fed(request);
      fed.stream.begin_run("1-1");
      fed.give("room/a", at(0s), 1, OtherReading{294.5});
      fed.give("room/a", at(1s), 2, OtherReading{294.5}, "b");
      fed.stream.begin_run("2-2");
      fed.give("room/a", at(2s), 1, OtherReading{294.5});
      fed.stream.begin_run("3-3");
      fed.give("room/a", at(3s), 1, RoomReading{21.5, "ok", 3});
      fed.stream.go_live(at(4s));
      fed.give("room/a", at(4s), 2, RoomReading{21.5, "ok", 3});
      fed.give("room/a", at(5s), 3, OtherReading{294.5});
      fed.stream.end("ended", "");
      std::string said;
      for (const json& line : fed.lines()) {
        if (line.contains("units")) said += line["units"]["value"].get<std::string>() + " ";
        if (line.contains("data")) said += line["data"]["value"].is_object() ? "step " : "event ";
      }
      const std::string one = json::parse(request).contains("step") ? "step " : "event ";
      // Steps of two origins come in another order, not in other units.
      CHECK_MESSAGE(has(said, "K " + one + one + one + "Cel " + one + one + "K " + one), said);
    }
  }

  TEST_CASE("NFR-5 a stream has NaN, infinity, and texts with quotes, umlauts and bytes that are no UTF-8") {
    Fed fed(R"({"request":"subscribe"})");
    constexpr double infinity = std::numeric_limits<double>::infinity();
    fed.give("t", at(0s), 1, RoomReading{std::nan(""), "say \"hä\"\n", 1}, "Fühler \"1\"");
    fed.give("t", at(1s), 2, RoomReading{-infinity, "\xff", 1}, "Fühler \"1\"");
    const auto lines = fed.lines();
    REQUIRE(lines.size() == 4);
    CHECK(lines[2]["origin"] == "Fühler \"1\"");
    CHECK(lines[2]["data"]["value"] == "NaN");
    CHECK(lines[2]["data"]["remark"] == "say \"hä\"\n");
    CHECK(lines[3]["data"]["value"] == "-Infinity");
    CHECK(lines[3]["data"]["remark"] == "\\xff");
  }

  TEST_CASE("NFR-5 the mean of a step with an infinity is that infinity, and of both is none") {
    Fed fed(R"({"request":"subscribe","step":"1 s"})");
    constexpr double infinity = std::numeric_limits<double>::infinity();
    for (std::uint64_t i = 1; i <= 4; ++i) fed.give("t", at(i * 100ms), i, RoomReading{i == 2 ? infinity : 1, "", 1});
    for (std::uint64_t i = 5; i <= 7; ++i)
      fed.give("t", at(i * 100ms + 1s), i, RoomReading{i == 6 ? -infinity : infinity, "", 1});
    fed.give("t", at(3s), 8, RoomReading{});
    const auto lines = fed.lines();
    REQUIRE(lines.size() == 4);
    CHECK(lines[2]["data"]["value"]["mean"] == "Infinity");
    CHECK(lines[2]["data"]["value"]["least"] == 1);
    CHECK(lines[2]["data"]["value"]["last"] == 1);
    CHECK(lines[3]["data"]["value"]["mean"] == "NaN");
    CHECK(lines[3]["data"]["value"]["most"] == "Infinity");
  }

  TEST_CASE("NFR-5 the mean of a step is right near the largest numbers") {
    Fed fed(R"({"request":"subscribe","step":"1 s"})");
    for (std::uint64_t i = 1; i <= 4; ++i)
      fed.give("t", at(i * 100ms), i, RoomReading{i % 2 == 0 ? -1.6e308 : 1.6e308, "", 1});
    for (std::uint64_t i = 5; i <= 7; ++i) fed.give("t", at(i * 100ms + 1s), i, RoomReading{1.7e308, "", 1});
    fed.give("t", at(3s), 8, RoomReading{});
    const auto lines = fed.lines();
    REQUIRE(lines.size() == 4);
    CHECK(std::abs(lines[2]["data"]["value"]["mean"].get<double>()) < 1e294);
    CHECK(lines[3]["data"]["value"]["mean"] == 1.7e308);
  }

  TEST_CASE("NFR-5 steps begin at multiples of their length, and have count, least, most, mean and last") {
    Fed fed(R"({"request":"subscribe","step":"100 ms"})");
    (void)fed.lines();
    fed.give("t", at(20ms), 1, RoomReading{3, "", 5});
    fed.give("t", at(40ms), 2, RoomReading{1, "", std::nullopt});
    fed.give("t", at(60ms), 3, RoomReading{std::nan(""), "", std::nullopt});
    fed.give("t", at(90ms), 4, RoomReading{2, "", std::nullopt});
    CHECK(fed.lines().empty());
    fed.give("t", at(110ms), 5, RoomReading{7, "", std::nullopt});
    auto lines = fed.lines();
    REQUIRE(lines.size() == 2);
    CHECK(has(lines[0].dump(), "units"));
    const json& step = lines[1];
    CHECK(step["topic"] == "t");
    CHECK(step["origin"] == "o");
    CHECK(step["time"] == to_nanoseconds(at(0s)));
    CHECK(step["until"] == to_nanoseconds(at(100ms)));
    CHECK(step["count"] == 4);
    CHECK(step["sequence"] == json::parse("[1,4]"));
    CHECK(step["data"] == json::parse(R"({"value":{"count":3,"least":1,"most":3,"mean":2,"last":2},
                                          "count":{"count":1,"least":5,"most":5,"mean":5,"last":5}})"));
    SUBCASE("and are over a little after their end, when nothing more comes") {
      fed.stream.turn(at(250ms));
      CHECK(fed.lines().empty());
      fed.stream.turn(at(300ms));
      lines = fed.lines();
      REQUIRE(lines.size() == 1);
      CHECK(lines[0]["time"] == to_nanoseconds(at(100ms)));
      CHECK(lines[0]["count"] == 1);
      CHECK(lines[0]["data"]["count"] == json::parse(R"({"count":0})"));
    }
    SUBCASE("and end with the stream") {
      fed.stream.end("ended", "so");
      lines = fed.lines();
      REQUIRE(lines.size() == 2);
      CHECK(lines[0]["count"] == 1);
      CHECK(lines[1] == json::parse(R"({"ended":"so"})"));
    }
  }

  TEST_CASE("NFR-5 a stream tells what was dropped before it, and gives no event twice") {
    Fed fed(R"({"request":"subscribe"})");
    fed.give("t", at(1s), 3, RoomReading{});
    (void)fed.lines();
    fed.give("t", at(2s), 3, RoomReading{});
    CHECK(fed.lines().empty());
    fed.give("t", at(3s), 6, RoomReading{});
    auto lines = fed.lines();
    REQUIRE(lines.size() == 2);
    CHECK(lines[0] == json::parse(R"({"dropped":2,"of":"t"})"));
    CHECK(lines[1]["sequence"] == 6);
    fed.put("t", {at(4s), 9, "o"}, nullptr, {});  // up to this one nothing had room
    lines = fed.lines();
    REQUIRE(lines.size() == 1);
    CHECK(lines[0] == json::parse(R"({"dropped":3,"of":"t"})"));
    fed.give("t", at(5s), 10, RoomReading{});
    CHECK(fed.lines().size() == 1);
  }

  TEST_CASE("NFR-5 who does not read gets counts and sums for what is left out, and each event counts once") {
    Fed fed(R"({"request":"subscribe"})");
    std::uint64_t sequence = 0;
    double sum = 0;
    for (; fed.stream.text().size() <= EventStream::most_bytes; sum += static_cast<double>(sequence)) {
      ++sequence;
      fed.give("t", at(sequence * 1ms), sequence, RoomReading{static_cast<double>(sequence), "", 1});
    }
    const std::size_t full = fed.stream.text().size();
    const std::uint64_t left_out = 10'000, before = sequence;
    for (std::uint64_t i = 0; i < left_out; ++i) {
      ++sequence;
      sum += static_cast<double>(sequence);
      fed.give("t", at(sequence * 1ms), sequence, RoomReading{static_cast<double>(sequence), "", 1});
      fed.stream.turn(at(sequence * 1ms));
    }
    CHECK(fed.stream.text().size() == full);
    std::uint64_t counted = 0;
    double summed = 0;
    const auto count = [&](const std::vector<json>& lines) {
      for (const json& line : lines) {
        if (!line.contains("data")) continue;
        counted += line.value("count", std::uint64_t{1});
        const json& value = line["data"]["value"];
        summed += value.is_object() ? value["mean"].get<double>() * value["count"].get<double>() : value.get<double>();
      }
    };
    count(fed.lines());
    CHECK(counted == before);
    fed.stream.turn(at(sequence * 1ms));
    auto lines = fed.lines();
    REQUIRE(lines.size() == 2);
    CHECK(lines[0] == json({{"dropped", left_out}, {"of", "t"}}));
    CHECK(lines[1]["sequence"] == json({before + 1, sequence}));
    count(lines);
    ++sequence;
    fed.give("t", at(sequence * 1ms), sequence, RoomReading{static_cast<double>(sequence), "", 1});
    sum += static_cast<double>(sequence);
    lines = fed.lines();
    REQUIRE(lines.size() == 1);
    count(lines);
    CHECK(counted == sequence);
    CHECK(summed == doctest::Approx(sum));
  }

  TEST_CASE("NFR-5 who does not read steps gets longer ones") {
    Fed fed(R"({"request":"subscribe","step":"10 ms"})");
    std::uint64_t sequence = 0;
    const auto give = [&] {
      ++sequence;
      fed.give("t", at(sequence * 5ms), sequence, RoomReading{static_cast<double>(sequence), "", 1});
    };
    while (fed.stream.text().size() <= EventStream::most_bytes) give();
    for (int i = 0; i < 1000; ++i) give();
    fed.stream.end("ended", "");
    std::uint64_t counted = 0, dropped = 0;
    Time until{};
    for (const json& line : fed.lines()) {
      dropped += line.value("dropped", std::uint64_t{0});
      if (!line.contains("data")) continue;
      counted += line["count"].get<std::uint64_t>();
      CHECK(line["time"] >= to_nanoseconds(until));
      until = from_nanoseconds(line["until"].get<std::int64_t>());
    }
    CHECK(counted == sequence);
    CHECK(dropped >= 499);
  }

  TEST_CASE("NFR-5 a stream says something every second") {
    Fed fed(R"({"request":"subscribe"})");
    fed.stream.turn(at(0s));
    (void)fed.lines();
    fed.stream.turn(at(900ms));
    CHECK(fed.lines().empty());
    fed.stream.turn(at(1s));
    const auto lines = fed.lines();
    REQUIRE(lines.size() == 1);
    CHECK(lines[0] == json({{"now", to_nanoseconds(at(1s))}}));
  }

  TEST_CASE("NFR-5 a stream begins at ns since 1970, as a number or as its text") {
    for (const char* const from : {"1700000000000000000", "\"1700000000000000000\""}) {
      const auto made = stream_request(std::string(R"({"request":"subscribe","from":)") + from + "}");
      REQUIRE(made);
      CHECK(made->from == at(0s));
    }
  }

  TEST_CASE("NFR-5 requests for events that are none are refused in words") {
    CHECK(why_refused(R"({"request":"subscribe"})").empty());
    CHECK(why_refused(R"({"request":"subscribe","version":1,"topics":["a","b/#"],"step":"1 s","from":"-10 min"})")
              .empty());
    CHECK(why_refused(R"({"request":"subscribe","from":1700000000000000000,"of":"run"})").empty());
    CHECK(why_refused(R"({"request":"subscribe","from":"2026-03-01T12:00:00Z"})").empty());
    for (const char* wrong :
         {"", "[]", "{", R"({"request":"subscribe","version":2})", R"({"topics":[]})", R"({"topics":"a"})",
          R"({"topics":["a//b"]})", R"({"topics":[1]})", R"({"topics":["\u00e4"]})", R"({"step":"0 s"})",
          R"({"step":5})", R"({"step":"2 d"})", R"({"step":"fast"})", R"({"from":"yesterday"})", R"({"from":1.5})",
          R"({"from":"-soon"})", R"({"of":"run"})", R"({"of":7})", R"({"speed":1})"}) {
      CAPTURE(wrong);
      CHECK_FALSE(why_refused(wrong).empty());
    }
  }

  TEST_CASE("NFR-5 events come through the ring of the readers whole and in order, and what has no room is told") {
    Loop loop{Loop::Manual{}};
    LiveFeed feed(loop);
    feed.bring("t/#");
    auto topic = loop.topic<RoomReading>("t/a");
    auto other = loop.topic<RoomReading>("other");
    std::uint64_t next = 1, lost = 0, seen = 0;
    const auto take = [&] {
      feed.ring()->take([&](const PackedEvent& event) {
        REQUIRE(event.topic() == "t/a");
        REQUIRE(event.origin() == "program:t/a");
        if (event.description == nullptr) {
          lost += event.sequence - (next - 1);
        } else {
          REQUIRE(event.sequence == next);
          // It outlives its topic, and the program's statics: the readers may come late.
          REQUIRE(feed.ring()->descriptions.at(event.description).get() == event.description);
          RoomReading reading;
          REQUIRE(event.payload_bytes == sizeof reading);
          std::memcpy(&reading, event.payload(), sizeof reading);
          CHECK(reading.value == static_cast<double>(event.sequence));
          ++seen;
        }
        next = event.sequence + 1;
      });
    };
    std::uint64_t published = 0;
    const auto publish = [&](std::uint64_t count) {
      for (std::uint64_t i = 0; i < count; ++i) {
        ++published;
        topic.publish({static_cast<double>(published), "x", 1});
        other.publish({});
        if (published % 500 == 0) loop.advance(1ms);
      }
      loop.advance(1ms);
    };
    for (int i = 0; i < 20; ++i) {  // several times around
      publish(10'000);
      take();
    }
    CHECK(seen == published);
    CHECK(lost == 0);
    publish(100'000);  // it has no room for so many
    CHECK(feed.ring()->has_lost);
    take();
    SUBCASE("with the next of that origin") { publish(1); }
    SUBCASE("or when it is asked for") { feed.tell_lost(); }
    take();
    CHECK_FALSE(feed.ring()->has_lost);
    CHECK(lost > 0);
    CHECK(seen + lost == published);
  }

  TEST_CASE("NFR-5 a ring between two threads gives each event once") {
    EventRing ring;
    constexpr std::uint64_t count = 200'000;
    std::thread puts([&] {
      const RoomReading reading{1, "x", 1};
      for (std::uint64_t i = 1; i <= count;) {
        const std::size_t size = i % 13 == 0 ? 3 : sizeof reading;
        if (ring.put("topic", {at(0s), i, "origin"}, description_of<RoomReading>().get(),
                     std::as_bytes(std::span(&reading, 1)).first(size)))
          ++i;
        else
          std::this_thread::yield();
      }
    });
    std::uint64_t next = 1;
    bool is_right = true;
    while (next <= count)
      ring.take([&](const PackedEvent& event) {
        is_right = is_right && event.sequence == next && event.key() == std::string_view("topic\0origin", 12);
        ++next;
      });
    puts.join();
    CHECK(is_right);
  }

  TEST_CASE("NFR-5 patterns that cover others") {
    CHECK(covers("#", "a/#"));
    CHECK(covers("#", "a/+"));
    CHECK(covers("a/+", "a/b"));
    CHECK(covers("a/#", "a/+/c"));
    CHECK_FALSE(covers("a/+", "a/#"));
    CHECK_FALSE(covers("a/b", "a/+"));
    CHECK_FALSE(covers("#", "$rtdata/health"));
    CHECK(covers("$rtdata/health", "$rtdata/health"));
  }

  TEST_CASE("NFR-5 lines for people name fields and units, steps, health, gaps, and what was left out") {
    EventPrinter printer(80);
    CHECK(printer.text(R"({"units":{"value":"Cel","inner.x":"m","n":"1"},"of":"room/a"})").empty());
    CHECK(printer.text(
              R"({"topic":"room/a","time":1700000000123000000,"origin":"a","sequence":1,"data":{"value":21.25,
                "n":3,"inner":{"x":1},"list":[1,2],"none":null}})") ==
          "2023-11-14 UTC\n22:13:20.123 room/a value=21.25 Cel n=3 inner.x=1 m list[0]=1 list[1]=2 none=ab~\n");
    CHECK(printer.text(
              R"({"topic":"room/a","time":1700000001000000000,"origin":"probe 2","sequence":1,
                "data":{"value":"NaN"}})") == "22:13:21.000 room/a (probe 2) value=NaN Cel\n");
    CHECK(printer.text(
              R"({"topic":"room/a","time":1700000001000000000,"until":1700000001100000000,"origin":"a",
                "sequence":[1,9],"count":9,"data":{"value":{"count":9,"least":1,"most":3,"mean":2,"last":3},
                "n":{"count":0}}})") == "22:13:21.000 room/a 9 events: value=2 (1 to 3) Cel n=absent\n");
    CHECK(printer.text(
              R"({"topic":"$rtdata/health","time":1700000001000000000,"origin":"program:$rtdata/health",
                "sequence":1,"data":{"kind":"sensor","name":"a","state":"faulted","reason":"gone\u001b[2J"}})") ==
          "22:13:21.000 ! sensor a faulted: gone?[2J\n");
    CHECK(printer.text(
              R"({"topic":"$rtdata/gaps","time":1700000001000000000,"origin":"program:$rtdata/gaps","sequence":1,
                "data":{"name":"a","topic":"room/a","kind":"missed","reason":"loop held",
                "first":1700000000000000000,"last":1700000000250000000,"count":3}})") ==
          "22:13:21.000 ! gap of a: 3 missed in 250 ms: loop held\n");
    CHECK(printer.text(
              R"({"topic":"hot","time":1700000001000000000,"origin":"hot","sequence":1,"data":{"level":"high",
                "alarm":"high","is_active":true}})") == "22:13:21.000 ! hot level=high alarm=high is_active=true\n");
    CHECK(printer.text(R"({"dropped":12,"of":"room/a"})") ==
          "             ! 12 of room/a left out: too many to be read in time\n");
    for (const char* nothing : {"", "{", "[]", R"({"now":1})", R"({"subscribed":["#"],
                "version":1})",
                                R"({"run":"x"})", R"({"topic":1,"data":2})", R"({"units":3,"of":4})"})
      CHECK(printer.text(nothing).empty());
    printer.text(R"({"units":{"value":"1"},"of":"room/a"})");  // of another run
    CHECK(
        printer.text(R"({"topic":"room/a","time":1700000002000000000,"origin":"a","sequence":1,"data":{"value":3}})") ==
        "22:13:22.000 room/a value=3\n");
  }
}
