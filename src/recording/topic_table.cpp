#include "recording/topic_table.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <type_traits>

#include "data/field_layout.hpp"
#include "data/load.hpp"
#include "data/part_of.hpp"
#include "recording/schema.hpp"
#include "rtdata/data/value.hpp"

namespace rtdata::sqlite {
namespace {

using detail::for_number;
using detail::is_number_kind;
using detail::is_part_of;
using detail::load;

constexpr std::size_t most_rows_per_statement = 16;
constexpr std::size_t most_parameters = 32766;  // SQLITE_MAX_VARIABLE_NUMBER of stock builds
constexpr std::size_t most_columns = 1990;      // SQLITE_MAX_COLUMN is 2000
constexpr int fixed_parameters = 3;             // time, origin, sequence

const char* type_of(const Leaf& leaf) {
  switch (leaf.kind) {
    case Kind::f32:
    case Kind::f64:
      return "REAL";
    case Kind::text:
      return "TEXT";
    case Kind::character:
    case Kind::enumeration:
      return "";  // keeps a text and a number as they are: in a TEXT column the char 7 would become the char '7'
    default:
      return "INTEGER";
  }
}

std::string column_of(const Leaf& leaf) { return quoted(leaf.path) + " " + type_of(leaf); }

/// As SQLite compares names: without the case of the letters of ASCII.
bool starts_with(const std::string& name, const char* start) {
  return ::sqlite3_strnicmp(name.c_str(), start, static_cast<int>(std::strlen(start))) == 0;
}

/// Keeps names of topics' tables apart from our own tables and SQLite's.
std::string table_name(const std::string& topic, std::int64_t version) {
  std::string name = starts_with(topic, "rtdata_") || starts_with(topic, "sqlite_") ? "topic~" + topic : topic;
  if (version > 1) name += "~" + std::to_string(version);
  return name;
}

/// True if it is the table of a topic, whatever the case of its letters.
bool is_of_topic(const Database& database, const std::string& name) {
  // Found in memory first, where a query would go through all topics.
  if (sqlite3_table_column_metadata(database.raw(), "main", name.c_str(), nullptr, nullptr, nullptr, nullptr, nullptr,
                                    nullptr) != SQLITE_OK)
    return false;
  auto known = database.prepare("SELECT EXISTS(SELECT 1 FROM rtdata_topic WHERE table_name = ? COLLATE NOCASE)");
  known.bind(1, name).step();
  return known.integer(0) != 0;
}

void make_table(Database& database, const std::string& name, const Description& description) {
  std::string sql = "CREATE TABLE " + quoted(name) +
                    "(run INTEGER NOT NULL, time INTEGER NOT NULL, origin TEXT NOT NULL, sequence INTEGER NOT NULL, " +
                    quoted(checksum_column) + " INTEGER";
  for (const Leaf& leaf : description.leaves()) sql += ", " + column_of(leaf);
  database.execute(sql + ")");
}

void add_columns(Database& database, const std::string& name, const Description& old, const Description& description) {
  for (const Leaf& leaf : description.leaves()) {
    const bool is_there = std::any_of(old.leaves().begin(), old.leaves().end(),
                                      [&](const Leaf& known) { return known.path == leaf.path; });
    if (is_there) continue;
    database.execute("ALTER TABLE " + quoted(name) + " ADD COLUMN " + column_of(leaf));
  }
}

/// Binds a value and hashes the form in which SQLite returns it.
void bind_value(sqlite3_stmt* statement, int index, const Leaf& leaf, const Value& value, RowHash& hash) {
  struct Binder {
    sqlite3_stmt* statement;
    int index;
    const Leaf& leaf;
    RowHash& hash;
    void integer(std::int64_t v) const {
      sqlite3_bind_int64(statement, index, v);
      hash.integer(v);
    }
    void text(std::string_view v) const {
      sqlite3_bind_text64(statement, index, v.data(), v.size(), SQLITE_TRANSIENT, SQLITE_UTF8);
      hash.text(v);
    }
    void operator()(std::monostate) const {
      sqlite3_bind_null(statement, index);
      hash.null();
    }
    void operator()(bool v) const { integer(v ? 1 : 0); }
    void operator()(char v) const {
      if (v >= ' ' && v <= '~') {
        text({&v, 1});
      } else {
        integer(static_cast<unsigned char>(v));
      }
    }
    void operator()(std::int64_t v) const { integer(v); }
    void operator()(std::uint64_t v) const { integer(static_cast<std::int64_t>(v)); }
    void operator()(double v) const {
      if (std::isnan(v) && leaf.optional != nullptr) return text("NaN");
      sqlite3_bind_double(statement, index, v);  // NaN becomes NULL
      hash.real(v);
    }
    void operator()(const std::string& v) const { text(v); }
  };
  std::visit(Binder{statement, index, leaf, hash}, value);
}

enum class Text { utf8, other };
/// `text` lives until the statement has run.
Text bind_text(sqlite3_stmt* statement, int index, std::string_view text, RowHash& hash) {
  if (detail::is_readable(text)) {
    sqlite3_bind_text64(statement, index, text.data(), text.size(), SQLITE_STATIC, SQLITE_UTF8);
    hash.text(text);
    return Text::utf8;
  }
  sqlite3_bind_blob64(statement, index, text.data(), text.size(), SQLITE_STATIC);
  hash.blob(text);
  return Text::other;
}

}  // namespace

Result<void> check_columns(std::string_view topic, const Description& description) {
  if (description.leaves().size() <= most_columns) return {};
  return Error{Errc::bad_description, "cannot record", "topic " + std::string(topic),
               "it has " + std::to_string(description.leaves().size()) + " values an event",
               "a table has at most " + std::to_string(most_columns) + " columns: split it"};
}

std::vector<const Leaf*> leaves_in_order(const Database& database, std::string_view table,
                                         const Description& description) {
  auto columns = columns_of(database, table);
  std::vector<const Leaf*> leaves;
  for (const std::string& column : columns) {
    for (const Leaf& leaf : description.leaves()) {
      if (leaf.path == column) leaves.push_back(&leaf);
    }
  }
  return leaves;
}

TopicTable TopicTable::prepare(Database& database, const SlotInfo& slot, std::int64_t run,
                               detail::EscapedTexts& no_utf8, AccountSums& sums, NewUtcViews& views, OpenSteps* steps) {
  const Description& description = *slot.description;
  check_columns(slot.topic, description).or_throw();
  auto known = database.prepare(
      "SELECT version, table_name, description FROM rtdata_topic WHERE topic = ? ORDER BY version DESC");
  known.bind(1, slot.topic);
  std::int64_t last_version = 0;
  std::string name;
  std::string widen;  // the JSON of the narrower description to be widened
  std::int64_t version = 0;
  while (known.step()) {
    last_version = std::max(last_version, known.integer(0));
    auto old = Description::from_json(known.text(2));
    if (!old) continue;  // written by something else: leave it alone
    if (is_part_of(**old, description) && name.empty()) {
      name = std::string(known.text(1));
      version = known.integer(0);
      if ((*old)->leaves().size() != description.leaves().size()) widen = std::string(known.text(2));
    }
  }
  known.reset();
  const std::string json = description.to_json();
  const bool is_new = name.empty();
  if (is_new) {
    version = last_version + 1;
    // SQLite takes names that differ in case only as the same: the table of "Room" is "Room~2" beside that of "room".
    for (std::int64_t number = version; name.empty() || is_of_topic(database, name); ++number)
      name = table_name(slot.topic, number);
    NewUtcViews::look_for_room(database, name);
    make_table(database, name, description);
    auto insert = database.prepare(
        "INSERT INTO rtdata_topic(topic, version, table_name, description, first_run) VALUES(?,?,?,?,?)");
    insert.bind(1, slot.topic).bind(2, version).bind(3, name).bind(4, json).bind(5, run);
    insert.run();
    sums.add_topic(database, name);
  } else if (!widen.empty()) {
    sums.add_topic(database, name, AccountSums::Rows::go);
    add_columns(database, name, **Description::from_json(widen), description);
    auto update = database.prepare("UPDATE rtdata_topic SET description = ? WHERE topic = ? AND version = ?");
    update.bind(1, json).bind(2, slot.topic).bind(3, version);
    update.run();
    sums.add_topic(database, name);
    replace_view(database, utc_view(name, description));
  }

  TopicTable table;
  table.database_ = &database;
  table.no_utf8_ = &no_utf8;
  table.name_ = name;
  table.topic_ = slot.topic;
  table.payload_bytes_ = description.size();
  table.run_ = run;
  auto order = leaves_in_order(database, name, description);
  if (!widen.empty()) StepTables::add_columns(database, name, order);
  if (steps != nullptr && StepTables::has_steps(order))
    table.steps_ = std::make_unique<StepTables>(database, sums, *steps, name, run, order);
  // After any failure the batch is rolled back and repeated, so OR ROLLBACK saves SQLite a journal for each statement.
  // The order of the table's columns avoids moving values twice.
  std::string into = "INSERT OR ROLLBACK INTO " + quoted(name) + "(run, time, origin, sequence";
  std::string values = "(" + std::to_string(run) + ",?,?,?";
  for (const Leaf* leaf : order) {
    table.columns_.push_back({leaf->optional == nullptr ? leaf->kind : Kind::record, leaf->offset, leaf});
    into += ", " + quoted(leaf->path);
    values += ",?";
  }
  const std::size_t width = table.columns_.size() + fixed_parameters;
  const std::size_t most_rows = std::clamp<std::size_t>(most_parameters / width, 1, most_rows_per_statement);
  const auto prepare_rows = [&](Insert& insert, std::size_t rows) {
    std::string sql = into + ") VALUES ";
    for (std::size_t i = 0; i < rows; ++i) sql += (i == 0 ? "" : ",") + values + ")";
    auto statement = database.prepare(sql);
    insert = {std::move(statement), std::vector<const SlotInfo*>(rows)};
  };
  prepare_rows(table.many_, most_rows);
  into += ", " + quoted(checksum_column);
  values += ",?";
  prepare_rows(table.one_, 1);
  table.pending_.reserve(most_rows);
  table.last_rowid_ = database.integer("SELECT max(_rowid_) FROM " + quoted(name));
  if (is_new) views.add(name, description);
  return table;
}

void TopicTable::bind(sqlite3_stmt* statement, int index, const Record& record) {
  const auto integer = [&](std::int64_t value) {
    sqlite3_bind_int64(statement, index, value);
    hash_.integer(value);
  };
  const auto real = [&](double value) {
    sqlite3_bind_double(statement, index, value);
    hash_.real(value);
  };
  hash_.begin();
  hash_.integer(run_);
  integer(to_nanoseconds(record.header.time));
  ++index;
  hash_.text(record.info->origin);  // bound already
  ++index;
  integer(static_cast<std::int64_t>(record.header.sequence));
  ++index;
  const std::byte* payload = record.payload.data();
  for (const Column& column : columns_) {
    const std::byte* at = payload + column.offset;
    if (is_number_kind(column.kind)) {
      for_number(column.kind, [&](auto zero) {
        const auto value = load<decltype(zero)>(at);
        if constexpr (std::is_floating_point_v<decltype(zero)>)
          real(value);
        else
          integer(static_cast<std::int64_t>(value));
      });
    } else if (column.kind == Kind::boolean) {
      integer(load<bool>(at) ? 1 : 0);
    } else if (column.leaf->kind == Kind::text) {
      const std::byte* value = find_value(*column.leaf, payload);
      if (value == nullptr) {
        sqlite3_bind_null(statement, index);
        hash_.null();
      } else if (bind_text(statement, index, detail::text_at(*column.leaf, value), hash_) == Text::other) {
        no_utf8_->add(record.slot);
      }
    } else {
      bind_value(statement, index, *column.leaf, read(*column.leaf, payload), hash_);
    }
    ++index;
  }
  sum_ += hash_.hash_of_values();
}

void TopicTable::bind(Insert& insert, std::span<const Record> records) {
  sqlite3_stmt* const statement = insert.statement.raw();
  const SlotInfo** bound = insert.bound.data();
  int index = 1;
  for (const Record& record : records) {
    if (*bound != record.info) {
      *bound = record.info;
      const std::string& origin = record.info->origin;
      sqlite3_bind_text64(statement, index + 1, origin.data(), origin.size(), SQLITE_STATIC, SQLITE_UTF8);
    }
    ++bound;
    bind(statement, index, record);
    index += static_cast<int>(columns_.size()) + fixed_parameters;
  }
}

void TopicTable::run(Insert& insert) {
  insert.statement.run();
  last_rowid_ = database_->last_rowid();
}

void TopicTable::insert(const Record& record) {
  if (pending_.size() == many_.bound.size()) {  // not before there is another one, which may be the last
    bind(many_, pending_);
    pending_.clear();
    run(many_);
  }
  pending_.push_back(record);
  if (steps_ != nullptr) steps_->add(record);
}

void TopicTable::flush() {
  const int checksum = static_cast<int>(columns_.size()) + fixed_parameters + 1;
  for (const Record& record : pending_) {
    bind(one_, {&record, 1});
    if (&record == &pending_.back()) {
      one_.statement.bind(checksum, static_cast<std::int64_t>(sum_));
    } else {
      one_.statement.bind_null(checksum);
    }
    run(one_);
  }
  pending_.clear();
  sum_ = 0;
  if (steps_ != nullptr) steps_->flush();
}

}  // namespace rtdata::sqlite
