// examples/rocket by the real program: simulated flights and a real one, imported and replayed, with sensors that fail.
#include <doctest/doctest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <sstream>
#include <string>
#include <vector>

#include "app/decided.hpp"
#include "app/flights.hpp"
#include "app/process.hpp"
#include "paths.hpp"
#include "rtdata/process/expression.hpp"

using namespace rtdata::test;

namespace {

/// What examples/rocket/rocket.json decides of a flight.
Decided fly(const Flight& flight) {
  const Folder folder;
  folder.write("flight.csv", flight.csv());
  std::filesystem::copy_file(in_source("examples/rocket/rocket.json"), folder.path() + "/rocket.json");
  REQUIRE(run(folder, {"import", "flight.csv", "--time", "t", "--topic", "rocket", "--origin", "rocket", "--into",
                       "flight.db"}) == 0);
  run(folder, {"replay", "flight.db", "rocket.json", "--speed", "max"});  // fails where a sensor does
  return decided_in(folder.path() + "/rocket.db");
}

const std::vector<std::string> whole = {"pad", "boost", "coast", "apogee", "descent", "landed"};
const std::vector<std::string> up_to_descent = {"pad", "boost", "coast", "apogee", "descent"};

/// How far off a decision is: later is positive.
double off(const Decided& decided, const std::string& state, double truth) {
  const auto at = decided.at.find(state);
  return at != decided.at.end() ? at->second - truth : std::nan("");
}

void check_whole(const Flight& flight, const Decided& decided) {
  INFO(flight.name);
  CHECK(decided.states == whole);
  const double liftoff = off(decided, "boost", flight.liftoff);
  const double burnout = off(decided, "coast", flight.burnout);
  const double apogee = off(decided, "apogee", flight.apogee);
  const double landing = off(decided, "landed", flight.landing);
  CHECK_MESSAGE((liftoff > 0 && liftoff < 0.4), "liftoff " << liftoff);
  CHECK_MESSAGE((burnout > -flight.fading && burnout < 1), "burnout " << burnout);
  CHECK_MESSAGE((apogee > -1 && apogee < 1), "apogee " << apogee);
  CHECK_MESSAGE((landing > 0 && landing < 15), "landing " << landing);
  if (flight.dip_until > 0) CHECK(decided.at.at("apogee") > flight.dip_until);
}

/// The apogee within these, and nothing before it.
void check_apogee(const Flight& flight, const Decided& decided, double earliest, double latest, const char* cause) {
  INFO(flight.name);
  CHECK(decided.states.size() >= up_to_descent.size());
  const double apogee = off(decided, "apogee", flight.apogee);
  CHECK_MESSAGE((apogee >= earliest && apogee <= latest), "apogee " << apogee);
  if (decided.cause.contains("apogee")) CHECK(decided.cause.at("apogee") == cause);
}

/// The flights on which everything that can fail is tried: a simulated one, and the real one where it is.
std::vector<Flight> tried() {
  std::vector<Flight> flights{simulated(rockets()[5])};
  if (auto real = real_flight()) {
    flights.push_back(*std::move(real));
  } else {
    MESSAGE("skipped for the real flight: there is no ../shared/data/flight");
  }
  return flights;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-41 rocket: liftoff, burnout, apogee and landing of simulated flights from 50 m to 15 km") {
    for (const Rocket& rocket : rockets()) {
      const Flight flight = simulated(rocket);
      check_whole(flight, fly(flight));
    }
  }

  TEST_CASE("US-41 rocket: flights at random") {
    std::uint32_t first = 1;
    std::uint32_t count = 5;
    if (const char* const wanted = std::getenv("RTDATA_TEST_SEEDS"))  // "FIRST COUNT", to look for more
      std::istringstream(wanted) >> first >> count;
    for (std::uint32_t seed = first; seed < first + count; ++seed) {
      const Flight flight = simulated(any_rocket(seed), seed);
      check_whole(flight, fly(flight));
    }
  }

  TEST_CASE("US-41 rocket: a real flight, with its false dip of altitude near Mach 1") {
    const auto flight = real_flight();
    if (!flight) {
      MESSAGE("skipped: there is no ../shared/data/flight");
      return;
    }
    check_whole(*flight, fly(*flight));
  }

