// Recordings of what is made of other topics have the account of these: at any depth, of all loops, whatever comes and
// goes; and what is said of a recording at its end is what verify says of it.
#include <doctest/doctest.h>

#include <algorithm>
#include <cstdlib>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "fsm/configured.hpp"
#include "has.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/virtual_time.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/recording/replay.hpp"
#include "rtdata/sensors/derived.hpp"
#include "rtdata/sensors/limit.hpp"
#include "rtdata/sensors/trigger.hpp"
#include "rtdata/sensors/vertical.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace recordings;
using rtdata::test::has;
using namespace std::chrono_literals;

namespace {

/// Fails in the first 4 of each 10 reads.
Sensor<Climate> failing(Loop& loop, const std::string& name, Rate rate = 10_Hz) {
  Sensor<Climate> sensor(loop, {.name = name, .rate = rate, .faulted_after = 1000},
                         [reads = 0]() mutable -> Result<Climate> {
                           if (++reads % 10 < 4) return Error{Errc::io_failed, "no answer", "", "", ""};
                           return Climate{1.0 * reads, 2};
                         });
  sensor.on_error([](const ErrorReport&) {});
  return sensor;
}

fsm::MachineSettings machine_on(const std::string& name, const std::string& input) {
  return {.name = name,
          .inputs = {input},
          .max_age = 0s,
          .start = "low",
          .states = {{.name = "low"}, {.name = "high"}},
          .transitions = {{.from = "low", .to = "high", .when = "value > 50"},
                          {.from = "high", .to = "low", .when = "value < 10"}}};
}

std::uint64_t failed_of(Loop& loop, const std::string& name) {
  for (const SensorStatus& sensor : loop.runtime().sensors())
    if (sensor.name == name) return sensor.counts.failed;
  return 0;
}

const TopicLoss* loss_of(const RunReport& run, const std::string& topic) {
  for (const TopicLoss& loss : run.losses)
    if (loss.topic == topic) return &loss;
  return nullptr;
}

/// What each recording said at its end, in that order.
std::vector<std::shared_ptr<const RunReport>> said_by(Loop& loop) {
  std::vector<std::shared_ptr<const RunReport>> all;
  for (const detail::ClosedSink& sink : loop.runtime().core().closed_sinks)
    if (sink.is_recording) all.push_back(sink.recorded);
  return all;
}

std::string joined(const std::vector<std::string>& lines) {
  std::string all;
  for (const std::string& line : lines) all += line + "\n";
  return all;
}

unsigned seed_of_test() {
  const char* const wanted = std::getenv("RTDATA_TEST_SEED");
  return wanted != nullptr ? static_cast<unsigned>(std::strtoul(wanted, nullptr, 10)) : 1;
}

/// Keeps of each event the run that it is of.
class Runs final : public Writer {
 public:
  explicit Runs(std::vector<std::string>& to) : to_(to) {}
  Result<void> open() override { return {}; }
  Result<void> write(Batch& batch) override {
    for (const Record& record : batch) to_.push_back(record.info->topic + " " + record.info->run);
    return {};
  }

