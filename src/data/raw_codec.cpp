#include <algorithm>
#include <bit>

#include "data/copy.hpp"
#include "data/per_description.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata {
namespace {

constexpr std::size_t longest_value = 255;

/// Between memory and little-endian.
void copy_number(std::byte* to, const std::byte* from, std::size_t size) {
  if constexpr (std::endian::native == std::endian::little) {
    std::memcpy(to, from, size);
  } else {
    std::reverse_copy(from, from + size, to);
  }
}

std::size_t text_size(const std::byte* text, std::size_t field_size) {
  const auto length = static_cast<std::size_t>(text[0]) | static_cast<std::size_t>(text[1]) << 8;
  return std::min(length, field_size - text_length_bytes);
}

Error does_not_fit(const std::string& where, std::string why) {
  return {Errc::does_not_fit, "the value cannot be sent as raw bytes", where, std::move(why),
          "use another format, such as json"};
}

/// An error of a nested record's field, with the path to it.
Error within(const Field& record, std::size_t element, Error error) {
  constexpr std::string_view start = "field ";
  std::string path = record.name;
  if (record.is_array) path += "[" + std::to_string(element) + "]";
  error.where.insert(start.size(), path + ".");
  return error;
}

Error too_long(const std::string& where, std::size_t size) {
  return does_not_fit(where, "it has " + std::to_string(size) + " bytes, but a value has at most 255");
}

/// The plan for encoding a payload: its values in order.
struct RawPlan {
  /// Numbers by size in bytes, which always fit, and other values.
  enum class Sort : std::uint8_t { field = 0, numbers_1 = 1, numbers_2 = 2, numbers_4 = 4, numbers_8 = 8 };
  struct LeafStep {
    Sort sort = Sort::field;
    std::size_t offset = 0;        ///< bytes from the start of the payload
    std::size_t count = 1;         ///< of numbers: how many lie one after the other
    const Field* field = nullptr;  ///< of another sort; owned by the description
    std::string where;             ///< of this field, for errors
  };

  explicit RawPlan(const Description& description) { add(description.fields(), 0, "field "); }

  std::vector<LeafStep> steps;
  std::size_t longest = 0;  ///< bytes that all this may take
  bool is_fixed = true;     ///< there are only numbers: it always takes as many bytes

 private:
  void add(const std::vector<Field>& fields, std::size_t base, const std::string& prefix) {
    for (const Field& field : fields) {
      const std::size_t offset = base + field.offset;
      if (field.kind == Kind::record) {
        for (std::size_t i = 0; i < field.count && !field.fields.empty(); ++i) {
          const std::string element = field.is_array ? "[" + std::to_string(i) + "]" : "";
          add(field.fields, offset + i * field.stride, prefix + field.name + element + ".");
        }
      } else if (field.is_array || field.optional != nullptr || field.kind == Kind::text ||
                 field.kind == Kind::boolean) {
        steps.push_back({Sort::field, offset, 1, &field, prefix + field.name});
        is_fixed = false;
        longest += 1 + std::min(longest_value, field.count * field.size);
      } else {
        add_number(offset, field.size);
        longest += 1 + field.size;
      }
    }
  }

