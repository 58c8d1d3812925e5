// What was recorded comes back: by type, with its gaps, by UTC, in steps, and while it is being written.
#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "rtdata/recording/recording.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace recordings;
using namespace std::chrono_literals;

namespace {

constexpr auto in_place = RowFilter::Gaps::in_place;

/// A part of Climate.
struct Warmth {
  double temperature = 0;
  RTDATA_FIELDS(Warmth, (temperature, "Cel"))
};
struct InKelvin {
  double temperature = 0;
  RTDATA_FIELDS(InKelvin, (temperature, "K"))
};
struct WithPressure {
  double pressure = 0;
  std::int32_t humidity = 0;
  RTDATA_FIELDS(WithPressure, (pressure, "hPa"), (humidity, "%RH"))
};

struct Mixed {
  std::int32_t count = 0;
  std::uint64_t large = 0;
  std::optional<double> maybe = {};
  double value = 0;
  bool is_on = false;
  std::array<float, 2> pair = {};
  text<8> name = {};
  RTDATA_FIELDS(Mixed, (count), (large), (maybe, "V"), (value, "m"), (is_on), (pair, "A"), (name))
};

double number_in(const RecordedRow& row, std::string_view path) {
  const Value value = row.event().value(path).or_throw();
  if (const auto* integer = std::get_if<std::int64_t>(&value)) return static_cast<double>(*integer);
  if (const auto* integer = std::get_if<std::uint64_t>(&value)) return static_cast<double>(*integer);
  return std::get<double>(value);
}
std::uint64_t count_in(const RecordedRow& row, std::string_view path) {
  return std::get<std::uint64_t>(row.event().value(path).or_throw());
}

}  // namespace

TEST_SUITE_BEGIN("sinks");

TEST_CASE("FW-5 events come back as a type") {
  const Folder folder;
  const auto recording = Recording::open(make(folder)).or_throw();
  auto events = recording.events<Climate>("room/climate").or_throw();
  std::uint64_t count = 0;
  double sum = 0;
  Time last = Time::min();
  while (const RecordedEvent<Climate>* event = events.next().or_throw()) {
    CHECK(event->sequence == ++count);
    CHECK(event->origin == "room");
    CHECK(event->run == 1);
    CHECK(event->time > last);
    CHECK((*event)->humidity == 40);
    sum += (*event)->temperature;
    last = event->time;
  }
  CHECK(count == 999);
  CHECK(sum == 1001 * 1002 / 2 - 101 - 102);
  auto part = recording.events<Warmth>("room/climate").or_throw();
  CHECK(part.next().or_throw()->data.temperature == 1);
  auto all = recording.events<Everything>({.topic = "every/#"}).or_throw();
  CHECK(all.next().or_throw()->data == full());
}

TEST_CASE("FW-5 a type that the events are not of is refused, and its fields named") {
  const Folder folder;
  const std::string path = make(folder);
  const auto recording = Recording::open(path).or_throw();
  const Error unit = recording.events<InKelvin>("room/climate").error();
  CHECK(unit.id() == "description-differs");
  CHECK(unit.text().find("field temperature: unit \"Cel\" in it, \"K\" wanted") != std::string::npos);
  const Error both = recording.events<WithPressure>("room/climate").error();
  CHECK(both.text().find("field pressure: not in it") != std::string::npos);
  CHECK(both.text().find("field humidity: double in it, int32 wanted") != std::string::npos);
  CHECK(recording.events<InKelvin>({.topic = "#"}).error().id() == "description-differs");
  const Error absent = recording.events<Climate>("room/climat").error();
  CHECK(absent.id() == "not-found");
  CHECK(absent.text().find("did you mean room/climate?") != std::string::npos);
  CHECK(recording.events<Climate>("room/#/x").error().id() == "bad-name");
}

