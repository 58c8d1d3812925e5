#include "app/run/new_files.hpp"

#include <algorithm>
#include <filesystem>
#include <set>

namespace rtdata::app {
namespace {

using Topics = std::vector<std::string>;

Topics topics_of(const std::vector<const PartPlan*>& parts) {
  Topics topics;
  for (const PartPlan* part : parts)
    if (part->publishes) topics.push_back(part->publishes->topic);
  return topics;
}

std::vector<std::string> files_of(const StoredTopics& stores, const Topics& topics) {
  std::vector<std::string> files{stores.path};
  if (!stores.file_of_topic) return files;
  for (const std::string& topic : topics)
    if (stores.wants(topic)) files.push_back(stores.file_of_topic(topic));
  return files;
}

std::string place_of(const std::string& path) { return std::filesystem::absolute(path).lexically_normal().string(); }

}  // namespace

std::vector<NewFile> new_files(const std::vector<const PartPlan*>& now, const SystemPlan& next,
                               const PlanChange& changes) {
  std::set<std::string> made;  // objects
  for (const PartChange& change : changes.all)
    if (change.fate == Fate::added || change.fate == Fate::restarted) made.insert(change.object);
  std::vector<NewFile> files;
  const auto is_made = [&](const PartPlan& part) {
    return part.stores && part.stores->check_openable && made.contains(part.object());
  };
  if (std::none_of(next.parts.begin(), next.parts.end(), is_made)) return files;
  std::set<std::string> known;
  const Topics topics_now = topics_of(now);
  for (const PartPlan* part : now) {
    if (!part->stores) continue;
    for (const std::string& path : files_of(*part->stores, topics_now))
      if (!path.empty()) known.insert(place_of(path));
  }
  std::vector<const PartPlan*> all;
  for (const PartPlan& part : next.parts) all.push_back(&part);
  const Topics topics = topics_of(all);
  for (const PartPlan* part : all) {
    if (!is_made(*part)) continue;
    for (const std::string& path : files_of(*part->stores, topics))
      if (known.insert(place_of(path)).second) files.push_back({part->object(), path, part->stores->check_openable});
  }
  return files;
}

std::string obstacle_to_write(const NewFile& file) {
  const auto openable = file.check_openable(file.path);
  return openable ? "" : openable.error().text();
}

}  // namespace rtdata::app