  void add_number(std::size_t offset, std::size_t size) {
    const auto sort = static_cast<Sort>(size);
    if (!steps.empty() && steps.back().sort == sort && steps.back().offset + steps.back().count * size == offset) {
      ++steps.back().count;
    } else {
      steps.push_back({sort, offset, 1, nullptr, {}});
    }
  }
};

std::byte* put_text(std::byte* to, std::string_view content) {
  *to = static_cast<std::byte>(content.size());
  return detail::copy_short(to + 1, content.data(), content.size());
}

template <std::size_t size>
std::byte* put_number(std::byte* to, const void* number) {
  *to = std::byte{size};
  copy_number(to + 1, static_cast<const std::byte*>(number), size);
  return to + 1 + size;
}

/// `count` numbers that lie one after the other.
template <std::size_t size>
std::byte* put_numbers(std::byte* to, const std::byte* from, std::size_t count) {
  for (const std::byte* const end = from + count * size; from != end; from += size) to = put_number<size>(to, from);
  return to;
}

/// Writes a value of any sort. Returns null, with the reason, if it cannot be sent.
std::byte* put_field(std::byte* to, const RawPlan::LeafStep& step, const std::byte* at, Error& why) {
  const Field& field = *step.field;
  std::byte* const begin = ++to;  // after the size, which is written last
  for (std::size_t i = 0; i < field.count; ++i, at += field.stride) {
    if (field.optional != nullptr && !field.optional->has_value(at)) {
      why = does_not_fit(step.where, "the value is absent, and raw bytes cannot say that");
      return nullptr;
    }
    const bool is_text = field.kind == Kind::text;
    const std::size_t size = is_text ? text_size(at, field.size) : field.size;
    const std::size_t size_so_far = static_cast<std::size_t>(to - begin) + size + (is_text && field.is_array ? 1 : 0);
    if (size_so_far > longest_value) {
      why = too_long(step.where, is_text ? size_so_far : field.count * field.size);
      return nullptr;
    }
    if (is_text) {
      if (field.is_array) *to++ = static_cast<std::byte>(size);
      if (size != 0) std::memcpy(to, at + text_length_bytes, size);
    } else if (field.kind == Kind::boolean) {
      *to = *at == std::byte{0} ? std::byte{0} : std::byte{1};
    } else {
      copy_number(to, at, size);
    }
    to += size;
  }
  begin[-1] = static_cast<std::byte>(to - begin);
  return to;
}

/// `count` numbers over others of their size.
template <std::size_t size>
std::byte* replace_numbers(std::byte* to, const std::byte* from, std::size_t count) {
#pragma GCC unroll 8
  for (; count > 0; --count, to += 1 + size, from += size) copy_number(to + 1, from, size);
  return to;
}

/// The bytes of the last event with only numbers: the next one of the same topic, origin and description only needs new
/// numbers.
class LastEvent {
 public:
  bool is_like(const EventView& event) const noexcept {
    return serial_ == event.description().serial() && detail::equal_short(topic_, event.topic()) &&
           detail::equal_short(origin_, event.origin());
  }

  void append_with_numbers_of(const EventView& event, std::vector<std::byte>& out) const {
    const std::size_t begin = out.size();
    out.insert(out.end(), bytes_.begin(), bytes_.end());
    std::byte* const bytes = out.data() + begin;
    const std::int64_t time = to_nanoseconds(event.time());
    replace_numbers<sizeof time>(bytes + time_at_, reinterpret_cast<const std::byte*>(&time), 1);
    std::byte* to = bytes + behind_origin_;
    if (has_sequence_) {
      const std::uint64_t sequence = event.sequence();
      to = replace_numbers<sizeof sequence>(to, reinterpret_cast<const std::byte*>(&sequence), 1);
    }
    for (const RawPlan::LeafStep& step : plan_->steps) {
      const std::byte* const from = event.payload().data() + step.offset;
      switch (step.sort) {
        case RawPlan::Sort::numbers_8:
          to = replace_numbers<8>(to, from, step.count);
          break;
        case RawPlan::Sort::numbers_4:
          to = replace_numbers<4>(to, from, step.count);
          break;
        case RawPlan::Sort::numbers_2:
          to = replace_numbers<2>(to, from, step.count);
          break;
        case RawPlan::Sort::numbers_1:
          to = replace_numbers<1>(to, from, step.count);
          break;
        case RawPlan::Sort::field:
          break;  // there is none
      }
    }
  }

  /// `plan`: of its description, fixed; lives until the next call or until `forget`.
  void keep(const EventView& event, const RawPlan& plan, RawConfig::Sequence sequence,
            std::span<const std::byte> bytes) {
    plan_ = &plan;
    topic_ = event.topic();
    origin_ = event.origin();
    bytes_.assign(bytes.begin(), bytes.end());
    time_at_ = 4 + 1 + topic_.size();
    behind_origin_ = time_at_ + 9 + 1 + origin_.size();
    has_sequence_ = sequence == RawConfig::Sequence::include;
    serial_ = event.description().serial();
  }
  /// Until the next `keep`, no event is like the last.
  void forget() noexcept { serial_ = 0; }

 private:
  const RawPlan* plan_ = nullptr;
  std::uint64_t serial_ = 0;  // serials start at 1
  std::string topic_;
  std::string origin_;
  std::vector<std::byte> bytes_;
  std::size_t time_at_ = 0;
  std::size_t behind_origin_ = 0;
  bool has_sequence_ = false;
};

class Decoder {
 public:
  explicit Decoder(std::span<const std::byte> bytes) : rest_(bytes) {}

  static Error bad(std::string where, std::string why) {
    return {Errc::bad_data, "the bytes are not an event in raw format", std::move(where), std::move(why), ""};
  }

