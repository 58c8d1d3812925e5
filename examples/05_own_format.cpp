// A format of one's own: a Codec. Files take it by its name, and it reads back what it wrote.
#include <cstdio>
#include <fstream>

#include "rtdata/data/codec.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/file.hpp"

/// The raw bytes in hexadecimal, an event a line: for channels that carry text only.
class HexCodec final : public rtdata::Codec {
 public:
  std::string_view name() const noexcept override { return "hex"; }
  rtdata::Result<void> encode(const rtdata::EventView& event, std::vector<std::byte>& out) override {
    std::vector<std::byte> bytes;
    if (auto encoded = raw_->encode(event, bytes); !encoded) return encoded;
    for (std::byte b : bytes) {
      const auto value = std::to_integer<unsigned>(b);
      for (unsigned digit : {value >> 4, value & 15}) out.push_back(std::byte("0123456789abcdef"[digit]));
    }
    out.push_back(std::byte{'\n'});
    return {};
  }
  rtdata::Result<rtdata::DecodedEvent> decode(std::span<const std::byte> line,
                                              const rtdata::Description& description) override {
    const std::string text(reinterpret_cast<const char*>(line.data()), line.size());
    const std::size_t digits = text.find_last_of("0123456789abcdef") + 1;
    const bool is_hex = digits % 2 == 0 && text.find_first_not_of("0123456789abcdef") >= digits;
    if (!is_hex) return rtdata::Error{rtdata::Errc::bad_data, "cannot decode", "hex", "no pairs of digits", ""};
    std::vector<std::byte> bytes;
    for (std::size_t i = 0; i < digits; i += 2) bytes.push_back(std::byte(std::stoi(text.substr(i, 2), nullptr, 16)));
    return raw_->decode(bytes, description);
  }

 private:
  std::unique_ptr<rtdata::Codec> raw_ = rtdata::make_raw_codec();
};

struct Level {
  double level = 0;
  RTDATA_FIELDS(Level, (level, "m"))
};

int main() {
  std::remove("levels.hex");
  rtdata::CodecRegistry formats = rtdata::CodecRegistry::standard();
  formats.add("hex", [] { return std::make_unique<HexCodec>(); }).or_throw();
  rtdata::Loop loop;
  rtdata::FileSink file(loop, {.path = "levels.hex", .format = "hex"}, formats);
  rtdata::Feed<Level> tank(loop, {.name = "tank"});
  for (double level : {1.5, 1.75, 2.0}) tank.publish(Level{level});
  if (loop.close() != 0) return 1;

  std::ifstream lines("levels.hex");
  HexCodec codec;
  double sum = 0;
  for (std::string line; std::getline(lines, line);)
    sum += rtdata::decode<Level>(codec, std::as_bytes(std::span(line))).or_throw().data.level;
  return sum == 5.25 ? 0 : 1;
}
