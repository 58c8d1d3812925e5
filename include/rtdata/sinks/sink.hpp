/// Sinks: turn events of any described payload into durable or remote records.
///
/// A sink attaches to topics by pattern and copies each event when it is published (a memcpy into a bounded queue). Its
/// `Writer` stores them in batches on its own lane, so neither the loop nor another sink ever waits for it. A new kind
/// of sink is a Writer:
///
///     class Lines final : public rtdata::Writer {
///       rtdata::Result<void> open() override { ... }
///       rtdata::Result<void> write(rtdata::Batch& batch) override {
///         for (const rtdata::Record& record : batch) ...
///       }
///     };
///     rtdata::Sink sink(loop, {.name = "lines"}, std::make_unique<Lines>());
///
/// If the writer cannot take a matching topic, this is never silent: its events are counted as offered and dropped as
/// refused, and the sink stays faulted with the reason.
///
/// Every event offered ends as stored, dropped with a reason, or is still queued (ledger.hpp). A failed batch is kept
/// and tried again with a delay that doubles; meanwhile the queue fills, and when it is full events are dropped by the
/// chosen policy, and counted.
///
/// Closing (or destroying) a sink stores what is queued, waiting at most `close_deadline`; `Loop::close` and
/// `Loop::drain` close all sinks of a loop, after its sensors.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's; the Writer is called on the lane's alone.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/event.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/loop/handle.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata {

/// Which event to drop if the queue is full.
enum class WhenFull { drop_newest, drop_oldest };
constexpr auto describe(type_tag<WhenFull>) {
  return enumeration("when_full", value("drop_newest", WhenFull::drop_newest),
                     value("drop_oldest", WhenFull::drop_oldest));
}

/// Where a sink with `through` begins at its first start.
enum class From { now, beginning };
constexpr auto describe(type_tag<From>) {
  return enumeration("from", value("now", From::now), value("beginning", From::beginning));
}

struct SinkConfig {
  std::string name = {};                            ///< in reports and the ledger; each kind has a default
  std::vector<std::string> topics = {"#"};          ///< patterns; they also match topics made later
  std::size_t batch_rows = 500;                     ///< events stored together; more if more are waiting
                                                    ///< (SqliteSink: all events of batch_time)
  Duration batch_time = std::chrono::seconds{1};    ///< a batch is stored after this time, whatever its size
  std::size_t queue_bytes = std::size_t{32} << 20;  ///< maximum memory for queued events
  WhenFull when_full = WhenFull::drop_newest;
  Duration retry_first = std::chrono::milliseconds{100};  ///< after a failed batch; doubles up to retry_longest
  Duration retry_longest = std::chrono::seconds{10};      ///< both above 0; Duration::max(): only when it closes
  Duration close_deadline = std::chrono::seconds{10};     ///< how long closing waits for the queue
  /// The name of a recording (SqliteSink) on the same loop: the sink reads committed events from it and keeps its
  /// position there, so nothing is lost while the peer is away. Empty: events come from memory.
  std::string through = {};
  From from = From::now;  ///< with `through`, if the recording has no position of this sink

  friend constexpr auto parameters(type_tag<SinkConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("name", &SinkConfig::name, "name in reports and in the ledger; each kind has a default",
                  TextIs::name),
        parameter("topics", &SinkConfig::topics, "which topics: names or patterns, + for one level, # for all below",
                  TextIs::topic_pattern),
        parameter("batch_rows", &SinkConfig::batch_rows, "events that are stored together (sqlite: all of batch_time)",
                  range(1, 1'000'000)),
        parameter("batch_time", &SinkConfig::batch_time, "a batch is stored after this time, however small it is",
                  range(1ms, 1h)),
        parameter("queue_bytes", &SinkConfig::queue_bytes, "most memory for events that wait", unit("By"),
                  range(262144.0, 68719476736.0)),
        parameter("when_full", &SinkConfig::when_full, "what is dropped when that memory is full"),
        parameter("retry_first", &SinkConfig::retry_first, "delay after a failed batch; it doubles with each failure",
                  range(1ms, 1h)),
        parameter("retry_longest", &SinkConfig::retry_longest, "the delay doubles up to this", range(1ms, 24h)),
        parameter("close_deadline", &SinkConfig::close_deadline, "how long closing waits for what is queued",
                  range(0ms, 24h)),
        parameter("through", &SinkConfig::through,
                  "name of a recording: events are taken from there, and wait there while the peer is away",
                  names_part("sink", "sqlite")),
        parameter("from", &SinkConfig::from,
                  "with `through`, at the first start: send what comes from now on, or all that is recorded"));
  }
};

/// One (topic, origin) of a sink. Immutable once it is listed.
struct SlotInfo {
  std::uint32_t topic_number = 0;  ///< counts the topics of this sink from 0
  std::string origin;
  std::string topic;
  std::shared_ptr<const Description> description;
  std::string run = {};  ///< uuid of the events' run; with `through`, of the recording
};

/// One event for a writer. Valid until `write` returns.
struct Record {
  std::uint32_t slot = 0;
  const SlotInfo* info = nullptr;
  EventHeader header;
  std::span<const std::byte> payload;
  /// Valid as long as this record is.
  EventView view() const noexcept { return EventView(info->topic, header, *info->description, payload); }
  /// The same with its run, for peers on other machines.
  EventView keyed_view() const noexcept {
    return EventView(info->topic, header, *info->description, payload, info->run);
  }
};

