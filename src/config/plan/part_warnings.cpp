#include "config/plan/part_warnings.hpp"

#include <linux/magic.h>
#include <sys/vfs.h>

#include <algorithm>
#include <filesystem>
#include <set>

#include "config/read/mistakes.hpp"
#include "data/lower_case.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::config_detail {
namespace {

/// The parts read on each loop, by tier ("": the main loop).
std::map<std::string, std::vector<const PartPlan*>> parts_by_loop(const std::vector<PartPlan>& parts) {
  std::map<std::string, std::vector<const PartPlan*>> loops;
  for (const PartPlan& part : parts)
    if (part.make && part.publishes && part.publishes->load) loops[std::string(part.tier())].push_back(&part);
  return loops;
}

LoopLoad load_of(const std::string& name, const std::vector<const PartPlan*>& parts) {
  std::vector<SensorLoad> loads;
  for (const PartPlan* part : parts) loads.push_back(*part->publishes->load);
  return estimate_load(name, loads);
}

/// The part with the largest share; `share` computes it from a load.
template <class Share>
const PartPlan& largest(const std::vector<const PartPlan*>& parts, const Share& share) {
  return **std::max_element(parts.begin(), parts.end(), [&](const PartPlan* a, const PartPlan* b) {
    return share(*a->publishes->load) < share(*b->publishes->load);
  });
}

void warn_of_loop(const std::string& tier, const std::string& name, const std::vector<const PartPlan*>& parts,
                  Problems& warnings) {
  const LoopLoad load = load_of(name, parts);
  const std::string where = tier.empty() ? "the main loop" : "tier \"" + tier + "\"";
  if (load.is_overloaded()) {
    const auto held = [](const SensorLoad& sensor) { return sensor.time.on_loop.value_or(Duration{0}); };
    const ConfigItem& longest = child_or_self(largest(parts, held).item, "rate");
    if (load.is_too_busy()) {
      warnings.add(longest.problem("overloaded-loop",
                                   "the readings of " + where + " take too much of its time (" + load.text() +
                                       "), this one most; lower the rates, or move sensors to another tier or lane"));
    } else {
      warnings.add(longest.problem(
          "late-readings", "readings that come due together on " + where +
                               " may take longer than its shortest period (" + load.text() +
                               "), so that its fastest sensors begin late or miss ticks now and then; give sensors of "
                               "one longer period different phases, or the fastest a tier of its own"));
    }
  }
  for (const LaneLoad& lane : load.lanes) {
    if (!lane.is_overloaded()) continue;
    const auto share = [&](const SensorLoad& sensor) {
      if (sensor.time.lane != lane.lane || !sensor.time.on_lane) return -1.0;
      return static_cast<double>(sensor.time.on_lane->count()) / static_cast<double>(sensor.period.count());
    };
    warnings.add(child_or_self(largest(parts, share).item, "rate")
                     .problem("overloaded-lane",
                              "a device cannot be read this often (" + lane.text() +
                                  "), and this sensor reads it most; lower the rates of the sensors that share it"));
  }
}

}  // namespace

void warn_of_patterns(const std::vector<PartPlan>& parts, const Neighbours& neighbours, Problems& warnings) {
  // A sensor whose topics are known only after it is made may publish on any topic.
  if (std::any_of(parts.begin(), parts.end(),
                  [](const PartPlan& part) { return part.kind == "sensor" && part.make && !part.publishes; }))
    return;
  const auto& topics = neighbours.topics();
  const auto matches = [&](const std::string& pattern) {
    if (pattern.starts_with("$") || topics.contains(pattern)) return true;
    if (pattern.find_first_of("+#") == std::string::npos) return false;
    return std::any_of(topics.begin(), topics.end(),
                       [&](const auto& topic) { return topic_matches(pattern, topic.first); });
  };
  std::vector<std::string> names;
  for (const auto& [name, part] : topics) names.push_back(name);
  for (const PartPlan& part : parts) {
    if (!part.stores || !part.make) continue;
    const std::vector<std::string>& patterns = part.stores->topics;
    const ConfigItem& list = child_or_self(part.item, "topics");
    if (patterns.empty()) {
      if (&list != &part.item)
        warnings.add(list.problem("matches-nothing", "the list is empty: nothing goes to this sink"));
      continue;
    }
    std::vector<std::size_t> idle;
    for (std::size_t i = 0; i < patterns.size(); ++i)
      if (!matches(patterns[i])) idle.push_back(i);
    for (const std::size_t i : idle) {
      const ConfigItem* element = list.is_array() ? list.find(i) : nullptr;
      const bool has_suggestion = warnings.size() < most_suggestions;
      warnings.add((element != nullptr ? *element : list)
                       .problem("matches-nothing",
                                "no sensor of this file publishes on \"" + patterns[i] + "\"" +
                                    (idle.size() == patterns.size() ? ", and nothing goes to this sink" : ""),
                                has_suggestion ? nearest_name(patterns[i], names) : ""));
    }
  }
}