 private:
  std::vector<std::string>& to_;
};

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-26 a recording has the account of what its topics are made of on tiers, whatever is made first") {
    enum class First { sink, sources, derived };
    for (const First first : {First::sink, First::sources, First::derived}) {
      CAPTURE(static_cast<int>(first));
      const Folder folder;
      const std::string path = folder / "run.db";
      std::uint64_t failed = 0, failed_here = 0;
      {
        Loop loop{virtual_time()};
        loop.on_error([](const ErrorReport&) {});
        loop.runtime().on_log([](const LogRecord&) {});
        Tier fast(loop, {.name = "fast"}), slow(loop, {.name = "slow"});
        SqliteSink sink;
        Sensor<Climate> adc, here;
        DerivedSensor tenth, sum;
        std::optional<fsm::ConfiguredMachine> machine;
        const auto make_sink = [&] {
          sink = SqliteSink(loop, {.path = path, .sink = {.topics = {"sequence", "sum"}}});
        };
        const auto make_sources = [&] {
          adc = failing(fast.loop(), "adc", 100_Hz);
          here = failing(loop, "here", 50_Hz);
        };
        const auto make_derived = [&] {  // adc of one tier, over another, to a machine of the main loop
          tenth = DerivedSensor(slow.loop(), {.name = "tenth"}, {.on = "adc", .expression = "temperature * 10"});
          sum = DerivedSensor(fast.loop(), {.name = "sum"}, {.on = "here", .expression = "temperature + 1"});
          machine.emplace(loop, machine_on("sequence", "tenth"));
        };
        if (first == First::sink) make_sink();
        if (first == First::derived) make_derived();
        make_sources();
        if (first != First::derived) make_derived();
        if (first != First::sink) make_sink();
        loop.run_for(2s);
        CHECK(loop.close() == 0);
        failed = failed_of(loop, "adc");
        failed_here = failed_of(loop, "here");
        const auto said = said_by(loop);
        REQUIRE(said.size() == 1);
        REQUIRE(said[0] != nullptr);
        CHECK(joined(said[0]->lines) == joined(verified(path).runs.at(0).lines));
      }
      const VerifyReport report = check_balanced(path);
      const RunReport& run = report.runs.at(0);
      REQUIRE_MESSAGE(loss_of(run, "adc") != nullptr, report.text());
      REQUIRE(loss_of(run, "here") != nullptr);
      CHECK(failed > 0);
      CHECK(loss_of(run, "adc")->failed == failed);
      CHECK(loss_of(run, "here")->failed == failed_here);
      CHECK(loss_of(run, "adc")->made_of_it == std::vector<std::string>{"sequence"});
      CHECK(loss_of(run, "here")->made_of_it == std::vector<std::string>{"sum"});
      CHECK(
          has(joined(run.lines), " ticks of adc (failed " + std::to_string(failed) + "), of which sequence is made\n"));
      CHECK(number(path, "SELECT count(*) FROM rtdata_topic WHERE topic IN ('adc', 'here', 'tenth')") == 0);
      CHECK(number(path, "SELECT count(*) FROM rtdata_ledger WHERE topic IN ('adc', 'here', 'tenth')") == 3);
      CHECK(number(path, "SELECT count(*) FROM rtdata_ledger WHERE topic = 'tenth' AND made_of = 'adc'") == 1);
      const auto summaries = summary(Recording::open(path).or_throw(), 1).or_throw();
      for (const TopicSummary& topic : summaries)
        if (topic.topic == "adc") CHECK(topic.made_of_it == std::vector<std::string>{"sequence"});
    }
  }

  TEST_CASE("US-26 limits, machines of a program and vertical motion are made of topics, too") {
    const Folder folder;
    const std::string path = folder / "run.db";
    {
      Loop loop{virtual_time()};
      loop.on_error([](const ErrorReport&) {});
      loop.runtime().on_log([](const LogRecord&) {});
      const SqliteSink sink(loop, {.path = path, .sink = {.topics = {"alarm", "program", "up"}}});
      const Sensor<Climate> a = failing(loop, "a"), b = failing(loop, "b"), c = failing(loop, "c"),
                            other = failing(loop, "other");
      const LimitSensor alarm(loop, {.name = "alarm"}, {.on = "a", .field = "temperature", .high = 50});
      fsm::Machine machine(loop, {.name = "program", .start = "on"});
      machine.add_state("on");
      const fsm::Input<Climate> input(machine, "b");
      machine.start();
      const VerticalSensor up(loop, {.name = "up"}, {.accelerometer = "c", .acceleration = "temperature"});
      loop.advance(2s);
      loop.close();
    }
    const RunReport run = check_balanced(path).runs.at(0);
    std::set<std::string> topics;
    for (const TopicLoss& loss : run.losses)
      if (loss.failed > 0) topics.insert(loss.topic);
    CHECK(topics == std::set<std::string>{"a", "b", "c"});
  }

  TEST_CASE("US-26 what is made of others comes and goes while a recording goes on, which balances") {
    const Folder folder;
    const std::string path = folder / "run.db";
    std::uint64_t before = 0, after = 0, failed_b = 0;
    {
      Loop loop{virtual_time()};
      loop.on_error([](const ErrorReport&) {});
      loop.runtime().on_log([](const LogRecord&) {});
      Tier fast(loop, {.name = "fast"});
      const SqliteSink sink(loop, {.path = path, .sink = {.topics = {"made"}}});
      const Sensor<Climate> a = failing(fast.loop(), "a", 100_Hz), b = failing(loop, "b", 50_Hz);
      loop.run_for(2205ms);  // in the middle of a gap
      before = failed_of(loop, "a");
      CHECK(before > 0);
      DerivedSensor made(loop, {.name = "made"}, {.on = "a", .expression = "temperature"});
      loop.run_for(1s);
      made.close();
      made = DerivedSensor(loop, {.name = "made"}, {.on = "b", .expression = "temperature"});
      const std::uint64_t failed_b_before = failed_of(loop, "b");
      loop.run_for(1s);
      CHECK(loop.close() == 0);
      after = failed_of(loop, "a");
      failed_b = failed_of(loop, "b") - failed_b_before;
    }
    const RunReport run = check_balanced(path).runs.at(0);
    REQUIRE(loss_of(run, "a") != nullptr);
    CHECK(loss_of(run, "a")->failed <= after);
    CHECK(loss_of(run, "a")->failed >= after - before - 3);  // as it was made, the tier was heard
    REQUIRE(loss_of(run, "b") != nullptr);
    CHECK(loss_of(run, "b")->failed == failed_b);
  }

  TEST_CASE("US-26 events of a topic whose account alone is kept do not come over from its tier") {
    const Folder folder;
    const std::string path = folder / "run.db";
    std::uint64_t published = 0;
    {
      Loop loop{virtual_time()};
      Tier fast(loop, {.name = "fast", .ring_bytes = 4096});
      const SqliteSink sink(loop, {.path = path, .sink = {.topics = {"made"}}});
      Feed<Climate> daq(fast.loop(), {.name = "daq"});
      const TriggerSensor made(fast.loop(), {.name = "made"},
                               {.on = "daq", .when = "temperature < 0", .before = 0s, .events = 100});
      Ticker bursts(fast.loop(), 10ms, [&](const Tick&) {
        for (int i = 0; i < 500; ++i) daq.publish({1.0 * i, 0});
        daq.lost(1);
      });
      loop.run_for(500ms);
      CHECK(loop.close() == 0);
      for (const SensorStatus& sensor : loop.runtime().sensors())
        if (sensor.name == "daq") published = sensor.counts.published;
      CHECK_FALSE(loop.runtime().core().exchange.tiers_had_loss);
    }
    const RunReport run = check_balanced(path).runs.at(0);
    CHECK(published >= 500 * 40);
    CHECK(number(path, "SELECT filtered FROM rtdata_ledger WHERE topic = 'daq'") ==
          static_cast<std::int64_t>(published));
    CHECK(run.dropped == 0);
    REQUIRE(loss_of(run, "daq") != nullptr);
    CHECK(loss_of(run, "daq")->by_source >= 40);
  }

  TEST_CASE("FW-5 a replay of what is made of others has the account of these, too") {
    const Folder folder;
    const std::string path = folder / "run.db", copy = folder / "copy.db";
    {
      Loop loop{Loop::Manual{}};
      loop.on_error([](const ErrorReport&) {});
      loop.runtime().on_log([](const LogRecord&) {});
      const SqliteSink sink(loop, {.path = path, .sink = {.topics = {"tenth"}}});
      const Sensor<Climate> adc = failing(loop, "adc");
      Feed<Climate> board(loop, {.name = "board"});
      const DerivedSensor tenth(loop, {.name = "tenth"},
                                {.on = "adc", .with = {"board"}, .expression = "temperature * 10"});
      for (int i = 0; i < 5; ++i) {
        loop.advance(1s);
        board.publish({1, 2});
        board.lost(2);
      }
      board.fault({Errc::disconnected, "cannot hear", "", "it is gone", ""});
      loop.advance(1s);
      loop.close();
    }
    const RunReport first = check_balanced(path).runs.at(0);
    REQUIRE(loss_of(first, "adc") != nullptr);
    REQUIRE(loss_of(first, "board") != nullptr);
    CHECK(loss_of(first, "board")->by_source == 10);
    CHECK(loss_of(first, "board")->outages.number == 1);
    for (const bool takes_all : {true, false}) {
      CAPTURE(takes_all);
      std::filesystem::remove(copy);
      {
        ManualClock clock(first.info.started);
        Runtime runtime({.clock = &clock});
        Loop loop(runtime, {.name = "again"});
        loop.on_error([](const ErrorReport&) {});
        runtime.on_log([](const LogRecord&) {});
        const SqliteSink sink(
            loop, {.path = copy, .sink = {.topics = {takes_all ? std::string("#") : std::string("tenth")}}});
        const Replay replay(loop, {.file = path});
        for (int i = 0; i < 100 && !replay.is_done(); ++i) loop.advance(1min);
        CHECK(replay.is_done());
        CHECK(loop.close() == 0);
      }
      const RunReport again = check_balanced(copy).runs.at(0);
      CHECK(joined(again.lines) == joined(first.lines));
    }
  }

  TEST_CASE("US-26 what a recording says at its end is what verify says of it, whatever is recorded") {
    std::size_t losses = 0;
    for (unsigned seed = seed_of_test(); seed < seed_of_test() + 12; ++seed) {
      CAPTURE(seed);
      std::mt19937 random(seed);
      const auto below = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
      const Folder folder;
      std::vector<std::string> paths;
      std::map<std::string, std::vector<std::string>> made_of;
      std::map<std::string, std::uint64_t> failed;
      std::vector<std::pair<std::string, std::vector<std::string>>> recorded;  // from the beginning to the end
      std::vector<std::shared_ptr<const RunReport>> said;
      {
        Loop loop{Loop::Manual{.seed = seed}};
        loop.on_error([](const ErrorReport&) {});
        loop.runtime().on_log([](const LogRecord&) {});
        Tier fast(loop, {.name = "fast"}), slow(loop, {.name = "slow"});
        const auto some_loop = [&]() -> Loop& {
          const int which = below(3);
          return which == 0 ? loop : which == 1 ? fast.loop() : slow.loop();
        };
        std::vector<std::string> topics;
        std::vector<AnySensor> sensors;
        for (int i = 0; i < 3; ++i) {
          topics.push_back("s" + std::to_string(i));
          sensors.push_back(failing(some_loop(), topics.back(), Rate::hertz(10.0 * (1 + below(10)))));
        }
        for (int i = 0; i < 6; ++i) {
          const std::string on = topics[static_cast<std::size_t>(below(static_cast<int>(topics.size())))];
          const std::string name = "d" + std::to_string(i), field = on[0] == 's' ? "temperature" : "value";
          sensors.push_back(DerivedSensor(some_loop(), {.name = name}, {.on = on, .expression = field + " + 1"}));
          made_of[name] = {on};
          topics.push_back(name);
        }
        std::vector<SqliteSink> sinks;
        const auto record = [&] {
          std::vector<std::string> taken;
          for (int i = 1 + below(2); i > 0; --i)
            taken.push_back(topics[static_cast<std::size_t>(below(static_cast<int>(topics.size())))]);
          paths.push_back(folder / ("r" + std::to_string(paths.size()) + ".db"));
          SinkConfig config{.topics = taken};
          if (below(3) == 0) config.queue_bytes = 64 << 10;
          sinks.push_back(SqliteSink(loop, {.path = paths.back(), .sink = std::move(config)}));
          return taken;
        };
        for (int i = 0; i < 2; ++i) {
          auto taken = record();
          recorded.emplace_back(paths.back(), std::move(taken));
        }
        loop.run_for(1s);
        (void)record();  // after the beginning
        loop.run_for(1ms * below(2000));
        sinks.back().close();
        loop.run_for(1ms * below(1000));
        CHECK(loop.close() == 0);
        for (const std::string& topic : topics) failed[topic] = failed_of(loop, topic);
        said = said_by(loop);
      }
      REQUIRE(said.size() == paths.size());
      std::set<std::string> all_said, all_verified;
      for (std::size_t i = 0; i < paths.size(); ++i) {
        const VerifyReport report = check_balanced(paths[i]);
        REQUIRE(said[i] != nullptr);
        all_said.insert(joined(said[i]->lines));
        all_verified.insert(joined(report.runs.at(0).lines));
        losses += report.runs.at(0).losses.size();
      }
      CHECK(all_said == all_verified);
      for (const auto& one : recorded) {  // all that its topics are made of, and nothing else
        const auto& path = one.first;
        const auto& taken = one.second;
        CAPTURE(path);
        std::set<std::string> all(taken.begin(), taken.end());
        for (std::vector<std::string> next = taken; !next.empty();) {
          const std::string topic = next.back();
          next.pop_back();
          for (const std::string& source : made_of[topic])
            if (all.insert(source).second) next.push_back(source);
        }
        const RunReport run = verified(path).runs.at(0);
        for (const auto& of : failed) {
          const auto& topic = of.first;
          const auto& count = of.second;
          CAPTURE(topic);
          const TopicLoss* const loss = loss_of(run, topic);
          CHECK((loss != nullptr ? loss->failed : 0) == (all.contains(topic) ? count : 0));
        }
      }
    }
    CHECK(losses > 12);
  }

  TEST_CASE("FW-5 what is sent from memory is of the run of the first recording that takes it, else of the program's") {
    const Folder folder;
    std::vector<std::string> sent;
    std::string own;
    {
      Loop loop{Loop::Manual{}};
      const SinkConfig config{.name = "peer", .batch_time = 1ms};
      const Sink memory(loop, config, std::make_unique<Runs>(sent));
      Feed<Climate> a(loop, {.name = "a"}), b(loop, {.name = "b"});
      const auto publish = [&] {
        a.publish({1, 2});
        b.publish({1, 2});
        loop.advance(10ms);
      };
      own = loop.runtime().core().run_uuid();
      publish();
      SqliteSink first(loop, {.path = folder / "first.db", .sink = {.topics = {"a"}}});
      publish();
      const SqliteSink second(loop, {.path = folder / "second.db"});
      publish();
      first.close();
      publish();
      loop.close();
    }
    const auto run_in = [&](const char* name) {
      return Recording::open(folder / name).or_throw().runs().or_throw().at(0).uuid;
    };
    const std::string first = run_in("first.db"), second = run_in("second.db");
    CHECK(first != second);
    CHECK(sent == std::vector<std::string>{"a " + own, "b " + own, "a " + first, "b " + own, "a " + first,
                                           "b " + second, "a " + second, "b " + second});
  }
}
