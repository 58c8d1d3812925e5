#include "app/control/terminal.hpp"

#include <poll.h>
#include <signal.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <iostream>

namespace rtdata::app {
namespace {

constexpr Duration signal_check = std::chrono::milliseconds{50};

volatile sig_atomic_t interrupted = 0;

}  // namespace

Terminal::Terminal() {
  struct sigaction action {};
  action.sa_handler = [](int) { interrupted = 1; };
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) ::sigaction(signal, &action, nullptr);
  is_changed_ = ::tcgetattr(STDIN_FILENO, &before_) == 0;
  if (!is_changed_) return;
  termios now = before_;
  now.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
  ::tcsetattr(STDIN_FILENO, TCSANOW, &now);
}

Terminal::~Terminal() {
  if (is_changed_) ::tcsetattr(STDIN_FILENO, TCSANOW, &before_);
}

bool Terminal::wait(Duration duration) {
  const auto until = std::chrono::steady_clock::now() + duration;
  while (interrupted == 0) {
    const Duration left = std::clamp<Duration>(until - std::chrono::steady_clock::now(), Duration{0}, signal_check);
    pollfd keys{has_keys_ ? STDIN_FILENO : -1, POLLIN, 0};
    const auto left_ms = std::chrono::ceil<std::chrono::milliseconds>(left).count();
    if (::poll(&keys, 1, static_cast<int>(left_ms)) <= 0) {
      if (left == Duration{0}) return interrupted == 0;
      continue;
    }
    char key = 0;
    if (::read(STDIN_FILENO, &key, 1) != 1) {
      has_keys_ = false;
    } else if (key == 'q' || key == 'Q') {
      return false;
    }
  }
  return false;
}

TerminalSize terminal_size() {
  winsize size{};
  if (::ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) != 0 || size.ws_col == 0) return {};
  return {size.ws_col, std::max<std::size_t>(size.ws_row, 4)};
}

HiddenCursor::HiddenCursor(bool is_hidden) : is_hidden_(is_hidden) {
  if (is_hidden_) print("\x1b[?25l\x1b[2J");
}
HiddenCursor::~HiddenCursor() {
  if (is_hidden_) print("\r\x1b[K\x1b[?25h");
}

void print(const std::string& text) { std::cout << text << std::flush; }

}  // namespace rtdata::app
