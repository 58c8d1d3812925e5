#include <algorithm>
#include <bit>
#include <limits>

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

class Encoder {
 public:
  explicit Encoder(std::vector<std::byte>& out) : out_(out), begin_(out.size()) { out_.resize(begin_ + 4); }

  Result<void> bytes(std::string_view name, std::string_view content) {
    if (content.size() > longest_value) return too_long(std::string(name), content.size());
    const auto* from = reinterpret_cast<const std::byte*>(content.data());
    out_.push_back(static_cast<std::byte>(content.size()));
    out_.insert(out_.end(), from, from + content.size());
    return {};
  }

  template <class T>
  void number(T value) {
    std::byte memory[sizeof value];
    std::memcpy(memory, &value, sizeof value);
    out_.push_back(static_cast<std::byte>(sizeof value));
    put_number(memory, sizeof value);
  }

  Result<void> fields(const std::vector<Field>& fields, const std::byte* record) {
    for (const Field& field : fields) {
      const std::byte* at = record + field.offset;
      if (field.kind == Kind::record) {
        for (std::size_t i = 0; i < field.count; ++i) {
          auto done = this->fields(field.fields, at + i * field.stride);
          if (!done) return within(field, i, std::move(done).error());
        }
        continue;
      }
      const std::size_t size_at = out_.size();
      out_.push_back(std::byte{0});
      for (std::size_t i = 0; i < field.count; ++i, at += field.stride) {
        if (field.optional != nullptr && !field.optional->has_value(at)) {
          return does_not_fit("field " + field.name, "it is absent, and raw bytes have no sign for that");
        }
        if (field.kind == Kind::text) {
          const std::size_t size = text_size(at, field.size);
          if (size > longest_value) return too_long("field " + field.name, size);
          if (field.is_array) out_.push_back(static_cast<std::byte>(size));
          out_.insert(out_.end(), at + text_length_bytes, at + text_length_bytes + size);
        } else if (field.kind == Kind::boolean) {
          out_.push_back(*at == std::byte{0} ? std::byte{0} : std::byte{1});
        } else {
          put_number(at, field.size);
        }
        // Here too, so that an array of millions does not fill the memory first.
        const std::size_t size = out_.size() - size_at - 1;
        if (size > longest_value) return too_long("field " + field.name, std::max(size, field.count * field.size));
      }
      out_[size_at] = static_cast<std::byte>(out_.size() - size_at - 1);
    }
    return {};
  }

  Result<void> finish() {
    const std::size_t size = out_.size() - begin_ - 4;
    if (size > std::numeric_limits<std::uint32_t>::max()) return too_long("the event", size);
    for (std::size_t i = 0; i < 4; ++i) out_[begin_ + i] = static_cast<std::byte>(size >> (8 * i) & 0xff);
    return {};
  }

  void undo() { out_.resize(begin_); }

 private:
  static Error too_long(const std::string& where, std::size_t size) {
    return does_not_fit(where, "it has " + std::to_string(size) + " bytes, a value may have 255");
  }
  void put_number(const std::byte* from, std::size_t size) {
    std::byte memory[8];
    copy_number(memory, from, size);
    out_.insert(out_.end(), memory, memory + size);
  }

  std::vector<std::byte>& out_;
  std::size_t begin_;
};

/// The fields of a description that has plain values only: no text, no optional, nothing that could fail to fit. Encoding
/// such an event is copying.
struct PlainFields {
  struct Field {
    std::uint32_t offset;
    std::uint8_t size;
  };
  std::uint64_t serial = 0;  // of the description; they start at 1
  bool is_plain = false;
  std::size_t bytes = 0;  // encoded
  std::vector<Field> fields;

  void make(const Description& description) {
    serial = description.serial();
    bytes = 0;
    fields.clear();
    is_plain = std::endian::native == std::endian::little && add(description.fields(), 0);
  }

 private:
  bool add(const std::vector<rtdata::Field>& all, std::size_t from) {
    for (const rtdata::Field& field : all) {
      if (field.is_array || field.count != 1 || field.optional != nullptr) return false;
      const std::size_t offset = from + field.offset;
      if (field.kind == Kind::record) {
        if (!add(field.fields, offset)) return false;
        continue;
      }
      if (field.kind == Kind::text || field.kind == Kind::boolean || field.size > 8) return false;
      fields.push_back({static_cast<std::uint32_t>(offset), static_cast<std::uint8_t>(field.size)});
      bytes += 1 + field.size;
    }
    return true;
  }
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
    if (plain_.serial != event.description().serial()) plain_.make(event.description());
    if (plain_.is_plain && event.topic().size() <= longest_value && event.origin().size() <= longest_value) {
      encode_plain(event, out);
      return {};
    }
    Encoder encoder(out);
    auto done = encode(event, encoder);
    if (!done) encoder.undo();
    return done;
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
  /// Every value fits.
  void encode_plain(const EventView& event, std::vector<std::byte>& out) {
    const bool has_sequence = config_.sequence == RawConfig::Sequence::include;
    const std::size_t size = 1 + event.topic().size() + 9 + 1 + event.origin().size() + (has_sequence ? 9 : 0) + plain_.bytes;
    if (bytes_.size() < 4 + size) bytes_.resize(4 + size);
    std::byte* to = bytes_.data();
    const auto put = [&to](const void* from, std::size_t count) {
      *to++ = static_cast<std::byte>(count);
      if (count != 0) std::memcpy(to, from, count);
      to += count;
    };
    const auto total = static_cast<std::uint32_t>(size);
    std::memcpy(to, &total, sizeof total);
    to += sizeof total;
    const std::int64_t time = to_nanoseconds(event.time());
    const std::uint64_t sequence = event.sequence();
    put(event.topic().data(), event.topic().size());
    put(&time, sizeof time);
    put(event.origin().data(), event.origin().size());
    if (has_sequence) put(&sequence, sizeof sequence);
    const std::byte* payload = event.payload().data();
    for (const PlainFields::Field& field : plain_.fields) {
      *to++ = static_cast<std::byte>(field.size);
      const std::byte* from = payload + field.offset;
      switch (field.size) {  // of a size known to the compiler, each is one instruction
        case 8: std::memcpy(to, from, 8); break;
        case 4: std::memcpy(to, from, 4); break;
        case 2: std::memcpy(to, from, 2); break;
        default: std::memcpy(to, from, field.size); break;
      }
      to += field.size;
    }
    out.insert(out.end(), bytes_.data(), to);
  }

  Result<void> encode(const EventView& event, Encoder& encoder) const {
    if (auto done = encoder.bytes("topic", event.topic()); !done) return done;
    encoder.number(to_nanoseconds(event.time()));
    if (auto done = encoder.bytes("origin", event.origin()); !done) return done;
    if (config_.sequence == RawConfig::Sequence::include) encoder.number(event.sequence());
    if (auto done = encoder.fields(event.description().fields(), event.payload().data()); !done) return done;
    return encoder.finish();
  }

  RawConfig config_;
  PlainFields plain_;             // of the last event
  std::vector<std::byte> bytes_;  // of one event
};

}  // namespace

std::unique_ptr<Codec> make_raw_codec(RawConfig config) { return std::make_unique<RawCodec>(config); }

}  // namespace rtdata
