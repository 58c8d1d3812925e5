#include "postgresql/server_table.hpp"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <charconv>
#include <cstring>
#include <map>

#include "data/load.hpp"
#include "data/part_of.hpp"
#include "data/utf8.hpp"
#include "postgresql/layout.hpp"
#include "rtdata/data/value.hpp"

namespace rtdata::postgresql {
namespace {

using detail::is_part_of;
using detail::load;

constexpr std::size_t most_fields = 1590;  // a table has at most 1600 columns
constexpr std::size_t longest_name = 63;   // NAMEDATALEN - 1
struct FixedColumn {
  const char *name, *type, *comment;
};
constexpr FixedColumn fixed[] = {{"time", "timestamp with time zone", "time_ns in UTC, to the microsecond"},
                                 {"time_ns", "bigint", "ns since the epoch as recorded, never jumps within a run"},
                                 {"run", "bigint", "rtdata_run.run"},
                                 {"origin", "text", "the sensor or feed"},
                                 {"sequence", "bigint", "number of the event of this origin in the run, from 1"}};
constexpr std::int64_t server_epoch_us = 946'684'800'000'000;  // 2000-01-01 in us since 1970

template <class T>
char* put_big(char* to, T value) noexcept {
  value = big_endian(value);
  std::memcpy(to, &value, sizeof value);
  return to + sizeof value;
}

/// Writes the length, then the value.
template <class T>
char* put_field(char* to, T value) noexcept {
  return put_big(put_big(to, static_cast<std::int32_t>(sizeof value)), value);
}

char* put_text(char* to, std::string_view text) noexcept {
  to = put_big(to, static_cast<std::int32_t>(text.size()));
  std::memcpy(to, text.data(), text.size());
  return to + text.size();
}

char* put_absent(char* to) noexcept { return put_big(to, std::int32_t{-1}); }

/// As the server writes it back: groups of four digits without zeros at the end (numeric_send).
char* put_numeric(char* to, std::uint64_t value) noexcept {
  std::int16_t digits[5];
  int count = 0;
  for (; value != 0; value /= 10'000) digits[count++] = static_cast<std::int16_t>(value % 10'000);
  int zeros = 0;
  while (zeros < count && digits[zeros] == 0) ++zeros;
  const int kept = count - zeros;
  to = put_big(to, static_cast<std::int32_t>(8 + 2 * kept));
  to = put_big(to, static_cast<std::int16_t>(kept));
  to = put_big(to, static_cast<std::int16_t>(count > 0 ? count - 1 : 0));  // weight of the first
  to = put_big(to, std::int16_t{0});                                       // sign
  to = put_big(to, std::int16_t{0});                                       // digits after the point
  for (int i = count - 1; i >= zeros; --i) to = put_big(to, digits[i]);
  return to;
}

std::int64_t to_server_time(std::int64_t nanoseconds) noexcept {
  const std::int64_t us = nanoseconds >= 0 ? nanoseconds / 1000 : (nanoseconds - 999) / 1000;
  return us - server_epoch_us;
}

/// A value that needs more than its bytes, as the text that the server gets.
std::string text_of(const Leaf& leaf, const std::byte* payload) {
  const Value value = read(leaf, payload);
  std::string out;
  if (const char* c = std::get_if<char>(&value)) {
    if (*c >= ' ' && *c <= '~') return {*c};
    constexpr char hex[] = "0123456789abcdef";
    const auto byte = static_cast<unsigned char>(*c);
    out = "\\x";
    out += hex[byte >> 4];
    out += hex[byte & 15];
    return out;
  }
  return to_string(value);
}

std::string table_name(const std::string& topic, std::int64_t version) {
  std::string name = topic.starts_with("rtdata_") || topic.starts_with("pg_") ? "topic~" + topic : topic;
  if (version > 1) name += "~" + std::to_string(version);
  return short_name(name);
}

std::string column_of(const Leaf& leaf) { return quoted_name(short_name(leaf.path)) + " " + type_of(leaf.kind); }

std::string comment_of(const std::string& table, const Leaf& leaf) {
  std::string text = leaf.path + ": " + std::string(name_of(leaf.kind));
  if (!leaf.unit.empty()) text += ", unit " + leaf.unit;
  if (leaf.optional != nullptr) text += ", NULL when absent";
  if (leaf.kind == Kind::enumeration) {
    text += ", one of";
    for (const EnumValue& value : leaf.field->values) text += " " + value.name;
  }
  return "COMMENT ON COLUMN " + quoted_name(table) + "." + quoted_name(short_name(leaf.path)) + " IS " +
         literal(detail::readable(text)) + ";";
}

std::string table_sql(const std::string& name, const SlotInfo& slot) {
  const std::string table = quoted_name(name);
  // TimescaleDB needs the time in each unique index, and no reference to the table: create_hypertable(..., 'time').
  std::string sql = "CREATE TABLE " + table + "(";
  for (const FixedColumn& column : fixed) sql += quoted_name(column.name) + " " + column.type + " NOT NULL, ";
  for (const Leaf& leaf : slot.description->leaves()) sql += column_of(leaf) + ", ";
  sql += "PRIMARY KEY(run, origin, sequence, \"time\"));CREATE INDEX ON " + table + " USING brin(\"time\");";
  sql += "COMMENT ON TABLE " + table + " IS " +
         literal(detail::readable("events of topic " + slot.topic + " (" + slot.description->name() +
                                  "), by rt-data; runs are in rtdata_run")) +
         ";";
  for (const FixedColumn& column : fixed)
    sql += "COMMENT ON COLUMN " + table + "." + quoted_name(column.name) + " IS " + literal(column.comment) + ";";
  for (const Leaf& leaf : slot.description->leaves()) sql += comment_of(name, leaf);
  return sql;
}

[[noreturn]] void not_ours(const std::string& table, std::string why) {
  throw SetupError({Errc::description_differs, "cannot store into table", table, std::move(why),
                    "rename it or give it its columns back; events wait until then"});
}

/// In a transaction: makes or widens the table. Returns the description of its columns.
struct Found {
  std::string table;
  std::shared_ptr<const Description> description;
};
Found find_or_make(Connection& connection, const SlotInfo& slot, std::int64_t run) {
  const std::string topic = slot.topic;
  const Reply known = connection.query(
      "SELECT version, table_name, description FROM rtdata_topic WHERE topic = $1 ORDER BY version DESC", {{topic}});
  std::int64_t last_version = 0;
  for (int row = 0; row < known.rows(); ++row) {
    last_version = std::max(last_version, known.integer(row, 0));
    auto old = Description::from_json(known.text(row, 2));
    if (!old) continue;  // written by something else: left alone
    const std::string table(known.text(row, 1));
    // Some of several machines may have programs with fewer fields: they use the same table.
    if (is_part_of(*slot.description, **old)) return {table, *old};
    if (!is_part_of(**old, *slot.description)) continue;
    std::string sql;
    for (const Leaf& leaf : slot.description->leaves()) {
      if ((*old)->find(leaf.path) != nullptr) continue;
      sql += "ALTER TABLE " + quoted_name(table) + " ADD COLUMN " + column_of(leaf) + ";";
      sql += comment_of(table, leaf);
    }
    sql += "UPDATE rtdata_topic SET description = " + literal(slot.description->to_json()) +
           " WHERE topic = " + literal(topic) + " AND version = " + std::string(known.text(row, 0));
    connection.run(sql);
    return {table, slot.description};
  }
  const std::int64_t version = last_version + 1;
  const std::string table = table_name(topic, version);
  if (connection.query("SELECT to_regclass($1) IS NULL", {{quoted_name(table)}}).text(0, 0) != "t")
    not_ours(table, "a table of this name is there, and rt-data has not made it");
  std::string sql = table_sql(table, slot);
  sql += "INSERT INTO rtdata_topic(topic, version, table_name, description, first_run) VALUES(" + literal(topic) + "," +
         std::to_string(version) + "," + literal(table) + "," + literal(slot.description->to_json()) + "," +
         std::to_string(run) + ")";
  connection.run(sql);
  return {table, slot.description};
}

}  // namespace

void Bytes::grow(std::size_t more) {
  const std::size_t capacity = std::max(size_ + more, capacity_ * 2);
  std::unique_ptr<char[]> larger(new char[capacity]);
  std::copy_n(data_.get(), size_, larger.get());
  data_ = std::move(larger);
  capacity_ = capacity;
}

std::string short_name(std::string_view name) {
  if (name.size() <= longest_name) return std::string(name);
  constexpr std::size_t digits = 8;
  std::size_t end = longest_name - digits - 1;
  while (end > 0 && (static_cast<unsigned char>(name[end]) & 0xc0) == 0x80) --end;  // not within a character
  char number[digits + 1] = {};
  std::snprintf(number, sizeof number, "%08x", static_cast<unsigned>(XXH3_64bits(name.data(), name.size()) >> 32));
  return std::string(name.substr(0, end)) + "~" + number;
}

std::uint64_t hash_of_row(std::string_view row) noexcept { return XXH3_64bits(row.data(), row.size()); }

Result<void> check_columns(std::string_view topic, const Description& description) {
  if (description.leaves().size() > most_fields) {
    return Error{Errc::bad_description, "cannot store", "topic " + std::string(topic),
                 "it has " + std::to_string(description.leaves().size()) + " values an event",
                 "a table of the server has at most " + std::to_string(most_fields) + " columns for values: split it"};
  }
  for (const Leaf& leaf : description.leaves()) {
    for (const char* name : {"time_ns", "tableoid", "xmin", "cmin", "xmax", "cmax", "ctid"}) {
      if (leaf.path != name) continue;
      return Error{Errc::bad_description, "cannot store", "topic " + std::string(topic),
                   "its field " + leaf.path + " has the name of a column that each table has", "give it another name"};
    }
  }
  return {};
}

ServerTable::ServerTable(Connection& connection, const SlotInfo& slot, std::int64_t run)
    : description_(slot.description) {
  Found found;
  in_transaction(connection, [&] { found = find_or_make(connection, slot, run); });
  name_ = found.table;
  const Reply there = columns_of(connection, name_);
  if (there.rows() == 0) not_ours(name_, "it was dropped or renamed, but rtdata_topic has it");
  std::map<std::string, std::string, std::less<>> types;
  for (int row = 0; row < there.rows(); ++row) types.emplace(there.text(row, 0), there.text(row, 1));
  const auto check = [&](const std::string& column, std::string_view type) {
    const auto at = types.find(column);
    if (at == types.end()) not_ours(name_, "it has no column " + column);
    if (at->second != type)
      not_ours(name_, "its column " + column + " is of type " + at->second + ", not " + std::string(type));
  };
  for (const FixedColumn& column : fixed) check(column.name, column.type);
  std::map<std::string, const Leaf*, std::less<>> leaves;  // of the table, by column
  for (const Leaf& leaf : found.description->leaves()) {
    check(short_name(leaf.path), type_of(leaf.kind));
    leaves.emplace(short_name(leaf.path), &leaf);
  }
  std::string columns = fixed_columns;
  for (int row = 0; row < there.rows(); ++row) {
    const auto at = leaves.find(there.text(row, 0));
    if (at == leaves.end()) continue;  // one of the user's: it has a default, or is computed
    columns += "," + quoted_name(at->first);
    const Leaf* leaf = slot.description->find(at->second->path);
    if (leaf == nullptr) {
      columns_.push_back({Kind::record, 0, nullptr});
      most_bytes_ += 4;
      continue;
    }
    const bool is_plain = leaf->optional == nullptr && leaf->kind != Kind::character && leaf->kind != Kind::enumeration;
    columns_.push_back({is_plain ? leaf->kind : Kind::record, leaf->offset, leaf});
    std::size_t bytes = 32;  // of a number, a character
    if (leaf->kind == Kind::text) bytes += 4 * leaf->size;
    if (leaf->kind == Kind::enumeration) {
      for (const EnumValue& value : leaf->field->values) bytes = std::max(bytes, value.name.size() + 32);
    }
    most_bytes_ += bytes;
  }
  most_bytes_ += 64;  // the fixed ones
  copy_ = "COPY " + quoted_name(name_) + "(" + columns + ") FROM STDIN (FORMAT binary)";
  begin();
}

void ServerTable::begin() {
  rows_.clear();
  count_ = 0;
  constexpr std::string_view head("PGCOPY\n\xff\r\n\0\0\0\0\0\0\0\0\0", 19);
  char* to = rows_.room(head.size());
  std::memcpy(to, head.data(), head.size());
  rows_.end_at(to + head.size());
}

void ServerTable::finish() { rows_.end_at(put_big(rows_.room(2), std::int16_t{-1})); }

char* ServerTable::put(char* to, const Column& column, const std::byte* payload) {
  const std::byte* at = payload + column.offset;
  switch (column.kind) {
    case Kind::f64:
      return put_field(to, load<std::uint64_t>(at));
    case Kind::f32:
      return put_field(to, load<std::uint32_t>(at));
    case Kind::i64:
      return put_field(to, load<std::int64_t>(at));
    case Kind::i32:
      return put_field(to, load<std::int32_t>(at));
    case Kind::i16:
      return put_field(to, load<std::int16_t>(at));
    case Kind::i8:
      return put_field(to, static_cast<std::int16_t>(load<std::int8_t>(at)));
    case Kind::u64:
      return put_numeric(to, load<std::uint64_t>(at));
    case Kind::u32:
      return put_field(to, static_cast<std::int64_t>(load<std::uint32_t>(at)));
    case Kind::u16:
      return put_field(to, static_cast<std::int32_t>(load<std::uint16_t>(at)));
    case Kind::u8:
      return put_field(to, static_cast<std::int16_t>(load<std::uint8_t>(at)));
    case Kind::boolean:
      return put_field(to, static_cast<char>(load<bool>(at) ? 1 : 0));
    case Kind::text: {
      const std::string_view text = detail::text_at(*column.leaf, at);
      if (!detail::needs_escape(text)) return put_text(to, text);
      std::string escaped;
      detail::append_escaped(escaped, text);
      return put_text(to, escaped);
    }
    default:
      break;
  }
  if (column.leaf == nullptr) return put_absent(to);
  const std::byte* value = find_value(*column.leaf, payload);
  if (value == nullptr) return put_absent(to);
  if (column.leaf->kind == Kind::character || column.leaf->kind == Kind::enumeration)
    return put_text(to, text_of(*column.leaf, payload));
  return put(to, {column.leaf->kind, static_cast<std::size_t>(value - payload), column.leaf}, payload);
}

std::uint64_t ServerTable::append(const Record& record, std::int64_t run) {
  const std::string& origin = record.info->origin;
  char* to = rows_.room(most_bytes_ + origin.size());
  to = put_big(to, static_cast<std::int16_t>(fixed_column_count + columns_.size()));
  const char* const begin = to;
  const std::int64_t time = to_nanoseconds(record.header.time);
  to = put_field(to, to_server_time(time));
  to = put_field(to, time);
  to = put_field(to, run);
  to = put_text(to, origin);
  to = put_field(to, static_cast<std::int64_t>(record.header.sequence));
  const std::byte* payload = record.payload.data();
  const char* end_of_values = to;
  for (const Column& column : columns_) {
    if (column.kind == Kind::f64 || column.kind == Kind::i64) [[likely]] {  // most of all values
      end_of_values = to = put_field(to, load<std::uint64_t>(payload + column.offset));
      continue;
    }
    const char* const before = to;
    to = put(to, column, payload);
    if (to - before > 4 || before[0] == 0) end_of_values = to;  // a length of -1 is an absent value
  }
  rows_.end_at(to);
  ++count_;
  return hash_of_row({begin, static_cast<std::size_t>(end_of_values - begin)});
}

}  // namespace rtdata::postgresql
