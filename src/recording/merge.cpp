// Makes one recording of the runs of several.
#include <fcntl.h>
#include <stdio.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>

#include "data/sqlite_magic.hpp"
#include "recording/account_sums.hpp"
#include "recording/deleted_runs.hpp"
#include "recording/recording_file.hpp"
#include "recording/recording_lock.hpp"
#include "recording/schema.hpp"
#include "recording/sqlite_writer.hpp"
#include "recording/step.hpp"
#include "recording/topic_table.hpp"
#include "recording/utc_line.hpp"
#include "rtdata/detail/io/descriptor.hpp"
#include "rtdata/recording/runs.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata {
namespace {

using detail::RecordingFile;
using sqlite::Database;
using sqlite::quoted;
using sqlite::Statement;

constexpr const char* merging = "cannot merge";

[[noreturn]] void refuse(std::string where, std::string why, std::string advice) {
  throw SetupError({Errc::bad_argument, merging, std::move(where), std::move(why), std::move(advice)});
}

std::string plural(std::uint64_t count, std::string_view noun) {
  return std::to_string(count) + " " + std::string(noun) + (count == 1 ? "" : "s");
}

std::string hash_text(std::uint64_t hash) {
  std::array<char, 17> text{};
  std::snprintf(text.data(), text.size(), "%016llx", static_cast<unsigned long long>(hash));
  return text.data();
}

struct Source {
  explicit Source(const std::string& path) : recording(Recording::open(path).or_throw()), seen(recording.file()) {}

  const RecordingFile& file() const { return *recording.file(); }
  const std::string& path() const { return recording.path(); }

  Recording recording;
  detail::Snapshot seen;  // all reads see the same moment
  std::vector<RunInfo> runs;
  std::vector<RecordedTopic> topics;
  std::map<std::int64_t, std::uint64_t> hashes;
  /// By table, of the runs that have rows in it the numbers of the first and the last.
  std::map<std::string, std::map<std::int64_t, std::pair<std::int64_t, std::int64_t>>> rows;
  std::vector<std::vector<std::string>> deleted;  // rtdata_deleted, as text
  std::int64_t last_number = 0;                   // of its runs, and of those that were deleted
  bool shares_runs = false;                       // with a source before it
};

/// A run of one source.
struct Member {
  Source* source;
  const RunInfo* info;
};

/// A run of the new recording, and all sources that have it: it takes the account of the first.
struct Run {
  std::vector<Member> members;
  MergedRun merged;
};

/// Writes the rows of one run into a table of the new recording.
class RowWriter {
 public:
  RowWriter(Database& to, const std::string& table, std::int64_t run) : table_(table), run_(run) {
    columns_ = sqlite::columns_of(to, table);
    std::string values;
    for (std::size_t i = 0; i < columns_.size(); ++i) values += i == 0 ? "?" : ",?";
    insert_ = to.prepare("INSERT INTO " + quoted(table) + " VALUES(" + values + ")");
  }

  /// For each of its columns, the index in a statement that selects all columns of a source's table; -1: not there.
  std::vector<int> columns_in(const Statement& from) const {
    std::vector<int> at;
    for (const std::string& column : columns_) {
      int found = -1;
      for (int i = 0; i < sqlite3_column_count(from.raw()); ++i)
        if (sqlite3_column_name(from.raw(), i) == column) found = i;
      at.push_back(found);
    }
    return at;
  }

  std::uint64_t hash(const Statement& row, const std::vector<int>& from) {
    hash_.begin();
    for (std::size_t i = 0; i < columns_.size(); ++i) {
      if (i == run_column) {
        hash_.integer(run_);
      } else if (i == checksum_column) {
        continue;
      } else if (from[i] < 0) {
        hash_.null();
      } else {
        hash_.column(row.raw(), from[i]);
      }
    }
    return hash_.hash_of_values();
  }

