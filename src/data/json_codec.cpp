#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <unordered_map>

#include "data/nearest.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata {
namespace {

// ---- writing ----

char* put(char* to, std::string_view text) {
  std::memcpy(to, text.data(), text.size());
  return to + text.size();
}

/// Bytes of the UTF-8 character at the start of `text`, 0 when it is none.
std::size_t utf8_size(std::string_view text) {
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
  const auto follows = [&](std::size_t count) {
    if (text.size() <= count) return false;
    for (std::size_t i = 1; i <= count; ++i) {
      if ((byte(i) & 0xc0) != 0x80) return false;
    }
    return true;
  };
  const unsigned char first = byte(0);
  if (first < 0x80) return 1;
  if (first >= 0xc2 && first <= 0xdf) return follows(1) ? 2 : 0;
  if (first >= 0xe0 && first <= 0xef) {  // no longer than needed, no surrogates
    return follows(2) && !(first == 0xe0 && byte(1) < 0xa0) && !(first == 0xed && byte(1) > 0x9f) ? 3 : 0;
  }
  if (first >= 0xf0 && first <= 0xf4) {  // up to U+10FFFF
    return follows(3) && !(first == 0xf0 && byte(1) < 0x90) && !(first == 0xf4 && byte(1) > 0x8f) ? 4 : 0;
  }
  return 0;
}

/// Writes at most 6 bytes for each of the text's, and two quotes.
char* put_string(char* to, std::string_view text) {
  *to++ = '"';
  while (!text.empty()) {
    const char c = text.front();
    if (static_cast<unsigned char>(c) >= 0x80) {
      const std::size_t size = utf8_size(text);
      to = put(to, size == 0 ? std::string_view("\xef\xbf\xbd") : text.substr(0, size));
      text.remove_prefix(size == 0 ? 1 : size);
      continue;
    }
    text.remove_prefix(1);
    if (c == '"' || c == '\\') {
      *to++ = '\\';
      *to++ = c;
    } else if (static_cast<unsigned char>(c) >= 0x20 && c != 0x7f) {
      *to++ = c;
    } else if (c == '\n') {
      to = put(to, "\\n");
    } else if (c == '\r') {
      to = put(to, "\\r");
    } else if (c == '\t') {
      to = put(to, "\\t");
    } else {
      constexpr char digits[] = "0123456789abcdef";
      to = put(to, "\\u00");
      *to++ = digits[c >> 4];
      *to++ = digits[c & 0xf];
    }
  }
  *to++ = '"';
  return to;
}

template <class T>
T load(const std::byte* from) {
  T value;
  std::memcpy(&value, from, sizeof value);
  return value;
}

constexpr std::size_t longest_number = 32;

template <class T>
char* put_number(char* to, T number) {
  return std::to_chars(to, to + longest_number, number).ptr;
}

template <class T>
char* put_floating(char* to, T number) {
  if (!std::isfinite(number)) {
    return put(to, std::isnan(number) ? "\"NaN\"" : number > 0 ? "\"Infinity\"" : "\"-Infinity\"");
  }
  // As an integer, -0 would lose its sign.
  if (number == 0) return put(to, std::signbit(number) ? "-0.0" : "0");
  return put_number(to, number);
}

std::int64_t load_integer(Kind kind, const std::byte* from) {
  switch (kind) {
    case Kind::i8:
      return load<std::int8_t>(from);
    case Kind::i16:
      return load<std::int16_t>(from);
    case Kind::i32:
      return load<std::int32_t>(from);
    case Kind::u8:
      return load<std::uint8_t>(from);
    case Kind::u16:
      return load<std::uint16_t>(from);
    case Kind::u32:
      return load<std::uint32_t>(from);
    default:
      return load<std::int64_t>(from);
  }
}

/// What to write for the payloads of one description: before each leaf a text that never changes, and one at the end.
struct Plan {
  struct Step {
    std::size_t prefix_size = 0;  ///< of the next bytes of `fixed`
    Kind kind = Kind::f64;
    Kind enum_base = Kind::i32;
    std::size_t offset = 0;
    std::size_t size = 0;
    const OptionalAccess* optional = nullptr;
    std::size_t first_name = 0;  ///< of an enumeration, in `names`
    std::size_t name_count = 0;
  };
  std::vector<Step> steps;
  std::string fixed;
  std::size_t suffix_size = 0;
  std::vector<std::pair<std::int64_t, std::string>> names;  ///< quoted
  std::size_t longest = 0;                                  ///< bytes that all this may take
};

class Planner {
 public:
  explicit Planner(const Description& description) {
    pending_ = '{';
    add(description.fields(), 0);
    pending_ += "}}\n";
    plan_.fixed += pending_;
    plan_.suffix_size = pending_.size();
    plan_.longest += plan_.fixed.size();
  }
  Plan take() { return std::move(plan_); }

