#include <cassert>
#include <unordered_map>
#include <utility>

#include "data/config_item_origin.hpp"
#include "rtdata/config/format.hpp"

namespace rtdata {

constexpr std::size_t deepest = 64;

struct ConfigBuilder::Frame {
  ConfigItem item;
  Position position;
  std::unordered_map<std::string, Position> keys;  ///< of an object: where each was first
};

ConfigBuilder::ConfigBuilder(const std::string& file, Problems& problems)
    : file_(std::make_shared<const std::string>(file)), problems_(problems) {}

ConfigBuilder::~ConfigBuilder() = default;

std::size_t ConfigBuilder::depth() const noexcept { return frames_.size(); }

ConfigBuilder::Position ConfigBuilder::innermost() const noexcept {
  return frames_.empty() ? Position{} : frames_.back().position;
}

std::string ConfigBuilder::path() const { return frames_.empty() ? "" : frames_.back().item.path(); }

bool ConfigBuilder::begin_object(Position position) { return begin(ConfigItem::object(), position); }
bool ConfigBuilder::begin_array(Position position) { return begin(ConfigItem::array(), position); }

void ConfigBuilder::key(std::string_view key, Position position) {
  assert(!frames_.empty() && frames_.back().item.is_object());
  key_ = key;
  key_position_ = position;
}

void ConfigBuilder::end() {
  assert(!frames_.empty());
  ConfigItem item = std::move(frames_.back().item);
  frames_.pop_back();
  attach(std::move(item));
}

void ConfigBuilder::null(Position position) { add(ConfigItem(), position); }
void ConfigBuilder::boolean(bool value, Position position) { add(ConfigItem::of(value), position); }
void ConfigBuilder::integer(std::int64_t value, Position position) { add(ConfigItem::of(value), position); }
void ConfigBuilder::integer(std::uint64_t value, Position position) { add(ConfigItem::of(value), position); }
void ConfigBuilder::string(std::string_view value, Position position) { add(ConfigItem::of(value), position); }

void ConfigBuilder::number(double value, std::string_view literal, Position position) {
  ConfigItem item;
  item.set_number(value);
  std::get<ConfigItem::Number>(item.value_).literal = literal;
  add(std::move(item), position);
}

ConfigItem ConfigBuilder::finish() {
  while (!frames_.empty()) end();
  return std::move(root_);
}

/// Gives the item its origin: below the innermost frame, under the key that came before it.
void ConfigBuilder::locate(ConfigItem& item, Position position) const {
  auto origin = std::make_shared<ConfigItem::Origin>();
  origin->file = file_;
  origin->line = position.line;
  origin->column = position.column;
  if (!frames_.empty()) {
    const ConfigItem& parent = frames_.back().item;
    origin->parent = parent.origin_;
    origin->index = parent.size();
    origin->element = parent.is_array();
    if (!origin->element) {
      origin->key = key_;
      origin->key_line = key_position_.line;
      origin->key_column = key_position_.column;
    }
  }
  item.origin_ = std::move(origin);
}

void ConfigBuilder::add(ConfigItem item, Position position) {
  locate(item, position);
  attach(std::move(item));
}

bool ConfigBuilder::begin(ConfigItem item, Position position) {
  if (frames_.size() == deepest) {
    problems_.add("too-deep", {*file_, position.line, position.column}, path(),
                  "more than " + std::to_string(deepest) + " levels of nesting");
    return false;
  }
  locate(item, position);
  frames_.push_back({std::move(item), position, {}});  // goes to its parent when it ends
  return true;
}

void ConfigBuilder::attach(ConfigItem item) {
  if (frames_.empty()) {
    root_ = std::move(item);
    return;
  }
  Frame& frame = frames_.back();
  const std::string key = item.origin_->key;
  if (frame.item.is_object()) {
    const ConfigPlace place = item.key_place();
    const auto [first, added] = frame.keys.emplace(key, Position{place.line, place.column});
    if (!added) {
      const ConfigPlace earlier{*file_, first->second.line, first->second.column};
      problems_.add("duplicate-key", place, item.path(), "this key is already at " + earlier.text());
      return;
    }
  }
  frame.item.child_list()->push_back({key, std::move(item)});
}

}  // namespace rtdata
