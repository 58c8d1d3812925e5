// PlacedList: objects in order of adding; each knows its index.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace rtdata::detail {

/// Removing an object leaves a hole and takes constant time. `Place`: the member that stores the index; an object
/// outside this list may use it for another list.
template <class T, std::uint32_t T::*Place>
class PlacedList {
 public:
  /// Throws, with nothing changed.
  void add(T& one) {
    entries_.push_back(&one);
    one.*Place = static_cast<std::uint32_t>(entries_.size() - 1);
  }
  /// Leaves a hole.
  void remove(const T& one) noexcept { remove_at(one.*Place); }
  void remove_at(std::size_t place) noexcept {
    entries_[place] = nullptr;
    ++holes_;
  }
  /// Closes the holes if there are many. Not during an iteration by index.
  void tidy() noexcept {
    if (2 * holes_ > entries_.size()) close_holes();
  }
  void close_holes() noexcept {
    if (holes_ == 0) return;
    std::size_t end = 0;
    for (T* one : entries_) {
      if (one == nullptr) continue;
      one->*Place = static_cast<std::uint32_t>(end);
      entries_[end++] = one;
    }
    entries_.resize(end);
    holes_ = 0;
  }
  void reserve(std::size_t count) { entries_.reserve(count); }

  /// Holes included.
  std::size_t places() const noexcept { return entries_.size(); }
  bool empty() const noexcept { return holes_ == entries_.size(); }
  /// Null: a hole.
  T* at(std::size_t place) const noexcept { return entries_[place]; }
  /// The objects without holes.
  std::vector<T*> all() const {
    std::vector<T*> all;
    all.reserve(entries_.size() - holes_);
    for (T* one : entries_) {
      if (one != nullptr) all.push_back(one);
    }
    return all;
  }

 private:
  std::vector<T*> entries_;
  std::size_t holes_ = 0;
};

}  // namespace rtdata::detail
