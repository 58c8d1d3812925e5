// The running instances that a command line means.
#pragma once

#include <optional>
#include <string>

#include "app/control/control_socket.hpp"
#include "app/control/status.hpp"

namespace rtdata::app {

/// What is sent to an instance to hear how it stands.
inline constexpr const char* status_request = R"({"request":"status"})";

struct FoundInstance {
  Instance instance;
  std::optional<ControlClient> client;  // none: it takes no connection
  bool answers = false;
  std::string name;           // empty: not known
  std::string configuration;  // or why nothing is known

  /// By name or pid; every one when none is given.
  bool matches(const std::string& wanted) const {
    return wanted.empty() || wanted == name || wanted == std::to_string(instance.pid);
  }
  void hear(Duration at_most);
};

/// The one that is meant, by name or pid; empty: the only one. It is connected, and was asked for its status, which it
/// may not have sent yet. None: why was printed, and `status` is what the program is to exit with.
std::optional<FoundInstance> choose_instance(const std::string& wanted, const char* command, int& status);

/// Whether a running instance has this name or pid.
bool is_instance(const std::string& word);

Error instance_does_not_answer();

}  // namespace rtdata::app