  TEST_CASE("US-41 rocket: with a barometer that is dead, frozen, or noisy") {
    for (const Flight& flight : tried()) {
      const double coast = flight.apogee - flight.burnout;
      // The speed that was felt drifts: a tenth of the time of the coast, and a little; it waits until that is sure.
      const double most = 1.5 + coast / 8;
      for (const double from : {0.0, flight.liftoff + 1, flight.burnout + coast / 2}) {
        const Decided dead = fly(barometer_dead(flight, from));
        check_apogee(flight, dead, -most, most, "apogee");
        CHECK(dead.states == up_to_descent);  // half an hour after the apogee it takes it for landed
        const Decided frozen = fly(barometer_frozen(flight, from));
        check_apogee(flight, frozen, -most, most, "apogee");
        CHECK(frozen.states == up_to_descent);
      }
      // High up in the descent, what does not change is no ground; just above it, it is.
      const Decided frozen_high = fly(barometer_frozen(flight, flight.apogee + 20));
      check_apogee(flight, frozen_high, -1, 1, "apogee");
      CHECK(frozen_high.states == up_to_descent);
      const double landing = off(fly(barometer_frozen(flight, flight.landing - 1)), "landed", flight.landing);
      CHECK_MESSAGE((landing > 0 && landing < 15), landing);
      for (const std::uint32_t seed : {1u, 2u}) {
        const Decided noisy = fly(barometer_noisy(flight, 20, seed));
        check_apogee(flight, noisy, -1, 1, "apogee");
        CHECK(noisy.states == whole);
      }
    }
  }

  TEST_CASE("US-41 rocket: with gaps of 2 s, and with an accelerometer that is saturated") {
    for (const Flight& flight : tried()) {
      // In the boost, over the burnout, in the dip: those delay nothing. Over the apogee: 1.2 s after its end.
      for (const double first : {flight.liftoff + 1, flight.burnout - 1, flight.burnout + 2, flight.apogee - 4})
        check_apogee(flight, fly(with_gaps(flight, 1e6, first)), -1, 1, "apogee");
      check_apogee(flight, fly(with_gaps(flight, 1e6, flight.apogee - 1)), 1, 2.3, "apogee");
      // Of each five seconds: where the apogee is in one, it is seen 1 s after the end.
      for (const double first : {3.0, 5.5}) {
        const Decided often = fly(with_gaps(flight, 5, first));
        const double apogee = off(often, "apogee", flight.apogee);
        CHECK_MESSAGE((apogee > -1 && apogee < 3.3), apogee);
      }
      check_whole(flight, fly(saturated(flight, 2)));
      // It shows 2 g for ever: that is no measurement, and the barometer says when it coasts.
      check_apogee(flight, fly(accelerometer_stuck(flight, flight.liftoff + 0.5, 2)), -1, 2, "apogee");
    }
  }

  TEST_CASE("US-41 rocket: popped, knocked, tipped or carried on the pad, it fires nothing and is ready again") {
    const std::vector<std::string> stays = {"pad"}, back = {"pad", "boost", "pad"};
    for (const double bias : {0.0, 0.05, 0.1, -0.1}) {
      // A pop, of 0.2 s or of 0.6 s; a minute later it is laid down, and after half a minute put up again.
      for (const double pop : {0.2, 0.6}) {
        const Flight popped = knocked(knocked(on_pad(120, 20, 0.5), 10, 10 + pop, 2.5), 70, 100, 0);
        const Flight flight = accelerometer_biased(popped, bias);
        INFO(bias << " " << pop);
        CHECK(fly(flight).states == stays);  // one and the same value is no liftoff unless the barometer climbs, too
        CHECK(fly(barometer_dead(flight, 0)).states == (pop < 0.3 ? stays : back));
        CHECK(fly(barometer_noisy(flight, 20, 1)).states == stays);
      }
    }
    // Noise alone, also where the rows come faster than its values.
    CHECK(fly(on_pad(600, 10, 20)).states == std::vector<std::string>{"pad"});
    CHECK(fly(barometer_slow(on_pad(300, 100, 5), 10)).states == std::vector<std::string>{"pad"});
    CHECK(fly(barometer_slow(on_pad(100, 500, 20), 50)).states == std::vector<std::string>{"pad"});
  }

