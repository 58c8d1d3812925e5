#include "config/plan/neighbours.hpp"

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include "config/plan/part_reader.hpp"
#include "config/read/mistakes.hpp"
#include "data/influx_name.hpp"
#include "data/listed.hpp"
#include "data/lower_case.hpp"
#include "data/name.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/outputs/guard.hpp"

namespace rtdata::config_detail {
namespace {

/// The item with a part's topic: its `topic`, or else its `name`.
const ConfigItem& topic_item(const PartPlan& part) {
  const ConfigItem* topic = child_of(part.item, "topic");
  return topic != nullptr ? *topic : child_or_self(part.item, "name");
}

/// A problem at a part's name: its `name`, or else the item, at its key.
Problem problem_of_name(const PartPlan& part, std::string id, std::string message) {
  const ConfigItem* name = child_of(part.item, "name");
  return name != nullptr ? name->problem(std::move(id), std::move(message))
                         : problem_at_key(part.item, std::move(id), std::move(message));
}

std::string place_of_name(const PartPlan& part) {
  const std::string place = problem_of_name(part, "", "").place.text();
  return place.empty() ? child_or_self(part.item, "name").path() : place;
}

}  // namespace

Neighbours::Neighbours(const Registry& registry, const std::string& configuration) : registry_(registry) {
  if (!configuration.empty()) configuration_.emplace(configuration);
}

void Neighbours::add(const PartPlan& part, Problems& problems) {
  if (part.publishes) check_topic(part, problems);
  if (part.publishes) publishing_.push_back(&part);
  if (!part.place.text.empty()) check_place(part, part.place, problems);
  for (const PartPlan::Place& place : part.more_places) check_place(part, place, problems);
  if (part.stores) {
    if (!part.stores->path.empty() && part.stores->path != "-") check_path(part, problems);
    storing_.push_back({&part});
  }
  check_name(part, problems);
  if (part.kind == "output" && part.item.to_json().size() > OutputGuard::most_bytes)
    problems.add(part.item.problem(
        "bad-value", "the output has more than 64 KiB of settings; the guard of outputs accepts no more"));
  if (part.kind == "output" && ++outputs_ == OutputGuard::most_outputs + 1)
    problems.add(part.item.problem("bad-value", "there are more outputs than the guard of outputs accepts, which is " +
                                                    std::to_string(OutputGuard::most_outputs)));
}

void Neighbours::check_values(const PartPlan& machine, Problems& problems) const {
  const ConfigItem* const states = child_of(machine.item, "states");
  if (states == nullptr) return;
  for (const ConfigChild& state : states->children()) {
    const ConfigItem* const all = child_of(state.item, "set");
    if (all == nullptr) continue;
    std::set<std::string> outputs;
    for (const ConfigChild& one : all->children()) {
      const std::string name = text_or_empty(one.item, "output");
      if (!outputs.insert(name).second)
        problems.add(child_or_self(one.item, "output")
                         .problem("bad-value", "the state sets the output \"" + name + "\" already"));
      const PartPlan* const output = find("output", name);
      if (output == nullptr || !output->refusal) continue;
      const ConfigItem* const given = child_of(one.item, "value");
      double value = 1;
      Problems told;  // problems of the machine
      if (given != nullptr && !ConfigValue<double>::read(*given, value, told)) continue;
      if (const std::string why = output->refusal(value); !why.empty())
        problems.add(child_or_self(one.item, "value")
                         .problem("bad-value", (given == nullptr ? "`value` is 1 unless given: " : "") + why));
    }
  }
}

void Neighbours::check_name(const PartPlan& part, Problems& problems) {
  if (part.name.empty() || (!part.stores && !detail::is_name(part.name))) return;
  const auto [known, is_new] = names_.try_emplace({part.kind, part.name}, &part);
  if (is_new && part.publishes) {
    const auto [other, is_new_origin] = origins_.try_emplace(part.name, &part);
    if (is_new_origin) return;
    problems.add(problem_of_name(part, "duplicate-name",
                                 "there is a " + other->second->kind + " \"" + part.name + "\" already, at " +
                                     place_of_name(*other->second) + ", and events are recorded under that name; " +
                                     "give each a `name` of its own"));
    return;
  }
  if (is_new) return;
  const PartPlan& first = *known->second;
  const bool both_by_default = child_of(part.item, "name") == nullptr && child_of(first.item, "name") == nullptr;
  // Both got their name from the same path, and the path has been reported already.
  if (both_by_default && refused_paths_.contains(&part)) return;
  problems.add(problem_of_name(part, "duplicate-name",
                               "there is a " + part.kind + " \"" + part.name + "\" already, at " +
                                   place_of_name(first) + "; give each a `name` of its own"));
}

void Neighbours::check_place(const PartPlan& part, const PartPlan::Place& taken, Problems& problems) {
  const bool is_on_bus = !taken.bus.empty();
  std::error_code ignored;  // a missing device is identified by its path
  const std::string place = is_on_bus ? taken.text : std::filesystem::weakly_canonical(taken.text, ignored).string();
  const auto [known, is_new] = places_.try_emplace({taken.bus, (place.empty() ? taken.text : place) + taken.more},
                                                   &part);
  if (is_new) return;
  const PartPlan& first = *known->second;
  const bool may_share = !taken.sharing.empty() && !first.place.sharing.empty();
  if (may_share && taken.sharing == first.place.sharing && part.tier() == first.tier()) return;
  if (!is_on_bus) {
    const char* advice = "a device belongs to one sensor or one bus only";
    if (part.kind == first.kind && part.kind == "bus") advice = "one bus is enough for all devices on it";
    if (may_share) advice = "sensors that share a device need the same `baud_rate` and so on, and the same tier";
    problems.add(child_or_self(part.item, "device")
                     .problem("duplicate-place", first.object() + ", at " + place_of(first.item) +
                                                     ", has this device already; " + advice));
    return;
  }
  const std::string key = taken.text.substr(0, taken.text.find(' '));
  const bool is_of_bus = std::any_of(part.uses.begin(), part.uses.end(),
                                     [&](const PartUse& use) { return use.kind == "bus" && use.name == taken.bus; });
  problems.add(child_or_self(part.item, key)
                   .problem("duplicate-place",
                            part.kind + " " + known->second->name + ", at " + place_of(known->second->item) + ", has " +
                                (is_of_bus ? taken.text + " of the bus \"" + taken.bus + "\" already; "
                                           : "the " + taken.bus + " " + taken.text + " already; ") +
                                (!taken.advice.empty() ? taken.advice
                                 : is_of_bus           ? "give each chip its own"
                                                       : "give each part its own")));
}

void Neighbours::check_topic(const PartPlan& part, Problems& problems) {
  const PublishedTopic& published = *part.publishes;
  if (!is_topic_name(published.topic)) return;
  const auto [other_case, is_new_case] = topic_by_lower_case_.try_emplace(detail::lower_case(published.topic), &part);
  if (const PartPlan& other = *other_case->second; other.publishes->topic != published.topic) {
    problems.add(topic_item(part).problem("bad-name", "the topic \"" + published.topic +
                                                          "\" differs in case only from \"" + other.publishes->topic +
                                                          "\", at " + place_of(topic_item(other))));
    return;
  }
  publishers_[published.topic].push_back(&part);
  const auto [known, is_new] = topics_.try_emplace(published.topic, &part);
  if (is_new) topic_names_.push_back(published.topic);
  const PartPlan& first = *known->second;
  if (first.publishes->description == nullptr) known->second = &part;
  if (&first == &part || first.publishes->description == nullptr || published.description == nullptr) return;
  if (first.publishes->description->same_meaning(*published.description)) return;
  std::string message = "the topic \"" + published.topic + "\" carries \"" + first.publishes->description->name() +
                        "\" of " + first.kind + " " + first.name + ", at " + place_of(topic_item(first)) + ", and \"" +
                        published.description->name() + "\" of this one";
  for (const std::string& difference : first.publishes->description->differences(*published.description))
    message += "; " + difference;
  message += "; give one of them a topic of its own";
  problems.add(topic_item(part).problem("description-differs", std::move(message)));
}

std::string Neighbours::conflict_with_configuration(const WrittenFile& written) const {
  if (!configuration_) return "";
  if (written.identity.is_same(*configuration_)) return "this is the configuration; choose another file";
  if (configuration_->is_companion_file(written.identity, written.is_companion_file))
    return "the configuration would be taken for a file beside \"" + written.path + "\"; choose another file";
  return "";
}

/// Why the file cannot be written; empty: it can. A part may write several topics into one file, but not a file that is
/// a companion of another.
std::string Neighbours::conflict_with_files(const KnownFile& written) const {
  if (std::string why = conflict_with_configuration(written.file); !why.empty()) return why;
  for (const KnownFile& known : files_) {
    if (known.part == written.part && known.file.path == written.file.path) continue;
    if (std::string why = conflict(written.file, known.file); !why.empty()) return why;
  }
  return "";
}

void Neighbours::check_path(const PartPlan& part, Problems& problems) {
  KnownFile written{written_file(part, part.stores->path), &part};
  if (const std::string why = conflict_with_files(written); !why.empty()) {
    refused_paths_.insert(&part);
    problems.add(child_or_self(part.item, "path").problem("duplicate-path", why));
  } else {
    files_.push_back(std::move(written));
  }
}

void Neighbours::check_file_of(const PartPlan& part, const std::string& topic, Problems& problems) {
  const std::string file = part.stores->file_of_topic(topic);
  if (file.empty() || file == part.stores->path) return;
  KnownFile written{written_file(part, file), &part};
  if (const std::string why = conflict_with_files(written); !why.empty()) {
    problems.add(
        child_or_self(part.item, "path")
            .problem("duplicate-path", "the events of topic \"" + topic + "\" go to \"" + file + "\": " + why));
  } else {
    files_.push_back(std::move(written));
  }
}

void Neighbours::check_files_of_topics(Problems& problems) {
  for (Storing& storing : storing_) {
    const PartPlan& part = *storing.part;
    const bool has_files = part.stores->file_of_topic && !refused_paths_.contains(&part);
    for (; storing.files < topic_names_.size(); ++storing.files) {
      const std::string& topic = topic_names_[storing.files];
      if (has_files && part.stores->wants(topic)) check_file_of(part, topic, problems);
    }
  }
}

void Neighbours::check_stored_topics(Problems& problems) {
  check_written_names(problems);
  for (Storing& storing : storing_) {
    const StoredTopics& stores = *storing.part->stores;
    const std::size_t first_new = std::exchange(storing.stored, topic_names_.size());
    if (!stores.refused_topics) continue;
    // All topics, because a new topic may conflict with one that is already stored.
    std::vector<TopicToRecord> wanted;
    std::size_t known = 0;
    for (std::size_t i = 0; i < topic_names_.size(); ++i) {
      const std::string& topic = topic_names_[i];
      if (!stores.wants(topic)) continue;
      wanted.push_back({topic, topics_.find(topic)->second->publishes->description.get()});
      if (i < first_new) ++known;
    }
    if (wanted.size() == known) continue;
    const bool was_refused = known > 0 &&
                             !stores
                                  .refused_topics({wanted.begin(), wanted.begin() + static_cast<std::ptrdiff_t>(known)})
                                  .empty();
    if (was_refused) continue;  // reported when those were added
    // The same error for several topics is reported once.
    const std::vector<Error> errors = stores.refused_topics(wanted);
    for (auto first = errors.begin(); first != errors.end();) {
      const auto next = std::find_if(first, errors.end(), [&](const Error& error) {
        return error.where != first->where || error.why != first->why;
      });
      Error error = *first;
      if (next - first > 1) error.what += " (and " + std::to_string(next - first - 1) + " more)";
      problems.add(child_or_self(storing.part->item, "path").problem("cannot-record", error.text()));
      first = next;
    }
  }
}

/// Each event with such a name would be refused.
void Neighbours::check_written_names(Problems& problems) {
  for (Storing& storing : storing_) {
    const PartPlan& sink = *storing.part;
    const bool is_influx = text_or_empty(sink.item, "format") == "influx";
    for (; storing.named < publishing_.size(); ++storing.named) {
      const PartPlan& part = *publishing_[storing.named];
      const std::string& topic = part.publishes->topic;
      if (!is_influx || !sink.stores->wants(topic)) continue;
      const std::string
          why = " cannot be in the lines of InfluxDB that the sink at " + place_of(sink.item) +
                " writes: they have no way to write a line break, nor a backslash at the end or before a "
                "comma, a blank, = or another; give it another name, or remove it from the `topics` there";
      if (!detail::fits_influx_name(topic)) {
        problems.add(topic_item(part).problem("cannot-record", "the topic \"" + topic + "\"" + why));
      } else if (!detail::fits_influx_name(part.name)) {
        problems.add(problem_of_name(part, "cannot-record", "the name \"" + part.name + "\"" + why));
      }
    }
  }
}

void Neighbours::assume_stored() {
  for (Storing& storing : storing_) {
    storing.stored = topic_names_.size();
    storing.named = publishing_.size();
  }
}

void Neighbours::add_log(const LogSettings& log, const ConfigItem& at, Problems& problems) {
  if (log.file.empty()) return;
  KnownFile written{
      {log.file, "the log",
       [log](const std::string& full, const std::string& other) { return is_rotated_log(log, full, other); }},
      nullptr};
  if (const std::string why = conflict_with_configuration(written.file); !why.empty()) {
    problems.add(at.problem("duplicate-path", why));
    return;
  }
  for (const KnownFile& known : files_) {
    const std::string why = conflict(written.file, known.file);
    if (why.empty()) continue;
    problems.add(at.problem("duplicate-path", why + " for the log"));
    return;
  }
  files_.push_back(std::move(written));
}

const PartPlan* Neighbours::find(std::string_view kind, std::string_view name) const {
  const auto found = names_.find({std::string(kind), std::string(name)});
  return found != names_.end() ? found->second : nullptr;
}

const std::vector<const PartPlan*>& Neighbours::publishers(const std::string& topic) const {
  static const std::vector<const PartPlan*> none;
  const auto found = publishers_.find(topic);
  return found != publishers_.end() ? found->second : none;
}

std::string Neighbours::suggestion(const PartUse& use) {
  if (++suggestions_ > most_suggestions) return "";
  std::vector<std::string> names;
  if (use.kind == "topic") {
    names = topic_names_;
  } else {
    for (const auto& [key, part] : names_)
      if (key.first == use.kind) names.push_back(key.second);
  }
  return nearest_name(use.name, names);
}

/// A part of another kind that has the name.
const PartPlan* Neighbours::namesake_of(const PartUse& use) const {
  if (const PartPlan* tier = find("tier", use.name)) return tier;
  for (const PartKind& kind : registry_.kinds())
    if (const PartPlan* part = find(kind.name, use.name)) return part;
  return nullptr;
}

void Neighbours::check_through(const PartPlan& part, Problems& problems) const {
  const ConfigItem& at = child_or_self(part.item, "through");
  if (part.stores->is_recording) {
    problems.add(at.problem("wrong-part", "a recording cannot go through another recording; remove `through`"));
    return;
  }
  const PartPlan* recording = find("sink", part.stores->through);
  if (recording == nullptr || !recording->stores || !recording->stores->is_recording) return;
  std::vector<std::string> names(topic_names_.begin(), topic_names_.end());
  names.insert(names.end(), {account_topic, health_topic});
  for (const std::string& topic : names) {
    if (!part.stores->wants(topic) || recording->stores->wants(topic)) continue;
    problems.add(at.problem("not-recorded", "the topic \"" + topic + "\" is not among those of the recording, at " +
                                                place_of(recording->item) + ", so that this sink would never get it; " +
                                                "add it to the `topics` there"));
  }
}

void Neighbours::check_stored_by(const PartPlan& part, Problems& problems) const {
  const PartPlan* sink = find("sink", part.stored_by);
  if (sink == nullptr || !sink->stores || !part.publishes) return;
  const auto use = std::find_if(part.uses.begin(), part.uses.end(),
                                [&](const PartUse& one) { return one.kind == "sink" && one.name == part.stored_by; });
  const ConfigItem& at = use != part.uses.end() ? use->item : child_or_self(part.item, "stored_by");
  const std::string name = "the sink " + ConfigItem::of(part.stored_by).to_json() + ", at " + place_of(sink->item) +
                           ",";
  if (!sink->stores->through.empty()) {
    problems.add(at.problem("wrong-part", name + " goes through a recording itself: name that recording"));
  } else if (!sink->stores->wants(part.publishes->topic)) {
    problems.add(at.problem("not-recorded", name + " does not take the topic \"" + part.publishes->topic +
                                                "\"; add it to the `topics` there"));
  } else if (sink->tier() != part.tier()) {
    problems.add(at.problem("wrong-part", name + " is on another loop; give both the same `tier`, or none"));
  }
  if (part.kind != "machine") return;
  // A recording with limits keeps the last row of each topic, from which the machine and its outputs resume.
  const auto check_alone = [&](const PartPlan& one) {
    for (const PartPlan* other : publishers(one.publishes->topic))
      if (other != &one)
        problems.add(
            at.problem("wrong-part", one.object() + " shares the topic \"" + one.publishes->topic + "\" with " +
                                         other->object() + ", at " + place_of_name(*other) +
                                         ": a machine and its outputs resume from the last event of their topic: "
                                         "each needs its own topic"));
  };
  check_alone(part);
  for (const PartUse& output : part.uses) {
    const PartPlan* plan = output.kind == "output" ? find("output", output.name) : nullptr;
    if (plan != nullptr && plan->publishes) check_alone(*plan);
  }
}

void Neighbours::check_uses(const PartPlan& part, Problems& problems) {
  if (part.kind == "machine") check_values(part, problems);
  if (!part.stored_by.empty()) check_stored_by(part, problems);
  if (part.stores && !part.stores->through.empty()) check_through(part, problems);
  if (part.check_topics) {
    const auto payload_of = [this](std::string_view topic) -> const Description* {
      // Follows the topics that pass events on, which may form a cycle.
      for (std::size_t i = 0; i <= topics_.size(); ++i) {
        const auto known = topics_.find(topic);
        if (known == topics_.end()) return nullptr;
        const PublishedTopic& published = *known->second->publishes;
        if (published.in_expressions || published.description != nullptr || known->second->passes_on.empty())
          return published.in_expressions.value_or(published.description).get();
        topic = known->second->passes_on;
      }
      return nullptr;
    };
    part.check_topics(part, payload_of, problems);
  }
  for (const PartUse& use : part.uses) {
    if (use.kind == "topic") {
      const std::vector<const PartPlan*>& from = publishers(use.name);
      const auto resumes = std::find_if(from.begin(), from.end(),
                                        [](const PartPlan* one) { return !one->stored_by.empty(); });
      if (part.kind == "output" && resumes != from.end())
        problems.add(use.item.problem("wrong-part",
                                      (*resumes)->object() + ", at " + place_of_name(**resumes) +
                                          ", resumes from its recording: this output would act before the change is "
                                          "stored. Set the output in the machine's states (`set`) instead"));
      if (!from.empty()) continue;
      problems.add(use.item.problem("unknown-topic", "nothing of this configuration publishes on \"" + use.name + "\"",
                                    suggestion(use)));
      continue;
    }
    const std::string name = ConfigItem::of(use.name).to_json();
    const PartPlan* other = find(use.kind, use.name);
    if (other == nullptr) {
      const PartKind* kind = find_kind(registry_, use.kind);
      std::string message = "there is no " + use.kind + " " + name + " in `" +
                            (kind != nullptr ? kind->key : use.kind + "s") + "`";
      std::string nearest = suggestion(use);
      if (const PartPlan* namesake = nearest.empty() ? namesake_of(use) : nullptr)
        message += "; that is the name of a " + namesake->kind + ", at " + place_of_name(*namesake);
      problems.add(use.item.problem("unknown-" + use.kind, std::move(message), std::move(nearest)));
      continue;
    }
    if (use.kind == "bus" && other->give_up_after > Duration{0} && part.holds_bus >= other->give_up_after) {
      problems.add(use.item.problem("bad-value", "the bus " + name + ", at " + place_of_name(*other) +
                                                     ", gives up after " + to_string(other->give_up_after) +
                                                     ", and this chip needs more than " + to_string(part.holds_bus) +
                                                     " at a time; give the bus a longer `timeout`"));
      continue;
    }
    if (use.kind == "output") {
      const bool follows = !text_or_empty(other->item, "on").empty();
      if (follows || other->tier() != part.tier())
        problems.add(use.item.problem("wrong-part", "the output " + name + ", at " + place_of_name(*other) +
                                                        (follows ? ", follows a topic, and nothing else sets it"
                                                                 : ", is on another loop; give both the same `tier`")));
      continue;
    }
    const bool is_known = other->make != nullptr && !use.types.empty();
    if (!is_known) continue;
    if (std::find(use.types.begin(), use.types.end(), other->type) != use.types.end()) {
      if (use.kind == "bus" && !part.place.bus_type.empty() && part.place.bus_type != other->type)
        problems.add(use.item.problem("wrong-part", "the bus " + name + ", at " + place_of_name(*other) +
                                                        ", is of type " + other->type + ", which has no " +
                                                        part.place.text + "; " + part.place.advice_on_other));
      continue;
    }
    problems.add(use.item.problem("wrong-part", "the " + use.kind + " " + name + ", at " + place_of_name(*other) +
                                                    ", is of type " + other->type + "; this needs " +
                                                    detail::listed(use.types)));
  }
}

}  // namespace rtdata::config_detail
