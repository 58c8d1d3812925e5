// The terminal of a view that runs until somebody ends it. Private to the program.
#pragma once

#include <termios.h>

#include <cstddef>
#include <string>

#include "rtdata/data/time.hpp"

namespace rtdata::app {

/// Switches the terminal to single keys without echo; Ctrl-C ends the view, not the process. One at a time; its owner's
/// thread.
class Terminal {
 public:
  Terminal();
  Terminal(const Terminal&) = delete;
  Terminal& operator=(const Terminal&) = delete;
  ~Terminal();
  /// False: end, because q was typed or a signal came.
  bool wait(Duration duration);

 private:
  termios before_{};
  bool is_changed_ = false;
  bool has_keys_ = true;
};

/// Of the terminal of standard output.
struct TerminalSize {
  std::size_t columns = 80, rows = 24;
};
TerminalSize terminal_size();

/// While a picture is drawn again and again: hides the cursor, and shows it afterwards, whatever ends the view.
class HiddenCursor {
 public:
  /// False: pictures are not drawn over each other.
  explicit HiddenCursor(bool is_hidden);
  HiddenCursor(const HiddenCursor&) = delete;
  HiddenCursor& operator=(const HiddenCursor&) = delete;
  ~HiddenCursor();

 private:
  const bool is_hidden_;
};

/// Writes at once.
void print(const std::string& text);

}  // namespace rtdata::app