struct Account;
class RecordingWriter;
class Sender;

namespace detail {
class SinkQueue;
class SinkNode;
struct ChunkHeader;
}  // namespace detail

/// Events to store together, in order of publishing, with the account as it stood after them.
class Batch {
 public:
  class Iterator {
   public:
    Record operator*() const noexcept;
    Iterator& operator++() noexcept;
    bool operator!=(const Iterator& other) const noexcept { return chunk_ != other.chunk_ || offset_ != other.offset_; }

   private:
    friend class Batch;
    Iterator(const Batch& batch, std::size_t chunk) noexcept : batch_(&batch), chunk_(chunk) {}
    const Batch* batch_;
    std::size_t chunk_;
    std::size_t offset_ = 0;
  };
  Iterator begin() const;
  Iterator end() const;
  std::size_t size() const noexcept { return rows_; }
  const SlotInfo& slot(std::uint32_t slot) const noexcept;
  std::size_t slots() const noexcept;
  /// The number of stored events of the slot after this batch.
  std::uint64_t stored_after(std::uint32_t slot) const noexcept;
  std::uint64_t refused_after(std::uint32_t slot) const noexcept;
  /// The account; null if this batch has none. See recording_writer.hpp.
  const Account* account() const noexcept { return account_; }
  /// This record can never be stored (it does not fit the format): it is dropped, counted and reported. Refusals take
  /// effect only if the batch succeeds.
  void refuse(const Record& record, const Error& why);
  /// As `refuse`, if no other record of its topic can be stored either: the sink stays faulted with this reason.
  /// Records of other topics are stored. Call it for each record of the topic.
  void refuse_topic(const Record& record, const Error& why);

 private:
  friend class detail::SinkQueue;
  detail::SinkQueue* queue_ = nullptr;
  std::vector<detail::ChunkHeader*> chunks_;
  std::size_t rows_ = 0;
  const Account* account_ = nullptr;
};

/// A topic for a sink, before either is made. See `refused_topics` of each kind.
struct TopicToRecord {
  std::string_view name;
  const Description* description;  ///< null: not known yet
};

/// Stores records. Called on the sink's lane, one call at a time. An exception is an error of the sink. It may only use
/// `post` and `stop` of the loop, also in calls on the loop's thread: everything else is refused (handle.hpp). If a
/// call has not returned at the sink's `close_deadline`, the sink abandons its thread together with the writer: the
/// call may continue after the sink and its loop are destroyed, so it must not use them then.
class Writer {
 public:
  virtual ~Writer() = default;
  /// Called before the first batch, and again after a failure. Does nothing if the writer is open.
  virtual Result<void> open() = 0;
  /// Stores the whole batch, or fails and gets the same batch again later: then it continues where it stopped and
  /// refuses the same records again. The error `closed` ends the writer: nothing is tried again, queued and later
  /// events are refused, and the sink stays faulted.
  virtual Result<void> write(Batch& batch) = 0;
  /// Called when the queue is empty.
  virtual Result<void> flush() { return {}; }
  /// The last call: makes written data durable and releases resources. Not called after a failed `open`.
  virtual Result<void> close() { return {}; }
  /// Called on the loop's thread, once, before the other calls, if its sink has `through` with the recording in this
  /// file. The returned function is called on the recording's lane after both this writer and the recording are closed
  /// and the last account is written; its text goes to the log. Null: no function.
  virtual std::function<std::string()> goes_through(const std::string& recording) {
    (void)recording;
    return {};
  }
  /// Called once by the sink: `this` if the writer is a RecordingWriter, otherwise null.
  virtual RecordingWriter* as_recording() noexcept { return nullptr; }
  /// The same for a Sender (sender.hpp).
  virtual Sender* as_sender() noexcept { return nullptr; }
};

class Sink : public Handle {
 public:
  Sink() noexcept = default;
  /// SetupError: an invalid pattern, an exact name of a topic without a description, a topic that the writer refuses;
  /// for a writer that is opened at set-up (recording_writer.hpp) while the loop does not run, the error of its
  /// opening.
  Sink(Loop& loop, SinkConfig config, std::unique_ptr<Writer> writer);

  /// All 0 after it is closed.
  SinkCounts counts() const noexcept;
  Health health() const noexcept;
  SinkStatus status() const;
  /// The reason why the last attempt to store failed; none if it did not fail, or there was no attempt yet.
  std::error_code obstacle() const noexcept;
  /// Sets the handler for errors of this sink. Default: the loop's handler.
  void on_error(Callback<void(const ErrorReport&)> handler);
  /// Stores the queue now, without waiting for the batch to fill.
  void flush();
  /// Stores the queue now; calls `done` on the loop when it is stored and, as far as the writer can ensure, survives a
  /// power failure. If storing fails, it is tried again first; if the sink is closed meanwhile, `done` is never called.
  void sync(Callback<void()> done);
  /// Takes no more events, and stores the queue while the loop turns, for `close_deadline` at most; then calls `done`
  /// with the number of lost events. Close the sink after that, but not inside `done`.
  void finish(Callback<void(std::uint64_t lost)> done);
  /// For a sink that finishes: a new sink of this name with the same file opens nothing until the old one has ended; it
  /// queues its events until then.
  void end_before(const std::string& successor);
};

}  // namespace rtdata
