#include "process/expression_names.hpp"

#include <cstdint>
#include <cstring>

#include "rtdata/process/expression.hpp"

namespace rtdata::detail {

bool is_number(const Leaf& leaf) noexcept { return leaf.kind != Kind::text && leaf.kind != Kind::character; }

Meaning meaning_of(const std::vector<std::string>& topics, const std::string& name) {
  Meaning meaning{0, name};
  std::size_t longest = 0;
  for (std::size_t i = 0; i < topics.size(); ++i) {
    const std::string topic = Expression::normal_name(topics[i]);
    if (topic.size() <= longest || !name.starts_with(topic)) continue;
    if (name.size() > topic.size() && name[topic.size()] != '.') continue;
    longest = topic.size();
    meaning = {i, name.size() == topic.size() ? "" : name.substr(topic.size() + 1)};
  }
  return meaning;
}

const Leaf* leaf_of(const Description& description, const Meaning& meaning, const std::string& name) {
  const auto number_at = [&](std::string_view path) {
    const Leaf* leaf = description.find(path);
    return leaf != nullptr && is_number(*leaf) ? leaf : nullptr;
  };
  if (meaning.topic == 0 && description.find(name) != nullptr) return number_at(name);  // a field called as the topic
  if (!meaning.path.empty()) return number_at(meaning.path);
  if (const Leaf* value = number_at("value")) return value;
  const Leaf* only = nullptr;
  for (const Leaf& leaf : description.leaves()) {
    if (!is_number(leaf)) continue;
    if (only != nullptr) return nullptr;
    only = &leaf;
  }
  return only;
}

namespace {

template <class T>
double number_at(const std::byte* at) noexcept {
  T value;
  std::memcpy(&value, at, sizeof value);
  return static_cast<double>(value);
}

}  // namespace

double number_of(const Leaf& leaf, const std::byte* at) noexcept {
  switch (leaf.kind == Kind::enumeration ? leaf.enum_base : leaf.kind) {
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
