// What becomes of reads, data and gaps in a recording.
#include <doctest/doctest.h>

#include <functional>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "rtdata/detail/sensors/transaction.hpp"
#include "sinks/recordings.hpp"

using namespace recordings;
using namespace std::chrono_literals;

TEST_SUITE_BEGIN("sinks");

namespace {

using Take = std::function<detail::Sampled(detail::SamplePort&)>;

/// A device of which one read brings what `take` hands over.
struct BurstDevice final : detail::SensorDevice {
  explicit BurstDevice(Take take_) : take(std::move(take_)) {}
  detail::Sampled sample(detail::SamplePort& port) override { return take(port); }
  Take take;
};
/// The same, on a lane.
struct BurstLane final : detail::LaneDevice {
  explicit BurstLane(Take take_) : take(std::move(take_)) {}
  struct Read final : detail::Transaction {
    void transact() noexcept override {}
  };
  std::shared_ptr<detail::Transaction> make_transaction() override { return std::make_shared<Read>(); }
  detail::Sampled decode(detail::Transaction&, detail::SamplePort& port) override { return take(port); }
  std::string lane_key() const override { return "chip"; }
  Error given_up_error() const override { return {Errc::timed_out, "no answer", "", "", ""}; }
  Take take;
};

struct BurstSensor : AnySensor {
  template <class Device>
  static BurstSensor make(Loop& loop, const SensorConfig& config, Take take) {
    return BurstSensor(
        detail::make_sensor(loop, config, detail::payload_type<Climate>(), std::make_unique<Device>(std::move(take))));
  }
  using AnySensor::AnySensor;
};

const Error garbled{Errc::bad_data, "a word of the FIFO is no sample", "chip", "", ""};
const Error no_answer{Errc::io_failed, "no answer", "chip", "", ""};

}  // namespace

TEST_CASE("US-5 reads and data are accounted for apart: ten reads of 32 samples balance") {
  for (const bool on_lane : {false, true}) {
    CAPTURE(on_lane);
    const Folder folder;
    const std::string path = folder / "run.db";
    SensorCounts counts;
    {
      Loop loop{Loop::Manual{}};
      loop.on_error([](const ErrorReport&) {});
      SqliteSink sink(loop, {.path = path});
      const Take burst = [n = 0](detail::SamplePort& port) mutable {
        for (int i = 0; i < 32; ++i) {
          Climate sample{static_cast<double>(n++), 40};
          port.publish(&sample);
        }
        return detail::Sampled::value;
      };
      const SensorConfig config{.name = "fifo", .rate = 10_Hz};
      BurstSensor fifo = on_lane ? BurstSensor::make<BurstLane>(loop, config, burst)
                                 : BurstSensor::make<BurstDevice>(loop, config, burst);
      loop.advance(950ms);
      fifo.stop();
      counts = fifo.counts();
      CHECK(loop.runtime().balances());
      CHECK_FALSE(loop.runtime().has_loss());
      loop.close();
    }
    CHECK(counts.scheduled == 10);
    CHECK(counts.taken == 10);
    CHECK(counts.received == 320);
    CHECK(counts.published == 320);
    CHECK(counts.balances());
    CHECK(number(path, "SELECT count(*) FROM fifo") == 320);
    CHECK(number(path, "SELECT count(*) FROM rtdata_ledger WHERE taken = 10 AND received = 320 AND published = 320") ==
          1);
    check_balanced(path);
    sql(path, "UPDATE rtdata_ledger SET taken = taken - 1, failed = failed + 1");
    CHECK(verified(path).verdict() == Verdict::not_balanced);  // a failed read has a gap
  }
}

