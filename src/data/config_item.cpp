#include "rtdata/data/config_item.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "data/config_item_origin.hpp"

namespace rtdata {
namespace {

bool is_plain(std::string_view key) {
  return !key.empty() && std::all_of(key.begin(), key.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '-' ||
           c == '$' || c == '/' || static_cast<unsigned char>(c) >= 0x80;
  });
}

/// A key that is not plain, as a step of a path.
std::string in_brackets(const std::string& key) {
  std::string step = "[";
  return step.append(ConfigItem::of(key).to_json()).append("]");
}

Error not_a_container(const ConfigItem& item, std::string_view what, std::string_view wanted) {
  const Problem problem = item.problem("wrong-type", std::string(what));
  Error error = problem.error();
  error.code = Errc::bad_argument;
  error.why = "it is " + item.describe() + ", not " + std::string(wanted);
  return error;
}

}  // namespace

ConfigItem ConfigItem::array() {
  ConfigItem item;
  item.value_ = Array{};
  return item;
}

ConfigItem ConfigItem::object() {
  ConfigItem item;
  item.value_ = Object{};
  return item;
}

ConfigItem::Kind ConfigItem::kind() const noexcept {
  constexpr Kind kinds[] = {Kind::null,   Kind::boolean, Kind::integer, Kind::integer,
                            Kind::number, Kind::string,  Kind::array,   Kind::object};
  return kinds[value_.index()];
}

// Places and paths ----------------------------------------------------------------------------------------------------

ConfigPlace ConfigItem::place() const {
  if (!origin_) return {};
  return {origin_->file ? *origin_->file : "", origin_->line, origin_->column};
}

ConfigPlace ConfigItem::key_place() const {
  if (!origin_) return {};
  if (origin_->key_line == 0) return place();
  return {origin_->file ? *origin_->file : "", origin_->key_line, origin_->key_column};
}

std::string ConfigItem::path() const {
  std::vector<const Origin*> steps;
  for (const Origin* origin = origin_.get(); origin != nullptr; origin = origin->parent.get())
    if (origin->parent || origin->element || !origin->key.empty()) steps.push_back(origin);
  std::string path;
  for (auto step = steps.rbegin(); step != steps.rend(); ++step) {
    if ((*step)->element) {
      path.append("[").append(std::to_string((*step)->index)).append("]");
    } else if (is_plain((*step)->key)) {
      if (!path.empty()) path += '.';
      path += (*step)->key;
    } else {
      path += in_brackets((*step)->key);
    }
  }
  return path;
}

Problem ConfigItem::problem(std::string id, std::string message, std::string suggestion) const {
  return {std::move(id), place(), path(), std::move(message), std::move(suggestion)};
}

void ConfigItem::move_below(const std::shared_ptr<const Origin>& parent, std::string_view key, std::size_t index,
                            bool element) {
  auto origin = origin_ ? std::make_shared<Origin>(*origin_) : std::make_shared<Origin>();
  origin->parent = parent;
  origin->key = key;
  origin->index = index;
  origin->element = element;
  origin_ = std::move(origin);
  rebuild_origins_of_children();
}

void ConfigItem::rebuild_origins_of_children() {
  Children* list = child_list();
  if (list == nullptr) return;
  for (std::size_t i = 0; i < list->size(); ++i) (*list)[i].item.move_below(origin_, (*list)[i].key, i, is_array());
}

void ConfigItem::renumber_from(std::size_t index) {
  Children& list = *child_list();
  for (std::size_t i = index; i < list.size(); ++i) list[i].item.move_below(origin_, list[i].key, i, is_array());
}

// Children ------------------------------------------------------------------------------------------------------------

const ConfigItem::Children* ConfigItem::child_list() const noexcept {
  if (const Array* list = std::get_if<Array>(&value_)) return &list->children;
  if (const Object* members = std::get_if<Object>(&value_)) return &members->children;
  return nullptr;
}

std::span<const ConfigChild> ConfigItem::children() const noexcept {
  const Children* list = child_list();
  return list == nullptr ? std::span<const ConfigChild>() : std::span<const ConfigChild>(*list);
}

std::size_t ConfigItem::size() const noexcept { return children().size(); }

std::vector<std::string> ConfigItem::keys() const {
  std::vector<std::string> names;
  if (is_object())
    for (const ConfigChild& child : children()) names.push_back(child.key);
  return names;
}

const ConfigItem* ConfigItem::find(std::string_view key_or_path) const {
  if (is_object())
    for (const ConfigChild& child : children())
      if (child.key == key_or_path) return &child.item;
  return follow(key_or_path);
}

/// Takes one step off the front of the path and leaves the rest to `find` of that child.
const ConfigItem* ConfigItem::follow(std::string_view path) const {
  if (path.empty()) return nullptr;
  const ConfigItem* child = nullptr;
  std::size_t used = 0;
  if (path.starts_with("[\"")) {
    for (const ConfigChild& member : children()) {
      const std::string step = in_brackets(member.key);
      if (is_object() && path.starts_with(step)) {
        child = &member.item;
        used = step.size();
      }
    }
  } else if (path.front() == '[') {
    const std::size_t close = path.find(']');
    if (close == std::string_view::npos || close < 2 || close > 18) return nullptr;
    std::size_t index = 0;
    for (const char digit : path.substr(1, close - 1)) {
      if (digit < '0' || digit > '9') return nullptr;
      index = index * 10 + static_cast<std::size_t>(digit - '0');
    }
    if (is_array()) child = find(index);
    used = close + 1;
  } else {
    used = path.find_first_of(".[");
    if (used == std::string_view::npos || used == 0) return nullptr;
    for (const ConfigChild& member : children())
      if (is_object() && member.key == path.substr(0, used)) child = &member.item;
  }
  if (child == nullptr || used == path.size()) return child;
  if (path[used] == '[') return child->follow(path.substr(used));
  return path[used] == '.' && used + 1 < path.size() ? child->find(path.substr(used + 1)) : nullptr;
}

