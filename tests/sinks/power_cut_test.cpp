// Power cuts at random moments: what a recording then is, and what the next start says of it.
#include <doctest/doctest.h>

#include <array>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "sinks/power_cut.hpp"
#include "sinks/recordings.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using recordings::number;

namespace {

struct Number {
  std::int64_t count = 0;
  double value = 0;
  friend constexpr auto describe(type_tag<Number>) {
    return record("number", field("count", &Number::count), field("value", &Number::value));
  }
};

struct Page {
  std::int64_t count = 0;
  text<1500> content;
  friend constexpr auto describe(type_tag<Page>) {
    return record("page", field("count", &Page::count), field("content", &Page::content));
  }
};

constexpr std::array<const char*, 3> topics = {"regular", "random", "burst"};
constexpr Duration step = 500ms;

/// What was the case at a moment of the disk.
struct Moment {
  std::size_t at = 0;
  Duration time{0};
  std::array<std::int64_t, topics.size()> published{};
  std::uint64_t stored = 0;
};

/// What survives a kill is in a folder that a power cut empties.
class Memory {
 public:
  Memory() { renew(); }
  ~Memory() { ::unsetenv("RUNTIME_DIRECTORY"); }
  void renew() { ::setenv("RUNTIME_DIRECTORY", folder_.emplace().path.c_str(), 1); }

 private:
  std::optional<sinks::Directory> folder_;
};

/// Records until it closes, or until it is to be left as it is.
std::vector<Moment> record(const SqliteConfig& config, const power_cut::Disk& disk, std::mt19937& random,
                           Duration time) {
  std::vector<Moment> moments;
  Loop loop{Loop::Manual{}};
  loop.on_error([](const ErrorReport&) {});
  loop.runtime().on_log([](const LogRecord&) {});
  SqliteSink sink(loop, config);
  Moment now;
  const auto next = [&](std::size_t topic) { return Number{++now.published[topic], static_cast<double>(random())}; };
  const bool is_limited = config.max_bytes != 0;
  const auto look = [&] {
    now.at = disk.now();
    now.stored = sink.counts().stored;
    moments.push_back(now);
  };
  look();
  Sensor<Number> regular(loop, {.name = "regular", .topic = topics[0], .rate = 5_Hz}, [&] { return next(0); });
  const unsigned often = 2 + static_cast<unsigned>(random() % 40);
  Sensor<Number> irregular(loop, {.name = "random", .topic = topics[1], .rate = 10_Hz, .retry_first = 1ms},
                           [&]() -> Reading<Number> {
                             const auto dice = random() % often;
                             if (dice == 0) return Error{Errc::io_failed, "no answer", "", "", ""};
                             if (dice == 1) return nothing_new;
                             return next(1);
                           });
  Feed<Page> burst(loop, {.name = "burst", .topic = topics[2]});
  for (; now.time < time; now.time += step) {
    if (random() % (is_limited ? 3 : 20) == 0) {
      for (auto n = random() % 150; n > 0; --n)
        burst.publish({++now.published[2], text<1500>(std::string(random() % 1500, 'x'))});
    }
    loop.advance(step);
    look();
  }
  loop.close();
  now.at = disk.now();
  now.stored = 0;
  for (const std::int64_t count : now.published) now.stored += static_cast<std::uint64_t>(count);
  moments.push_back(now);
  return moments;
}

/// What the disk may hold beside: an index of the log, and the lock of the recording, half written.
void litter(std::mt19937& random, const std::string& path) {
  for (const char* name : {"-shm", "-lock"}) {
    if (random() % 2 == 0) continue;
    std::ofstream out(path + name, std::ios::binary);
    const auto size = name[1] == 's' ? std::size_t{32768} : random() % 100;
    for (std::size_t i = 0; i < size; ++i) out.put(static_cast<char>(random()));
  }
}

/// The next start, which seals what is there. Empty, or why it cannot record into it.
std::string start(const std::string& path) {
  try {
    Loop loop{Loop::Manual{}};
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    Sensor<Number> regular(loop, {.name = "regular", .topic = topics[0], .rate = 5_Hz}, [] { return Number{}; });
    loop.advance(1s);
    loop.close();
    return "";
  } catch (const SetupError& e) {
    return e.error().text();
  }
}

/// Of the rows of a run.
std::int64_t of_rows(const std::string& path, std::int64_t run, const std::string& topic, const std::string& what) {
  if (number(path, "SELECT count(*) FROM rtdata_topic WHERE topic = '" + topic + "'") == 0) return 0;
  return number(path, "SELECT coalesce(" + what + ", 0) FROM \"" + topic + "\" WHERE run = " + std::to_string(run));
}

struct Found {
  int cuts = 0;
  int damaged = 0;  // files
  int without_run = 0;
  int pruned = 0;  // recordings
  std::int64_t lost = 0;
};

struct Seeds {
  unsigned long first = 1;
  unsigned long count = 4;
};

Seeds seeds() {
  const char* const wanted = std::getenv("RTDATA_TEST_SEEDS");  // "FIRST COUNT", to look for more
  if (wanted == nullptr) return {};
  char* rest = nullptr;
  const unsigned long first = std::strtoul(wanted, &rest, 10);
  return {first, std::strtoul(rest, nullptr, 10)};
}

constexpr int cuts_a_recording = 7;

struct Promise {
  SqliteProfile profile;
  bool keeps_committed;
  Duration at_risk;
};

/// A recording on a disk whose power was cut at random.
struct Cut {
  Cut(const std::vector<Moment>& all, std::mt19937& random, std::size_t first = 0)
      : at(first + random() % (all.back().at + 1 - first)), moments(all) {
    while (last + 1 < all.size() && all[last + 1].at <= at) ++last;
  }
  const Moment& before() const { return moments[last]; }
  const Moment& after() const { return moments[std::min(last + 1, moments.size() - 1)]; }
  bool had_begun() const { return at >= moments.front().at; }
  bool had_closed() const { return at >= moments.back().at; }
  bool may_have_closed() const { return last + 2 >= moments.size(); }

