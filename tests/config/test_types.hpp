// Sensor and sink types for tests of configurations and of the program.
#pragma once

#include <time.h>
#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <limits>
#include <memory>
#include <new>
#include <string>
#include <utility>

#include "rtdata/config/registry.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::test {

/// What this throws, as text; empty: nothing.
template <class Use>
std::string refusal(const Use& use) {
  try {
    use();
  } catch (const ConfigError& error) {
    return error.problems().text();
  } catch (const SetupError& error) {
    return error.what();
  }
  return "";
}

struct Count {
  std::uint64_t number = 0;
  friend constexpr auto describe(type_tag<Count>) { return record("count", field("number", &Count::number)); }
};
struct Level {
  double level = 0;
  friend constexpr auto describe(type_tag<Level>) { return record("level", field("level", &Level::level, "bar")); }
};

/// Counts its readings; can fail and take its time.
struct CounterConfig {
  std::uint64_t first = 1;
  std::uint64_t fail_every = 0;
  std::uint64_t hang_at = 0;
  std::uint64_t starve_at = 0;
  Duration hold{0};
  friend constexpr auto parameters(type_tag<CounterConfig>) {
    return parameter_list(
        parameter("first", &CounterConfig::first, "where it begins"),
        parameter("fail_every", &CounterConfig::fail_every, "fails each time it has counted so far; 0: never"),
        parameter("hang_at", &CounterConfig::hang_at, "the reading that never returns, and says so on stderr; 0: none"),
        parameter("starve_at", &CounterConfig::starve_at,
                  "the reading that asks for more memory than there is; 0: none"),
        parameter("hold", &CounterConfig::hold, "how long each reading holds the loop"));
  }
  friend ReadTime read_time(const CounterConfig& config) {
    return config.hold.count() > 0 ? ReadTime{.on_loop = config.hold} : ReadTime{};
  }
};

struct Counter {
  CounterConfig config;
  std::uint64_t count = 0;
  Result<Count> read() {
    const std::uint64_t number = config.first + count++;
    if (config.hang_at != 0 && count >= config.hang_at) {
      [[maybe_unused]] const ssize_t size = ::write(STDERR_FILENO, "it hangs now\n", 13);
      for (;;) ::pause();
    }
    if (config.starve_at != 0 && count >= config.starve_at) {
      volatile std::size_t most = std::numeric_limits<std::size_t>::max() / 4;
      ::operator delete(::operator new(most));
    }
    if (config.hold.count() > 0) {
      timespec wait{config.hold.count() / 1'000'000'000, static_cast<long>(config.hold.count() % 1'000'000'000)};
      ::nanosleep(&wait, nullptr);  // the tests that ask for it want a loop that is held
    }
    if (config.fail_every != 0 && count % config.fail_every == 0) {
      return Error{Errc::bad_data, "cannot count", "the counter", "it fails on purpose", "leave fail_every out"};
    }
    return Count{number};
  }
};

/// Cannot be opened.
struct AbsentConfig {
  std::string device = "/dev/absent";
  bool hangs = false;
  bool check_hangs = false;
  friend constexpr auto parameters(type_tag<AbsentConfig>) {
    return parameter_list(parameter("device", &AbsentConfig::device, "what is not there"),
                          parameter("hangs", &AbsentConfig::hangs, "opening it does not return"),
                          parameter("check_hangs", &AbsentConfig::check_hangs,
                                    "checking its configuration does not return, and says so on stderr"));
  }
};
struct Absent {
  std::string device;
  bool hangs = false;
  Result<void> open() {
    while (hangs) ::pause();
    return Error{Errc::not_found, "cannot open the device", device, "No such file or directory", "plug it in"};
  }
  Level read() { return {}; }
};

/// Throws its events away, perhaps slowly.
struct DiscardConfig {
  std::string path = {};
  bool stalls = false;
  bool once = false;
  SinkConfig sink = {};
  friend constexpr auto parameters(type_tag<DiscardConfig>) {
    return parameter_list(parameter("path", &DiscardConfig::path, "a file that it does not write"),
                          parameter("stalls", &DiscardConfig::stalls, "it never stores anything"),
                          parameter("once", &DiscardConfig::once, "a program makes one such sink, and no second one"),
                          include_member(&DiscardConfig::sink));
  }
};
class Discard final : public Writer {
 public:
  explicit Discard(DiscardConfig config) : config_(std::move(config)) {}
  Result<void> open() override { return {}; }
  Result<void> write(Batch&) override {
    if (config_.stalls) return Error{Errc::storage_full, "cannot store", config_.path, "it stalls on purpose", ""};
    return {};
  }

 private:
  DiscardConfig config_;
};

/// A bus that answers with how often it was asked, and a sensor on it.
struct Loopback {
  std::shared_ptr<std::atomic<std::uint64_t>> asked = std::make_shared<std::atomic<std::uint64_t>>();
};
struct WiredConfig {
  std::string bus;
  friend constexpr auto parameters(type_tag<WiredConfig>) {
    return parameter_list(
        parameter("bus", &WiredConfig::bus, "the bus that it is on", required, names_part("bus", "loopback")));
  }
};

inline void add_test_types(Registry& registry) {
  registry.add_sensor<CounterConfig>(
      "tallied", "counts its readings", [](const CounterConfig&) { return description_of<Count>(); },
      [](Loop& loop, const SensorConfig& common, const CounterConfig& config) {
        return Sensor<Count>(loop, common, Counter{config});
      });
  registry.add_sensor<AbsentConfig>(
      "absent", "is never there",
      [](const AbsentConfig& config) {
        if (config.check_hangs) {
          [[maybe_unused]] const ssize_t size = ::write(STDERR_FILENO, "it hangs now\n", 13);
          for (;;) ::pause();
        }
        return description_of<Level>();
      },
      [](Loop& loop, const SensorConfig& common, const AbsentConfig& config) {
        return Sensor<Level>(loop, common, Absent{config.device, config.hangs});
      });
  registry.add_sensor<NoParameters>(
      "fed", "is fed by the program", [](const NoParameters&) { return description_of<Count>(); },
      [](Loop& loop, const FeedConfig& common, const NoParameters&) { return Feed<Count>(loop, common); });
  registry.add_bus<NoParameters>("loopback", "answers with how often it was asked",
                                 [](Runtime&, const std::string&, const NoParameters&) { return Loopback{}; });
  registry.add_sensor<WiredConfig>(
      "wired", "is on a bus", [](const WiredConfig&) { return description_of<Count>(); },
      [](Loop& loop, const SensorConfig& common, const WiredConfig& config, const Parts& parts) {
        return Sensor<Count>(loop, common,
                             [asked = parts.get<Loopback>("bus", config.bus).asked] { return Count{++*asked}; });
      });
  registry.add_sink<DiscardConfig>(
      "discard", "throws its events away", [](const DiscardConfig& config) { return config.path; },
      [](Loop& loop, const DiscardConfig& config) {
        static bool is_made = false;
        if (config.once && std::exchange(is_made, true))
          throw SetupError({Errc::busy, "cannot make the sink", config.sink.name, "there was one", ""});
        return Sink(loop, config.sink, std::make_unique<Discard>(config));
      });
}

}  // namespace rtdata::test