const ConfigItem* ConfigItem::find(std::size_t index) const {
  const auto list = children();
  return index < list.size() ? &list[index].item : nullptr;
}

ConfigItem* ConfigItem::find(std::string_view key_or_path) {
  return const_cast<ConfigItem*>(std::as_const(*this).find(key_or_path));
}

ConfigItem* ConfigItem::find(std::size_t index) { return const_cast<ConfigItem*>(std::as_const(*this).find(index)); }

const ConfigItem& ConfigItem::step_to(std::string_view key_or_path) const {
  if (const ConfigItem* child = find(key_or_path)) return *child;
  Problems problems;
  problems.add(problem("missing-key", "there is no \"" + std::string(key_or_path) + "\" in " + describe(),
                       nearest_name(key_or_path, keys())));
  throw ConfigError(std::move(problems));
}

const ConfigItem& ConfigItem::step_to(std::size_t index) const {
  if (const ConfigItem* child = find(index)) return *child;
  Problems problems;
  problems.add(problem("missing-key", "there is no element " + std::to_string(static_cast<std::ptrdiff_t>(index)) +
                                          " in " + describe() + " of " + std::to_string(size())));
  throw ConfigError(std::move(problems));
}

// Changing ------------------------------------------------------------------------------------------------------------

ConfigItem& ConfigItem::child_for(std::string_view key) {
  if (is_null()) value_ = Object{};
  Object* members = std::get_if<Object>(&value_);
  if (members == nullptr)
    throw SetupError(not_a_container(*this, "cannot set \"" + std::string(key) + "\"", "an object"));
  for (ConfigChild& child : members->children)
    if (child.key == key) return child.item;
  members->children.push_back({std::string(key), ConfigItem()});
  members->children.back().item.move_below(origin_, key, members->children.size() - 1, false);
  return members->children.back().item;
}

ConfigItem& ConfigItem::new_element() {
  if (is_null()) value_ = Array{};
  Array* list = std::get_if<Array>(&value_);
  if (list == nullptr) throw SetupError(not_a_container(*this, "cannot add an element", "a list"));
  list->children.push_back({});
  list->children.back().item.move_below(origin_, "", list->children.size() - 1, true);
  return list->children.back().item;
}

bool ConfigItem::remove(std::string_view key) {
  const auto list = children();
  if (!is_object()) return false;
  for (std::size_t i = 0; i < list.size(); ++i)
    if (list[i].key == key) return remove(i);
  return false;
}

bool ConfigItem::remove(std::size_t index) {
  Children* list = child_list();
  if (list == nullptr || index >= list->size()) return false;
  list->erase(list->begin() + static_cast<std::ptrdiff_t>(index));
  renumber_from(index);
  return true;
}

void ConfigItem::set_null() { value_ = std::monostate{}; }
void ConfigItem::set_boolean(bool value) { value_ = value; }
void ConfigItem::set_integer(std::int64_t value) { value_ = value; }

void ConfigItem::set_integer(std::uint64_t value) {
  if (value <= static_cast<std::uint64_t>(INT64_MAX))
    value_ = static_cast<std::int64_t>(value);
  else
    value_ = value;
}

void ConfigItem::set_number(double value) {
  if (!std::isfinite(value))
    throw SetupError({Errc::bad_argument, "cannot set a configuration item to " + std::to_string(value), path(),
                      "a configuration file has no such number", "remove the item, or use null"});
  value_ = Number{value, ""};
}

void ConfigItem::set_string(std::string_view value) { value_ = std::string(value); }

void ConfigItem::set_item(const ConfigItem& other) {
  Content content = other.value_;  // copied first, because the other item may be below this one
  value_ = std::move(content);
  rebuild_origins_of_children();
}

bool ConfigItem::operator==(const ConfigItem& other) const {
  if (value_.index() != other.value_.index()) return false;
  if (const Number* number = std::get_if<Number>(&value_)) return number->value == std::get<Number>(other.value_).value;
  if (is_array())
    return std::equal(children().begin(), children().end(), other.children().begin(), other.children().end(),
                      [](const ConfigChild& a, const ConfigChild& b) { return a.item == b.item; });
  if (is_object()) {
    if (size() != other.size()) return false;
    std::map<std::string_view, const ConfigItem*> members;
    for (const ConfigChild& child : other.children()) members.emplace(child.key, &child.item);
    return std::all_of(children().begin(), children().end(), [&](const ConfigChild& child) {
      const auto found = members.find(child.key);
      return found != members.end() && child.item == *found->second;
    });
  }
  if (const bool* flag = as_boolean()) return *flag == *other.as_boolean();
  if (const std::int64_t* integer = as_signed()) return *integer == *other.as_signed();
  if (const std::uint64_t* integer = as_unsigned()) return *integer == *other.as_unsigned();
  if (const std::string* text = as_string()) return *text == *other.as_string();
  return true;
}

}  // namespace rtdata