  std::size_t at;
  const std::vector<Moment>& moments;
  std::size_t last = 0;  // of the moments before it
};

/// After a start: the rows of the run are all from the first, less what was pruned, up to one as late as is promised.
void check_rows(const std::string& path, std::int64_t run, const Promise& promise, const Cut& cut, Found& found) {
  Moment safe;  // what is old enough
  for (const Moment& moment : cut.moments) {
    if (moment.time + promise.at_risk <= cut.before().time) safe = moment;
  }
  std::int64_t stored = 0;
  for (std::size_t i = 0; i < topics.size(); ++i) {
    CAPTURE(topics[i]);
    const std::int64_t rows = of_rows(path, run, topics[i], "count(*)");
    const std::int64_t last = of_rows(path, run, topics[i], "max(sequence)");
    stored += last;
    CHECK(of_rows(path, run, topics[i], "sum(count = sequence)") == rows);
    CHECK(of_rows(path, run, topics[i], "max(sequence) - min(sequence) + 1") == rows);
    if (number(path, "SELECT total(pruned) FROM rtdata_ledger") == 0) {
      CHECK(rows == last);
    } else {
      ++found.pruned;
    }
    CHECK(last <= cut.after().published[i]);
    CHECK(last >= safe.published[i]);
    found.lost += cut.after().published[i] - last;
  }
  if (promise.keeps_committed) CHECK(stored >= static_cast<std::int64_t>(cut.before().stored));
}

/// After a start: what the recording says of the run.
void check_told(const std::string& path, std::int64_t run, const Cut& cut) {
  const VerifyReport report = recordings::verified(path);
  INFO(recordings::problems_of(report));
  CHECK(report.problems.empty());
  CHECK(report.exit_code() == 0);
  for (const RunReport& one : report.runs) {
    if (one.info.run != run) {
      CHECK(one.verdict <= Verdict::sealed);
    } else if (one.verdict == Verdict::balanced) {
      CHECK(cut.may_have_closed());
    } else {
      CHECK(one.verdict == Verdict::sealed);
      CHECK_FALSE(cut.had_closed());
      CHECK_FALSE(one.info.lost.has_value());
      CHECK(one.info.remark.find("is unknown") != std::string::npos);
    }
  }
}

void check_intact(const std::string& path) {
  CHECK(number(path, "SELECT count(*) FROM pragma_integrity_check WHERE integrity_check <> 'ok'") == 0);
}

/// All that can be asked of a file that may be damaged: an error, or an answer.
void read_all(const std::string& path) {
  if (auto opened = Recording::open(path)) (void)verify(*opened);
}

/// What a second power cut leaves, during or after a start on what the first one left, is what the first one left and
/// more.
void cut_again(const std::string& path, const Promise& promise, std::mt19937& random, Memory& memory, Found& found) {
  power_cut::Disk disk;
  disk.has(path);
  const std::size_t first = disk.now();
  const std::vector<Moment> moments = record({.path = path, .profile = promise.profile}, disk, random, 5s);
  const std::int64_t run = number(path, "SELECT max(run) FROM rtdata_run");
  const Cut cut(moments, random, first);
  const sinks::Directory left;
  const std::string again = left / "run.db";
  disk.cut(cut.at, random, left.path);
  litter(random, again);
  memory.renew();
  ++found.cuts;
  REQUIRE(start(again) == "");
  check_intact(again);
  for (const char* topic : topics) {
    CAPTURE(topic);
    for (std::int64_t before = 1; before < run; ++before)
      CHECK(of_rows(again, before, topic, "count(*)") == of_rows(path, before, topic, "count(*)"));
  }
  if (number(again, "SELECT max(run) FROM rtdata_run") > run) {
    check_told(again, run, cut);
    check_rows(again, run, promise, cut, found);
  } else {
    CHECK_FALSE(cut.had_begun());
    CHECK(recordings::verified(again).exit_code() == 0);
  }
}

Found cut_at_random(const Promise& promise) {
  Found found;
  const Seeds wanted = seeds();
  for (unsigned long seed = wanted.first; seed < wanted.first + wanted.count; ++seed) {
    CAPTURE(seed);
    std::mt19937 random(static_cast<unsigned>(seed));
    power_cut::Disk disk;
    Memory memory;
    const sinks::Directory folder;
    const std::uint64_t max_bytes = seed % 3 == 0 ? SqliteConfig::least_max_bytes : 0;
    const std::vector<Moment> moments = record(
        {.path = folder / "run.db", .profile = promise.profile, .max_bytes = max_bytes}, disk, random,
        step * (random() % 150 + 20));
    for (int n = 0; n < cuts_a_recording; ++n) {
      const Cut cut(moments, random);
      CAPTURE(n);
      CAPTURE(cut.at);
      CAPTURE(cut.before().time.count());
      const sinks::Directory left;
      const std::string path = left / "run.db";
      disk.cut(cut.at, random, left.path);
      litter(random, path);
      memory.renew();
      ++found.cuts;
      const std::string refused = start(path);
      if (promise.profile == SqliteProfile::fast) {
        found.damaged += refused.empty() ? 0 : 1;
        read_all(path);
        continue;
      }
      REQUIRE(refused == "");
      check_intact(path);
      if (number(path, "SELECT count(*) FROM rtdata_run") == 1) {
        ++found.without_run;
        CHECK_FALSE(cut.had_begun());
        continue;
      }
      check_rows(path, 1, promise, cut, found);
      check_told(path, 1, cut);
      if (n == 0) cut_again(path, promise, random, memory, found);
    }
  }
  if (std::getenv("RTDATA_TEST_SEEDS") != nullptr) {
    MESSAGE(wanted.count << " seeds from " << wanted.first << ": " << found.cuts << " cuts, " << found.damaged
                         << " damaged, " << found.without_run << " before it began, " << found.pruned
                         << " tables pruned, " << found.lost << " events lost");
  }
  return found;
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE(
      "NFR-1 power cut at random moments, profile normal: the file is whole, 31 s at most are lost, and that is "
      "said") {
    const Found found = cut_at_random({SqliteProfile::normal, false, 31s});
    CHECK(found.lost > 0);
  }
  TEST_CASE("NFR-1 power cut at random moments, profile safe: what was committed is there") {
    const Found found = cut_at_random({SqliteProfile::safe, true, 1s});
    CHECK(found.lost > 0);
  }
  TEST_CASE("NFR-1 power cut at random moments, profile card: what was committed is there, 10 s at most are lost") {
    const Found found = cut_at_random({SqliteProfile::card, true, 10s});
    CHECK(found.lost > 0);
  }
  TEST_CASE(
      "NFR-1 power cut at random moments, profile fast: the file may be lost, and that is an error and no crash") {
    const Found found = cut_at_random({SqliteProfile::fast, false, 31s});
    CHECK(found.cuts > 0);
  }

  TEST_CASE("NFR-1 what is published before a long silence survives a power cut in it, with the profile normal") {
    for (unsigned seed = 1; seed <= 5; ++seed) {
      CAPTURE(seed);
      std::mt19937 random(seed);
      power_cut::Disk disk;
      Memory memory;
      const sinks::Directory folder, left;
      {
        Loop loop{Loop::Manual{}};
        SqliteSink sink(loop, {.path = folder / "run.db"});
        Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
        loop.advance(51s);
        for (int i = 1; i <= 10; ++i) {
          feed.publish({i, 1});
          loop.advance(1s);
        }
        loop.advance(29s);
        loop.advance(1s);
        disk.cut(disk.now(), random, left.path);
        loop.close();
      }
      memory.renew();
      REQUIRE(start(left / "run.db") == "");
      CHECK(of_rows(left / "run.db", 1, "a", "count(*)") == 10);
    }
  }
}
