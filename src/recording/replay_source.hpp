// Reads a recording in portions, on the replay's lane.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::detail {

/// An origin on one of the topics that are replayed.
struct ReplayOrigin {
  std::size_t topic = 0;  // its place among these
  std::string name;
  bool operator<(const ReplayOrigin& other) const noexcept {
    return topic != other.topic ? topic < other.topic : name < other.name;
  }
};

/// Some rows in their order.
struct ReplayPortion {
  struct Entry {
    std::int64_t time;
    std::uint64_t sequence;  // 0: a gap
    std::uint32_t origin;
    std::uint32_t at;  // in `payloads`, or in `gaps`
  };
  std::vector<Entry> entries;
  std::vector<std::byte> payloads;
  std::vector<Gap> gaps;
  std::vector<ReplayOrigin> new_origins;  // added after those that are known
  bool is_last = false;
  std::optional<Error> error;  // instead of what would follow

  void clear() noexcept {
    entries.clear();
    payloads.clear();
    gaps.clear();
    new_origins.clear();
  }
};

/// Thread: one at a time, that of the lane once it works.
class ReplaySource {
 public:
  /// `topics`: the topics that are replayed, in the order of their places. `origins`: those that are known. `end`: of
  /// the run, if it has ended; an event after that is an error.
  ReplaySource(Recording recording, RowFilter filter, const std::vector<RecordedTopic>& topics,
               const std::vector<ReplayOrigin>& origins, std::optional<Time> end);
  void read(ReplayPortion& portion) noexcept;
  /// Any thread: `read` ends soon.
  void cancel() noexcept;

 private:
  struct Topic {
    const RecordedTopic* read_as;
    std::size_t place;
    std::string last_name;  // of the last origin
    std::uint32_t last = 0;
  };
  void read_rows(ReplayPortion& portion);
  Topic& topic_of(const RecordedTopic& read_as);
  bool is_chosen(std::string_view topic) const;
  std::optional<std::size_t> place_of(const RecordedTopic& topic) const;
  std::uint32_t origin_of(std::size_t topic, std::string_view name, ReplayPortion& portion);

  Recording recording_;
  RowFilter filter_;
  const std::optional<Time> end_;
  std::optional<Rows> rows_;
  std::vector<std::pair<std::string, std::int64_t>> topics_;  // name and version
  std::map<ReplayOrigin, std::uint32_t> origins_;
  std::vector<Topic> known_topics_;
  std::atomic<bool> is_cancelled_{false};
};

class ReplayNode;

/// One portion to read.
class ReplayJob final : public LaneJob {
 public:
  ReplayJob(ReplayNode& node_, std::shared_ptr<ReplaySource> source) : node(&node_), source_(std::move(source)) {}
  void run() noexcept override { source_->read(portion); }
  void done(Outcome outcome) override;

  ReplayNode* node;  // null once it is closed
  bool is_ready = false;
  ReplayPortion portion;  // the lane's from submission until `done`

 private:
  const std::shared_ptr<ReplaySource> source_;
};

/// Returns a copy of the text that lives as long as the program, as needed for the reason of a gap; "several" if there
/// are too many.
std::string_view kept_reason(std::string_view text);
std::optional<Gap::Kind> gap_kind(std::string_view name) noexcept;

}  // namespace rtdata::detail
