/// Fuzzes the decoders: arbitrary bytes in each format and as a description.
///
/// What decodes must encode again and decode to the same values; nothing may crash. The first byte chooses what is
/// tried.
///
///     tests/fuzz/run.sh 60
#include <cstdint>
#include <cstdlib>

#include "data/payloads.hpp"
#include "rtdata/data/codec.hpp"

namespace {

using namespace rtdata;

void require(bool condition) {
  if (!condition) std::abort();
}

/// As JSON: the values without what lies between and behind them in memory.
std::vector<std::byte> canonical(const DecodedEvent& event, const Description& description) {
  std::vector<std::byte> bytes;
  const EventHeader header = event.header();
  make_json_codec()->encode(EventView(event.topic, header, description, event.payload), bytes).or_throw();
  return bytes;
}

void decode_twice(Codec& codec, std::span<const std::byte> bytes, const Description& description) {
  require(codec.first_event(bytes) <= bytes.size());
  const auto event = codec.decode(bytes, description);
  if (!event) {
    require(!event.error().text().empty());
    return;
  }
  require(event->payload.size() == description.size());
  const EventHeader header = event->header();
  std::vector<std::byte> again;
  // Raw bytes cannot carry all that other formats can, but what came from raw bytes fits.
  codec.encode(EventView(event->topic, header, description, event->payload), again).or_throw();
  const auto same = codec.decode(again, description);
  require(same.has_value());
  require(canonical(*event, description) == canonical(*same, description));
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const auto raw_numbered = make_raw_codec({.sequence = RawConfig::Sequence::include});
  static const auto registry = CodecRegistry::standard();
  static const std::unique_ptr<Codec> codecs[] = {registry.make("json").or_throw(), registry.make("raw").or_throw(),
                                                  registry.make("csv").or_throw(), registry.make("cbor").or_throw(),
                                                  registry.make("influx").or_throw()};
  if (size == 0) return 0;
  const std::uint8_t choice = data[0];
  const auto bytes = std::as_bytes(std::span(data + 1, size - 1));
  const Description& everything = *description_of<payloads::Everything>();
  const Description& climate = *description_of<payloads::Climate>();
  const Description& nothing = *description_of<payloads::Nothing>();
  const Description& description = choice / 8 % 3 == 0 ? climate : choice / 8 % 3 == 1 ? everything : nothing;
  switch (choice % 8) {
    case 0:
    case 1:
    case 2:
    case 3:
    case 4:
      decode_twice(*codecs[choice % 8], bytes, description);
      break;
    case 5:
      decode_twice(*raw_numbered, bytes, description);
      break;
    case 6: {  // raw bytes whose total size is right
      std::vector<std::byte> sized(4);
      for (std::size_t i = 0; i < 4; ++i) sized[i] = static_cast<std::byte>(bytes.size() >> (8 * i));
      sized.insert(sized.end(), bytes.begin(), bytes.end());
      decode_twice(*codecs[1], sized, description);
      break;
    }
    default: {
      const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
      if (const auto made = Description::from_json(text)) {
        const auto again = Description::from_json((*made)->to_json());
        require(again.has_value() && (*again)->same_meaning(**made) && (*again)->same_layout(**made));
      }
      if (const auto time = parse_iso8601(text)) require(parse_iso8601(to_iso8601(*time)).or_throw() == *time);
      if (const auto duration = parse_duration(text)) {
        require(parse_duration(to_string(*duration)).or_throw() == *duration);
      }
      if (const auto rate = parse_rate(text)) require(parse_rate(to_string(*rate)).or_throw() == *rate);
    }
  }
  return 0;
}
