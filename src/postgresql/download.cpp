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
#include <set>

#include "data/utf8.hpp"
#include "postgresql/account_copy.hpp"
#include "postgresql/connection.hpp"
#include "postgresql/layout.hpp"
#include "postgresql/postgresql_writer.hpp"
#include "postgresql/server_table.hpp"
#include "recording/account_sums.hpp"
#include "recording/recording_file.hpp"
#include "recording/schema.hpp"
#include "recording/topic_table.hpp"
#include "recording/utc_line.hpp"
#include "recording/verify_run.hpp"
#include "rtdata/data/value.hpp"
#include "rtdata/postgresql/recording.hpp"

namespace rtdata {
namespace postgresql {
namespace {

using sqlite::account_tables;
using sqlite::Database;

struct Folder {
  Folder() {
    const char* base = ::getenv("TMPDIR");
    path = std::string(base != nullptr && *base != '\0' ? base : "/tmp") + "/rtdata-XXXXXX";
    if (::mkdtemp(path.data()) == nullptr)
      throw SetupError(system_error(errno, "cannot make a folder", path, "set TMPDIR"));
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path, ignored);
  }
  std::string path;
};

template <class T>
T load_big(const char* from) noexcept {
  T value;
  std::memcpy(&value, from, sizeof value);
  return big_endian(value);
}

/// numeric_send; false: it is not a whole number of 64 bits.
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

/// An origin of a run, from rtdata_position and from its rows.
struct Origin {
  std::string topic;
  Position said, found;
};

struct Run {
  std::int64_t run = 0;
  bool has_account = false;
  std::string uuid, machine;
  std::string is_of() const { return " WHERE run = " + std::to_string(run); }
};

/// By run, a sentence each.
using Sentences = std::vector<std::pair<std::int64_t, std::string>>;

constexpr std::int64_t no_run = -1;  // no run has this number; 0 means all runs

class Download {
 public:
  Download(Connection& connection, Database& database) : connection_(connection), database_(database) {}
  void all();
  Sentences problems, notes;

 private:
  void read_layout();
  void read_topics();
  /// Searches rows of runs that are missing in rtdata_run.
  void look_for_other_runs();
  void copy_run(const Run& run);
  void copy_rows(const Run& run, const Topic& topic);
  void copy_account(const Run& run);
  void set_rows_up_to(const Run& run);
  void make_account(const Run& run);
  void compare_account(const Run& run);
  void compare(const Run& run);

