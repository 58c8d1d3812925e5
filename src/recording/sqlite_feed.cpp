#include "recording/sqlite_feed.hpp"

#include <algorithm>
#include <cstring>

#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/topic.hpp"
#include "sinks/core/sink_queue.hpp"

namespace rtdata::sqlite {
namespace {

enum Column { row_column, run_column, time_column, origin_column, sequence_column, fixed_columns };

}  // namespace

SqliteFeed::SqliteFeed(std::string path, std::shared_ptr<Positions> positions, detail::RowFeedConfig config)
    : path_(std::move(path)), positions_(std::move(positions)), config_(std::move(config)) {
  positions_->begin(config_.sink, lines_of(config_.topics), config_.from == From::beginning, this);
}

SqliteFeed::~SqliteFeed() { positions_->leave(config_.sink, this); }

// ---- opening

void SqliteFeed::open() {
  auto opened = Recording::open(path_).or_throw();
  const detail::RecordingFile& file = *opened.file();
  get_schema_version_ = file.prepare("PRAGMA schema_version");
  recording_.emplace(std::move(opened));
}

void SqliteFeed::look_at_beginning() {
  const detail::RecordingFile& file = *recording_->file();
  topics_before_.clear();
  auto known = file.prepare("SELECT host, origin FROM rtdata_position WHERE sink = ? AND table_name = ''");
  known.bind(1, config_.sink);
  const bool row = known.step();
  is_new_ = !row;
  if (!row) return;
  topics_before_ = known.text(1);
  if (known.text(0) != host_name()) {
    remarks_.push_back("continues from the position of computer " + std::string(known.text(0)) +
                       " in this recording; if that computer also still sends it, events arrive twice");
    positions_->set(config_.sink, no_table, {0, 0, lines_of(config_.topics), 0});  // from now on it is this machine's
  }
}

void SqliteFeed::look() {
  if (!has_looked_) look_at_beginning();
  get_schema_version_.step();
  const std::int64_t version = get_schema_version_.integer(0);
  get_schema_version_.reset();
  if (version != schema_version_ && !has_rows_in_queue()) {  // a table more, or VACUUM
    for (Table& table : tables_) find_again(table);
    schema_version_ = version;
  }
  auto count = recording_->file()->database.integer("SELECT count(*) FROM rtdata_topic");
  if (count != topics_known_) {
    auto topics = recording_->topics().or_throw();
    for (RecordedTopic& topic : topics) {
      const bool is_known = std::any_of(tables_.begin(), tables_.end(),
                                        [&](const Table& table) { return table.topic.table == topic.table; });
      if (is_known || !is_wanted(topic.topic)) continue;
      tables_.emplace_back();
      try {
        prepare(tables_.back(), std::move(topic));
      } catch (...) {
        tables_.pop_back();
        throw;
      }
    }
    topics_known_ = count;
    rows_of_new_tables_ = removed_of_new_tables_ = bytes_of_new_tables_ = 0;
  }
  is_new_ = false;  // tables that are made from now on are new themselves
  topics_before_.clear();
  has_looked_ = true;
  if (config_.times == detail::RowFeedConfig::Times::utc) {
    auto pairs = recording_->file()->database.integer("SELECT coalesce(max(_rowid_), 0) FROM rtdata_clock");
    if (std::exchange(clock_pairs_, pairs) != pairs) {
      for (auto& [number, run] : runs_) run.utc.reset();
    }
  }
  for (Table& table : tables_) look_at(table);
}

void SqliteFeed::look_at(Table& table) {
  table.ends.step();
  count_deleted(table, table.ends.integer(0) - 1);
  table.last_row = std::max(table.last_row, table.ends.integer(1));
  table.ends.reset();
  if (!has_rows_in_queue()) pass_deleted(table);
}

void SqliteFeed::count_deleted(Table& table, std::int64_t up_to) noexcept {
  if (up_to <= table.deleted_to) return;
  const std::int64_t before = std::max(table.read, table.deleted_to);
  if (up_to > before) removed_.fetch_add(static_cast<std::uint64_t>(up_to - before), std::memory_order_relaxed);
  table.deleted_to = up_to;
}

void SqliteFeed::pass_deleted(Table& table) {
  if (table.deleted_to <= table.done.row) return;
  table.done.row = table.read = table.deleted_to;
  positions_->set(config_.sink, table.topic.table, table.done);
}

void SqliteFeed::find_again(Table& table) {
  auto now = position_now(table, table.done);
  if (now.row == table.done.row) return;
  table.begin += now.row - table.done.row;
  table.done = std::move(now);
  table.read = table.deleted_to = table.last_row = table.done.row;  // those after it are looked for next
  positions_->set(config_.sink, table.topic.table, table.done);
}

void SqliteFeed::look_at_oldest() {
  std::int64_t oldest = 0;
  for (Table& table : tables_) {
    if (table.done.row >= table.last_row) continue;
    table.next.bind(1, table.done.row).bind(2, std::int64_t{1});
    const bool row = table.next.step();
    const std::int64_t time = row ? table.next.integer(time_column) : 0;
    table.next.reset();
    if (time != 0 && (oldest == 0 || time < oldest)) oldest = time;
  }
  oldest_.store(oldest, std::memory_order_relaxed);
}

bool SqliteFeed::is_wanted(std::string_view topic) const noexcept {
  return std::any_of(config_.topics.begin(), config_.topics.end(),
                     [&](const std::string& pattern) { return topic_matches(pattern, topic); });
}

void SqliteFeed::prepare(Table& table, RecordedTopic topic) {
  table.topic = std::move(topic);
  table.reader.emplace(table.topic);
  const detail::RecordingFile& file = *recording_->file();
  auto next = file.prepare("SELECT t._rowid_, t.run, t.time, t.origin, t.sequence" + table.reader->columns() +
                           " FROM " + quoted(table.topic.table) + " t WHERE t._rowid_ > ? ORDER BY t._rowid_ LIMIT ?");
  table.next = std::move(next);
  const std::string name = quoted(table.topic.table);  // apart, each is found in the index alone
  auto ends = file.prepare("SELECT coalesce((SELECT min(_rowid_) FROM " + name + "), 1), " +
                           "coalesce((SELECT max(_rowid_) FROM " + name + "), 0)");
  table.ends = std::move(ends);
  table.done = position_in(table);
  table.begin = table.read = table.last_row = table.deleted_to = table.done.row;
  const auto committed = positions_->last_rows();
  if (const auto known = committed.find(table.topic.table); known != committed.end()) table.seen = known->second;
  const auto number = static_cast<std::uint32_t>(topic_numbers_.size());
  table.topic_number = topic_numbers_.try_emplace(table.topic.topic, number).first->second;
}

std::int64_t SqliteFeed::number(const std::string& sql, const Position& position) {
  auto statement = recording_->file()->prepare(sql);
  const auto index = [&](const char* name) { return sqlite3_bind_parameter_index(statement.raw(), name); };
  if (index(":row") != 0) statement.bind(index(":row"), position.row);
  if (index(":run") != 0) statement.bind(index(":run"), position.run);
  if (index(":origin") != 0) statement.bind(index(":origin"), position.origin);
  if (index(":sequence") != 0) statement.bind(index(":sequence"), position.sequence);
  return statement.step() ? statement.integer(0) : 0;
}

Position SqliteFeed::position_in(const Table& table) {
  const detail::RecordingFile& file = *recording_->file();
  Position position;
  auto stored = file.prepare(
      "SELECT row, run, origin, sequence FROM rtdata_position WHERE sink = ? AND table_name = ?");
  stored.bind(1, config_.sink).bind(2, table.topic.table);
  const bool is_stored = stored.step();
  if (is_stored) position = {stored.integer(0), stored.integer(1), std::string(stored.text(2)), stored.integer(3)};
  if (is_stored && position.row != 0) return position_now(table, std::move(position));
  if (!is_stored) {
    const bool is_new = is_new_ || (!topics_before_.empty() && !has_topic(topics_before_, table.topic.topic));
    if (is_new) position = config_.from == From::beginning ? beginning_of(table) : end_of(table);
  }
  positions_->set(config_.sink, table.topic.table, position);  // so that the file shows that these rows must be sent
  return position;
}

Position SqliteFeed::end_of(const Table& table) {
  auto last = recording_->file()->prepare("SELECT _rowid_, run, origin, sequence FROM " + quoted(table.topic.table) +
                                          " ORDER BY _rowid_ DESC LIMIT 1");
  if (!last.step()) return Position{};
  return Position{last.integer(0), last.integer(1), std::string(last.text(2)), last.integer(3)};
}

Position SqliteFeed::position_now(const Table& table, Position position) {
  if (position.row == 0) return position;
  const std::string name = quoted(table.topic.table);
  constexpr const char* is_key = " AND run = :run AND origin = :origin AND sequence = :sequence";
  auto same = number("SELECT count(*) FROM " + name + " WHERE _rowid_ = :row" + is_key, position);
  if (same != 0) return position;
  auto first = number("SELECT coalesce(min(_rowid_), 0) FROM " + name, position);
  auto elsewhere = number("SELECT _rowid_ FROM " + name + " WHERE 1" + is_key, position);
  const std::string of = "topic " + table.topic.topic + ": ";
  if (elsewhere != 0) {
    remarks_.push_back(of +
                       "the rows of the recording were renumbered; continues after the event that "
                       "was sent last");
    position.row = elsewhere;
    return position;
  }
  if (first > position.row) return position;  // deleted by a limit, with all before it
  // Deleted by a limit before VACUUM; or another file of that name, or an older copy of it.
  const std::string last = position.sequence == 0 ? ""
                                                  : "the event that was sent last, " + position.origin + " " +
                                                        std::to_string(position.sequence) + ", is not there; ";
  remarks_.push_back(
      of + last +
      "the rows of the recording were renumbered, or it is an older copy: all of its events are sent again");
  return beginning_of(table);
}

Position SqliteFeed::beginning_of(const Table& table) {
  auto first = number("SELECT coalesce(min(_rowid_), 1) FROM " + quoted(table.topic.table), {});
  return Position{first - 1, 0, {}, 0};
}

// ---- rows

SqliteFeed::Run* SqliteFeed::run_of(std::int64_t number) {
  Run& run = runs_[number];
  if (config_.times == detail::RowFeedConfig::Times::utc && !run.utc) run.utc = recording_->utc_line(number).or_throw();
  if (!run.uuid.empty()) return &run;
  auto query = recording_->file()->prepare("SELECT uuid FROM rtdata_run WHERE run = ?");
  query.bind(1, number);
  run.uuid = query.step() ? std::string(query.text(0)) : std::string();
  return &run;
}

std::uint32_t SqliteFeed::slot_of(Table& table, detail::SinkQueue& queue, std::int64_t run, std::string_view origin,
                                  const Run& of) {
  if (run == table.run_of_slot && origin == table.origin_of_slot) return table.slot;
  auto [found, is_new] = table.slots.try_emplace({run, std::string(origin)}, 0);
  if (is_new) {
    try {
      found->second = queue.add_slot(
          {table.topic_number, found->first.second, table.topic.topic, table.topic.description, of.uuid});
    } catch (...) {
      table.slots.erase(found);
      throw;
    }
  }
  table.run_of_slot = run;
  table.origin_of_slot = origin;
  return table.slot = found->second;
}

std::size_t SqliteFeed::take(Table& table, detail::SinkQueue& queue, std::size_t most, std::size_t& bytes_left) {
  const std::size_t payload_bytes = table.topic.description->size();
  const std::size_t record_bytes = detail::record_bytes_of(payload_bytes);
  struct Reset {
    ~Reset() { statement.reset(); }
    Statement& statement;
  } reset{table.next};
  marks_.reserve(marks_.size() + most);
  table.next.bind(1, table.read).bind(2, static_cast<std::int64_t>(most));
  std::size_t taken = 0;
  while (taken < most && (record_bytes <= bytes_left || marks_.empty())) {
    if (!table.next.step()) break;
    const std::int64_t row = table.next.integer(row_column);
    const std::int64_t before = std::max(table.read, table.deleted_to);
    if (row > before + 1) removed_ahead_ += static_cast<std::uint64_t>(row - before - 1);
    const std::int64_t run_number = table.next.integer(run_column);
    auto of_run = run_of(run_number);
    const std::string_view origin = table.next.text(origin_column);
    const std::uint32_t slot = slot_of(table, queue, run_number, origin, *of_run);
    std::byte* const to = queue.room(slot, record_bytes);
    if (to == nullptr) break;  // cannot be: the queue was empty
    const std::int64_t sequence = table.next.integer(sequence_column);
    const std::int64_t recorded = table.next.integer(time_column);
    const auto& utc = of_run->utc;
    const std::int64_t time = utc ? to_nanoseconds(utc->utc(from_nanoseconds(recorded))) : recorded;
    const detail::RecordHeader record{&queue.stored(slot), time, static_cast<std::uint64_t>(sequence)};
    std::memcpy(to, &record, sizeof record);
    try {
      table.reader->read(table.next.raw(), fixed_columns, to + sizeof record);
    } catch (const SetupError& error) {  // a row that cannot be read must not hold up those after it
      ++removed_ahead_;
      remarks_.push_back(
          "left out: " +
          at_row(*recording_->file(), table.topic, run_number, origin, record.sequence, error.error()).text());
      table.read = row;
      table.left_out = {row, run_number, std::string(origin), sequence};
      continue;
    }
    queue.commit(record_bytes);
    bytes_left -= std::min(bytes_left, record_bytes);
    table.read = row;
    marks_.push_back(
        {&table, row, run_number, sequence, time, &queue.slot(slot).info.origin, std::exchange(removed_ahead_, 0)});
    ++taken;
  }
  return taken;
}

Result<void> SqliteFeed::attach() try {
  const Positions::Reading reading(*positions_);
  if (!recording_) open();
  const detail::Snapshot snapshot(recording_->file());
  look();
  if (!has_rows_in_queue()) look_at_oldest();
  update_counts();
  is_known_.store(true, std::memory_order_release);
  return {};
} catch (const SetupError& error) {
  return error.error();
}

Result<bool> SqliteFeed::fill(detail::SinkQueue& queue) try {
  if (has_rows_in_queue()) forget();
  marks_.clear();
  settled_ = 0;
  if (positions_->is_full()) return false;  // the recording's next transaction calls again
  const Positions::Reading reading(*positions_);
  // All of it sees the same state of the file: the numbers of the rows, too.
  const detail::Snapshot snapshot(recording_->file());
  look();
  std::size_t bytes_left = queue.bytes_at_once();
  std::size_t rows_left = config_.rows;
  const auto take_turns = [&](bool of_accounts) {
    for (std::size_t i = 0; i < tables_.size() && rows_left > 0 && bytes_left > 0; ++i) {
      Table& table = tables_[(next_table_ + i) % tables_.size()];
      if (table.read >= table.last_row || (table.topic.topic == account_topic) != of_accounts) continue;
      // In turn, so that a fast topic does not hold back a slow one.
      const std::size_t share = std::max<std::size_t>(rows_left / (tables_.size() - i), 1);
      try {
        rows_left -= std::min(rows_left, take(table, queue, share, bytes_left));
      } catch (const SetupError&) {
        if (marks_.empty()) throw;
        return;  // what is in the queue already is sent; the error comes again
      }
    }
  };
  take_turns(false);
  // The final account is sent after everything else, because a receiver uses it to check completeness.
  if (marks_.empty()) take_turns(true);
  if (!tables_.empty()) next_table_ = (next_table_ + 1) % tables_.size();
  if (marks_.empty()) {  // all that was left are rows that cannot be read
    for (Table& table : tables_) {
      if (table.read > table.done.row) {
        table.done = table.left_out;
        positions_->set(config_.sink, table.topic.table, table.done);
      }
    }
    removed_.fetch_add(std::exchange(removed_ahead_, 0), std::memory_order_relaxed);
  }
  update_counts();
  is_known_.store(true, std::memory_order_release);
  return !marks_.empty();
} catch (const SetupError& error) {
  return error.error();
}

void SqliteFeed::refused(const SlotInfo& slot, std::uint64_t sequence, const Error& why) {
  positions_->add({config_.sink, slot.topic, slot.run, slot.origin, static_cast<std::int64_t>(sequence)}, why.text());
}

void SqliteFeed::settled(std::size_t rows) noexcept {
  rows = std::min(rows, marks_.size());
  if (rows <= settled_) return;
  try {
    for (; settled_ < rows; ++settled_) {
      const Mark& mark = marks_[settled_];
      Position& done = mark.table->done;
      done.row = mark.row;
      mark.table->has_moved = true;
      done.run = mark.run;
      done.sequence = mark.sequence;
      if (done.origin != *mark.origin) done.origin = *mark.origin;
      removed_.fetch_add(mark.removed_before, std::memory_order_relaxed);
    }
    for (Table& table : tables_) {
      if (std::exchange(table.has_moved, false)) positions_->settle(config_.sink, table.topic.table, table.done);
    }
  } catch (...) {  // no memory: the stored position is not updated, and the next start sends some rows again
  }
  update_counts();
}

void SqliteFeed::note_committed() {
  rows_of_new_tables_ = removed_of_new_tables_ = bytes_of_new_tables_ = 0;
  for (const auto& [name, committed] : positions_->last_rows()) {
    const auto known = std::find_if(tables_.begin(), tables_.end(),
                                    [&name = name](const Table& table) { return table.topic.table == name; });
    if (known != tables_.end()) {
      // Only new data: earlier row numbers may be from before a VACUUM.
      const Positions::Committed seen = std::exchange(known->seen, committed);
      if (committed.last_row != seen.last_row) known->last_row = std::max(known->last_row, committed.last_row);
      if (committed.deleted_to != seen.deleted_to) count_deleted(*known, committed.deleted_to);
    } else if (is_wanted(committed.topic)) {
      const auto rows = static_cast<std::uint64_t>(committed.last_row);
      const auto removed = static_cast<std::uint64_t>(std::min(committed.deleted_to, committed.last_row));
      rows_of_new_tables_ += rows;
      removed_of_new_tables_ += removed;
      bytes_of_new_tables_ += (rows - removed) * committed.payload_bytes;
    }
  }
  update_counts();
}

void SqliteFeed::forget() noexcept {
  for (Table& table : tables_) {
    const std::int64_t gone = std::min(table.read, table.deleted_to) - table.done.row;  // while they were in the queue
    if (gone > 0) removed_.fetch_add(static_cast<std::uint64_t>(gone), std::memory_order_relaxed);
    table.read = table.done.row;
  }
  removed_ahead_ = 0;
  settled_ = marks_.size();
  try {
    for (Table& table : tables_) pass_deleted(table);
  } catch (...) {  // no memory: it is done the next time
  }
  update_counts();
}

void SqliteFeed::update_counts() noexcept {
  std::uint64_t offered = rows_of_new_tables_, backlog = rows_of_new_tables_ - removed_of_new_tables_;
  std::uint64_t bytes = bytes_of_new_tables_;
  if (has_rows_in_queue()) oldest_.store(marks_[settled_].time, std::memory_order_relaxed);
  for (const Table& table : tables_) {
    offered += static_cast<std::uint64_t>(table.last_row - table.begin);
    const std::int64_t gone = std::max<std::int64_t>(table.deleted_to - table.read, 0);
    const auto waits = static_cast<std::uint64_t>(table.last_row - table.done.row - gone);
    backlog += waits;
    bytes += waits * table.topic.description->size();
  }
  bytes_.store(bytes, std::memory_order_relaxed);
  offered_.store(offered, std::memory_order_relaxed);
  backlog_.store(backlog, std::memory_order_relaxed);
  removed_of_new_.store(removed_of_new_tables_, std::memory_order_relaxed);
  if (backlog == 0) oldest_.store(0, std::memory_order_relaxed);
}

detail::FeedCounts SqliteFeed::counts() const noexcept {
  return {offered_.load(std::memory_order_relaxed),
          removed_.load(std::memory_order_relaxed) + removed_of_new_.load(std::memory_order_relaxed),
          backlog_.load(std::memory_order_relaxed),
          bytes_.load(std::memory_order_relaxed),
          from_nanoseconds(oldest_.load(std::memory_order_relaxed)),
          is_known_.load(std::memory_order_acquire)};
}

}  // namespace rtdata::sqlite
