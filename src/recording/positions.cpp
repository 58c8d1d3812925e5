#include "recording/positions.hpp"

#include <algorithm>
#include <chrono>

#include "rtdata/loop/topic.hpp"

namespace rtdata::sqlite {
namespace {

constexpr std::int64_t bytes_of_refusal = 150;  // in the file, beside its reason
constexpr std::size_t most_refusals = 10'000;   // that wait to be written, and those of one more batch
constexpr auto longest_wait = std::chrono::milliseconds{500};

}  // namespace

std::string lines_of(const std::vector<std::string>& topics) {
  std::string lines;
  for (const std::string& topic : topics) lines += (lines.empty() ? "" : "\n") + topic;
  return lines;
}

bool has_topic(std::string_view lines, std::string_view topic) noexcept {
  while (!lines.empty()) {
    const std::size_t end = std::min(lines.find('\n'), lines.size());
    if (topic_matches(lines.substr(0, end), topic)) return true;
    lines.remove_prefix(std::min(end + 1, lines.size()));
  }
  return false;
}

std::int64_t row_of(const Database& database, std::string_view table, const Position& position) {
  if (position.row == 0) return 0;
  const std::string from = " FROM " + quoted(table), is_key = " WHERE run = ?2 AND origin = ?3 AND sequence = ?4";
  auto query = database.prepare("SELECT coalesce((SELECT _rowid_" + from + is_key +
                                " AND _rowid_ = ?1), (SELECT ?1 WHERE (SELECT min(_rowid_)" + from +
                                ") > ?1), (SELECT _rowid_" + from + is_key + "), 0)");
  query.bind(1, position.row).bind(2, position.run).bind(3, position.origin).bind(4, position.sequence);
  query.step();
  return query.integer(0);
}

void Positions::set(const std::string& sink, const std::string& table, Position position) {
  const std::lock_guard lock(mutex_);
  const Key key{sink, table};
  if (const auto found = unsent_.find(key); found != unsent_.end()) found->second.after = found->second.up_to;
  dirty_[key] = std::move(position);
}

void Positions::settle(const std::string& sink, const std::string& table, Position position) {
  const std::lock_guard lock(mutex_);
  const Key key{sink, table};
  if (const auto found = unsent_.find(key); found != unsent_.end()) {
    Unsent& of = found->second;
    const std::int64_t up_to = std::clamp(position.row, of.after, of.up_to);
    of.settled += up_to - std::exchange(of.after, up_to);
  }
  dirty_[key] = std::move(position);
}

void Positions::begin(const std::string& sink, std::string topics, bool at_beginning, const void* owner) {
  const std::lock_guard lock(mutex_);
  sinks_[sink] = {std::move(topics), at_beginning, owner, false, false};
}

void Positions::leave(const std::string& sink, const void* owner) noexcept {
  const std::lock_guard lock(mutex_);
  const auto found = sinks_.find(sink);
  if (found != sinks_.end() && found->second.owner == owner) sinks_.erase(found);
}

void Positions::add(Refusal refusal, std::string reason) {
  const std::lock_guard lock(mutex_);
  refusals_.insert_or_assign(std::move(refusal), std::move(reason));
}

bool Positions::is_full() const {
  const std::lock_guard lock(mutex_);
  return refusals_.size() + refusals_in_transaction_.size() >= most_refusals;
}

std::map<std::string, Positions::Committed> Positions::last_rows() const {
  const std::lock_guard lock(mutex_);
  return last_rows_;
}

std::int64_t Positions::run() const {
  const std::lock_guard lock(mutex_);
  return run_;
}

void Positions::begin_run(std::int64_t run) {
  const std::lock_guard lock(mutex_);
  run_ = run;
}

void Positions::set_last_row(const std::string& table, const std::string& topic, std::int64_t row,
                             std::size_t payload_bytes) {
  const std::lock_guard lock(mutex_);
  Committed& committed = last_rows_[table];
  if (committed.topic.empty()) committed.topic = topic;
  committed.last_row = row;
  committed.payload_bytes = payload_bytes;
}

void Positions::set_deleted_to(const std::string& table, const std::string& topic, std::int64_t row) {
  const std::lock_guard lock(mutex_);
  Committed& committed = last_rows_[table];
  if (committed.topic.empty()) committed.topic = topic;
  committed.deleted_to = row;
}

void Positions::at_end(std::function<std::string()> call) {
  const std::lock_guard lock(mutex_);
  at_end_.push_back(std::move(call));
}

std::vector<std::string> Positions::end() {
  std::vector<std::function<std::string()>> calls;
  {
    const std::lock_guard lock(mutex_);
    calls = std::exchange(at_end_, {});
  }
  std::vector<std::string> said;
  for (const auto& call : calls) {
    if (std::string text = call(); !text.empty()) said.push_back(std::move(text));
  }
  return said;
}

bool Positions::is_dirty() const {
  const std::lock_guard lock(mutex_);
  return !dirty_.empty() || !refusals_.empty() ||
         std::any_of(unsent_.begin(), unsent_.end(), [](const auto& one) { return one.second.settled != 0; }) ||
         std::any_of(sinks_.begin(), sinks_.end(), [](const auto& sink) { return !sink.second.is_known; });
}

void Positions::write_begins(Database& database) {
  std::map<std::string, GoingThrough> begins;
  {
    const std::lock_guard lock(mutex_);
    for (auto& [name, sink] : sinks_) {
      if (sink.is_known) continue;
      sink.is_written = true;
      begins.emplace(name, sink);
    }
  }
  if (begins.empty()) return;
  for (const auto& [name, sink] : begins) write_begin(database, name, sink);
}

void Positions::write_begin(Database& database, const std::string& name, const GoingThrough& sink) {
  auto known = database.prepare("SELECT origin, host FROM rtdata_position WHERE sink = ? AND table_name = ''");
  known.bind(1, name);
  const bool is_known = known.step();
  const std::string topics_before(is_known ? known.text(0) : "");
  const std::string host(is_known ? std::string(known.text(1)) : host_name());
  known.reset();
  if (is_known && topics_before == sink.topics) return;
  auto come = database.prepare("INSERT OR REPLACE INTO rtdata_position VALUES(?, '', 0, 0, ?, 0, ?)");
  come.bind(1, name).bind(2, sink.topics).bind(3, host);
  come.run();
  auto topics = database.prepare("SELECT topic, table_name FROM rtdata_topic");
  while (topics.step()) {
    if (!has_topic(sink.topics, topics.text(0)) || has_topic(topics_before, topics.text(0))) continue;
    const std::string table(topics.text(1)), rows = " FROM " + quoted(table) + " ORDER BY _rowid_";
    auto begin = database.prepare("INSERT OR IGNORE INTO rtdata_position SELECT ?1, ?2, * FROM (SELECT " +
                                  (sink.at_beginning ? "_rowid_ - 1, 0, '', 0, ?3" + rows
                                                     : "_rowid_, run, origin, sequence, ?3" + rows + " DESC") +
                                  " LIMIT 1)");
    begin.bind(1, name).bind(2, table).bind(3, host);
    begin.run();
  }
}

namespace {

const std::string senders = std::to_string(of_senders);

}  // namespace

void add_unsent(Database& database, AccountSums& sums, const std::string& sink, const std::string& topic,
                std::int64_t count) {
  auto before = database.prepare("SELECT " + senders + ", * FROM rtdata_unsent WHERE sink = ? AND topic = ?");
  before.bind(1, sink).bind(2, topic);
  auto add = database.prepare(
      "INSERT INTO rtdata_unsent VALUES(?, ?, ?) ON CONFLICT(sink, topic) DO UPDATE SET count = count + excluded.count "
      "RETURNING " +
      senders + ", *");
  add.bind(1, sink).bind(2, topic).bind(3, count);
  sums.replace(before, add);
}

std::vector<SinkPosition> sink_positions(Database& database, const std::string& topic, const std::string& table) {
  std::vector<SinkPosition> found;
  auto sinks = database.prepare(
      "SELECT s.sink, s.origin, p.row, p.run, p.origin, p.sequence FROM rtdata_position s LEFT JOIN rtdata_position p "
      "ON p.sink = s.sink AND p.table_name = ? WHERE s.table_name = ''");
  sinks.bind(1, table);
  while (sinks.step()) {
    if (!has_topic(sinks.text(1), topic)) continue;
    SinkPosition& one = found.emplace_back();
    one.sink = sinks.text(0);
    one.position = {sinks.integer(2), sinks.integer(3), std::string(sinks.text(4)), sinks.integer(5)};
  }
  return found;
}

void Positions::count_unsent(Database& database, AccountSums& sums, const std::string& topic, const std::string& table,
                             std::int64_t up_to) {
  auto stored = sink_positions(database, topic, table);
  for (SinkPosition& of : stored) {
    const Key key{of.sink, table};
    Position& done = of.position;
    {
      const std::lock_guard lock(mutex_);
      if (const auto newer = dirty_.find(key); newer != dirty_.end()) done = newer->second;
    }
    const std::int64_t after = row_of(database, table, done);
    auto rows = database.prepare("SELECT count(*) FROM " + quoted(table) + " WHERE _rowid_ > ? AND _rowid_ <= ?");
    rows.bind(1, after).bind(2, up_to).step();
    const std::int64_t count = rows.integer(0);
    unsent_in_transaction_[key.first] += count;
    if (count == 0) continue;
    add_unsent(database, sums, key.first, topic, count);
    const std::lock_guard lock(mutex_);
    Unsent& unsent = unsent_[key];
    const bool is_open = unsent.after < unsent.up_to;
    unsent.topic = topic;
    // When rows have got other numbers (VACUUM), it is not known which of them are under way.
    unsent.after = after != done.row ? up_to : std::min(is_open ? std::max(unsent.after, after) : after, up_to);
    unsent.up_to = up_to;
    unsent.is_new = true;
  }
}

void Positions::write(Database& database, AccountSums& sums) {
  write_begins(database);
  std::map<Key, std::int64_t> settled;  // by sink and topic
  {
    const std::lock_guard lock(mutex_);
    in_transaction_ = dirty_;
    refusals_in_transaction_.swap(refusals_);
    for (const auto& [key, unsent] : unsent_) {
      if (unsent.settled == 0) continue;
      settled_in_transaction_[key] = unsent.settled;
      settled[{key.first, unsent.topic}] += unsent.settled;
    }
  }
  for (const auto& [key, count] : settled) add_unsent(database, sums, key.first, key.second, -count);
  if (in_transaction_.empty() && refusals_in_transaction_.empty()) return;
  const std::string host = host_name();
  auto position = database.prepare("INSERT OR REPLACE INTO rtdata_position VALUES(?,?,?,?,?,?,?)");
  for (const auto& [key, at] : in_transaction_) {
    position.bind_all(key.first, key.second, at.row, at.run, at.origin, at.sequence, host);
    position.run();
  }
  auto before = database.prepare("SELECT " + senders +
                                 ", * FROM rtdata_refused WHERE sink = ? AND topic = ? AND run = ? AND origin = ? AND "
                                 "sequence = ?");
  auto refused = database.prepare("INSERT OR REPLACE INTO rtdata_refused VALUES(?,?,?,?,?,?) RETURNING " + senders +
                                  ", *");
  for (const auto& [one, reason] : refusals_in_transaction_) {
    for (Statement* statement : {&before, &refused})
      statement->bind(1, one.sink).bind(2, one.topic).bind(3, one.run).bind(4, one.origin).bind(5, one.sequence);
    refused.bind(6, reason);
    sums.replace(before, refused);
    if (refused_bytes_ >= 0) refused_bytes_ += bytes_of_refusal + static_cast<std::int64_t>(reason.size());
  }
  if (!refusals_in_transaction_.empty() && most_refused_bytes_ != 0) forget_refusals(database, sums);
}

/// Limits the stored refusals, so that a peer that refuses everything for a night does not displace data. Deletes more
/// than needed, so that not each transaction must search for the oldest.
void Positions::forget_refusals(Database& database, AccountSums& sums) {
  const auto measure = [&] {
    refused_bytes_ = database.integer("SELECT count(*) * " + std::to_string(bytes_of_refusal) +
                                      " + coalesce(sum(length(reason)), 0) FROM rtdata_refused");
  };
  if (refused_bytes_ < 0) measure();
  if (refused_bytes_ <= most_refused_bytes_) return;
  const std::string oldest =
      " FROM rtdata_refused ORDER BY (SELECT run FROM rtdata_run WHERE uuid = rtdata_refused.run), sequence, sink, "
      "topic, origin LIMIT (SELECT count(*) FROM rtdata_refused) * " +
      std::to_string(refused_bytes_ - most_refused_bytes_ / 4 * 3) + " / " + std::to_string(refused_bytes_) + " + 1";
  auto counts = database.prepare("SELECT " + senders + ", * FROM rtdata_refused_before");
  sums.run(counts, AccountSums::Rows::go);
  database.execute("INSERT INTO rtdata_refused_before SELECT sink, count(*) FROM (SELECT sink" + oldest +
                   ") WHERE true GROUP BY sink ON CONFLICT(sink) DO UPDATE SET count = "
                   "rtdata_refused_before.count + excluded.count");
  sums.run(counts);
  auto forgotten = database.prepare(
      "DELETE FROM rtdata_refused WHERE (sink, topic, run, origin, sequence) IN (SELECT sink, topic, run, origin, "
      "sequence" +
      oldest + ") RETURNING " + senders + ", *");
  sums.run(forgotten, AccountSums::Rows::go);
  measure();
}

void Positions::committed() noexcept {
  const std::lock_guard lock(mutex_);
  for (const auto& [key, stored] : in_transaction_) {
    const auto now = dirty_.find(key);
    if (now != dirty_.end() && now->second.row == stored.row) dirty_.erase(now);
  }
  in_transaction_.clear();
  for (auto& [name, sink] : sinks_) sink.is_known = sink.is_known || std::exchange(sink.is_written, false);
  refusals_in_transaction_.clear();
  for (const auto& [key, count] : settled_in_transaction_) unsent_[key].settled -= count;
  settled_in_transaction_.clear();
  for (auto& [key, unsent] : unsent_) unsent.is_new = false;
  std::erase_if(unsent_,
                [](const auto& one) { return one.second.after == one.second.up_to && one.second.settled == 0; });
  for (const auto& [sink, count] : unsent_in_transaction_) {
    if (count == 0) {
      are_losing_.erase(sink);
    } else if (are_losing_.insert(sink).second) {
      losing_ += (losing_.empty() ? "" : ", ") + sink;
    }
  }
  unsent_in_transaction_.clear();
}

void Positions::rolled_back() noexcept {
  const std::lock_guard lock(mutex_);
  refused_bytes_ = -1;
  in_transaction_.clear();
  for (auto& [name, sink] : sinks_) sink.is_written = false;
  refusals_.merge(refusals_in_transaction_);  // what is left has been said again
  refusals_in_transaction_.clear();
  settled_in_transaction_.clear();
  std::erase_if(unsent_, [](const auto& one) { return one.second.is_new; });
  unsent_in_transaction_.clear();
}

Positions::Reading::Reading(Positions& of) : of_(of) {
  std::unique_lock lock(of_.mutex_);
  of_.changed_.wait(lock, [this] { return !of_.is_held_off_; });
  ++of_.readers_;
}

Positions::Reading::~Reading() {
  const std::lock_guard lock(of_.mutex_);
  --of_.readers_;
  of_.changed_.notify_all();
}

Positions::HoldOff::HoldOff(Positions& of) : of_(of) {
  std::unique_lock lock(of_.mutex_);
  of_.is_held_off_ = true;
  of_.changed_.wait_for(lock, longest_wait, [this] { return of_.readers_ == 0; });
}

Positions::HoldOff::~HoldOff() {
  const std::lock_guard lock(of_.mutex_);
  of_.is_held_off_ = false;
  of_.changed_.notify_all();
}

}  // namespace rtdata::sqlite
