// Supplies a sink with the rows of a recording, from its position on.
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "recording/positions.hpp"
#include "recording/recording_file.hpp"
#include "rtdata/recording/recording.hpp"
#include "sinks/core/row_feed.hpp"

namespace rtdata::sqlite {

class SqliteFeed final : public detail::RowFeed {
 public:
  /// Opens no file. The recording's next transaction registers the sink.
  SqliteFeed(std::string path, std::shared_ptr<Positions> positions, detail::RowFeedConfig config);
  ~SqliteFeed() override;

  Result<void> attach() override;
  Result<bool> fill(detail::SinkQueue& queue) override;
  void refused(const SlotInfo& slot, std::uint64_t sequence, const Error& why) override;
  void settled(std::size_t rows) noexcept override;
  void note_committed() override;
  void forget() noexcept override;
  detail::FeedCounts counts() const noexcept override;
  const std::string& path() const noexcept override { return path_; }
  void at_end(std::function<std::string()> call) override { positions_->at_end(std::move(call)); }
  std::vector<std::string> take_remarks() override { return std::exchange(remarks_, {}); }

 private:
  /// A topic's table.
  struct Table {
    RecordedTopic topic;
    std::optional<detail::RowReader> reader;
    Statement next;         // rows after a given one, with a limit
    Statement ends;         // the numbers of the first row and of the last
    Position done;          // with all up to this one
    std::int64_t read = 0;  // the last row that was put into the queue, or left out
    Position left_out;      // the last row that could not be read
    std::int64_t begin = 0;
    std::int64_t last_row = 0;
    std::int64_t deleted_to = 0;  // rows up to this one were deleted, and counted unless they were in the queue
    Positions::Committed seen;    // the last commit seen
    std::uint32_t topic_number = 0;
    std::map<std::pair<std::int64_t, std::string>, std::uint32_t> slots;  // by run and origin
    std::int64_t run_of_slot = -1;                                        // of the last row, with the next two
    std::string origin_of_slot;
    std::uint32_t slot = 0;
    bool has_moved = false;  // `done` since the position was set
  };
  /// A row in the queue.
  struct Mark {
    Table* table;
    std::int64_t row;
    std::int64_t run;
    std::int64_t sequence;
    std::int64_t time;
    const std::string* origin;
    std::uint64_t removed_before;  // rows that are gone between the one before and this
  };
  struct Run {
    std::string uuid;
    std::optional<UtcLine> utc;
  };

  void open();
  /// Reads the stored data of the sink at the start.
  void look_at_beginning();
  /// Checks for new tables and deleted rows, and reads the last row of each table.
  void look();
  void look_at(Table& table);
  /// Counts deleted rows up to this one.
  void count_deleted(Table& table, std::int64_t up_to) noexcept;
  /// Skips deleted rows if nothing of the table is in the queue.
  void pass_deleted(Table& table);
  /// Finds the position again after VACUUM, which renumbers the rows.
  void find_again(Table& table);
  /// Reads the oldest waiting row if none is in the queue.
  void look_at_oldest();
  bool has_rows_in_queue() const noexcept { return settled_ < marks_.size(); }
  void prepare(Table& table, RecordedTopic topic);
  bool is_wanted(std::string_view topic) const noexcept;
  /// The stored position in a table, if it is still valid.
  Position position_in(const Table& table);
  /// After the last row that is there.
  Position end_of(const Table& table);
  /// Before the first row that is there.
  Position beginning_of(const Table& table);
  /// The present row of an earlier position.
  Position position_now(const Table& table, Position position);
  std::int64_t number(const std::string& sql, const Position& position);
  /// Puts at most `most` rows into the queue. Returns how many.
  std::size_t take(Table& table, detail::SinkQueue& queue, std::size_t most, std::size_t& bytes_left);
  Run* run_of(std::int64_t number);
  std::uint32_t slot_of(Table& table, detail::SinkQueue& queue, std::int64_t run, std::string_view origin,
                        const Run& of);
  void update_counts() noexcept;

  const std::string path_;
  const std::shared_ptr<Positions> positions_;
  const detail::RowFeedConfig config_;
  std::optional<Recording> recording_;
  std::deque<Table> tables_;
  std::size_t next_table_ = 0;
  std::map<std::int64_t, Run> runs_;
  std::map<std::string, std::uint32_t> topic_numbers_;
  std::uint64_t rows_of_new_tables_ = 0;   // rows that the feed has not looked at yet
  std::uint64_t bytes_of_new_tables_ = 0;  // of those of them that wait
  std::int64_t topics_known_ = 0;
  std::int64_t clock_pairs_ = -1;  // rows of rtdata_clock when the lines of UTC were made
  bool has_looked_ = false;
  bool is_new_ = false;        // the sink comes to this recording for the first time
  std::string topics_before_;  // lines: of the sink when it came the last time; of the first look alone, with is_new_
  std::vector<Mark> marks_;
  std::size_t settled_ = 0;                  // of those
  std::uint64_t removed_ahead_ = 0;          // since the last row that was put into the queue
  std::uint64_t removed_of_new_tables_ = 0;  // of the rows in `rows_of_new_tables_`
  std::int64_t schema_version_ = 0;
  Statement get_schema_version_;
  std::vector<std::string> remarks_;
  std::atomic<std::uint64_t> offered_{0};
  std::atomic<std::uint64_t> removed_{0};
  std::atomic<std::uint64_t> removed_of_new_{0};
  std::atomic<std::uint64_t> backlog_{0};
  std::atomic<std::uint64_t> bytes_{0};
  std::atomic<std::int64_t> oldest_{0};
  std::atomic<bool> is_known_{false};
};

}  // namespace rtdata::sqlite
