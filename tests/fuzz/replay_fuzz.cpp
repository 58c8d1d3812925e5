/// A recording with any bytes changed, or cut off: opening, reading in every way and replaying it must neither crash
/// nor lose count. What is given are changes: 4 bytes say where, 1 what; the first 2 how much is cut off.
///
///     tests/fuzz/run.sh 60
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include "rtdata/loop/topic.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/replay.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace {

using namespace rtdata;
using namespace rtdata::literals;

struct Sample {
  double value = 0;
  text<16> name = {};
  std::optional<std::int32_t> count = {};
  RTDATA_FIELDS(Sample, (value, "V"), (name), (count))
};

std::string path_of(const char* name) {
  return "/dev/shm/rtdata_replay_fuzz." + std::to_string(::getpid()) + "." + name;
}

/// A second of a sensor that fails now and then.
std::string recorded() {
  const std::string path = path_of("base");
  std::filesystem::remove(path);
  {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    int number = 0;
    Sensor<Sample> sensor(loop, {.name = "a", .topic = "t/a", .rate = 50_Hz}, [&]() -> Result<Sample> {
      if (++number % 20 == 0) return Error{Errc::io_failed, "no answer", "", "", ""};
      return Sample{number / 7.0, "x", number};
    });
    loop.advance(1s);
    sensor.close();
    loop.close();
  }
  std::ifstream file(path, std::ios::binary);
  std::ostringstream bytes;
  bytes << file.rdbuf();
  std::filesystem::remove(path);
  return bytes.str();
}

void read_all(const std::string& path) {
  auto recording = Recording::open(path);
  if (!recording) return;
  if (auto rows = recording->rows({.gaps = RowFilter::Gaps::in_place})) {
    for (int i = 0; i < 10'000; ++i) {
      auto row = rows->next();
      if (!row || *row == nullptr) break;
    }
  }
  if (auto steps = recording->steps({}, 100ms)) {
    for (int i = 0; i < 10'000; ++i) {
      auto row = steps->next();
      if (!row || *row == nullptr) break;
    }
  }
}

void replay_all(const std::string& path) {
  Loop loop{Loop::Manual{}};
  loop.on_error([](const ErrorReport&) {});
  loop.runtime().on_log([](const LogRecord&) {});
  std::uint64_t heard = 0;
  auto all = loop.subscribe("#", [&](const EventView& event) {
    for (const Leaf& leaf : event.description().leaves()) (void)event.value(leaf);
    ++heard;
  });
  try {
    Replay replay(loop, {.file = path, .speed = 1e6});
    for (int i = 0; i < 1000 && !replay.is_done(); ++i) loop.advance(1h);
    if (heard > replay.counts().events) std::abort();
  } catch (const SetupError&) {
  }
  if (!loop.runtime().balances()) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const std::string base = recorded();
  static const std::string path = path_of("changed");
  if (size < 2) return 0;
  std::string bytes = base;
  const std::size_t cut = (static_cast<std::size_t>(data[0]) << 8 | data[1]) % bytes.size();
  for (std::size_t i = 2; i + 5 <= size; i += 5) {
    const std::size_t at = (static_cast<std::size_t>(data[i]) << 24 | static_cast<std::size_t>(data[i + 1]) << 16 |
                            static_cast<std::size_t>(data[i + 2]) << 8 | data[i + 3]) %
                           bytes.size();
    bytes[at] = static_cast<char>(data[i + 4]);
  }
  bytes.resize(bytes.size() - cut);
  std::ofstream(path, std::ios::binary | std::ios::trunc) << bytes;
  read_all(path);
  replay_all(path);
  return 0;
}
