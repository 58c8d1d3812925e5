// InfluxDB's line protocol: measurement,tag=value field=value,field=value time.
#include <charconv>
#include <cmath>
#include <limits>

#include "data/character.hpp"
#include "data/influx_name.hpp"
#include "data/load.hpp"
#include "data/number_text.hpp"
#include "data/utf8.hpp"
#include "rtdata/data/codec.hpp"

namespace rtdata {
namespace {

constexpr const char* no_line = "the text is not a line of InfluxDB";
constexpr std::string_view sequence_key = "sequence";
constexpr std::string_view run_key = "run";

Error bad(std::string where, std::string why) {
  return {Errc::bad_data, no_line, std::move(where), std::move(why), ""};
}

/// Appends a measurement, a key or a tag value, with a backslash before separators.
void append_name(std::string& line, std::string_view text) {
  for (const char c : text) {
    if (c == ',' || c == ' ' || c == '=') line += '\\';
    line += c;
  }
}

/// The protocol allows no line break in a text: it is written as \x0a, like bytes that are not UTF-8.
constexpr std::string_view line_break = "\\x0a";

/// In quotes.
void append_text(std::string& line, std::string_view text) {
  std::string escaped;
  detail::append_escaped(escaped, text);
  line += '"';
  for (std::size_t i = 0; i < escaped.size(); ++i) {
    const char c = escaped[i];
    if (c == '\n') {
      line.append("\\").append(line_break);
      continue;
    }
    if (c == '"' || c == '\\') line += '\\';
    line += c;
    if (std::string_view(escaped).substr(i).starts_with(line_break)) line += "x5c";  // already escaped
  }
  line += '"';
}

/// Undoes `append_text`, without the quotes and the backslashes before them.
std::string text_of(std::string_view written) {
  std::string escaped;
  while (!written.empty()) {
    const bool is_break = written.starts_with(line_break);
    escaped += is_break ? '\n' : written.front();
    written.remove_prefix(is_break ? line_break.size() : 1);
  }
  return detail::unescaped(escaped);
}

template <class Number>
void append_number(std::string& line, Number number) {
  char digits[detail::longest_number];
  line.append(digits, detail::put_number(digits, number));
}

void append_integer(std::string& line, std::int64_t number) {
  append_number(line, number);
  line += 'i';
}

/// A number above int64 has another suffix, which not every receiver accepts.
void append_natural(std::string& line, std::uint64_t number) {
  append_number(line, number);
  line += number <= std::uint64_t{std::numeric_limits<std::int64_t>::max()} ? 'i' : 'u';
}

/// False: the protocol has no such value.
template <class T>
bool append_floating(std::string& line, const std::byte* from) {
  const T number = detail::load<T>(from);
  if (!std::isfinite(number)) return false;
  append_number(line, number);
  return true;
}

bool append_value(std::string& line, const Leaf& leaf, const std::byte* from) {
  switch (leaf.kind) {
    case Kind::f64:
      return append_floating<double>(line, from);
    case Kind::f32:
      return append_floating<float>(line, from);
    case Kind::boolean:
      line += *from != std::byte{0} ? "true" : "false";
      return true;
    case Kind::character:
      append_text(line, detail::utf8_of(static_cast<char>(from[0])));
      return true;
    case Kind::text:
      append_text(line, detail::text_at(leaf, from));
      return true;
    case Kind::u64:
      append_natural(line, detail::load<std::uint64_t>(from));
      return true;
    case Kind::enumeration: {
      const std::int64_t number = detail::load_integer(leaf.field->enum_base, from);
      for (const EnumValue& value : leaf.field->values) {
        if (value.value != number) continue;
        append_text(line, value.name);
        return true;
      }
      if (leaf.field->enum_base == Kind::u64) {
        append_natural(line, static_cast<std::uint64_t>(number));
      } else {
        append_integer(line, number);
      }
      return true;
    }
    case Kind::record:
      return false;
    default:
      append_integer(line, detail::load_integer(leaf.kind, from));
      return true;
  }
}

/// Parses a line from the left.
class Scanner {
 public:
  explicit Scanner(std::string_view line) : left_(line) {}

