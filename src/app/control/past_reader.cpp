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
  FollowingReader(std::string path, std::vector<std::string> topics, Time from)
      : path_(std::move(path)), config_{std::move(topics), from} {}

  Slice read() noexcept override {
    Slice slice;
    try {
      if (!rows_) {
        rows_ = RecordingFollower::open(path_, config_).or_throw();
        name_runs(slice);
      }
      auto more = rows_->read(transaction, [&](const RecordedRow& row) {
        add(row, slice);
        return slice.events.size() < most_bytes ? RecordingFollower::Goes::on : RecordingFollower::Goes::enough;
      });
      slice.has_more = more.or_throw();
    } catch (const std::exception& error) {
      slice.failed = detail::reason_of(error);
    }
    return slice;
  }

 private:
  void add(const RecordedRow& row, Slice& slice) {
    if (row.run() > newest_) name_runs(slice);
    const EventView event = row.event();
    const auto& description = row.topic().description;
    if (descriptions_.empty() || descriptions_.back() != description) {
      if (std::find(descriptions_.begin(), descriptions_.end(), description) == descriptions_.end())
        descriptions_.push_back(description);
    }
    const std::size_t at = slice.events.size();
    slice.events.resize(at + PackedEvent::bytes_of(event.topic(), event.origin(), event.payload().size()));
    PackedEvent::put(slice.events.data() + at, event.topic(), event.header(), description.get(), event.payload(),
                     static_cast<std::uint32_t>(row.run()));
  }

  void name_runs(Slice& slice) {
    for (const RunInfo& one : rows_->recording().runs().or_throw()) {
      if (one.run <= newest_) continue;
      newest_ = one.run;
      slice.runs.emplace_back(static_cast<std::uint32_t>(one.run), one.uuid);
    }
  }

  const std::string path_;
  const RecordingFollower::Config config_;
  std::optional<RecordingFollower> rows_;
  std::int64_t newest_ = 0;                                       // the last run that was named
  std::vector<std::shared_ptr<const Description>> descriptions_;  // of all that it has given
};

}  // namespace

std::unique_ptr<PastReader> make_past_reader(std::string path, std::vector<std::string> topics, Time from) {
  return std::make_unique<FollowingReader>(std::move(path), std::move(topics), from);
}

}  // namespace rtdata::app
