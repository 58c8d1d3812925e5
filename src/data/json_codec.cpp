#include <algorithm>
#include <cmath>

#include "data/character.hpp"
#include "data/copy.hpp"
#include "data/copy_padded.hpp"
#include "data/event_head.hpp"
#include "data/json_decode.hpp"
#include "data/load.hpp"
#include "data/number_text.hpp"
#include "data/per_description.hpp"
#include "data/utf8.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata {
namespace {

using detail::load;
using detail::load_integer;
using detail::put_number;

char* put(char* to, std::string_view text) { return detail::copy_short(to, text.data(), text.size()); }

/// True if the character needs no escape in a string.
bool is_plain(char c) {
  const auto code = static_cast<unsigned char>(c);
  return code >= 0x20 && code < 0x7f && c != '"' && c != '\\';
}

/// Escapes bytes that are not UTF-8 (utf8.hpp). Writes at most 6 bytes for each byte of the text, and two quotes.
char* put_string(char* to, std::string_view text) {
  *to++ = '"';
  for (;;) {
    const auto plain = static_cast<std::size_t>(std::find_if_not(text.begin(), text.end(), is_plain) - text.begin());
    to = put(to, text.substr(0, plain));
    text.remove_prefix(plain);
    if (text.empty()) break;
    const char c = text.front();
    constexpr char digits[] = "0123456789abcdef";
    const std::size_t size = detail::utf8_size(text);
    const bool is_escaped = c == '\0' || size == 0 || (c == '\\' && detail::escaped_byte(text) >= 0);
    if (is_escaped) {
      const auto byte = static_cast<unsigned char>(c);
      to = put(to, "\\\\x");
      *to++ = digits[byte >> 4];
      *to++ = digits[byte & 0xf];
      text.remove_prefix(1);
      continue;
    }
    if (size > 1) {
      to = put(to, text.substr(0, size));
      text.remove_prefix(size);
      continue;
    }
    text.remove_prefix(1);
    if (c == '"' || c == '\\') {
      *to++ = '\\';
      *to++ = c;
    } else if (c == '\n') {
      to = put(to, "\\n");
    } else if (c == '\r') {
      to = put(to, "\\r");
    } else if (c == '\t') {
      to = put(to, "\\t");
    } else {
      to = put(to, "\\u00");
      *to++ = digits[c >> 4];
      *to++ = digits[c & 0xf];
    }
  }
  *to++ = '"';
  return to;
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

/// The plan for payloads of one description: the fixed text before each leaf, and at the end.
struct JsonPlan {
  struct LeafStep {
    std::size_t prefix_size = 0;  ///< of the next bytes of `fixed`
    Kind kind = Kind::f64;
    Kind enum_base = Kind::i32;
    std::size_t offset = 0;
    std::size_t size = 0;
    const OptionalAccess* optional = nullptr;
    std::size_t first_name = 0;  ///< of an enumeration, in `names`
    std::size_t name_count = 0;
  };

  explicit JsonPlan(const Description& description) {
    fixed = '{';
    add(description.fields(), 0);
    fixed += "}}\n";
    end_size = fixed.size() - used_;
    fixed.append(detail::padding, '\0');
    longest += fixed.size();
  }

  std::vector<LeafStep> steps;
  std::string fixed;                                        ///< padded
  std::size_t end_size = 0;                                 ///< of what follows in it, behind the leaves
  std::vector<std::pair<std::int64_t, std::string>> names;  ///< quoted
  std::size_t longest = 0;                                  ///< bytes that all this may take

 private:
  void add(const std::vector<Field>& fields, std::size_t base) {
    bool first = true;
    for (const Field& field : fields) {
      // Names are letters, digits and underscores: nothing to escape.
      fixed += (first ? "\"" : ",\"") + field.name + "\":";
      first = false;
      if (field.is_array) fixed += '[';
      for (std::size_t i = 0; i < field.count; ++i) {
        const std::size_t offset = base + field.offset + i * field.stride;
        if (i > 0) fixed += ',';
        if (field.kind == Kind::record) {
          fixed += '{';
          add(field.fields, offset);
          fixed += '}';
        } else {
          add_leaf(field, offset);
        }
      }
      if (field.is_array) fixed += ']';
    }
  }

  void add_leaf(const Field& field, std::size_t offset) {
    LeafStep step{fixed.size() - used_, field.kind,     field.enum_base, offset,
                  field.size,           field.optional, names.size(),    0};
    used_ = fixed.size();
    std::size_t most = detail::longest_number;
    if (field.kind == Kind::text) most = 6 * (field.size - text_length_bytes) + 2;
    for (const EnumValue& value : field.values) {
      std::string quoted(6 * value.name.size() + 2, ' ');
      quoted.resize(static_cast<std::size_t>(put_string(quoted.data(), value.name) - quoted.data()));
      most = std::max(most, quoted.size());
      names.emplace_back(value.value, std::move(quoted));
      ++step.name_count;
    }
    longest += most;
    steps.push_back(step);
  }

  std::size_t used_ = 0;  ///< bytes of `fixed` that belong to a step
};

char* put_enum(char* to, const JsonPlan& plan, const JsonPlan::LeafStep& step, const std::byte* from) {
  const std::int64_t number = load_integer(step.enum_base, from);
  for (std::size_t i = 0; i < step.name_count; ++i) {
    const auto& [value, quoted] = plan.names[step.first_name + i];
    if (value == number) return put(to, quoted);
  }
  return step.enum_base == Kind::u64 ? put_number(to, static_cast<std::uint64_t>(number)) : put_number(to, number);
}

char* put_value(char* to, const JsonPlan& plan, const JsonPlan::LeafStep& step, const std::byte* from) {
  switch (step.kind) {
    case Kind::f64:
      return put_floating(to, load<double>(from));
    case Kind::f32:
      return put_floating(to, load<float>(from));
    case Kind::boolean:
      return put(to, *from != std::byte{0} ? "true" : "false");
    case Kind::character: {
      return put_string(to, detail::utf8_of(static_cast<char>(from[0])));
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

class JsonCodec final : public Codec {
 public:
  std::string_view name() const noexcept override { return "json"; }
  std::string_view extension() const noexcept override { return "jsonl"; }  // the whole file is not a JSON text
  bool is_text() const noexcept override { return true; }

  Result<void> encode(const EventView& event, std::vector<std::byte>& out) override {
    const JsonPlan& plan = plans_.of(event.description());
    const std::size_t longest = 128 + 6 * (event.topic().size() + event.origin().size() + event.run().size()) +
                                plan.longest;
    if (line_.size() < longest) line_.resize(longest);
    head_.set(event, [&] { make_head(event); });
    char* to = put(line_.data(), head_.before_time);
    to = put_number(to, to_nanoseconds(event.time()));
    to = put(to, head_.before_sequence);
    to = put_number(to, event.sequence());
    to = put(to, head_.before_data);
    const char* fixed = plan.fixed.data();
    const std::byte* payload = event.payload().data();
    for (const JsonPlan::LeafStep& step : plan.steps) {
      to = detail::copy_padded(to, fixed, step.prefix_size);
      fixed += step.prefix_size;
      const std::byte* from = payload + step.offset;
      if (step.optional != nullptr && !step.optional->has_value(from)) {
        to = put(to, "null");
      } else {
        to = put_value(to, plan, step, from);
      }
    }
    to = detail::copy_padded(to, fixed, plan.end_size);
    const auto* line = reinterpret_cast<const std::byte*>(line_.data());
    out.insert(out.end(), line, line + (to - line_.data()));
    return {};
  }

  Result<DecodedEvent> decode(std::span<const std::byte> bytes, const Description& description) override {
    return detail::decode_json(bytes, description);
  }

 private:
  void make_head(const EventView& event) {
    const auto make = [this](std::string& text, std::string_view before, std::string_view name,
                             std::string_view after) {
      char* to = put_string(put(line_.data(), before), name);
      to = put(to, after);
      text.assign(line_.data(), to);
    };
    make(head_.before_time, "{\"topic\":", event.topic(), ",\"time\":");
    make(head_.before_sequence, ",\"origin\":", event.origin(), ",\"sequence\":");
    if (event.run().empty()) {
      head_.before_data = ",\"data\":";
    } else {
      make(head_.before_data, ",\"run\":", event.run(), ",\"data\":");
    }
  }

  detail::PerDescription<JsonPlan> plans_;
  std::vector<char> line_;
  detail::EventHead head_;
};

}  // namespace

std::unique_ptr<Codec> make_json_codec() { return std::make_unique<JsonCodec>(); }

}  // namespace rtdata
