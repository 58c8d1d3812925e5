/// Any bytes as a stream of frames, in pieces as the first byte says: cutting must come to its end, never claim bytes
/// that are not there, and find the same frames whatever the pieces are; taking values from them, choosing and checking
/// them must neither crash nor refuse one without a reason.
///
///     tests/fuzz/run.sh 60
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "sensors/lines/frame_cutter.hpp"
#include "sensors/lines/line_decoder.hpp"

namespace {

using namespace rtdata;

struct Stream {
  explicit Stream(LineConfig config_) : config(std::move(config_)), decoder(config), cutter(*config.frame, 128) {}
  LineConfig config;
  detail::LineDecoder decoder;
  detail::FrameCutter cutter;
};

/// The frames of the stream, when it comes in pieces.
std::vector<std::string> frames_of(Stream& stream, std::string_view bytes, std::size_t piece) {
  std::vector<std::string> frames;
  std::string buffer;
  stream.cutter.reset();
  while (!bytes.empty()) {
    const std::size_t size = std::min(piece, bytes.size());
    buffer += bytes.substr(0, size);
    bytes.remove_prefix(size);
    for (;;) {
      const detail::FrameCutter::Found found = stream.cutter.next(buffer);
      if (found.skipped + found.size > buffer.size()) std::abort();
      if (found.size != 0) {
        const std::string_view frame = std::string_view(buffer).substr(found.skipped, found.size);
        frames.emplace_back(frame);
        const auto plain = stream.cutter.plain(frame);
        const auto checked = plain ? stream.decoder.checked(*plain) : plain;
        if (!checked && checked.error().why.empty()) std::abort();
        if (checked) {
          const std::string_view text = stream.config.format == LineFormat::binary ? *checked
                                                                                   : stream.cutter.body(*checked);
          if (stream.decoder.is_meant(text))
            if (const auto done = stream.decoder.decode(text); !done && done.error().why.empty()) std::abort();
        }
      }
      buffer.erase(0, found.skipped + found.size);
      if (found.size == 0) break;
    }
  }
  return frames;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static Stream streams[] = {
      Stream({.format = LineFormat::binary,
              .fields = {{.name = "a", .type = Kind::u16, .at = 4, .no_value = {"65535"}},
                         {.name = "b", .scale = 0.1, .at = 6, .wire = Kind::i16},
                         {.name = "t", .type = Kind::text, .length = 3, .at = 8}},
              .frame = LineFrame{.start_hex = "42 4d", .length_at = 2, .length_bytes = 2, .length_adds = 4},
              .checksum = LineChecksum{.type = ChecksumType::sum16, .form = ChecksumForm::big}}),
      Stream({.format = LineFormat::labels,
              .fields = {{.name = "a", .key = "A", .optional = true},
                         {.name = "b", .key = "B", .optional = true, .column = 2}},
              .separator = '(',
              .frame = LineFrame{.start = "/", .end = "!", .after_end = 4},
              .only = LineMatch{.key = "A", .contains = "1"},
              .checksum = LineChecksum{.type = ChecksumType::crc16_arc, .after = "!", .covers_after = true}}),
      Stream({.fields = {{.name = "a", .optional = true}, {}},
              .frame = LineFrame{.end = "\x03", .after_end = 2},
              .only = LineMatch{.column = 2, .begins = "x"},
              .checksum = LineChecksum{.type = ChecksumType::xor8, .after = "\x03", .from = 1, .optional = true}}),
      Stream({.format = LineFormat::binary,
              .fields = {{.name = "a", .at = 0, .wire = Kind::i32, .bytes = 3},
                         {.name = "b", .type = Kind::boolean, .at = 3, .wire = Kind::u16, .bit = 9}},
              .frame = LineFrame{.stuffing = Stuffing::hdlc, .byte_order = WireOrder::little}}),
      Stream({.format = LineFormat::binary,
              .fields = {{.name = "a", .type = Kind::u16, .at = 1, .mask = 0x0ff0}},
              .frame = LineFrame{.stuffing = Stuffing::cobs}}),
      Stream({.format = LineFormat::pattern,
              .fields = {{.name = "a", .optional = true, .wire = Kind::i64}},
              .pattern = "(?s)a(?<a>.{0,9})",
              .frame = LineFrame{.stuffing = Stuffing::slip}})};
  if (size == 0) return 0;
  const std::string_view bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  for (Stream& stream : streams) {
    const std::vector<std::string> whole = frames_of(stream, bytes, std::max<std::size_t>(bytes.size(), 1));
    if (frames_of(stream, bytes, data[0] % 64 + 1U) != whole) std::abort();
  }
  return 0;
}
