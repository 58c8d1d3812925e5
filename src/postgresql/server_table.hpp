// The table of one topic on a server: finds, makes or extends it, and encodes its rows for COPY.
#pragma once

#include <bit>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "postgresql/connection.hpp"
#include "rtdata/data/description.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::postgresql {

/// Bytes that grow and are not zeroed first.
class Bytes {
 public:
  void clear() noexcept { size_ = 0; }
  std::size_t size() const noexcept { return size_; }
  std::string_view view() const noexcept { return {data_.get(), size_}; }
  /// Returns space for `more` further bytes.
  char* room(std::size_t more) {
    if (size_ + more > capacity_) [[unlikely]]
      grow(more);
    return data_.get() + size_;
  }
  void end_at(const char* end) noexcept { size_ = static_cast<std::size_t>(end - data_.get()); }

 private:
  void grow(std::size_t more);
  std::unique_ptr<char[]> data_;
  std::size_t size_ = 0, capacity_ = 0;
};

/// Checks that a table can have a column for each value. Errors: bad-description.
Result<void> check_columns(std::string_view topic, const Description& description);

/// The server's form of a name. The server uses only the first 63 bytes, so a longer name is shortened and ends with a
/// number made from the whole name.
std::string short_name(std::string_view name);

/// Columns before those of the fields, in the order in which rows are copied.
inline constexpr const char* fixed_columns = "\"time\",time_ns,run,origin,sequence";
inline constexpr int fixed_column_count = 5;

/// XXH3 of a row in COPY format, without the field count and without absent fields at its end, so that later columns do
/// not change it.
std::uint64_t hash_of_row(std::string_view row) noexcept;

/// Converts numbers between the byte order of the server and of this machine.
template <class T>
T big_endian(T value) noexcept {
  if constexpr (std::endian::native == std::endian::little) {
    if constexpr (sizeof value == 8) return static_cast<T>(__builtin_bswap64(static_cast<std::uint64_t>(value)));
    if constexpr (sizeof value == 4) return static_cast<T>(__builtin_bswap32(static_cast<std::uint32_t>(value)));
    if constexpr (sizeof value == 2) return static_cast<T>(__builtin_bswap16(static_cast<std::uint16_t>(value)));
  }
  return value;
}

/// The server's column type for a field; texts may contain escapes (data/utf8.hpp).
inline constexpr const char* type_of(Kind kind) noexcept {
  switch (kind) {
    case Kind::boolean:
      return "boolean";
    case Kind::i8:
    case Kind::i16:
    case Kind::u8:
      return "smallint";
    case Kind::i32:
    case Kind::u16:
      return "integer";
    case Kind::i64:
    case Kind::u32:
      return "bigint";
    case Kind::u64:
      return "numeric(20,0)";
    case Kind::f32:
      return "real";
    case Kind::f64:
      return "double precision";
    default:
      return "text";  // text, character, enumeration by name
  }
}

class ServerTable {
 public:
  /// Finds the table for this description; adds missing columns. A changed kind or unit gets a new table. Uses its own
  /// transaction. Throws description-differs (the existing table is not ours or has lost a column).
  ServerTable(Connection& connection, const SlotInfo& slot, std::int64_t run);

  const std::string& name() const noexcept { return name_; }
  /// COPY ... FROM STDIN, of rows as `append` makes them.
  const std::string& copy() const noexcept { return copy_; }
  /// Rows waiting for COPY; complete with head and end after `finish`.
  Bytes& rows() noexcept { return rows_; }
  void begin();
  void finish();
  bool is_empty() const noexcept { return count_ == 0; }

  /// Appends the record, and returns its hash.
  std::uint64_t append(const Record& record, std::int64_t run);

 private:
  struct Column {
    Kind kind;  // Kind::record: needs more than its bytes
    std::size_t offset = 0;
    const Leaf* leaf = nullptr;  // null: a field that this description has not
  };
  char* put(char* to, const Column& column, const std::byte* payload);

  std::string name_, copy_;
  std::shared_ptr<const Description> description_;
  std::vector<Column> columns_;
  std::size_t most_bytes_ = 0;  // bytes of a row, without its origin
  Bytes rows_;
  std::size_t count_ = 0;
};

}  // namespace rtdata::postgresql
