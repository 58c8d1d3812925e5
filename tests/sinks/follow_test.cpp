// A recording read in the order of storing, while it is written and afterwards.
#include "rtdata/recording/follow.hpp"

#include <doctest/doctest.h>

#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace recordings;
using namespace std::chrono_literals;

namespace {

struct Counted {
  std::uint64_t number = 0;
  RTDATA_FIELDS(Counted, (number))
};

/// Of each topic, the numbers that came, in their order.
using Came = std::map<std::string, std::vector<std::uint64_t>>;

/// What is there by now, `at_once` rows a call.
Came read_all(RecordingFollower& rows, std::uint64_t at_once = 1000) {
  Came came;
  for (bool has_more = true; has_more;) {
    std::uint64_t taken = 0;
    has_more = rows.read(10s,
                         [&](const RecordedRow& row) {
                           REQUIRE(row.gap() == nullptr);
                           const auto* number = row.event().as<Counted>();
                           REQUIRE(number != nullptr);
                           CHECK(number->number == row.header().sequence);
                           came[row.topic().topic].push_back(number->number);
                           return ++taken < at_once ? RecordingFollower::Goes::on : RecordingFollower::Goes::enough;
                         })
                   .or_throw();
    CHECK(taken <= at_once);
  }
  return came;
}

std::vector<std::uint64_t> from_to(std::uint64_t first, std::uint64_t last) {
  std::vector<std::uint64_t> all;
  for (std::uint64_t i = first; i <= last; ++i) all.push_back(i);
  return all;
}

}  // namespace

TEST_SUITE_BEGIN("sinks");

TEST_CASE(
    "FW-5 who follows from an instant on gets the rows of each run, also where a later run has an earlier clock") {
  const Folder folder;
  const std::string path = folder / "run.db";
  for (int run = 1; run <= 3; ++run) {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Feed<Counted> a(loop, {.name = "a"});
    if (run == 2) loop.advance(24h);
    for (std::uint64_t i = 1; i <= 100; ++i) {
      a.publish({i});
      loop.advance(100ms);
    }
    CHECK(loop.close(5s) == 0);
  }
  const auto runs = Recording::open(path).or_throw().runs().or_throw();
  REQUIRE(runs.size() == 3);
  auto rows = RecordingFollower::open(path, {.from = runs[1].started + 1h}).or_throw();
  CHECK(read_all(rows) == Came{{"a", from_to(1, 100)}});
  auto all = RecordingFollower::open(path, {.from = runs[0].started}).or_throw();
  CHECK(read_all(all)["a"].size() == 300);
  auto none = RecordingFollower::open(path, {.from = runs[1].started + 48h}).or_throw();
  CHECK(read_all(none).empty());
}

TEST_CASE("FW-5 who follows a recording gets each row once, while it is written, and of tables that come later") {
  const Folder folder;
  const std::string path = folder / "run.db";
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, {.path = path});
  Feed<Counted> a(loop, {.name = "a", .topic = "t/a"}), b(loop, {.name = "b", .topic = "t/b"});
  std::uint64_t count = 0;
  const auto publish = [&](std::uint64_t more, auto&... feeds) {
    for (std::uint64_t i = 0; i < more; ++i) {
      loop.advance(1ms);
      ++count;
      (feeds.publish({count}), ...);
    }
    loop.advance(2s);  // it is stored
  };
  publish(100, a, b);
  auto rows = RecordingFollower::open(path, {}).or_throw();
  auto part = RecordingFollower::open(path, {.topics = {"t/b", "later"}}).or_throw();
  CHECK(read_all(rows) == Came{{"t/a", from_to(1, 100)}, {"t/b", from_to(1, 100)}});
  CHECK(read_all(part, 7) == Came{{"t/b", from_to(1, 100)}});
  CHECK(read_all(rows).empty());
  publish(50, a);
  CHECK(read_all(rows, 1) == Came{{"t/a", from_to(101, 150)}});
  CHECK(read_all(part).empty());
  count = 0;
  Feed<Counted> later(loop, {.name = "later"});
  publish(3, later);
  CHECK(read_all(rows) == Came{{"later", from_to(1, 3)}});
  CHECK(read_all(part) == Came{{"later", from_to(1, 3)}});
  a.close(), b.close(), later.close();
  CHECK(loop.close() == 0);
  CHECK(read_all(rows).empty());
}

TEST_CASE("FW-5 who follows a recording from an instant gets what is not before it") {
  const Folder folder;
  const std::string path = folder / "run.db";
  Time half{};
  {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Feed<Counted> feed(loop, {.name = "a"});
    for (std::uint64_t i = 1; i <= 3000; ++i) {
      loop.advance(20ms);
      if (i == 1500) half = loop.time();
      feed.publish({i});
    }
    feed.close();
    CHECK(loop.close() == 0);
  }
  const auto from = [&](Time time) { return RecordingFollower::open(path, {.from = time}).or_throw(); };
  for (const auto& [time, first] : {std::pair{half, 1500U},
                                    {half + 1ns, 1501U},
                                    {half - 20ms, 1499U},
                                    {Time::min(), 1U},
                                    {half - 1h, 1U},
                                    {half + 1h, 3001U},
                                    {Time::max(), 3001U}}) {
    auto rows = from(time);
    const auto came = read_all(rows, 100);
    CHECK(came == (first > 3000 ? Came{} : Came{{"a", from_to(first, 3000)}}));
  }
}

TEST_CASE("FW-5 who follows rows in several runs and tables gets them in order of run and time") {
  const Folder folder;
  const std::string path = folder / "run.db";
  for (int run = 0; run < 2; ++run) {
    Loop loop{Loop::Manual{}};
    SqliteSink sink(loop, {.path = path});
    Feed<Counted> a(loop, {.name = "a"}), b(loop, {.name = "b"});
    for (std::uint64_t i = 1; i <= 500; ++i) {
      loop.advance(1ms);
      a.publish({i});
      loop.advance(1ms);
      b.publish({i});
    }
    a.close(), b.close();
    CHECK(loop.close() == 0);
  }
  auto rows = RecordingFollower::open(path, {}).or_throw();
  std::pair<std::int64_t, Time> last{};
  std::size_t count = 0;
  CHECK_FALSE(rows.read(1min,
                        [&](const RecordedRow& row) {
                          const std::pair now{row.run(), row.header().time};
                          CHECK(now > last);
                          last = now;
                          ++count;
                          return RecordingFollower::Goes::on;
                        })
                  .or_throw());
  CHECK(count == 2000);
}

TEST_CASE("FW-5 what cannot be followed is refused, and a damaged row is named") {
  const Folder folder;
  CHECK(RecordingFollower::open(folder / "none.db", {}).error().id() == "not-found");
  const std::string path = make(folder);
  CHECK(RecordingFollower::open(path, {.topics = {"a//b"}}).error().id() == "bad-name");
  sql(path, "UPDATE \"room/climate\" SET temperature = 'hot' WHERE sequence = 10");
  auto rows = RecordingFollower::open(path, {.topics = {"room/climate"}}).or_throw();
  std::uint64_t last = 0;
  const auto read = rows.read(1min, [&](const RecordedRow& row) {
    last = row.header().sequence;
    return RecordingFollower::Goes::on;
  });
  REQUIRE_FALSE(read);
  CHECK(last == 9);
  CHECK(read.error().id() == "damaged");
  CHECK(read.error().text().find("sequence 10") != std::string::npos);
}

TEST_SUITE_END();
