/// The rocket of examples/rocket in this process, in virtual time, without a recording: thousands of flights in
/// minutes.
#pragma once

#include <chrono>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "../examples/rocket/rocket.hpp"
#include "app/hard_flights.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/fsm/machine.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata::test {

struct RocketRow {
  std::optional<double> altitude = {};
  std::optional<double> acceleration = {};
  friend constexpr auto describe(type_tag<RocketRow>) {
    return record("import", field("altitude", &RocketRow::altitude, "m"),
                  field("acceleration", &RocketRow::acceleration));
  }
};

/// Gives the rows to topic `rocket` of a loop and returns what its machine `flight` decides. `make` adds the machine.
template <class Make>
std::vector<Decision> flown(const Flight& flight, Make&& make, std::vector<std::string>* errors = nullptr) {
  Loop loop{Loop::Manual{}};
  if (errors != nullptr)
    loop.on_error([errors](const ErrorReport& report) { errors->push_back(report.error.text()); });
  else
    loop.on_error([](const ErrorReport&) {});
  Feed<RocketRow> feed(loop, {.name = "rocket"});
  std::vector<Decision> decisions;
  const Time start = loop.time();
  const Subscription seen = loop.subscribe<fsm::StateChange>("flight", [&](const Event<fsm::StateChange>& change) {
    decisions.push_back({std::chrono::duration<double>(change.time - start).count(), std::string(change->from),
                         std::string(change->to), std::string(change->cause)});
  });
  auto machine = make(loop);
  for (const FlightRow& row : flight.rows) {
    const Time at = start + std::chrono::nanoseconds(static_cast<std::int64_t>(row.time * 1e9));
    if (at > loop.time()) loop.advance(at - loop.time());
    feed.publish(RocketRow{row.altitude, row.acceleration}, at);
    loop.advance(std::chrono::nanoseconds{0});
  }
  loop.advance(std::chrono::seconds{1});
  return decisions;
}

/// As examples/rocket/rocket.json, or another file, decides it.
class JsonRocket {
 public:
  explicit JsonRocket(const std::string& file) : registry_(standard_registry()) {
    ConfigDocument document = load_config(file);
    ConfigItem& root = document.root;
    ConfigItem* machines = root.find("machines");
    for (std::size_t i = 0; i < machines->size(); ++i) machines->find(i)->remove("resume");
    plan_ = plan_system(registry_, std::move(document));
    if (!plan_.good()) throw std::runtime_error(plan_.report());
    std::erase_if(plan_.parts, [](const PartPlan& part) {
      return part.kind != "machine" && !(part.kind == "sensor" && part.type == "vertical");
    });
    for (PartPlan& part : plan_.parts)
      std::erase_if(part.uses, [](const PartUse& use) { return use.kind == "output"; });
  }
  std::vector<Decision> fly(const Flight& flight, std::vector<std::string>* errors = nullptr) const {
    return flown(
        flight, [&](Loop& loop) { return std::make_unique<System>(loop, registry_, plan_); }, errors);
  }

 private:
  Registry registry_;
  SystemPlan plan_;
};

/// The decisions of the example in C++.
inline std::vector<Decision> fly_in_cpp(const Flight& flight) {
  return flown(flight, [](Loop& loop) {
    return std::make_unique<rocket::Rocket>(loop, rocket::Charges{[] {}, [] {}});
  });
}

}  // namespace rtdata::test
