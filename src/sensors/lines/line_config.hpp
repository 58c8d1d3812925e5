// What settings of lines can be together, and words about lines.
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
/// SetupError (bad-argument): settings that exclude each other. Of lines that are not NMEA.
void check_lines(const LineConfig& config);
/// Null: NMEA. SetupError: as LineDecoder, and of settings that NMEA has not.
std::unique_ptr<LineDecoder> decoder_of_lines(const LineConfig& config);

/// The setting that an error of lines is about.
SettingMistake mistake_in_lines(const Error& error);
/// `check_config` of a LineConfig whose frames are such.
void check_lines_of(const LineConfig& config, FrameCutter::Stream stream, const ConfigItem& item, Problems& problems);

/// True if a pattern's group of it is bytes, not text.
inline bool are_bytes(const LineField& field) noexcept { return field.wire && field.base != 16; }
/// SetupError (bad-argument): a pattern takes bytes from lines, which are cut at some of them.
void check_bytes_are_framed(const LineConfig& config);

/// What is sent after an opening: the texts, then the bytes. `key`: of the bytes. SetupError (bad-argument): `hex` is
/// not bytes.
std::vector<std::string> texts_at_open(const std::vector<std::string>& texts, const std::vector<std::string>& hex,
                                       const char* key = "at_open_hex");
void check_at_open(const std::vector<std::string>& hex, const ConfigItem& item, Problems& problems,
                   const char* key = "at_open_hex");

/// The beginning of a line, in quotes.
std::string shown_line(std::string_view text);
/// Of numbers: "an int8", "a number".
std::string type_with_article(Kind kind);

}  // namespace rtdata::detail
