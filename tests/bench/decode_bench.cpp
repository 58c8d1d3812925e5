// line_decode: a line of CSV with 8 numbers, beside std::from_chars by hand. frame_decode: a frame of 8 fields found in
// a stream of bytes, with its CRC, beside the same by hand with a table of the CRC. pattern: a line by a regular
// expression with 2 numbers, beside PCRE2 and std::from_chars by hand.
#ifdef RTDATA_BENCH_PATTERN
#define PCRE2_CODE_UNIT_WIDTH 8
#include <pcre2.h>
#endif

#include <array>
#include <charconv>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

#include "harness.hpp"
#include "sensors/lines/checksum.hpp"
#include "sensors/lines/frame_cutter.hpp"
#include "sensors/lines/line_decoder.hpp"

namespace bench {
namespace {

using namespace rtdata;

constexpr unsigned rounds = 200'000;

double ns_per_piece(std::int64_t begin) { return static_cast<double>(thread_cpu_ns() - begin) / rounds; }

template <class Decode>
double measure(const std::vector<std::string>& all, Decode decode) {
  const std::int64_t begin = thread_cpu_ns();
  unsigned good = 0;
  for (unsigned i = 0; i < rounds; ++i) good += decode(all[i % all.size()]) ? 1 : 0;
  keep(good);
  if (good != rounds) std::fputs("bench: a line could not be decoded\n", stderr);
  return ns_per_piece(begin);
}

std::vector<std::string> lines_of(const char* format) {
  std::vector<std::string> all;
  for (int i = 0; i < 1000; ++i) {
    char line[200];
    std::snprintf(line, sizeof line, format, 20 + i * 0.01, i * 0.37 - 100, 1013.25 - i * 0.1, i * 1.0, 0.001 * i,
                  -9.81 + i * 0.0001, 400.5 + i, i * 12.75);
    all.emplace_back(line);
  }
  return all;
}

void bench_lines(Report& report) {
  if (!report.wants("line_decode")) return;
  const auto all = lines_of("%.2f,%.2f,%.2f,%.0f,%.3f,%.4f,%.1f,%.2f");
  LineConfig config;
  for (const char* const name : {"a", "b", "c", "d", "e", "f", "g", "h"}) config.fields.push_back({.name = name});
  detail::LineDecoder decoder(config);
  std::array<double, 8> values{};
  report.add(measure_pair(
      {.name = "line_decode", .unit = "ns/line", .reach = 1.5},
      [&] {
        return measure(all, [&](const std::string& line) {
          const bool is_good = !decoder.is_skipped(line) && decoder.is_meant(line) && decoder.decode(line);
          keep(*decoder.payload());
          return is_good;
        });
      },
      [&] {
        return measure(all, [&](const std::string& line) {
          const char* at = line.data();
          const char* const end = at + line.size();
          for (std::size_t i = 0; i < values.size(); ++i) {
            const auto [next, status] = std::from_chars(at, end, values[i]);
            if (status != std::errc{} || (i + 1 < values.size() ? next == end || *next != ',' : next != end))
              return false;
            at = next + 1;
          }
          keep(values);
          return true;
        });
      },
      15));
}

/// CRC-16/MODBUS by a table.
class Crc16 {
 public:
  Crc16() {
    for (unsigned i = 0; i < 256; ++i) {
      unsigned value = i;
      for (int bit = 0; bit < 8; ++bit) value = (value & 1) != 0 ? value >> 1 ^ 0xa001 : value >> 1;
      table_[i] = static_cast<std::uint16_t>(value);
    }
  }
  std::uint16_t of(std::string_view bytes) const {
    std::uint16_t value = 0xffff;
    for (const char c : bytes)
      value = static_cast<std::uint16_t>(value >> 8 ^ table_[(value ^ static_cast<unsigned char>(c)) & 0xff]);
    return value;
  }

