/// Any bytes as a message of MQTT, its topic before the first zero byte: taking values from it must neither crash nor
/// refuse it without a reason, and the same message gives the same values again.
///
///     tests/fuzz/run.sh 60
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

#include "sensors/lines/line_decoder.hpp"

namespace {

using rtdata::Kind;
using rtdata::LineField;
using rtdata::detail::LineDecoder;

LineDecoder decoder_for(rtdata::LineFormat format) {
  rtdata::LineConfig config;
  config.format = format;
  config.fields = {LineField{.name = "level", .unit = "%"},
                   LineField{.name = "count", .type = Kind::i32, .optional = true},
                   LineField{.name = "word", .type = Kind::text, .length = 20, .optional = true},
                   LineField{.name = "from", .type = Kind::text, .key = "$topic", .length = 40},
                   LineField{.name = "kept", .type = Kind::boolean, .key = "$retained"}};
  if (format == rtdata::LineFormat::json) config.fields[1].key = "deep.er";
  return LineDecoder(config, {{"$topic", "$retained"}, "message"});
}

bool take(LineDecoder& decoder, std::string_view topic, std::string_view message, std::vector<std::byte>& payload) {
  rtdata::Result<void> done = decoder.decode(message);
  if (done) done = decoder.give("$topic", topic);
  if (done) done = decoder.give("$retained", "true");
  if (!done && done.error().why.empty()) std::abort();
  if (done) payload.assign(decoder.payload(), decoder.payload() + decoder.description()->size());
  return static_cast<bool>(done);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static LineDecoder decoders[] = {decoder_for(rtdata::LineFormat::json), decoder_for(rtdata::LineFormat::csv)};
  const std::string_view all(reinterpret_cast<const char*>(data), size);
  const std::string_view topic = all.substr(0, all.find('\0'));
  const std::string_view message = all.substr(std::min(all.size(), topic.size() + 1));
  for (LineDecoder& decoder : decoders) {
    std::vector<std::byte> once, again;
    const bool is_good = take(decoder, topic, message, once);
    if (take(decoder, topic, message, again) != is_good || once != again) std::abort();
  }
  return 0;
}
