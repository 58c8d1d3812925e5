// Text as wide as the terminal that it goes to. What goes elsewhere (a pipe, a file) is not touched.
#pragma once

#include <cstddef>
#include <ostream>
#include <streambuf>
#include <string>
#include <string_view>

namespace rtdata::app {

/// Columns of the terminal behind a file descriptor, 80 where it does not know; 0: there is none.
std::size_t columns_of(int fd);

/// Breaks lines that are wider than `columns` at blanks. What is broken off hangs under the last column of a line that
/// looks like one of a table, else two to the right of its beginning. A word that is wider stays whole, so that a path
/// can be copied; so do lines with escape sequences. `columns` 0: the text as it is.
std::string wrapped(std::string_view text, std::size_t columns);

/// With '?' for control characters, and bytes that are no UTF-8: what a device or somebody else's file says must not
/// command the terminal.
std::string printable(std::string_view text);

/// For a terminal of so many columns: control characters but line ends and tabs as \xHH, and broken as above. `columns`
/// 0: the text as it is.
std::string for_terminal(std::string_view text, std::size_t columns);

/// While it lives, lines printed to a stream are made for the terminal behind `fd`, if there is one. For what is
/// read by people, never for data. Thread: one prints.
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
  std::string line_;                // that is not complete
};

}  // namespace rtdata::app
