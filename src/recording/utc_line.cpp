#include "recording/utc_line.hpp"

#include <algorithm>
#include <cctype>
#include <limits>

#include "data/saturating.hpp"

namespace rtdata {
namespace {

Duration offset_of(const RecordedClock& pair) {
  return pair.realtime.time_since_epoch() - pair.monotonic.time_since_epoch();
}

/// From pairs of known accuracy, in order of time, those that are used: no other pair has a smaller error at the
/// instant of one of them.
std::vector<RecordedClock> best_of(const std::vector<RecordedClock>& pairs) {
  constexpr double drift = 1e-6;
  std::vector<double> by_others(pairs.size(), std::numeric_limits<double>::infinity());  // the smallest error, ns
  const auto walk = [&](std::size_t from, std::ptrdiff_t step) {
    double best = std::numeric_limits<double>::infinity();
    for (std::size_t i = from, last = from; i < pairs.size(); last = i, i += static_cast<std::size_t>(step)) {
      best += drift * static_cast<double>(std::chrono::abs(pairs[i].monotonic - pairs[last].monotonic).count());
      by_others[i] = std::min(by_others[i], best);
      best = std::min(best, static_cast<double>(pairs[i].accuracy->count()));
    }
  };
  walk(0, 1);
  walk(pairs.size() - 1, -1);  // ends by running below 0
  std::vector<RecordedClock> best;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    if (static_cast<double>(pairs[i].accuracy->count()) <= by_others[i]) best.push_back(pairs[i]);
  }
  return best;
}

/// Removes pairs until both clocks rise from each to the next; of two that do not agree, it removes the less accurate
/// one, otherwise the earlier one.
std::vector<RecordedClock> rising(const std::vector<RecordedClock>& pairs) {
  std::vector<RecordedClock> kept;
  for (const RecordedClock& pair : pairs) {
    bool is_kept = true;
    while (is_kept && !kept.empty() &&
           (pair.monotonic <= kept.back().monotonic || pair.realtime <= kept.back().realtime)) {
      is_kept = *pair.accuracy <= *kept.back().accuracy;
      if (is_kept) kept.pop_back();
    }
    if (is_kept) kept.push_back(pair);
  }
  return kept;
}

/// From `since` on, the machine had been suspended for `total` since the first pair.
struct Suspended {
  MonotonicTime since{};
  Duration total{0};
};

/// Adds suspensions to the monotonic times of pairs, which are in order of time. Returns the first instant and the
/// suspensions.
std::vector<Suspended> add_suspensions(std::vector<RecordedClock>& pairs) {
  constexpr Duration noise = std::chrono::milliseconds{1};  // of reading two clocks
  constexpr Duration beginning = std::chrono::milliseconds{
      10};  // a run begins this much before its first pair, at most
  std::vector<Suspended> all{{pairs.front().monotonic, Duration{0}}};
  MonotonicTime before = pairs.front().monotonic;
  for (RecordedClock& pair : pairs) {
    const Duration total = detail::difference(pairs.front().suspended, pair.suspended);
    if (detail::difference(all.back().total, total) > noise) {
      const bool is_new_run = pair.occasion == "start";
      all.push_back({is_new_run ? std::max(before + Duration{1}, pair.monotonic - beginning) : pair.monotonic, total});
    }
    before = pair.monotonic;
    pair.monotonic = detail::later(pair.monotonic, all.back().total);
  }
  return all;
}

/// The line of monotonic times, from that of a clock which goes on during suspensions.
std::vector<UtcLine::Stretch> without_suspensions(std::vector<UtcLine::Stretch> line,
                                                  const std::vector<Suspended>& suspensions) {
  if (suspensions.size() == 1) return line;
  if (suspensions.front().since < line.front().since) {  // in a copy, pairs of earlier runs are before 0
    const double earlier = static_cast<double>((line.front().since - suspensions.front().since).count());
    line.front().offset -= Duration{static_cast<std::int64_t>(earlier * line.front().rate)};
    line.front().since = suspensions.front().since;
  }
  std::vector<UtcLine::Stretch> result;
  for (std::size_t s = 0; s < suspensions.size(); ++s) {
    const Duration total = suspensions[s].total;
    const MonotonicTime begin = s == 0 ? line.front().since : detail::later(suspensions[s].since, total);
    const MonotonicTime end = s + 1 == suspensions.size() ? MonotonicTime::max()
                                                          : detail::later(suspensions[s + 1].since, total);
    for (std::size_t i = 0; i < line.size() && line[i].since < end; ++i) {
      if (i + 1 < line.size() && line[i + 1].since <= begin) continue;
      const MonotonicTime since = std::max(line[i].since, begin);
      const double later = static_cast<double>((since - line[i].since).count()) * line[i].rate;
      result.push_back({detail::later(since, -total),
                        detail::difference(-total, line[i].offset) + Duration{static_cast<std::int64_t>(later)},
                        line[i].rate});
    }
  }
  return result;
}

/// The offset of pairs of unknown accuracy: that after the last time the clock was set.
Duration last_set(const std::vector<RecordedClock>& pairs) {
  constexpr Time plausible{std::chrono::sys_days{std::chrono::year{2020} / 1 / 1}};
  constexpr Duration noise = std::chrono::milliseconds{1};  // of reading two clocks
  std::size_t last = 0;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    if (pairs[i].realtime >= plausible || pairs[last].realtime < plausible) last = i;
  }
  const Duration offset = offset_of(pairs[last]);
  while (last > 0 && std::chrono::abs(offset_of(pairs[last - 1]) - offset) <= noise) --last;
  return offset_of(pairs[last]);
}

