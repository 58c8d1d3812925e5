#include "recording/account_share.hpp"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

namespace rtdata::sqlite {
namespace {

constexpr std::int64_t bytes_a_row = 100;  // about
constexpr int most_pairs = 2000;           // in a transaction

struct Table {
  const char* name;
  const char* object;  // whose rows are joined
  const char* texts;   // that make a row longer
  /// Only rows of the same stretch are joined; NULL: never.
  const char* stretch;
  const char* begin;
  const char* end;
  /// Joins row ?2, which follows, into row ?1.
  const char* join;
};

constexpr Table all_tables[] = {
    {"rtdata_gap", "run, topic, origin", "length(topic) + length(origin) + length(kind) + length(reason)",
     // Gaps lie in one segment; a gap before the first segment, of a read that was under way, is not joined.
     "(SELECT CASE WHEN l.has_schedule THEN (SELECT max(s.first_due) FROM rtdata_schedule s WHERE s.run = t.run AND "
     "s.origin = t.origin AND s.topic = t.topic AND s.first_due <= t.first) ELSE 0 END FROM rtdata_ledger l WHERE "
     "l.run = t.run AND l.topic = t.topic AND l.origin = t.origin)",
     "t.first", "t.last",
     "UPDATE rtdata_gap SET kind = 'joined', reason = iif(rtdata_gap.reason = b.reason, b.reason, 'several'), "
     "last = max(rtdata_gap.last, b.last), count = coalesce(rtdata_gap.count, 1) + coalesce(b.count, 1) "
     "FROM (SELECT reason, last, count FROM rtdata_gap WHERE _rowid_ = ?2) b WHERE rtdata_gap._rowid_ = ?1"},
    {"rtdata_error", "run, object, id", "length(object) + length(id) + length(text)", "0", "t.time", "t.time",
     "UPDATE rtdata_error SET text = b.text, last = max(rtdata_error.time, rtdata_error.last, b.time, b.last), "
     "count = rtdata_error.count + b.count "
     "FROM (SELECT text, time, last, count FROM rtdata_error WHERE _rowid_ = ?2) b WHERE rtdata_error._rowid_ = ?1"},
    {"rtdata_health", "run, kind, name", "length(kind) + length(name) + length(state) + length(reason)", "0", "t.time",
     "t.time",
     "UPDATE rtdata_health SET state = b.state, reason = b.reason, "
     "last = max(rtdata_health.time, rtdata_health.last, b.time, b.last), count = rtdata_health.count + b.count "
     "FROM (SELECT state, reason, time, last, count FROM rtdata_health WHERE _rowid_ = ?2) b "
     "WHERE rtdata_health._rowid_ = ?1"},
    {"rtdata_configuration", "run, object", "length(object) + length(text)", "0", "t.time", "t.time",
     "UPDATE rtdata_configuration SET time = b.time, text = b.text, count = rtdata_configuration.count + b.count "
     "FROM (SELECT time, text, count FROM rtdata_configuration WHERE _rowid_ = ?2) b "
     "WHERE rtdata_configuration._rowid_ = ?1"},
};

/// An object's rows in one table.
struct Object {
  const Table* table = nullptr;
  std::int64_t any_row = 0;
  std::int64_t rows = 0;
  std::int64_t bytes = 0;
};

/// The bytes of all rows of a table; adds the objects with rows that can be joined to `objects`.
std::int64_t look_at(Database& database, const Table& table, std::vector<Object>& objects) {
  const std::string query = std::string("SELECT max(_rowid_), count(*), sum(40 + ") + table.texts + ") FROM " +
                            table.name + " GROUP BY " + table.object;
  auto object = database.prepare(query);
  std::int64_t all = 0;
  while (object.step()) {
    const Object one{&table, object.integer(0), object.integer(1), object.integer(2)};
    all += one.bytes;
    if (one.rows >= AccountShare::least_rows) objects.push_back(one);
  }
  return all;
}

/// Joins the older half of an object's rows in pairs. Returns by how many rows it becomes smaller.
std::size_t join(Database& database, AccountSums& sums, const Object& object) {
  const Table& table = *object.table;
  std::vector<std::pair<std::int64_t, std::int64_t>> pairs;
  {
    std::string same;
    for (std::string rest = table.object; !rest.empty();) {
      const std::size_t comma = rest.find(", ");
      const std::string column = rest.substr(0, comma);
      same += (same.empty() ? "" : " AND ") + std::string("t.") + column + " = o." + column;
      rest = comma == std::string::npos ? "" : rest.substr(comma + 2);
    }
    auto rows = database.prepare(std::string("SELECT t._rowid_, ") + table.stretch + ", " + table.begin + ", " +
                                 table.end + " FROM " + table.name + " t, " + table.name +
                                 " o WHERE o._rowid_ = ?1 AND " + same + " ORDER BY " + table.begin +
                                 ", t._rowid_ LIMIT ?2");
    rows.bind(1, object.any_row).bind(2, std::min<std::int64_t>(object.rows / 2, 2 * most_pairs));
    struct {
      std::int64_t row = 0, stretch = 0, end = 0;
      bool has_two = false;
    } into;
    while (rows.step()) {
      if (rows.is_null(1)) continue;
      const bool is_same = into.row != 0 && rows.integer(1) == into.stretch;
      // A gap within the one before is joined with it, so that joined gaps do not overlap.
      if (is_same && (!into.has_two || rows.integer(2) <= into.end)) {
        pairs.emplace_back(into.row, rows.integer(0));
        into.has_two = true;
        into.end = std::max(into.end, rows.integer(3));
      } else {
        into = {rows.integer(0), rows.integer(1), rows.integer(3), false};
      }
    }
  }
  auto before = database.prepare(std::string("SELECT * FROM ") + table.name + " WHERE _rowid_ = ?");
  auto grow = database.prepare(std::string(table.join) + " RETURNING *");
  auto remove = database.prepare(std::string("DELETE FROM ") + table.name + " WHERE _rowid_ = ? RETURNING *");
  for (const auto& [first, second] : pairs) {
    before.bind(1, first);
    grow.bind(1, first).bind(2, second);
    sums.replace(before, grow);
    remove.bind(1, second);
    sums.run(remove, AccountSums::Rows::go);
  }
  return pairs.size();
}

}  // namespace

void AccountShare::hold(Database& database, AccountSums& sums) {
  if (most_ == 0) return;
  std::array<std::int64_t, tables> now{};
  std::int64_t added = 0;
  for (std::size_t i = 0; i < tables; ++i) {
    if (!newest_[i]) newest_[i] = database.prepare(std::string("SELECT max(_rowid_) FROM ") + all_tables[i].name);
    newest_[i].step();
    now[i] = newest_[i].integer(0);
    newest_[i].reset();
    added += now[i] - known_[i];
  }
  if (has_looked_ && !has_more_ && added < most_ / (16 * bytes_a_row)) return;
  std::vector<Object> objects;
  std::int64_t bytes = 0;
  for (const Table& table : all_tables) bytes += look_at(database, table, objects);
  has_looked_ = true;
  known_ = now;
  const bool is_too_much = bytes > (has_more_ ? most_ - most_ / 8 : most_);
  has_more_ = false;
  if (!is_too_much) return;
  std::sort(objects.begin(), objects.end(), [](const Object& a, const Object& b) { return a.bytes > b.bytes; });
  for (const Object& object : objects) {
    auto joined = join(database, sums, object);
    has_more_ = joined != 0;
    if (has_more_) break;  // otherwise its schedule has changed between any two of them
  }
}

}  // namespace rtdata::sqlite
