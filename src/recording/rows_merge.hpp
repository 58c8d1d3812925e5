// The implementation of Rows: cursors over tables, gaps and steps, merged in order of run and time.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "recording/recording_file.hpp"

namespace rtdata::detail {

/// Gives rows in order of run and time, the next one at hand.
struct RowCursor {
  virtual ~RowCursor() = default;
  /// Goes to the next row, whose run and time are then set. False: there is none.
  virtual bool advance() = 0;
  /// Fills `row` with the current row.
  void put(RecordedRow& row) {
    row.run_ = run;
    row.header_.time = from_nanoseconds(time);
    give(row);
  }
  /// The same; run and time are set already.
  virtual void give(RecordedRow& row) = 0;
  virtual bool is_gap() const noexcept { return false; }

  std::size_t place = 0;  // among the cursors: which comes first at one time
  std::int64_t run = 0;
  std::int64_t time = 0;

 protected:
  /// An event. `payload_bytes` are set aside for it; they keep their values.
  static std::byte* set_event(RecordedRow& row, std::string_view origin, std::uint64_t sequence,
                              const RecordedTopic& topic) {
    set_origin(row, origin, sequence);
    row.topic_ = &topic;
    row.gap_ = nullptr;
    if (row.payload_.size() != topic.description->size()) row.payload_.resize(topic.description->size());
    return row.payload_.data();
  }
  /// Sets the sequences of a step.
  static void set_sequences(RecordedRow& row, std::uint64_t first, std::uint64_t last) {
    row.first_sequence_ = first;
    row.last_sequence_ = last;
  }
  static void set_gap(RecordedRow& row, const RecordedGap& gap, const RecordedTopic& topic) {
    set_origin(row, gap.origin, 0);
    row.topic_ = &topic;
    row.gap_ = &gap;
  }

 private:
  static void set_origin(RecordedRow& row, std::string_view origin, std::uint64_t sequence) {
    if (row.origin_ != origin) row.origin_.assign(origin);
    row.header_.origin = row.origin_;
    row.header_.sequence = row.first_sequence_ = row.last_sequence_ = sequence;
  }
};

struct RowsMerge {
  RowsMerge(std::shared_ptr<RecordingFile> file_, Snapshot snapshot_, std::uint64_t limit_)
      : file(std::move(file_)), snapshot(std::move(snapshot_)), limit(limit_) {}

  std::shared_ptr<RecordingFile> file;
  Snapshot snapshot;
  std::uint64_t limit;
  std::vector<std::unique_ptr<RowCursor>> cursors;
  std::vector<RowCursor*> heap;
  RowCursor* last = nullptr;  // gave the current row; advances at the next call
  std::uint64_t given = 0;
  RecordedRow row;

  void add(std::unique_ptr<RowCursor> cursor);
  /// Null: there is none.
  RowCursor* next();
};

/// The rows of a topic's table.
std::unique_ptr<RowCursor> make_table_cursor(const RecordingFile& file, RecordedTopic topic,
                                             const Selection& selection);
/// The gaps of all topics that are selected.
std::unique_ptr<RowCursor> make_gap_cursor(const RecordingFile& file, const Selection& selection);
/// Registers the SQL functions for steps on a connection.
void provide_steps(const sqlite::Database& database);
/// A topic's table in steps.
void add_step_cursors(RowsMerge& to, const Recording& recording, RecordedTopic topic, const Selection& selection,
                      Duration step, std::span<const std::string> fields);

}  // namespace rtdata::detail
