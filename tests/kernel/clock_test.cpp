// The time of day is really set while a recording runs.
#include <doctest/doctest.h>

#include <ctime>
#include <sstream>

#include "kernel/bench.hpp"
#include "rtdata/recording/export.hpp"

using namespace bench;

namespace {

/// The kernel's time of day; as it was again afterwards.
class TimeOfDay {
 public:
  TimeOfDay() : right_(offset()) {}
  TimeOfDay(const TimeOfDay&) = delete;
  ~TimeOfDay() { set(Time{right_ + SystemClock().monotonic().time_since_epoch()}); }

  static void set(Time time) {
    const std::int64_t ns = time.time_since_epoch().count();
    const timespec spec{ns / 1'000'000'000, static_cast<long>(ns % 1'000'000'000)};
    CHECK(::clock_settime(CLOCK_REALTIME, &spec) == 0);
  }
  static void move(Duration by) { set(SystemClock().realtime() + by); }
  /// Of the time of day from the monotonic clock, now.
  static Duration offset() {
    SystemClock clock;
    return clock.realtime().time_since_epoch() - clock.monotonic().time_since_epoch();
  }
  Duration right() const { return right_; }
  void correct() const { set(Time{right_ + SystemClock().monotonic().time_since_epoch()}); }

 private:
  Duration right_;
};

/// When it was taken, on the monotonic clock.
struct Sample {
  std::int64_t monotonic = 0;
  RTDATA_FIELDS(Sample, (monotonic, "ns"))
};

/// Reading two clocks one after the other costs time, of which a busy machine may make much; a step is an hour.
constexpr Duration tolerance = 100ms;

bool near(Duration a, Duration b) { return a - b < tolerance && b - a < tolerance; }

/// Records at 200 Hz, doing one thing after the other, 200 ms apart; then looks at what was recorded.
/// `steps`: by how much the clock was moved each time. `right`: the offset that gives the right time.
void check_recording(const std::vector<std::function<void()>>& things, const std::vector<Duration>& steps,
                     Duration right) {
  recordings::Folder folder;
  const std::string path = folder / "run.db";
  std::size_t warnings = 0;
  SensorCounts counts;
  {
    Loop loop;
    loop.runtime().on_log([&](const LogRecord& record) {
      if (record.object == "clock") ++warnings;
    });
    SqliteSink sink(loop, {.path = path, .sink = {.batch_time = 100ms}});
    Sensor<Sample> sensor(loop, {.name = "clocked", .topic = "clocked", .rate = 200_Hz},
                          [] { return Sample{SystemClock().monotonic().time_since_epoch().count()}; });
    std::size_t done = 0;
    Ticker act(loop, {.period = 200ms, .phase = 200ms}, [&](const Tick&) {
      if (done == things.size()) return loop.stop();
      things[done++]();
    });
    loop.run();
    act.close();
    sensor.stop();  // a tick may come due while the loop closes
    counts = sensor.counts();
    close_balanced(loop);
  }
  CHECK(warnings == steps.size());
  CHECK(counts.failed == 0);
  CHECK(counts.published > 0);
  if (is_time_simulated()) {  // nothing else that could hold the loop
    CHECK(counts.missed == 0);
    CHECK(counts.late == 0);
    CHECK(counts.scheduled == (things.size() + 1) * 40 + 1);
  }
  check_verifies(path);

  const Recording recording = Recording::open(path).or_throw();
  const RunInfo run = recording.runs().or_throw().at(0);
  std::vector<Duration> noticed;
  Duration offset = run.clock_offset;
  const std::vector<RecordedClock> clock = recording.clock(1).or_throw();
  for (const RecordedClock& pair : clock) {
    const Duration now = pair.realtime.time_since_epoch() - pair.monotonic.time_since_epoch();
    if (pair.occasion == "step") {
      noticed.push_back(now - offset);
      offset = now;
    }
    CAPTURE(pair.occasion);
    CHECK(near(now, offset));
  }
  REQUIRE(noticed.size() == steps.size());
  for (std::size_t i = 0; i < steps.size(); ++i) CHECK(near(noticed[i], steps[i]));

  // As recorded: the monotonic clock, moved by one offset. As exported: right, from the first row to the last.
  Rows rows = recording.rows({.topic = "clocked"}).or_throw();
  std::uint64_t count = 0, jumps = 0;
  Time last{};
  while (const RecordedRow* row = rows.next().or_throw()) {
    const EventView event = row->event();
    const Duration monotonic{std::get<std::int64_t>(event.value("monotonic").value())};
    if (!near(event.time().time_since_epoch(), monotonic + run.clock_offset) || event.time() <= last) ++jumps;
    last = event.time();
    ++count;
  }
  CHECK(count == counts.published);
  CHECK(jumps == 0);
  std::stringstream csv;
  CHECK(export_rows(recording, {.filter = {.topic = "clocked"}, .time = ExportTime::utc}, csv).or_throw().rows ==
        count);
  std::string line;
  std::getline(csv, line);
  REQUIRE(line == "utc,origin,sequence,monotonic");
  std::uint64_t wrong = 0;
  while (std::getline(csv, line)) {
    const Duration utc{std::stoll(line)}, monotonic{std::stoll(line.substr(line.rfind(',') + 1))};
    if (!near(utc, monotonic + right)) ++wrong;
    --count;
  }
  CHECK(count == 0);
  CHECK(wrong == 0);
}

}  // namespace

