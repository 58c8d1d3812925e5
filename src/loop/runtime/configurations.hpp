// The configuration of a run as it stands: its text, and the parts that were added, changed or removed since.
#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

class RuntimeCore;

/// Thread: the loop's.
class Configurations {
 public:
  Configurations(RuntimeCore& runtime, std::string text) : runtime_(runtime), state_{std::move(text), {}} {}

  /// From now on this is the text of all. The recordings keep it, as they keep the next.
  void replace(std::string text);
  /// From now on there is this part ("sensor chamber"), of this item.
  void add(std::string object, std::string text);
  void remove(std::string object);
  /// From now on the samples of this sensor are processed so; empty: not at all. Of a tier, the main loop keeps it.
  void set_process(const std::string& sensor, std::string text);

  /// The text of all, and the changes since that still hold, in the order of their times: for a recording that begins.
  const std::string& whole() const noexcept { return state_.whole; }
  std::vector<ConfigurationChange> changes() const;
  /// How sensors are processed now, by their names.
  const std::map<std::string, ConfigurationChange>& processes() const noexcept { return processes_; }

  struct Entry {
    ConfigurationChange change;
    bool is_of_text;  ///< the text of all has a part of that name
  };
  struct State {
    std::string whole;
    std::map<std::string, Entry> changes;  ///< by object: so many as there are parts
  };
  const State& state() const noexcept { return state_; }
  /// It is again as it was; the recordings keep the text, and each of those changes.
  void restore(State state);

 private:
  void note(const ConfigurationChange& change);

  RuntimeCore& runtime_;
  State state_;
  std::map<std::string, ConfigurationChange> processes_;
};

}  // namespace rtdata::detail