  Result<std::span<const std::byte>> next(const std::string& where) {
    if (rest_.empty()) return bad(where, "the bytes end before this field");
    const auto size = static_cast<std::size_t>(rest_[0]);
    if (size > rest_.size() - 1) return bad(where, "the bytes end within this field");
    const auto value = rest_.subspan(1, size);
    rest_ = rest_.subspan(1 + size);
    return value;
  }

  Result<std::string> text(const std::string& where) {
    auto value = next(where);
    if (!value) return std::move(value).error();
    return std::string(reinterpret_cast<const char*>(value->data()), value->size());
  }

  template <class T>
  Result<T> number(const std::string& where) {
    auto value = next(where);
    if (!value) return std::move(value).error();
    if (value->size() != sizeof(T)) return wrong_size(where, value->size(), sizeof(T));
    std::byte memory[sizeof(T)];
    copy_number(memory, value->data(), sizeof(T));
    T number;
    std::memcpy(&number, memory, sizeof number);
    return number;
  }

  Result<void> fields(const std::vector<Field>& fields, std::byte* record) {
    for (const Field& field : fields) {
      std::byte* at = record + field.offset;
      if (field.kind == Kind::record) {
        for (std::size_t i = 0; i < field.count; ++i) {
          auto done = this->fields(field.fields, at + i * field.stride);
          if (!done) return within(field, i, std::move(done).error());
        }
        continue;
      }
      const std::string where = "field " + field.name;
      auto value = next(where);
      if (!value) return std::move(value).error();
      auto rest = *value;
      if (field.kind != Kind::text && rest.size() != field.size * field.count) {
        return wrong_size(where, rest.size(), field.size * field.count);
      }
      for (std::size_t i = 0; i < field.count; ++i, at += field.stride) {
        std::byte* to = field.optional != nullptr ? field.optional->set(at, true) : at;
        std::size_t size = field.size;
        if (field.kind == Kind::text) {
          size = rest.size();
          if (field.is_array) {
            if (rest.empty()) return bad(where, "the bytes of its text " + std::to_string(i) + " are missing");
            size = static_cast<std::size_t>(rest[0]);
            rest = rest.subspan(1);
            if (size > rest.size()) return bad(where, "its text " + std::to_string(i) + " is cut");
          }
          if (size > field.size - text_length_bytes) {
            return bad(where, "a text of " + std::to_string(size) + " bytes, " +
                                  std::to_string(field.size - text_length_bytes) + " fit");
          }
          to[0] = static_cast<std::byte>(size);
          to[1] = std::byte{0};
          if (size != 0) std::memcpy(to + text_length_bytes, rest.data(), size);
        } else if (field.kind == Kind::boolean) {
          if (rest[0] > std::byte{1}) return bad(where, "a bool is neither 0 nor 1");
          const bool flag = rest[0] == std::byte{1};
          std::memcpy(to, &flag, sizeof flag);
        } else {
          copy_number(to, rest.data(), size);
        }
        rest = rest.subspan(size);
      }
      if (!rest.empty()) return bad(where, std::to_string(rest.size()) + " bytes are left over");
    }
    return {};
  }

  Result<void> finish() const {
    if (rest_.empty()) return {};
    return bad("", std::to_string(rest_.size()) + " bytes follow the last field");
  }

 private:
  static Error wrong_size(const std::string& where, std::size_t size, std::size_t expected) {
    return bad(where, "a value of " + std::to_string(size) + " bytes, not of " + std::to_string(expected));
  }

  std::span<const std::byte> rest_;
};

std::uint32_t total_size(std::span<const std::byte> bytes) {
  std::uint32_t size = 0;
  for (std::size_t i = 0; i < 4; ++i) size |= static_cast<std::uint32_t>(bytes[i]) << (8 * i);
  return size;
}

class RawCodec final : public Codec {
 public:
  explicit RawCodec(RawConfig config) : config_(config) {}

  std::string_view name() const noexcept override { return "raw"; }

  Result<void> encode(const EventView& event, std::vector<std::byte>& out) override {
    if (!last_.is_like(event)) return encode_unlike_last(event, out);
    last_.append_with_numbers_of(event, out);
    return {};
  }