TEST_CASE("FW-5 a topic whose fields changed between runs comes back run by run, by the description of each") {
  const Folder folder;
  const std::string path = make(folder);
  {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Feed<InKelvin> feed(loop, {.name = "room", .topic = "room/climate"});
    feed.publish({293});
    feed.close();
    CHECK(loop.close() == 0);
  }
  const auto recording = Recording::open(path).or_throw();
  CHECK(recording.events<InKelvin>("room/climate").error().id() == "description-differs");
  auto second = recording.events<InKelvin>({.topic = "room/climate", .run = 2}).or_throw();
  CHECK(second.next().or_throw()->data.temperature == 293);
  CHECK(second.next().or_throw() == nullptr);
  auto first = recording.events<Climate>({.topic = "room/climate", .run = 1}).or_throw();
  CHECK(first.next().or_throw()->data.temperature == 1);
}

TEST_CASE("FW-5 gaps come in their places, when they are asked for") {
  const Folder folder;
  const auto recording = Recording::open(make(folder)).or_throw();
  const auto gaps = recording.gaps(1).or_throw();
  REQUIRE(gaps.size() == 2);
  auto rows = recording.rows({.gaps = in_place}).or_throw();
  std::vector<RecordedGap> found;
  Time last = Time::min();
  std::uint64_t events = 0, before_first = 0;
  while (const RecordedRow* row = rows.next().or_throw()) {
    CHECK(row->header().time >= last);
    last = row->header().time;
    if (row->gap() == nullptr) {
      ++events;
      if (found.empty()) ++before_first;
      continue;
    }
    found.push_back(*row->gap());
    CHECK(row->topic().topic == "room/climate");
    CHECK(row->header().origin == "room");
    CHECK(row->header().sequence == 0);
  }
  CHECK(events == 1001);
  CHECK(before_first == 100);
  REQUIRE(found.size() == 2);
  CHECK(found[0].kind == "failed");
  CHECK(found[0].count == 2);
  CHECK(found[1].kind == "missed");
  CHECK(found[1].count == gaps[1].count);
  CHECK(found[1].first == gaps[1].first);

  // Of a stretch of time: those that lie in it with some part; of a topic and an origin: theirs.
  const auto count_gaps = [&](RowFilter filter) {
    filter.gaps = in_place;
    auto chosen = recording.rows(filter).or_throw();
    int count = 0;
    while (const RecordedRow* row = chosen.next().or_throw()) count += row->gap() != nullptr ? 1 : 0;
    return count;
  };
  CHECK(count_gaps({.from = gaps[0].last}) == 2);
  CHECK(count_gaps({.from = gaps[0].last + 1ns}) == 1);
  CHECK(count_gaps({.until = gaps[1].first}) == 1);
  CHECK(count_gaps({.until = gaps[1].first + 1ns}) == 2);
  CHECK(count_gaps({.topic = "every/thing"}) == 0);
  CHECK(count_gaps({.origin = "room"}) == 2);
  CHECK(count_gaps({.origin = "program feed"}) == 0);
  CHECK(count_gaps({.run = 2}) == 0);

  auto typed = recording.events<Climate>({.topic = "room/climate", .gaps = in_place}).or_throw();
  int typed_gaps = 0;
  while (const auto* event = typed.next().or_throw()) typed_gaps += event->gap != nullptr ? 1 : 0;
  CHECK(typed_gaps == 2);
}

