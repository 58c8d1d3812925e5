// A program run by a test, with its output read through pipes or a pseudo terminal.
#pragma once

#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <spawn.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string>
#include <vector>

namespace rtdata::test {

/// A directory of its own, removed at the end.
class Folder {
 public:
  Folder() {
    char name[] = "/tmp/rtdata_program_XXXXXX";
    path_ = ::mkdtemp(name);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  const std::string& path() const { return path_; }
  void write(const std::string& name, const std::string& text) const { std::ofstream(path_ + "/" + name) << text; }
  std::string read(const std::string& name) const {
    std::ifstream file(path_ + "/" + name);
    std::ostringstream text;
    text << file.rdbuf();
    return text.str();
  }
  bool has(const std::string& name) const { return std::filesystem::exists(path_ + "/" + name); }

 private:
  std::string path_;
};

/// A child process. What it writes is collected by `wait_for` and `end`; both give up after a minute.
class Process {
 public:
  enum class Output { pipes, terminal, one_terminal };  // of 80 columns: standard output alone, or errors on it too

  Process(const Folder& folder, const std::string& executable, std::vector<std::string> arguments,
          Output output = Output::pipes) {
    int out_child = -1;
    int err_child = -1;
    int fds[2];
    if (output != Output::pipes) {
      winsize size{24, 80, 0, 0};
      if (::openpty(&out_, &out_child, nullptr, nullptr, &size) != 0) return;
    } else if (::pipe2(fds, O_CLOEXEC) == 0) {
      out_ = fds[0];
      out_child = fds[1];
    }
    if (output == Output::one_terminal) {
      err_child = ::fcntl(out_child, F_DUPFD_CLOEXEC, 0);
      err_open_ = false;
    } else if (::pipe2(fds, O_CLOEXEC) == 0) {
      err_ = fds[0];
      err_child = fds[1];
    }
    ::fcntl(out_, F_SETFD, FD_CLOEXEC);
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
    ::posix_spawn_file_actions_adddup2(&actions, out_child, 1);
    ::posix_spawn_file_actions_adddup2(&actions, err_child, 2);
    ::posix_spawn_file_actions_addchdir_np(&actions, folder.path().c_str());
    std::vector<char*> argv;
    arguments.insert(arguments.begin(), executable);
    // Where these tests run in an emulator of another processor, so does what they start: tests/arm/run.sh.
    if (const char* emulator = std::getenv("RTDATA_TEST_EMULATOR"); emulator != nullptr) {
      std::istringstream words(emulator);
      arguments.insert(arguments.begin(), std::istream_iterator<std::string>(words), {});
    }
    for (std::string& argument : arguments) {
      argv.push_back(argument.data());
      command_ += (command_.empty() ? "" : " ") + argument;
    }
    argv.push_back(nullptr);
    // Under nohup, too, it hears every signal.
    posix_spawnattr_t attributes;
    ::posix_spawnattr_init(&attributes);
    sigset_t signals;
    ::sigfillset(&signals);
    ::posix_spawnattr_setsigdefault(&attributes, &signals);
    ::sigemptyset(&signals);
    ::posix_spawnattr_setsigmask(&attributes, &signals);
    ::posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSIGMASK);
    if (::posix_spawn(&pid_, argv[0], &actions, &attributes, argv.data(), environ) != 0) pid_ = -1;
    ::posix_spawnattr_destroy(&attributes);
    ::posix_spawn_file_actions_destroy(&actions);
    ::close(out_child);
    ::close(err_child);
    living().push_back(this);
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;
  ~Process() {
    if (pid_ > 0) {
      ::kill(pid_, SIGKILL);
      ::waitpid(pid_, nullptr, 0);
    }
    ::close(out_);
    ::close(err_);
    std::erase(living(), this);
  }

  /// What those that live have written so far: shown with a check that fails.
  static std::string all_output() {
    std::string text;
    for (const Process* one : living())
      text += one->command_ + "\n--- stdout\n" + one->out + "--- stderr\n" + one->err + "---\n";
    return text;
  }

  void signal(int number) const {
    if (pid_ > 0) ::kill(pid_, number);
  }
  /// True when this text has been written, on either of the two.
  bool wait_for(const std::string& text) {
    const auto is_there = [&] { return out.find(text) != std::string::npos || err.find(text) != std::string::npos; };
    while (!is_there()) {
      if (!collect()) return is_there();
    }
    return true;
  }
  /// Waits for its end: the exit status, or 128 + the signal that ended it; -1 when it did not end.
  int end() {
    while (collect()) {
    }
    if (pid_ <= 0) return -1;
    int status = 0;
    if (::waitpid(pid_, &status, std::chrono::steady_clock::now() < limit_ ? 0 : WNOHANG) != pid_) return -1;
    pid_ = -1;
    return WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
  }

  std::string out;
  std::string err;

 private:
  /// False when both have ended, or time is up.
  bool collect() {
    pollfd fds[2] = {{out_open_ ? out_ : -1, POLLIN, 0}, {err_open_ ? err_ : -1, POLLIN, 0}};
    if (!out_open_ && !err_open_) return false;
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(limit_ - std::chrono::steady_clock::now())
                          .count();
    if (left <= 0 || ::poll(fds, 2, static_cast<int>(left)) <= 0) return false;
    const auto take = [](const pollfd& from, std::string& to, bool& is_open) {
      if (from.revents == 0) return;
      char buffer[4096];
      const ssize_t size = ::read(from.fd, buffer, sizeof buffer);
      if (size > 0) {
        to.append(buffer, static_cast<std::size_t>(size));
      } else {
        is_open = false;
      }
    };
    take(fds[0], out, out_open_);
    take(fds[1], err, err_open_);
    return true;
  }

  std::chrono::steady_clock::time_point limit_ = std::chrono::steady_clock::now() + std::chrono::seconds{60};
  static std::vector<Process*>& living() {
    static std::vector<Process*> processes;
    return processes;
  }

  std::string command_;
  pid_t pid_ = -1;
  int out_ = -1;
  int err_ = -1;
  bool out_open_ = true;
  bool err_open_ = true;
};

}  // namespace rtdata::test
