#include "recording/seal_account.hpp"

#include <algorithm>

#include "rtdata/data/time.hpp"

namespace rtdata::sqlite {
namespace {

/// A statement of one origin: its first three parameters are run, topic and origin.
Statement prepare(Database& database, const KilledOrigin& killed, std::string_view sql) {
  auto statement = database.prepare(sql);
  statement.bind(1, killed.run).bind(2, killed.topic).bind(3, killed.origin);
  return statement;
}

struct Account {
  SensorCounts counts;
  Segment segment;  // period 0: none
};

std::int64_t signed_of(std::uint64_t count) { return static_cast<std::int64_t>(count); }
std::uint64_t count_of(const Statement& row, int column) { return static_cast<std::uint64_t>(row.integer(column)); }

/// The recording's own account, with its data on the current segment in `kept`.
Account last_account(Database& database, const KilledOrigin& killed, const LiveAccount& kept) {
  Account account;
  SensorCounts& s = account.counts;
  {
    auto query = prepare(database, killed,
                         "SELECT scheduled, taken, missed, failed, in_flight, late, received, published, repeated, "
                         "filtered, unreadable, lost, has_schedule FROM rtdata_ledger WHERE run = ? AND topic = ? AND "
                         "origin = ?");
    if (query.step()) {
      int column = 0;
      for (std::uint64_t* count : {&s.scheduled, &s.taken, &s.missed, &s.failed, &s.in_flight, &s.late, &s.received,
                                   &s.published, &s.repeated, &s.filtered, &s.unreadable, &s.lost})
        *count = count_of(query, column++);
      s.lost_is_known = !query.is_null(11);
      s.has_schedule = query.integer(12) != 0;
    }
  }
  account.segment = kept.segment;
  account.segment.scheduled = 0;
  auto query = prepare(database, killed,
                       "SELECT scheduled FROM rtdata_schedule WHERE run = ? AND topic = ? AND origin = ? AND first_due "
                       "= ?");
  query.bind(4, to_nanoseconds(kept.segment.first_due));
  if (query.step()) account.segment.scheduled = count_of(query, 0);
  return account;
}

/// Adds the events since then, each of which was one read with one sample.
void add_events(Account& account, std::uint64_t events) {
  SensorCounts& s = account.counts;
  s.received += events;
  s.published += events;
  if (!s.has_schedule || events == 0) return;
  const std::uint64_t ticks = events - std::min<std::uint64_t>(s.in_flight, 1);  // the first of them was under way
  s.scheduled += ticks;
  s.taken += events;
  s.in_flight = 0;
  account.segment.scheduled += ticks;
}

void write(Database& database, const KilledOrigin& killed, const Account& account) {
  const SensorCounts& s = account.counts;
  auto ledger = prepare(
      database, killed,
      "UPDATE rtdata_ledger SET scheduled = ?4, taken = ?5, missed = ?6, failed = ?7, in_flight = ?8, "
      "late = ?9, received = ?10, published = ?11, repeated = ?12, filtered = ?13, unreadable = ?14, "
      "lost = ?15, has_schedule = ?16 WHERE run = ?1 AND topic = ?2 AND origin = ?3");
  int column = 4;
  for (const std::uint64_t count : {s.scheduled, s.taken, s.missed, s.failed, s.in_flight, s.late, s.received,
                                    s.published, s.repeated, s.filtered, s.unreadable, s.lost})
    ledger.bind(column++, signed_of(count));
  if (!s.lost_is_known) ledger.bind_null(15);
  ledger.bind(16, std::int64_t{s.has_schedule});
  ledger.run();
  const Segment& segment = account.segment;
  if (segment.period.count() <= 0 || segment.scheduled == 0) return;
  auto schedule = prepare(
      database, killed,
      "INSERT INTO rtdata_schedule(run, topic, origin, first_due, period, end, scheduled, "
      "late_after) VALUES(?,?,?,?,?,?,?,?) ON CONFLICT(run, origin, first_due) DO UPDATE SET end = excluded.end, "
      "scheduled = excluded.scheduled, period = excluded.period, late_after = "
      "excluded.late_after");
  schedule.bind(4, to_nanoseconds(segment.first_due)).bind(5, segment.period.count());
  schedule.bind(6, to_nanoseconds(segment.first_due + (signed_of(segment.scheduled) - 1) * segment.period));
  schedule.bind(7, signed_of(segment.scheduled)).bind(8, segment.late_after.count());
  return schedule.run();
}

/// The recorded gaps of an origin.
struct Known {
  std::int64_t count = 0;  // the sum of their ticks
  std::int64_t first = 0;  // of the last one
  std::int64_t last = 0;
  bool is_any = false;
};

Known known_gaps(Database& database, const KilledOrigin& killed) {
  auto query = prepare(database, killed,
                       "SELECT total(count), max(first), max(last), count(*) FROM rtdata_gap WHERE run = ? AND topic = "
                       "? AND origin = ?");
  query.step();
  return Known{query.integer(0), query.integer(1), query.integer(2), query.integer(3) > 0};
}

/// The ticks of the rows that begin within this gap.
std::int64_t ticks_in(Database& database, const KilledOrigin& killed, const LiveGap& gap) {
  auto query = prepare(database, killed,
                       "SELECT total(count) FROM rtdata_gap WHERE run = ? AND topic = ? AND origin = ? AND "
                       "first BETWEEN ? AND ?");
  query.bind(4, gap.first).bind(5, gap.last);
  query.step();
  return query.integer(0);
}

/// The total ticks of all gaps of the origin.
struct GapTicks {
  std::uint64_t missed = 0, failed = 0, joined = 0;
  std::int64_t last = 0;
};

GapTicks gap_ticks(Database& database, const KilledOrigin& killed) {
  auto query = prepare(database, killed,
                       "SELECT kind, total(count), max(last) FROM rtdata_gap WHERE run = ? AND topic = ? AND origin = "
                       "? GROUP BY kind");
  GapTicks ticks;
  while (query.step()) {
    const std::string_view kind = query.text(0);
    (kind == "missed" ? ticks.missed : kind == "failed" ? ticks.failed : ticks.joined) += count_of(query, 1);
    ticks.last = std::max(ticks.last, query.integer(2));
  }
  return ticks;
}

/// Raises the counts to the values proved by the gaps, because the counts of a sensor on another loop are stored later
/// than its gaps and events.
void add_gaps(Account& account, const GapTicks& gaps, bool has_events) {
  SensorCounts& s = account.counts;
  Segment& segment = account.segment;
  const std::uint64_t all = gaps.missed + gaps.failed + gaps.joined;
  if (all > s.missed + s.failed) {
    std::uint64_t ticks = all - s.missed - s.failed;
    s.missed = std::max(s.missed, gaps.missed);
    const std::uint64_t failed = all - s.missed;  // the kind of joined gaps is not known
    if (failed > s.failed && !has_events && s.in_flight != 0) {
      --s.in_flight;  // reads of an origin follow each other: it was the first to fail
      --ticks;
    }
    s.failed = failed;
    s.scheduled += ticks;
    segment.scheduled += ticks;
  }
  if (segment.period.count() <= 0 || gaps.last < to_nanoseconds(segment.first_due)) return;
  const auto up_to_last = static_cast<std::uint64_t>((gaps.last - to_nanoseconds(segment.first_due)) /
                                                     segment.period.count()) +
                          1;
  if (up_to_last <= segment.scheduled) return;
  // Ticks before the last gap with neither a gap nor an event: reads that brought nothing to publish.
  const std::uint64_t silent = up_to_last - segment.scheduled;
  s.taken += silent;
  s.scheduled += silent;
  segment.scheduled += silent;
}

/// Adds a gap, or updates the row of a gap that has grown: the one with the same beginning.
void put_gap(Database& database, const KilledOrigin& killed, const LiveGap& gap) {
  const std::string reason(gap.reason);
  const auto run = [&](std::string_view sql) {
    auto statement = prepare(database, killed, sql);
    statement.bind(4, gap.first).bind(5, gap.last).bind(6, name_of(gap.kind)).bind(7, std::string_view(reason));
    gap.count != 0 ? statement.bind(8, signed_of(gap.count)) : statement.bind_null(8);
    return statement.run();
  };
  run("UPDATE rtdata_gap SET first = ?4, last = ?5, kind = ?6, reason = ?7, count = ?8 WHERE run = ?1 "
      "AND topic = ?2 AND origin = ?3 AND first BETWEEN ?4 AND ?5");
  if (sqlite3_changes(database.raw()) > 0) return;
  return run("INSERT INTO rtdata_gap(run, topic, origin, first, last, kind, reason, count) VALUES(?,?,?,?,?,?,?,?)");
}

}  // namespace

void seal_account(Database& database, const KilledOrigin& killed, const LiveAccount& kept, std::int64_t& last_time) {
  auto account = last_account(database, killed, kept);
  const auto told = [](const SensorCounts& s) { return s.scheduled + s.received; };
  if (told(kept.sensor) >= told(account.counts)) account = {kept.sensor, kept.segment};
  // Events offered after the account was made: of a sensor on another loop, events come before the account that counts
  // them.
  const auto offered = static_cast<std::uint64_t>(killed.offered);
  const std::uint64_t events = offered - std::min(offered, account.counts.published);
  add_events(account, events);
  const Segment& segment = account.segment;
  // The row of a gap that was under way at the last account may have grown, or closed, and others have followed.
  auto known = known_gaps(database, killed);
  LiveGap closed = kept.closed;
  if (closed.is_there && known.is_any && closed.first < known.first) {  // its first ones are in the recording
    closed.kind = Gap::Kind::joined;
    closed.first = known.last + segment.period.count();
  }
  LiveGap open = kept.under_way;
  if (open.is_there && !account.counts.has_schedule) open.last = std::max(open.last, last_time);
  if (account.counts.has_schedule && closed.is_there) {
    // Ticks that are in neither the recording nor the open gap. A recorded gap with the same begin is an earlier state
    // of it.
    auto closed_there = ticks_in(database, killed, closed);
    std::int64_t others = known.count - closed_there;
    if (open.is_there) {
      auto open_there = ticks_in(database, killed, open);
      others -= open_there;
    }
    auto whole = ticks_in(database, killed, kept.closed);
    const auto by_counts = signed_of(account.counts.missed + account.counts.failed) - others -
                           (open.is_there ? signed_of(open.count) : 0);
    // The counts of a sensor on another loop are older than its gaps, which are stored at once.
    const auto lacking = std::max(by_counts, signed_of(kept.closed.count) - (whole - closed_there));
    closed.is_there = lacking > 0 && closed.first <= closed.last;
    if (closed.is_there && lacking != signed_of(closed.count)) {
      closed.kind = Gap::Kind::joined;
      closed.count = static_cast<std::uint64_t>(lacking);
      // Earlier gaps had been stored, and were lost with the disk: it begins after the remaining ones.
      const std::int64_t period = segment.period.count();
      const std::int64_t after = known.is_any ? known.last + period : 0;
      if (period > 0 && lacking > (closed.last - closed.first) / period + 1)
        closed.first = std::min(closed.first, std::max(after, to_nanoseconds(segment.first_due)));
    }
  } else if (closed.is_there && known.is_any && closed.first <= known.last && closed.first != known.first) {
    closed.is_there = false;  // it is in the recording
  }
  for (const LiveGap* gap : {&closed, &open}) {
    if (!gap->is_there) continue;
    last_time = std::max(last_time, gap->last);
    put_gap(database, killed, *gap);
  }
  if (account.counts.has_schedule) {
    auto ticks = gap_ticks(database, killed);
    add_gaps(account, ticks, events != 0);
  }
  if (segment.period.count() > 0 && segment.scheduled > 0) {
    last_time = std::max(last_time,
                         to_nanoseconds(segment.first_due + (signed_of(segment.scheduled) - 1) * segment.period));
  }
  return write(database, killed, account);
}

}  // namespace rtdata::sqlite
