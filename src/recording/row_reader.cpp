#include <charconv>
#include <cstring>
#include <limits>

#include "data/utf8.hpp"
#include "recording/recording_file.hpp"
#include "rtdata/data/value.hpp"

namespace rtdata::detail {
namespace {

std::string_view text_of(sqlite3_value* stored) {
  const auto* bytes = static_cast<const char*>(sqlite3_value_blob(stored));
  return bytes == nullptr ? std::string_view{}
                          : std::string_view{bytes, static_cast<std::size_t>(sqlite3_value_bytes(stored))};
}

/// The stored value as text for messages.
std::string found(sqlite3_value* stored) {
  switch (sqlite3_value_type(stored)) {
    case SQLITE_INTEGER:
      return "the integer " + std::to_string(sqlite3_value_int64(stored));
    case SQLITE_FLOAT:
      return "the number " + to_string(Value{sqlite3_value_double(stored)});
    case SQLITE_NULL:
      return "nothing";
    default:
      return "the text \"" + std::string(text_of(stored).substr(0, 40)) + "\"";
  }
}

/// Converts the stored value for `write`; false if it does not fit the kind.
bool convert(sqlite3_value* stored, const Leaf& leaf, Value& value) {
  const int type = sqlite3_value_type(stored);
  switch (leaf.kind) {
    case Kind::boolean:
      value = sqlite3_value_int64(stored) != 0;
      return type == SQLITE_INTEGER && (sqlite3_value_int64(stored) | 1) == 1;
    case Kind::f32:
    case Kind::f64:
      if (type == SQLITE_TEXT) {
        value = std::numeric_limits<double>::quiet_NaN();
        return text_of(stored) == "NaN";
      }
      value = sqlite3_value_double(stored);
      return type == SQLITE_FLOAT || type == SQLITE_INTEGER;
    case Kind::u64:
      value = static_cast<std::uint64_t>(sqlite3_value_int64(stored));
      return type == SQLITE_INTEGER;
    case Kind::text:
      value = std::string(text_of(stored));
      return type == SQLITE_TEXT || (type == SQLITE_BLOB && !is_readable(text_of(stored)));
    case Kind::character: {
      if (type == SQLITE_TEXT) {
        const std::string_view text = text_of(stored);
        if (text.size() != 1) return false;
        value = text.front();
        return true;
      }
      const std::int64_t number = sqlite3_value_int64(stored);
      value = static_cast<char>(number);
      return type == SQLITE_INTEGER && number >= 0 && number <= 255;
    }
    case Kind::enumeration:
      if (type == SQLITE_TEXT) {
        value = std::string(text_of(stored));
        return true;
      }
      if (leaf.enum_base == Kind::u64) {
        value = static_cast<std::uint64_t>(sqlite3_value_int64(stored));
      } else {
        value = sqlite3_value_int64(stored);
      }
      return type == SQLITE_INTEGER;
    default:
      value = sqlite3_value_int64(stored);
      return type == SQLITE_INTEGER;
  }
}

template <class T>
void store(std::byte* to, T value) {
  std::memcpy(to, &value, sizeof value);
}

/// Reads the most common values directly, without a Value.
bool read_plain(sqlite3_value* stored, const Leaf& leaf, std::byte* payload) {
  if (leaf.optional != nullptr) return false;
  const int type = sqlite3_value_type(stored);
  if (leaf.kind == Kind::f64 && type == SQLITE_FLOAT) {
    store(payload + leaf.offset, sqlite3_value_double(stored));
    return true;
  }
  if (leaf.kind == Kind::f32 && type == SQLITE_FLOAT) {
    store(payload + leaf.offset, static_cast<float>(sqlite3_value_double(stored)));
    return true;
  }
  if ((leaf.kind == Kind::i64 || leaf.kind == Kind::u64) && type == SQLITE_INTEGER) {
    store(payload + leaf.offset, sqlite3_value_int64(stored));
    return true;
  }
  return false;
}

void read_any(sqlite3_value* stored, const Leaf& leaf, std::byte* payload) {
  if (sqlite3_value_type(stored) == SQLITE_NULL) {
    // Absent, NaN, or a field of a later run: zero bytes are zero, empty and absent.
    if (leaf.optional == nullptr && leaf.kind == Kind::f64)
      store(payload + leaf.offset, std::numeric_limits<double>::quiet_NaN());
    if (leaf.optional == nullptr && leaf.kind == Kind::f32)
      store(payload + leaf.offset, std::numeric_limits<float>::quiet_NaN());
    return;
  }
  Value value;
  if (!convert(stored, leaf, value)) {
    throw SetupError({Errc::damaged, "cannot read a row", "field " + leaf.path,
                      "it holds " + found(stored) + ", which is not of type " + std::string(name_of(leaf.kind)), ""});
  }
  if (auto done = write(leaf, payload, value); !done) {
    Error error = std::move(done).error();
    throw SetupError({Errc::damaged, "cannot read a row", std::move(error.where), std::move(error.why), ""});
  }
}

}  // namespace

std::string RowReader::columns() const {
  std::string sql;
  for (const Leaf& leaf : topic_->description->leaves()) sql += ", t." + sqlite::quoted(leaf.path);
  return sql;
}

void RowReader::read(sqlite3_stmt* row, int first, std::byte* payload) const {
  std::memset(payload, 0, topic_->description->size());
  int column = first;
  for (const Leaf& leaf : topic_->description->leaves()) {
    sqlite3_value* const stored = sqlite3_column_value(row, column++);  // no other thread uses the connection meanwhile
    if (read_plain(stored, leaf, payload)) continue;
    read_any(stored, leaf, payload);
  }
}

}  // namespace rtdata::detail