 private:
  void add(const std::vector<Field>& fields, std::size_t base) {
    bool first = true;
    for (const Field& field : fields) {
      // Names are letters, digits and underscores: nothing to escape.
      pending_ += (first ? "\"" : ",\"") + field.name + "\":";
      first = false;
      if (field.is_array) pending_ += '[';
      for (std::size_t i = 0; i < field.count; ++i) {
        if (i != 0) pending_ += ',';
        const std::size_t offset = base + field.offset + i * field.stride;
        if (field.kind == Kind::record) {
          pending_ += '{';
          add(field.fields, offset);
          pending_ += '}';
        } else {
          leaf(field, offset);
        }
      }
      if (field.is_array) pending_ += ']';
    }
  }

  void leaf(const Field& field, std::size_t offset) {
    Plan::Step step{pending_.size(), field.kind,     field.enum_base,    offset,
                    field.size,      field.optional, plan_.names.size(), 0};
    plan_.fixed += pending_;
    pending_.clear();
    std::size_t longest = longest_number;
    if (field.kind == Kind::text) longest = 6 * (field.size - text_length_bytes) + 2;
    for (const EnumValue& value : field.values) {
      std::string quoted(6 * value.name.size() + 2, ' ');
      quoted.resize(static_cast<std::size_t>(put_string(quoted.data(), value.name) - quoted.data()));
      longest = std::max(longest, quoted.size());
      plan_.names.emplace_back(value.value, std::move(quoted));
      ++step.name_count;
    }
    plan_.longest += longest;
    plan_.steps.push_back(step);
  }

  Plan plan_;
  std::string pending_;
};

char* put_enum(char* to, const Plan& plan, const Plan::Step& step, const std::byte* from) {
  const std::int64_t number = load_integer(step.enum_base, from);
  for (std::size_t i = 0; i < step.name_count; ++i) {
    const auto& [value, quoted] = plan.names[step.first_name + i];
    if (value == number) return put(to, quoted);
  }
  return step.enum_base == Kind::u64 ? put_number(to, static_cast<std::uint64_t>(number)) : put_number(to, number);
}

char* put_value(char* to, const Plan& plan, const Plan::Step& step, const std::byte* from) {
  switch (step.kind) {
    case Kind::f64:
      return put_floating(to, load<double>(from));
    case Kind::f32:
      return put_floating(to, load<float>(from));
    case Kind::boolean:
      return put(to, *from != std::byte{0} ? "true" : "false");
    case Kind::character: {
      const auto c = load<unsigned char>(from);
      const char latin[2] = {static_cast<char>(0xc0 | c >> 6), static_cast<char>(0x80 | (c & 0x3f))};
      const char ascii = static_cast<char>(c);
      return put_string(to, c < 0x80 ? std::string_view(&ascii, 1) : std::string_view(latin, 2));
    }
    case Kind::text: {
      const auto length = static_cast<std::size_t>(from[0]) | static_cast<std::size_t>(from[1]) << 8;
      return put_string(to, {reinterpret_cast<const char*>(from) + text_length_bytes,
                             std::min(length, step.size - text_length_bytes)});
    }
    case Kind::enumeration:
      return put_enum(to, plan, step, from);
    case Kind::u64:
      return put_number(to, load<std::uint64_t>(from));
    case Kind::record:
      return to;
    default:
      return put_number(to, load_integer(step.kind, from));
  }
}

// ---- reading ----

/// What the parser found; numbers as exact as they were written.
struct Node {
  enum class Type { null, boolean, integer, natural, fraction, string, object, array };
  Type type = Type::null;
  bool flag = false;
  std::int64_t integer = 0;
  std::uint64_t natural = 0;
  double fraction = 0;
  std::string text;  ///< of a string, or the digits of a fraction
  std::vector<std::string> keys;
  std::vector<Node> children;
};

/// Builds nodes from nlohmann's events.
class Builder {
 public:
  static constexpr std::size_t deepest = 48;

