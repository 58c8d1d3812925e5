// Rotation: at its size or time limit, a file is renamed to a number and a new one starts.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/sinks/file.hpp"
#include "sinks/file/output_file.hpp"

namespace rtdata::detail {

/// "run.csv" is always the current file; earlier files are "run-00000001.csv" and so on, which sort before it in the
/// order of their events. Thread: the sink's.
class Rotation {
 public:
  /// SetupError, bad-argument: settings that say nothing.
  explicit Rotation(const FileConfig& config);

  bool is_on() const noexcept { return config_.rotate.is_on(); }
  /// Moves the event just encoded, from this index in the file's buffer on, to a new file if a limit is reached.
  /// Errors: of writing the data before it. `index` counts the files of the sink.
  Result<void> see_to(OutputFile& file, std::size_t index, std::size_t from, Time time);
  /// Gives a file that an earlier run wrote the next number, and starts a new one.
  static Result<void> set_aside(OutputFile& file);
  /// A failure that is tried again with the next event; reported once, until it succeeds.
  std::string take_trouble() { return std::exchange(trouble_, {}); }

  /// The name that a file gets.
  static std::string name(const std::string& path, std::uint64_t number);
  /// True if it is such a name.
  static bool is_numbered(const std::string& path, const std::string& other);
  /// The mistake in the settings; empty: none.
  static std::string mistake(const FileConfig& config);

 private:
  struct State {
    std::uint64_t last_number = 0;
    std::int64_t period = 0;  // in which its events lie
    bool is_known = false;
  };
  /// Numbers of the files that are there, in order.
  static std::map<std::uint64_t, std::string> numbered(const std::string& path);
  static std::uint64_t last_number(const std::string& path);
  void remove_old(const std::string& path);
  void tell(const Error& error);

  const FileConfig config_;
  std::vector<State> states_;  // by index
  std::string trouble_;
  bool is_in_trouble_ = false;
};

}  // namespace rtdata::detail
