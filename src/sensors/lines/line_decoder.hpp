// Lines of text to payloads.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/sensors/lines.hpp"
#include "sensors/lines/binary_field.hpp"
#include "sensors/lines/checksum.hpp"
#include "sensors/lines/field_text.hpp"
#include "sensors/lines/line_pattern.hpp"

namespace rtdata::detail {

/// Fields with one of these keys are not in the lines and are set with `give`. Also: how messages call a line.
struct AroundLine {
  std::vector<std::string> given = {};
  std::string what = "line";
};

/// Decodes one line at a time into a buffer of its own.
class LineDecoder {
 public:
  /// SetupError (bad-argument, bad-description).
  explicit LineDecoder(const LineConfig& config, AroundLine around = {});

  const std::shared_ptr<const Description>& description() const noexcept { return description_; }
  /// True if the line is empty or a comment.
  bool is_skipped(std::string_view line) const noexcept;
  /// False if `only` excludes the line.
  bool is_meant(std::string_view line) { return !only_ || is_chosen(line); }
  /// True if the checksum of the line is wrong.
  bool is_damaged(std::string_view line) const noexcept;
  /// The line or frame without its checksum. Errors: bad-data.
  Result<std::string_view> checked(std::string_view line) const;
  /// Afterwards `payload` is the line's. Errors: bad-data, not-a-number, out-of-range, does-not-fit; no allocation
  /// without an error.
  Result<void> decode(std::string_view line);
  /// True if a pattern takes any bytes.
  bool has_bytes() const noexcept;
  /// After `decode` has failed: the device reports that it has no value (`unreadable_if`).
  bool says_none() const noexcept { return says_none_; }
  /// After `decode`: the value of the fields with this key. Errors: those of `decode`.
  Result<void> give(std::string_view key, std::string_view text);
  std::byte* payload() noexcept { return reinterpret_cast<std::byte*>(payload_.data()); }

  /// The comparison of the line's number with the last one.
  struct NumberComparison {
    bool is_repeated = false;
    bool goes_back = false;  // as after a restart of the device
    std::uint64_t lost = 0;
  };
  bool has_sequence() const noexcept { return sequence_ != nullptr; }
  /// To be called for each good line.
  NumberComparison step() noexcept;
  /// Call before `step`: true if this number follows the one before the last, so the last number was wrong.
  bool takes_back() const noexcept;
  /// Ignores the last line's number.
  void drop_last() noexcept { last_ = before_; }
  /// Starts again with the next line's number.
  void forget_sequence() noexcept { last_.reset(); }

 private:
  class JsonHandler;
  Result<void> decode_csv(std::string_view line);
  std::string advice_on(std::string_view line) const;
  bool is_chosen(std::string_view line);
  Result<void> decode_json(std::string_view line);
  void find_choices();
  /// The keys with the indices of the objects that they choose, in this line.
  void choose_in_json(std::string_view line);
  /// Writes the value to `found_`. False: there is no value.
  bool find_in_json(std::string_view key, std::string_view line);
  /// The end of the row's label if it is this field's label; otherwise npos.
  std::size_t end_of_label(std::string_view row, std::string_view label) const noexcept;
  std::optional<std::string_view> row_of(std::string_view rows, std::string_view label) const noexcept;
  Result<void> decode_labels(std::string_view rows);
  Result<void> decode_pattern(std::string_view line);
  Result<void> decode_binary(std::string_view frame);
  Result<void> put_group(std::size_t index, std::string_view group);
  void use_bytes(const LineConfig& config);
  Result<void> all_seen() const;
  /// LineMatch, with its regular expression ready for use.
  struct Match {
    LineMatch config;
    std::optional<LinePattern> pattern = {};
    std::vector<std::string> bytes = {};  // `is_hex`
  };
  static std::optional<Match> match_of(const std::optional<LineMatch>& config, const char* key);
  bool matches(Match& match, std::string_view line);
  bool is_found(LinePattern& pattern, std::string_view text) noexcept;
  std::optional<std::string_view> text_in_question(const LineMatch& match, std::string_view line);
  /// Puts the text of column or key `index` in its place.
  Result<void> put(std::size_t index, std::string_view text);
  Result<void> put_value(std::size_t index, const Leaf& leaf, std::string_view text, const FieldScale& scale);
  struct Column {
    std::string_view text;  // valid until the next one
    bool is_quoted = false;
  };
  std::string_view text_of(std::size_t index, const Column& column) const noexcept;
  Result<Column> next_column(std::size_t index, std::string_view& rest);
  /// A column that contains only the digits of a number.
  struct PlainNumber {
    bool is_one = false;
    std::size_t offset = 0;  // of the number
    FieldScale scale = FieldScale(1);
  };
  bool take_number(const PlainNumber& plain, std::string_view& rest) noexcept;
  void go_behind(std::size_t end, std::string_view& rest) const noexcept;
  Error failure(Errc code, std::size_t index, std::string why) const;
  std::uint64_t number() const noexcept;
  /// The distance between two numbers. Empty: the number goes back.
  std::optional<std::uint64_t> steps_between(std::uint64_t from, std::uint64_t to) const noexcept;
  void use_pattern(const std::string& expression);
  bool is_given(std::size_t index) const noexcept { return is_given_[index]; }

  const AroundLine around_;
  const std::string bad_line_;
  std::vector<LineField> fields_;
  std::vector<FieldText> texts_;     // of each field
  std::vector<FieldScale> scales_;   // of each field
  std::vector<PlainNumber> plain_;   // of each field
  std::vector<const Leaf*> leaves_;  // of each field; null: not kept
  std::shared_ptr<const Description> description_;
  LineFormat format_;
  char separator_;
  std::string comment_;
  const Leaf* sequence_ = nullptr;
  std::optional<std::uint64_t> last_;    // the bits of the number
  std::optional<std::uint64_t> before_;  // of the line before that
  std::optional<Match> only_, unreadable_if_;
  std::optional<LinePattern> pattern_;
  std::vector<std::vector<unsigned>> groups_;  // of each field, their numbers in the pattern
  std::optional<Checksum> checksum_;
  bool has_row_checksums_ = false;
  bool says_none_ = false;
  bool is_too_long_ = false;                        // the text for `only` is too long for a search
  bool is_not_json_ = false;                        // the text for `only` is not JSON
  std::vector<std::optional<BinaryField>> binary_;  // of each field whose values are bytes
  std::vector<std::max_align_t> payload_;
  std::vector<bool> seen_;
  std::vector<bool> is_given_;
  std::size_t columns_ = 0;
  std::string cell_;   // without its quotes
  std::string found_;  // the value in JSON that a match looks at
  /// A key such as values[type=P1].value: in the array `values`, the first object with that member.
  struct Choice {
    std::size_t field;
    std::string key, array, member, text, rest;  // "values.", ".type", "P1", ".value"
    bool is_made = false;                        // in this line
  };
  std::vector<Choice> choices_;
};

}  // namespace rtdata::detail