TEST_CASE("US-5 what cannot be decoded is unreadable, and a read fails when it brings nothing usable") {
  for (const bool on_lane : {false, true}) {
    CAPTURE(on_lane);
    const Folder folder;
    const std::string path = folder / "run.db";
    SensorCounts counts;
    std::vector<Health> health;
    std::uint64_t errors = 0;
    {
      Loop loop{Loop::Manual{}};
      loop.on_error([](const ErrorReport&) {});
      SqliteSink sink(loop, {.path = path});
      int read = 0;
      AnySensor* sensor = nullptr;
      const Take take = [&](detail::SamplePort& port) {
        if (sensor != nullptr) health.push_back(sensor->health());
        Climate sample{1, 2};
        switch (read++) {
          case 0:  // an empty FIFO
            return detail::Sampled::value;
          case 1:  // one of three is no use: taken
            port.publish(&sample);
            port.unreadable(garbled);
            port.publish(&sample);
            return detail::Sampled::value;
          case 2:  // some, and then the bus fails: taken
            port.publish(&sample);
            return port.fail(no_answer);
          case 3:  // nothing but garbage, whatever it returns: failed
            port.unreadable(garbled);
            port.unreadable(garbled);
            return detail::Sampled::value;
          case 4:
            return port.fail(no_answer);
          case 5:  // old ones only
            port.repeated();
            port.repeated();
            return detail::Sampled::value;
          case 6:
            return detail::Sampled::nothing_new;
          default:
            port.publish(&sample);
            return detail::Sampled::value;
        }
      };
      const SensorConfig config{.name = "fifo", .rate = 10_Hz};
      BurstSensor fifo = on_lane ? BurstSensor::make<BurstLane>(loop, config, take)
                                 : BurstSensor::make<BurstDevice>(loop, config, take);
      sensor = &fifo;
      fifo.on_error([&](const ErrorReport&) { ++errors; });
      loop.advance(750ms);
      fifo.stop();
      counts = fifo.counts();
      CHECK(loop.runtime().balances());
      CHECK(loop.runtime().has_loss());
      loop.close();
    }
    CHECK(counts.scheduled == 8);
    CHECK(counts.taken == 6);
    CHECK(counts.failed == 2);
    CHECK(counts.published == 4);
    CHECK(counts.repeated == 3);
    CHECK(counts.unreadable == 3);
    CHECK(counts.received == 10);
    CHECK(errors == 4);
    REQUIRE(health.size() >= 7);
    const std::size_t first = health.size() - 8 + 2;  // of the third read on
    CHECK(health[first] == Health::degraded);
    CHECK(health[first + 3] == Health::degraded);
    CHECK(health[first + 4] == Health::ok);
    check_balanced(path);
    CHECK(number(path, "SELECT sum(count) FROM rtdata_gap WHERE kind = 'failed'") == 2);
    std::ostringstream out, err;
    CHECK(app::info({.database = path}, out, err) == 0);
    CHECK(out.str().find("2 failed, 3 unreadable") != std::string::npos);
    CHECK(verified(path).text().find("10 received, 3 of them unreadable") != std::string::npos);
    sql(path, "UPDATE rtdata_ledger SET unreadable = unreadable + 1");
    CHECK(verified(path).verdict() == Verdict::not_balanced);
  }
}