  Node root;
  std::string error;

  bool null() { return add({}) != nullptr; }
  bool boolean(bool flag) {
    Node* node = add(Node::Type::boolean);
    node->flag = flag;
    return true;
  }
  bool number_integer(std::int64_t number) {
    add(Node::Type::integer)->integer = number;
    return true;
  }
  bool number_unsigned(std::uint64_t number) {
    add(Node::Type::natural)->natural = number;
    return true;
  }
  bool number_float(double number, const std::string& digits) {
    Node* node = add(Node::Type::fraction);
    node->fraction = number;
    node->text = digits;
    return true;
  }
  bool string(std::string& text) {
    add(Node::Type::string)->text = std::move(text);
    return true;
  }
  bool binary(nlohmann::json::binary_t&) { return false; }
  bool start_object(std::size_t) { return open(Node::Type::object); }
  bool start_array(std::size_t) { return open(Node::Type::array); }
  bool key(std::string& key) {
    open_.back()->keys.push_back(std::move(key));
    return true;
  }
  bool end_object() { return close(); }
  bool end_array() { return close(); }
  bool parse_error(std::size_t position, const std::string&, const nlohmann::json::exception& exception) {
    error = "at byte " + std::to_string(position) + ", ";
    // "[json.exception.parse_error.101] parse error at line 1, column 2: syntax error ..."
    const std::string_view what = exception.what();
    const auto colon = what.find(": ");
    error += what.substr(colon == std::string_view::npos ? 0 : colon + 2);
    return false;
  }

 private:
  Node* add(Node::Type type) {
    if (open_.empty()) {
      root.type = type;
      return &root;
    }
    // Only the innermost open node grows, so the pointers to the others stay good.
    Node& made = open_.back()->children.emplace_back();
    made.type = type;
    return &made;
  }
  bool open(Node::Type type) {
    if (open_.size() >= deepest) {
      error = "it is nested more than " + std::to_string(deepest) + " deep";
      return false;
    }
    open_.push_back(add(type));
    return true;
  }
  bool close() {
    open_.pop_back();
    return true;
  }

  std::vector<Node*> open_;
};

Error bad(std::string where, std::string why, std::string advice = {}) {
  return {Errc::bad_data, "the text is no event in JSON", std::move(where), std::move(why), std::move(advice)};
}

/// The one character of a string, as a code point up to 0xff.
bool to_char(std::string_view text, char& c) {
  if (text.size() == 1) {
    c = text[0];
    return true;
  }
  if (text.size() != 2 || (static_cast<unsigned char>(text[0]) & 0xfc) != 0xc0) return false;
  c = static_cast<char>((text[0] & 0x03) << 6 | (text[1] & 0x3f));
  return true;
}

class Reader {
 public:
  Reader(const Description& description, std::byte* payload) : leaves_(description.leaves()), payload_(payload) {}

  Result<void> record(const std::vector<Field>& fields, const Node& node, const std::string& path) {
    std::vector<std::string_view> names;
    names.reserve(fields.size());
    for (const Field& field : fields) names.push_back(field.name);
    auto found = find(node, names, names.size(), path);
    if (!found) return std::move(found).error();
    for (std::size_t i = 0; i < fields.size(); ++i) {
      if (auto done = field(fields[i], *(*found)[i], path + fields[i].name); !done) return done;
    }
    return {};
  }

