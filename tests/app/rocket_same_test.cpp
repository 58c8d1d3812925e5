// examples/rocket, as JSON and in C++, decides the same: where a sensor is silent, on the ground, with fast sensors,
// and for how long its charges are on.
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <fstream>
#include <iterator>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "../examples/rocket/rocket.hpp"
#include "app/rocket_flying.hpp"
#include "outputs/memory_actuator.hpp"
#include "paths.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/process/expression.hpp"

using namespace rtdata;
using namespace rtdata::test;
using namespace std::chrono_literals;

namespace {

using States = std::vector<std::string>;
const States whole_flight = {"pad", "boost", "coast", "apogee", "descent", "landed"};

std::vector<Decision> fly_in_json(const Flight& flight) {
  static const JsonRocket rocket(in_source("examples/rocket/rocket.json"));
  return rocket.fly(flight);
}
States states_of(const std::vector<Decision>& decisions) {
  States states;
  for (const Decision& one : decisions) states.push_back(one.to);
  return states;
}
double first_to(const std::vector<Decision>& decisions, const std::string& state) {
  for (const Decision& one : decisions)
    if (one.to == state) return one.time;
  return std::nan("");
}
std::string text_of(const std::vector<Decision>& decisions) {
  std::string text;
  for (const Decision& one : decisions) text += std::to_string(one.time) + " " + one.to + ": " + one.cause + "\n";
  return text;
}

/// Both go to these states in the same tick. Returns when they are at the apogee.
std::array<double, 2> check_same(const Flight& flight, const States& states) {
  const auto json = fly_in_json(flight), cpp = fly_in_cpp(flight);
  INFO(flight.name << "\nJSON:\n" << text_of(json) << "C++:\n" << text_of(cpp));
  CHECK(states_of(json) == states);
  CHECK(states_of(cpp) == states);
  for (std::size_t i = 0; i < std::min(json.size(), cpp.size()); ++i)
    CHECK_MESSAGE(json[i].time == cpp[i].time, json[i].to);
  return {first_to(json, "apogee"), first_to(cpp, "apogee")};
}

/// How it is silent: the rows have no value of it, or one that is no number.
enum class Silence { absent, not_a_number };
Flight accelerometer_silent(Flight flight, double from, Silence how) {
  for (FlightRow& row : flight.rows)
    if (row.time >= from) {
      row.acceleration.reset();
      if (how == Silence::not_a_number) row.acceleration = std::numeric_limits<double>::quiet_NaN();
    }
  return flight;
}

/// Another altimeter opens the parachute at the apogee, and it sinks at 8 m/s.
Flight opened_by_another() {
  return simulated({.name = "opened by another",
                    .thrust = 5,
                    .burn = 1,
                    .fall = 8,
                    .fall_below = 8,
                    .opens = 0,
                    .noise = 0.3,
                    .dip = 0});
}

/// When a charge was set and when it was safe again, in s.
struct Charge {
  std::vector<double> on, off;
};
class ChargeLog {
 public:
  ChargeLog(Loop& loop, const std::string& name, Charge& charge)
      : seen_(loop.subscribe<OutputChange>(name, [&charge, start = loop.time()](const Event<OutputChange>& change) {
          if (change->cause == OutputCause::start || change->cause == OutputCause::stop) return;
          (change->asked == 1 ? charge.on : charge.off)
              .push_back(std::chrono::duration<double>(change.time - start).count());
        })) {}

