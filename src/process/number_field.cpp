#include "process/number_field.hpp"

#include "data/load.hpp"
#include "rtdata/data/value.hpp"

namespace rtdata::detail {
namespace {

bool is_number(const Leaf& leaf) noexcept { return leaf.kind != Kind::text && leaf.kind != Kind::character; }

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
  const Kind kind = field.kind == Kind::enumeration ? field.enum_base : field.kind;
  return for_number(kind == Kind::boolean ? Kind::u8 : kind,
                    [at](auto zero) { return static_cast<double>(load<decltype(zero)>(at)); });
}

}  // namespace rtdata::detail