  Connection& connection_;
  Database& database_;
  sqlite::AccountSums sums_;
  const std::vector<std::vector<AccountColumn>> columns_ = account_columns();
  std::vector<Topic> topics_;
  std::map<std::pair<std::string, std::string>, Origin> origins_;  // of the run, by table and origin
  Time first_{}, last_{};                                          // of the run's rows
  std::set<std::string, std::less<>> tables_;                      // of the account, that are there
};

void Download::all() {
  connection_.run("BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY");
  const Reply there = connection_.run(
      "SELECT relname FROM pg_class WHERE pg_table_is_visible(oid) AND relkind IN ('r', 'p') AND relname LIKE "
      "'rtdata\\_%'");
  for (int row = 0; row < there.rows(); ++row) tables_.emplace(there.text(row, 0));
  for (const char* table : {"rtdata_layout", "rtdata_run", "rtdata_topic", "rtdata_position"}) {
    if (!tables_.contains(table)) {
      throw SetupError(
          {Errc::not_a_recording, "cannot read the server", "database", std::string("it has no table ") + table,
           "name the database, and with ?options=-csearch_path%3DNAME the schema, that a postgresql sink stores "
           "into"});
    }
  }
  database_.execute("PRAGMA journal_mode=OFF;PRAGMA synchronous=OFF;BEGIN");
  sqlite::make_recording(database_);
  read_layout();
  read_topics();
  const Reply rows = connection_.run("SELECT run, account_at IS NOT NULL, uuid, machine FROM rtdata_run ORDER BY run");
  std::vector<Run> runs;
  for (int row = 0; row < rows.rows(); ++row)
    runs.push_back({rows.integer(row, 0), rows.text(row, 1) == "t", std::string(rows.text(row, 2)),
                    std::string(rows.text(row, 3))});
  look_for_other_runs();
  if (tables_.contains("rtdata_checksum")) {
    const Reply odd = connection_.run("SELECT run FROM rtdata_run WHERE account_at IS DISTINCT FROM ended");
    for (int row = 0; row < odd.rows(); ++row)
      problems.emplace_back(odd.integer(row, 0), "rtdata_run: account_at is not the end of the account that is there.");
  }
  for (const Run& run : runs) copy_run(run);
  for (const Run& run : runs) sums_.add_run(database_, run.run);
  sums_.write(database_);
  sqlite::write_utc_lines(database_);
  database_.execute("COMMIT");
}

void Download::read_layout() {
  const Reply layout = connection_.run("SELECT coalesce(max(version), 0), count(*) FROM rtdata_layout");
  check_layout(layout.integer(0, 0));
  if (layout.integer(0, 0) != layout_version || layout.integer(0, 1) != 1)
    problems.emplace_back(no_run, "rtdata_layout must have one row with the version.");
}

void Download::read_topics() {
  const Reply topics = connection_.run(
      "SELECT topic, table_name, description, version FROM rtdata_topic ORDER BY topic, version");
  std::int64_t version = 0;
  for (int row = 0; row < topics.rows(); ++row) {
    if (row > 0 && topics.text(row, 0) != topics.text(row - 1, 0)) version = 0;
    if (topics.integer(row, 3) != ++version) {
      problems.emplace_back(no_run, "rtdata_topic: " + std::string(topics.text(row, 0)) + " has version " +
                                        std::string(topics.text(row, 3)) + " where " + std::to_string(version) +
                                        " follows.");
      version = topics.integer(row, 3);
    }
    Topic topic{std::string(topics.text(row, 0)), std::string(topics.text(row, 1)), nullptr, {}, {}};
    auto description = Description::from_json(topics.text(row, 2));
    if (!description) {
      description.error().where = "rtdata_topic, " + topic.topic;
      throw SetupError(std::move(description).error());
    }
    topic.description = std::move(*description);
    const Reply columns = columns_of(connection_, topic.table);
    std::map<std::string, const Leaf*, std::less<>> leaves;
    for (const Leaf& leaf : topic.description->leaves()) leaves.emplace(short_name(leaf.path), &leaf);
    for (int column = 0; column < columns.rows(); ++column) {
      const auto leaf = leaves.find(columns.text(column, 0));
      if (leaf == leaves.end()) continue;
      topic.leaves.push_back(leaf->second);
      topic.columns += "," + quoted_name(leaf->first);
    }
    if (topic.leaves.size() != leaves.size()) {
      throw SetupError({Errc::damaged, "cannot read the server", "table " + topic.table,
                        columns.rows() == 0 ? "it is not there" : "it lacks columns of its description", ""});
    }
    topics_.push_back(std::move(topic));
  }
}

void Download::look_for_other_runs() {
  std::vector<std::string> tables{"rtdata_position"};
  for (const std::string_view table : account_tables)
    if (tables_.contains(table)) tables.emplace_back(table);
  for (const Topic& topic : topics_) tables.push_back(topic.table);
  for (const std::string& table : tables) {
    const Reply others = connection_.run("SELECT run, count(*) FROM " + quoted_name(table) +
                                         " WHERE run NOT IN (SELECT run FROM rtdata_run) GROUP BY run ORDER BY run");
    for (int row = 0; row < others.rows(); ++row) {
      problems.emplace_back(no_run, table + ": rows of run " + std::string(others.text(row, 0)) + " (" +
                                        std::string(others.text(row, 1)) + "), which is not in rtdata_run.");
    }
  }
}

void Download::copy_run(const Run& run) {
  const Reply rows = connection_.run(
      "SELECT table_name, origin, topic, first_sequence, last_sequence, rows, sum FROM rtdata_position" + run.is_of());
  origins_.clear();
  first_ = Time::max();
  last_ = Time::min();
  for (int row = 0; row < rows.rows(); ++row) {
    const auto at = [&](int column) { return static_cast<std::uint64_t>(rows.integer(row, column)); };
    origins_[{std::string(rows.text(row, 0)), std::string(rows.text(row, 1))}] = {
        std::string(rows.text(row, 2)), {true, at(3), at(4), at(5), at(6)}, {}};
  }
  for (const Topic& topic : topics_) copy_rows(run, topic);
  compare(run);
  run.has_account ? copy_account(run) : make_account(run);
}

void Download::copy_rows(const Run& run, const Topic& topic) {
  detail::EscapedTexts no_utf8;
  std::optional<sqlite::TopicTable> table;
  std::vector<std::unique_ptr<SlotInfo>> slots;
  std::vector<std::vector<std::byte>> payloads(64, std::vector<std::byte>(topic.description->size()));
  std::size_t next_payload = 0;
  Origin* of = nullptr;
  std::string bytes;
  const auto row = [&](const Reply& reply) {
    const std::string_view origin = reply.text(0, 3);
    if (slots.empty() || slots.back()->origin != origin) {
      slots.push_back(std::make_unique<SlotInfo>(SlotInfo{0, std::string(origin), topic.topic, topic.description, {}}));
      of = &origins_[{topic.table, std::string(origin)}];
      if (!of->said.is_there) of->topic = topic.topic;
    }
    if (!table) {
      sqlite::NewUtcViews views;
      table.emplace(sqlite::TopicTable::prepare(database_, *slots.back(), run.run, no_utf8, sums_, views, nullptr));
      views.make(database_);
    }
    const auto sequence = load_big<std::uint64_t>(reply.text(0, 4).data());
    const auto time = load_big<std::int64_t>(reply.text(0, 1).data());
    first_ = std::min(first_, from_nanoseconds(time));
    last_ = std::max(last_, from_nanoseconds(time));
    // The row as it was sent.
    bytes.clear();
    std::size_t end = 0;
    const int columns = PQnfields(reply.raw());
    for (int column = 0; column < columns; ++column) {
      const bool is_null = reply.is_null(0, column);
      const std::string_view value = reply.text(0, column);
      const auto length = static_cast<std::uint32_t>(is_null ? -1 : static_cast<std::int32_t>(value.size()));
      for (int shift = 24; shift >= 0; shift -= 8) bytes += static_cast<char>(length >> shift & 0xff);
      bytes += value;
      if (!is_null) end = bytes.size();
    }
    if (of->found.rows++ == 0) of->found.first = sequence;
    of->found.last = sequence;
    of->found.sum += hash_of_row(std::string_view(bytes).substr(0, end));
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
        throw SetupError(
            {Errc::damaged, "cannot read a row",
             topic.topic + ", run " + std::to_string(run.run) + ", origin " + std::string(origin) + ", sequence " +
                 std::to_string(sequence),
             "field " + leaf.path + " holds a value that is not a valid " + std::string(name_of(leaf.kind)), ""});
      }
      write(leaf, payload.data(), value).or_throw();
    }
    EventHeader header;
    header.time = from_nanoseconds(time);
    header.sequence = sequence;
    header.origin = slots.back()->origin;
    table->insert({static_cast<std::uint32_t>(slots.size() - 1), slots.back().get(), header, std::span(payload)});
  };
  connection_.each(std::string("SELECT ") + fixed_columns + topic.columns + " FROM " + quoted_name(topic.table) +
                       run.is_of() + " ORDER BY run, origin, sequence",
                   row);
  if (table) table->flush();
}

