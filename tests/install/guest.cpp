// The guest on the loop of host.c: a sensor and its recording. No exception leaves it.
#include <cstdio>
#include <exception>
#include <optional>

#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata::literals;

namespace {

struct Climate {
  double temperature = 21.5;
  RTDATA_FIELDS(Climate, (temperature, "Cel"))
};
struct Guest {
  explicit Guest(uv_loop_t* host) : loop(host) {}
  rtdata::Loop loop;
  rtdata::SqliteSink recording{loop, {.path = "run.db"}};
  rtdata::Sensor<Climate> room{
      loop, {.name = "room", .topic = "room/climate", .rate = 100_Hz}, [] { return Climate{}; }};
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
  const auto events = static_cast<int>(guest->room.counts().published);
  guest.reset();
  return events;
}
