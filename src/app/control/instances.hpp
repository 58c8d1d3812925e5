// Finds the running instance for a command line.
#pragma once

#include <optional>
#include <string>

#include "app/control/control_socket.hpp"
#include "app/control/status.hpp"

namespace rtdata::app {

/// The request for the status of an instance.
inline constexpr const char* status_request = R"({"request":"status"})";

struct FoundInstance {
  Instance instance;
  std::optional<ControlClient> client;  // empty: it accepts no connection
  bool answers = false;
  std::string name;           // empty: unknown
  std::string configuration;  // or why the status is unknown

  /// By name or pid; an empty text matches every instance.
  bool matches(const std::string& wanted) const {
    return wanted.empty() || wanted == name || wanted == std::to_string(instance.pid);
  }
  void hear(Duration at_most);
};

/// The instance with this name or pid; empty: the only one. It is connected, and its status was requested but may not
/// have arrived yet. Empty result: the reason was printed, and `status` is the exit status of the program.
std::optional<FoundInstance> choose_instance(const std::string& wanted, const char* command, int& status);

/// True if a running instance has this name or pid.
bool is_instance(const std::string& word);

Error instance_does_not_answer();

}  // namespace rtdata::app
