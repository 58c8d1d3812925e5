// Makes a recording of what a server has.
#include <stdlib.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <map>

#include "data/utf8.hpp"
#include "rtdata/data/value.hpp"
#include "rtdata/sinks/postgresql_recording.hpp"
#include "sinks/postgresql/account_copy.hpp"
#include "sinks/postgresql/connection.hpp"
#include "sinks/postgresql/layout.hpp"
#include "sinks/postgresql/postgresql_writer.hpp"
#include "sinks/postgresql/server_table.hpp"
#include "sinks/sqlite/account_sums.hpp"
#include "sinks/sqlite/schema.hpp"
#include "sinks/sqlite/topic_table.hpp"
#include "sinks/sqlite/utc_line.hpp"
#include "sinks/sqlite/value_ranges.hpp"
#include "sinks/sqlite/verify_run.hpp"

namespace rtdata {
namespace postgresql {
namespace {

using sqlite::account_tables;
using sqlite::Database;

struct Folder {
  Folder() {
    const char* base = ::getenv("TMPDIR");
    path = std::string(base != nullptr && *base != '\0' ? base : "/tmp") + "/rtdata-XXXXXX";
    is_made = ::mkdtemp(path.data()) != nullptr;
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  ~Folder() {
    std::error_code ignored;
    if (is_made) std::filesystem::remove_all(path, ignored);
  }
  std::string path;
  bool is_made = false;
};

template <class T>
T load_big(const char* from) noexcept {
  T value;
  std::memcpy(&value, from, sizeof value);
  if constexpr (std::endian::native == std::endian::little) {
    if constexpr (sizeof value == 8) value = static_cast<T>(__builtin_bswap64(static_cast<std::uint64_t>(value)));
    if constexpr (sizeof value == 4) value = static_cast<T>(__builtin_bswap32(static_cast<std::uint32_t>(value)));
    if constexpr (sizeof value == 2) value = static_cast<T>(__builtin_bswap16(static_cast<std::uint16_t>(value)));
  }
  return value;
}

/// numeric_send; false: it is no whole number of 64 bits.
bool read_numeric(std::string_view bytes, std::uint64_t& value) noexcept {
  if (bytes.size() < 8) return false;
  const auto at = [&](std::size_t i) { return load_big<std::int16_t>(bytes.data() + 2 * i); };
  const int digits = at(0), weight = at(1);
  if (at(2) != 0 || digits < 0 || bytes.size() != 8 + 2 * static_cast<std::size_t>(digits) || digits > weight + 1 ||
      weight > 4)
    return digits == 0 ? (value = 0, true) : false;
  value = 0;
  for (int i = 0; i <= weight; ++i) {
    const std::int16_t digit = i < digits ? at(4 + static_cast<std::size_t>(i)) : std::int16_t{0};
    if (__builtin_mul_overflow(value, std::uint64_t{10'000}, &value) ||
        __builtin_add_overflow(value, static_cast<std::uint64_t>(digit), &value))
      return false;
  }
  return true;
}

/// The value of a column as `write` takes it; false when it does not fit the kind.
bool convert(std::string_view bytes, const Leaf& leaf, Value& value) {
  const auto whole = [&](auto number) {
    if (bytes.size() != sizeof number) return false;
    number = load_big<decltype(number)>(bytes.data());
    if (leaf.kind == Kind::u8 || leaf.kind == Kind::u16 || leaf.kind == Kind::u32) {
      value = static_cast<std::uint64_t>(number);
      return number >= 0;
    }
    value = static_cast<std::int64_t>(number);
    return true;
  };
  switch (leaf.kind) {
    case Kind::boolean:
      value = !bytes.empty() && bytes[0] != 0;
      return bytes.size() == 1;
    case Kind::i8:
    case Kind::i16:
    case Kind::u8:
      return whole(std::int16_t{});
    case Kind::i32:
    case Kind::u16:
      return whole(std::int32_t{});
    case Kind::i64:
    case Kind::u32:
      return whole(std::int64_t{});
    case Kind::u64: {
      std::uint64_t number = 0;
      const bool is_read = read_numeric(bytes, number);
      value = number;
      return is_read;
    }
    case Kind::f32:
      if (bytes.size() != 4) return false;
      value = static_cast<double>(std::bit_cast<float>(load_big<std::uint32_t>(bytes.data())));
      return true;
    case Kind::f64:
      if (bytes.size() != 8) return false;
      value = std::bit_cast<double>(load_big<std::uint64_t>(bytes.data()));
      return true;
    case Kind::text:
      value = detail::has_escape(bytes) ? detail::unescaped(bytes) : std::string(bytes);
      return true;
    case Kind::character:
      if (bytes.size() == 1) {
        value = bytes[0];
        return true;
      }
      if (bytes.size() != 4 || bytes[0] != '\\' || bytes[1] != 'x') return false;
      {
        unsigned byte = 0;
        const auto read = std::from_chars(bytes.data() + 2, bytes.data() + 4, byte, 16);
        value = static_cast<char>(static_cast<unsigned char>(byte));
        return read.ec == std::errc{} && read.ptr == bytes.data() + 4;
      }
    default: {  // an enumeration: its name, or a number that has none
      const auto& names = leaf.field->values;
      if (std::any_of(names.begin(), names.end(), [&](const EnumValue& one) { return one.name == bytes; })) {
        value = std::string(bytes);
        return true;
      }
      std::int64_t number = 0;
      auto read = std::from_chars(bytes.data(), bytes.data() + bytes.size(), number);
      value = number;
      if (read.ec == std::errc::result_out_of_range) {
        std::uint64_t large = 0;
        read = std::from_chars(bytes.data(), bytes.data() + bytes.size(), large);
        value = large;
      }
      return read.ec == std::errc{} && read.ptr == bytes.data() + bytes.size();
    }
  }
}

/// One topic's table on the server.
struct Topic {
  std::string topic, table;
  std::shared_ptr<const Description> description;
  std::vector<const Leaf*> leaves;  // in the order of its columns
  std::string columns;
};

struct Position {
  std::string topic, origin, table;
  std::uint64_t first = 0, last = 0, rows = 0, sum = 0;
  // found
  std::uint64_t found_first = 0, found_last = 0, found_rows = 0, found_sum = 0;
  bool is_known = false;
};

struct Run {
  std::int64_t run = 0;
  bool has_account = false;
  std::string uuid, machine;
};

/// By run, a sentence each.
using Sentences = std::vector<std::pair<std::int64_t, std::string>>;

constexpr std::int64_t no_run = -1;  // none is recorded; 0 stands for all

class Download {
 public:
  Download(Connection& connection, Database& database) : connection_(connection), database_(database) {}
  Result<void> all();
  Sentences problems, notes;

 private:
  Result<void> read_layout();
  Result<void> read_topics();
  Result<std::vector<Run>> read_runs();
  /// Rows of runs that rtdata_run does not have.
  Result<void> look_for_other_runs();
  Result<void> copy_run(const Run& run);
  Result<void> copy_rows(const Run& run, const Topic& topic);
  Result<void> copy_account(const Run& run);
  Result<void> make_account(const Run& run);
  Result<void> finish_account(const Run& run);
  void compare(const Run& run);

  Connection& connection_;
  Database& database_;
  sqlite::AccountSums sums_;
  std::vector<std::vector<AccountColumn>> columns_;
  std::vector<Topic> topics_;
  std::map<std::pair<std::string, std::string>, Position> positions_;  // of the run, by table and origin
  Time first_{}, last_{};                                              // of its rows
  std::map<std::string, bool, std::less<>> tables_;                    // of the account: whether they are there
};

std::string key_text(const Position& position) { return position.topic + ", origin " + position.origin; }

Result<void> Download::all() {
  auto columns = account_columns();
  if (!columns) return std::move(columns).error();
  columns_ = std::move(*columns);
  if (auto begun = connection_.run("BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY"); !begun)
    return std::move(begun).error();
  auto there = connection_.run(
      "SELECT relname FROM pg_class WHERE pg_table_is_visible(oid) AND relkind IN ('r', 'p') AND relname LIKE "
      "'rtdata\\_%'");
  if (!there) return std::move(there).error();
  for (int row = 0; row < there->rows(); ++row) tables_.emplace(there->text(row, 0), true);
  for (const char* table : {"rtdata_layout", "rtdata_run", "rtdata_topic", "rtdata_position"}) {
    if (!tables_.contains(table)) {
      return Error{
          Errc::not_a_recording, "cannot read the server", "database", std::string("it has no table ") + table,
          "name the database, and with ?options=-csearch_path%3DNAME the schema, that a postgresql sink stores "
          "into"};
    }
  }
  if (auto done = database_.execute(std::string("PRAGMA journal_mode=OFF;PRAGMA synchronous=OFF;BEGIN;") +
                                    sqlite::schema + sqlite::run_view());
      !done)
    return done;
  if (auto done = sums_.watch(database_); !done) return done;
  sums_.begin(no_run);
  if (auto done = read_layout(); !done) return done;
  if (auto done = read_topics(); !done) return done;
  auto runs = read_runs();
  if (!runs) return std::move(runs).error();
  if (auto done = look_for_other_runs(); !done) return done;
  for (const Run& run : *runs) {
    if (auto done = copy_run(run); !done) return done;
  }
  if (auto done = sums_.write_changes(database_); !done) return done;
  for (const Run& run : *runs) {
    if (auto done = finish_account(run); !done) return done;
  }
  if (auto done = sqlite::write_utc_lines(database_); !done) return done;
  return database_.execute(sqlite::account_views() +
                           ";PRAGMA application_id=" + std::to_string(sqlite::application_id) +
                           ";PRAGMA user_version=" + std::to_string(sqlite::schema_version) + ";COMMIT");
}

Result<void> Download::read_layout() {
  auto version = connection_.run("SELECT coalesce(max(version), 0) FROM rtdata_layout");
  if (!version) return std::move(version).error();
  if (version->integer(0, 0) == 0) problems.emplace_back(no_run, "rtdata_layout does not say of which version it is.");
  return check_layout(version->integer(0, 0));
}

Result<void> Download::read_topics() {
  auto topics = connection_.run(
      "SELECT topic, table_name, description, version FROM rtdata_topic ORDER BY topic, version");
  if (!topics) return std::move(topics).error();
  std::int64_t version = 0;
  for (int row = 0; row < topics->rows(); ++row) {
    if (row > 0 && topics->text(row, 0) != topics->text(row - 1, 0)) version = 0;
    if (topics->integer(row, 3) != ++version) {
      problems.emplace_back(no_run, "rtdata_topic: " + std::string(topics->text(row, 0)) + " has version " +
                                        std::string(topics->text(row, 3)) + " where " + std::to_string(version) +
                                        " follows.");
      version = topics->integer(row, 3);
    }
    Topic topic{std::string(topics->text(row, 0)), std::string(topics->text(row, 1)), nullptr, {}, {}};
    auto description = Description::from_json(topics->text(row, 2));
    if (!description) {
      Error error = std::move(description).error();
      error.where = "rtdata_topic, " + topic.topic;
      return error;
    }
    topic.description = std::move(*description);
    auto columns = connection_.query(
        "SELECT attname FROM pg_attribute WHERE attrelid = to_regclass($1) AND attnum > 0 AND NOT attisdropped ORDER "
        "BY "
        "attnum",
        {{quoted_name(topic.table)}});
    if (!columns) return std::move(columns).error();
    std::map<std::string, const Leaf*, std::less<>> leaves;
    for (const Leaf& leaf : topic.description->leaves()) leaves.emplace(short_name(leaf.path), &leaf);
    for (int column = 0; column < columns->rows(); ++column) {
      const auto leaf = leaves.find(columns->text(column, 0));
      if (leaf == leaves.end()) continue;
      topic.leaves.push_back(leaf->second);
      topic.columns += "," + quoted_name(leaf->first);
    }
    if (topic.leaves.size() != leaves.size()) {
      return Error{Errc::damaged, "cannot read the server", "table " + topic.table,
                   columns->rows() == 0 ? "it is not there" : "it has not all columns of its description", ""};
    }
    topics_.push_back(std::move(topic));
  }
  return {};
}

Result<std::vector<Run>> Download::read_runs() {
  auto runs = connection_.run("SELECT run, account_at IS NOT NULL, uuid, machine FROM rtdata_run ORDER BY run");
  if (!runs) return std::move(runs).error();
  std::vector<Run> all;
  for (int row = 0; row < runs->rows(); ++row) {
    all.push_back({runs->integer(row, 0), runs->text(row, 1) == "t", std::string(runs->text(row, 2)),
                   std::string(runs->text(row, 3))});
  }
  return all;
}

Result<void> Download::look_for_other_runs() {
  std::vector<std::string> tables{"rtdata_position"};
  for (const std::string_view table : account_tables)
    if (tables_.contains(table)) tables.emplace_back(table);
  for (const Topic& topic : topics_) tables.push_back(topic.table);
  for (const std::string& table : tables) {
    auto others = connection_.run("SELECT run, count(*) FROM " + quoted_name(table) +
                                  " WHERE run NOT IN (SELECT run FROM rtdata_run) GROUP BY run ORDER BY run");
    if (!others) return std::move(others).error();
    for (int row = 0; row < others->rows(); ++row) {
      problems.emplace_back(no_run, table + ": rows of run " + std::string(others->text(row, 0)) + " (" +
                                        std::string(others->text(row, 1)) + "), which is not in rtdata_run.");
    }
  }
  return {};
}

Result<void> Download::copy_run(const Run& run) {
  auto rows = connection_.run(
      "SELECT table_name, origin, topic, first_sequence, last_sequence, rows, sum FROM rtdata_position WHERE run = " +
      std::to_string(run.run));
  if (!rows) return std::move(rows).error();
  positions_.clear();
  first_ = Time::max();
  last_ = Time::min();
  for (int row = 0; row < rows->rows(); ++row) {
    Position& position = positions_[{std::string(rows->text(row, 0)), std::string(rows->text(row, 1))}];
    const auto at = [&](int column) { return static_cast<std::uint64_t>(rows->integer(row, column)); };
    position = {std::string(rows->text(row, 2)),
                std::string(rows->text(row, 1)),
                std::string(rows->text(row, 0)),
                at(3),
                at(4),
                at(5),
                at(6),
                0,
                0,
                0,
                0,
                true};
  }
  for (const Topic& topic : topics_) {
    if (auto done = copy_rows(run, topic); !done) return done;
  }
  compare(run);
  return run.has_account ? copy_account(run) : make_account(run);
}

Result<void> Download::copy_rows(const Run& run, const Topic& topic) {
  detail::EscapedTexts escaped;
  sqlite::ValueRanges ranges;
  ranges.begin(run.run, Time{});
  std::optional<sqlite::TopicTable> table;
  std::vector<std::unique_ptr<SlotInfo>> slots;
  std::vector<std::vector<std::byte>> payloads(64, std::vector<std::byte>(topic.description->size()));
  std::size_t next_payload = 0;
  Position* position = nullptr;
  std::string bytes;
  const auto row = [&](const Reply& reply) -> Result<void> {
    PGresult* const raw = reply.raw();
    const std::string_view origin = reply.text(0, 3);
    if (slots.empty() || slots.back()->origin != origin) {
      slots.push_back(std::make_unique<SlotInfo>(SlotInfo{0, std::string(origin), topic.topic, topic.description, {}}));
      position = &positions_[{topic.table, std::string(origin)}];
      if (!position->is_known) position->topic = topic.topic;
      position->origin = std::string(origin);
      position->table = topic.table;
    }
    if (!table) {
      sqlite::NewUtcViews views;
      auto made = sqlite::TopicTable::prepare(database_, *slots.back(), run.run, escaped, ranges, views);
      if (!made) return std::move(made).error();
      if (auto viewed = views.make(database_); !viewed) return viewed;
      table.emplace(std::move(*made));
    }
    const auto sequence = load_big<std::uint64_t>(reply.text(0, 4).data());
    const auto time = load_big<std::int64_t>(reply.text(0, 1).data());
    first_ = std::min(first_, from_nanoseconds(time));
    last_ = std::max(last_, from_nanoseconds(time));
    // The row as it was sent.
    bytes.clear();
    std::size_t end = 0;
    const int columns = PQnfields(raw);
    for (int column = 0; column < columns; ++column) {
      const bool is_null = reply.is_null(0, column);
      const std::string_view value = reply.text(0, column);
      const auto length = static_cast<std::uint32_t>(is_null ? -1 : static_cast<std::int32_t>(value.size()));
      for (int shift = 24; shift >= 0; shift -= 8) bytes += static_cast<char>(length >> shift & 0xff);
      bytes += value;
      if (!is_null) end = bytes.size();
    }
    if (position->found_rows++ == 0) position->found_first = sequence;
    position->found_last = sequence;
    position->found_sum += hash_of_row(std::string_view(bytes).substr(0, end));
    // The table keeps the payload until it is inserted, which it does in groups.
    std::vector<std::byte>& payload = payloads[next_payload++ % payloads.size()];
    std::fill(payload.begin(), payload.end(), std::byte{0});
    for (std::size_t i = 0; i < topic.leaves.size(); ++i) {
      const Leaf& leaf = *topic.leaves[i];
      const int column = fixed_column_count + static_cast<int>(i);
      Value value;
      if (reply.is_null(0, column)) {
        if (leaf.optional != nullptr || (leaf.kind != Kind::f32 && leaf.kind != Kind::f64)) continue;
        value = std::numeric_limits<double>::quiet_NaN();
      } else if (!convert(reply.text(0, column), leaf, value)) {
        return Error{Errc::damaged, "cannot read a row",
                     topic.topic + ", run " + std::to_string(run.run) + ", origin " + std::string(origin) +
                         ", sequence " + std::to_string(sequence),
                     "field " + leaf.path + " holds what is no " + std::string(name_of(leaf.kind)), ""};
      }
      if (auto done = write(leaf, payload.data(), value); !done) return done;
    }
    EventHeader header;
    header.time = from_nanoseconds(time);
    header.sequence = sequence;
    header.origin = slots.back()->origin;
    return table->insert(
        {static_cast<std::uint32_t>(slots.size() - 1), slots.back().get(), header, std::span(payload)});
  };
  auto done = connection_.each(std::string("SELECT ") + fixed_columns + topic.columns + " FROM " +
                                   quoted_name(topic.table) + " WHERE run = " + std::to_string(run.run) +
                                   " ORDER BY run, origin, sequence",
                               row);
  if (done && table) done = table->flush();
  if (done) done = ranges.write(database_, sqlite::ValueRanges::Close::all, Time{});
  return done;
}

void Download::compare(const Run& run) {
  for (const auto& [key, one] : positions_) {
    const auto tell = [&, &one = one](const std::string& text) {
      problems.emplace_back(run.run, key_text(one) + ": " + text);
    };
    const auto topic = std::find_if(topics_.begin(), topics_.end(),
                                    [&one = one](const Topic& other) { return other.table == one.table; });
    if (topic == topics_.end()) {
      tell("rtdata_position has it in the table " + one.table + ", of which rtdata_topic knows nothing.");
    } else if (topic->topic != one.topic) {
      tell("rtdata_position has it in the table " + one.table + ", which is that of " + topic->topic + ".");
    } else if (!one.is_known) {
      tell(std::to_string(one.found_rows) + " rows of which rtdata_position knows nothing.");
    } else if (one.found_rows != one.rows) {
      tell(std::to_string(one.found_rows) + " rows, rtdata_position says that " + std::to_string(one.rows) +
           " were stored.");
    } else if (one.rows != 0 && (one.found_first != one.first || one.found_last != one.last)) {
      tell("sequences " + std::to_string(one.found_first) + " to " + std::to_string(one.found_last) +
           ", rtdata_position says " + std::to_string(one.first) + " to " + std::to_string(one.last) + ".");
    } else if (one.found_sum != one.sum) {
      tell("the sum of the hashes of its rows is another than when they were sent: a value was changed.");
    }
  }
}

Result<void> Download::copy_account(const Run& run) {
  for (std::size_t table = 0; table < account_tables.size(); ++table) {
    const std::string name(account_tables[table]);
    std::string columns, marks;
    for (const AccountColumn& column : columns_[table]) {
      columns += (columns.empty() ? "" : ",") + quoted_name(column.name);
      marks += marks.empty() ? "?" : ",?";
    }
    auto rows = connection_.run("SELECT " + columns + " FROM " + name + " WHERE run = " + std::to_string(run.run));
    if (!rows) return std::move(rows).error();
    auto insert = database_.prepare("INSERT INTO " + name + "(" + columns + ") VALUES(" + marks + ")");
    if (!insert) return std::move(insert).error();
    for (int row = 0; row < rows->rows(); ++row) {
      for (int column = 0; column < static_cast<int>(columns_[table].size()); ++column) {
        if (rows->is_null(row, column)) {
          insert->bind_null(column + 1);
        } else if (columns_[table][static_cast<std::size_t>(column)].type == "bigint") {
          insert->bind(column + 1, rows->integer(row, column));
        } else {
          insert->bind(column + 1, rows->text(row, column));
        }
      }
      if (auto done = insert->run(); !done) return done;
    }
  }
  // Of a run that goes on, rows may have come since: of each origin the first so many are in the account.
  auto open = database_.prepare("SELECT count(*) FROM rtdata_run WHERE run = ? AND state = 'recording'");
  if (!open) return std::move(open).error();
  open->bind(1, run.run);
  auto is_open = open->step();
  if (!is_open) return std::move(is_open).error();
  if (open->integer(0) == 0) return {};
  open->reset();
  auto update = database_.prepare("UPDATE rtdata_ledger SET rows_up_to = ? WHERE run = ? AND topic = ? AND origin = ?");
  if (!update) return std::move(update).error();
  auto ledger = database_.prepare("SELECT topic, origin, stored - pruned FROM rtdata_ledger WHERE run = ?");
  if (!ledger) return std::move(ledger).error();
  ledger->bind(1, run.run);
  struct Entry {
    std::string topic, origin;
    std::int64_t rows;
  };
  std::vector<Entry> entries;
  for (;;) {
    auto row = ledger->step();
    if (!row) return std::move(row).error();
    if (!*row) break;
    entries.push_back({std::string(ledger->text(0)), std::string(ledger->text(1)), ledger->integer(2)});
  }
  ledger->reset();
  for (const Entry& entry : entries) {
    auto tables = database_.prepare("SELECT table_name FROM rtdata_topic WHERE topic = ? ORDER BY version DESC");
    if (!tables) return std::move(tables).error();
    tables->bind(1, entry.topic);
    auto names = tables->texts();
    if (!names) return std::move(names).error();
    std::int64_t last = 0;
    for (const std::string& name : *names) {
      auto rowid = database_.prepare("SELECT _rowid_ FROM " + sqlite::quoted(name) +
                                     " WHERE run = ? AND origin = ? ORDER BY _rowid_ LIMIT 1 OFFSET ?");
      if (!rowid) return std::move(rowid).error();
      rowid->bind(1, run.run).bind(2, entry.origin).bind(3, std::max<std::int64_t>(entry.rows - 1, 0));
      auto row = rowid->step();
      if (!row) return std::move(row).error();
      if (*row && entry.rows > 0) last = rowid->integer(0);
    }
    update->bind(1, last).bind(2, run.run).bind(3, entry.topic).bind(4, entry.origin);
    if (auto done = update->run(); !done) return done;
  }
  return {};
}

/// Of a run whose events came from memory, or whose account has not come yet: what rtdata_position says, and the times
/// of its rows.
Result<void> Download::make_account(const Run& run) {
  auto insert = database_.prepare(
      "INSERT INTO rtdata_run(run, uuid, name, notes, configuration, program, host, boot_id, pid, started, "
      "ended, clock_offset, state, format) VALUES(?,?,'','','','',?,'',0,?,?,0,'recording',?)");
  if (!insert) return std::move(insert).error();
  insert->bind(1, run.run).bind(2, run.uuid).bind(3, run.machine).bind(6, std::int64_t{sqlite::schema_version});
  const bool has_rows = first_ <= last_;
  insert->bind(4, to_nanoseconds(has_rows ? first_ : Time{}));
  has_rows ? insert->bind(5, to_nanoseconds(last_)) : insert->bind_null(5);
  if (auto done = insert->run(); !done) return done;
  notes.emplace_back(run.run,
                     "No account came along, as of events that are sent from memory: what is here is "
                     "whole, what never came is not known.");
  return {};
}

Result<void> Download::finish_account(const Run& run) {
  if (!run.has_account || !tables_.contains("rtdata_checksum")) return {};
  auto state = database_.prepare("SELECT state FROM rtdata_run WHERE run = ?");
  if (!state) return std::move(state).error();
  state->bind(1, run.run);
  auto row = state->step();
  if (!row) return std::move(row).error();
  if (!*row) return {};
  if (state->text(0) == "recording") return {};  // it gets them when it ends
  auto lines = connection_.run("SELECT table_name, columns, rows, sum FROM rtdata_checksum WHERE run = " +
                               std::to_string(run.run));
  if (!lines) return std::move(lines).error();
  for (int line = 0; line < lines->rows(); ++line) {
    const std::string table(lines->text(line, 0));
    if (auto done = sqlite::insert_line(database_, {run.run,
                                                    table,
                                                    "",
                                                    0,
                                                    0,
                                                    static_cast<int>(lines->integer(line, 1)),
                                                    {static_cast<std::uint64_t>(lines->integer(line, 2)),
                                                     static_cast<std::uint64_t>(lines->integer(line, 3))}});
        !done)
      return done;
  }
  return {};
}

}  // namespace
}  // namespace postgresql

bool is_server_url(std::string_view text) noexcept {
  return text.starts_with("postgresql://") || text.starts_with("postgres://");
}

std::string shown_url(const std::string& url) {
  auto parts = postgresql::look_at_url(url);
  if (!parts) return url.substr(0, url.find(':')) + "://...";
  std::string text = url.substr(0, url.find('?'));
  const auto at = text.rfind('@');
  const auto begin = text.find("://") + 3;
  const auto colon = text.find(':', begin);
  if (at != std::string::npos && colon < at) text.erase(colon, at - colon);
  return text;
}

Result<ServerRecording> download(const PostgresqlConfig& config) {
  auto connection = postgresql::Connection::open(postgresql::address_of(config));
  if (!connection) return std::move(connection).error();
  // Sorting a large table may take long, and is waited for.
  if (auto set = connection->run("SET statement_timeout = 0"); !set) return std::move(set).error();
  connection->set_timeout(std::chrono::hours{1});
  const auto folder = std::make_shared<postgresql::Folder>();
  if (!folder->is_made) return system_error(errno, "cannot make a folder", folder->path, "set TMPDIR");
  const std::string path = folder->path + "/server.db";
  postgresql::Sentences problems, notes;
  {
    auto database = sqlite::Database::open(path, sqlite::Database::Mode::write, 0600);
    if (!database) return std::move(database).error();
    postgresql::Download all(*connection, *database);
    if (auto done = all.all(); !done) return std::move(done).error();
    problems = std::move(all.problems);
    notes = std::move(all.notes);
    *database = sqlite::Database();  // before what its triggers call
  }
  auto recording = Recording::open(path);
  if (!recording) return std::move(recording).error();
  return ServerRecording{folder, std::move(*recording), std::move(problems), std::move(notes)};
}

Result<VerifyReport> verify_server(const PostgresqlConfig& config) {
  auto server = download(config);
  if (!server) return std::move(server).error();
  auto report = detail::verify_contents(server->recording);
  if (!report) return report;
  report->path = shown_url(config.url);
  for (const auto& [number, problem] : server->problems)
    if (number == postgresql::no_run) report->problems.push_back(problem);
  for (RunReport& run : report->runs) {
    for (const auto& [number, note] : server->notes) {
      if (number == run.info.run) run.notes = {note};  // all others would speak of an account
    }
    for (auto& [number, problem] : server->problems) {
      if (number != run.info.run) continue;
      run.problems.push_back(std::move(problem));
      run.verdict = Verdict::not_balanced;
    }
  }
  return report;
}

}  // namespace rtdata
