#include "sensors/lines/binary_field.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <iterator>

#include "data/field_layout.hpp"
#include "data/load.hpp"
#include "data/number_text.hpp"

namespace rtdata::detail {
namespace {

[[noreturn]] void refuse_binary(const LineField& field, const char* why, const char* advice) {
  throw SetupError({Errc::bad_argument, "cannot use these fields", "field " + field.name, why, advice});
}

bool is_floating(Kind kind) noexcept { return kind == Kind::f32 || kind == Kind::f64; }
bool is_signed(Kind kind) noexcept { return kind <= Kind::i64; }

template <class T, bool is_big>
double number_at(const char* from) noexcept {
  char bytes[sizeof(T)];
  std::memcpy(bytes, from, sizeof bytes);
  if (is_big) std::reverse(std::begin(bytes), std::end(bytes));  // the machines we run on put the low byte first
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return static_cast<double>(value);
}

template <bool is_big>
auto number_of_kind(Kind kind) noexcept {
  return for_number(kind, [](auto zero) { return &number_at<decltype(zero), is_big>; });
}

/// True if a value of this kind with so many bits can be the number.
bool can_be(Kind kind, int bits, double number) noexcept {
  if (is_floating(kind)) return true;
  if (!is_integer_kind(kind)) return false;
  const double range = std::ldexp(1.0, bits);  // how many numbers there are
  const double end = is_signed(kind) ? range / 2 : range;
  // The largest number of 64 bits is rounded up to the next double.
  return number == std::trunc(number) && number >= (is_signed(kind) ? -range / 2 : 0) &&
         (number < end || (bits == 64 && number == end));
}

}  // namespace

BinaryField::BinaryField(const LineField& field, const Leaf* leaf, WireOrder order)
    : leaf_(leaf),
      offset_(leaf->offset),
      at_(field.at.value_or(0)),
      wire_(field.wire.value_or(field.type == Kind::boolean ? Kind::u8 : field.type)),
      is_big_(order == WireOrder::big),
      scale_(field.scale),
      is_bcd_(field.bcd) {
  const bool has_text_settings = !field.prefix.empty() || !field.suffix.empty() || field.decimal != '.' ||
                                 !field.thousands.empty() || field.sign_blanks || !field.words.empty();
  if (has_text_settings) refuse_binary(field, "its bytes are not text, but it has settings for text", "remove them");
  const bool is_free = is_floating(field.type) || field.type == Kind::boolean;
  if (wire_ != field.type && !is_free)
    refuse_binary(field, "its `wire` differs from its `type`", "set `type` to double, or remove `wire`");
  if (field.type == Kind::boolean && is_floating(wire_))
    refuse_binary(field, "a bool cannot be a number with decimals", "set another `wire`");
  if ((field.bit || field.mask || field.bcd || field.bytes != 0) && !is_integer_kind(wire_))
    refuse_binary(field, "only a whole number can have `bytes`, `bit`, `mask` or `bcd`",
                  "set `wire`, such as \"uint32\"");
  if (field.bcd && (field.bit || field.mask))
    refuse_binary(field, "`bcd` does not work together with `bit` or `mask`", "remove `bcd`");
  const std::size_t whole = field.type == Kind::text ? field.length : size_of(wire_);
  size_ = field.bytes != 0 ? field.bytes : whole;
  if (size_ > whole) refuse_binary(field, "`bytes` is larger than its type", "set a larger `wire`, such as \"int32\"");
  const std::size_t bits = 8 * size_;
  const std::uint64_t all = bits >= 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << bits) - 1;
  if (field.bit && field.mask) refuse_binary(field, "it has both `bit` and `mask`", "remove one of them");
  if (field.bit && *field.bit >= bits)
    refuse_binary(field, "`bit` is beyond its bytes", "count the bits from 0, the lowest");
  if (field.mask && (*field.mask == 0 || *field.mask > all))
    refuse_binary(field, "`mask` has no bit within its bytes, or a bit beyond them", "set the bits of the value");
  if (field.bit) mask_ = std::uint64_t{1} << *field.bit;
  if (field.mask) mask_ = *field.mask;
  if (mask_ == 0 && !is_bcd_ && size_ == size_of(wire_))
    whole_ = is_big_ ? number_of_kind<true>(wire_) : number_of_kind<false>(wire_);
  is_plain_ = whole_ != nullptr && field.type == Kind::f64 && field.no_value.empty() && !field.optional;
  if (mask_ != 0 && is_integer_kind(field.type) && is_signed(field.type))
    refuse_binary(field, "bits of a number have no sign", "set its `type` to an unsigned one, double or bool");
  for (const std::string& none : field.no_value) {
    double number = 0;
    const Kind kind = mask_ != 0 && is_integer_kind(wire_) ? Kind::u64 : wire_;
    const int width = mask_ != 0 ? static_cast<int>(std::bit_width(mask_ >> std::countr_zero(mask_)))
                                 : static_cast<int>(bits);
    if (read_number(none, number) != std::errc{} || !can_be(kind, width, number))
      refuse_binary(field, "its bytes or bits can never have one of the numbers of `no_value`",
                    "write the number as it is after `mask` and before `scale`, in decimal digits");
  }
}