void Download::compare(const Run& run) {
  for (const auto& [key, one] : origins_) {
    const auto& [table, origin] = key;
    const Position &said = one.said, &found = one.found;
    const auto tell = [&, &one = one, &origin = origin](const std::string& text) {
      problems.emplace_back(run.run, one.topic + ", origin " + origin + ": " + text);
    };
    const auto topic = std::find_if(topics_.begin(), topics_.end(),
                                    [&table = table](const Topic& other) { return other.table == table; });
    if (topic == topics_.end()) {
      tell("rtdata_position says that its rows are in the table " + table +
           ", but rtdata_topic does not list this table.");
    } else if (topic->topic != one.topic) {
      tell("rtdata_position says that its rows are in the table " + table + ", but that table belongs to " +
           topic->topic + ".");
    } else if (!said.is_there) {
      tell(std::to_string(found.rows) + " rows that rtdata_position does not list.");
    } else if (found.rows != said.rows) {
      tell(std::to_string(found.rows) + " rows, rtdata_position says that " + std::to_string(said.rows) +
           " were stored.");
    } else if (said.rows != 0 && (found.first != said.first || found.last != said.last)) {
      tell("sequences " + std::to_string(found.first) + " to " + std::to_string(found.last) +
           ", rtdata_position says " + std::to_string(said.first) + " to " + std::to_string(said.last) + ".");
    } else if (found.sum != said.sum) {
      tell("the sum of the hashes of its rows has changed since they were sent: a value was changed.");
    }
  }
}