/// From pairs in order of time.
std::vector<UtcLine::Stretch> line_of(const std::vector<RecordedClock>& all) {
  std::vector<UtcLine::Stretch> line;
  std::vector<RecordedClock> known;
  std::copy_if(all.begin(), all.end(), std::back_inserter(known),
               [](const auto& pair) { return pair.accuracy.has_value(); });
  if (known.empty()) {
    line.push_back({MonotonicTime{}, last_set(all), 0});
    return line;
  }
  const std::vector<RecordedClock> best = rising(best_of(known));
  line.push_back({MonotonicTime{}, offset_of(best.front()), 0});
  for (std::size_t i = 0; i < best.size(); ++i) {
    UtcLine::Stretch stretch{best[i].monotonic, offset_of(best[i]), 0};
    if (i + 1 < best.size()) {
      stretch.rate = static_cast<double>((offset_of(best[i + 1]) - stretch.offset).count()) /
                     static_cast<double>((best[i + 1].monotonic - stretch.since).count());
    }
    const UtcLine::Stretch& before = line.back();
    if (before.offset != stretch.offset || before.rate != stretch.rate) {
      if (before.since == stretch.since) line.pop_back();
      line.push_back(stretch);
    }
  }
  // In a copy, pairs of earlier runs are before 0: a line that bends there begins at the first of them.
  if (line.size() > 1 && line[1].since < line[0].since) {
    line[0].since = best.front().monotonic;
    if (line[1].since == line[0].since) line.erase(line.begin());
  }
  return line;
}

}  // namespace

UtcLine::UtcLine(std::span<const RecordedClock> pairs, Duration clock_offset) : clock_offset_(clock_offset) {
  if (pairs.empty()) return;
  std::vector<RecordedClock> all(pairs.begin(), pairs.end());
  std::stable_sort(all.begin(), all.end(), [](const auto& a, const auto& b) { return a.monotonic < b.monotonic; });
  const std::vector<Suspended> suspended = add_suspensions(all);
  stretches_ = without_suspensions(line_of(all), suspended);
}

Time UtcLine::utc(Time recorded) const noexcept {
  const MonotonicTime at{recorded.time_since_epoch() - clock_offset_};
  const auto after = std::upper_bound(stretches_.begin(), stretches_.end(), at,
                                      [](MonotonicTime t, const Stretch& s) { return t < s.since; });
  if (after == stretches_.begin()) return recorded;
  const Stretch& stretch = *std::prev(after);
  // As the views have it: double, then towards zero.
  const Duration more{static_cast<std::int64_t>(static_cast<double>((at - stretch.since).count()) * stretch.rate)};
  return Time{at.time_since_epoch() + stretch.offset + more};
}

Time UtcLine::recorded(Time utc_time) const noexcept {
  if (stretches_.empty()) return utc_time;
  // UTC never goes back on the line: halve the span in which its time must lie.
  std::int64_t low = clock_offset_.count(), high = low + (std::int64_t{1} << 62);
  if (utc_time < utc(from_nanoseconds(low))) return std::min(utc_time, from_nanoseconds(low));
  while (low < high) {
    const std::int64_t middle = low + (high - low) / 2;
    if (utc(from_nanoseconds(middle)) < utc_time) {
      low = middle + 1;
    } else {
      high = middle;
    }
  }
  return from_nanoseconds(low);
}