  Result<DecodedEvent> decode(std::span<const std::byte> bytes, const Description& description) override {
    if (bytes.size() < 4) return Decoder::bad("", "the bytes end within the total size");
    if (const std::size_t total = total_size(bytes); total != bytes.size() - 4) {
      return Decoder::bad(
          "", "they announce " + std::to_string(total) + " bytes and " + std::to_string(bytes.size() - 4) + " follow");
    }
    Decoder decoder(bytes.subspan(4));
    DecodedEvent event;
    auto topic = decoder.text("topic");
    if (!topic) return std::move(topic).error();
    auto time = decoder.number<std::int64_t>("time");
    if (!time) return std::move(time).error();
    auto origin = decoder.text("origin");
    if (!origin) return std::move(origin).error();
    if (config_.sequence == RawConfig::Sequence::include) {
      auto sequence = decoder.number<std::uint64_t>("sequence");
      if (!sequence) return std::move(sequence).error();
      event.sequence = *sequence;
    }
    event.topic = std::move(*topic);
    event.time = from_nanoseconds(*time);
    event.origin = std::move(*origin);
    event.payload.resize(description.size());
    if (auto done = decoder.fields(description.fields(), event.payload.data()); !done) return std::move(done).error();
    if (auto done = decoder.finish(); !done) return std::move(done).error();
    return event;
  }

  std::size_t first_event(std::span<const std::byte> stream) const noexcept override {
    if (stream.size() < 4) return 0;
    const std::size_t total = total_size(stream);
    return stream.size() - 4 < total ? 0 : total + 4;
  }

 private:
  /// The source of an event, as addresses that are only compared.
  struct Source {
    const void* topic = nullptr;
    const void* origin = nullptr;
    const void* plan = nullptr;
    bool operator==(const Source&) const = default;
  };

  [[gnu::noinline]] Result<void> encode_unlike_last(const EventView& event, std::vector<std::byte>& out) {
    if (event.topic().size() > longest_value) return too_long("topic", event.topic().size());
    if (event.origin().size() > longest_value) return too_long("origin", event.origin().size());
    last_.forget();  // its plan may be destroyed now
    const RawPlan& plan = plans_.of(event.description());
    const std::size_t begin = out.size();
    out.resize(begin + longest_header + event.topic().size() + event.origin().size() + plan.longest);
    std::byte* to = put_text(out.data() + begin + 4, event.topic());
    const std::int64_t time = to_nanoseconds(event.time());
    to = put_number<sizeof time>(to, &time);
    to = put_text(to, event.origin());
    const std::uint64_t sequence = event.sequence();
    if (config_.sequence == RawConfig::Sequence::include) to = put_number<sizeof sequence>(to, &sequence);
    const std::byte* const payload = event.payload().data();
    for (const RawPlan::LeafStep& step : plan.steps) {
      const std::byte* from = payload + step.offset;
      switch (step.sort) {
        case RawPlan::Sort::numbers_8:
          to = put_numbers<8>(to, from, step.count);
          break;
        case RawPlan::Sort::numbers_4:
          to = put_numbers<4>(to, from, step.count);
          break;
        case RawPlan::Sort::numbers_2:
          to = put_numbers<2>(to, from, step.count);
          break;
        case RawPlan::Sort::numbers_1:
          to = put_numbers<1>(to, from, step.count);
          break;
        case RawPlan::Sort::field: {
          Error why;
          to = put_field(to, step, from, why);
          if (to != nullptr) break;
          out.resize(begin);
          return why;
        }
      }
    }
    const auto end = static_cast<std::size_t>(to - out.data());
    const auto size = static_cast<std::uint32_t>(end - begin - 4);
    copy_number(out.data() + begin, reinterpret_cast<const std::byte*>(&size), sizeof size);
    out.resize(end);
    // If origins or topics alternate, keeping each event would cost more than it saves.
    const Source source{event.topic().data(), event.origin().data(), &plan};
    if (plan.is_fixed && source == previous_) last_.keep(event, plan, config_.sequence, std::span(out).subspan(begin));
    previous_ = source;
    return {};
  }

  /// The bytes of total size, topic, time, origin and sequence, without the two texts.
  static constexpr std::size_t longest_header = 4 + 1 + 9 + 1 + 9;

  RawConfig config_;
  detail::PerDescription<RawPlan> plans_;
  Source previous_;  // of the last event that was not like `last_`
  LastEvent last_;
};

}  // namespace

std::unique_ptr<Codec> make_raw_codec(RawConfig config) { return std::make_unique<RawCodec>(config); }

}  // namespace rtdata
