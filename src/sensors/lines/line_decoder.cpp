#include "sensors/serial/line_decoder.hpp"

#include <algorithm>
#include <charconv>
#include <cstring>
#include <nlohmann/json.hpp>
#include <utility>

#include "data/character.hpp"
#include "data/field_layout.hpp"
#include "data/lower_case.hpp"
#include "data/number_text.hpp"
#include "data/utf8.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/sensors/gps.hpp"
#include "sensors/core/sysfs_file.hpp"
#include "sensors/serial/frame_cutter.hpp"

namespace rtdata {
namespace {

constexpr const char* check_fields = "check `fields` and the other settings";

/// Of a type of numbers, with its article.
std::string type_name(Kind kind) {
  if (kind == Kind::f64 || kind == Kind::f32) return "a number";
  const std::string_view name = name_of(kind);
  return std::string(name.starts_with('i') ? "an " : "a ").append(name);
}

Error refused(std::string where, std::string why, std::string advice) {
  return {Errc::bad_argument, "cannot use these fields", std::move(where), std::move(why), std::move(advice)};
}

}  // namespace

Result<std::shared_ptr<const Description>> line_description(const std::vector<LineField>& fields) {
  DescriptionBuilder builder("line");
  std::size_t kept = 0;
  for (const LineField& field : fields) {
    if (field.name.empty()) continue;
    ++kept;
    if (field.type == Kind::enumeration || field.type == Kind::record) {
      return refused("field " + field.name, "a line holds no " + std::string(name_of(field.type)),
                     "choose another `type`");
    }
    if (field.scale == 0)
      return refused("field " + field.name, "a scale of 0 makes all of it 0", "set another `scale`");
    if (field.scale != 1 && field.type != Kind::f32 && field.type != Kind::f64) {
      return refused("field " + field.name, "only a float or double can be scaled", "make its `type` double");
    }
    using Presence = DescriptionBuilder::Presence;
    const bool is_optional = field.optional || !field.no_value.empty();
    const Presence presence = is_optional ? Presence::optional : Presence::always;
    if (field.type == Kind::text) {
      if (field.length < 1 || field.length > 65535)
        return refused("field " + field.name, "a length of 0", "set `length`");
      builder.text(field.name, field.length, presence);
    } else {
      builder.field(field.name, field.type, field.unit, presence);
    }
  }
  if (kept == 0) return refused("", "no field has a name", "list what is in a line in `fields`");
  auto made = builder.build();
  if (made && (*made)->size() > max_payload_size) return refused("", "they need more than 4 KiB", "shorten the texts");
  return made;
}

namespace detail {
namespace {

template <class T>
std::errc parse_into(std::string_view text, std::byte* to, double scale) noexcept {
  T number{};
  if (const std::errc status = read_number(text, number); status != std::errc{}) return status;
  if constexpr (std::is_floating_point_v<T>) {
    if (scale != 1) number = static_cast<T>(scaled(static_cast<double>(number), scale));
  }
  std::memcpy(to, &number, sizeof number);
  return {};
}

std::errc parse_number(Kind kind, std::string_view text, std::byte* to, double scale) noexcept {
  switch (kind) {
    case Kind::i8:
      return parse_into<std::int8_t>(text, to, scale);
    case Kind::i16:
      return parse_into<std::int16_t>(text, to, scale);
    case Kind::i32:
      return parse_into<std::int32_t>(text, to, scale);
    case Kind::i64:
      return parse_into<std::int64_t>(text, to, scale);
    case Kind::u8:
      return parse_into<std::uint8_t>(text, to, scale);
    case Kind::u16:
      return parse_into<std::uint16_t>(text, to, scale);
    case Kind::u32:
      return parse_into<std::uint32_t>(text, to, scale);
    case Kind::u64:
      return parse_into<std::uint64_t>(text, to, scale);
    case Kind::f32:
      return parse_into<float>(text, to, scale);
    default:
      return parse_into<double>(text, to, scale);
  }
}

/// True if the text may begin a CSV number ("12.", "-1e", "na", "INF"), so that such a line is not taken as a comment.
bool begins_a_number(std::string_view text) noexcept {
  if (!text.empty() && (text.front() == '+' || text.front() == '-')) text.remove_prefix(1);
  const std::string lower = detail::lower_case(text);
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

/// NMEA has lines of its own kind.
void check_nmea(const LineConfig& config) {
  for (const auto& [key, is_set] : {std::pair("frame", config.frame.has_value()),
                                    {"only", config.only.has_value()},
                                    {"unreadable_if", config.unreadable_if.has_value()},
                                    {"checksum", config.checksum.has_value()},
                                    {"line_end", config.line_end != '\n'}})
    if (is_set) throw SetupError(refused(key, "`format` nmea reads its sentences by itself", "leave it out"));
}

void check_marks(const LineConfig& config) {
  const auto refuse = [](const char* key, std::string why, const char* advice) {
    throw SetupError(refused(key, std::move(why), advice));
  };
  constexpr std::string_view ends("\n\r\0", 3);
  const std::string& comment = config.comment;
  const bool is_csv = config.format == LineFormat::csv;
  if (config.frame && config.line_end != '\n') refuse("line_end", "events are frames", "leave it out, or `frame`");
  if (config.format == LineFormat::binary && !config.frame)
    refuse("frame", "bytes without a frame have no beginning", "set `frame`");
  if (config.checksum && config.checksum->of == ChecksumOf::row && config.format != LineFormat::labels)
    refuse("checksum", "only labels have rows", "leave `of` out");
  if (config.format == LineFormat::labels) return;
  if (comment.find_first_of(ends) != std::string::npos)
    refuse("comment", "no line begins with the end of a line", "such as \"#\", or \"\" for none");
  if (!comment.empty() && comment.find_first_not_of(" \t") == std::string::npos)
    refuse("comment", "lines of data may begin with a blank", "such as \"#\", or \"\" for none");
  if (!is_csv) {
    if (comment.starts_with('{')) refuse("comment", "each object begins with {", "such as \"#\", or \"\" for none");
    return;
  }
  if (config.separator == '"' || ends.find(config.separator) != std::string_view::npos)
    refuse("separator", "it has another meaning in CSV", "such as \",\" or \";\"");
  if (config.line_end == config.separator) refuse("line_end", "it is the separator", "set another one");
  if (std::string_view("0123456789+-.eEaAfFiInNtTyY").find(config.separator) != std::string_view::npos)
    refuse("separator", "numbers may have this character", "such as \",\" or \";\"");
  if (comment.empty()) return;
  if (comment.front() == config.separator)
    refuse("comment", "comments would begin with the separator", "set another `comment`, \"\" for none");
  const bool begins_with_boolean = !config.fields.empty() && config.fields.front().type == Kind::boolean;
  if (comment.front() == '"' || begins_a_number(comment) || (begins_with_boolean && begins_a_boolean(comment)))
    refuse("comment", "lines of data may begin with it", "such as \"#\", or \"\" for none");
}

std::string shown(std::string_view text) {
  std::string shown = "\"";
  for (const char c : text.substr(0, 40)) shown += c >= ' ' && c < 127 ? c : '?';
  return shown + (text.size() > 40 ? "...\"" : "\"");
}

}  // namespace

std::unique_ptr<LineDecoder> decoder_of_lines(const LineConfig& config) {
  if (config.format != LineFormat::nmea) return std::make_unique<LineDecoder>(config);
  check_nmea(config);
  return nullptr;
}

LineDecoder::LineDecoder(const LineConfig& config, AroundLine around)
    : around_(std::move(around)),
      bad_line_("cannot use a " + around_.what),
      fields_(config.fields),
      description_(line_description(config.fields).or_throw()),
      format_(config.format),
      separator_(config.separator),
      comment_(config.comment),
      only_(config.only),
      unreadable_if_(config.unreadable_if),
      payload_((description_->size() + sizeof(std::max_align_t) - 1) / sizeof(std::max_align_t)),
      seen_(fields_.size()) {
  check_marks(config);
  cell_.reserve(config.max_line);
  for (LineField& field : fields_) {
    texts_.emplace_back(field);
    field.optional = field.optional || !field.no_value.empty();
    leaves_.push_back(field.name.empty() ? nullptr : description_->find(field.name));
    if (field.key.empty()) field.key = field.name;
    const auto& given = around_.given;
    is_given_.push_back(std::find(given.begin(), given.end(), field.key) != given.end());
    if (!is_given_.back()) ++columns_;
    if ((format_ == LineFormat::json || format_ == LineFormat::labels) && field.key.empty()) {
      throw SetupError(refused("field " + std::to_string(leaves_.size()),
                               format_ == LineFormat::json ? "a field of JSON has no name" : "a field has no name",
                               "give it a `name`"));
    }
    if (format_ != LineFormat::binary && (field.at || field.wire))
      throw SetupError(refused("field " + field.name, "`at` and `wire` are of binary frames", "leave them out"));
    if (format_ != LineFormat::labels && field.column != 1)
      throw SetupError(refused("field " + field.name, "`column` is of labels", "leave it out"));
  }
  if (config.checksum) {
    checksum_.emplace(*config.checksum);
    has_row_checksums_ = config.checksum->of == ChecksumOf::row;
  }
  for (const auto* match : {&only_, &unreadable_if_}) {
    if (!*match) continue;
    const char* const key = match == &only_ ? "only" : "unreadable_if";
    const LineMatch& of = **match;
    const auto refuse = [&](const char* why, const char* advice) { throw SetupError(refused(key, why, advice)); };
    if (of.is.empty() && of.begins.empty() && of.contains.empty())
      refuse("it does not say what the text is", "set `is`, `begins` or `contains`");
    if (of.column != 0 && format_ != LineFormat::csv) refuse("only CSV has columns", "use `key`, or the whole line");
    if (!of.key.empty() && format_ != LineFormat::json && format_ != LineFormat::labels)
      refuse("only JSON and labels have keys", "use `column`, or the whole line");
    if (format_ == LineFormat::binary) refuse("frames of bytes have no text", "leave it out");
  }
  if (format_ == LineFormat::binary) {
    if (config.separator != ',') throw SetupError(refused("separator", "bytes have none", "leave it out"));
    binary_.emplace(config.fields, *description_, config.frame->byte_order, config.frame->length);
  }
  for (const LineField& field : config.fields)
    if (format_ == LineFormat::csv && (field.decimal == separator_ || field.thousands == std::string(1, separator_)))
      throw SetupError(refused("separator", "field " + field.name + " has it within its numbers",
                               "set another `separator`, such as \";\""));
  if (config.sequence_field.empty()) return;
  sequence_ = description_->find(config.sequence_field);
  if (sequence_ == nullptr || !is_integer_kind(sequence_->kind)) {
    throw SetupError(refused("sequence_field", "\"" + config.sequence_field + "\" is not an integer among the fields",
                             "name one of `fields` whose type is an integer"));
  }
  if (sequence_->optional != nullptr) {
    throw SetupError(refused("sequence_field", "\"" + config.sequence_field + "\" is optional",
                             "remove its `optional` and `no_value`: each line has a number"));
  }
}

bool LineDecoder::is_skipped(std::string_view line) const noexcept {
  return trimmed(line).empty() || (!comment_.empty() && line.starts_with(comment_));
}

bool LineDecoder::is_meant(std::string_view line) { return !only_ || matches(*only_, line); }

Result<std::string_view> LineDecoder::checked(std::string_view line) const {
  return checksum_ && !has_row_checksums_ ? checksum_->checked(line) : Result(line);
}

bool LineDecoder::is_damaged(std::string_view line) const noexcept {
  return checksum_ && !has_row_checksums_ && checksum_->is_damaged(line);
}

bool LineDecoder::matches(const LineMatch& match, std::string_view line) {
  const auto text = text_in_question(match, line);
  return text && text->starts_with(match.begins) && text->find(match.contains) != std::string_view::npos &&
         (match.is.empty() || std::find(match.is.begin(), match.is.end(), *text) != match.is.end());
}

Result<void> LineDecoder::decode(std::string_view line) {
  std::memset(payload_.data(), 0, payload_.size() * sizeof payload_[0]);
  if (unreadable_if_ && matches(*unreadable_if_, line))
    return Error{Errc::bad_data, bad_line_, shown(line), "the device says that it has no value (`unreadable_if`)",
                 "check the device"};
  if (binary_) return binary_->decode(line, texts_, payload());
  if (format_ == LineFormat::json) return decode_json(line);
  if (format_ == LineFormat::labels) return decode_labels(line);
  Result<void> done = decode_csv(line);
  if (done) return done;
  Error error = std::move(done).error();
  error.advice = advice_on(line);
  return error;
}

/// Advice for an unexpected line.
std::string LineDecoder::advice_on(std::string_view line) const {
  const auto columns_by = [&](char separator) {
    return static_cast<std::size_t>(std::count(line.begin(), line.end(), separator)) + 1;
  };
  for (const char other : {';', ',', '\t', '|', ' '}) {
    if (columns_ < 2 || columns_by(separator_) == columns_ || columns_by(other) != columns_) continue;
    return std::string("the line seems to be separated by ") +
           (other == '\t'  ? "tabs"
            : other == ' ' ? "blanks"
                           : "\"" + std::string(1, other) + "\"") +
           ": set `separator`";
  }
  const bool is_numeric = std::none_of(fields_.begin(), fields_.end(),
                                       [](const LineField& field) { return field.type == Kind::text; });
  if (is_numeric && !line.empty() && std::isalpha(static_cast<unsigned char>(line.front())) != 0)
    return std::string(check_fields) + "; a greeting or a heading is left out by `skip_lines` or `comment`";
  return check_fields;
}

Result<void> LineDecoder::give(std::string_view key, std::string_view text) {
  for (std::size_t i = 0; i < fields_.size(); ++i) {
    if (!is_given(i) || fields_[i].key != key) continue;
    if (auto done = put(i, text); !done) return done;
  }
  return {};
}

Error LineDecoder::failure(Errc code, std::size_t index, std::string why) const {
  const std::string& name = fields_[index].name;
  return {code, bad_line_, name.empty() ? "column " + std::to_string(index + 1) : "field " + name, std::move(why),
          check_fields};
}

Result<void> LineDecoder::put(std::size_t index, std::string_view text) {
  const Leaf* leaf = leaves_[index];
  if (leaf == nullptr) return {};
  double scale = fields_[index].scale;
  if (FieldText& of = texts_[index]; of.is_used()) {
    const FieldText::Found found = of.read(text);
    if (found.is_absent) return {};
    if (found.why != nullptr) return failure(Errc::bad_data, index, shown(text) + " " + found.why);
    if (!found.is_scaled) scale = 1;
    text = found.text;
  }
  if (auto done = put_value(index, *leaf, text, scale); !done) return done;
  if (leaf->optional != nullptr) payload()[leaf->offset + leaf->optional->value_size] = std::byte{1};
  return {};
}

Result<void> LineDecoder::put_value(std::size_t index, const Leaf& leaf_of_it, std::string_view text, double scale) {
  const Leaf* leaf = &leaf_of_it;
  std::byte* to = payload() + leaf->offset;
  switch (leaf->kind) {
    case Kind::text: {
      const std::size_t capacity = leaf->size - text_length_bytes;
      if (text.size() > capacity) {
        return failure(Errc::does_not_fit, index,
                       shown(text) + " is longer than " + std::to_string(capacity) + " bytes");
      }
      to[0] = static_cast<std::byte>(text.size() & 0xff);
      to[1] = static_cast<std::byte>(text.size() >> 8);
      std::memcpy(to + text_length_bytes, text.data(), text.size());
      return {};
    }
    case Kind::character: {
      const auto c = character_of(text);
      if (!c) return failure(Errc::bad_data, index, shown(text) + " is not one character");
      *to = static_cast<std::byte>(*c);
      return {};
    }
    case Kind::boolean: {
      bool flag = false;
      if (!read_boolean(text, flag)) {
        return failure(Errc::bad_data, index, shown(text) + " is not true, false, 1 or 0");
      }
      *to = static_cast<std::byte>(flag);
      return {};
    }
    default: {
      const std::errc status = parse_number(leaf->kind, text, to, scale);
      if (status == std::errc{}) return {};
      if (status == std::errc::result_out_of_range) {
        return failure(Errc::out_of_range, index,
                       shown(text) + " does not fit into " + std::string(name_of(leaf->kind)));
      }
      return failure(Errc::not_a_number, index, shown(text) + " is not " + type_name(leaf->kind));
    }
  }
}

Result<LineDecoder::Column> LineDecoder::next_column(std::size_t index, std::string_view& rest) {
  const auto first = rest.find_first_not_of(' ');
  const bool is_quoted = first != std::string_view::npos && rest[first] == '"';
  std::size_t end = is_quoted ? first + 1 : rest.find(separator_);
  if (is_quoted) {  // a separator in it belongs to it, and a quote is written twice
    cell_.clear();
    for (;; ++end) {
      const auto quote = rest.find('"', end);
      if (quote == std::string_view::npos) return failure(Errc::bad_data, index, "its quote does not end");
      cell_.append(rest.substr(end, quote - end));
      end = quote + 1;
      if (end >= rest.size() || rest[end] != '"') break;
      cell_ += '"';
    }
    const std::size_t after = end;
    end = rest.find(separator_, after);
    if (const auto more = trimmed(rest.substr(after, end - after)); !more.empty())
      return failure(Errc::bad_data, index, shown(more) + " follows its quotes");
  }
  const std::string_view text = is_quoted ? std::string_view(cell_) : trimmed(rest.substr(0, end));
  if (end == std::string_view::npos) {
    rest = {};
  } else {
    rest.remove_prefix(end + 1);
    if (separator_ == ' ') rest.remove_prefix(std::min(rest.find_first_not_of(' '), rest.size()));
  }
  return Column{text, is_quoted};
}

Result<void> LineDecoder::decode_csv(std::string_view line) {
  const auto count_error = [&](std::string_view what) {
    return Error{Errc::bad_data, bad_line_, shown(line),
                 "it has " + std::string(what) + " than the " + std::to_string(columns_) + " columns expected",
                 check_fields};
  };
  std::string_view rest = separator_ == ' ' ? trimmed(line) : line;
  for (std::size_t i = 0; i < fields_.size(); ++i) {
    if (is_given(i)) continue;
    const bool has_more = rest.data() != nullptr;
    if (!has_more) return count_error("fewer");
    const Result<Column> column = next_column(i, rest);
    if (!column) return column.error();
    const bool is_absent = fields_[i].optional && column->text.empty() && !column->is_quoted;
    if (is_absent) continue;
    if (Result<void> done = put(i, column->text); !done) return done;
  }
  if (rest.data() != nullptr) return count_error("more");
  return {};
}

/// The first row with this label; empty: there is none.
static std::optional<std::string_view> row_of(std::string_view rows, std::string_view label, char separator) {
  while (!rows.empty()) {
    const std::size_t end = std::min(rows.find('\n'), rows.size());
    const std::string_view row = trimmed(rows.substr(0, end));
    rows.remove_prefix(std::min(end + 1, rows.size()));
    const std::size_t mark = row.find(separator);
    if (mark != std::string_view::npos && trimmed(row.substr(0, mark)) == label) return row.substr(mark + 1);
  }
  return std::nullopt;
}

/// Rows of a label and values.
Result<void> LineDecoder::decode_labels(std::string_view rows) {
  std::fill(seen_.begin(), seen_.end(), false);
  while (!rows.empty()) {
    const std::size_t end = std::min(rows.find('\n'), rows.size());
    std::string_view row = rows.substr(0, end);
    rows.remove_prefix(std::min(end + 1, rows.size()));
    if (row.ends_with('\r')) row.remove_suffix(1);
    const std::size_t mark = row.find(separator_);
    if (mark == std::string_view::npos) continue;
    const std::string_view label = trimmed(row.substr(0, mark));
    bool is_checked = false;
    for (std::size_t i = 0; i < fields_.size(); ++i) {
      if (is_given(i) || fields_[i].key != label) continue;
      if (has_row_checksums_ && !std::exchange(is_checked, true)) {
        const Result<std::string_view> good = checksum_->checked(row);
        if (!good) return failure(Errc::bad_data, i, good.error().why);
        row = *good;
      }
      if (row.size() <= mark) return failure(Errc::bad_data, i, "its row has a checksum, and no value");
      if (seen_[i]) return failure(Errc::bad_data, i, "it is there twice");
      std::string_view rest = row.substr(mark + 1);
      Result<Column> column = next_column(i, rest);
      for (std::size_t n = 1; column && n < fields_[i].column; ++n) {
        if (rest.data() == nullptr)
          return failure(Errc::bad_data, i, "its row has only " + std::to_string(n) + " columns");
        column = next_column(i, rest);
      }
      if (!column) return column.error();
      seen_[i] = true;
      if (fields_[i].optional && column->text.empty() && !column->is_quoted) continue;
      if (Result<void> done = put(i, column->text); !done) return done;
    }
  }
  return all_seen();
}

/// Follows the parser through one object, and takes the values whose path is a field's key.
class LineDecoder::JsonHandler {
 public:
  using number_integer_t = nlohmann::json::number_integer_t;
  using number_unsigned_t = nlohmann::json::number_unsigned_t;
  using number_float_t = nlohmann::json::number_float_t;
  using string_t = nlohmann::json::string_t;
  using binary_t = nlohmann::json::binary_t;
  /// `wanted`: only looks for this value; empty: takes the fields.
  explicit JsonHandler(LineDecoder& decoder, std::string_view wanted = {}) : decoder_(decoder), wanted_(wanted) {}
  bool has_found() const noexcept { return has_found_; }

