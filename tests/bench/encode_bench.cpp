// json_encode, raw_encode: an event of eight doubles into bytes.
#include <cstring>
#include <vector>

#include "by_hand.hpp"
#include "harness.hpp"
#include "payloads.hpp"
#include "rtdata/data/codec.hpp"

namespace bench {
namespace {

constexpr unsigned events = 20'000;

double encode_all(rtdata::Codec& codec) {
  std::vector<std::byte> bytes;
  rtdata::Event<Eight> event;
  event.time = rtdata::from_nanoseconds(1'772'366'400'000'000'000);
  event.origin = "chamber";
  const std::int64_t begin = thread_cpu_ns();
  for (unsigned i = 0; i < events; ++i) {
    event.time += std::chrono::milliseconds{1};
    ++event.sequence;
    event.data = reading(i);
    bytes.clear();
    if (!rtdata::encode(codec, "test/climate", event, bytes)) return 1e9;
    keep(bytes.data());
  }
  return static_cast<double>(thread_cpu_ns() - begin) / events;
}

template <class Function>
double encode_by_hand(Function&& function) {
  char buffer[2048];
  std::int64_t time = 1'772'366'400'000'000'000;
  const std::int64_t begin = thread_cpu_ns();
  for (unsigned i = 0; i < events; ++i) {
    time += 1'000'000;
    const Eight data = reading(i);
    keep(function(buffer, time, i + 1, data));
    keep(buffer);
  }
  return static_cast<double>(thread_cpu_ns() - begin) / events;
}

}  // namespace

void bench_encoding(Report& report) {
  if (report.wants("json_encode")) {
    const auto codec = rtdata::make_json_codec();
    report.add(measure_pair(
        {.name = "json_encode", .unit = "ns/event", .reach = 1.2}, [&] { return encode_all(*codec); },
        [] { return encode_by_hand(json_by_hand); }, 15));
  }
  if (report.wants("raw_encode")) {
    const auto codec = rtdata::make_raw_codec();
    report.add(measure_pair(
        {.name = "raw_encode", .unit = "ns/event", .reach = 2}, [&] { return encode_all(*codec); },
        [] { return encode_by_hand(raw_by_hand); }, 15));
  }
}

}  // namespace bench