void warn_of_units(const std::vector<PartPlan>& parts, Problems& warnings) {
  for (const PartPlan& part : parts) {
    if (!part.publishes || part.publishes->description == nullptr) continue;
    for (const rtdata::Leaf& leaf : part.publishes->description->leaves()) {
      const bool is_coulomb = leaf.unit == "C";
      if (!is_coulomb && leaf.unit != "F") continue;
      const std::string names = detail::lower_case(part.name + " " + part.publishes->topic + " " + leaf.path);
      if (names.find("temp") == std::string::npos) continue;
      const ConfigItem* fields = child_of(part.item, "fields");
      warnings.add((fields != nullptr ? *fields : child_or_self(part.item, "unit"))
                       .problem("unlikely-unit", std::string("the unit ") + (is_coulomb ? "C of " : "F of ") +
                                                     leaf.path + " is the " + (is_coulomb ? "coulomb" : "farad") +
                                                     "; degrees are " + (is_coulomb ? "Cel" : "[degF]")));
      break;
    }
  }
}

void warn_of_recordings(const std::vector<PartPlan>& parts, Problems& warnings) {
  for (const PartPlan& part : parts) {
    if (!part.stores || !part.stores->is_recording) continue;
    const bool is_gone_through = std::any_of(parts.begin(), parts.end(), [&](const PartPlan& other) {
      return other.stores && other.stores->through == part.name;
    });
    if (!is_gone_through) continue;
    const std::string folder = std::filesystem::path(part.stores->path).parent_path().string();
    struct statfs about {};
    if (::statfs(folder.empty() ? "." : folder.c_str(), &about) != 0 || about.f_type != TMPFS_MAGIC) continue;
    warnings.add(child_or_self(part.item, "path")
                     .problem("in-memory",
                              "the recording is on a file system in memory: its backlog for a peer is lost when the "
                              "machine restarts"));
  }
}

void warn_of_senders(const std::vector<PartPlan>& parts, const Neighbours& neighbours, Problems& warnings) {
  const auto is_one_peer = [](const PartPlan& a, const PartPlan& b) {
    const auto is_same = [&](const char* key) {
      const ConfigItem* const of_a = child_of(a.item, key);
      const ConfigItem* const of_b = child_of(b.item, key);
      return of_a == nullptr || of_b == nullptr ? of_a == of_b : *of_a == *of_b;
    };
    const auto keys = {"url", "host", "port", "prefix", "method"};
    const bool has_peer = child_of(a.item, "url") != nullptr || child_of(a.item, "host") != nullptr ||
                          child_of(a.item, "port") != nullptr;
    return a.type == b.type && has_peer && std::all_of(keys.begin(), keys.end(), is_same);
  };
  std::vector<const PartPlan*> senders;
  for (const PartPlan& part : parts) {
    if (!part.stores || !part.stores->is_sender) continue;
    for (const PartPlan* const other : senders) {
      if (!is_one_peer(*other, part)) continue;
      const auto& topics = neighbours.topics();
      const auto shared = std::find_if(topics.begin(), topics.end(), [&](const auto& topic) {
        return other->stores->wants(topic.first) && part.stores->wants(topic.first);
      });
      if (shared == topics.end()) continue;
      warnings.add(part.item.problem("sent-twice", other->object() + ", at " + place_of(other->item) +
                                                       ", sends to the same server: it has each event of topic \"" +
                                                       shared->first + "\" twice; give each its own `topics`"));
    }
    senders.push_back(&part);
  }
}

void warn_of_tiers(const std::vector<PartPlan>& parts, Problems& warnings) {
  std::set<std::string_view> used;
  for (const PartPlan& part : parts) used.insert(part.tier());
  for (const PartPlan& part : parts) {
    if (part.kind == "tier" && !used.contains(part.name))
      warnings.add(part.item.problem("unused-tier", "no sensor runs on tier \"" + part.name + "\""));
  }
}

void warn_of_load(const std::vector<PartPlan>& parts, const std::string& main_loop, Problems& warnings) {
  for (const auto& [tier, there] : parts_by_loop(parts))
    warn_of_loop(tier, tier.empty() ? main_loop : tier, there, warnings);
}

std::vector<LoopLoad> loads_of(const std::vector<PartPlan>& parts, const std::string& main_loop) {
  std::vector<LoopLoad> all;
  for (const auto& [tier, there] : parts_by_loop(parts)) all.push_back(load_of(tier.empty() ? main_loop : tier, there));
  return all;
}

}  // namespace rtdata::config_detail
