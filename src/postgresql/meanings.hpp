// What errors of a PostgreSQL server and of libpq mean: which of ours they are, and what is to be done.
#pragma once

#include <string_view>

#include "rtdata/data/error.hpp"

namespace rtdata::postgresql {

struct Meaning {
  Errc code;
  const char* advice;
};

/// Of an SQLSTATE.
Meaning meaning_of(std::string_view state) noexcept;
/// Of an error that a row of a COPY made by what is in it (the table has a CHECK, a trigger, a unique index of its
/// own): the others can be stored.
inline constexpr Meaning row_refused{Errc::does_not_fit, "the others are stored; see the table's constraints"};
/// `constraint`: the one that it says was violated.
bool refuses_row(std::string_view state, std::string_view constraint) noexcept;
/// Of a text without one, which libpq says by itself when it cannot connect: a mistake of the configuration that it
/// names, else that the server is away. Its English, which it speaks unless the program calls `setlocale`.
Meaning meaning_of_text(std::string_view why) noexcept;

}  // namespace rtdata::postgresql
