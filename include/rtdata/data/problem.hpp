/// Problems: all mistakes of a configuration together.
///
/// Reading a configuration never stops at the first mistake. Each one becomes a `Problem` with a stable id, the place
/// in the file, the path in the tree, a sentence and, where a name was probably mistyped, the name that was meant:
///
///     bench.json:7:43: sensors[0].rtae: unknown key (did you mean "rate"?) [unknown-key]
///
/// docs/errors.md explains every id. The ids do not change between versions.
///
/// Values; any thread.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/error.hpp"

namespace rtdata {

/// A place in a configuration file. Lines and columns count from 1; a column is a character (a UTF-8 code point; a tab
/// is one), not a byte. Line 0: the file as a whole, or, with an empty `file`, something a program made.
struct ConfigPlace {
  std::string file;
  std::size_t line = 0;
  std::size_t column = 0;

  /// "bench.json:7:43", "bench.json" or "".
  std::string text() const;
  bool operator==(const ConfigPlace&) const = default;
};

/// One mistake in a configuration.
struct Problem {
  std::string id;          ///< "unknown-key"
  ConfigPlace place;       ///< where it is
  std::string path;        ///< "sensors[0].rtae", empty for the root
  std::string message;     ///< "unknown key"
  std::string suggestion;  ///< the name that was probably meant, or empty

  /// `file:line:column: path: message (did you mean "rate"?)`, without the empty parts.
  std::string text() const;
  /// The text for users: text() and the id in brackets.
  std::string text_with_id() const;
  /// The same as an error of code bad-configuration.
  Error error() const;
  bool operator==(const Problem&) const = default;
};

/// A list of problems, in the order they were found.
class Problems {
 public:
  using const_iterator = std::vector<Problem>::const_iterator;

  void add(Problem problem) { list_.push_back(std::move(problem)); }
  void add(std::string id, ConfigPlace place, std::string path, std::string message, std::string suggestion = {});
  void append(const Problems& others);

  bool empty() const noexcept { return list_.empty(); }
  std::size_t size() const noexcept { return list_.size(); }
  const Problem& operator[](std::size_t index) const { return list_[index]; }
  const_iterator begin() const noexcept { return list_.begin(); }
  const_iterator end() const noexcept { return list_.end(); }

  /// Orders them by line and column; those of one place keep their order.
  void sort();
  /// One line per problem, with its id, each ended by a newline.
  std::string text() const;

 private:
  std::vector<Problem> list_;
};

/// Thrown if a configuration with mistakes is used. `what()` is the text of the first problem, the number of further
/// ones and the id bad-configuration.
class ConfigError : public SetupError {
 public:
  /// `problems` is not empty.
  explicit ConfigError(Problems problems);
  const Problems& problems() const noexcept { return problems_; }

 private:
  Problems problems_;
};

/// The candidate that `word` probably means: a few letters wrong, missing, added or swapped (case, '-' and '_' are
/// ignored), or the only candidate that begins with it. Empty if none is similar enough.
std::string nearest_name(std::string_view word, const std::vector<std::string>& candidates);

}  // namespace rtdata