  /// The children with these names, in this order; those from `needed` on may be missing (null). Errors: not an object,
  /// an unknown key, one twice, one missing.
  static Result<std::vector<const Node*>> find(const Node& node, const std::vector<std::string_view>& names,
                                               std::size_t needed, const std::string& path) {
    const std::string where = path.empty() ? "" : "field " + path.substr(0, path.size() - 1);
    if (node.type != Node::Type::object) return bad(where, "it is no object");
    std::vector<const Node*> found(names.size(), nullptr);
    for (std::size_t i = 0; i < node.keys.size(); ++i) {
      const std::string& key = node.keys[i];
      // Mostly the keys come in order. This ends after names.size() + 1 keys at the latest: the next is unknown or
      // twice.
      std::size_t at = i;
      if (at >= names.size() || names[at] != key) {
        at = static_cast<std::size_t>(std::find(names.begin(), names.end(), key) - names.begin());
      }
      if (at == names.size()) return bad(where, "unknown key " + key.substr(0, 64), detail::suggestion(key, names));
      if (found[at] != nullptr) return bad(where, "the key " + key + " is there twice");
      found[at] = &node.children[i];
    }
    for (std::size_t i = 0; i < needed; ++i) {
      if (found[i] == nullptr) return bad(where, "the key " + std::string(names[i]) + " is missing");
    }
    return found;
  }

 private:
  Result<void> field(const Field& field, const Node& node, const std::string& path) {
    if (!field.is_array) return element(field, node, path);
    if (node.type != Node::Type::array || node.children.size() != field.count) {
      return bad("field " + path, "it is no list of " + std::to_string(field.count));
    }
    for (std::size_t i = 0; i < field.count; ++i) {
      if (auto done = element(field, node.children[i], path + "[" + std::to_string(i) + "]"); !done) return done;
    }
    return {};
  }

  Result<void> element(const Field& field, const Node& node, const std::string& path) {
    if (field.kind == Kind::record) return record(field.fields, node, path + ".");
    // The leaves come in the order of the fields.
    const Leaf& leaf = leaves_[next_leaf_++];
    if (node.type == Node::Type::object || node.type == Node::Type::array) {
      return bad("field " + path, "a list or an object is not what a " + std::string(name_of(leaf.kind)) + " takes");
    }
    return write(leaf, payload_, value(leaf, node));
  }

  /// What to write there; of a node that is no list and no object.
  static Value value(const Leaf& leaf, const Node& node) {
    const bool floating = leaf.kind == Kind::f32 || leaf.kind == Kind::f64;
    switch (node.type) {
      case Node::Type::boolean:
        return node.flag;
      case Node::Type::integer:
        if (floating) return nearest(leaf.kind, node.integer);
        return node.integer;
      case Node::Type::natural:
        if (floating) return nearest(leaf.kind, node.natural);
        return node.natural;
      case Node::Type::fraction:
        if (leaf.kind == Kind::f32) {
          // Not by way of the double: rounding twice may give the neighbour.
          float number = 0;
          const char* end = node.text.data() + node.text.size();
          if (const auto r = std::from_chars(node.text.data(), end, number); r.ec == std::errc{} && r.ptr == end) {
            return static_cast<double>(number);
          }
        }
        return node.fraction;
      case Node::Type::string:
        if (floating) {
          constexpr double infinity = std::numeric_limits<double>::infinity();
          if (node.text == "NaN") return std::numeric_limits<double>::quiet_NaN();
          if (node.text == "Infinity") return infinity;
          if (node.text == "-Infinity") return -infinity;
        }
        if (leaf.kind == Kind::character) {
          if (char c = 0; to_char(node.text, c)) return c;
        }
        return node.text;
      default:
        return std::monostate{};
    }
  }

  /// Decimal text means the nearest number that the field can hold.
  template <class T>
  static double nearest(Kind kind, T number) {
    return kind == Kind::f32 ? static_cast<double>(static_cast<float>(number)) : static_cast<double>(number);
  }

