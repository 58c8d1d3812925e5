#include "process/number_field.hpp"

#include <cstdint>
#include <cstring>

#include "rtdata/data/value.hpp"

namespace rtdata::detail {
namespace {

bool is_number(const Leaf& leaf) noexcept { return leaf.kind != Kind::text && leaf.kind != Kind::character; }

template <class T>
double number_at(const std::byte* at) noexcept {
  T value;
  std::memcpy(&value, at, sizeof value);
  return static_cast<double>(value);
}

}  // namespace

const Leaf* number_field(const Description& description, std::string_view path) noexcept {
  const auto number_called = [&](std::string_view name) {
    const Leaf* const leaf = description.find(name);
    return leaf != nullptr && is_number(*leaf) ? leaf : nullptr;
  };
  if (!path.empty()) return number_called(path);
  if (const Leaf* const value = number_called("value")) return value;
  const Leaf* only = nullptr;
  for (const Leaf& leaf : description.leaves()) {
    if (!is_number(leaf)) continue;
    if (only != nullptr) return nullptr;
    only = &leaf;
  }
  return only;
}

std::optional<double> number_in(const Leaf& field, const std::byte* payload) noexcept {
  const std::byte* const at = find_value(field, payload);
  if (at == nullptr) return std::nullopt;
  switch (field.kind == Kind::enumeration ? field.enum_base : field.kind) {
    case Kind::boolean:
    case Kind::u8:
      return number_at<std::uint8_t>(at);
    case Kind::i8:
      return number_at<std::int8_t>(at);
    case Kind::i16:
      return number_at<std::int16_t>(at);
    case Kind::i32:
      return number_at<std::int32_t>(at);
    case Kind::i64:
      return number_at<std::int64_t>(at);
    case Kind::u16:
      return number_at<std::uint16_t>(at);
    case Kind::u32:
      return number_at<std::uint32_t>(at);
    case Kind::u64:
      return number_at<std::uint64_t>(at);
    case Kind::f32:
      return number_at<float>(at);
    default:
      return number_at<double>(at);
  }
}

}  // namespace rtdata::detail