  /// `is_end`: the row gets the checksum of all rows since the last one that got one.
  void put(const Statement& row, const std::vector<int>& from, bool is_end) {
    sum_ += hash(row, from);
    bind(insert_, row, from);
    if (is_end) insert_.bind(checksum_column + 1, static_cast<std::int64_t>(sum_));
    if (is_end) sum_ = 0;
    insert_.run();
    ++rows_;
  }

  /// All of its columns; NULL for the checksum.
  void bind(Statement& to, const Statement& row, const std::vector<int>& from) const {
    for (std::size_t i = 0; i < columns_.size(); ++i) {
      const int parameter = static_cast<int>(i) + 1;
      if (i == run_column) {
        to.bind(parameter, run_);
      } else if (i == checksum_column || from[i] < 0) {
        to.bind_null(parameter);
      } else if (sqlite3_bind_value(to.raw(), parameter, sqlite3_column_value(row.raw(), from[i])) != SQLITE_OK) {
        throw SetupError(sqlite::error_of(sqlite3_db_handle(to.raw()), merging));
      }
    }
  }

  const std::string& table() const noexcept { return table_; }
  std::uint64_t rows() const noexcept { return rows_; }
  std::size_t columns() const noexcept { return columns_.size(); }

 private:
  static constexpr std::size_t run_column = 0, checksum_column = sqlite::columns_before_fields - 1;
  const std::string table_;
  const std::int64_t run_;
  std::vector<std::string> columns_;
  Statement insert_;
  sqlite::RowHash hash_;
  std::uint64_t sum_ = 0, rows_ = 0;
};

class Merge {
 public:
  Merge(const std::vector<std::string>& paths, const std::string& path) : path_(path) {
    for (const std::string& one : paths) open(one);
  }
  MergeReport into(Database& database);

 private:
  using Origin = std::pair<std::string, std::string>;  // topic and origin

  void open(const std::string& path);
  void number_runs();
  void copy_run(Database& to, Run& run);
  void copy_rows(Database& to, Run& run);
  /// For a run that several sources have: adds the rows that only another one has, in the order of time.
  void unite_rows(Database& to, Run& run, const std::string& topic, RowWriter& writer,
                  const std::vector<std::pair<const Member*, const RecordedTopic*>>& tables);
  /// The name of the new recording's table for these rows; makes it.
  std::string table_for(Database& to, const RecordedTopic& topic, const Source& source, std::int64_t run);
  void copy_account(Database& to, const Run& run);
  void add_deleted(Database& to);
  void add_senders(Database& to);