 private:
  Subscription seen_;
};

/// The program in C++ with outputs, as on board.
struct ArmedInCpp {
  outputs_test::Device drogue_device, backup_device;
  ChargeLog drogue_log, backup_log;
  Output drogue, backup;
  rocket::Rocket rocket;
  ArmedInCpp(Loop& loop, Charge& on_drogue, Charge& on_backup)
      : drogue_log(loop, "drogue", on_drogue),
        backup_log(loop, "backup", on_backup),
        drogue(loop, {.name = "drogue", .lease = 2s}, drogue_device.make()),
        backup(loop, {.name = "backup", .lease = 2s}, backup_device.make()),
        rocket(loop, {.drogue = [this] { drogue.set(1).or_throw(); }, .backup = [this] { backup.set(1).or_throw(); }}) {
  }
};

struct NoSettings {
  friend constexpr auto parameters(type_tag<NoSettings>) { return parameter_list(); }
};

/// examples/rocket/rocket.json with devices of memory for its charges, which are armed from the start.
struct ArmedInJson {
  outputs_test::Device device;
  Registry registry = standard_registry();
  ChargeLog drogue_log, backup_log;
  std::unique_ptr<System> system;
  ArmedInJson(Loop& loop, Charge& on_drogue, Charge& on_backup)
      : drogue_log(loop, "drogue", on_drogue), backup_log(loop, "backup", on_backup) {
    registry.add_output<NoSettings>("memory", "a device of memory",
                                    [this](const NoSettings&) { return device.make()(); });
    std::ifstream file(in_source("examples/rocket/rocket.json"));
    std::string text(std::istreambuf_iterator<char>(file), {});
    const auto replace = [&text](const std::string& old, const std::string& with) {
      REQUIRE(text.find(old) != std::string::npos);
      text.replace(text.find(old), old.size(), with);
    };
    replace(R"("type": "gpio", "line": "GPIO22", "armed": "by command")", R"("type": "memory")");
    replace(R"("type": "gpio", "line": "GPIO23", "armed": "by command")", R"("type": "memory")");
    replace(R"(, "arm": ["drogue", "backup"])", "");
    ConfigDocument document = parse_config(text, "rocket.json");
    document.root.find("machines")->find(std::size_t{0})->remove("resume");
    SystemPlan plan = plan_system(registry, std::move(document));
    if (!plan.good()) throw std::runtime_error(plan.report());
    std::erase_if(plan.parts, [](const PartPlan& part) {
      return part.kind == "sink" || (part.kind == "sensor" && part.type != "vertical");
    });
    system = std::make_unique<System>(loop, registry, plan);
  }
};

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("rocket, as JSON and in C++: a step of pressure on the ground, and later one down, fires nothing") {
    Flight ground = on_pad(90, 20, 0.3);
    for (FlightRow& row : ground.rows)
      *row.altitude += 45 * std::clamp((row.time - 20) / 2.5, 0.0, 1.0) -
                       60 * std::clamp((row.time - 63) / 4, 0.0, 1.0);
    const States back = {"pad", "boost", "pad"};
    check_same(ground, {"pad"});  // at rest, by what is felt
    for (const Silence how : {Silence::absent, Silence::not_a_number})
      check_same(accelerometer_silent(ground, 0, how), back);
  }

  TEST_CASE("rocket, as JSON and in C++: an accelerometer that goes silent in the coast delays nothing") {
    const Flight flight = opened_by_another();
    const Flight fast = simulated(rockets()[5]);  // with a dip near Mach 1
    for (const Silence how : {Silence::absent, Silence::not_a_number}) {
      for (const double before : {2.0, 0.5, 0.2}) {
        Flight silent = accelerometer_silent(flight, flight.apogee - before, how);
        silent.name += ", silent " + std::to_string(before) + (how == Silence::absent ? " absent" : " nan");
        for (const double at : check_same(silent, whole_flight)) {
          const double off = at - flight.apogee;
          CHECK_MESSAGE((off > -1 && off < (before > 1.5 ? 0.5 : 2.5)), silent.name << " " << off);
        }
      }
      for (const double at : check_same(accelerometer_silent(fast, fast.burnout + 1, how), whole_flight))
        CHECK(std::abs(at - fast.apogee) < 1);
      if (const auto real = real_flight())  // with a dip of 5 s
        for (const double at : check_same(accelerometer_silent(*real, real->burnout + 1, how), whole_flight))
          CHECK_MESSAGE(std::abs(at - real->apogee) < 1, at);
    }
  }

  TEST_CASE("rocket, as JSON and in C++: sensors of 700 rows a second") {
    Rocket fast = rockets()[0];
    fast.rate = 700;
    fast.pad = 5;
    Flight flight = simulated(fast);
    std::erase_if(flight.rows, [&](const FlightRow& row) { return row.time > flight.landing + 16; });
    check_same(flight, whole_flight);
  }

  TEST_CASE("rocket, as JSON and in C++: the drogue is on for 2.5 s from the apogee, the backup for 2 s") {
    const Flight flight = simulated(rockets()[2]);
    const auto check = [&](const auto& fly) {
      Charge drogue, backup;
      const std::vector<Decision> decisions = fly(drogue, backup);
      REQUIRE(states_of(decisions) == whole_flight);
      for (const Charge* const charge : {&drogue, &backup}) {
        REQUIRE(charge->on.size() == 1);
        REQUIRE(charge->off.size() == 1);
      }
      const double apogee = first_to(decisions, "apogee");
      CHECK(std::abs(first_to(decisions, "descent") - apogee - 0.5) < 0.1);
      CHECK(std::abs(drogue.on[0] - apogee) < 0.1);
      CHECK(std::abs(drogue.off[0] - apogee - 2.5) < 0.1);
      CHECK(std::abs(backup.on[0] - apogee - 0.5) < 0.1);
      CHECK(std::abs(backup.off[0] - apogee - 2.5) < 0.1);
    };
    check([&](Charge& drogue, Charge& backup) {
      return flown(flight, [&](Loop& loop) { return std::make_unique<ArmedInJson>(loop, drogue, backup); });
    });
    check([&](Charge& drogue, Charge& backup) {
      return flown(flight, [&](Loop& loop) { return std::make_unique<ArmedInCpp>(loop, drogue, backup); });
    });
  }
}
