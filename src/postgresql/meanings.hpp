// Maps errors of a PostgreSQL server and libpq to our errors, with advice.
#pragma once

#include <string_view>

#include "rtdata/data/error.hpp"

namespace rtdata::postgresql {

struct Meaning {
  Errc code;
  const char* advice;
};

/// The meaning of an SQLSTATE.
Meaning meaning_of(std::string_view state) noexcept;
/// For an error caused by the content of a row in a COPY (a CHECK, a trigger, a unique index): the other rows can be
/// stored.
inline constexpr Meaning row_refused{Errc::does_not_fit, "the others are stored; see the table's constraints"};
/// `constraint`: the one that it says was violated.
bool refuses_row(std::string_view state, std::string_view constraint) noexcept;
/// For a text without SQLSTATE, from libpq when it cannot connect: a mistake in the configuration, otherwise the server
/// is away. Expects English, which libpq uses unless the program calls `setlocale`.
Meaning meaning_of_text(std::string_view why) noexcept;

}  // namespace rtdata::postgresql