  /// Takes the text up to the first of `ends` without a backslash before it, and removes the backslashes.
  std::string name(std::string_view ends) {
    std::string name;
    while (!left_.empty() && ends.find(left_.front()) == std::string_view::npos) {
      if (left_.front() == '\\' && left_.size() > 1 &&
          std::string_view(", =\\").find(left_[1]) != std::string_view::npos)
        left_.remove_prefix(1);
      name += left_.front();
      left_.remove_prefix(1);
    }
    return name;
  }
  /// Takes a text in quotes. False: the quotes do not end.
  bool text(std::string& text) {
    left_.remove_prefix(1);
    for (; !left_.empty(); left_.remove_prefix(1)) {
      if (left_.front() == '"') {
        left_.remove_prefix(1);
        return true;
      }
      if (left_.front() == '\\' && left_.size() > 1 && (left_[1] == '"' || left_[1] == '\\')) left_.remove_prefix(1);
      text += left_.front();
    }
    return false;
  }
  bool take(char c) {
    if (left_.empty() || left_.front() != c) return false;
    left_.remove_prefix(1);
    return true;
  }
  char next() const { return left_.empty() ? '\0' : left_.front(); }
  std::string_view rest() const { return left_; }

 private:
  std::string_view left_;
};

Result<Value> value_of(const Leaf& leaf, Scanner& line) {
  if (line.next() == '"') {
    std::string text;
    if (!line.text(text)) return bad("field " + leaf.path, "a text does not end");
    text = text_of(text);
    if (leaf.kind == Kind::character)
      if (const auto c = detail::character_of(text)) return Value(*c);
    return Value(std::move(text));
  }
  std::string word = line.name(", ");
  const auto wrong = [&] { return bad("field " + leaf.path, "\"" + word.substr(0, 64) + "\" is not a value"); };
  if (leaf.kind == Kind::boolean) {
    if (bool flag = false; detail::read_boolean(word, flag) || word == "t" || word == "T" || word == "f" || word == "F")
      return Value(word.front() == 't' || word.front() == 'T');
    return wrong();
  }
  const char suffix = word.empty() ? '\0' : word.back();
  if (suffix == 'i' || suffix == 'u') {
    const std::string_view digits = std::string_view(word).substr(0, word.size() - 1);
    std::int64_t number = 0;
    std::uint64_t natural = 0;
    if (suffix == 'i' && detail::read_number(digits, number) == std::errc{}) return Value(number);
    if (suffix == 'u' && detail::read_number(digits, natural) == std::errc{}) return Value(natural);
    return wrong();
  }
  if (leaf.kind == Kind::f32) {  // not through a double: rounding twice may give a wrong float
    float number = 0;
    if (detail::read_number(word, number) == std::errc{} && std::isfinite(number))
      return Value(static_cast<double>(number));
    return wrong();
  }
  double number = 0;
  if (detail::read_number(word, number) == std::errc{} && std::isfinite(number)) return Value(number);
  return wrong();
}

bool is_floating(const Leaf& leaf) { return leaf.kind == Kind::f64 || leaf.kind == Kind::f32; }

class InfluxCodec final : public Codec {
 public:
  std::string_view name() const noexcept override { return "influx"; }
  bool is_text() const noexcept override { return true; }

  Result<void> encode(const EventView& event, std::vector<std::byte>& out) override {
    for (const std::string_view text : {event.topic(), event.origin()}) {
      if (detail::fits_influx_name(text)) continue;
      return Error{Errc::does_not_fit, "cannot write the event as a line of InfluxDB", detail::readable(text),
                   "the format cannot write this name", "use a name without line breaks and backslashes"};
    }
    line_.clear();
    append_name(line_, event.topic());
    if (!event.origin().empty()) append_name(line_ += ",origin=", event.origin());
    line_ += ' ';
    for (const Leaf& leaf : event.description().leaves()) {
      const std::byte* from = find_value(leaf, event.payload().data());
      if (from == nullptr) continue;
      const std::size_t before = line_.size();
      append_name(line_, leaf.path);
      line_ += '=';
      if (append_value(line_, leaf, from)) {
        line_ += ',';
      } else {
        line_.resize(before);
      }
    }
    line_.append(sequence_key) += '=';
    append_natural(line_, event.sequence());
    if (!event.run().empty()) append_text((line_ += ',').append(run_key) += '=', event.run());
    line_ += ' ';
    append_number(line_, to_nanoseconds(event.time()));
    line_ += '\n';
    const auto* from = reinterpret_cast<const std::byte*>(line_.data());
    out.insert(out.end(), from, from + line_.size());
    return {};
  }

