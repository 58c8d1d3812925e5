#include "data/field_map.hpp"

#include <algorithm>
#include <cstring>
#include <string>

#include "rtdata/data/text.hpp"

namespace rtdata::detail {
namespace {

/// Bytes that a leaf takes in memory: of an optional, its flag too.
std::size_t extent(const Leaf& leaf) { return leaf.optional == nullptr ? leaf.size : leaf.field->stride; }

/// "double", "text of 16", "optional int32".
std::string type_text(const Leaf& leaf) {
  return (leaf.optional != nullptr ? "optional " : "") + std::string(name_of(leaf.kind)) +
         (leaf.kind == Kind::text ? " of " + std::to_string(leaf.size - text_length_bytes) : "");
}

}  // namespace

void FieldMap::apply(const std::byte* from, std::byte* to) const noexcept {
  for (const Copy& copy : copies) std::memcpy(to + copy.to, from + copy.from, copy.size);
}

Result<FieldMap> map_fields(const Description& have, const Description& wanted) {
  FieldMap map;
  std::string why;
  map.is_identity = have.size() == wanted.size() && have.leaves().size() == wanted.leaves().size();
  for (const Leaf& to : wanted.leaves()) {
    const auto& leaves = have.leaves();
    const auto from = std::find_if(leaves.begin(), leaves.end(),
                                   [&](const Leaf& leaf) { return leaf.path == to.path; });
    const auto complain = [&](const std::string& text) {
      why += (why.empty() ? "" : "; ") + ("field " + to.path + ": " + text);
    };
    if (from == leaves.end()) {
      complain("not in it");
    } else if (from->kind != to.kind || from->size != to.size ||
               (from->optional == nullptr) != (to.optional == nullptr)) {
      complain(type_text(*from) + " in it, " + type_text(to) + " wanted");
    } else if (from->unit != to.unit) {
      complain("unit \"" + from->unit + "\" in it, \"" + to.unit + "\" wanted");
    } else if (from->field->values != to.field->values) {
      complain("other named values");
    } else {
      map.copies.push_back({from->offset, to.offset, extent(to)});
      map.is_identity = map.is_identity && from->offset == to.offset;
    }
  }
  if (!why.empty()) return Error{Errc::description_differs, "", "", std::move(why), ""};
  return map;
}

}  // namespace rtdata::detail
