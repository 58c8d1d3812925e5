// Another configuration takes the place of that of a running system: what becomes of each part, and what recordings
// keep.
#include "rtdata/config/change.hpp"
#include "has.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <condition_variable>
#include <fstream>
#include <iterator>
#include <memory>
#include <mutex>

#include "app/process.hpp"
#include "config/test_types.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/verify.hpp"
#include "rtdata/sensors/limit.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using test::Count;
using test::Folder;
using test::refusal;

namespace {

/// On a bus too, but cannot be made when it says so.
struct BrittleConfig {
  std::string bus;
  bool breaks = false;
  friend constexpr auto parameters(type_tag<BrittleConfig>) {
    return parameter_list(parameter("bus", &BrittleConfig::bus, "the bus that it is on", names_part("bus")),
                          parameter("breaks", &BrittleConfig::breaks, "it cannot be made"));
  }
};

/// Without a schedule.
struct PulsedConfig {
  double gain = 1;
  friend constexpr auto parameters(type_tag<PulsedConfig>) {
    return parameter_list(parameter("gain", &PulsedConfig::gain, "a factor"));
  }
};

/// A kind of a program's own.
struct LampConfig {
  std::string watches;
  std::uint64_t above = 1;
  bool sticks = false;
  friend constexpr auto parameters(type_tag<LampConfig>) {
    return parameter_list(parameter("watches", &LampConfig::watches, "a topic", required, names_part("topic")),
                          parameter("above", &LampConfig::above, "on above this number"),
                          parameter("sticks", &LampConfig::sticks, "no other can take it over"));
  }
};
struct Lamp {
  bool is_on = false;
  Subscription subscription;
};

/// A file that is closed when it may be.
struct SlowFile {
  std::mutex mutex;
  std::condition_variable changed;
  bool may_close = false;
  std::vector<std::string> happened;
  std::vector<std::uint64_t> sequences;  // in the order in which they were stored
  void note(const std::string& what) {
    const std::lock_guard lock(mutex);
    happened.push_back(what);
  }
};
struct SlowConfig {
  std::string path = "one";
  std::string label;
  SinkConfig sink = {};
  friend constexpr auto parameters(type_tag<SlowConfig>) {
    return parameter_list(parameter("path", &SlowConfig::path, "its file"),
                          parameter("label", &SlowConfig::label, "what it is called here"),
                          include_member(&SlowConfig::sink));
  }
};
class SlowWriter final : public Writer {
 public:
  SlowWriter(std::shared_ptr<SlowFile> file, std::string label) : file_(std::move(file)), label_(std::move(label)) {}
  Result<void> open() override {
    if (!std::exchange(is_open_, true)) file_->note("open " + label_);
    return {};
  }
  Result<void> write(Batch& batch) override {
    const std::lock_guard lock(file_->mutex);
    for (const Record& record : batch) file_->sequences.push_back(record.header.sequence);
    return {};
  }
  Result<void> close() override {
    file_->note("closing " + label_);
    std::unique_lock lock(file_->mutex);
    file_->changed.wait(lock, [&] { return file_->may_close; });
    file_->happened.push_back("closed " + label_);
    return {};
  }

 private:
  const std::shared_ptr<SlowFile> file_;
  const std::string label_;
  bool is_open_ = false;
};

Registry registry() {
  Registry registry = standard_registry();
  test::add_test_types(registry);
  registry.add_sensor<BrittleConfig>(
      "brittle", "may break", [](const BrittleConfig&) { return description_of<Count>(); },
      [](Loop& loop, const SensorConfig& common, const BrittleConfig& config) {
        if (config.breaks) throw SetupError({Errc::io_failed, "cannot make it", "the device", "it breaks", ""});
        return Sensor<Count>(loop, common, [] { return Count{1}; });
      });
  registry.add_sensor<PulsedConfig>(
      "pulsed", "has no schedule", [](const PulsedConfig&) { return description_of<Count>(); },
      [](Loop& loop, const FeedConfig& common, const PulsedConfig&) { return Feed<Count>(loop, common); });
  registry.add_kind("lamp", "lamps", "what shines", PartKind::Written::by_name);
  registry.add_part<LampConfig>("lamp", "led", "a light", [](PartPlan& plan, const LampConfig& config) {
    plan.make = [config](Loop& loop, const Parts&) {
      return PartObject::made_by<std::unique_ptr<Lamp>>([&] {
        auto lamp = std::make_unique<Lamp>();
        lamp->subscription = loop.subscribe(config.watches, [lamp = lamp.get(), config](const EventView& event) {
          lamp->is_on = event.sequence() > config.above;
        });
        return lamp;
      });
    };
    if (config.sticks)
      plan.make_again = [](const PartObject&) -> PartPlan::Make {
        throw SetupError({Errc::busy, "cannot take over", "the lamp", "it sticks", ""});
      };
  });
  return registry;
}

/// "sensor a: restarted (first)\n..."
std::string change(const std::string& now, const std::string& next) {
  const Registry types = registry();
  return plan_change(plan_system(types, parse_config(now, "now.json")),
                     plan_system(types, parse_config(next, "next.json")))
      .text();
}

std::string sensors(const std::string& list, const std::string& rest = "") {
  return R"({"sensors": [)" + list + R"(], "sinks": [{"type": "discard"}])" + rest + "}";
}

struct Running {
  explicit Running(const std::string& text) : plan(plan_system(types, parse_config(text, "f.json"))) {}
  SystemPlan next(const std::string& text) const { return plan_system(types, parse_config(text, "f.json")); }