  const std::vector<Leaf>& leaves_;
  std::byte* payload_;
  std::size_t next_leaf_ = 0;
};

class JsonCodec final : public Codec {
 public:
  std::string_view name() const noexcept override { return "json"; }

  Result<void> encode(const EventView& event, std::vector<std::byte>& out) override {
    const Plan& plan = plan_of(event.description());
    const std::size_t longest = 128 + 6 * (event.topic().size() + event.origin().size()) + plan.longest;
    if (line_.size() < longest) line_.resize(longest);
    char* to = put(line_.data(), "{\"topic\":");
    to = put_string(to, event.topic());
    to = put(to, ",\"time\":");
    to = put_number(to, to_nanoseconds(event.time()));
    to = put(to, ",\"origin\":");
    to = put_string(to, event.origin());
    to = put(to, ",\"sequence\":");
    to = put_number(to, event.sequence());
    to = put(to, ",\"data\":");
    const char* fixed = plan.fixed.data();
    const std::byte* payload = event.payload().data();
    for (const Plan::Step& step : plan.steps) {
      to = put(to, {fixed, step.prefix_size});
      fixed += step.prefix_size;
      const std::byte* from = payload + step.offset;
      if (step.optional != nullptr && !step.optional->has_value(from)) {
        to = put(to, "null");
      } else {
        to = put_value(to, plan, step, from);
      }
    }
    to = put(to, {fixed, plan.suffix_size});
    const auto* line = reinterpret_cast<const std::byte*>(line_.data());
    out.insert(out.end(), line, line + (to - line_.data()));
    return {};
  }

  Result<DecodedEvent> decode(std::span<const std::byte> bytes, const Description& description) override {
    Builder builder;
    const char* text = reinterpret_cast<const char*>(bytes.data());
    if (!nlohmann::json::sax_parse(text, text + bytes.size(), &builder)) return bad("", builder.error);
    auto found = Reader::find(builder.root, {"topic", "time", "origin", "data", "sequence"}, 4, "");
    if (!found) return std::move(found).error();
    const auto& [topic, time, origin, data, sequence] =
        std::array{(*found)[0], (*found)[1], (*found)[2], (*found)[3], (*found)[4]};
    DecodedEvent event;
    if (topic->type != Node::Type::string) return bad("topic", "it is no string");
    if (origin->type != Node::Type::string) return bad("origin", "it is no string");
    event.topic = topic->text;
    event.origin = origin->text;
    if (time->type == Node::Type::integer) {
      event.time = from_nanoseconds(time->integer);
    } else if (time->type == Node::Type::natural &&
               time->natural <= std::uint64_t{std::numeric_limits<std::int64_t>::max()}) {
      event.time = from_nanoseconds(static_cast<std::int64_t>(time->natural));
    } else {
      return bad("time", "it is no integer of 64 bits", "write ns since 1970-01-01");
    }
    if (sequence != nullptr) {
      if (sequence->type != Node::Type::natural) return bad("sequence", "it is no number from 0 on");
      event.sequence = sequence->natural;
    }
    event.payload.resize(description.size());
    Reader reader(description, event.payload.data());
    if (auto done = reader.record(description.fields(), *data, ""); !done) return std::move(done).error();
    return event;
  }

 private:
  const Plan& plan_of(const Description& description) {
    if (last_serial_ == description.serial()) return *last_;
    if (plans_.size() >= 256) plans_.clear();  // somebody makes descriptions as they go
    const auto [found, added] = plans_.try_emplace(description.serial());
    if (added) found->second = Planner(description).take();
    last_serial_ = description.serial();
    last_ = &found->second;
    return *last_;
  }

  std::unordered_map<std::uint64_t, Plan> plans_;
  std::uint64_t last_serial_ = 0;  // serials start at 1
  const Plan* last_ = nullptr;
  std::vector<char> line_;
};

}  // namespace

std::unique_ptr<Codec> make_json_codec() { return std::make_unique<JsonCodec>(); }

}  // namespace rtdata