  const std::string path_;
  std::vector<std::unique_ptr<Source>> sources_;
  std::vector<Run> runs_;
  std::map<std::string, std::int64_t> base_;  // by source: what is added to the numbers of its deleted runs
  sqlite::AccountSums sums_;
  std::map<Origin, std::uint64_t> restored_;       // of the run that is copied: rows that its account calls pruned
  std::map<std::string, std::int64_t> last_rows_;  // of the new tables, by topic
};

Statement rows_of(const Source& source, const RecordedTopic& topic, std::int64_t run) {
  auto rows = source.file().prepare("SELECT * FROM " + quoted(topic.table) +
                                    " WHERE run = ? AND _rowid_ BETWEEN ? AND ? ORDER BY _rowid_");
  const auto& [first, last] = source.rows.at(topic.table).at(run);
  rows.bind(1, run).bind(2, first).bind(3, last);
  return rows;
}

void Merge::open(const std::string& path) {
  std::error_code failed;
  for (const auto& other : sources_) {
    if (std::filesystem::equivalent(other->path(), path, failed)) refuse(path, "it is named twice", "name it once");
  }
  auto source = std::make_unique<Source>(path);
  const VerifyReport report = verify(source->recording).or_throw();
  if (!report.problems.empty())
    refuse(path, "it does not balance: " + report.problems.front(), "see `rtdata verify " + path + "`");
  for (const RunReport& run : report.runs) {
    const std::string where = path + ", run " + std::to_string(run.info.run);
    if (run.verdict == Verdict::recording)
      throw SetupError({Errc::busy, merging, where, "it is being recorded", "wait until it has ended, or stop it"});
    if (run.verdict == Verdict::unsealed)
      refuse(where, "it ended without closing, and what it lost is not written down yet",
             "`rtdata seal " + path + "` does that");
    if (run.verdict == Verdict::not_balanced)
      refuse(where, "it does not balance" + (run.problems.empty() ? "" : ": " + run.problems.front()),
             "see `rtdata verify " + path + "`");
  }
  source->runs = source->recording.runs().or_throw();
  source->topics = source->recording.topics().or_throw();
  source->hashes = hashes_of_runs(source->recording).or_throw();
  for (const RecordedTopic& topic : source->topics) {
    auto runs = source->file().prepare("SELECT run, min(_rowid_), max(_rowid_) FROM " + quoted(topic.table) +
                                       " GROUP BY run");
    while (runs.step()) source->rows[topic.table][runs.integer(0)] = {runs.integer(1), runs.integer(2)};
  }
  auto deleted = source->file().prepare("SELECT * FROM rtdata_deleted ORDER BY topic, origin");
  while (deleted.step()) {
    std::vector<std::string>& row = source->deleted.emplace_back();
    for (int i = 0; i < sqlite3_column_count(deleted.raw()); ++i) row.emplace_back(deleted.text(i));
  }
  if (!source->runs.empty()) source->last_number = source->runs.back().run;
  source->last_number = std::max(source->last_number,
                                 source->file().database.integer("SELECT max(last_run) FROM rtdata_deleted"));
  sources_.push_back(std::move(source));
}

/// The runs of a source are numbered after those of the source before, and keep the gaps of deleted runs.
void Merge::number_runs() {
  std::int64_t last = 0;
  std::map<std::string, std::size_t> by_uuid;
  for (const auto& source : sources_) {
    const Source* shared = nullptr;
    for (const RunInfo& run : source->runs) {
      if (const auto known = by_uuid.find(run.uuid); known != by_uuid.end() && !run.uuid.empty())
        shared = runs_[known->second].members.front().source;
    }
    source->shares_runs = shared != nullptr;
    // A copy may have runs that the other one has deleted and counts in its sums.
    if (shared != nullptr && shared->deleted != source->deleted)
      refuse(source->path(), "it has runs of " + shared->path() + ", and one of the two has deleted others",
             "merge one of them only");
    if (shared == nullptr) base_[source->path()] = last;
    for (const RunInfo& info : source->runs) {
      const Member member{source.get(), &info};
      if (const auto known = by_uuid.find(info.uuid); known != by_uuid.end() && !info.uuid.empty()) {
        runs_[known->second].members.push_back(member);
        continue;
      }
      const std::int64_t number = shared == nullptr ? base_[source->path()] + info.run : ++last;
      last = std::max(last, number);
      by_uuid.emplace(info.uuid, runs_.size());
      Run& run = runs_.emplace_back();
      run.members.push_back(member);
      run.merged.run = number;
    }
    if (shared == nullptr) last = std::max(last, base_[source->path()] + source->last_number);
  }
  for (Run& run : runs_) {
    const auto later = [](const Member& a, const Member& b) {
      const auto of = [](const Member& one) {
        return std::pair(one.info->ended.value_or(one.info->started), one.info->state == RunState::closed);
      };
      return of(a) > of(b);
    };
    std::stable_sort(run.members.begin(), run.members.end(), later);
    const Member& first = run.members.front();
    run.merged.source = first.source->path();
    run.merged.source_run = first.info->run;
    run.merged.hash = first.source->hashes.at(first.info->run);
  }
}

MergeReport Merge::into(Database& database) {
  number_runs();
  database.execute("PRAGMA auto_vacuum=INCREMENTAL;PRAGMA journal_mode=OFF;PRAGMA synchronous=OFF;BEGIN");
  sqlite::make_recording(database);
  database.execute("PRAGMA application_id=0");  // not a recording before it is whole
  for (Run& run : runs_) copy_run(database, run);
  add_deleted(database);
  add_senders(database);
  sums_.write(database);
  sqlite::write_utc_lines(database);
  database.execute("COMMIT");
  // In a transaction of its own: without a journal SQLite writes pages in any order.
  database.execute("PRAGMA application_id=" + std::to_string(sqlite::application_id));
  MergeReport report;
  for (Run& run : runs_) report.runs.push_back(std::move(run.merged));
  for (const auto& source : sources_) {
    for (const RecordedBacklog& of : source->recording.backlogs().or_throw()) {
      if (of.events != 0)
        report.notes.push_back(plural(of.events, "event") + (of.events == 1 ? " waits" : " wait") + " in " +
                               source->path() + " for the peer of sink " + of.sink +
                               ": they are sent from there, not from the new recording");
    }
  }
  return report;
}

void Merge::copy_run(Database& to, Run& run) {
  restored_.clear();
  last_rows_.clear();
  copy_rows(to, run);
  copy_account(to, run);
}

std::string Merge::table_for(Database& to, const RecordedTopic& topic, const Source& source, std::int64_t run) {
  const SlotInfo slot{0, "", topic.topic, topic.description, {}};
  detail::EscapedTexts no_utf8;
  sqlite::NewUtcViews views;
  try {
    const auto table = sqlite::TopicTable::prepare(to, slot, run, no_utf8, sums_, views, nullptr);
    views.make(to);
    return table.name();
  } catch (const SetupError& error) {
    Error why = error.error();
    if (sqlite3_errcode(to.raw()) == SQLITE_ERROR) why.code = Errc::bad_name;
    why.what = "cannot merge topic " + topic.topic;
    why.where = source.path();
    throw SetupError(std::move(why));
  }
}

void Merge::copy_rows(Database& to, Run& run) {
  // By table of the new recording; the first member's come first.
  std::map<std::string, std::vector<std::pair<const Member*, const RecordedTopic*>>> tables;
  std::vector<std::string> order;
  for (const Member& member : run.members) {
    for (const RecordedTopic& topic : member.source->topics) {
      const auto there = member.source->rows.find(topic.table);
      if (there == member.source->rows.end() || !there->second.contains(member.info->run)) continue;
      const std::string table = table_for(to, topic, *member.source, run.merged.run);
      if (!tables.contains(table)) order.push_back(table);
      tables[table].emplace_back(&member, &topic);
    }
  }
  for (const std::string& table : order) {
    const auto& of = tables[table];
    const std::string& topic = of.front().second->topic;
    RowWriter writer(to, table, run.merged.run);
    if (of.size() > 1 || of.front().first != &run.members.front()) {
      unite_rows(to, run, topic, writer, of);
    } else {
      auto rows = rows_of(*of.front().first->source, *of.front().second, of.front().first->info->run);
      const std::vector<int> from = writer.columns_in(rows);
      while (rows.step()) writer.put(rows, from, !rows.is_null(sqlite::columns_before_fields - 1));
    }
    run.merged.rows += writer.rows();
    if (writer.rows() != 0) last_rows_[topic] = std::max(last_rows_[topic], to.last_rowid());
  }
}

void Merge::unite_rows(Database& to, Run& run, const std::string& topic, RowWriter& writer,
                       const std::vector<std::pair<const Member*, const RecordedTopic*>>& tables) {
  constexpr std::uint64_t rows_a_checksum = 1000;
  const Member& first = run.members.front();
  std::map<std::string, std::uint64_t> pruned;  // by origin: what others may add
  for (const LedgerEntry& entry : first.source->recording.ledger(first.info->run).or_throw())
    if (entry.topic == topic)
      pruned[entry.origin] = entry.pruned - std::min(entry.pruned, restored_[{topic, entry.origin}]);
  to.execute(
      "DROP TABLE IF EXISTS temp.merge_key; DROP TABLE IF EXISTS temp.merge_row;"
      "CREATE TEMP TABLE merge_key(origin TEXT, sequence INTEGER, hash INTEGER, PRIMARY KEY(origin, sequence)) "
      "WITHOUT ROWID; CREATE TEMP TABLE merge_row AS SELECT * FROM main." +
      quoted(writer.table()) + " WHERE false");
  auto find_key = to.prepare("SELECT hash FROM temp.merge_key WHERE origin = ? AND sequence = ?");
  auto add_key = to.prepare("INSERT INTO temp.merge_key VALUES(?, ?, ?)");
  std::string parameters = "?";
  for (std::size_t i = 1; i < writer.columns(); ++i) parameters += ",?";
  auto add_row = to.prepare("INSERT INTO temp.merge_row VALUES(" + parameters + ")");
  for (const auto& [member, table] : tables) {
    const bool is_first = member == &first;
    std::uint64_t same = 0, added = 0, differing = 0, unknown = 0;
    std::string which;
    auto rows = rows_of(*member->source, *table, member->info->run);
    const std::vector<int> from = writer.columns_in(rows);
    while (rows.step()) {
      const std::string origin(rows.text(2));
      const std::int64_t sequence = rows.integer(3);
      const auto hash = static_cast<std::int64_t>(writer.hash(rows, from));
      find_key.bind(1, origin).bind(2, sequence);
      const bool is_there = find_key.step();
      const bool is_same = is_there && find_key.integer(0) == hash;
      find_key.reset();
      if (is_there) {
        ++(is_same ? same : differing);
        if (!is_same && which.empty()) which = "sequence " + std::to_string(sequence) + " of origin " + origin;
        continue;
      }
      if (!is_first) {
        std::uint64_t& room = pruned[origin];
        if (room == 0) {
          ++unknown;
          continue;
        }
        --room;
        ++restored_[{topic, origin}];
        ++added;
      }
      add_key.bind(1, origin).bind(2, sequence).bind(3, hash).run();
      writer.bind(add_row, rows, from);
      add_row.run();
    }
    if (is_first) continue;
    const std::string of = "run " + std::to_string(member->info->run) + " of " + member->source->path() + ", " + topic +
                           ": ";
    if (same != 0) run.merged.copies.push_back(of + plural(same, "row") + (same == 1 ? " is" : " are") + " the same");
    if (added != 0)
      run.merged.copies.push_back(of + plural(added, "row") + (added == 1 ? " is" : " are") +
                                  " added that the account calls pruned");
    if (differing != 0)
      run.merged.differences.push_back(of + plural(differing, "row") + " with other values, left out; the first is " +
                                       which);
    if (unknown != 0)
      run.merged.differences.push_back(of + plural(unknown, "row") + " that the account of " + run.merged.source +
                                       " does not know, left out");
  }
  auto count = to.integer("SELECT count(*) FROM temp.merge_row");
  auto rows = to.prepare("SELECT * FROM temp.merge_row ORDER BY time, origin, sequence");
  const std::vector<int> from = writer.columns_in(rows);
  while (rows.step()) {
    --count;
    writer.put(rows, from, count == 0 || (writer.rows() + 1) % rows_a_checksum == 0);
  }
}

void Merge::copy_account(Database& to, const Run& run) {
  const Member& first = run.members.front();
  for (const std::string_view table : sqlite::account_tables) {
    const auto columns = sqlite::columns_of(to, table);
    std::string names, values;
    for (const std::string& column : columns) {
      names += (names.empty() ? "" : ", ") + quoted(column);
      values += values.empty() ? "?" : ", ?";
    }
    auto rows = first.source->file().prepare("SELECT " + names + " FROM " + std::string(table) + " WHERE run = ?");
    rows.bind(1, first.info->run);
    auto insert = to.prepare("INSERT INTO " + std::string(table) + "(" + names + ") VALUES(" + values + ")");
    const auto at = [&](std::string_view column) {
      return static_cast<int>(std::find(columns.begin(), columns.end(), column) - columns.begin());
    };
    while (rows.step()) {
      for (int i = 0; i < static_cast<int>(columns.size()); ++i)
        sqlite3_bind_value(insert.raw(), i + 1, sqlite3_column_value(rows.raw(), i));
      insert.bind(at("run") + 1, run.merged.run);
      std::string remark;
      if (table == "rtdata_run") {
        remark = first.info->remark;
        const auto add = [&](const std::string& text) { remark += (remark.empty() ? "" : "; ") + text; };
        add("merged from run " + std::to_string(run.merged.source_run) + " of " + run.merged.source + ", hash " +
            hash_text(run.merged.hash));
        for (const std::string& copy : run.merged.copies) add(copy);
        for (const std::string& difference : run.merged.differences) add(difference);
        insert.bind(at("remark") + 1, remark).bind(at(sqlite::checksum_column) + 1, std::int64_t{0});
      } else if (table == "rtdata_ledger") {
        const std::string topic(rows.text(at("topic")));
        const auto restored = restored_.find({topic, std::string(rows.text(at("origin")))});
        const std::uint64_t again = restored == restored_.end() ? 0 : restored->second;
        insert.bind(at("pruned") + 1, rows.integer(at("pruned")) - static_cast<std::int64_t>(again));
        insert.bind(at("rows_up_to") + 1, last_rows_[topic]);
        for (const sqlite::StepLength& length : sqlite::step_lengths) insert.bind(at(length.from) + 1, std::int64_t{0});
      }
      insert.run();
    }
  }
  sums_.add_run(to, run.merged.run);
}

void Merge::add_deleted(Database& to) {
  for (const auto& source : sources_) {
    if (source->shares_runs) continue;  // they are those of the other one
    auto rows = source->file().prepare("SELECT * FROM rtdata_deleted");
    while (rows.step()) sqlite::add_deleted(to, rows, base_[source->path()]);
  }
}

/// Adds the refusals and losses of senders. Those of two copies are partly the same, so the larger count is taken.
void Merge::add_senders(Database& to) {
  for (const std::string_view table : sqlite::sender_tables) {
    const std::string name(table);
    const bool has_counts = table != "rtdata_refused";
    std::string parameters = "?";
    const auto columns = sqlite::columns_of(to, table);
    for (std::size_t i = 1; i < columns.size(); ++i) parameters += ",?";
    for (const auto& source : sources_) {
      const std::string key = table == "rtdata_unsent" ? "sink, topic" : "sink";
      auto insert = to.prepare(has_counts
                                   ? "INSERT INTO " + name + " VALUES(" + parameters + ") ON CONFLICT(" + key +
                                         ") DO UPDATE SET count = " +
                                         (source->shares_runs ? "max(count, excluded.count)" : "count + excluded.count")
                                   : "INSERT OR IGNORE INTO " + name + " VALUES(" + parameters + ")");
      auto rows = source->file().prepare("SELECT * FROM " + name);
      while (rows.step()) {
        for (int i = 0; i < sqlite3_column_count(rows.raw()); ++i)
          sqlite3_bind_value(insert.raw(), i + 1, sqlite3_column_value(rows.raw(), i));
        insert.run();
      }
    }
    auto all = to.prepare("SELECT " + std::to_string(sqlite::of_senders) + ", * FROM " + name);
    sums_.run(all);
  }
}

/// Empty, or of SQLite, as a merge that was killed leaves it.
bool is_left_by_merge(const std::string& path) {
  const detail::Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  const int fd = file.fd();
  struct stat about {};
  return fd < 0 || (::fstat(fd, &about) == 0 && about.st_size == 0) || detail::is_sqlite_file(fd);
}

/// The file that is made beside `path`, and removed with the object unless it was renamed.
class Beside {
 public:
  Beside(const std::string& path, const std::vector<std::string>& sources) : path_(path), made_(path + "-merging") {
    for (const std::string& one : {path, made_}) sqlite::check_path(one).or_throw();
    const auto refuse_ending = [&](std::string_view ending) {
      if (path.ends_with(ending))
        refuse(path, "files that end with " + std::string(ending) + " belong to another recording",
               "choose another name");
    };
    std::for_each(sqlite::companion_endings.begin(), sqlite::companion_endings.end(), refuse_ending);
    refuse_ending(made_.substr(path.size()));
    struct stat there {};
    if (::lstat(path.c_str(), &there) == 0) refuse(path, "it is there already", "choose another name");
    std::error_code ignored;
    const bool is_source = std::any_of(sources.begin(), sources.end(), [&](const std::string& source) {
      return std::filesystem::equivalent(source, made_, ignored);
    });
    if (::lstat(made_.c_str(), &there) == 0 && (is_source || !is_left_by_merge(made_)))
      refuse(made_, "it exists, and is not left over from a killed merge", "move it away");
    (void)Database::open(made_, Database::Mode::write);
    std::error_code failed;
    real_ = std::filesystem::canonical(made_, failed).string();
    if (failed)
      throw SetupError(system_error(failed.value(), merging, made_, "choose a folder where files can be made"));
    auto lock = sqlite::RecordingLock::take(real_);
    if (!lock) {
      lock.error().what = merging;
      lock.error().advice = "another merge makes this file: wait for it";
      throw SetupError(std::move(lock).error());
    }
    lock_ = *std::move(lock);
    remove();  // the file of a killed merge
    database = Database::open(made_, Database::Mode::write);
  }
  Beside(const Beside&) = delete;
  ~Beside() {
    database = Database();
    if (!is_renamed_) remove();
    lock_.remove();
  }