  bool null() { return take(Form::null, "null"); }
  bool boolean(bool is_true) { return take(Form::boolean, is_true ? "true" : "false"); }
  // The parser takes a 0 without a sign for an unsigned number.
  bool number_integer(number_integer_t number) { return number == 0 ? take(Form::number, "-0") : take_number(number); }
  bool number_unsigned(number_unsigned_t number) { return take_number(number); }
  bool number_float(number_float_t, const string_t& text) { return take(Form::number, text); }
  bool string(string_t& text) { return take(Form::string, text); }
  bool binary(binary_t&) { return false; }
  bool start_object(std::size_t) { return open(false); }
  bool key(string_t& name) {
    path_.resize(levels_.back().start);
    path_ += name;
    return true;
  }
  bool end_object() { return close(); }
  bool start_array(std::size_t) { return open(true); }
  bool end_array() { return close(); }
  bool parse_error(std::size_t position, const std::string& token, const nlohmann::detail::exception& why) {
    constexpr int number_overflow = 406;
    error_ = why.id == number_overflow
                 ? Error{Errc::out_of_range, decoder_.bad_line_, "", shown(token) + " does not fit into a double", ""}
                 : Error{Errc::bad_data, decoder_.bad_line_, "",
                         "it is not JSON from byte " + std::to_string(position) + " on", check_fields};
    return false;
  }
  Error take_error() {
    return error_ ? std::move(*error_)
                  : Error{Errc::bad_data, decoder_.bad_line_, "", "it is not a JSON object", check_fields};
  }

