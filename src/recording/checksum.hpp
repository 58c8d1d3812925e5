// The hash of a row's values, and sums of such hashes. docs/recording.md has the encoding for others who compute it.
#pragma once

#include <sqlite3.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string_view>

namespace rtdata::sqlite {

/// A number of rows, and the sum of their hashes mod 2^64: in whatever order they are added.
struct RowSum {
  std::uint64_t rows = 0;
  std::uint64_t sum = 0;
  void add(std::uint64_t hash) noexcept {
    ++rows;
    sum += hash;
  }
  bool operator==(const RowSum&) const = default;
};

/// The tables of the account in which each row belongs to a run; their first column.
inline constexpr std::array<std::string_view, 8> account_tables = {
    "rtdata_run",   "rtdata_schedule", "rtdata_ledger", "rtdata_gap",
    "rtdata_clock", "rtdata_error",    "rtdata_health", "rtdata_configuration"};

/// Takes the values of a row one after the other, each as SQLite gives it back, and hashes them. Throws bad_alloc.
class RowHash {
 public:
  void begin() noexcept { size_ = values_ = 0; }
  void null() { *room(1) = std::byte{0}; }
  void integer(std::int64_t value) { number(1, static_cast<std::uint64_t>(value)); }
  /// NaN is NULL, and -0.0 is 0.0, as it is to SQLite.
  void real(double value) {
    if (value != value) return null();
    value += 0.0;
    std::uint64_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    number(2, bits);
  }
  void text(std::string_view value) { bytes(3, value); }
  void blob(std::string_view value) { bytes(4, value); }
  void column(sqlite3_stmt* row, int column);
  std::uint64_t hash() const noexcept { return hash_of(size_); }
  /// Without the NULLs at its end, which may belong to columns that were added later.
  std::uint64_t hash_of_values() const noexcept { return hash_of(values_); }

 private:
  std::byte* room(std::size_t bytes) {
    if (capacity_ - size_ < bytes) [[unlikely]]
      grow(bytes);
    return buffer_.get() + (size_ += bytes) - bytes;
  }
  void grow(std::size_t bytes);
  std::uint64_t hash_of(std::size_t bytes) const noexcept;
  void number(unsigned char kind, std::uint64_t value) {
    std::byte* at = room(9);
    *at = std::byte{kind};
#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
    value = __builtin_bswap64(value);
#endif
    std::memcpy(at + 1, &value, sizeof value);
    values_ = size_;
  }
  void bytes(unsigned char kind, std::string_view value) {
    number(kind, value.size());
    if (value.empty()) return;
    std::memcpy(room(value.size()), value.data(), value.size());
    values_ = size_;
  }

  std::unique_ptr<std::byte[]> buffer_;
  std::size_t size_ = 0;
  std::size_t values_ = 0;  // up to the last that is not NULL
  std::size_t capacity_ = 0;
};

/// Hashes columns `first` up to and without `end` of the row that the statement is at.
inline std::uint64_t hash_of(RowHash& hash, sqlite3_stmt* row, int first, int end) {
  hash.begin();
  for (int column = first; column < end; ++column) hash.column(row, column);
  return hash.hash();
}

}  // namespace rtdata::sqlite