bool BinaryField::takes(std::size_t bytes) const noexcept {
  const bool has_bits = bytes >= 8 || mask_ >> (8 * bytes) == 0;
  return is_integer_kind(wire_) ? bytes >= 1 && bytes <= size_of(wire_) && has_bits : bytes == size_;
}

/// The bits of an integer; a negative integer fills all 64.
std::uint64_t BinaryField::bits_of(std::string_view bytes) const noexcept {
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    const auto byte = static_cast<unsigned char>(bytes[is_big_ ? i : bytes.size() - 1 - i]);
    bits = is_bcd_ ? bits * 100 + byte / 16 * 10 + byte % 16 : bits << 8 | byte;
  }
  if (is_bcd_) return bits;
  if (mask_ != 0) return (bits & mask_) >> std::countr_zero(mask_);
  const std::size_t unused = 64 - 8 * bytes.size();
  return is_signed(wire_) ? static_cast<std::uint64_t>(static_cast<std::int64_t>(bits << unused) >> unused) : bits;
}

double BinaryField::number_of(std::string_view bytes) const noexcept {
  if (whole_ != nullptr && bytes.size() == size_) return whole_(bytes.data());
  const std::uint64_t bits = bits_of(bytes);
  return is_signed(wire_) ? static_cast<double>(static_cast<std::int64_t>(bits)) : static_cast<double>(bits);
}

bool BinaryField::has_digits(std::string_view bytes) const noexcept {
  return std::all_of(bytes.begin(), bytes.end(), [](char c) { return (c & 0x0f) < 0x0a && (c & 0xf0) < 0xa0; });
}

const char* BinaryField::put_any(std::string_view bytes, const FieldText& text, std::byte* payload) const noexcept {
  std::byte* const to = payload + leaf_->offset;
  if (leaf_->kind == Kind::text) {
    const std::size_t size = std::min(bytes.find('\0'), bytes.size());
    to[0] = static_cast<std::byte>(size & 0xff);
    to[1] = static_cast<std::byte>(size >> 8);
    std::memcpy(to + text_length_bytes, bytes.data(), size);
  } else if (leaf_->kind == Kind::character) {
    *to = static_cast<std::byte>(bytes.front());
  } else {
    const double number = number_of(bytes);
    if (text.is_used() && text.is_none(number)) return nullptr;  // absent, as at the start
    if (is_bcd_ && !has_digits(bytes)) return "its bytes are not decimal digits";
    if (leaf_->kind == Kind::f64 || leaf_->kind == Kind::f32) {
      const double value = scale_(number);
      const auto narrow = static_cast<float>(value);
      const bool is_out = leaf_->kind == Kind::f64 ? !std::isfinite(value) : !std::isfinite(narrow);
      if (is_out && std::isfinite(number)) return "with its `scale` it is out of range";
      leaf_->kind == Kind::f64 ? std::memcpy(to, &value, sizeof value) : std::memcpy(to, &narrow, sizeof narrow);
    } else if (leaf_->kind == Kind::boolean) {
      *to = static_cast<std::byte>(number != 0);
    } else {
      const std::uint64_t bits = bits_of(bytes);  // the machines we run on put the low byte first
      std::memcpy(to, &bits, leaf_->size);
    }
  }
  if (leaf_->optional != nullptr) to[leaf_->optional->value_size] = std::byte{1};
  return nullptr;
}

}  // namespace rtdata::detail
