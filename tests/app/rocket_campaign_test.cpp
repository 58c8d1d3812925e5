// examples/rocket on flights at random, with sensors that fail: thousands through the estimate and its decisions alone,
// some through whole machines, from JSON and in C++.
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "../examples/rocket/rocket.hpp"
#include "app/random_flights.hpp"
#include "app/rocket_decisions.hpp"
#include "app/rocket_flying.hpp"
#include "paths.hpp"
#include "rtdata/process/expression.hpp"

using namespace rtdata;
using namespace rtdata::test;

namespace {

struct Campaign {
  std::uint64_t first = 1, count = 600;
  bool is_long = false;
};
/// Or what "FIRST COUNT" in RTDATA_TEST_SEEDS says.
Campaign campaign_of_flights() {
  Campaign campaign;
  if (const char* const wanted = std::getenv("RTDATA_TEST_SEEDS")) {
    std::istringstream(wanted) >> campaign.first >> campaign.count;
    campaign.is_long = true;
  }
  return campaign;
}

Flight rows_of(const RandomFlight& random) {
  Flight flight{random.what};
  for (const RandomRow& row : random.rows) {
    FlightRow one{row.time};
    if (std::isfinite(row.altitude)) one.altitude = row.altitude;
    if (std::isfinite(row.acceleration)) one.acceleration = row.acceleration;
    flight.rows.push_back(one);
  }
  return flight;
}

std::vector<Decision> fly_campaign_in_cpp(const Flight& flight) {
  return flown(flight, [](Loop& loop) {
    return std::make_unique<rocket::Rocket>(loop, rocket::Charges{[] {}, [] {}});
  });
}

/// A log of ../shared/data/flight-fast at this rate, or at its own (0), after 10 s on the pad; without rows: it is not
/// there. Its apogee is where the barometer is highest, if nobody says `apogee`.
RandomFlight logged(const std::string& name, double rate, double apogee = 0) {
  RandomFlight flight{.what = name};
  std::ifstream file(in_source("../shared/data/flight-fast/" + name));
  std::string line;
  std::getline(file, line);
  double next = 0, highest = -1e9;
  while (std::getline(file, line)) {
    std::istringstream cells(line);
    std::string time, altitude, acceleration;
    std::getline(cells, time, ','), std::getline(cells, altitude, ','), std::getline(cells, acceleration, ',');
    const double at = std::stod(time) + 10;
    if (at < next) continue;
    if (rate > 0) next = at + 1 / rate;
    const RandomRow row{at, altitude.empty() ? std::nan("") : std::stod(altitude),
                        acceleration.empty() ? std::nan("") : std::stod(acceleration)};
    if (flight.rows.empty())
      for (double t = 0; t < at - 0.02; t += 0.05)
        flight.rows.push_back({t, row.altitude + 0.3 * std::sin(t * 17),
                               std::isnan(row.acceleration) ? row.acceleration : 1 + 0.02 * std::sin(t * 31)});
    flight.rows.push_back(row);
    if (row.altitude > highest) highest = row.altitude, flight.apogee = at;
  }
  if (apogee > 0) flight.apogee = apogee + 10;
  return flight;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("rocket: a real flight to Mach 1.7, whose static port reads 784 m too low, and one by a barometer alone") {
    for (const double rate : {0.0, 10.0, 20.0, 50.0}) {
      const RandomFlight fast = logged("irec_2023.csv", rate, 40.8), slow = logged("barometer_only_2023.csv", rate);
      if (fast.rows.empty() || slow.rows.empty()) {
        MESSAGE("skipped: there is no ../shared/data/flight-fast");
        return;
      }
      RandomFlight clipped = fast, blind = fast, deaf = fast;
      for (RandomRow& row : clipped.rows) row.acceleration = std::clamp(row.acceleration, -2.0, 2.0);
      for (RandomRow& row : blind.rows) row.altitude = std::nan("");
      for (RandomRow& row : deaf.rows) row.acceleration = std::nan("");
      const std::array<const RandomFlight*, 5> flights = {&fast, &clipped, &blind, &deaf, &slow};
      for (const RandomFlight* const flight : flights) {
        const std::optional<double> off = fired(*flight);
        INFO(flight->what << " " << rate);
        REQUIRE(off.has_value());
        CHECK_MESSAGE((*off > -2 && *off < 3), *off);
      }
    }
  }

  TEST_CASE("US-41 rocket campaign: flights at random fire at the apogee") {
    const Campaign campaign = campaign_of_flights();
    std::uint64_t early = 0, never = 0, late = 0, late_calm = 0, nothing_works = 0;
    std::map<std::string, std::uint64_t> why;
    for (std::uint64_t seed = campaign.first; seed < campaign.first + campaign.count; ++seed) {
      const RandomFlight flight = random_flight(seed);
      const std::optional<double> off = fired(flight);
      const bool is_early = off && *off < -2, is_late = off && *off > 4;
      const bool is_never = !off || flight.apogee + *off > flight.landing;
      early += is_early;
      if (!flight.works && (is_never || is_late)) {
        ++nothing_works;
        continue;
      }
      late += is_late && !is_never, never += is_never;
      // By a barometer alone, `burn` has to be over.
      const double locked = std::max(0.0, flight.liftoff + 7 - flight.apogee);
      late_calm += off && !flight.has_accelerometer && flight.is_calm && *off > 5 + locked;
      if (is_early || is_late || is_never) ++why[flight.what];
      if (is_early || is_never)
        MESSAGE("flight " << seed << " (" << flight.what << "): " << (off ? std::to_string(*off) : "never"));
    }
    if (campaign.is_long) {
      for (const auto& [what, times] : why) MESSAGE(times << " of: " << what);
      MESSAGE(campaign.count << " flights: " << early << " early, " << never << " never, " << late << " late; "
                             << nothing_works << " in which nothing worked");
    }
    CHECK(early == 0);
    CHECK(never == 0);
    CHECK(late_calm == 0);
    // 0.5 %; of few flights some more, since processors and compilers round the estimate in other ways.
    CHECK(late * 200 <= campaign.count + (campaign.is_long ? 199 : 999));
    CHECK(nothing_works * 200 <= campaign.count + 199);
  }

  TEST_CASE("US-41 US-40 rocket campaign: JSON, C++ and the decisions alone fire in the same tick") {
    const JsonRocket json(in_source("examples/rocket/rocket.json"));
    for (std::uint64_t seed = 1; seed <= 24; ++seed) {
      RandomFlight random = random_flight(seed);
      random.killed = random.back = 1e9;
      const Flight flight = rows_of(random);
      INFO("flight " << seed << ": " << random.what);
      const auto by_json = json.fly(flight), by_cpp = fly_campaign_in_cpp(flight);
      REQUIRE(by_json.size() == by_cpp.size());
      for (std::size_t i = 0; i < by_json.size(); ++i) {
        CHECK(by_json[i].to == by_cpp[i].to);
        CHECK(by_json[i].cause == by_cpp[i].cause);
        CHECK(by_json[i].time == by_cpp[i].time);
        if (by_cpp[i].to == "apogee") {
          const std::optional<double> alone = fired(random);
          REQUIRE(alone.has_value());
          CHECK(std::abs(by_cpp[i].time - (*alone + random.apogee)) < 0.001);
        }
      }
    }
  }
}
