#include "sensors/lines/line_decoder.hpp"

#include <algorithm>
#include <charconv>
#include <cstring>
#include <type_traits>
#include <utility>

#include "data/character.hpp"
#include "data/field_layout.hpp"
#include "data/hex_bytes.hpp"
#include "data/load.hpp"
#include "data/number_text.hpp"
#include "sensors/core/sysfs_file.hpp"
#include "sensors/lines/line_config.hpp"

namespace rtdata::detail {
namespace {

std::errc parse_number(Kind kind, std::string_view text, std::byte* to, const FieldScale& scale) noexcept {
  return for_number(kind, [&](auto number) {
    if (const std::errc status = read_number(text, number); status != std::errc{}) return status;
    if constexpr (std::is_floating_point_v<decltype(number)>)
      number = static_cast<decltype(number)>(scale(static_cast<double>(number)));
    std::memcpy(to, &number, sizeof number);
    return std::errc{};
  });
}

}  // namespace

LineDecoder::LineDecoder(const LineConfig& config, AroundLine around)
    : around_(std::move(around)),
      bad_line_("cannot use a " + (config.format == LineFormat::binary ? "frame" : around_.what)),
      fields_(config.fields),
      description_(line_description(config.fields).or_throw()),
      format_(config.format),
      separator_(config.separator),
      comment_(config.comment),
      payload_((description_->size() + sizeof(std::max_align_t) - 1) / sizeof(std::max_align_t)),
      seen_(fields_.size()) {
  cell_.reserve(config.max_line);
  for (LineField& field : fields_) {
    LineField text = field;
    if (field.wire) text.base = 10;  // the base of digits that are bytes, whose numbers are in `no_value`
    texts_.emplace_back(text);
    scales_.emplace_back(field.scale);
    field.optional = field.optional || !field.no_value.empty();
    leaves_.push_back(field.name.empty() ? nullptr : description_->find(field.name));
    if (field.key.empty()) field.key = field.name;
    const auto& given = around_.given;
    is_given_.push_back(std::find(given.begin(), given.end(), field.key) != given.end());
    if (!is_given_.back()) ++columns_;
    PlainNumber& plain = plain_.emplace_back();
    plain.is_one = leaves_.back() != nullptr && field.type == Kind::f64 && !field.wire && !field.optional &&
                   !is_given_.back() && !texts_.back().is_used();
    if (plain.is_one) plain = {true, leaves_.back()->offset, scales_.back()};
  }
  check_lines(config);
  if (format_ == LineFormat::json) find_choices();
  only_ = match_of(config.only, "only");
  unreadable_if_ = match_of(config.unreadable_if, "unreadable_if");
  if (format_ == LineFormat::pattern) use_pattern(config.pattern);
  if (config.checksum) {
    checksum_.emplace(*config.checksum);
    has_row_checksums_ = config.checksum->of == ChecksumOf::row;
  }
  use_bytes(config);
  if (config.sequence_field.empty()) return;
  sequence_ = description_->find(config.sequence_field);
  if (sequence_ == nullptr || !is_integer_kind(sequence_->kind)) {
    throw SetupError(refused_lines("sequence_field",
                                   "\"" + config.sequence_field + "\" is not an integer among the fields",
                                   "name one of `fields` whose type is an integer"));
  }
  if (sequence_->optional != nullptr) {
    throw SetupError(refused_lines("sequence_field", "\"" + config.sequence_field + "\" is optional",
                                   "remove its `optional` and `no_value`: each line has a number"));
  }
}

bool LineDecoder::is_skipped(std::string_view line) const noexcept {
  return line.find_first_not_of(" \t\r\n") == std::string_view::npos ||
         (!comment_.empty() && line.starts_with(comment_));
}

bool LineDecoder::is_chosen(std::string_view line) {
  is_too_long_ = is_not_json_ = false;
  // If it is not known whether the line is for this sensor, `decode` fails.
  return matches(*only_, line) || is_not_json_;
}

Result<std::string_view> LineDecoder::checked(std::string_view line) const {
  return checksum_ && !has_row_checksums_ ? checksum_->checked(line) : Result(line);
}

bool LineDecoder::is_damaged(std::string_view line) const noexcept {
  return checksum_ && !has_row_checksums_ && checksum_->is_damaged(line);
}

std::optional<LineDecoder::Match> LineDecoder::match_of(const std::optional<LineMatch>& config, const char* key) {
  if (!config) return std::nullopt;
  Match match{*config};
  if (!config->pattern.empty()) match.pattern.emplace(config->pattern, key);
  for (const std::string& hex : config->is_hex) match.bytes.push_back(bytes_of_hex(hex).value_or(""));
  return match;
}

/// Also true if the search would take too long.
bool LineDecoder::matches(Match& match, std::string_view line) {
  const LineMatch& wanted = match.config;
  if (!match.bytes.empty()) {
    const std::string_view rest = line.substr(std::min(wanted.at, line.size()));
    return std::any_of(match.bytes.begin(), match.bytes.end(),
                       [&](const std::string& bytes) { return rest.starts_with(bytes); });
  }
  const auto text = text_in_question(wanted, line);
  return text && text->starts_with(wanted.begins) && text->find(wanted.contains) != std::string_view::npos &&
         (wanted.is.empty() || std::find(wanted.is.begin(), wanted.is.end(), *text) != wanted.is.end()) &&
         (!match.pattern || is_found(*match.pattern, *text));
}

bool LineDecoder::is_found(LinePattern& pattern, std::string_view text) noexcept {
  const LinePattern::Search search = pattern.search(text);
  is_too_long_ = is_too_long_ || search == LinePattern::Search::too_long;
  return search != LinePattern::Search::not_found;
}

/// Each named group belongs to a field.
void LineDecoder::use_pattern(const std::string& expression) {
  pattern_.emplace(expression, "pattern", has_bytes());
  groups_.resize(fields_.size());
  for (const LinePattern::Group& group : pattern_->groups()) {
    bool is_used = false;
    for (std::size_t i = 0; i < fields_.size(); ++i) {
      if (fields_[i].key != group.name) continue;
      groups_[i].push_back(group.number);
      is_used = true;
    }
    if (!is_used)
      throw SetupError(refused_lines("pattern",
                                     "`pattern` has a group \"" + group.name + "\", but `fields` has no such field",
                                     "add it to `fields`, or write (...) without a name"));
  }
  for (std::size_t i = 0; i < fields_.size(); ++i)
    if (groups_[i].empty() && !is_given(i))
      throw SetupError(refused_lines("field " + fields_[i].name, "`pattern` has no group of this name",
                                     "write (?<" + fields_[i].key + ">...) at the place of its value"));
}

/// Fields of a binary frame; of a pattern, those with a `wire`.
void LineDecoder::use_bytes(const LineConfig& config) {
  const bool is_binary = format_ == LineFormat::binary;
  const WireOrder order = config.frame ? config.frame->byte_order : WireOrder::big;
  for (std::size_t i = 0; i < fields_.size(); ++i) {
    const LineField& field = config.fields[i];
    std::optional<BinaryField>& binary = binary_.emplace_back();
    if (!is_binary && !field.wire) continue;
    const auto refuse = [&](const char* why, const char* advice) {
      throw SetupError(refused_lines(field.name.empty() ? "fields" : "field " + field.name, why, advice));
    };
    if (field.name.empty()) refuse("a binary field has no name", "set its `name`, or remove the field");
    if (field.base != 10 && (is_binary || field.base != 16))
      refuse("its bytes are not digits of another base", "remove `base`: only 16 in a `pattern` is possible");
    binary.emplace(field, leaves_[i], order);
    if (!is_binary) continue;
    if (!field.at) refuse("it has no place in the frame", "set `at`, the number of its first byte, from 0");
    if (field.optional && field.no_value.empty())
      refuse("its bytes always exist", "remove `optional`, or set `no_value` to the number that means no value");
    if (config.frame->length != 0 && binary->at() + binary->size() > config.frame->length)
      refuse("it ends beyond the frame", "check `at`, `type` and the frame's `length`");
  }
}

bool LineDecoder::has_bytes() const noexcept {
  return std::any_of(fields_.begin(), fields_.end(), [](const LineField& field) { return are_bytes(field); });
}

Result<void> LineDecoder::decode_binary(std::string_view frame) {
  for (std::size_t i = 0; i < fields_.size(); ++i) {
    const BinaryField& field = *binary_[i];
    if (field.at() + field.size() > frame.size())
      return failure(Errc::bad_data, i,
                     "the frame has " + std::to_string(frame.size()) + " bytes, but the field ends at " +
                         std::to_string(field.at() + field.size()));
    if (const char* const why = field.put(frame.substr(field.at(), field.size()), texts_[i], payload()))
      return failure(Errc::out_of_range, i, why);
  }
  return {};
}

Result<void> LineDecoder::decode(std::string_view line) {
  std::memset(payload_.data(), 0, payload_.size() * sizeof payload_[0]);
  if (std::exchange(is_too_long_, false))
    return Error{Errc::bad_data, bad_line_, shown_line(line), "the pattern of `only` takes too many steps",
                 "write it with fewer ways to match, such as [^,]* instead of .*"};
  says_none_ = unreadable_if_ && matches(*unreadable_if_, line);
  is_too_long_ = false;
  if (says_none_)
    return Error{Errc::bad_data, bad_line_, shown_line(line), "the device says that it has no value (`unreadable_if`)",
                 "check the device"};
  if (format_ == LineFormat::binary) return decode_binary(line);
  if (format_ == LineFormat::json) return decode_json(line);
  if (format_ == LineFormat::labels) return decode_labels(line);
  if (pattern_) return decode_pattern(line);
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
    return std::string(check_fields) + "; to skip a greeting or a heading, set `skip_lines` or `comment`";
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
  bool is_scaled = true;
  if (FieldText& of = texts_[index]; of.is_used()) {
    const FieldText::Found found = of.read(text);
    if (found.is_absent) return {};
    if (found.why != nullptr) return failure(Errc::bad_data, index, shown_line(text) + " " + found.why);
    is_scaled = found.is_scaled;
    text = found.text;
  }
  static const FieldScale by_one(1);
  if (auto done = put_value(index, *leaf, text, is_scaled ? scales_[index] : by_one); !done) return done;
  if (leaf->optional != nullptr) payload()[leaf->offset + leaf->optional->value_size] = std::byte{1};
  return {};
}

Result<void> LineDecoder::put_value(std::size_t index, const Leaf& leaf_of_it, std::string_view text,
                                    const FieldScale& scale) {
  const Leaf* leaf = &leaf_of_it;
  std::byte* to = payload() + leaf->offset;
  switch (leaf->kind) {
    case Kind::text: {
      const std::size_t capacity = leaf->size - text_length_bytes;
      if (text.size() > capacity) {
        return failure(Errc::does_not_fit, index,
                       shown_line(text) + " is longer than " + std::to_string(capacity) + " bytes");
      }
      to[0] = static_cast<std::byte>(text.size() & 0xff);
      to[1] = static_cast<std::byte>(text.size() >> 8);
      if (!text.empty()) std::memcpy(to + text_length_bytes, text.data(), text.size());
      return {};
    }
    case Kind::character: {
      const auto c = character_of(text);
      if (!c) return failure(Errc::bad_data, index, shown_line(text) + " is not one character");
      *to = static_cast<std::byte>(*c);
      return {};
    }
    case Kind::boolean: {
      bool flag = false;
      if (!read_boolean(text, flag)) {
        return failure(Errc::bad_data, index, shown_line(text) + " is not true, false, 1 or 0");
      }
      *to = static_cast<std::byte>(flag);
      return {};
    }
    default: {
      const std::errc status = parse_number(leaf->kind, text, to, scale);
      if (status == std::errc{}) return {};
      if (status == std::errc::result_out_of_range) {
        return failure(Errc::out_of_range, index,
                       shown_line(text) + " does not fit into " + std::string(name_of(leaf->kind)));
      }
      return failure(Errc::not_a_number, index, shown_line(text) + " is not " + type_with_article(leaf->kind));
    }
  }
}

Result<LineDecoder::Column> LineDecoder::next_column(std::size_t index, std::string_view& rest) {
  const auto first = rest.find_first_not_of(' ');
  const bool is_quoted = first != std::string_view::npos && rest[first] == '"';
  std::size_t end = is_quoted ? first + 1 : rest.find(separator_);
  if (is_quoted) {  // it may contain separators, and a quote in it is written twice
    cell_.clear();
    for (;; ++end) {
      const auto quote = rest.find('"', end);
      if (quote == std::string_view::npos) return failure(Errc::bad_data, index, "its quote is not closed");
      cell_.append(rest.substr(end, quote - end));
      end = quote + 1;
      if (end >= rest.size() || rest[end] != '"') break;
      cell_ += '"';
    }
    const std::size_t after = end;
    end = rest.find(separator_, after);
    if (const auto more = trimmed(rest.substr(after, end - after)); !more.empty())
      return failure(Errc::bad_data, index, shown_line(more) + " follows its quotes");
  }
  const std::string_view text = is_quoted ? std::string_view(cell_) : trimmed(rest.substr(0, end));
  go_behind(end, rest);
  return Column{text, is_quoted};
}

/// Goes to the next column, after the separator at `end`. npos: it was the last column.
void LineDecoder::go_behind(std::size_t end, std::string_view& rest) const noexcept {
  if (end == std::string_view::npos) {
    rest = {};
    return;
  }
  rest.remove_prefix(end + 1);
  if (separator_ == ' ') rest.remove_prefix(std::min(rest.find_first_not_of(' '), rest.size()));
}

/// Most columns are plain numbers, which are read in one pass. False: `next_column` must read it.
bool LineDecoder::take_number(const PlainNumber& plain, std::string_view& rest) noexcept {
  const char* const end = rest.data() + rest.size();
  double number = 0;
  const auto [behind, status] = std::from_chars(rest.data(), end, number);
  if (status != std::errc{} || (behind != end && *behind != separator_)) return false;
  number = plain.scale(number);
  std::memcpy(payload() + plain.offset, &number, sizeof number);
  if (behind != end && separator_ != ' ') {
    rest.remove_prefix(static_cast<std::size_t>(behind - rest.data()) + 1);
  } else {
    go_behind(behind == end ? std::string_view::npos : static_cast<std::size_t>(behind - rest.data()), rest);
  }
  return true;
}

/// Blanks within the quotes of a number are ignored.
std::string_view LineDecoder::text_of(std::size_t index, const Column& column) const noexcept {
  const Leaf* const leaf = leaves_[index];
  const bool is_text = leaf == nullptr || leaf->kind == Kind::text || leaf->kind == Kind::character;
  return column.is_quoted && !is_text ? trimmed(column.text) : column.text;
}

Result<void> LineDecoder::decode_csv(std::string_view line) {
  const auto count_error = [&](std::string_view what) {
    return Error{Errc::bad_data, bad_line_, shown_line(line),
                 "it has " + std::string(what) + " than the " + std::to_string(columns_) + " columns expected",
                 check_fields};
  };
  std::string_view rest = separator_ == ' ' ? trimmed(line) : line;
  for (std::size_t i = 0; i < fields_.size(); ++i) {
    if (is_given(i)) continue;
    const bool has_more = rest.data() != nullptr;
    if (!has_more) return count_error("fewer");
    if (plain_[i].is_one && take_number(plain_[i], rest)) continue;
    const Result<Column> column = next_column(i, rest);
    if (!column) return column.error();
    const bool is_absent = fields_[i].optional && column->text.empty() && !column->is_quoted;
    if (is_absent) continue;
    if (Result<void> done = put(i, text_of(i, *column)); !done) return done;
  }
  if (rest.data() != nullptr) return count_error("more");
  return {};
}

Result<void> LineDecoder::decode_pattern(std::string_view line) {
  switch (pattern_->search(line)) {
    case LinePattern::Search::found:
      break;
    case LinePattern::Search::not_found:
      return Error{Errc::bad_data, bad_line_, shown_line(line), "`pattern` does not match it",
                   "check `pattern`; to skip lines of another kind, set `only`"};
    case LinePattern::Search::too_long:
      return Error{Errc::bad_data, bad_line_, shown_line(line), "`pattern` takes too many steps",
                   "write `pattern` with fewer ways to match, such as [^,]* instead of .*"};
  }
  for (std::size_t i = 0; i < fields_.size(); ++i) {
    if (is_given(i)) continue;
    std::optional<std::string_view> text;
    for (std::size_t n = 0; n < groups_[i].size() && !text; ++n) text = pattern_->group(groups_[i][n]);
    if (std::string_view rest = text.value_or("");
        plain_[i].is_one && take_number(plain_[i], rest) && rest.data() == nullptr)
      continue;
    if (binary_[i] && text && !text->empty()) {
      if (auto done = put_group(i, *text); !done) return done;
      continue;
    }
    const std::string_view value = trimmed(text.value_or(""));
    if (value.empty() && fields_[i].optional) continue;
    if (!text) return failure(Errc::bad_data, i, "`pattern` matches " + shown_line(line) + ", but without this group");
    if (Result<void> done = put(i, value); !done) return done;
  }
  return {};
}

/// Bytes, or hexadecimal digits of bytes.
Result<void> LineDecoder::put_group(std::size_t index, std::string_view group) {
  std::optional<std::string> bytes;  // the few bytes of a number need no allocation
  if (fields_[index].base == 16) {
    bytes = bytes_of_hex(group);
    if (!bytes) return failure(Errc::bad_data, index, shown_line(group) + " is not bytes");
    group = *bytes;
  }
  if (!binary_[index]->takes(group.size()))
    return failure(Errc::bad_data, index, "its group has " + std::to_string(group.size()) + " bytes");
  if (const char* const why = binary_[index]->put(group, texts_[index], payload()))
    return failure(Errc::out_of_range, index, why);
  return {};
}

std::size_t LineDecoder::end_of_label(std::string_view row, std::string_view label) const noexcept {
  const std::size_t first = std::min(row.find_first_not_of(' '), row.size());
  // A label may hold the separator itself, as {chip="a",label="Sensor 1"} does.
  if (label.find(separator_) != std::string_view::npos) {
    if (!row.substr(first).starts_with(label)) return std::string_view::npos;
    const std::size_t end = first + label.size();
    const std::size_t mark = row.find(separator_, end);
    const bool is_next = mark != std::string_view::npos && trimmed(row.substr(end, mark - end)).empty();
    return is_next ? mark : std::string_view::npos;
  }
  const std::size_t mark = row.find(separator_, first);
  return mark != std::string_view::npos && trimmed(row.substr(0, mark)) == label ? mark : std::string_view::npos;
}

/// The rest of the first row with this label. Empty: there is no such row.
std::optional<std::string_view> LineDecoder::row_of(std::string_view rows, std::string_view label) const noexcept {
  while (!rows.empty()) {
    const std::size_t end = std::min(rows.find('\n'), rows.size());
    const std::string_view row = trimmed(rows.substr(0, end));
    rows.remove_prefix(std::min(end + 1, rows.size()));
    if (const std::size_t mark = end_of_label(row, label); mark != std::string_view::npos) return row.substr(mark + 1);
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
    bool is_checked = false;
    for (std::size_t i = 0; i < fields_.size(); ++i) {
      if (is_given(i)) continue;
      const std::size_t mark = end_of_label(row, fields_[i].key);
      if (mark == std::string_view::npos) continue;
      if (has_row_checksums_ && !std::exchange(is_checked, true)) {
        const Result<std::string_view> good = checksum_->checked(row);
        if (!good) return failure(Errc::bad_data, i, good.error().why);
        row = *good;
      }
      if (row.size() <= mark) return failure(Errc::bad_data, i, "its row contains only a checksum, no value");
      if (seen_[i]) return failure(Errc::bad_data, i, "it occurs twice");
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
      if (Result<void> done = put(i, text_of(i, *column)); !done) return done;
    }
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
    const auto row = row_of(line, match.key);
    return row ? std::optional(trimmed(row->substr(0, row->find(separator_)))) : std::nullopt;
  }
  if (!match.key.empty()) return find_in_json(match.key, line) ? std::optional<std::string_view>(found_) : std::nullopt;
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
  // A number that goes back has wrapped around if the step is small; otherwise the device has restarted.
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

}  // namespace rtdata::detail
