// A program of the user, in its own session.
#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

#include "data/setting_mistake.hpp"
#include "rtdata/data/error.hpp"

namespace rtdata::detail {

/// Its descriptors do not block. `end_child` closes them.
struct Child {
  pid_t pid = -1;     ///< also of its session and process group
  int ended = -1;     ///< a pidfd: readable when the program has ended
  int output = -1;    ///< what it prints
  int errors = -1;    ///< what it writes to its standard error; none if it goes to ours
  int terminal = -1;  ///< the other side of its controlling terminal: when it is closed, the session gets SIGHUP
};

enum class ChildPrints {
  to_pipe,
  to_terminal,
  answers,  ///< to its terminal, from which it reads requests: they are written to `output`. Its errors go to ours
};
/// May block: the program lies on a disk. Errors: not-found, not-permitted, and others of the system.
Result<Child> start_child(const std::vector<std::string>& run, ChildPrints prints);

/// For a path (a first word with "/") to what is there and cannot be started: a folder, or a file without the
/// permission. What is not there may come later.
SettingMistake mistake_in_program(const std::vector<std::string>& run);

/// Sends SIGTERM to the process group, SIGKILL when the program has ended or after 2 s, and closes the descriptors. A
/// separate thread waits for this; the end of this program waits for the thread.
void end_child(const Child& child) noexcept;

/// True if it has ended with status 0.
bool has_succeeded(const Child& child) noexcept;
/// How it has ended, such as "it has ended with status 1"; empty: it runs.
std::string end_of(const Child& child);

}  // namespace rtdata::detail
