// The table of a machine: its states and transitions. Private to the machine.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/fsm/machine.hpp"

namespace rtdata::fsm::detail {

/// What makes a machine try its transitions: a named event, by its number, or any other.
inline constexpr std::uint16_t any_event = 0xffff;
/// As any_event, but without an event: time has passed, or the program asked. Hold times only count events.
inline constexpr std::uint16_t no_event = 0xfffe;

struct StateEntry;

// The members needed for each event come first.
struct TransitionEntry {
  std::uint16_t on;         // any_event: it waits for none
  bool is_removed = false;  // destroyed when no action runs
  StateEntry& to;
  Condition when;
  Duration after;
  Duration hold;
  std::optional<Time> since{};  // since when its condition has been true, with `hold`
  std::string cause;
};

/// A state with the transitions out of it.
struct StateEntry {
  std::string name;
  std::unique_ptr<State> code;
  bool is_final;
  bool has_check;  // it has its own check
  std::vector<std::unique_ptr<TransitionEntry>> ways{};
};

/// Thread: the machine's loop's. Removed entries stay until `tidy`, because they may be on the stack.
class MachineTable {
 public:
  explicit MachineTable(const std::string& machine) : object_("machine " + machine) {}

  void add_state(std::string name, std::unique_ptr<State> code, bool is_final, bool has_check);
  /// Removes a state with all transitions to it.
  void remove_state(StateEntry& state);
  /// Returns the state of its start.
  StateEntry& add_transition(Transition transition);
  /// Returns the number of removed transitions.
  std::size_t remove_transitions(std::string_view from, std::string_view to);
  bool has_removed() const noexcept { return has_removed_; }
  /// Destroys the removed entries.
  void tidy();
  void clear() noexcept;

  /// None: null.
  StateEntry* find(std::string_view name) const noexcept;
  /// Throws SetupError if it does not exist; `what` names the failed action.
  StateEntry& entry(std::string_view name, const char* what) const;
  /// any_event: no transition waits for an event with this name.
  std::uint16_t event_number(std::string_view name) const noexcept {
    const auto found = std::find(events_.begin(), events_.end(), name);
    return found == events_.end() ? any_event : static_cast<std::uint16_t>(found - events_.begin());
  }
  /// By their numbers.
  const std::vector<std::string>& events() const noexcept { return events_; }
  /// `start`: the name of its first state.
  Graph graph(const std::string& machine, const std::string& start) const;

  [[noreturn]] void refuse(Errc code, const char* what, std::string_view of, std::string why, std::string advice) const;

 private:
  void check_name(const std::string& name, const char* what) const;

  const std::string object_;  // in errors
  std::vector<std::unique_ptr<StateEntry>> states_;
  std::vector<std::unique_ptr<StateEntry>> removed_;
  bool has_removed_ = false;  // of these, or of ways
  std::vector<std::string> events_;
};

}  // namespace rtdata::fsm::detail
