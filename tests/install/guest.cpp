// The guest on the loop of host.c: a sensor and its recording. No exception leaves it.
#include <cstdio>
#include <exception>
#include <optional>

#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata::literals;

namespace {

struct Load {
  double minute = 0.5;
  RTDATA_FIELDS(Load, (minute, "1"))
};
struct Guest {
  explicit Guest(uv_loop_t* host) : loop(host) {}
  rtdata::Loop loop;
  rtdata::SqliteSink recording{loop, {.path = "run.db"}};
  rtdata::Sensor<Load> sensor{loop, {.name = "load", .rate = 100_Hz}, [] { return Load{}; }};
};
std::optional<Guest> guest;

}  // namespace

extern "C" int guest_begin(uv_loop_t* host) {
  try {
    guest.emplace(host);
    return 0;
  } catch (const std::exception& error) {
    std::puts(error.what());
    return 1;
  }
}
extern "C" void guest_drain() {
  guest->loop.drain(5s, [](std::uint64_t lost) { std::printf("%u lost\n", static_cast<unsigned>(lost)); });
}
extern "C" int guest_end() {
  const auto events = static_cast<int>(guest->sensor.counts().published);
  guest.reset();
  return events;
}