  void rename() {
    const detail::Descriptor file(::open(made_.c_str(), O_RDONLY | O_CLOEXEC));
    if (file.fd() < 0 || ::fsync(file.fd()) != 0)
      throw SetupError(system_error(errno, merging, made_, "check the disk"));
    if (::renameat2(AT_FDCWD, made_.c_str(), AT_FDCWD, path_.c_str(), RENAME_NOREPLACE) != 0) {
      struct stat there {};
      const int reason = errno;
      if (reason == EEXIST || ::lstat(path_.c_str(), &there) == 0)
        refuse(path_, "it has been made meanwhile", "choose another name");
      if (reason != EINVAL && reason != ENOSYS) throw SetupError(system_error(reason, merging, path_, ""));
      // File systems such as those of many SD cards have no RENAME_NOREPLACE.
      if (::rename(made_.c_str(), path_.c_str()) != 0) throw SetupError(system_error(errno, merging, path_, ""));
    }
    is_renamed_ = true;
    const detail::Descriptor folder(
        ::open(std::filesystem::path(real_).parent_path().c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (folder.fd() >= 0) (void)::fsync(folder.fd());
  }

  const std::string& path() const noexcept { return made_; }
  Database database;

 private:
  void remove() noexcept {
    for (const char* part : {"", "-journal", "-wal", "-shm"}) ::unlink((made_ + part).c_str());
  }
  const std::string path_, made_;
  std::string real_;
  sqlite::RecordingLock lock_;
  bool is_renamed_ = false;
};

}  // namespace

Result<MergeReport> merge(const std::vector<std::string>& sources, const std::string& path) try {
  if (sources.empty()) refuse(path, "no recording is named", "name those to be merged");
  Merge merge(sources, path);
  Beside made(path, sources);
  MergeReport report;
  try {
    report = merge.into(made.database);
  } catch (const SetupError& error) {
    Error why = error.error();
    if (why.what == "cannot use the recording") why.what = merging;
    if (why.code == Errc::storage_full) why.advice = "make room";
    throw SetupError(std::move(why));
  }
  made.database = Database();
  {
    auto recording = Recording::open(made.path()).or_throw();
    const VerifyReport verified = verify(recording).or_throw();
    if (verified.exit_code() != 0) {
      std::string problem = verified.problems.empty() ? "" : verified.problems.front();
      for (const RunReport& run : verified.runs)
        if (problem.empty() && !run.problems.empty()) problem = run.problems.front();
      throw SetupError({Errc::damaged, merging, path, "what was made does not balance: " + problem,
                        "nothing is made; the sources are as they were"});
    }
  }
  made.rename();
  return report;
} catch (const SetupError& error) {
  return error.error();
}

}  // namespace rtdata