TEST_CASE("FW-5 events of a span of UTC, over a clock that was set") {
  const Folder folder;
  const std::string path = folder / "run.db";
  ManualClock clock;
  {
    Runtime runtime({.clock = &clock});
    runtime.on_log([](const LogRecord&) {});
    Loop loop(runtime, {});
    SqliteSink sink(loop, {.path = path});
    Feed<Climate> room(loop, {.name = "room"});
    for (int i = 0; i < 20; ++i) {
      room.publish({static_cast<double>(i), 0});
      clock.pass(1s);
      if (i == 9) clock.set_realtime(clock.realtime() + 1h);
      loop.poll();
    }
    room.close();
    CHECK(loop.close() == 0);
  }
  const auto recording = Recording::open(path).or_throw();
  const UtcLine line = recording.utc_line(1).or_throw();
  std::vector<Time> utc;
  auto all = recording.rows({}).or_throw();
  while (const RecordedRow* row = all.next().or_throw()) {
    utc.push_back(line.utc(row->header().time));
    CHECK(line.recorded(utc.back()) == row->header().time);
    CHECK(line.recorded(utc.back() + 1ns) == row->header().time + 1ns);
  }
  REQUIRE(utc.size() == 20);
  for (std::size_t i = 0; i < utc.size(); i += 3) {
    for (const Duration offset : {Duration{0}, Duration{1}}) {
      auto some = recording.events<Climate>({.topic = "room", .from = utc[i] + offset, .times = RowFilter::Times::utc})
                      .or_throw();
      const auto* first = some.next().or_throw();
      const std::size_t wanted = i + (offset == Duration{0} ? 0 : 1);
      REQUIRE((first != nullptr) == (wanted < utc.size()));
      if (first != nullptr) CHECK(first->data.temperature == static_cast<double>(wanted));
    }
    auto before = recording.rows({.until = utc[i], .times = RowFilter::Times::utc}).or_throw();
    std::size_t count = 0;
    while (before.next().or_throw() != nullptr) ++count;
    CHECK(count == i);
  }
}

TEST_CASE("FW-5 several origins of one topic come in order of time, also when they were stored in another") {
  const Folder folder;
  const std::string path = folder / "run.db";
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, {.path = path});
  Feed<Warmth> a(loop, {.name = "a", .topic = "t"}), b(loop, {.name = "b", .topic = "t"});
  const Time start = loop.time();
  for (int i = 0; i < 10; ++i) {
    a.publish({1}, start + i * 10ms + 5ms);
    b.publish({2}, start + i * 10ms);
  }
  a.close();
  b.close();
  CHECK(loop.close() == 0);
  const auto recording = Recording::open(path).or_throw();
  auto events = recording.events<Warmth>("t").or_throw();
  for (int i = 0; i < 20; ++i) {
    const auto* event = events.next().or_throw();
    REQUIRE(event != nullptr);
    CHECK(event->origin == (i % 2 == 0 ? "b" : "a"));
  }
  // What an origin recorded goes on in time: a row that does not was changed by somebody.
  sql(path, "UPDATE t SET time = time - 1000000000 WHERE origin = 'a' AND sequence = 5");
  auto changed = Recording::open(path).or_throw().rows({.origin = "a"}).or_throw();
  for (int i = 0; i < 4; ++i) CHECK(changed.next().or_throw() != nullptr);
  const auto damaged = changed.next();
  REQUIRE_FALSE(damaged);
  CHECK(damaged.error().id() == "damaged");
  CHECK(damaged.error().text().find("origin a, sequence 5, time") != std::string::npos);
}

namespace {

struct Wide {
  std::int64_t counter = 0;
  std::uint64_t large = 0;
  double value = 0;
  float small = 0;
  bool is_on = false;
  RTDATA_FIELDS(Wide, (counter), (large), (value), (small), (is_on))
};

}  // namespace