TEST_CASE("US-26 a device that fails at every second tick for an hour leaves some gaps, and the ledger is exact") {
  const Folder folder;
  const std::string path = folder / "run.db";
  SensorCounts counts;
  int lines = 0;
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([&](const LogRecord&) { ++lines; });
    SqliteSink sink(loop, {.path = path});
    Sensor<Climate> bad(loop, {.name = "bad", .rate = 10_Hz}, [n = 0]() mutable -> Result<Climate> {
      if (++n % 2 == 0) return no_answer;
      return Climate{static_cast<double>(n), 40};
    });
    loop.advance(1h);
    bad.close();
    counts = bad.counts();
    loop.close();
  }
  const VerifyReport report = check_balanced(path);
  CHECK(report.runs.at(0).failed == 18'000);
  CHECK(number(path, "SELECT count(*) FROM bad") == 18'001);
  CHECK(number(path, "SELECT sum(count) FROM rtdata_gap") == 18'000);
  CHECK(number(path, "SELECT count(*) FROM rtdata_gap WHERE kind = 'failed'") >= 15);
  const auto joined = number(path, "SELECT count(*) FROM rtdata_gap WHERE kind = 'joined'");
  CHECK(joined >= 55);
  CHECK(joined <= 61);
  // Of each joined gap: its rows and its count are the ticks from its first to its last.
  CHECK(number(path,
               "SELECT count(*) FROM rtdata_gap g WHERE kind = 'joined' AND (last - first) / 100000000 + 1 <> count + "
               "(SELECT count(*) FROM bad WHERE time BETWEEN g.first AND g.last)") == 0);
  CHECK(number(path,
               "SELECT count(*) FROM rtdata_gap a JOIN rtdata_gap b ON a.rowid < b.rowid AND a.last >= b.first") == 0);
  // Errors and changes of health are joined too, and none is forgotten.
  CHECK(number(path, "SELECT sum(count) FROM rtdata_error WHERE object = 'sensor bad'") == 18'000);
  CHECK(number(path, "SELECT count(*) FROM rtdata_error WHERE object = 'sensor bad'") <= 16 + 61);
  CHECK(number(path, "SELECT sum(count) FROM rtdata_health WHERE name = 'bad'") == 36'000);
  CHECK(number(path, "SELECT count(*) FROM rtdata_health WHERE name = 'bad'") <= 16 + 61);
  CHECK(number(path, "SELECT count(*) FROM rtdata_health WHERE last < time") == 0);
  CHECK(lines <= 16 + 61);
  sql(path, "DELETE FROM rtdata_gap WHERE rowid = (SELECT max(rowid) FROM rtdata_gap)");
  CHECK(verified(path).verdict() == Verdict::not_balanced);
}

TEST_CASE("US-26 a long outage is one gap, also after many short ones") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    bool is_away = false, is_well = false;
    Sensor<Climate> bad(loop, {.name = "bad", .rate = 10_Hz}, [&, n = 0]() mutable -> Result<Climate> {
      if (is_away || (!is_well && ++n % 2 == 0)) return no_answer;
      return Climate{};
    });
    loop.advance(10s);
    is_well = true;
    loop.advance(20min);
    is_away = true;
    loop.advance(1h);
    is_away = false;
    loop.advance(1min);
    is_well = false;
    loop.advance(10s);
    bad.close();
    loop.close();
  }
  check_balanced(path);
  CHECK(number(path, "SELECT count(*) FROM rtdata_gap WHERE kind = 'failed' AND count >= 36000") == 1);
  CHECK(number(path, "SELECT count(*) FROM rtdata_gap") <= 40);
}

TEST_CASE("US-26 reads that hang again and again leave some gaps that hold with the rows between them") {
  const Folder folder;
  const std::string path = folder / "run.db";
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    const Take take = [n = 0](detail::SamplePort& port) mutable {
      Climate sample{};
      if (++n % 3 == 0) return port.fail(no_answer);
      port.publish(&sample);
      return detail::Sampled::value;
    };
    loop.script_lane_duration(35ms);
    BurstSensor chip = BurstSensor::make<BurstLane>(loop, {.name = "chip", .rate = 100_Hz, .faulted_after = 100}, take);
    loop.advance(5min);
    chip.set_rate(90_Hz);
    loop.advance(5min);
    chip.close();
    loop.close();
  }
  const VerifyReport report = check_balanced(path);
  CHECK(report.runs.at(0).missed > 30'000);
  CHECK(report.runs.at(0).failed > 3000);
  CHECK(number(path, "SELECT count(*) FROM rtdata_gap") <= 40);
  // Each read makes a row: of each joined gap, ticks = rows + its count + those of gaps within it.
  CHECK(
      number(path,
             "SELECT count(*) FROM rtdata_gap g, rtdata_schedule s WHERE g.kind = 'joined' AND g.first >= s.first_due "
             "AND g.first <= s.end AND (g.last - g.first) / s.period + 1 <> g.count + "
             "(SELECT count(*) FROM chip WHERE time BETWEEN g.first AND g.last) + "
             "(SELECT coalesce(sum(count), 0) FROM rtdata_gap i WHERE i.rowid <> g.rowid AND i.first >= g.first AND "
             "i.last <= g.last)") == 0);
  CHECK(number(path,
               "SELECT count(*) FROM rtdata_gap a JOIN rtdata_gap b ON a.kind = 'joined' AND b.kind = 'joined' AND "
               "a.rowid < b.rowid AND a.last >= b.first") == 0);
}

TEST_SUITE_END();