namespace sqlite {

std::vector<RecordedClock> clock_pairs_of_boot(const Database& database, std::string_view boot_id) {
  std::string text = "'";
  for (const char c : boot_id) text.append(c == '\'' ? 2 : 1, c);
  return clock_pairs(database, "r.boot_id = " + text + "'");
}

std::vector<RecordedClock> clock_pairs(const Database& database, const std::string& condition) {
  auto query = database.prepare(
      "SELECT c.monotonic, c.realtime, c.source, c.accuracy, c.occasion, c.suspended FROM rtdata_run r JOIN "
      "rtdata_clock c ON c.run = r.run WHERE " +
      condition + " ORDER BY c.monotonic, c._rowid_");
  std::vector<RecordedClock> pairs;
  while (query.step()) {
    RecordedClock& pair = pairs.emplace_back();
    pair.monotonic = MonotonicTime{Duration{query.integer(0)}};
    pair.realtime = from_nanoseconds(query.integer(1));
    pair.source = std::string(query.text(2));
    if (!query.is_null(3)) pair.accuracy = Duration{query.integer(3)};
    pair.occasion = std::string(query.text(4));
    pair.suspended = Duration{query.integer(5)};
  }
  return pairs;
}

namespace {

std::vector<UtcLine::Stretch> written_stretches(const Database& database, std::string_view boot_id) {
  auto query = database.prepare("SELECT since, \"offset\", rate FROM rtdata_utc WHERE boot_id = ? ORDER BY since");
  query.bind(1, boot_id);
  std::vector<UtcLine::Stretch> stretches;
  while (query.step()) {
    stretches.push_back({MonotonicTime{Duration{query.integer(0)}}, Duration{query.integer(1)}, query.real(2)});
  }
  return stretches;
}

}  // namespace

bool utc_line_agrees(const Database& database, std::string_view boot_id) {
  auto pairs = clock_pairs_of_boot(database, boot_id);
  auto written = written_stretches(database, boot_id);
  return written == UtcLine(pairs).stretches();
}

void write_utc_line(Database& database, std::string_view boot_id) {
  auto pairs = clock_pairs_of_boot(database, boot_id);
  auto written = written_stretches(database, boot_id);
  const UtcLine line(pairs);
  const auto [old, wanted] = std::mismatch(written.begin(), written.end(), line.stretches().begin(),
                                           line.stretches().end());
  if (old != written.end()) {
    auto remove = database.prepare("DELETE FROM rtdata_utc WHERE boot_id = ? AND since >= ?");
    remove.bind(1, boot_id).bind(2, old->since.time_since_epoch().count());
    remove.run();
  }
  if (wanted == line.stretches().end()) return;
  auto insert = database.prepare("INSERT INTO rtdata_utc(boot_id, since, \"offset\", rate) VALUES(?,?,?,?)");
  for (auto next = wanted; next != line.stretches().end(); ++next) {
    insert.bind_all(boot_id, next->since.time_since_epoch().count(), next->offset.count(), next->rate);
    insert.run();
  }
}

void write_utc_lines(Database& database) {
  auto query = database.prepare("SELECT DISTINCT boot_id FROM rtdata_run");
  auto boots = query.texts();
  for (const std::string& boot : boots) write_utc_line(database, boot);
}

std::string utc_of(const std::string& time, const std::string& run) {
  const std::string at = "(" + time + " - r.clock_offset)";
  return "coalesce((SELECT " + at + " + u.\"offset\" + CAST((" + at +
         " - u.since) * u.rate AS INTEGER) FROM rtdata_run r" +
         " JOIN rtdata_utc u ON u.boot_id = r.boot_id AND u.since <= " + at + " WHERE r.run = " + run +
         " ORDER BY u.since DESC LIMIT 1), " + time + ")";
}

namespace {

/// ISO 8601 of a column of ns.
std::string iso8601_sql(const std::string& ns) {
  const std::string fraction = "((" + ns + " % 1000000000 + 1000000000) % 1000000000)";
  return "strftime('%Y-%m-%dT%H:%M:%S', (" + ns + " - " + fraction +
         ") / 1000000000, 'unixepoch') || printf('.%09dZ', " + fraction + ")";
}

constexpr std::size_t few_views = 16;  // that SQLite makes one by one

std::string utc_view_of(const std::string& table) { return table + "~utc"; }

}  // namespace

View utc_view(const std::string& table, const Description& description) {
  const std::string name = utc_view_of(table);
  std::string sql = "CREATE VIEW " + quoted(name) + " AS SELECT run, time, origin, sequence, " + iso8601_sql("\"~\"") +
                    " AS utc, \"~\" AS utc_ns";
  for (const Leaf& leaf : description.leaves()) {
    std::string lower = leaf.path;
    std::transform(lower.begin(), lower.end(), lower.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    sql += ", " + quoted(leaf.path);
    if (lower == "utc" || lower == "utc_ns") sql += " AS " + quoted(leaf.path + "~");
  }
  return {name, sql + " FROM (SELECT t.*, " + utc_of("t.time", "t.run") + " AS \"~\" FROM " + quoted(table) + " t)"};
}

void replace_view(const Database& database, const View& view) {
  database.execute("DROP VIEW IF EXISTS " + quoted(view.name) + "; " + view.sql);
}

void NewUtcViews::look_for_room(const Database& database, const std::string& table) {
  const std::string view = utc_view_of(table);
  // Found in memory, where a query would go through the whole schema.
  const bool is_table = sqlite3_table_column_metadata(database.raw(), "main", view.c_str(), nullptr, nullptr, nullptr,
                                                      nullptr, nullptr, nullptr) == SQLITE_OK;
  auto index = database.prepare("PRAGMA main.index_info(" + quoted(view) + ")");
  if (!is_table && !index.step()) return;
  throw SetupError({Errc::bad_description, "cannot make a view", view,
                    "there is " + std::string(is_table ? "a table" : "an index") + " of that name", ""});
}

void NewUtcViews::add(const std::string& table, const Description& description) {
  views_.push_back(utc_view(table, description));
}

void NewUtcViews::make(Database& database) {
  if (views_.size() > few_views) {
    if (enter(database)) views_.clear();
  }
  for (const View& view : views_) replace_view(database, view);
  views_.clear();
}

/// Makes all views at once, as SQLite itself does: adds a row for each to the schema table, which is then read again.
/// SQLite first parses each statement without running it, so that it refuses invalid ones.
bool NewUtcViews::enter(Database& database) {
  Statement row;
  try {
    for (const View& view : views_) (void)database.prepare(view.sql);
    database.execute("PRAGMA writable_schema=ON");
    row = database.prepare("INSERT INTO sqlite_schema(type, name, tbl_name, rootpage, sql) VALUES('view',?1,?1,0,?2)");
  } catch (const SetupError&) {  // a view that SQLite refuses says why when it makes it
    database.execute("PRAGMA writable_schema=RESET");
    return false;
  }
  try {
    for (const View& view : views_) row.bind(1, view.name).bind(2, view.sql).run();
  } catch (const SetupError&) {
    row = Statement();
    database.execute("PRAGMA writable_schema=RESET");
    throw;
  }
  row = Statement();
  database.execute("PRAGMA writable_schema=RESET");
  return true;
}

std::vector<View> account_views() {
  std::vector<View> views{
      {"rtdata_run_utc", "CREATE VIEW rtdata_run_utc AS SELECT run, name, host, state, " + iso8601_sql("started_ns") +
                             " AS started, " + iso8601_sql("ended_ns") +
                             " AS ended, started_ns, ended_ns FROM (SELECT run, name, host, state, " +
                             utc_of("t.started", "t.run") + " AS started_ns, " + utc_of("t.ended", "t.run") +
                             " AS ended_ns FROM rtdata_run t)"}};
  const auto make = [&](const std::string& table, const std::vector<std::pair<std::string, std::string>>& times) {
    std::string inner = "SELECT t.*", outer = "SELECT *";
    for (const auto& [time, name] : times) {
      inner += ", " + utc_of("t." + quoted(time), "t.run") + " AS " + name + "_ns";
      outer += ", " + iso8601_sql(name + "_ns") + " AS " + name;
    }
    views.push_back({utc_view_of(table), "CREATE VIEW " + quoted(utc_view_of(table)) + " AS " + outer + " FROM (" +
                                             inner + " FROM " + table + " t)"});
  };
  make("rtdata_gap", {{"first", "first_utc"}, {"last", "last_utc"}});
  make("rtdata_health", {{"time", "utc"}});
  make("rtdata_error", {{"time", "utc"}});
  views.push_back({"rtdata_field", R"sql(CREATE VIEW rtdata_field AS
WITH RECURSIVE node(topic, version, table_name, prefix, field, element, place) AS (
  SELECT t.topic, t.version, t.table_name, '', j.value, 0, printf('%05d', j.key)
    FROM rtdata_topic t, json_each(t.description, '$.fields') j
  UNION ALL  -- the next element of an array
  SELECT topic, version, table_name, prefix, field, element + 1, place FROM node
    WHERE element + 1 < json_extract(field, '$.array')
  UNION ALL  -- the fields of a record
  SELECT n.topic, n.version, n.table_name,
         n.prefix || json_extract(n.field, '$.name') ||
           CASE WHEN json_extract(n.field, '$.array') IS NULL THEN '' ELSE '[' || n.element || ']' END || '.',
         j.value, 0, n.place || printf('%05d%05d', n.element, j.key)
    FROM node n, json_each(n.field, '$.fields') j)
SELECT topic, version, table_name,
       row_number() OVER (PARTITION BY topic, version ORDER BY place || printf('%05d', element)) AS number,
       prefix || json_extract(field, '$.name') ||
         CASE WHEN json_extract(field, '$.array') IS NULL THEN '' ELSE '[' || element || ']' END AS field,
       json_extract(field, '$.type') AS type,
       coalesce(json_extract(field, '$.unit'), '') AS unit,
       coalesce(json_extract(field, '$.optional'), 0) AS optional
  FROM node WHERE json_extract(field, '$.type') <> 'record')sql"});
  return views;
}

}  // namespace sqlite
}  // namespace rtdata
