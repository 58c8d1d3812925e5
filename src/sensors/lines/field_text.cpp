#include "sensors/lines/field_text.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdint>

#include "data/field_layout.hpp"
#include "data/number_text.hpp"
#include "sensors/core/sysfs_file.hpp"

namespace rtdata::detail {
namespace {

constexpr std::size_t longest_text = 128;  // of a number with its separators
constexpr const char* wrong_groups = "has a `thousands` character that is not before a group of three digits";

[[noreturn]] void refuse_field(const LineField& field, std::string why, std::string advice) {
  throw SetupError(
      {Errc::bad_argument, "cannot use these fields", "field " + field.name, std::move(why), std::move(advice)});
}

}  // namespace

FieldText::FieldText(const LineField& field)
    : is_number_(is_number_kind(field.type)),
      prefix_(field.prefix),
      suffix_(field.suffix),
      decimal_(field.decimal),
      base_(static_cast<int>(field.base)),
      has_sign_blanks_(field.sign_blanks),
      half_(field.type <= Kind::i64 && is_integer_kind(field.type) ? std::uint64_t{1} << (8 * size_of(field.type) - 1)
                                                                   : 0) {
  buffer_.reserve(longest_text);
  if (field.thousands.size() > 1)
    refuse_field(field, "`thousands` has more than one character", R"(such as "," or "'")");
  if (!field.thousands.empty()) thousands_ = field.thousands.front();
  has_notation_ = decimal_ != '.' || thousands_ != '\0' || base_ != 10 || has_sign_blanks_;
  if (has_notation_ && !is_number_)
    refuse_field(field, "only numbers have `decimal`, `thousands`, `base` and `sign_blanks`", "remove them");
  if (prefix_.starts_with(' ') || suffix_.ends_with(' '))
    refuse_field(field, "blanks around the text of a field are removed, so its `prefix` or `suffix` never matches",
                 "remove the blank");
  if (decimal_ != '.' && decimal_ != ',')
    refuse_field(field, "`decimal` must be a point or a comma", "choose one of them");
  if (thousands_ == decimal_ || thousands_ == '-' || thousands_ == '+' ||
      (thousands_ != '\0' && std::isalnum(static_cast<unsigned char>(thousands_)) != 0))
    refuse_field(field, "`thousands` has another meaning in a number", "choose another character");
  if (decimal_ != '.' && is_number_ && field.type != Kind::f32 && field.type != Kind::f64)
    refuse_field(field, "a whole number cannot have `decimal`", "set its `type` to double, or remove `decimal`");
  if (base_ != 10 && (decimal_ != '.' || thousands_ != '\0'))
    refuse_field(field, "a number of base " + std::to_string(base_) + " cannot have `decimal` or `thousands`",
                 "remove `decimal` and `thousands`");
  if (!field.words.empty() && field.type == Kind::text)
    refuse_field(field, "`words` mean numbers, but this field is a text", "set another `type`, or remove `words`");
  for (const std::string& text : field.no_value) {
    // In the device's notation.
    double number = 0;
    std::string_view plain = text;
    const bool is_one = is_number_ && plain_number(plain) == nullptr && read_number(plain, number) == std::errc{};
    no_value_.emplace_back(text, is_one && is_number_ ? std::optional(number) : std::nullopt);
    has_numbers_of_none_ = has_numbers_of_none_ || no_value_.back().second;
  }
  const bool is_whole = is_number_ ? field.type != Kind::f32 && field.type != Kind::f64 : true;
  for (const auto& [word, number] : field.words) {
    if (is_whole && number != std::trunc(number))
      refuse_field(field, "the number of the word \"" + word + "\" is not a whole number", "set its `type` to double");
    for (const auto& [none, number_of_none] : no_value_)
      if (none == word) refuse_field(field, "\"" + word + "\" is in `words` and in `no_value`", "remove one of them");
    std::array<char, longest_number> text{};
    words_.emplace_back(word, std::string(text.data(), put_number(text.data(), number)));
  }
  is_used_ = has_notation_ || !prefix_.empty() || !suffix_.empty() || !no_value_.empty() || !words_.empty();
}

FieldText::Found FieldText::read(std::string_view text) {
  if (const auto found = known_text(text)) return *found;
  if (!text.starts_with(prefix_)) return {.why = "does not begin with its `prefix`"};
  text.remove_prefix(prefix_.size());
  if (!text.ends_with(suffix_)) return {.why = "does not end with its `suffix`"};
  text.remove_suffix(suffix_.size());
  text = trimmed(text);
  if (const auto found = known_text(text)) return *found;
  if (!is_number_) return {.text = text};
  if (text.empty()) return {.why = "has no number"};
  if (const char* const why = plain_number(text)) return {.why = why};
  if (is_no_number(text)) return {.is_absent = true};
  return {.text = text};
}

/// One of `words` or of `no_value`, which devices send with or without prefix and suffix.
std::optional<FieldText::Found> FieldText::known_text(std::string_view text) const noexcept {
  for (const auto& [none, number] : no_value_)
    if (none == text) return Found{.is_absent = true};
  for (const auto& [word, number] : words_)
    if (word == text) return Found{.text = number, .is_scaled = false};
  if (!has_notation_ && is_no_number(text)) return Found{.is_absent = true};
  return std::nullopt;
}

bool FieldText::is_no_number(std::string_view text) const noexcept {
  double value = 0;
  return has_numbers_of_none_ && read_number(text, value) == std::errc{} && is_none(value);
}

bool FieldText::is_none(double number) const noexcept {
  return std::any_of(no_value_.begin(), no_value_.end(), [&](const auto& none) {
    return none.second == number || (none.second && std::isnan(*none.second) && std::isnan(number));
  });
}

/// Copies the digits before the decimal mark to the buffer. `thousands` must be before groups of three digits;
/// otherwise it is not a thousands character.
const char* FieldText::take_thousands(std::string_view& text) {
  if (thousands_ == '\0') return nullptr;
  std::size_t digits = 0;  // of the group
  bool has_groups = false;
  for (; !text.empty(); text.remove_prefix(1)) {
    const char c = text.front();
    if (c == thousands_) {
      if (has_groups ? digits != 3 : digits == 0 || digits > 3) return wrong_groups;
      has_groups = true;
      digits = 0;
    } else if (c >= '0' && c <= '9') {
      ++digits;
      buffer_ += c;
    } else {
      break;
    }
  }
  return has_groups && digits != 3 ? wrong_groups : nullptr;
}

/// Null: the text is a number in the usual notation, or not a number.
const char* FieldText::plain_number(std::string_view& text) {
  if (decimal_ == '.' && thousands_ == '\0' && base_ == 10 && !has_sign_blanks_) return nullptr;
  if (text.size() > longest_text) return "is too long for a number";
  buffer_.clear();
  if (!text.empty() && (text.front() == '-' || text.front() == '+')) {
    buffer_ += text.front();
    text.remove_prefix(1);
    if (has_sign_blanks_) text.remove_prefix(std::min(text.find_first_not_of(' '), text.size()));
  }
  if (base_ != 10) {
    const bool has_mark = base_ == 16 && (text.starts_with("0x") || text.starts_with("0X"));
    if (has_mark) text.remove_prefix(2);
    std::uint64_t number = 0;
    const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), number, base_);
    if (status != std::errc{} || end != text.data() + text.size()) return "is not a number in its `base`";
    // Negative numbers as bytes have them: as int16, FFFF is -1.
    if (base_ == 16 && half_ != 0 && number >= half_ && number / 2 < half_ && buffer_.empty()) {
      number = 2 * half_ - number;  // 64 bits: wraps around to the correct number
      buffer_ += '-';
    }
    std::array<char, longest_number> digits{};
    buffer_.append(digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), number).ptr);
  } else {
    if (const char* const why = take_thousands(text)) return why;
    bool is_behind_mark = false;
    for (const char c : text) {
      if (c == '.' && decimal_ == ',') return "has a point, but its `decimal` is a comma";
      is_behind_mark = is_behind_mark || c == decimal_ || c == 'e' || c == 'E';
      buffer_ += c == decimal_ ? '.' : c;
    }
  }
  text = buffer_;
  return nullptr;
}

}  // namespace rtdata::detail