  Registry types = registry();
  SystemPlan plan;
  Loop loop{Loop::Manual{}, plan.loop_config()};
  System system{loop, types, plan};
  const Runtime& runtime = loop.runtime();
};

using rtdata::test::has;

const std::string counter = R"({"name": "a", "type": "tallied", "rate": "100 Hz"})";

}  // namespace

TEST_SUITE("config") {
  TEST_CASE("NFR-6 each item of another configuration is unchanged, changed live, restarted, added or removed") {
    CHECK(change(sensors(counter), sensors(counter)) == "");
    CHECK(change(sensors(counter), sensors(R"({"rate": "100 Hz", "type": "tallied", "name": "a"})")) == "");
    CHECK(change(sensors(counter), sensors(R"({"name": "a", "type": "tallied", "rate": "50 Hz"})")) ==
          "sensor a: changed while it runs (rate)\n");
    CHECK(change(sensors(counter), sensors(R"({"name": "a", "type": "tallied", "rate": "50 Hz", "first": 7})")) ==
          "sensor a: restarted (rate, first)\n");
    CHECK(change(sensors(R"({"name": "a", "type": "tallied", "rate": "100 Hz", "first": 7})"), sensors(counter)) ==
          "sensor a: restarted (first)\n");
    CHECK(change(sensors(counter), sensors(R"({"name": "b", "type": "tallied", "rate": "100 Hz"})")) ==
          "sensor b: added\nsensor a: removed\n");
  }

  TEST_CASE("NFR-6 what uses a part that is restarted is restarted with it, and nothing else") {
    const auto with = [](const std::string& type) {
      return R"({"buses": {"x": {"type": ")" + type + R"("}, "y": {"type": "loopback"}}, "sensors": [
        {"name": "on_x", "type": "brittle", "rate": "1 Hz", "bus": "x"},
        {"name": "on_y", "type": "brittle", "rate": "1 Hz", "bus": "y"}], "sinks": [{"type": "discard"}]})";
    };
    Registry types = registry();
    types.add_bus<NoParameters>("other", "another",
                                [](Runtime&, const std::string&, const NoParameters&) { return 3; });
    const auto planned = [&](const char* type) { return plan_system(types, parse_config(with(type), "f.json")); };
    CHECK(plan_change(planned("loopback"), planned("other")).text() ==
          "bus x: restarted (type)\nsensor on_x: restarted (it uses bus x)\n");
  }

  TEST_CASE("NFR-6 what a run has fixed is refused, with the reason") {
    const std::string plain = sensors(counter);
    CHECK(has(change(plain, sensors(counter, R"(, "name": "other")")),
              "name: refused: the program reads it only when it starts"));
    CHECK(has(change(plain, sensors(counter, R"(, "loop": {"hold_limit": "1 s"})")), "loop: refused"));
    CHECK(has(change(plain, sensors(counter, R"(, "tiers": {"fast": {}})")),
              "tier fast: refused: a tier is made before"));
    CHECK(has(change(sensors(counter, R"(, "tiers": {"fast": {}})"), plain), "tier fast: refused"));
    CHECK(change(plain, sensors(counter, R"(, "notes": "second")")) ==
          "notes: changed while it runs (kept with the text)\n");
    CHECK(has(change(plain, sensors(R"({"name": "a", "type": "tallied", "rate": "100 Hz", "topic": "b"})")),
              "sensor a: refused: earlier in this run it published on topic a"));
    CHECK(has(change(plain, sensors(R"({"name": "a", "type": "absent", "rate": "100 Hz"})")),
              "sensor a: refused: the topic a carries other values"));
    CHECK(
        has(change(plain, sensors(R"({"name": "a", "type": "fed"})")), "sensor a: refused: a sensor with a schedule"));
  }

  TEST_CASE("US-8 US-5 a name that another tier is to have is refused whole, also when its sensor is gone") {
    const auto with = [](const std::string& list) { return sensors(list, R"(, "tiers": {"fast": {}, "slow": {}})"); };
    const auto on = [&](const std::string& tier, const std::string& rate = "100 Hz") {
      return R"({"name": "a", "type": "tallied", "rate": ")" + rate + "\"" +
             (tier.empty() ? "" : R"(, "tier": ")" + tier + "\"") + "}";
    };
    const std::string other = R"({"name": "b", "type": "tallied", "rate": "1 Hz", "tier": "fast"})";
    const std::string belongs = " until the end of the run; start the program again, or give it another name\n";
    CHECK(change(with(on("fast")), with(on("slow"))) == "sensor a: refused: its name belongs to tier fast" + belongs);
    CHECK(change(with(on("fast")), with(on(""))) == "sensor a: refused: its name belongs to tier fast" + belongs);
    CHECK(change(with(on("")), with(on("slow"))) == "sensor a: refused: its name belongs to the main loop" + belongs);
    CHECK(change(with(on("fast")), with(other)) == "sensor b: added\nsensor a: removed\n");

    Running run(with(on("fast") + ", " + other));
    run.loop.advance(100ms);
    const auto refused = [&](const std::string& text) {
      const SystemPlan plan = run.next(text);
      const PlanChange all = run.system.change_to(plan);
      CHECK(all.refused() == 1);
      CHECK(has(all.text(), "sensor a: refused: its name belongs to tier fast" + belongs));
      CHECK_THROWS_AS(run.system.apply(plan), SetupError);
    };
    refused(with(on("slow") + R"(, {"name": "c", "type": "tallied", "rate": "1 Hz"})"));
    CHECK(run.runtime.sensors().size() == 2);
    CHECK(run.system.apply(run.next(with(other))).refused() == 0);
    refused(with(on("slow") + ", " + other));
    refused(with(on("") + ", " + other));
    CHECK(run.system.apply(run.next(with(on("fast", "50 Hz") + ", " + other))).refused() == 0);
    run.loop.advance(100ms);
    CHECK(run.runtime.balances());
    CHECK(run.system.parts().get<AnySensor>("sensor", "a").status().counts.taken > 10);
  }

  TEST_CASE(
      "US-5 another configuration is applied in one turn: the ledger balances, and the recording says what was "
      "changed") {
    const Folder folder;
    const std::string path = folder.path() + "/run.db";
    const auto text = [&](const std::string& list) {
      return R"({"sensors": [)" + list + R"(], "sinks": [{"type": "sqlite", "path": ")" + path + R"("}]})";
    };
    const std::string first = text(counter + R"(, {"name": "b", "type": "tallied", "rate": "10 Hz"},
                                                  {"name": "c", "type": "tallied", "rate": "10 Hz"})");
    const std::string second = text(R"({"name": "a", "type": "tallied", "rate": "50 Hz"},
                                       {"name": "b", "type": "tallied", "rate": "10 Hz", "first": 1000},
                                       {"name": "d", "type": "tallied", "rate": "10 Hz"})");
    {
      Running run(first);
      Loop& loop = run.loop;
      System& system = run.system;
      loop.advance(995ms);
      const SystemPlan next = run.next(second);
      PlanChange done;
      loop.post([&] { done = system.apply(next); });
      loop.advance(1s);
      CHECK(done.text() ==
            "sensor a: changed while it runs (rate)\nsensor b: restarted (first)\nsensor d: added\n"
            "sensor c: removed\n");
      CHECK(system.sensor("a").rate() == 50_Hz);
      CHECK(system.sensor_names() == std::vector<std::string>{"a", "b", "d"});
      CHECK(system.change_to(next).is_empty());
      loop.close(1s);
      CHECK(run.runtime.balances());
      CHECK_FALSE(run.runtime.has_loss());
    }
    const Recording recording = Recording::open(path).or_throw();
    const VerifyReport report = verify(recording).or_throw();
    INFO(report.text());
    CHECK(report.verdict() == Verdict::balanced);
    const auto runs = recording.runs().or_throw();
    REQUIRE(runs.size() == 1);  // the sink went on
    const auto changes = recording.configurations(1).or_throw();
    REQUIRE(changes.size() == 1);
    CHECK(changes[0].object == "");
    CHECK(changes[0].text == second);
    CHECK(changes[0].time == runs[0].started + 995ms);
    for (const LedgerEntry& entry : recording.ledger(1).or_throw()) {
      CAPTURE(entry.origin);
      if (entry.origin == "a") CHECK(entry.stored == 100 + 51);
      if (entry.origin == "b") CHECK(entry.stored == 10 + 11);
      if (entry.origin == "b") CHECK(entry.last_sequence == 21);  // it went on
      if (entry.origin == "c") CHECK(entry.stored == 10);
      if (entry.origin == "d") CHECK(entry.stored == 11);
    }
  }

  TEST_CASE("US-5 a configuration with mistakes, or with what is refused, changes nothing") {
    Running run(sensors(counter));
    Loop& loop = run.loop;
    System& system = run.system;
    loop.advance(105ms);
    const AnySensor* before = &system.sensor("a");
    CHECK(has(refusal([&] { system.apply(run.next(sensors(R"({"name": "a", "type": "tallie", "rate": "1 Hz"})"))); }),
              "did you mean \"tallied\"?"));
    CHECK(has(refusal([&] {
                system.apply(run.next(sensors(R"({"name": "a", "type": "tallied", "rate": "1 Hz"})",
                                              R"(, "loop": {"hold_limit": "1 s"})")));
              }),
              "cannot apply the configuration: loop: the program reads it only when it starts"));
    CHECK(&system.sensor("a") == before);
    CHECK(system.sensor("a").rate() == 100_Hz);
    loop.advance(100ms);
    CHECK(run.runtime.has_loss() == false);
  }

  TEST_CASE("US-5 a sensor that is stopped stays so over a reload that makes it anew, also one that fails") {
    const auto text = [](const char* first, const char* breaks) {
      return sensors(R"({"name": "a", "type": "tallied", "rate": "100 Hz", "first": )" + std::string(first) +
                     R"(}, {"name": "b", "type": "tallied", "rate": "100 Hz", "first": )" + first +
                     R"(}, {"name": "c", "type": "brittle", "rate": "10 Hz", "breaks": )" + breaks + "}");
    };
    Running run(text("1", "false"));
    Loop& loop = run.loop;
    std::vector<std::string> told;
    loop.runtime().on_log(
        [&](const LogRecord& record) { told.push_back(std::string(record.object) + ": " + std::string(record.text)); });
    std::uint64_t seen = 0;
    const auto subscription = loop.subscribe("a", [&](const EventView&) { ++seen; });
    loop.advance(100ms);
    run.system.sensor("a").stop();
    loop.advance(0ns);
    seen = 0;
    CHECK(run.system.apply(run.next(text("7", "false"))).count(Fate::restarted) == 2);
    loop.advance(1s);
    CHECK_FALSE(run.system.sensor("a").is_running());
    CHECK(run.system.sensor("b").is_running());
    CHECK(told == std::vector<std::string>{
                      "sensor a: it was stopped, and stays stopped after the reload, until it is started"});
    CHECK(has(refusal([&] { run.system.apply(run.next(text("9", "true"))); }), "are running again"));
    loop.advance(1s);
    CHECK_FALSE(run.system.sensor("a").is_running());
    CHECK(run.system.sensor("b").is_running());
    CHECK(seen == 0);
    run.system.sensor("a").start();
    loop.advance(995ms);
    CHECK(seen == 100);
    loop.close(1s);
    CHECK(run.runtime.balances());
  }

  TEST_CASE("US-5 what cannot be made brings back all that was before") {
    const std::string two = sensors(counter + R"(, {"name": "b", "type": "brittle", "rate": "10 Hz"})");
    const std::string broken = sensors(R"({"name": "a", "type": "tallied", "rate": "100 Hz", "first": 5},
                                          {"name": "b", "type": "brittle", "rate": "10 Hz", "breaks": true},
                                          {"name": "c", "type": "tallied", "rate": "10 Hz"})");
    Running run(two);
    Loop& loop = run.loop;
    System& system = run.system;
    loop.advance(105ms);
    const std::string why = refusal([&] { system.apply(run.next(broken)); });
    CHECK(has(why, "f.json:2:"));
    CHECK(has(why, "it breaks"));
    CHECK(has(why, "the earlier parts are running again"));
    CHECK(system.sensor_names() == std::vector<std::string>{"a", "b"});
    CHECK(system.change_to(run.plan).is_empty());
    std::uint64_t seen = 0;
    const auto subscription = loop.subscribe("a", [&](const EventView&) { ++seen; });
    loop.advance(1s);
    CHECK(seen >= 99);
    loop.close(1s);
    CHECK(run.runtime.balances());
  }

  TEST_CASE("a part that says that it cannot be taken over: nothing is closed, and all goes on") {
    const auto text = [](int above) {
      return sensors(
          counter + R"(, {"name": "b", "type": "tallied", "rate": "10 Hz", "first": )" + std::to_string(above) + "}",
          R"(, "lamps": {"l": {"type": "led", "watches": "a", "sticks": true, "above": )" + std::to_string(above) +
              "}}");
    };
    Running run(text(3));
    run.loop.advance(15ms);
    const auto* const lamp = run.system.parts().find<std::unique_ptr<Lamp>>("lamp", "l");
    REQUIRE(lamp != nullptr);
    const AnySensor* const b = &run.system.sensor("b");
    const std::string why = refusal([&] { run.system.apply(run.next(text(5))); });
    CHECK(has(why, "it sticks"));
    CHECK(has(why, "the earlier parts are running again"));
    CHECK_MESSAGE(!has(why, "but not"), why);
    CHECK(run.system.parts().find<std::unique_ptr<Lamp>>("lamp", "l") == lamp);
    CHECK(&run.system.sensor("b") == b);
    CHECK(run.system.change_to(run.plan).is_empty());
    CHECK(!(*lamp)->is_on);
    run.loop.advance(100ms);
    CHECK((*lamp)->is_on);
    run.loop.close(1s);
    CHECK(run.runtime.balances());
  }

  TEST_CASE(
      "US-5 ticks that the closing of a slow recording costs are missed, of a sensor that is restarted with it too") {
    const Folder folder;
    const auto text = [&](const char* first, const char* deadline) {
      return R"({"sensors": [{"name": "a", "type": "tallied", "rate": "100 Hz", "first": )" + std::string(first) +
             R"(}], "sinks": [{"type": "sqlite", "name": "db", "path": ")" + folder.path() +
             R"(/run.db", "close_deadline": ")" + deadline + R"("}]})";
    };
    Running run(text("1", "10 s"));
    Loop& loop = run.loop;
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    const MonotonicTime began = loop.now();
    loop.advance(1s);
    loop.script_lane_duration(200ms);
    loop.post([&] { run.system.apply(run.next(text("5", "9 s"))); });
    loop.advance(10ms);
    loop.script_lane_duration(Duration{0});
    loop.advance(1s);
    REQUIRE(run.runtime.sensors().size() == 1);
    const SensorCounts counts = run.runtime.sensors()[0].counts;
    const auto ticks = static_cast<std::uint64_t>((loop.now() - began) / 10ms);
    CHECK(ticks >= 200 + 20);
    CHECK(counts.missed >= 19);
    CHECK(counts.scheduled + 2 >= ticks);
    for (const std::string& error : errors) CHECK_FALSE(has(error, "was not read"));
    loop.close(1s);
    CHECK(run.runtime.balances());
    CHECK(verify(Recording::open(folder.path() + "/run.db").or_throw()).or_throw().verdict() == Verdict::balanced);
  }

  TEST_CASE(
      "NFR-1 US-5 many sensors are changed a part at a time: the loop turns, and what is restarted misses ticks") {
    const Folder folder;
    const std::string path = folder.path() + "/run.db";
    const auto text = [&](unsigned count, const std::string& more) {
      std::string list = counter;
      for (unsigned i = 0; i < count; ++i)
        list += R"(, {"name": "s)" + std::to_string(i) + R"(", "type": "tallied", "rate": "100 Hz"})";
      return R"({"sensors": [)" + list + more + R"(], "sinks": [{"type": "sqlite", "name": "db", "path": ")" + path +
             R"("}], "tiers": {"fast": {}}})";
    };
    const auto restarted = [](const std::string& first) {  // on both loops
      return R"(, {"name": "b", "type": "tallied", "rate": "10 Hz", "first": )" + first +
             R"(}, {"name": "t", "type": "tallied", "rate": "10 Hz", "tier": "fast", "first": )" + first + "}";
    };
    const std::string second = text(20, restarted("5"));
    {
      Running run(text(0, restarted("1")));
      Loop& loop = run.loop;
      loop.advance(1s);
      const auto count_of = [&](const std::string& kind) { return run.system.parts().names(kind).size(); };
      const MonotonicTime began = loop.now() - 1s;
      std::vector<std::size_t> counts;  // how many sensors there were, one after the other
      const auto apply = [&](const std::string& to) {
        const SystemPlan next = run.next(to);
        REQUIRE(next.good());
        StepwiseChange change(run.system, next);
        counts.clear();
        while (change.step(Duration{0})) {
          if (counts.empty() || counts.back() != count_of("sensor")) counts.push_back(count_of("sensor"));
          loop.advance(10ms);
        }
        CHECK(change.is_applied());
        CHECK(run.system.change_to(next).is_empty());
        return change.changes().text();
      };
      std::string done = apply(second);
      CHECK(has(done, "sensor b: restarted (first)\n"));
      CHECK(has(done, "sensor s0: added\n"));
      REQUIRE(counts.size() == 25);
      for (std::size_t i = 0; i < counts.size(); ++i) CHECK(counts[i] == (i < 2 ? 3 - i : i - 1));
      done = apply(text(1, restarted("6")));
      CHECK(has(done, "sensor s19: removed\n"));
      REQUIRE(counts.size() >= 22);
      for (std::size_t i = 0; i < 22; ++i) CHECK(counts[i] == 23 - i);
      CHECK(run.system.sensor_names() == std::vector<std::string>{"a", "s0", "b", "t"});
      loop.advance(1s);
      for (const SensorStatus& sensor : run.runtime.sensors()) {
        CAPTURE(sensor.name);
        const bool is_restarted = sensor.name == "b" || sensor.name == "t";
        CHECK((sensor.counts.missed > 0) == is_restarted);
        const auto due = static_cast<std::uint64_t>((loop.now() - began) / 100ms);
        if (is_restarted) CHECK(sensor.counts.scheduled + 2 >= due);  // no tick is in no account
      }
      loop.close(1s);
      CHECK(run.runtime.balances());
    }
    const Recording recording = Recording::open(path).or_throw();
    for (const RecordedGap& gap : recording.gaps(1).or_throw()) CHECK(gap.reason == "made anew");
    CHECK(recording.gaps(1).or_throw().size() == 4);
    CHECK(recording.configurations(1).or_throw().size() == 2);
    CHECK(verify(recording).or_throw().verdict() == Verdict::balanced);
  }

  TEST_CASE("US-5 a source without a schedule that is made anew has an outage, and what is made of others has none") {
    const auto text = [](const char* gain, const char* factor) {
      return sensors(counter + R"(, {"name": "p", "type": "pulsed", "gain": )" + gain +
                     R"(}, {"name": "d", "type": "derived", "on": "a", "expression": "number * )" + factor + "\"}");
    };
    Running run(text("1", "1"));
    run.loop.advance(1s);
    const SystemPlan next = run.next(text("2", "3"));
    REQUIRE_MESSAGE(next.good(), next.report());
    StepwiseChange change(run.system, next);
    CHECK(change.changes().count(Fate::restarted) == 2);
    while (change.step(Duration{0})) run.loop.advance(10ms);
    const Outages outages = run.system.sensor("p").status().outages;
    CHECK(outages.number == 1);
    CHECK(outages.time >= 10ms);
    CHECK(run.system.sensor("d").status().outages.number == 0);
    run.loop.close(1s);
    CHECK(run.runtime.balances());
  }

  TEST_CASE("US-5 one of many that cannot be made: those before it go again, and what is unchanged is not touched") {
    for (const bool restarts_another : {false, true}) {
      CAPTURE(restarts_another);
      const auto text = [&](const std::string& more, const char* first) {
        return sensors(counter + R"(, {"name": "b", "type": "tallied", "rate": "10 Hz", "first": )" + first + "}" +
                       more);
      };
      std::string many;
      for (unsigned i = 0; i < 10; ++i)
        many += R"(, {"name": "s)" + std::to_string(i) + R"(", "type": "brittle", "rate": "10 Hz", "breaks": )" +
                (i == 7 ? "true" : "false") + "}";
      Running run(text("", "1"));
      run.loop.advance(1s);
      const AnySensor* const before = &run.system.sensor("a");
      const SystemPlan next = run.next(text(many, restarts_another ? "2" : "1"));
      REQUIRE(next.good());
      StepwiseChange change(run.system, next);
      const std::string why = refusal([&] {
        while (change.step(Duration{0})) run.loop.advance(10ms);
      });
      CHECK(has(why, "it breaks"));
      CHECK(has(why, "the earlier parts are running again"));
      CHECK_FALSE(change.is_applied());
      CHECK_FALSE(change.step(Duration::max()));
      CHECK(&run.system.sensor("a") == before);
      CHECK(run.system.sensor_names() == std::vector<std::string>{"a", "b"});
      CHECK(run.system.change_to(run.plan).is_empty());
      run.loop.advance(1s);
      run.loop.close(1s);
      CHECK(run.runtime.balances());
      CHECK_FALSE(run.runtime.has_loss());
    }
  }

  TEST_CASE("US-26 a sink that is added with the sensors it stores has their first events") {
    const Folder folder;
    const std::string path = folder.path() + "/late.db";
    const std::string added = counter + R"(, {"name": "c", "type": "tallied", "rate": "100 Hz"})";
    const auto sinks = [&](const std::string& more) {
      return R"({"type": "discard", "name": ")" + std::string(more.empty() ? "old" : "new") + R"("})" + more;
    };
    {
      Running run(R"({"sensors": [)" + counter + R"(], "sinks": [)" + sinks("") + "]}");
      run.loop.advance(1s);
      const SystemPlan next = run.next(R"({"sensors": [)" + added + R"(], "sinks": [)" +
                                       sinks(R"(, {"type": "sqlite", "path": ")" + path + "\"}") + "]}");
      StepwiseChange change(run.system, next);
      while (change.step(Duration{0})) run.loop.advance(10ms);
      run.loop.advance(1s);
      run.loop.close(1s);
    }
    for (const LedgerEntry& entry : Recording::open(path).or_throw().ledger(1).or_throw())
      if (entry.origin == "c") CHECK(entry.first_sequence == 1);
  }

  TEST_CASE("US-5 a sink that is made anew refuses the topic that it could not take before, and stores the others") {
    const Folder folder;
    const auto text = [&](const char* time) {
      return R"({"sensors": [)" + counter + R"(], "sinks": [{"type": "file", "name": "table", "batch_time": ")" + time +
             R"(", "path": ")" + folder.path() + "/a.csv\"}]}";
    };
    const auto lines = [&](const char* name) {
      std::ifstream file(folder.path() + name);
      return std::count(std::istreambuf_iterator<char>(file), {}, '\n');
    };
    Running run(text("100 ms"));
    run.loop.advance(1s);
    run.loop.topic<Alarm>("late").publish({});
    run.loop.advance(1s);
    run.system.apply(run.next(text("200 ms")));
    run.loop.advance(2s);
    CHECK(run.loop.runtime().sinks().front().health == Health::faulted);
    run.loop.close(1s);
    CHECK(lines("/a-00000001.csv") > 2);
    CHECK(lines("/a.csv") >= lines("/a-00000001.csv") - 2);  // as long again
  }

  TEST_CASE("US-5 a recording whose file changes is closed while the loop turns; nothing is lost, also when it fails") {
    const Folder folder;
    const auto text = [&](const char* file, const char* breaks) {
      return R"({"sensors": [)" + counter + R"(, {"name": "b", "type": "brittle", "rate": "10 Hz", "breaks": )" +
             breaks + R"(}], "sinks": [{"type": "sqlite", "name": "db", "topics": ["a"], "path": ")" + folder.path() +
             "/" + file + "\"}]}";
    };
    {
      Running run(text("first.db", "false"));
      run.loop.advance(1s);
      const auto closed = [&] { return run.loop.runtime().core().closed_sinks.size(); };
      run.system.apply(run.next(text("second.db", "false")));
      CHECK(closed() == 0);  // it is still being closed
      run.loop.advance(1s);
      CHECK(closed() == 1);
      // This needs the file of before again, at once.
      CHECK(has(refusal([&] { run.system.apply(run.next(text("third.db", "true"))); }), "it breaks"));
      run.loop.advance(1s);
      run.loop.close(1s);
    }
    std::uint64_t next_sequence = 1;
    for (const char* file : {"first.db", "second.db"}) {
      const Recording recording = Recording::open(folder.path() + "/" + file).or_throw();
      const VerifyReport report = verify(recording).or_throw();
      INFO(report.text());
      CHECK(report.verdict() == Verdict::balanced);
      auto rows = recording.rows({.topic = "a", .origin = "a"}).or_throw();
      while (const RecordedRow* row = rows.next().or_throw()) CHECK(row->header().sequence == next_sequence++);
    }
    CHECK(next_sequence > 290);
  }

  // With threads: in virtual time closing takes none.
  TEST_CASE("US-5 a sink that is made anew on its file waits for the end of the one before, and the loop does not") {
    const auto file = std::make_shared<SlowFile>();
    Registry types = registry();
    types.add_sink<SlowConfig>(
        "slow", "is closed when it may be", [](const SlowConfig& config) { return config.path; },
        [file](Loop& loop, const SlowConfig& config) {
          return Sink(loop, config.sink, std::make_unique<SlowWriter>(file, config.label));
        });
    const auto plan_of = [&](const std::string& label) {
      return plan_system(types,
                         parse_config(R"({"sensors": [)" + counter + R"(], "sinks": [{"type": "slow", "name": "s",
        "batch_time": "10 ms", "label": ")" +
                                          label + "\"}]}",
                                      "f.json"));
    };
    const SystemPlan plan = plan_of("first"), next = plan_of("second");
    std::uint64_t last = 0;
    {
      Loop loop(plan.loop_config());
      System system(loop, types, plan);
      bool is_over = false, is_waited_for = false;
      const Subscription events = loop.subscribe("a", [&](const EventView& event) {
        last = event.sequence();
        if (is_waited_for && last > 20) loop.stop();
      });
      std::optional<StepwiseChange> change;
      Timer later;
      Ticker steps(loop, 10ms, [&](const Tick& tick) {
        if (tick.index < 10) return;
        if (is_over) return;
        if (!change) change.emplace(system, next);
        if (change->step(1ms)) return;
        is_over = true;
        const SinkStatus status = system.sink("s").status();
        CHECK(status.health == Health::degraded);
        CHECK(status.reason == "waits until the sink that had its file has ended; events wait in the queue");
        // While the loop turns.
        later = Timer(loop, 100ms, [&] {
          CHECK(system.sink("s").counts().queued > 0);
          {
            const std::lock_guard lock(file->mutex);
            file->may_close = true;
          }
          file->changed.notify_all();
          system.sink("s").sync([&] {
            CHECK(system.sink("s").health() == Health::ok);
            is_waited_for = true;
          });
        });
      });
      loop.run();
      CHECK(loop.close(10s) == 0);
      CHECK(system.lost_in_changes() == 0);
    }
    CHECK(file->happened == std::vector<std::string>{"open first", "closing first", "closed first", "open second",
                                                     "closing second", "closed second"});
    REQUIRE(last > 20);
    CHECK(file->sequences.size() >= last);
    for (std::size_t i = 0; i < file->sequences.size(); ++i) CHECK(file->sequences[i] == i + 1);
  }

  // With threads: in virtual time no tier publishes while a step runs.
  TEST_CASE("US-26 US-5 what a tier publishes while one recording is closed and another made is in one of them") {
    const Folder folder;
    constexpr int files = 16;
    const auto path = [&](int file) { return folder.path() + "/" + std::to_string(file) + ".db"; };
    const auto text = [&](int file) {
      return R"({"tiers": {"fast": {}}, "sensors": [
        {"name": "a", "type": "tallied", "rate": "5 kHz", "tier": "fast"}], "sinks": [{"type": "sqlite", "name": "db", "path": ")" +
             path(file) + "\"}]}";
    };
    {
      const Registry types = registry();
      const SystemPlan plan = plan_system(types, parse_config(text(0), "f.json"));
      Loop loop(plan.loop_config());
      System system(loop, types, plan);
      int file = 0;
      Ticker reloads(loop, 40ms, [&](const Tick&) {
        if (++file == files) return loop.stop();
        system.apply(plan_system(types, parse_config(text(file), "f.json")));
      });
      loop.run();
      CHECK(loop.close(10s) == 0);
    }
    std::uint64_t last = 0;
    for (int file = 0; file < files; ++file) {
      CAPTURE(file);
      const Recording recording = Recording::open(path(file)).or_throw();
      const VerifyReport report = verify(recording).or_throw();
      INFO(report.text());
      CHECK(report.verdict() == Verdict::balanced);
      auto rows = recording.rows({.topic = "a"}).or_throw();
      std::uint64_t missing = 0;
      while (const RecordedRow* row = rows.next().or_throw())
        missing += row->header().sequence - std::exchange(last, row->header().sequence) - 1;
      CHECK(missing == 0);
    }
    CHECK(last > 100);
  }

  TEST_CASE("US-26 a recording that begins again since a reload failed has the text that holds") {
    const Folder folder;
    const std::string path = folder.path() + "/run.db";
    const auto text = [&](const char* breaks, const char* deadline) {
      return R"({"sensors": [{"name": "b", "type": "brittle", "rate": "10 Hz", "breaks": )" + std::string(breaks) +
             R"(}], "sinks": [{"type": "sqlite", "name": "db", "path": ")" + path + R"(", "close_deadline": ")" +
             deadline + R"("}]})";
    };
    {
      Running run(text("false", "10 s"));
      run.loop.advance(1s);
      CHECK(has(refusal([&] { run.system.apply(run.next(text("true", "9 s"))); }), "it breaks"));
      run.loop.advance(1s);
      run.loop.close(1s);
    }
    const Recording recording = Recording::open(path).or_throw();
    const auto runs = recording.runs().or_throw();
    REQUIRE(runs.size() == 3);
    CHECK(runs[0].configuration == "");  // that of the runtime, which was given none
    CHECK(runs[2].configuration == "");
    CHECK(recording.configurations(3).or_throw().empty());
    // The run that was begun for what then failed says that it did not hold.
    const auto changes = recording.configurations(2).or_throw();
    REQUIRE(changes.size() == 1);
    CHECK(changes[0].object == "");
    CHECK(changes[0].text == "");
  }

  TEST_CASE("US-7 parts that are added and removed at run time are kept with their times, also by a later recording") {
    const Folder folder;
    const std::string path = folder.path() + "/run.db", later = folder.path() + "/later.db";
    const auto sink = [](const std::string& file) { return R"({"type": "sqlite", "path": ")" + file + R"("})"; };
    const std::string text = R"({"sensors": [)" + counter + R"(], "sinks": [)" + sink(path) + "]}";
    const std::string added = R"({"name": "late", "type": "tallied", "rate": "10 Hz"})";
    {
      Running run(text);
      Loop& loop = run.loop;
      System& system = run.system;
      loop.advance(500ms);
      CHECK(system.add("sensor", parse_config(added, "x").or_throw()) == "late");
      loop.advance(500ms);
      system.add("sensor", parse_config(R"({"name": "brief", "type": "tallied", "rate": "10 Hz"})", "x").or_throw());
      system.remove("sensor", "brief");
      system.add_sink(parse_config(sink(later), "x").or_throw());
      loop.advance(500ms);
      system.remove_sensor("a");
      loop.advance(500ms);
      loop.close(1s);
    }
    const Recording recording = Recording::open(path).or_throw();
    const Time started = recording.runs().or_throw()[0].started;
    const auto changes = recording.configurations(1).or_throw();
    REQUIRE(changes.size() == 5);
    CHECK(changes[0].object == "sensor late");
    CHECK(parse_config(changes[0].text, "x").or_throw() == parse_config(added, "x").or_throw());
    CHECK(changes[0].time == started + 500ms);
    CHECK(changes[1].object == "sensor brief");
    CHECK(changes[2].object == "sensor brief");
    CHECK(changes[2].text == "");
    CHECK(changes[3].object == "sink " + later);
    CHECK(changes[4].object == "sensor a");
    CHECK(changes[4].time == started + 1500ms);
    const Recording second = Recording::open(later).or_throw();
    const auto known = second.configurations(1).or_throw();
    REQUIRE(known.size() == 3);
    CHECK(known[0].object == "sensor late");
    CHECK(known[0].time == started + 500ms);
    for (const Recording* one : {&recording, &second}) {
      const VerifyReport report = verify(*one).or_throw();
      INFO(report.text());
      CHECK(report.verdict() == Verdict::balanced);
    }
  }

  TEST_CASE("US-26 a text of a configuration that was changed afterwards is found") {
    const Folder folder;
    const std::string path = folder.path() + "/run.db";
    {
      Running run(R"({"sensors": [)" + counter + R"(], "sinks": [{"type": "sqlite", "path": ")" + path + R"("}]})");
      run.loop.advance(100ms);
      run.system.add_sensor(parse_config(R"({"name": "late", "type": "tallied", "rate": "10 Hz"})", "x").or_throw());
      run.loop.advance(100ms);
      run.loop.close(1s);
    }
    const auto verdict = [&] { return verify(Recording::open(path).or_throw()).or_throw().verdict(); };
    CHECK(verdict() == Verdict::balanced);
    recordings::sql(path, "UPDATE rtdata_configuration SET text = replace(text, '10', '20')");
    CHECK(verdict() == Verdict::not_balanced);
  }

  TEST_CASE(
      "NFR-6 a kind of parts of a program's own is read, compared, made, changed and closed as those that are "
      "shipped") {
    const std::string text = sensors(counter, R"(, "lamps": {"red": {"type": "led", "watches": "a", "above": 5}})");
    Running run(text);
    CHECK(has(run.types.schema(), "\"lamps\""));
    CHECK(has(run.next(sensors(counter, R"(, "lamps": {"red": {"type": "led", "watches": "b"}})")).problems.text(),
              "nothing of this configuration publishes on \"b\""));
    CHECK(has(refusal([&] { run.types.add_kind("lamp", "more", "", PartKind::Written::list); }), "already"));
    CHECK(has(refusal([&] { run.types.add_kind("log", "log", "", PartKind::Written::list); }), "is a setting"));
    Loop& loop = run.loop;
    System& system = run.system;
    const auto is_on = [&](const char* name) { return system.parts().get<std::unique_ptr<Lamp>>("lamp", name)->is_on; };
    CHECK(system.add("lamp", parse_config(R"({"type": "led", "watches": "a", "above": 500})", "x").or_throw(), "dim") ==
          "dim");
    loop.advance(1s);
    CHECK(is_on("red"));
    CHECK_FALSE(is_on("dim"));
    CHECK(system.apply(run.next(sensors(counter))).text() == "lamp red: removed\nlamp dim: removed\n");
    CHECK(system.parts().names("lamp").empty());
    CHECK(has(refusal([&] { system.add("lmp", ConfigItem(), "x"); }), "there is no kind \"lmp\""));
  }
}
