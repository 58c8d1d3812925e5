// Wraps text at the width of the terminal. Output to a pipe or file is not changed.
#pragma once

#include <cstddef>
#include <ostream>
#include <streambuf>
#include <string>
#include <string_view>

#include "rtdata/data/error.hpp"

namespace rtdata::app {

/// The columns of the terminal of a file descriptor; 80 if unknown; 0: not a terminal.
std::size_t columns_of(int fd);

/// Breaks lines that are wider than `columns` at blanks. The rest is indented under the last column of a line that
/// looks like a table row, otherwise by two. Longer words are not broken, so that a path can be copied, and neither are
/// lines with escape sequences. `columns` 0: no change.
std::string wrapped(std::string_view text, std::size_t columns);

/// Replaces control characters and bytes that are not UTF-8 by '?', because text from a device or another file must not
/// control the terminal.
std::string printable(std::string_view text);

/// For a terminal with `columns` columns: writes control characters, except line ends and tabs, as \xHH, and wraps as
/// above. `columns` 0: no change.
std::string for_terminal(std::string_view text, std::size_t columns);

/// Prints an error of a command: a line "rtdata: TEXT [ID]". docs/errors.md explains the id.
void print_error(std::ostream& to, const std::string& text, std::string_view id);
void print_error(std::ostream& to, const Error& error);

/// While it lives, wraps lines printed to a stream for the terminal of `fd`, if it is one. For readable text, not for
/// data. Thread: one at a time.
class WrappedOutput final : public std::streambuf {
 public:
  WrappedOutput(std::ostream& stream, int fd);
  WrappedOutput(const WrappedOutput&) = delete;
  WrappedOutput& operator=(const WrappedOutput&) = delete;
  ~WrappedOutput() override;

 protected:
  int overflow(int character) override;
  std::streamsize xsputn(const char* text, std::streamsize size) override;
  int sync() override;

 private:
  bool write_lines();
  std::ostream& stream_;
  std::streambuf* const to_;
  const std::size_t columns_;
  const std::ios::fmtflags flags_;  // of the stream before
  std::string line_;                // the incomplete line
};

}  // namespace rtdata::app
