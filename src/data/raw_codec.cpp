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
  return does_not_fit(where, "it has " + std::to_string(size) + " bytes, a value may have 255");
}

/// The values of a payload, in their order, as encoding takes them.
struct Plan {
  struct Step {
    std::size_t offset = 0;        ///< bytes from the start of the payload
    std::size_t numbers = 0;       ///< so many lie one after the other; 0: it is a field of another sort
    std::size_t size = 0;          ///< bytes of each number: 1, 2, 4 or 8
    const Field* field = nullptr;  ///< owned by the description
    std::string where;             ///< of the field, for errors
  };

  explicit Plan(const Description& description) { add(description.fields(), 0, "field "); }

  std::vector<Step> steps;
  std::size_t longest = 0;  ///< bytes that all this may take

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
        steps.push_back({offset, 0, 0, &field, prefix + field.name});
        longest += 1 + std::min(longest_value, field.count * field.size);
      } else {
        add_number(offset, field.size);
        longest += 1 + field.size;
      }
    }
  }

  void add_number(std::size_t offset, std::size_t size) {
    if (!steps.empty()) {
      Step& last = steps.back();
      if (last.numbers != 0 && last.size == size && last.offset + last.numbers * size == offset) {
        ++last.numbers;
        return;
      }
    }
    steps.push_back({offset, 1, size, nullptr, {}});
  }
};

/// Writes to where there is room for all.
class Encoder {
 public:
  explicit Encoder(std::byte* to) : to_(to) {}
  std::byte* end() const noexcept { return to_; }

  void text(std::string_view content) {
    *to_ = static_cast<std::byte>(content.size());
    to_ = detail::copy_short(to_ + 1, content.data(), content.size());
  }

  template <class T>
  void number(T value) {
    numbers<sizeof value>(reinterpret_cast<const std::byte*>(&value), 1);
  }

  /// The numbers of a step.
  void numbers(const Plan::Step& step, const std::byte* payload) {
    const std::byte* from = payload + step.offset;
    switch (step.size) {
      case 1:
        return numbers<1>(from, step.numbers);
      case 2:
        return numbers<2>(from, step.numbers);
      case 4:
        return numbers<4>(from, step.numbers);
      default:
        return numbers<8>(from, step.numbers);
    }
  }

  Result<void> field(const Plan::Step& step, const std::byte* payload) {
    const Field& field = *step.field;
    const std::byte* at = payload + step.offset;
    std::byte* const begin = ++to_;  // behind the size, which comes last
    for (std::size_t i = 0; i < field.count; ++i, at += field.stride) {
      if (field.optional != nullptr && !field.optional->has_value(at)) {
        return does_not_fit(step.where, "it is absent, and raw bytes have no sign for that");
      }
      const bool is_text = field.kind == Kind::text;
      const std::size_t size = is_text ? text_size(at, field.size) : field.size;
      const std::size_t size_so_far =
          static_cast<std::size_t>(to_ - begin) + size + (is_text && field.is_array ? 1 : 0);
      if (size_so_far > longest_value) {
        return too_long(step.where, is_text ? size_so_far : field.count * field.size);
      }
      if (is_text) {
        if (field.is_array) *to_++ = static_cast<std::byte>(size);
        if (size != 0) std::memcpy(to_, at + text_length_bytes, size);
      } else if (field.kind == Kind::boolean) {
        *to_ = *at == std::byte{0} ? std::byte{0} : std::byte{1};
      } else {
        copy_number(to_, at, size);
      }
      to_ += size;
    }
    begin[-1] = static_cast<std::byte>(to_ - begin);
    return {};
  }

 private:
  template <std::size_t size>
  void numbers(const std::byte* from, std::size_t count) {
    std::byte* to = to_;
    const auto put = [&] {
      *to = std::byte{size};
      copy_number(to + 1, from, size);
      to += 1 + size;
      from += size;
    };
    for (; count >= 4; count -= 4) {
      put();
      put();
      put();
      put();
    }
    for (; count > 0; --count) put();
    to_ = to;
  }

  std::byte* to_;
};

class Decoder {
 public:
  explicit Decoder(std::span<const std::byte> bytes) : rest_(bytes) {}

  static Error bad(std::string where, std::string why) {
    return {Errc::bad_data, "the bytes are no event in raw format", std::move(where), std::move(why), ""};
  }

  Result<std::span<const std::byte>> next(const std::string& where) {
    if (rest_.empty()) return bad(where, "the bytes end before it");
    const auto size = static_cast<std::size_t>(rest_[0]);
    if (size > rest_.size() - 1) return bad(where, "the bytes end within it");
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
    if (event.topic().size() > longest_value) return too_long("topic", event.topic().size());
    if (event.origin().size() > longest_value) return too_long("origin", event.origin().size());
    const Plan& plan = plans_.of(event.description());
    const std::size_t begin = out.size();
    out.resize(begin + longest_header + event.topic().size() + event.origin().size() + plan.longest);
    Encoder encoder(out.data() + begin + 4);
    encoder.text(event.topic());
    encoder.number(to_nanoseconds(event.time()));
    encoder.text(event.origin());
    if (config_.sequence == RawConfig::Sequence::include) encoder.number(event.sequence());
    for (const Plan::Step& step : plan.steps) {
      if (step.numbers != 0) {
        encoder.numbers(step, event.payload().data());
      } else if (auto done = encoder.field(step, event.payload().data()); !done) {
        out.resize(begin);
        return done;
      }
    }
    const auto end = static_cast<std::size_t>(encoder.end() - out.data());
    const auto size = static_cast<std::uint32_t>(end - begin - 4);
    copy_number(out.data() + begin, reinterpret_cast<const std::byte*>(&size), sizeof size);
    out.resize(end);
    return {};
  }

  Result<DecodedEvent> decode(std::span<const std::byte> bytes, const Description& description) override {
    if (bytes.size() < 4) return Decoder::bad("", "they end within the total size");
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
  /// Total size, topic, time, origin and sequence but for the two texts.
  static constexpr std::size_t longest_header = 4 + 1 + 9 + 1 + 9;

  RawConfig config_;
  detail::PerDescription<Plan> plans_;
};

}  // namespace

std::unique_ptr<Codec> make_raw_codec(RawConfig config) { return std::make_unique<RawCodec>(config); }

}  // namespace rtdata
