#include "app/control/past_reader.hpp"

#include <algorithm>
#include <exception>
#include <optional>

#include "app/control/event_ring.hpp"
#include "rtdata/recording/follow.hpp"

namespace rtdata::app {
namespace {

constexpr Duration transaction = std::chrono::milliseconds{100};
constexpr std::size_t most_bytes = std::size_t{256} << 10;

class FollowingReader final : public PastReader {
 public:
  FollowingReader(std::string path, std::vector<std::string> topics, Time from, std::string run)
      : path_(std::move(path)), config_{std::move(topics), from}, current_(std::move(run)) {}

  Slice read() noexcept override {
    Slice slice;
    try {
      if (!rows_) rows_ = RecordingFollower::open(path_, config_).or_throw();
      auto more = rows_->read(transaction, [&](const RecordedRow& row) {
        add(row, slice);
        return slice.events.size() < most_bytes ? RecordingFollower::Goes::on : RecordingFollower::Goes::enough;
      });
      slice.has_more = more.or_throw();
    } catch (const std::exception& error) {
      slice.failed = error.what();
    }
    return slice;
  }

 private:
  void add(const RecordedRow& row, Slice& slice) {
    if (row.run() != run_) begin_run(row.run(), slice);
    const EventView event = row.event();
    const auto& description = row.topic().description;
    if (descriptions_.empty() || descriptions_.back() != description) {
      if (std::find(descriptions_.begin(), descriptions_.end(), description) == descriptions_.end())
        descriptions_.push_back(description);
    }
    const std::size_t at = slice.events.size();
    slice.events.resize(at + PackedEvent::bytes_of(event.topic(), event.origin(), event.payload().size()));
    PackedEvent::put(slice.events.data() + at, event.topic(), event.header(), description.get(), event.payload(),
                     shown_run_);
  }

  void begin_run(std::int64_t run, Slice& slice) {
    run_ = run;
    std::string uuid;
    for (const RunInfo& one : rows_->recording().runs().or_throw())
      if (one.run == run) uuid = one.uuid;
    shown_run_ = uuid == current_ ? 0 : static_cast<std::uint32_t>(run);
    slice.runs.emplace_back(shown_run_, uuid);
  }

  const std::string path_;
  const RecordingFollower::Config config_;
  const std::string current_;
  std::optional<RecordingFollower> rows_;
  std::int64_t run_ = -1;
  std::uint32_t shown_run_ = 0;
  std::vector<std::shared_ptr<const Description>> descriptions_;  // of all that it has given
};

}  // namespace

std::unique_ptr<PastReader> make_past_reader(std::string path, std::vector<std::string> topics, Time from,
                                             std::string run) {
  return std::make_unique<FollowingReader>(std::move(path), std::move(topics), from, std::move(run));
}

}  // namespace rtdata::app
