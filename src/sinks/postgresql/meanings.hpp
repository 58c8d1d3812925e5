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
/// Of a text without one, which libpq says by itself when it cannot connect: a mistake of the configuration that it
/// names, else that the server is away. Its English, which it speaks unless the program calls `setlocale`.
Meaning meaning_of_text(std::string_view why) noexcept;

}  // namespace rtdata::postgresql
