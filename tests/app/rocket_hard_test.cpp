// examples/rocket, as JSON and in C++, on flights that are hard to decide, each with the truth beside it.
#include <doctest/doctest.h>

#include <cstdint>
#include <cstdlib>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "app/hard_flights.hpp"
#include "app/rocket_flying.hpp"
#include "paths.hpp"
#include "rtdata/process/expression.hpp"

using namespace rtdata::test;

namespace {

enum class Stays { once, in_soak };

/// One of each kind of trouble; or as many as "FIRST COUNT" in RTDATA_TEST_SEEDS says. Of those that stay on the pad
/// for two hours, which take the longest, there are fewer.
template <class Fly>
void check_hard_flights(Stays stays, const Fly& fly) {
  std::uint32_t first = 1;
  std::uint32_t count = 1;
  if (const char* const wanted = std::getenv("RTDATA_TEST_SEEDS")) std::istringstream(wanted) >> first >> count;
  const std::uint32_t few_stay = stays == Stays::in_soak && count == 1 ? 0 : 1 + count / 20;
  int flown = 0;
  int wrong = 0;
  for (std::size_t i = 0; i < static_cast<std::size_t>(Trouble::count); ++i) {
    const auto trouble = static_cast<Trouble>(i);
    const std::uint32_t few = trouble == Trouble::stays ? few_stay : count;
    int wrong_here = 0;
    for (std::uint32_t seed = first; seed < first + few; ++seed) {
      const HardFlight flight = hard_flight(trouble, seed);
      const std::string mistake = judged(flight, fly(flight));
      CHECK_MESSAGE(mistake == "", flight.name << ": " << mistake);
      ++flown;
      if (mistake != "") ++wrong_here;
    }
    if (count > 1) MESSAGE(name_of(trouble) << ": " << few << " flown, " << wrong_here << " decided wrongly");
    wrong += wrong_here;
  }
  CHECK(flown == (static_cast<int>(Trouble::count) - 1) * static_cast<int>(count) + static_cast<int>(few_stay));
  CHECK(wrong == 0);
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-41 rocket: flights that are hard to decide") {
    const JsonRocket rocket(in_source("examples/rocket/rocket.json"));
    check_hard_flights(Stays::once, [&](const HardFlight& flight) { return rocket.fly(flight); });
  }

  TEST_CASE("US-40 US-39 rocket in C++: flights that are hard to decide") {
    check_hard_flights(Stays::in_soak, [](const HardFlight& flight) { return fly_in_cpp(flight); });
  }

  TEST_CASE("rocket: what is wrong with a decision is seen") {
    const HardFlight flight = hard_flight(Trouble::none, 1);
    REQUIRE(flight.rows.size() == flight.speeds.size());
    const double apogee = flight.apogee;
    const auto decided = [&](double charge, double landed) {
      return std::vector<Decision>{{0, "", "pad", ""},
                                   {flight.liftoff + 0.1, "pad", "boost", ""},
                                   {flight.burnout, "boost", "coast", ""},
                                   {charge, "coast", "apogee", ""},
                                   {landed, "descent", "landed", ""}};
    };
    CHECK(judged(flight, decided(apogee + 0.1, flight.landing + 5)) == "");
    CHECK(judged(flight, decided(apogee - 2, flight.landing + 5)).starts_with("early"));
    CHECK(judged(flight, decided(apogee + 2, flight.landing + 5)).starts_with("late"));
    CHECK(judged(flight, decided(flight.liftoff - 1, flight.landing + 5)).starts_with("fires on the pad"));
    CHECK(judged(flight, decided(apogee, flight.landing - 5)).starts_with("landed in the air"));
    CHECK(judged(flight, {{0, "", "pad", ""}}) == "never fires");
    CHECK(judged(hard_flight(Trouble::stays, 1), decided(100, 200)) == "fires on the pad");
  }
}
