#include "rtdata/data/event.hpp"

#include <cstdint>

#include "data/nearest.hpp"

namespace rtdata {

Result<Value> EventView::value(std::string_view path) const {
  if (const Leaf* leaf = description_->find(path)) return value(*leaf);
  std::vector<std::string_view> known;
  for (const Leaf& leaf : description_->leaves()) known.push_back(leaf.path);
  return Error{Errc::bad_name, "no field of this name", std::string(topic_) + ", field " + std::string(path),
               "record " + description_->name() + " does not have it", detail::suggestion(path, known)};
}

bool EventView::matches(const Description& other) const noexcept {
  if (payload_.size() != other.size() || reinterpret_cast<std::uintptr_t>(payload_.data()) % other.alignment() != 0) {
    return false;
  }
  return description_ == &other || (description_->same_meaning(other) && description_->same_layout(other));
}

}  // namespace rtdata