void Download::copy_account(const Run& run) {
  for (std::size_t table = 0; table < account_tables.size(); ++table) {
    const std::string name(account_tables[table]);
    const std::string columns = names_of(columns_[table]);
    std::string marks = "?";
    for (std::size_t i = 1; i < columns_[table].size(); ++i) marks += ",?";
    const Reply rows = connection_.run("SELECT " + columns + " FROM " + name + run.is_of());
    auto insert = database_.prepare("INSERT INTO " + name + "(" + columns + ") VALUES(" + marks + ")");
    for (int row = 0; row < rows.rows(); ++row) {
      for (int column = 0; column < static_cast<int>(columns_[table].size()); ++column) {
        if (rows.is_null(row, column)) {
          insert.bind_null(column + 1);
        } else if (columns_[table][static_cast<std::size_t>(column)].type == "bigint") {
          insert.bind(column + 1, rows.integer(row, column));
        } else {
          insert.bind(column + 1, rows.text(row, column));
        }
      }
      insert.run();
    }
  }
  if (database_.integer("SELECT state = 'recording' FROM rtdata_run" + run.is_of()) != 0) {
    set_rows_up_to(run);
  } else {
    compare_account(run);
  }
}

/// A running run may have newer rows: only the first rows of each origin are in the account.
void Download::set_rows_up_to(const Run& run) {
  struct Entry {
    std::string topic, origin;
    std::int64_t rows;
  };
  std::vector<Entry> entries;
  auto ledger = database_.prepare("SELECT topic, origin, stored - pruned FROM rtdata_ledger" + run.is_of());
  while (ledger.step())
    entries.push_back({std::string(ledger.text(0)), std::string(ledger.text(1)), ledger.integer(2)});
  ledger.reset();
  auto update = database_.prepare("UPDATE rtdata_ledger SET rows_up_to = ?" + run.is_of() +
                                  " AND topic = ? AND origin = ?");
  auto tables = database_.prepare("SELECT table_name FROM rtdata_topic WHERE topic = ? ORDER BY version DESC");
  for (const Entry& entry : entries) {
    const auto names = tables.bind(1, entry.topic).texts();
    tables.reset();
    std::int64_t last = 0;
    for (const std::string& name : names) {
      auto rowid = database_.prepare("SELECT _rowid_ FROM " + sqlite::quoted(name) + run.is_of() +
                                     " AND origin = ? ORDER BY _rowid_ LIMIT 1 OFFSET ?");
      rowid.bind(1, entry.origin).bind(2, std::max<std::int64_t>(entry.rows - 1, 0));
      if (rowid.step() && entry.rows > 0) last = rowid.integer(0);
    }
    update.bind(1, last).bind(2, entry.topic).bind(3, entry.origin).run();
  }
}

/// For a run from memory, or without an account yet: makes an account from rtdata_position and the times of the rows.
void Download::make_account(const Run& run) {
  auto insert = database_.prepare(
      "INSERT INTO rtdata_run(run, uuid, name, notes, configuration, program, host, boot_id, pid, started, "
      "ended, clock_offset, state, format) VALUES(?,?,'','','','',?,'',0,?,?,0,'recording',?)");
  insert.bind(1, run.run).bind(2, run.uuid).bind(3, run.machine).bind(6, std::int64_t{sqlite::schema_version});
  const bool has_rows = first_ <= last_;
  insert.bind(4, to_nanoseconds(has_rows ? first_ : Time{}));
  has_rows ? insert.bind(5, to_nanoseconds(last_)) : insert.bind_null(5);
  insert.run();
  notes.emplace_back(
      run.run,
      "The account was not sent, because the events were sent from memory: the rows are intact, but losses "
      "on the way are not known.");
}