TEST_SUITE("clock") {
  TEST_CASE(
      "US-26 the clock is set forwards by an hour while recording: no time jumps, the step is recorded, exports are "
      "right") {
    const TimeOfDay time_of_day;
    check_recording({[] { TimeOfDay::move(1h); }}, {1h}, time_of_day.right() + 1h);
  }
  TEST_CASE(
      "US-26 the clock is set backwards by an hour while recording: no time jumps, the step is recorded, exports are "
      "right") {
    const TimeOfDay time_of_day;
    check_recording({[] { TimeOfDay::move(-1h); }}, {-1h}, time_of_day.right() - 1h);
  }
  TEST_CASE("US-26 the clock is set from 1970 to now while recording: rows from before get the right time too") {
    const TimeOfDay time_of_day;
    TimeOfDay::set(Time{24h});
    const Duration off = time_of_day.right() - TimeOfDay::offset();
    check_recording({[&] { time_of_day.correct(); }}, {off}, time_of_day.right());
  }
  TEST_CASE("US-26 the clock is set many times while recording: the last time that can be right holds for the run") {
    const TimeOfDay time_of_day;
    TimeOfDay::set(Time{24h});
    const Duration off = time_of_day.right() - TimeOfDay::offset();
    check_recording({[&] { time_of_day.correct(); }, [] { TimeOfDay::move(1h); }, [] { TimeOfDay::move(-2h); },
                     [&] { time_of_day.correct(); }, [&] { TimeOfDay::move(-off); }},
                    {off, 1h, -2h, 1h, -off}, time_of_day.right());
  }
  TEST_CASE("NFR-4 a clock that is set moves no tick of a schedule") {
    const TimeOfDay time_of_day;
    Loop loop;
    be_quiet(loop);
    std::uint64_t ticks = 0, early = 0;
    std::uint64_t last = 0;
    Ticker tick(loop, 5ms, [&](const Tick& t) {
      if (t.now < t.due || (ticks > 0 && t.index != last + t.missed + 1)) ++early;
      last = t.index;
      if (++ticks % 10 == 0) TimeOfDay::move(ticks % 20 == 0 ? 3h : -3h);
      if (ticks == 100) loop.stop();
    });
    const Timer patience = limit(loop);
    const MonotonicTime begin = loop.now();
    loop.run();
    CHECK(ticks == 100);
    CHECK(early == 0);
    CHECK(loop.now() - begin >= 5ms * 98);
    if (is_time_simulated()) CHECK(last == 99);
    tick.close();
    close_balanced(loop);
  }
}
