#include "sensors/lines/binary_fields.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "data/field_layout.hpp"
#include "data/load.hpp"
#include "data/number_text.hpp"

namespace rtdata::detail {
namespace {

[[noreturn]] void refuse_binary(const LineField& field, const char* why, const char* advice) {
  throw SetupError({Errc::bad_argument, "cannot use these fields", "field " + field.name, why, advice});
}

bool is_floating(Kind kind) noexcept { return kind == Kind::f32 || kind == Kind::f64; }

double number_at(Kind kind, const std::byte* from) noexcept {
  if (kind == Kind::f32) return static_cast<double>(load<float>(from));
  if (kind == Kind::f64) return load<double>(from);
  if (kind == Kind::u64) return static_cast<double>(load<std::uint64_t>(from));
  return static_cast<double>(load_integer(kind, from));
}

/// Whether bytes of this kind can be the number.
bool can_be(Kind kind, double number) noexcept {
  if (is_floating(kind)) return true;
  if (!is_integer_kind(kind)) return false;
  const double range = std::ldexp(1.0, static_cast<int>(8 * size_of(kind)));  // how many numbers there are
  const bool is_signed = kind <= Kind::i64;
  return number == std::trunc(number) && number >= (is_signed ? -range / 2 : 0) &&
         number < (is_signed ? range / 2 : range);
}

void put_floating(Kind kind, double value, std::byte* to) noexcept {
  if (kind == Kind::f64) {
    std::memcpy(to, &value, sizeof value);
  } else {
    const auto narrow = static_cast<float>(value);
    std::memcpy(to, &narrow, sizeof narrow);
  }
}

}  // namespace

BinaryFields::BinaryFields(const std::vector<LineField>& fields, const Description& description, WireOrder order,
                           std::size_t length)
    : is_big_(order == WireOrder::big) {
  for (const LineField& field : fields) {
    if (field.name.empty())
      throw SetupError({Errc::bad_argument, "cannot use these fields", "fields", "a binary field has no name",
                        "leave out what is not kept"});
    if (!field.at)
      refuse_binary(field, "it has no place in the frame", "set `at`, the number of its first byte, from 0");
    const Kind wire = field.wire.value_or(field.type);
    const bool has_text_settings = !field.prefix.empty() || !field.suffix.empty() || field.decimal != '.' ||
                                   !field.thousands.empty() || field.base != 10 || field.sign_blanks ||
                                   !field.words.empty();
    if (has_text_settings) refuse_binary(field, "its bytes are no text, but it has settings of one", "leave them out");
    if (wire != field.type && !is_floating(field.type))
      refuse_binary(field, "it has a `wire` of another type", "make its `type` double, or leave `wire` out");
    const std::size_t size = field.type == Kind::text ? field.length : size_of(wire);
    if (length != 0 && *field.at + size > length)
      refuse_binary(field, "it ends behind the frame", "check `at`, `type` and the frame's `length`");
    for (const std::string& none : field.no_value) {
      double number = 0;
      if (read_number(none, number) != std::errc{} || !can_be(wire, number))
        refuse_binary(field, "one of `no_value` is no number that its bytes can be",
                      "write the number of its bytes, before `scale`, in decimal digits");
    }
    if (field.optional && field.no_value.empty())
      refuse_binary(field, "its bytes are always there",
                    "leave `optional` out, or say by `no_value` what stands for none");
    places_.push_back({description.find(field.name), *field.at, size, wire, field.scale, wire != field.type});
  }
}

Result<void> BinaryFields::decode(std::string_view frame, const std::vector<FieldText>& texts,
                                  std::byte* payload) const {
  for (std::size_t i = 0; i < places_.size(); ++i) {
    const Place& place = places_[i];
    const Leaf& leaf = *place.leaf;
    if (place.at + place.size > frame.size())
      return Error{Errc::bad_data, "cannot use a frame", "field " + std::string(leaf.path),
                   "the frame has " + std::to_string(frame.size()) + " bytes, and the field ends at " +
                       std::to_string(place.at + place.size),
                   "check `at` and `type`"};
    std::byte* const to = payload + leaf.offset;
    if (leaf.kind == Kind::text) {
      const std::string_view text = frame.substr(place.at, place.size);
      const std::size_t size = std::min(text.find('\0'), text.size());
      to[0] = static_cast<std::byte>(size & 0xff);
      to[1] = static_cast<std::byte>(size >> 8);
      std::memcpy(to + text_length_bytes, text.data(), size);
    } else if (leaf.kind == Kind::boolean) {
      *to = static_cast<std::byte>(frame[place.at] != '\0');
    } else {
      std::byte bytes[8];
      std::memcpy(bytes, frame.data() + place.at, place.size);
      if (is_big_) std::reverse(bytes, bytes + place.size);  // the machines we run on put the low byte first
      if (texts[i].is_used() || is_floating(leaf.kind)) {
        const double number = number_at(place.wire, bytes);
        if (texts[i].is_none(number)) continue;  // absent, as it is from the beginning
        if (is_floating(leaf.kind)) {
          const double value = scaled(number, place.scale);
          if (std::isfinite(number) && !std::isfinite(value))
            return Error{Errc::out_of_range, "cannot use a frame", "field " + std::string(leaf.path),
                         "with its `scale` it is out of range", "check `scale` and `type`"};
          put_floating(leaf.kind, value, to);
        } else {
          std::memcpy(to, bytes, place.size);
        }
      } else {
        std::memcpy(to, bytes, place.size);
      }
    }
    if (leaf.optional != nullptr) to[leaf.optional->value_size] = std::byte{1};
  }
  return {};
}

}  // namespace rtdata::detail