  Result<DecodedEvent> decode(std::span<const std::byte> bytes, const Description& description) override {
    std::string_view text{reinterpret_cast<const char*>(bytes.data()), bytes.size()};
    if (text.ends_with('\n')) text.remove_suffix(1);
    if (text.ends_with('\r')) text.remove_suffix(1);
    Scanner line(text);
    DecodedEvent event;
    event.payload.resize(description.size());
    const auto& leaves = description.leaves();
    for (const Leaf& leaf : leaves) {  // values that the protocol cannot represent
      if (leaf.optional != nullptr)
        write(leaf, event.payload.data(), Value{}).or_throw();
      else if (is_floating(leaf))
        write(leaf, event.payload.data(), std::numeric_limits<double>::quiet_NaN()).or_throw();
    }
    event.topic = line.name(", ");
    while (line.take(',')) {
      const std::string key = line.name("=, ");
      if (!line.take('=')) return bad("tag " + key.substr(0, 64), "it has no value");
      std::string value = line.name(", ");
      if (key == "origin") event.origin = std::move(value);  // ignores tags of the receiver
    }
    if (!line.take(' ')) return bad("", "it has no fields");
    if (text.find('\n') != std::string_view::npos) return bad("", "something follows the end of the line");
    if (!detail::fits_influx_name(event.topic) || !detail::fits_influx_name(event.origin))
      return bad("", "a name has a line break");
    std::vector<bool> is_there(leaves.size(), false);
    do {
      const std::string key = line.name("=, ");
      if (!line.take('=')) return bad("field " + key.substr(0, 64), "it has no value");
      if (key == sequence_key) {
        std::string word = line.name(", ");
        std::uint64_t number = 0;
        if (word.empty() || (word.back() != 'i' && word.back() != 'u') ||
            detail::read_number(std::string_view(word).substr(0, word.size() - 1), number) != std::errc{})
          return bad("field sequence",
                     "\"" + word.substr(0, 64) + "\" must be a whole number, 0 or more, with `i` or `u` behind it");
        event.sequence = number;
        continue;
      }
      std::size_t at = 0;
      while (at < leaves.size() && leaves[at].path != key) ++at;
      if (at == leaves.size() && key == run_key && line.next() == '"') {
        if (!line.text(event.run)) return bad("field run", "a text does not end");
        event.run = text_of(event.run);
        continue;
      }
      if (at == leaves.size()) return bad("field " + key.substr(0, 64), "there is no such field");
      if (is_there[at]) return bad("field " + key, "it is there twice");
      is_there[at] = true;
      auto value = value_of(leaves[at], line);
      if (!value) return std::move(value).error();
      if (auto done = write(leaves[at], event.payload.data(), *value); !done) return std::move(done).error();
    } while (line.take(','));
    for (std::size_t i = 0; i < leaves.size(); ++i) {
      const Leaf& leaf = leaves[i];
      if (!is_there[i] && leaf.optional == nullptr && !is_floating(leaf))
        return bad("field " + leaf.path, "it is missing");
    }
    std::int64_t nanoseconds = 0;
    if (!line.take(' ') || detail::read_number(line.rest(), nanoseconds) != std::errc{})
      return bad("time", "it is not an integer of 64 bits");
    event.time = from_nanoseconds(nanoseconds);
    return event;
  }

 private:
  std::string line_;
};

}  // namespace

std::unique_ptr<Codec> make_influx_codec() { return std::make_unique<InfluxCodec>(); }

}  // namespace rtdata
