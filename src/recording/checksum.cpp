#include "recording/checksum.hpp"

#include <algorithm>

// Header only: nothing to link, and the same result in every version since 0.8.
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wold-style-cast"
#pragma GCC diagnostic ignored "-Wconversion"
#pragma GCC diagnostic ignored "-Wshadow"
#define XXH_INLINE_ALL
#include <xxhash.h>
#pragma GCC diagnostic pop

namespace rtdata::sqlite {

void RowHash::grow(std::size_t bytes) {
  const std::size_t capacity = std::max(std::max<std::size_t>(256, 2 * capacity_), size_ + bytes);
  std::unique_ptr<std::byte[]> grown(new std::byte[capacity]);
  if (size_ != 0) std::memcpy(grown.get(), buffer_.get(), size_);
  buffer_ = std::move(grown);
  capacity_ = capacity;
}

void RowHash::column(sqlite3_stmt* row, int column) {
  const auto bytes_of = [&] {
    const void* data = sqlite3_column_blob(row, column);  // as it is stored: UTF-8
    return std::string_view(static_cast<const char*>(data),
                            static_cast<std::size_t>(sqlite3_column_bytes(row, column)));
  };
  switch (sqlite3_column_type(row, column)) {
    case SQLITE_INTEGER:
      return integer(sqlite3_column_int64(row, column));
    case SQLITE_FLOAT:
      return real(sqlite3_column_double(row, column));
    case SQLITE_TEXT:
      return text(bytes_of());
    case SQLITE_BLOB:
      return blob(bytes_of());
    default:
      return null();
  }
}

std::uint64_t RowHash::hash_of(std::size_t bytes) const noexcept { return XXH3_64bits(buffer_.get(), bytes); }

}  // namespace rtdata::sqlite
