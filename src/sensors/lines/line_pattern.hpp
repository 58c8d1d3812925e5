// A regular expression that is searched for in lines.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace rtdata::detail {

/// Only the first calls allocate memory. A call ends after a limited number of steps, so that no text blocks the loop.
class LinePattern {
 public:
  static constexpr std::size_t most_steps = 20'000, steps_of_a_byte = 8;  // of a search: both together

  /// SetupError: bad-argument (an invalid expression, or built without PCRE2), not-found (PCRE2 is not installed).
  /// `key`: the key of the setting, in errors. `of_bytes`: a `.` matches any byte, also a newline.
  LinePattern(const std::string& expression, const char* key, bool of_bytes = false);
  LinePattern(LinePattern&&) noexcept;
  LinePattern& operator=(LinePattern&&) noexcept;
  ~LinePattern();

  enum class Search { found, not_found, too_long };
  /// The first place that matches.
  Search search(std::string_view text) noexcept;
  /// After `found`: the text of a group. Empty: the group is not part of the match. Valid as long as the text.
  std::optional<std::string_view> group(unsigned number) const noexcept;

  struct Group {
    std::string name;
    unsigned number;
  };
  /// The named groups, in the order of their numbers.
  const std::vector<Group>& groups() const noexcept { return groups_; }

 private:
  struct Compiled;
  std::unique_ptr<Compiled> compiled_;
  std::vector<Group> groups_;
  std::string_view text_;  // of the last search
};

}  // namespace rtdata::detail
