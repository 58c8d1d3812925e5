#include "sensors/lines/line_config.hpp"

#include <algorithm>
#include <optional>
#include <utility>

#include "data/hex_bytes.hpp"
#include "data/lower_case.hpp"
#include "data/setting_mistake.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/detail/io/loaded_library.hpp"
#include "rtdata/sensors/gps.hpp"
#include "sensors/lines/device_clock.hpp"
#include "sensors/lines/line_decoder.hpp"

namespace rtdata {
namespace detail {
namespace {

/// True if the text may begin a CSV number ("12.", "-1e", "na", "INF"), so that such a line is not taken as a comment.
bool begins_a_number(std::string_view text) noexcept {
  if (!text.empty() && (text.front() == '+' || text.front() == '-')) text.remove_prefix(1);
  const std::string lower = lower_case(text);
  for (const std::string_view word : {"nan", "infinity"})
    if (word.starts_with(lower)) return true;
  if (lower.starts_with("nan(")) return true;
  const std::size_t exponent = lower.find('e');
  const std::string_view digits = std::string_view(lower).substr(0, exponent);
  if (digits.find_first_not_of("0123456789.") != std::string_view::npos ||
      std::count(digits.begin(), digits.end(), '.') > 1)
    return false;
  if (exponent == std::string::npos) return true;
  std::string_view power = std::string_view(lower).substr(exponent + 1);
  if (!power.empty() && (power.front() == '+' || power.front() == '-')) power.remove_prefix(1);
  return digits.find_first_of("0123456789") != std::string_view::npos &&
         power.find_first_not_of("0123456789") == std::string_view::npos;
}

bool begins_a_boolean(std::string_view text) noexcept {
  for (const std::string_view word : {"true", "TRUE", "True", "false", "FALSE", "False"})
    if (word.starts_with(text)) return true;
  return false;
}

/// NMEA defines its own lines.
void check_nmea(const LineConfig& config) {
  for (const auto& [key, is_set] : {std::pair("frame", config.frame.has_value()),
                                    {"only", config.only.has_value()},
                                    {"unreadable_if", config.unreadable_if.has_value()},
                                    {"checksum", config.checksum.has_value()},
                                    {"device_time", config.device_time.has_value()},
                                    {"line_end", config.line_end != '\n'}})
    if (is_set) throw SetupError(refused_lines(key, "it has no effect with `format` nmea", "remove it"));
}

void check_marks(const LineConfig& config) {
  const auto refuse = [](const char* key, std::string why, const char* advice) {
    throw SetupError(refused_lines(key, std::move(why), advice));
  };
  constexpr std::string_view ends("\n\r\0", 3);
  const std::string& comment = config.comment;
  const bool is_csv = config.format == LineFormat::csv;
  if (config.frame && config.line_end != '\n')
    refuse("line_end", "`line_end` has no effect together with `frame`", "remove one of the two");
  if (config.format == LineFormat::binary && !config.frame)
    refuse("frame", "`format` binary needs a `frame`", "set `frame`");
  if (config.checksum && config.checksum->of == ChecksumOf::row && config.format != LineFormat::labels)
    refuse("checksum", "`of` row works only with `format` labels", "remove `of`");
  if (config.checksum && config.frame && config.frame->length != 0 && config.checksum->from >= config.frame->length)
    refuse("checksum", "`from` is beyond the end of the frame", "check `from`, and the `length` of the frame");
  if (config.format == LineFormat::labels) return;
  if (comment.find_first_of(ends) != std::string::npos)
    refuse("comment", "it contains a line end, so no line can begin with it",
           "set another `comment`, such as \"#\", or \"\" for none");
  if (!comment.empty() && comment.find_first_not_of(" \t") == std::string::npos)
    refuse("comment", "lines of data may begin with a blank", "set another `comment`, such as \"#\", or \"\" for none");
  if (!is_csv) {
    if (comment.starts_with('{'))
      refuse("comment", "each JSON object begins with {", "set another `comment`, such as \"#\", or \"\" for none");
    return;
  }
  if (config.separator == '"' || ends.find(config.separator) != std::string_view::npos)
    refuse("separator", "this character has another meaning in CSV", "set another `separator`, such as \",\" or \";\"");
  if (config.line_end == config.separator) refuse("line_end", "it is the same as the separator", "set another one");
  if (std::string_view("0123456789+-.eEaAfFiInNtTyY").find(config.separator) != std::string_view::npos)
    refuse("separator", "numbers may contain this character", "set another `separator`, such as \",\" or \";\"");
  if (comment.empty()) return;
  if (comment.front() == config.separator)
    refuse("comment", "comments would begin with the separator", "set another `comment`, or \"\" for none");
  const bool begins_with_boolean = !config.fields.empty() && config.fields.front().type == Kind::boolean;
  if (comment.front() == '"' || begins_a_number(comment) || (begins_with_boolean && begins_a_boolean(comment)))
    refuse("comment", "lines of data may begin with it", "set another `comment`, such as \"#\", or \"\" for none");
}

void check_fields_of(const LineConfig& config) {
  for (std::size_t i = 0; i < config.fields.size(); ++i) {
    const LineField& field = config.fields[i];
    const bool has_keys = config.format == LineFormat::json || config.format == LineFormat::labels ||
                          config.format == LineFormat::pattern;
    if (has_keys && field.name.empty() && field.key.empty())
      throw SetupError(
          refused_lines("field " + std::to_string(i + 1),
                        config.format == LineFormat::json ? "a field of JSON has no name" : "a field has no name",
                        "give it a `name`"));
    const bool is_binary = config.format == LineFormat::binary;
    const bool has_bytes = is_binary || (config.format == LineFormat::pattern && field.wire);
    if (!is_binary && (field.at || field.bytes != 0 || (field.wire && !has_bytes)))
      throw SetupError(
          refused_lines("field " + field.name, "only binary frames have `at`, `bytes` and `wire`", "remove them"));
    if (!has_bytes && (field.bit || field.mask || field.bcd))
      throw SetupError(
          refused_lines("field " + field.name, "only fields of bytes have `bit`, `mask` and `bcd`", "remove them"));
    if (config.format != LineFormat::labels && field.column != 1)
      throw SetupError(refused_lines("field " + field.name, "only labels have `column`", "remove it"));
    const bool has_separator = field.decimal == config.separator || field.thousands == std::string(1, config.separator);
    if (config.format == LineFormat::csv && has_separator)
      throw SetupError(refused_lines("separator", "field " + field.name + " has this character within its numbers",
                                     "set another `separator`, such as \";\""));
  }
}

void check_match(const LineConfig& config, const char* key, const std::optional<LineMatch>& match) {
  if (!match) return;
  const auto refuse = [&](const char* why, const char* advice) { throw SetupError(refused_lines(key, why, advice)); };
  const bool has_text = !match->is.empty() || !match->begins.empty() || !match->contains.empty() ||
                        !match->pattern.empty();
  if (config.format == LineFormat::binary) {
    if (has_text || match->column != 0 || !match->key.empty())
      refuse("binary frames have no text", "set `at` and `is_hex`");
    if (match->is_hex.empty()) refuse("it does not say what the bytes are", "set `is_hex`");
    for (const std::string& hex : match->is_hex) {
      const auto bytes = bytes_of_hex(hex);
      if (!bytes || bytes->empty())
        refuse("`is_hex` is not bytes", "write two hexadecimal digits for each, such as \"01 07\"");
      if (config.frame->length != 0 && match->at + bytes->size() > config.frame->length)
        refuse("its bytes end beyond the frame", "check `at` and the frame's `length`");
    }
    return;
  }
  if (match->at != 0 || !match->is_hex.empty()) refuse("only binary frames have `at` and `is_hex`", "remove them");
  if (!has_text) refuse("it does not say what the text is", "set `is`, `begins`, `contains` or `pattern`");
  if (match->column != 0 && config.format != LineFormat::csv)
    refuse("only CSV has columns", "use `key`, or the whole line");
  if (!match->key.empty() && config.format != LineFormat::json && config.format != LineFormat::labels)
    refuse("only JSON and labels have keys", "use `column`, or the whole line");
}

}  // namespace

Error refused_lines(std::string where, std::string why, std::string advice) {
  return {Errc::bad_argument, "cannot use these fields", std::move(where), std::move(why), std::move(advice)};
}

void check_lines(const LineConfig& config) {
  check_marks(config);
  check_fields_of(config);
  check_match(config, "only", config.only);
  check_match(config, "unreadable_if", config.unreadable_if);
  if (config.format == LineFormat::binary && config.separator != ',')
    throw SetupError(refused_lines("separator", "binary frames have no separator", "remove it"));
}

std::unique_ptr<LineDecoder> decoder_of_lines(const LineConfig& config) {
  if (config.format != LineFormat::nmea) return std::make_unique<LineDecoder>(config);
  check_nmea(config);
  return nullptr;
}

std::vector<std::string> texts_at_open(const std::vector<std::string>& texts, const std::vector<std::string>& hex,
                                       const char* key) {
  std::vector<std::string> all = texts;
  for (const std::string& one : hex) {
    auto bytes = bytes_of_hex(one);
    if (!bytes || bytes->empty())
      throw SetupError(refused_lines(key, "\"" + one + "\" is not bytes",
                                     "write two hexadecimal digits for each, such as \"02 4d 0d\""));
    all.push_back(*std::move(bytes));
  }
  return all;
}

void check_at_open(const std::vector<std::string>& hex, const ConfigItem& item, Problems& problems, const char* key) {
  try {
    texts_at_open({}, hex, key);
  } catch (const SetupError& error) {
    add_mistake({key, error.error().why, error.error().advice}, item, problems);
  }
}

std::string shown_line(std::string_view text) {
  std::string shown = "\"";
  for (const char c : text.substr(0, 40)) shown += c >= ' ' && c < 127 ? c : '?';
  return shown + (text.size() > 40 ? "...\"" : "\"");
}

std::string type_with_article(Kind kind) {
  if (kind == Kind::f64 || kind == Kind::f32) return "a number";
  const std::string_view name = name_of(kind);
  return std::string(name.starts_with('i') ? "an " : "a ").append(name);
}

void check_bytes_are_framed(const LineConfig& config) {
  const bool has_bytes = std::any_of(config.fields.begin(), config.fields.end(), are_bytes);
  if (config.format == LineFormat::pattern && has_bytes && !config.frame)
    throw SetupError(refused_lines("frame", "fields with `wire` may contain bytes that end a line",
                                   "set `frame`; `base` 16 is for bytes written as hexadecimal digits"));
}

SettingMistake mistake_in_lines(const Error& error) {
  constexpr std::string_view keys[] = {"sequence_field", "separator",     "comment",  "line_end", "frame",
                                       "only",           "unreadable_if", "checksum", "pattern",  "device_time"};
  if (error.where.empty()) return {"fields", error.why, error.advice};
  if (std::ranges::find(keys, error.where) != std::end(keys)) return {error.where, error.why, error.advice};
  return {"fields", error.where + ": " + error.why, error.advice};
}

void check_lines_of(const LineConfig& config, FrameCutter::Stream stream, const ConfigItem& item, Problems& problems) {
  try {
    const auto decoder = decoder_of_lines(config);
    if (stream == FrameCutter::Stream::endless) check_bytes_are_framed(config);
    if (config.device_time && decoder) DeviceClock(*config.device_time, *decoder->description());
    if (config.frame) FrameCutter(*config.frame, config.max_line, stream);
  } catch (const SetupError& error) {
    const Error& e = error.error();
    if (e.code == Errc::not_found) {  // the pattern library
      add_not_installed(e, item, problems);
      return;
    }
    SettingMistake mistake = mistake_in_lines(e);
    if (mistake.key == "comment" && item.find("comment") == nullptr)
      mistake.key = "separator";  // which has the default comment
    add_mistake(mistake, item, problems);
  }
}

}  // namespace detail

Result<std::shared_ptr<const Description>> line_description(const std::vector<LineField>& fields) {
  DescriptionBuilder builder("line");
  std::size_t kept = 0;
  for (const LineField& field : fields) {
    if (field.name.empty()) continue;
    ++kept;
    if (field.type == Kind::enumeration || field.type == Kind::record) {
      return detail::refused_lines("field " + field.name, "a line cannot contain a " + std::string(name_of(field.type)),
                                   "choose another `type`");
    }
    if (field.scale == 0)
      return detail::refused_lines("field " + field.name, "a scale of 0 would make every value 0",
                                   "set another `scale`");
    if (field.scale != 1 && field.type != Kind::f32 && field.type != Kind::f64) {
      return detail::refused_lines("field " + field.name, "only a float or double can be scaled",
                                   "set its `type` to double");
    }
    using Presence = DescriptionBuilder::Presence;
    const bool is_optional = field.optional || !field.no_value.empty();
    const Presence presence = is_optional ? Presence::optional : Presence::always;
    if (field.type == Kind::text) {
      if (field.length < 1 || field.length > 65535)
        return detail::refused_lines("field " + field.name, "a length of 0", "set `length`");
      builder.text(field.name, field.length, presence);
    } else {
      builder.field(field.name, field.type, field.unit, presence);
    }
  }
  if (kept == 0) return detail::refused_lines("", "no field has a name", "list the values of a line in `fields`");
  auto made = builder.build();
  if (made && (*made)->size() > max_payload_size)
    return detail::refused_lines("", "the fields need more than 4 KiB", "shorten the texts");
  return made;
}

Result<std::shared_ptr<const Description>> description_of_lines(const LineConfig& config) {
  if (config.format == LineFormat::nmea) return description_of<GpsFix>();
  return line_description(config.fields);
}

void check_config(const LineConfig& config, const ConfigItem& item, Problems& problems) {
  detail::check_lines_of(config, detail::FrameCutter::Stream::endless, item, problems);
}

ReadTime read_time(const LineConfig&) { return {.on_loop = std::chrono::microseconds{500}}; }

}  // namespace rtdata
