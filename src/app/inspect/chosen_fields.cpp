#include "app/inspect/chosen_fields.hpp"

#include <algorithm>
#include <set>
#include <utility>

#include "app/core/figures.hpp"
#include "app/inspect/names.hpp"
#include "rtdata/data/problem.hpp"

namespace rtdata::app {
namespace {

[[noreturn]] void refuse(const std::string& name, std::string why, std::string advice) {
  throw SetupError({Errc::not_found, "cannot plot", name, std::move(why), std::move(advice)});
}

/// The numbers that a path means; empty: none. `is_there`: there is something of that name.
std::vector<std::string> numbers_of(const Description& of, const std::string& path, bool& is_there) {
  std::vector<std::string> found;
  for (const Leaf& leaf : of.leaves()) {
    const bool is_it = path.empty() || leaf.path == path || leaf.path.starts_with(path + ".") ||
                       leaf.path.starts_with(path + "[");
    // "pressure.raw" was added beside the number "pressure", and is not a part of it.
    if (!is_it || (leaf.path != path && of.find(path) != nullptr)) continue;
    is_there = true;
    if (is_number(leaf.kind)) found.push_back(leaf.path);
  }
  return found;
}

/// The reason why there is no number.
std::string no_number_text(const Description& of, const std::string& path) {
  const Leaf* const leaf = of.find(path);
  if (leaf == nullptr) return "it holds no number";
  std::string text = "it is " +
                     std::string(leaf->kind == Kind::enumeration ? "an enum" : "a " + std::string(name_of(leaf->kind)));
  if (leaf->kind == Kind::enumeration) {
    std::set<std::string> words;
    for (const EnumValue& value : leaf->field->values) words.insert(value.name);
    text += " (" + list_of(words) + ")";
  }
  return text + ", and only numbers have a curve";
}

std::vector<ChosenField> chosen(const std::string& name, const std::vector<RecordedTopic>& topics) {
  std::set<std::string> names;
  for (const RecordedTopic& topic : topics) names.insert(topic.topic);
  // Both topics and fields may have points in their names: the longest topic is meant.
  std::string topic = name;
  while (!names.contains(topic)) {
    const std::size_t point = topic.rfind('.');
    if (point == std::string::npos) {
      std::vector<std::string> known(names.begin(), names.end());
      for (const RecordedTopic& one : topics)
        for (const Leaf& leaf : one.description->leaves())
          if (is_number(leaf.kind)) known.push_back(one.topic + "." + leaf.path);
      const std::string nearest = nearest_name(name, known);
      refuse(name, "there is no such topic",
             nearest.empty() ? nearest_or_all(name, {names.begin(), names.end()}) : "did you mean " + nearest + "?");
    }
    topic.resize(point);
  }
  const std::string path = name.size() > topic.size() ? name.substr(topic.size() + 1) : "";
  std::vector<ChosenField> fields;
  const Description* last = nullptr;
  bool is_there = false;
  for (const RecordedTopic& one : topics) {  // another description may have other fields
    if (one.topic != topic) continue;
    last = one.description.get();
    for (std::string& found : numbers_of(*last, path, is_there)) {
      ChosenField field{topic, std::move(found)};
      if (std::find(fields.begin(), fields.end(), field) == fields.end()) fields.push_back(std::move(field));
    }
  }
  if (!fields.empty()) return fields;
  if (is_there) refuse(name, no_number_text(*last, path), "`rtdata export` has all values");
  std::vector<std::string> known;
  for (const Leaf& leaf : last->leaves()) known.push_back(leaf.path);
  refuse(name, "topic " + topic + " has no field " + path, nearest_or_all(path, known));
}

}  // namespace

std::vector<ChosenField> chosen_fields(const std::vector<std::string>& names,
                                       const std::vector<RecordedTopic>& topics) {
  std::vector<ChosenField> fields;
  for (const std::string& name : names)
    for (ChosenField& field : chosen(name, topics))
      if (std::find(fields.begin(), fields.end(), field) == fields.end()) fields.push_back(std::move(field));
  return fields;
}

}  // namespace rtdata::app