TEST_CASE("FW-5 steps: the least and the largest are values that were there, and a mean lies between them") {
  const Folder folder;
  const std::string path = folder / "run.db";
  constexpr std::int64_t beyond = (1LL << 53) + 1;  // no double is this number
  constexpr std::int64_t least = std::numeric_limits<std::int64_t>::min(), most = -(least + 1);
  constexpr double huge = std::numeric_limits<double>::max(), infinite = std::numeric_limits<double>::infinity();
  {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Feed<Wide> feed(loop, {.name = "t"});
    Time time{1'800'000'000s};
    const auto publish = [&](const Wide& event) { feed.publish(event, time += 1ms); };
    publish({beyond, 5, huge, 0.1F, true});
    publish({beyond + 2, ~std::uint64_t{0}, huge, 0.3F, true});
    publish({beyond + 4, ~std::uint64_t{0} - 1, huge, 0.2F, true});
    time = Time{1'800'000'001s};
    publish({least, 1, -huge, 0, false});
    publish({least, 0, -huge, 0, false});
    publish({least + 3, 2, huge, 0, true});
    publish({most, 1, 0, 0, false});
    time = Time{1'800'000'002s};
    publish({-5, 0, infinite, 0, false});
    publish({-6, 0, 1, 0, false});
    CHECK(loop.close() == 0);
  }
  auto steps = Recording::open(path).or_throw().steps({.topic = "t"}, 1s).or_throw();
  const RecordedRow* row = steps.next().or_throw();
  REQUIRE(row != nullptr);
  const auto value = [&](std::string_view path_of) { return row->event().value(path_of).or_throw(); };
  CHECK(value("counter.min") == Value{beyond});
  CHECK(value("counter.max") == Value{beyond + 4});
  CHECK(std::abs(number_in(*row, "counter.mean") - 0x1p53) <= 4);  // doubles are 2 apart there
  CHECK(value("large.min") == Value{std::uint64_t{5}});
  CHECK(value("large.max") == Value{~std::uint64_t{0}});
  CHECK(value("large.mean") == Value{0x1p65 / 3});
  CHECK(value("value.min") == Value{huge});
  CHECK(value("value.mean") == Value{huge});
  CHECK(value("small.max") == Value{double{0.3F}});
  CHECK(row->topic().description->find("small.max")->kind == Kind::f32);
  CHECK(value("is_on.min") == Value{std::uint64_t{1}});
  row = steps.next().or_throw();
  REQUIRE(row != nullptr);
  CHECK(value("counter.min") == Value{least});
  CHECK(value("counter.max") == Value{most});
  CHECK(value("counter.mean") == Value{-0x1p62});
  CHECK(value("large.mean") == Value{1.0});
  CHECK(value("value.min") == Value{-huge});
  CHECK(value("value.max") == Value{huge});
  CHECK(value("value.mean") == Value{-huge / 4});
  CHECK(value("is_on.mean") == Value{0.25});
  row = steps.next().or_throw();
  REQUIRE(row != nullptr);
  CHECK(value("counter.mean") == Value{-5.5});
  CHECK(value("value.mean") == Value{infinite});
}

TEST_CASE("FW-5 steps: count, least, largest and mean of each number, of each origin") {
  const Folder folder;
  const std::string path = folder / "run.db";
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, {.path = path});
  Feed<Mixed> a(loop, {.name = "a", .topic = "t"}), b(loop, {.name = "b", .topic = "t"});
  const Time start{1'800'000'000s};
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  a.publish({.count = -3, .large = ~std::uint64_t{0}, .maybe = 2, .value = nan, .is_on = true, .pair = {1, 2}}, start);
  a.publish({.count = 5, .large = 0, .maybe = {}, .value = 1.5, .is_on = false, .pair = {3, -2}}, start + 999ms);
  b.publish({.value = -1}, start + 999'999'999ns);
  b.publish({.value = 7}, start + 1s);
  a.publish({.value = nan}, start + 5s);
  a.close();
  b.close();
  CHECK(loop.close() == 0);

  const auto recording = Recording::open(path).or_throw();
  auto steps = recording.steps({.topic = "t"}, 1s).or_throw();
  const RecordedRow* row = steps.next().or_throw();
  REQUIRE(row != nullptr);
  CHECK(row->header().time == start);
  CHECK(row->header().origin == "a");
  CHECK(row->header().sequence == 1);
  CHECK(row->first_sequence() == 1);
  CHECK(row->last_sequence() == 2);
  CHECK(row->topic().topic == "t");
  CHECK(count_in(*row, "events") == 2);
  CHECK(count_in(*row, "count.count") == 2);
  CHECK(number_in(*row, "count.min") == -3);
  CHECK(number_in(*row, "count.max") == 5);
  CHECK(number_in(*row, "count.mean") == 1);
  CHECK(number_in(*row, "large.max") == 0x1p64);
  CHECK(count_in(*row, "maybe.count") == 1);
  CHECK(number_in(*row, "maybe.mean") == 2);
  CHECK(count_in(*row, "value.count") == 1);
  CHECK(number_in(*row, "value.mean") == 1.5);
  CHECK(number_in(*row, "is_on.mean") == 0.5);
  CHECK(number_in(*row, "pair[1].min") == -2);
  CHECK(number_in(*row, "pair[0].mean") == 2);
  CHECK(row->topic().description->find("value.mean")->unit == "m");
  CHECK(row->topic().description->find("name.count") == nullptr);
  row = steps.next().or_throw();
  CHECK(row->header().origin == "b");
  CHECK(number_in(*row, "value.mean") == -1);
  row = steps.next().or_throw();
  CHECK(row->header().origin == "b");
  CHECK(row->header().sequence == 2);
  CHECK(row->first_sequence() == 2);
  CHECK(row->last_sequence() == 2);
  CHECK(row->header().time == start + 1s);
  row = steps.next().or_throw();
  CHECK(row->header().time == start + 5s);
  CHECK(count_in(*row, "events") == 1);
  CHECK(count_in(*row, "value.count") == 0);
  CHECK(std::holds_alternative<std::monostate>(row->event().value("value.mean").or_throw()));
  CHECK(steps.next().or_throw() == nullptr);
  CHECK(steps.next().or_throw() == nullptr);
  CHECK(recording.steps({}, Duration{0}).error().id() == "bad-argument");

  auto of_hour = recording.steps({.topic = "t", .origin = "a"}, 1h).or_throw();
  row = of_hour.next().or_throw();
  CHECK(count_in(*row, "events") == 3);
  CHECK(of_hour.next().or_throw() == nullptr);
}

TEST_CASE("FW-5 steps keep the gaps, and their sums are those of SQL") {
  const Folder folder;
  const std::string path = make(folder);
  const auto recording = Recording::open(path).or_throw();
  const auto gaps = recording.gaps(1).or_throw();
  for (const Duration step : {Duration{10ms}, Duration{70ms}, Duration{1s}, Duration{1h}}) {
    auto steps = recording.steps({.topic = "room/climate", .gaps = in_place}, step).or_throw();
    std::uint64_t events = 0;
    std::size_t gap = 0;
    double sum = 0;
    Time last = Time::min();
    while (const RecordedRow* row = steps.next().or_throw()) {
      CHECK(row->header().time >= last);
      last = row->header().time;
      if (row->gap() != nullptr) {
        CHECK(row->gap()->first == gaps.at(gap++).first);
        continue;
      }
      CHECK(row->header().time.time_since_epoch() % step == 0ns);
      events += count_in(*row, "events");
      sum += number_in(*row, "temperature.mean") * static_cast<double>(count_in(*row, "temperature.count"));
    }
    CHECK(gap == 2);
    CHECK(events == 999);
    CHECK(sum == doctest::Approx(number(path, "SELECT sum(temperature) FROM \"room/climate\"")));
  }
  // A value that is none is told with its place, where rows are read.
  sql(path, "UPDATE \"room/climate\" SET humidity = x'00' WHERE sequence = 300");
  const auto failed = Recording::open(path).or_throw().steps({.topic = "room/climate"}, 12500ms);
  REQUIRE_FALSE(failed);
  CHECK(failed.error().text().find("sequence 300, field humidity") != std::string::npos);
}

TEST_CASE("FW-5 what is read while it is written is what was there when reading began") {
  const Folder folder;
  const std::string path = folder / "run.db";
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, {.path = path});
  Feed<Warmth> feed(loop, {.name = "a", .topic = "t"});
  std::uint64_t written = 0;
  const auto write = [&] {
    for (int i = 0; i < 300; ++i) feed.publish({static_cast<double>(++written)});
    loop.advance(2s);
  };
  write();
  for (int round = 0; round < 5; ++round) {
    const auto recording = Recording::open(path).or_throw();
    const std::uint64_t before = written;
    auto events = recording.events<Warmth>("t").or_throw();
    std::uint64_t count = 0;
    while (const auto* event = events.next().or_throw()) {
      CHECK(event->data.temperature == static_cast<double>(++count));
      if (count == 100) write();
    }
    CHECK(count == before);
    auto later = Recording::open(path).or_throw().events<Warmth>("t").or_throw();
    while (later.next().or_throw() != nullptr) ++count;
    CHECK(count == before + written);
  }
  feed.close();
  CHECK(loop.close() == 0);
  check_balanced(path);
}

TEST_SUITE_END();