 private:
  enum class Form { number, boolean, string, null };
  bool take(Form form, std::string_view text);
  /// A value begins: in an array its path ends with its index.
  void begin_value() {
    if (levels_.empty() || !levels_.back().is_array) return;
    path_.resize(levels_.back().start);
    char digits[24];
    path_.append(digits, std::to_chars(digits, digits + sizeof digits, levels_.back().index++).ptr);
  }
  bool open(bool is_array) {
    begin_value();
    if (!levels_.empty()) path_ += '.';
    levels_.push_back({path_.size(), is_array, 0});
    return true;
  }
  bool close() {
    levels_.pop_back();
    return true;
  }
  template <class T>
  bool take_number(T number) {
    char text[24];
    const auto end = std::to_chars(text, text + sizeof text, number).ptr;
    return take(Form::number, {text, static_cast<std::size_t>(end - text)});
  }

  LineDecoder& decoder_;
  const std::string_view wanted_;
  bool has_found_ = false;
  std::string path_;  // of the value last seen
  struct Level {
    std::size_t start;  // where in the path the key or index begins
    bool is_array;
    std::size_t index;  // of the next value
  };
  std::vector<Level> levels_;  // objects and arrays that are open
  std::optional<Error> error_;
};

bool LineDecoder::JsonHandler::take(Form form, std::string_view text) {
  if (levels_.empty()) return false;
  begin_value();
  if (!wanted_.empty()) {
    if (path_ != wanted_) return true;
    decoder_.found_ = text;
    has_found_ = true;
    return false;  // no more is needed
  }
  for (std::size_t i = 0; i < decoder_.fields_.size(); ++i) {
    if (decoder_.fields_[i].key != path_ || decoder_.is_given(i)) continue;
    const Kind kind = decoder_.fields_[i].type;
    const bool is_textual = kind == Kind::text || kind == Kind::character;
    // As our own JSON has them, since JSON has no such numbers.
    if (form == Form::string && (kind == Kind::f32 || kind == Kind::f64) &&
        (text == "NaN" || text == "Infinity" || text == "-Infinity"))
      form = Form::number;
    // What stands around a number makes it a text.
    if (form == Form::string && !is_textual && decoder_.texts_[i].is_used()) form = Form::number;
    if (decoder_.seen_[i]) {
      error_ = decoder_.failure(Errc::bad_data, i, "it is there twice");
    } else if (form == Form::null && decoder_.fields_[i].optional) {
      // absent, as it is from the beginning
    } else if (form == Form::null || is_textual != (form == Form::string) ||
               (kind != Kind::boolean && form == Form::boolean)) {
      error_ = decoder_.failure(is_textual ? Errc::bad_data : Errc::not_a_number, i,
                                shown(text) + " is not " + type_name(kind));
    } else if (Result<void> done = decoder_.put(i, text); !done) {
      error_ = std::move(done).error();
    }
    if (error_) return false;
    decoder_.seen_[i] = true;
  }
  return true;
}

Result<void> LineDecoder::decode_json(std::string_view line) {
  std::fill(seen_.begin(), seen_.end(), false);
  JsonHandler handler(*this);
  if (!nlohmann::json::sax_parse(line.begin(), line.end(), &handler)) {
    Error error = handler.take_error();
    if (error.where.empty()) error.where = shown(line);
    return error;
  }
  return all_seen();
}

Result<void> LineDecoder::all_seen() const {
  for (std::size_t i = 0; i < fields_.size(); ++i) {
    if (!seen_[i] && !fields_[i].optional && !is_given(i))
      return failure(Errc::bad_data, i, "the " + around_.what + " has no \"" + fields_[i].key + "\"");
  }
  return {};
}

std::optional<std::string_view> LineDecoder::text_in_question(const LineMatch& match, std::string_view line) {
  if (!match.key.empty() && format_ == LineFormat::labels) {
    const auto row = row_of(line, match.key, separator_);
    return row ? std::optional(trimmed(row->substr(0, row->find(separator_)))) : std::nullopt;
  }
  if (!match.key.empty()) {
    JsonHandler handler(*this, match.key);
    nlohmann::json::sax_parse(line.begin(), line.end(), &handler);
    return handler.has_found() ? std::optional<std::string_view>(found_) : std::nullopt;
  }
  if (match.column == 0) return trimmed(line);
  std::string_view rest = separator_ == ' ' ? trimmed(line) : line;
  for (unsigned i = 1;; ++i) {
    const Result<Column> column = next_column(0, rest);
    if (!column) return std::nullopt;
    if (i == match.column) return column->text;
    if (rest.data() == nullptr) return std::nullopt;
  }
}

std::uint64_t LineDecoder::number() const noexcept {
  std::uint64_t number = 0;
  std::memcpy(&number, reinterpret_cast<const std::byte*>(payload_.data()) + sequence_->offset,
              sequence_->size);  // the machines we run on put the low byte first
  return number;
}

std::optional<std::uint64_t> LineDecoder::steps_between(std::uint64_t from, std::uint64_t to) const noexcept {
  const unsigned bits = 8 * static_cast<unsigned>(sequence_->size);
  const std::uint64_t all = bits == 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << bits) - 1;
  const std::uint64_t forward = (to - from) & all;
  const bool is_signed = sequence_->kind <= Kind::i64;
  const bool has_grown = is_signed ? forward <= all / 2 : to > from;
  // A number that goes back has wrapped when that is a small step, else the device has started again.
  if (forward != 0 && !has_grown && forward > all / 16) return std::nullopt;
  return forward;
}

LineDecoder::NumberComparison LineDecoder::step() noexcept {
  if (sequence_ == nullptr) return {};
  before_ = std::exchange(last_, number());
  if (!before_) return {};
  const std::optional<std::uint64_t> steps = steps_between(*before_, *last_);
  if (!steps) return {.goes_back = true};
  if (*steps == 0) return {.is_repeated = true};
  return {.lost = *steps - 1};
}

bool LineDecoder::takes_back() const noexcept {
  if (sequence_ == nullptr || !before_ || !last_) return false;
  const std::optional<std::uint64_t> from_before = steps_between(*before_, number());
  const std::optional<std::uint64_t> from_last = steps_between(*last_, number());
  return from_before && (!from_last || *from_before < *from_last);
}

}  // namespace detail

Result<std::shared_ptr<const Description>> description_of_lines(const LineConfig& config) {
  if (config.format == LineFormat::nmea) return description_of<GpsFix>();
  return line_description(config.fields);
}

void check_config(const LineConfig& config, const ConfigItem& item, Problems& problems) {
  try {
    (void)detail::decoder_of_lines(config);
    if (config.frame) detail::FrameCutter(*config.frame, config.max_line);
  } catch (const SetupError& error) {
    const Error& e = error.error();
    const std::string_view keys[] = {"sequence_field", "separator", "comment",       "line_end",
                                     "frame",          "only",      "unreadable_if", "checksum"};
    const bool is_of_key = std::find(std::begin(keys), std::end(keys), e.where) != std::end(keys);
    const std::string key = is_of_key ? e.where : "fields";
    const ConfigItem* at = item.find(key);
    if (at == nullptr && key == "comment") at = item.find("separator");  // which is that of the default
    const bool is_key = e.where.empty() || e.where == key;
    problems.add(
        (at != nullptr ? *at : item).problem("bad-value", (is_key ? "" : e.where + ": ") + e.why + "; " + e.advice));
  }
}

ReadTime read_time(const LineConfig&) { return {.on_loop = std::chrono::microseconds{500}}; }

}  // namespace rtdata
