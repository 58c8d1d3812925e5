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

#define NEEDS_EXPRESSIONS() \
  if (!rtdata::Expression::available()) return

TEST_SUITE("app") {
  TEST_CASE("US-41 rocket: liftoff, burnout, apogee and landing of simulated flights from 50 m to 15 km") {
    NEEDS_EXPRESSIONS();
    for (const Rocket& rocket : rockets()) {
      const Flight flight = simulated(rocket);
      check_whole(flight, fly(flight));
    }
  }

  TEST_CASE("US-41 rocket: flights at random") {
    NEEDS_EXPRESSIONS();
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
    NEEDS_EXPRESSIONS();
    const auto flight = real_flight();
    if (!flight) {
      MESSAGE("skipped: there is no ../shared/data/flight");
      return;
    }
    check_whole(*flight, fly(*flight));
  }

  TEST_CASE("US-41 rocket: with a barometer that is dead, frozen, or noisy") {
    NEEDS_EXPRESSIONS();
    for (const Flight& flight : tried()) {
      const double coast = flight.apogee - flight.burnout;
      // The speed that was felt drifts: a tenth of the time of the coast, and a little.
      const double most = 1 + coast / 8;
      const char* const without = "apogee, without a barometer";
      for (const double from : {0.0, flight.liftoff + 1, flight.burnout + coast / 2}) {
        const Decided dead = fly(barometer_dead(flight, from));
        check_apogee(flight, dead, -most, most, without);
        CHECK(dead.states == up_to_descent);  // half an hour after the apogee it takes it for landed
        const Decided frozen = fly(barometer_frozen(flight, from));
        check_apogee(flight, frozen, -most, most, without);
        CHECK(frozen.states == up_to_descent);
      }
      // In the descent, there is nothing to tell it from a rocket that lies still.
      const double frozen_at = flight.apogee + 20;
      const double landing = off(fly(barometer_frozen(flight, frozen_at)), "landed", frozen_at);
      CHECK_MESSAGE((landing > 8 && landing < 15), landing);
      for (const std::uint32_t seed : {1u, 2u}) {
        const Decided noisy = fly(barometer_noisy(flight, 20, seed));
        check_apogee(flight, noisy, -1, 1, "apogee");
        CHECK(noisy.states == whole);
      }
    }
  }

  TEST_CASE("US-41 rocket: with gaps of 2 s, and with an accelerometer that is saturated") {
    NEEDS_EXPRESSIONS();
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
      // It shows 2 g for ever: no end of the boost is seen, and only that it falls.
      check_apogee(flight, fly(accelerometer_stuck(flight, flight.liftoff + 0.5, 2)), 2, 5, "it falls");
    }
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
                   1 + coast / 8, "apogee, without a barometer");
    }
  }
}
