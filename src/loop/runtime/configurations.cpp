#include "loop/runtime/configurations.hpp"

#include <algorithm>

#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {

void Configurations::note(const ConfigurationChange& change) {
  for (Recorder* recorder : runtime_.recorders) recorder->on_configuration(change);
}

void Configurations::replace(std::string text) {
  state_.changes.clear();
  state_.whole = runtime_.hide(std::move(text));
  note({runtime_.event_now(), "", state_.whole});
}

void Configurations::add(std::string object, std::string text) {
  ConfigurationChange change{runtime_.event_now(), std::move(object), runtime_.hide(std::move(text))};
  const auto [known, is_new] = state_.changes.try_emplace(change.object, Entry{change, false});
  if (!is_new) known->second.change = change;
  note(change);
}

void Configurations::remove(std::string object) {
  ConfigurationChange change{runtime_.event_now(), std::move(object), ""};
  const auto known = state_.changes.try_emplace(change.object, Entry{change, true}).first;
  if (known->second.is_of_text) {
    known->second.change = change;
  } else {
    state_.changes.erase(known);
  }
  note(change);
}

void Configurations::set_told(std::string object, std::string text) {
  if (text.empty() && !told_.contains(object)) return;
  const ConfigurationChange change{runtime_.event_now(), std::move(object), std::move(text)};
  keep_told(change);
  if (runtime_.hub == nullptr) return note(change);
  runtime_.reports.post_to_main([hub = runtime_.hub, change] {
    hub->configurations.keep_told(change);
    hub->configurations.note(change);
  });
}

void Configurations::keep_told(const ConfigurationChange& change) {
  if (change.text.empty())
    told_.erase(change.object);
  else
    told_.insert_or_assign(change.object, change);
}

void Configurations::restore(State state) {
  state_ = std::move(state);
  const Time now = runtime_.event_now();
  note({now, "", state_.whole});
  for (auto& [object, entry] : state_.changes) {
    entry.change.time = now;
    note(entry.change);
  }
}

std::vector<ConfigurationChange> Configurations::changes() const {
  std::vector<ConfigurationChange> all;
  for (const auto& [object, entry] : state_.changes) all.push_back(entry.change);
  std::stable_sort(all.begin(), all.end(), [](const auto& a, const auto& b) { return a.time < b.time; });
  return all;
}

}  // namespace rtdata::detail