/// Compares the account of an ended run with its checksums.
void Download::compare_account(const Run& run) {
  if (!tables_.contains("rtdata_checksum")) return;
  const Reply lines = connection_.run("SELECT table_name, columns, rows, sum FROM rtdata_checksum" + run.is_of());
  sqlite::RowHash hash;
  const auto compare_sum = [&](std::string_view table, int columns, const sqlite::RowSum& found) {
    bool agrees = false;
    for (int line = 0; line < lines.rows(); ++line) {
      const auto at = [&](int column) { return static_cast<std::uint64_t>(lines.integer(line, column)); };
      agrees = agrees || (lines.text(line, 0) == table && lines.integer(line, 1) == columns && at(2) == found.rows &&
                          at(3) == found.sum);
    }
    if (!agrees)
      problems.emplace_back(run.run, std::string(table) + ": the checksum of its " + std::to_string(found.rows) +
                                         " rows is not the same as when they were sent, or is not there: a row was "
                                         "changed, added or deleted.");
  };
  compare_sum("rtdata_position", position_columns, sum_of_positions(connection_, run.run));
  for (const std::string_view table : account_tables) {
    auto rows = database_.prepare("SELECT * FROM " + std::string(table) + run.is_of());
    const int columns = sqlite::hashed_columns(rows.raw());
    sqlite::RowSum found;
    while (rows.step()) found.add(sqlite::hash_of(hash, rows.raw(), 1, columns));
    compare_sum(table, columns, found);
  }
}

}  // namespace
}  // namespace postgresql

bool is_server_url(std::string_view text) noexcept {
  return text.starts_with("postgresql://") || text.starts_with("postgres://");
}

std::string shown_url(const std::string& url) {
  try {
    postgresql::password_in(url);
  } catch (const SetupError&) {
    return url.substr(0, url.find(':')) + "://...";
  }
  std::string text = url.substr(0, url.find('?'));
  const auto at = text.rfind('@');
  const auto begin = text.find("://") + 3;
  const auto colon = text.find(':', begin);
  if (at != std::string::npos && colon < at) text.erase(colon, at - colon);
  return text;
}

Result<ServerRecording> download(const PostgresqlConfig& config) try {
  postgresql::Connection connection(postgresql::address_of(config));
  // Sorting a large table may take long, and is waited for.
  connection.run("SET statement_timeout = 0");
  connection.set_timeout(std::chrono::hours{1});
  const auto folder = std::make_shared<postgresql::Folder>();
  const std::string path = folder->path + "/server.db";
  postgresql::Sentences problems, notes;
  {
    auto database = sqlite::Database::open(path, sqlite::Database::Mode::write, 0600);
    postgresql::Download all(connection, database);
    all.all();
    problems = std::move(all.problems);
    notes = std::move(all.notes);
    database = sqlite::Database();
  }
  auto recording = Recording::open(path).or_throw();
  recording.file()->is_of_server = true;
  return ServerRecording{folder, std::move(recording), std::move(problems), std::move(notes)};
} catch (const SetupError& error) {
  return error.error();
}

Result<VerifyReport> verify_server(const PostgresqlConfig& config) try {
  const ServerRecording server = download(config).or_throw();
  VerifyReport report = detail::verify_contents(server.recording);
  report.path = shown_url(config.url);
  for (const auto& [number, problem] : server.problems)
    if (number == postgresql::no_run) report.problems.push_back(problem);
  for (RunReport& run : report.runs) {
    for (const auto& [number, note] : server.notes) {
      if (number == run.info.run) run.notes = {note};  // all others would speak of an account
    }
    for (const auto& [number, problem] : server.problems) {
      if (number != run.info.run) continue;
      run.problems.push_back(problem);
      run.verdict = Verdict::not_balanced;
    }
  }
  return report;
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace rtdata
