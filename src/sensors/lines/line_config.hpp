// Which settings of lines can be combined, and texts about lines.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "data/setting_mistake.hpp"
#include "rtdata/sensors/lines.hpp"
#include "sensors/lines/frame_cutter.hpp"

namespace rtdata::detail {

class LineDecoder;

inline constexpr const char* check_fields = "check `fields` and the other settings";
/// `where`: the key, or "field NAME".
Error refused_lines(std::string where, std::string why, std::string advice);
/// For lines that are not NMEA. SetupError (bad-argument): settings that cannot be combined.
void check_lines(const LineConfig& config);
/// Null: NMEA. SetupError: as LineDecoder, and for settings that NMEA does not have.
std::unique_ptr<LineDecoder> decoder_of_lines(const LineConfig& config);

/// The setting that an error of lines is about.
SettingMistake mistake_in_lines(const Error& error);
/// `check_config` of a LineConfig with such frames.
void check_lines_of(const LineConfig& config, FrameCutter::Stream stream, const ConfigItem& item, Problems& problems);

/// True if the pattern's group for this field contains bytes, not text.
inline bool are_bytes(const LineField& field) noexcept { return field.wire && field.base != 16; }
/// SetupError (bad-argument): a pattern takes bytes from lines, which some of these bytes would end.
void check_bytes_are_framed(const LineConfig& config);

/// What is sent after opening: the texts, then the bytes. `key`: the key of the bytes. SetupError (bad-argument): `hex`
/// is not bytes.
std::vector<std::string> texts_at_open(const std::vector<std::string>& texts, const std::vector<std::string>& hex,
                                       const char* key = "at_open_hex");
void check_at_open(const std::vector<std::string>& hex, const ConfigItem& item, Problems& problems,
                   const char* key = "at_open_hex");

/// The beginning of a line, in quotes.
std::string shown_line(std::string_view text);
/// For numeric types: "an int8", "a number".
std::string type_with_article(Kind kind);

}  // namespace rtdata::detail
