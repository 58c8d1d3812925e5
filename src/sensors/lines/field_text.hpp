// How a device writes the value of one field of a line.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/sensors/lines.hpp"

namespace rtdata::detail {

/// The factor of a number. A decimal factor gives the number that the device means: 12530 times 0.001 is 12.53, as the
/// nearest double.
class FieldScale {
 public:
  explicit FieldScale(double scale) noexcept {
    const double inverse = 1 / scale;
    is_divisor_ = std::fabs(inverse) > 1 && inverse == std::nearbyint(inverse);
    by_ = is_divisor_ ? inverse : scale;
  }
  double operator()(double number) const noexcept { return is_divisor_ ? number / by_ : number * by_; }

 private:
  double by_;
  bool is_divisor_;
};

/// Removes the characters around the number from the text of a column or of a JSON value: `prefix`, `suffix`,
/// `thousands` and so on of LineField. A value; one thread at a time.
class FieldText {
 public:
  /// SetupError (bad-argument): settings that cannot be combined.
  explicit FieldText(const LineField& field);

  /// False: the text is the value itself, and calling `read` is not necessary.
  bool is_used() const noexcept { return is_used_; }
  struct Found {
    std::string_view text = {};  ///< in the usual notation; valid until the next call
    bool is_absent = false;      ///< it is one of `no_value`
    bool is_scaled = true;       ///< false: one of `words`, whose number is not scaled
    const char* why = nullptr;   ///< why it cannot be used
  };
  /// No allocation.
  Found read(std::string_view text);
  /// True if it is one of the numbers in `no_value`.
  bool is_none(double number) const noexcept;

 private:
  std::optional<Found> known_text(std::string_view text) const noexcept;
  bool is_no_number(std::string_view text) const noexcept;
  const char* take_thousands(std::string_view& text);
  const char* plain_number(std::string_view& text);

  bool is_used_;
  bool is_number_;
  std::string prefix_, suffix_;
  char decimal_;
  char thousands_ = '\0';  ///< 0: none
  int base_;
  bool has_sign_blanks_;
  std::uint64_t half_;         ///< of a signed type: how many negative numbers it has; 0: of another type
  bool has_notation_ = false;  ///< its numbers are not in the usual notation
  std::vector<std::pair<std::string, std::optional<double>>> no_value_;  ///< with its number, if it is a number
  bool has_numbers_of_none_ = false;
  std::vector<std::pair<std::string, std::string>> words_;
  std::string buffer_;
};

}  // namespace rtdata::detail