 private:
  std::array<std::uint16_t, 256> table_{};
};

void bench_frames(Report& report) {
  if (!report.wants("frame_decode")) return;
  constexpr std::size_t length = 20;  // two bytes of start, 8 words, the CRC
  const Crc16 crc;
  std::vector<std::string> all;
  for (int i = 0; i < 1000; ++i) {
    std::string frame = "\x55\xaa";
    for (int k = 0; k < 8; ++k) {
      const int value = i * 17 + k * 1000;
      frame += static_cast<char>(value >> 8);
      frame += static_cast<char>(value);
    }
    const std::uint16_t sum = crc.of(frame);
    frame += static_cast<char>(sum);
    frame += static_cast<char>(sum >> 8);
    all.push_back(frame + frame.substr(0, 4));  // and the beginning of the next
  }
  LineConfig config;
  config.format = LineFormat::binary;
  config.frame = LineFrame{.start_hex = "55 aa", .length = length};
  config.checksum = LineChecksum{.type = ChecksumType::crc16_modbus, .form = ChecksumForm::little};
  for (std::size_t k = 0; k < 8; ++k)
    config.fields.push_back({.name = std::string(1, static_cast<char>('a' + k)), .at = 2 + 2 * k, .wire = Kind::i16});
  detail::LineDecoder decoder(config);
  detail::FrameCutter cutter(*config.frame, config.max_line);
  std::array<double, 8> values{};
  report.add(measure_pair(
      {.name = "frame_decode", .unit = "ns/frame", .reach = 1.5},
      [&] {
        return measure(all, [&](const std::string& bytes) {
          const auto found = cutter.next(bytes);
          const auto frame = decoder.checked(std::string_view(bytes).substr(found.skipped, found.size));
          const bool is_good = frame && decoder.is_meant(*frame) && decoder.decode(*frame);
          keep(*decoder.payload());
          return is_good;
        });
      },
      [&] {
        return measure(all, [&](const std::string& bytes) {
          const std::size_t start = bytes.find("\x55\xaa");
          if (start == std::string::npos || bytes.size() - start < length) return false;
          const auto* at = reinterpret_cast<const unsigned char*>(bytes.data()) + start;
          if (crc.of({bytes.data() + start, length - 2}) != (at[length - 2] | at[length - 1] << 8)) return false;
          for (std::size_t k = 0; k < values.size(); ++k)
            values[k] = static_cast<std::int16_t>(at[2 + 2 * k] << 8 | at[3 + 2 * k]);
          keep(values);
          return true;
        });
      },
      15));
}

#ifdef RTDATA_BENCH_PATTERN
void bench_patterns(Report& report) {
  if (!report.wants("pattern")) return;
  const auto all = lines_of("T: %.2f C H: %.2f %% (ok)");
  LineConfig config;
  config.format = LineFormat::pattern;
  config.pattern = R"(T: *(?<t>[-+0-9.]+) C H: *(?<h>[-+0-9.]+) %)";
  config.fields = {{.name = "t"}, {.name = "h"}};
  detail::LineDecoder decoder(config);
  int number = 0;
  std::size_t place = 0;
  pcre2_code* const code = pcre2_compile(reinterpret_cast<const unsigned char*>(config.pattern.data()),
                                         config.pattern.size(), 0, &number, &place, nullptr);
  pcre2_match_data* const found = pcre2_match_data_create_from_pattern(code, nullptr);
  std::array<double, 2> values{};
  report.add(measure_pair(
      {.name = "pattern", .unit = "ns/line", .reach = 1.5},
      [&] {
        return measure(all, [&](const std::string& line) {
          const bool is_good = !decoder.is_skipped(line) && decoder.is_meant(line) && decoder.decode(line);
          keep(*decoder.payload());
          return is_good;
        });
      },
      [&] {
        return measure(all, [&](const std::string& line) {
          if (pcre2_match(code, reinterpret_cast<const unsigned char*>(line.data()), line.size(), 0, 0, found,
                          nullptr) != 3)
            return false;
          const std::size_t* const ends = pcre2_get_ovector_pointer(found);
          for (std::size_t i = 0; i < values.size(); ++i) {
            const char* const end = line.data() + ends[2 * i + 3];
            const auto [next, status] = std::from_chars(line.data() + ends[2 * i + 2], end, values[i]);
            if (status != std::errc{} || next != end) return false;
          }
          keep(values);
          return true;
        });
      },
      15));
  pcre2_match_data_free(found);
  pcre2_code_free(code);
}
#endif

}  // namespace

void bench_decoding(Report& report) {
  bench_lines(report);
  bench_frames(report);
#ifdef RTDATA_BENCH_PATTERN
  bench_patterns(report);
#endif
}

}  // namespace bench
