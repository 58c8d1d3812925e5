// Programs that benchmarks start.
#pragma once

#include <fcntl.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <string>
#include <vector>

extern char** environ;

namespace bench {

/// A child process, its standard output and errors thrown away unless a file is given for the output.
inline pid_t start(const std::vector<std::string>& command, const char* output = "/dev/null") {
  std::vector<char*> arguments;
  for (const std::string& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 1, output, O_WRONLY | O_CREAT | O_TRUNC, 0600);
  posix_spawn_file_actions_addopen(&actions, 2, "/dev/null", O_WRONLY, 0);
  pid_t child = -1;
  if (::posix_spawn(&child, arguments[0], &actions, nullptr, arguments.data(), environ) != 0) child = -1;
  posix_spawn_file_actions_destroy(&actions);
  return child;
}

/// CPU s of a child process that has ended or ends by itself; 0: it failed.
inline double cpu_seconds(pid_t child) {
  int status = -1;
  rusage usage{};
  if (child <= 0 || ::wait4(child, &status, 0, &usage) != child || status != 0) return 0;
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_usec) / 1e6;
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

/// The folder in which programs run; removed at the end.
class Folder {
 public:
  explicit Folder(const std::string& under) : before_(std::filesystem::current_path()) {
    const auto path = std::filesystem::absolute(under) / ("rtdata_bench." + std::to_string(::getpid()));
    std::filesystem::create_directory(path);
    std::filesystem::current_path(path);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  ~Folder() {
    const auto path = std::filesystem::current_path();
    std::filesystem::current_path(before_);
    std::error_code ignored;
    std::filesystem::remove_all(path, ignored);
  }

 private:
  std::filesystem::path before_;
};

/// A program beside this one.
inline std::string beside(const char* name) {
  return (std::filesystem::read_symlink("/proc/self/exe").parent_path() / name).string();
}

}  // namespace bench
