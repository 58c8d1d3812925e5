// examples/rocket in flight, killed at 20 moments and started again, while its sensors go on.
#include <doctest/doctest.h>
#include <signal.h>
#include <stdio.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "app/decided.hpp"
#include "app/flights.hpp"
#include "app/process.hpp"
#include "app/runtime_folder.hpp"
#include "outputs/terminal.hpp"
#include "paths.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/process/expression.hpp"
#include "sanitized.hpp"

using namespace rtdata::test;
using namespace std::chrono_literals;
using outputs_test::Terminal;
using Clock = std::chrono::steady_clock;

namespace {

void replace(std::string& text, const std::string& old, const std::string& with) {
  REQUIRE(text.find(old) != std::string::npos);
  text.replace(text.find(old), old.size(), with);
}

/// The program of a rocket, with serial lines for its sensors and its two charges.
class Computer {
 public:
  explicit Computer(int number) : name_("rocket" + std::to_string(number)) {
    std::string text = source().read("rocket.json");
    replace(text, "\"name\": \"rocket\"", "\"name\": \"" + name_ + "\"");
    replace(text, "/dev/ttyACM0", sensors.name);
    for (Terminal* const charge : {&drogue, &backup}) {
      const std::string line = charge == &drogue ? "\"GPIO22\"" : "\"GPIO23\"";
      replace(text, "\"type\": \"gpio\", \"line\": " + line,
              "\"type\": \"serial\", \"device\": \"" + charge->name + "\", \"text\": \"<{value}>\"");
    }
    folder.write("rocket.json", text);
    start();
  }

  void start() {
    sensors.flush();
    process_ = std::make_unique<Process>(folder, built("rtdata"), std::vector<std::string>{"run", "rocket.json"});
  }
  bool is_running() { return process_->wait_for("running " + name_); }
  void kill() {
    process_->signal(SIGKILL);
    CHECK(process_->end() == 128 + SIGKILL);
    err += process_->err;
  }
  int end() {
    process_->signal(SIGTERM);
    const int status = process_->end();
    err += process_->err;
    return status;
  }
  /// What `rtdata ctl` says.
  std::string ctl(std::vector<std::string> words) const {
    words.insert(words.begin(), {"ctl", name_});
    Process one(folder, built("rtdata"), words);
    one.end();
    return one.out + one.err;
  }

  Terminal sensors, drogue, backup;
  Folder folder;
  std::string err;

 private:
  static const Folder& source() {
    static Folder copy;
    if (!copy.has("rocket.json"))
      std::filesystem::copy_file(in_source("examples/rocket/rocket.json"), copy.path() + "/rocket.json");
    return copy;
  }
  const std::string name_;
  std::unique_ptr<Process> process_;
};

double seconds(Clock::duration duration) { return std::chrono::duration<double>(duration).count(); }

/// Twenty computers fly it, and each is killed at another moment, from just before liftoff until after the apogee.
void fly_and_kill(const Flight& flight) {
  const RuntimeFolder runtime;
  constexpr int count = sanitized ? 5 : 20;  // more would need more than the processor has
  const double first = flight.liftoff - 0.5;
  const double last = flight.apogee + 1.5;
  std::vector<std::unique_ptr<Computer>> computers;
  for (int i = 0; i < count; ++i) computers.push_back(std::make_unique<Computer>(i));
  for (const auto& computer : computers) {
    REQUIRE(computer->is_running());
    CHECK(computer->ctl({"arm", "drogue"}) == "output drogue is armed\n");
  }

  // Rows in real time; a row that is late counts as that of its time, and makes decisions as late.
  const Clock::time_point began = Clock::now();
  const double epoch = std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
  double late = 0;
  int killed = 0;
  std::vector<double> down(count);
  std::string refused;
  for (const FlightRow& row : flight.rows) {
    if (row.time > flight.apogee + 7) break;
    const auto due = began + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(row.time));
    std::this_thread::sleep_until(due);
    late = std::max(late, seconds(Clock::now() - due));
    std::array<char, 64> text{};
    ::snprintf(text.data(), text.size(), "%.2f,%.3f\n", *row.altitude, *row.acceleration);
    for (const auto& computer : computers) {
      computer->sensors.write(text.data());
      computer->drogue.collect();
      computer->backup.collect();
    }
    if (killed < count && row.time >= first + (last - first) * killed / (count - 1)) {
      computers[std::size_t(killed)]->kill();
      computers[std::size_t(killed)]->start();
      ++killed;
    }
    if (refused.empty() && row.time > flight.apogee + 3.5) refused = computers.back()->ctl({"arm", "backup"});
  }
  CHECK(killed == count);
  CHECK(refused.find("can be armed in pad only") != std::string::npos);
  for (int i = 0; i < count; ++i) {
    Computer& computer = *computers[std::size_t(i)];
    const double moment = first + (last - first) * i / (count - 1) - flight.liftoff;
    REQUIRE(computer.is_running());
    CHECK(computer.end() == 0);
    INFO("killed " << moment << " s after liftoff\n" << computer.err);
    const Decided decided = decided_in(computer.folder.path() + "/rocket.db");
    CHECK(decided.at.contains("apogee"));
    if (!decided.at.contains("apogee")) continue;
    // Two seconds to look anew, and what the machine under the test took.
    const double apogee = decided.at.at("apogee") - epoch - flight.apogee;
    CHECK_MESSAGE((apogee > -1 && apogee < 2.5 + 2 * late), "apogee " << apogee << ", rows late by " << late);
    // From state to state; where it goes on, once more in the one that it was in.
    const std::vector<std::string> order = {"pad", "boost", "coast", "apogee", "descent"};
    std::size_t at = 0;
    for (const std::string& state : decided.states) {
      const auto found = std::find(order.begin(), order.end(), state);
      REQUIRE(found != order.end());
      const auto place = static_cast<std::size_t>(found - order.begin());
      CHECK((place == at || place == at + 1));
      at = place;
    }
    CHECK(at == 4);
    const std::string& fired = computer.drogue.collect();
    CHECK_MESSAGE(fired.find("<1>") != std::string::npos, fired);
    CHECK_MESSAGE(fired.ends_with("<0>"), fired);
    CHECK(computer.backup.collect().find("<1>") == std::string::npos);  // it was not armed
    // Nothing was on before the apogee.
    auto recording = rtdata::Recording::open(computer.folder.path() + "/rocket.db").or_throw();
    auto changes = recording.events<rtdata::OutputChange>("drogue").or_throw();
    while (const auto* change = changes.next().or_throw()) {
      const double time = std::chrono::duration<double>(change->time.time_since_epoch()).count();
      if ((*change)->done.value_or(0) > 0) CHECK(time >= decided.at.at("apogee"));
    }
  }
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-41 US-35 rocket: killed at 20 moments of the flight and started again, it opens its parachute") {
    Rocket rocket = rockets().front();  // the shortest flight leaves the least time
    rocket.pad = 3;
    fly_and_kill(simulated(rocket));
  }

  TEST_CASE("US-41 US-35 rocket: killed at 20 moments of a real flight and started again, it opens its parachute") {
    if (std::getenv("RTDATA_TEST_SEEDS") == nullptr) {
      MESSAGE("skipped: it takes the 50 s of the flight; script/soak rocket runs it");
      return;
    }
    const auto flight = real_flight(3);
    if (!flight) {
      MESSAGE("skipped: there is no ../shared/data/flight");
      return;
    }
    fly_and_kill(*flight);
  }
}
