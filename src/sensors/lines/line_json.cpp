// LineDecoder: lines of JSON.
#include <algorithm>
#include <charconv>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "sensors/core/sysfs_file.hpp"
#include "sensors/lines/line_config.hpp"
#include "sensors/lines/line_decoder.hpp"

namespace rtdata::detail {

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
  /// Looks for the members by which keys choose objects.
  void only_choose() noexcept { only_chooses_ = true; }

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
                 ? Error{Errc::out_of_range, decoder_.bad_line_, "", shown_line(token) + " does not fit into a double",
                         ""}
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
  bool choose(std::string_view text);
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
  bool only_chooses_ = false;
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
  if (only_chooses_) return choose(text);
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
    // In the form of our own JSON output, since JSON has no such numbers.
    if (form == Form::string && (kind == Kind::f32 || kind == Kind::f64) &&
        (text == "NaN" || text == "Infinity" || text == "-Infinity"))
      form = Form::number;
    // Many devices write numbers as texts; an empty one is no value.
    if (form == Form::string && !is_textual)
      form = text.empty() && decoder_.fields_[i].optional ? Form::null : Form::number;
    if (decoder_.seen_[i]) {
      error_ = decoder_.failure(Errc::bad_data, i, "it occurs twice");
    } else if (form == Form::null && decoder_.fields_[i].optional) {
      // absent, as at the start
    } else if (form == Form::null || is_textual != (form == Form::string) ||
               (kind != Kind::boolean && form == Form::boolean)) {
      error_ = decoder_.failure(is_textual ? Errc::bad_data : Errc::not_a_number, i,
                                shown_line(text) + " is not " + type_with_article(kind));
    } else if (Result<void> done = decoder_.put(i, text); !done) {
      error_ = std::move(done).error();
    }
    if (error_) return false;
    decoder_.seen_[i] = true;
  }
  return true;
}

bool LineDecoder::JsonHandler::choose(std::string_view text) {
  for (Choice& choice : decoder_.choices_) {
    const std::string_view path(path_);
    if (choice.is_made || text != choice.text || !path.starts_with(choice.array) || !path.ends_with(choice.member))
      continue;
    const std::size_t begin = choice.array.size();
    if (path.size() <= begin + choice.member.size()) continue;
    const std::string_view index = path.substr(begin, path.size() - choice.member.size() - begin);
    if (index.find_first_not_of("0123456789") != std::string_view::npos) continue;
    choice.is_made = true;
    decoder_.fields_[choice.field].key.assign(choice.array).append(index).append(choice.rest);
  }
  return true;
}

void LineDecoder::find_choices() {
  for (std::size_t i = 0; i < fields_.size(); ++i) {
    const std::string& key = fields_[i].key;
    const std::size_t open = key.find('['), equals = key.find('=', open), close = key.find(']', equals);
    if (open == std::string::npos || equals == std::string::npos || close == std::string::npos) continue;
    Choice choice{i,
                  key,
                  key.substr(0, open),
                  "." + key.substr(open + 1, equals - open - 1),
                  key.substr(equals + 1, close - equals - 1),
                  key.substr(close + 1)};
    if (!choice.array.empty()) choice.array += '.';
    choices_.push_back(std::move(choice));
  }
}

void LineDecoder::choose_in_json(std::string_view line) {
  for (Choice& choice : choices_) {
    choice.is_made = false;
    fields_[choice.field].key = choice.key;
  }
  JsonHandler handler(*this);
  handler.only_choose();
  nlohmann::json::sax_parse(line.begin(), line.end(), &handler);
}

/// A NUL would end the text for the parser.
static std::size_t end_of_json(std::string_view line) { return std::min(line.find('\0'), line.size()); }

Result<void> LineDecoder::decode_json(std::string_view line) {
  if (const std::size_t end = end_of_json(line); end != line.size())
    return Error{Errc::bad_data, bad_line_, shown_line(line),
                 "it is not JSON from byte " + std::to_string(end + 1) + " on: there is a NUL byte", check_fields};
  std::fill(seen_.begin(), seen_.end(), false);
  if (!choices_.empty()) choose_in_json(line);
  JsonHandler handler(*this);
  if (!nlohmann::json::sax_parse(line.begin(), line.end(), &handler)) {
    Error error = handler.take_error();
    if (error.where.empty()) error.where = shown_line(line);
    return error;
  }
  return all_seen();
}

bool LineDecoder::find_in_json(std::string_view key, std::string_view line) {
  JsonHandler handler(*this, key);
  const bool is_whole = nlohmann::json::sax_parse(line.begin(), line.end(), &handler);
  // Lines that are not JSON at all, such as a board's output at its start, are not for this sensor.
  const std::string_view begin = trimmed(line).substr(0, 1);
  is_not_json_ = !handler.has_found() && (begin == "{" || begin == "[") &&
                 (!is_whole || end_of_json(line) != line.size());
  return handler.has_found();
}

}  // namespace rtdata::detail
