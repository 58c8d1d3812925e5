// The present configuration of a run: its text, and the parts added, changed or removed since.
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

  /// Replaces the whole text. Recordings store this and the following changes.
  void replace(std::string text);
  /// Adds a part ("sensor chamber") with its item.
  void add(std::string object, std::string text);
  void remove(std::string object);
  /// Sets the text that recordings get about a sensor besides its item, such as its processing; empty: none. For a
  /// sensor on a tier, the main loop stores it.
  void set_told(std::string object, std::string text);

  /// The whole text, and the valid changes since in order of time, for a recording that begins.
  const std::string& whole() const noexcept { return state_.whole; }
  std::vector<ConfigurationChange> changes() const;
  /// The current texts, by object.
  const std::map<std::string, ConfigurationChange>& told() const noexcept { return told_; }

  struct Entry {
    ConfigurationChange change;
    bool is_of_text;  ///< the whole text has a part of that name
  };
  struct State {
    std::string whole;
    std::map<std::string, Entry> changes;  ///< by object: at most as many as there are parts
  };
  const State& state() const noexcept { return state_; }
  /// Restores an earlier state; recordings store the text and each of its changes.
  void restore(State state);

 private:
  void note(const ConfigurationChange& change);
  void keep_told(const ConfigurationChange& change);

  RuntimeCore& runtime_;
  State state_;
  std::map<std::string, ConfigurationChange> told_;
};

}  // namespace rtdata::detail
