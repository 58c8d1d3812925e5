#include "data/json_decode.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <limits>

#include "data/character.hpp"
#include "data/json_tree.hpp"
#include "data/nearest.hpp"
#include "data/utf8.hpp"

namespace rtdata {
namespace {

using Node = detail::JsonNode;

/// The format of the source.
enum class Source {
  json,
  cbor,  ///< texts without escapes
};

/// Decodes one event.
class Reader {
 public:
  explicit Reader(Source source) : source_(source) {}
  Result<DecodedEvent> event(const Node& root, const Description& description);

  Error bad(std::string where, std::string why, std::string advice = {}) const {
    return {Errc::bad_data,
            source_ == Source::json ? "the text is not an event in JSON" : "the bytes are not an event in CBOR",
            std::move(where), std::move(why), std::move(advice)};
  }

 private:
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
  Result<std::vector<const Node*>> find(const Node& node, const std::vector<std::string_view>& names,
                                        std::size_t needed, const std::string& path) const {
    const std::string where = path.empty() ? "" : "field " + path.substr(0, path.size() - 1);
    if (node.type != Node::Type::object) return bad(where, "it is not an object");
    std::vector<const Node*> found(names.size(), nullptr);
    for (std::size_t i = 0; i < node.keys.size(); ++i) {
      const std::string& key = node.keys[i];
      // Usually the keys come in order. The loop ends after names.size() + 1 keys at the latest: the next one is
      // unknown or a duplicate.
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

  Result<void> field(const Field& field, const Node& node, const std::string& path) {
    if (!field.is_array) return element(field, node, path);
    if (node.type != Node::Type::array || node.children.size() != field.count) {
      return bad("field " + path, "it is not a list of " + std::to_string(field.count));
    }
    for (std::size_t i = 0; i < field.count; ++i) {
      if (auto done = element(field, node.children[i], path + "[" + std::to_string(i) + "]"); !done) return done;
    }
    return {};
  }

  Result<void> element(const Field& field, const Node& node, const std::string& path) {
    if (field.kind == Kind::record) return record(field.fields, node, path + ".");
    // The leaves come in the order of the fields.
    const Leaf& leaf = (*leaves_)[next_leaf_++];
    if (node.type == Node::Type::object || node.type == Node::Type::array) {
      return bad("field " + path, "a list or an object is not what a " + std::string(name_of(leaf.kind)) + " takes");
    }
    return write(leaf, payload_, value(leaf, node));
  }

  /// The value of a node that is not a list or an object.
  Value value(const Leaf& leaf, const Node& node) const {
    const bool floating = leaf.kind == Kind::f32 || leaf.kind == Kind::f64;
    switch (node.type) {
      case Node::Type::boolean:
        return node.flag;
      case Node::Type::integer:
        if (floating && node.integer == 0) return -0.0;  // the parser reads an unsigned 0 as a natural number
        if (floating) return nearest(leaf.kind, node.integer);
        return node.integer;
      case Node::Type::natural:
        if (floating) return nearest(leaf.kind, node.natural);
        return node.natural;
      case Node::Type::fraction:
        if (leaf.kind == Kind::f32) {
          // Not through a double: rounding twice may give a wrong float.
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
          if (const auto c = detail::character_of(text_of(node))) return *c;
        }
        return text_of(node);
      default:
        return std::monostate{};
    }
  }

  /// A decimal text gives the nearest number of the field's type.
  template <class T>
  static double nearest(Kind kind, T number) {
    return kind == Kind::f32 ? static_cast<double>(static_cast<float>(number)) : static_cast<double>(number);
  }

  std::string text_of(const Node& node) const {
    return source_ == Source::json ? detail::unescaped(node.text) : node.text;
  }

  const Source source_;
  const std::vector<Leaf>* leaves_ = nullptr;
  std::byte* payload_ = nullptr;
  std::size_t next_leaf_ = 0;
};

Result<DecodedEvent> Reader::event(const Node& root, const Description& description) {
  auto found = find(root, {"topic", "time", "origin", "data", "sequence", "run"}, 4, "");
  if (!found) return std::move(found).error();
  const auto& [topic, time, origin, data, sequence, run] = std::array{(*found)[0], (*found)[1], (*found)[2],
                                                                      (*found)[3], (*found)[4], (*found)[5]};
  DecodedEvent event;
  if (topic->type != Node::Type::string) return bad("topic", "it is not a string");
  if (origin->type != Node::Type::string) return bad("origin", "it is not a string");
  event.topic = topic->text;
  event.origin = text_of(*origin);
  if (time->type == Node::Type::integer) {
    event.time = from_nanoseconds(time->integer);
  } else if (time->type == Node::Type::natural &&
             time->natural <= std::uint64_t{std::numeric_limits<std::int64_t>::max()}) {
    event.time = from_nanoseconds(static_cast<std::int64_t>(time->natural));
  } else {
    return bad("time", "it is not an integer of 64 bits", "write ns since 1970-01-01");
  }
  if (sequence != nullptr) {
    if (sequence->type != Node::Type::natural)
      return bad("sequence", "the sequence number must be a whole number, 0 or more");
    event.sequence = sequence->natural;
  }
  if (run != nullptr) {
    if (run->type != Node::Type::string) return bad("run", "it is not a string");
    event.run = text_of(*run);
  }
  event.payload.resize(description.size());
  leaves_ = &description.leaves();
  payload_ = event.payload.data();
  if (auto done = record(description.fields(), *data, ""); !done) return std::move(done).error();
  return event;
}

}  // namespace

Result<DecodedEvent> detail::decode_json(std::span<const std::byte> bytes, const Description& description) {
  Node root;
  Reader reader(Source::json);
  if (auto mistake = parse_json({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, root); !mistake.empty())
    return reader.bad("", std::move(mistake));
  return reader.event(root, description);
}

Result<DecodedEvent> detail::decode_cbor(std::span<const std::byte> bytes, const Description& description) {
  Node root;
  Reader reader(Source::cbor);
  if (auto mistake = parse_cbor(bytes, root); !mistake.empty()) return reader.bad("", std::move(mistake));
  return reader.event(root, description);
}

}  // namespace rtdata