  TEST_CASE("US-41 rocket: what was felt before the liftoff does not count") {
    Rocket rocket = rockets()[5];
    rocket.pad = 120;
    for (const double bias : {0.03, -0.03}) {
      rocket.bias = bias;
      const Flight flight = simulated(rocket);
      const Decided knock = fly(knocked(flight, 10, 10.25, 3));
      CHECK(knock.states == whole);
      CHECK(std::abs(off(knock, "apogee", flight.apogee)) < 1);
      const double coast = flight.apogee - flight.burnout;
      check_apogee(flight, fly(barometer_dead(knocked(flight, 10, 10.25, 3), flight.burnout + 5)), -1 - coast / 8,
                   1 + coast / 8, "apogee");
      const Decided chuffed = fly(barometer_dead(knocked(flight, 10, 10.6, 3), 0));
      REQUIRE(chuffed.states.size() >= 7);  // to boost and back, and then the flight
      CHECK(chuffed.states[2] == "pad");
    }
  }

  TEST_CASE("US-41 rocket: a barometer that flickers at one value, dips for 2 s, or is repeated, fires nothing early") {
    for (const Flight& flight : tried()) {
      const double coast = flight.apogee - flight.burnout;
      const double most = 1.5 + coast / 8;
      for (const double metres : {0.05, 0.3})
        for (const double from : {flight.liftoff + 2, flight.burnout + coast / 4})
          check_apogee(flight, fly(barometer_flickering(flight, from, metres)), -most, most, "apogee");
      for (const double speed : {150.0, 285.0})
        check_apogee(flight, fly(barometer_dipping(flight, flight.burnout + 2, 2, speed)), -1, 1, "apogee");
      check_apogee(flight, fly(barometer_slow(flight, 10)), -1, 1, "apogee");
      for (const double bias : {0.1, -0.1})
        check_apogee(flight, fly(accelerometer_biased(flight, bias)), -1, 1, "apogee");
    }
  }

  TEST_CASE("US-41 rocket: from 30 m to 20 km, on a still and on a noisy pad") {
    const Flight low = simulated({.name = "30 m",
                                  .thrust = 6,
                                  .burn = 0.6,
                                  .drag = 1e-3,
                                  .fall = 5,
                                  .fall_below = 5,
                                  .noise = 0.3,
                                  .dip = 0,
                                  .bias = 0.1});
    CHECK(low.height < 50);
    check_whole(low, fly(low));
    const Flight high = simulated(
        {.name = "20 km", .thrust = 9, .burn = 12, .drag = 6e-5, .fall = 60, .rate = 50, .noise = 2, .bias = -0.1});
    CHECK(high.height > 19e3);
    check_whole(high, fly(high));
  }

  TEST_CASE("US-40 US-39 rocket in C++: it decides the same flights") {
    const std::string program = built("examples/example_rocket");
    if (!std::filesystem::exists(program)) {
      MESSAGE("skipped: examples are not built");
      return;
    }
    const auto fly_in_cpp = [&](const Flight& flight) {
      const Folder folder;
      folder.write("flight.csv", flight.csv());
      REQUIRE(run(folder, {"import", "flight.csv", "--time", "t", "--topic", "rocket", "--origin", "rocket", "--into",
                           "flight.db"}) == 0);
      Process process(folder, program, {"flight.db", "decided.db"});
      process.end();
      CHECK(process.err == "");
      return decided_in(folder.path() + "/decided.db");
    };
    for (const Rocket& rocket : rockets()) {
      const Flight flight = simulated(rocket);
      check_whole(flight, fly_in_cpp(flight));
    }
    for (const Flight& flight : tried()) {
      const double coast = flight.apogee - flight.burnout;
      check_whole(flight, fly_in_cpp(flight));
      check_whole(flight, fly_in_cpp(saturated(flight, 2)));
      check_apogee(flight, fly_in_cpp(barometer_noisy(flight, 20, 1)), -1, 1, "apogee");
      check_apogee(flight, fly_in_cpp(barometer_frozen(flight, flight.burnout + coast / 2)), -1 - coast / 8,
                   1 + coast / 8, "apogee");
      check_apogee(flight, fly_in_cpp(barometer_flickering(flight, flight.burnout + coast / 4, 0.3)), -1 - coast / 8,
                   1.5 + coast / 8, "apogee");
      check_apogee(flight, fly_in_cpp(barometer_dipping(flight, flight.burnout + 2, 2, 285)), -1, 1, "apogee");
    }
    const Flight popped = knocked(knocked(on_pad(120, 20, 0.5), 10, 10.2, 2.5), 70, 100, 0);
    for (const double bias : {0.1, -0.1})
      CHECK(fly_in_cpp(accelerometer_biased(popped, bias)).states == std::vector<std::string>{"pad"});
  }
}
