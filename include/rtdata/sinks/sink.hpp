/// Sinks: turn events of any described payload into durable or remote records.
///
/// A sink attaches to topics by pattern and takes its copy of each event when it is published (a memcpy into a bounded
/// queue); its `Writer` stores them in batches on a lane of its own, so that neither the loop nor another sink ever
/// waits for it. A new kind of sink is a Writer:
///
///     class Lines final : public rtdata::Writer {
///       rtdata::Result<void> open() override { ... }
///       rtdata::Result<void> write(rtdata::Batch& batch) override {
///         for (const rtdata::Record& record : batch) ...
///       }
///     };
///     rtdata::Sink sink(loop, {.name = "lines"}, std::make_unique<Lines>());
///
/// A topic that the patterns match and that the writer cannot take is never left out in silence: its events are offered
/// and dropped as refused, and the sink is faulted with the reason for as long as it lives.
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

/// What is dropped when the queue is full.
enum class WhenFull { drop_newest, drop_oldest };
constexpr auto describe(type_tag<WhenFull>) {
  return enumeration("when_full", value("drop_newest", WhenFull::drop_newest),
                     value("drop_oldest", WhenFull::drop_oldest));
}

/// Where a sink that goes through a recording begins, at its first start.
enum class From { now, beginning };
constexpr auto describe(type_tag<From>) {
  return enumeration("from", value("now", From::now), value("beginning", From::beginning));
}

struct SinkConfig {
  std::string name = {};                            ///< in reports and the ledger; each kind has a default
  std::vector<std::string> topics = {"#"};          ///< patterns; topics made later are taken too
  std::size_t batch_rows = 500;                     ///< events that are stored together; more when more wait already
                                                    ///< (SqliteSink: all that came within batch_time)
  Duration batch_time = std::chrono::seconds{1};    ///< a batch is stored after so long, however small it is
  std::size_t queue_bytes = std::size_t{32} << 20;  ///< memory for events that wait, at most
  WhenFull when_full = WhenFull::drop_newest;
  Duration retry_first = std::chrono::milliseconds{100};  ///< after a failed batch; doubles up to retry_longest
  Duration retry_longest = std::chrono::seconds{10};      ///< both above 0; Duration::max(): not before it closes
  Duration close_deadline = std::chrono::seconds{10};     ///< how long closing waits for what is queued
  /// The name of a recording (SqliteSink) of the same loop: events are taken from there once they are committed, and
  /// the position is kept in it, so that nothing is lost while the peer is away. Empty: from memory.
  std::string through = {};
  From from = From::now;  ///< with `through`, when the recording has no position of this sink yet

  friend constexpr auto parameters(type_tag<SinkConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("name", &SinkConfig::name, "in reports and in the ledger; each kind has a default", TextIs::name),
        parameter("topics", &SinkConfig::topics, "which topics: names or patterns, + for one level, # for all below",
                  TextIs::topic_pattern),
        parameter("batch_rows", &SinkConfig::batch_rows, "events that are stored together (sqlite: all of batch_time)",
                  range(1, 1'000'000)),
        parameter("batch_time", &SinkConfig::batch_time, "a batch is stored after so long, however small it is",
                  range(1ms, 1h)),
        parameter("queue_bytes", &SinkConfig::queue_bytes, "memory for events that wait, at most", unit("By"),
                  range(262144.0, 68719476736.0)),
        parameter("when_full", &SinkConfig::when_full, "what is dropped when that memory is full"),
        parameter("retry_first", &SinkConfig::retry_first, "delay after a failed batch; doubles with each failure",
                  range(1ms, 1h)),
        parameter("retry_longest", &SinkConfig::retry_longest, "the delay doubles up to this", range(1ms, 24h)),
        parameter("close_deadline", &SinkConfig::close_deadline, "how long closing waits for what is queued",
                  range(0ms, 24h)),
        parameter("through", &SinkConfig::through,
                  "name of a recording: events are taken from there, and wait there while the peer is away",
                  names_part("sink", "sqlite")),
        parameter("from", &SinkConfig::from, "with `through`, at the first start: what comes now, or all there is"));
  }
};

/// One (topic, origin) that a sink takes events of. Immutable once it is listed.
struct SlotInfo {
  std::uint32_t topic_number = 0;  ///< counts the topics of this sink from 0
  std::string origin;
  std::string topic;
  std::shared_ptr<const Description> description;
  std::string run = {};  ///< uuid of the run that the events are of; with `through` that of the recording
};

/// One event as a writer gets it. Valid until `write` returns.
struct Record {
  std::uint32_t slot = 0;
  const SlotInfo* info = nullptr;
  EventHeader header;
  std::span<const std::byte> payload;
  /// Valid as long as this record is.
  EventView view() const noexcept { return EventView(info->topic, header, *info->description, payload); }
  /// The same with its run: for what leaves the machine.
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
  /// Events of the slot that will be stored once this batch is.
  std::uint64_t stored_after(std::uint32_t slot) const noexcept;
  std::uint64_t refused_after(std::uint32_t slot) const noexcept;
  /// Null when this batch brings none. See recording_writer.hpp.
  const Account* account() const noexcept { return account_; }
  /// This record can never be stored (it does not fit the format): it is dropped, counted and reported. Refusals hold
  /// only if the batch succeeds.
  void refuse(const Record& record, const Error& why);
  /// As `refuse`; no other record of its topic can be stored either, so that the sink is faulted for as long as it
  /// lives, with this reason. The others' records are stored. To be called for each record of the topic.
  void refuse_topic(const Record& record, const Error& why);

 private:
  friend class detail::SinkQueue;
  detail::SinkQueue* queue_ = nullptr;
  std::vector<detail::ChunkHeader*> chunks_;
  std::size_t rows_ = 0;
  const Account* account_ = nullptr;
};

/// A topic that a sink is to take, before either is made. See `refused_topics` of each kind.
struct TopicToRecord {
  std::string_view name;
  const Description* description;  ///< null: not known yet
};

/// Stores records. Called on the sink's lane, one call at a time. What it throws is an error of the sink's. Of the loop
/// it may use `post` and `stop` alone, in the calls on the loop's thread too: all else is refused (handle.hpp). A call
/// that has not returned when the sink's `close_deadline` is over is left behind on its thread, together with the
/// writer: it goes on after the sink and its loop are gone, of which it must use nothing then.
class Writer {
 public:
  virtual ~Writer() = default;
  /// Before the first batch, and again after a failure. A writer that is open already does nothing.
  virtual Result<void> open() = 0;
  /// Stores all of the batch, or fails and is given the same batch again later: then it goes on where it stopped, and
  /// refuses again what it refused. An error `closed` is the end of the writer: nothing is tried again, what is queued
  /// and what comes later is refused, and the sink stays faulted.
  virtual Result<void> write(Batch& batch) = 0;
  /// Nothing more is queued for now.
  virtual Result<void> flush() { return {}; }
  /// The last call: what was written is made durable and the resources are released. Not after an `open` that failed.
  virtual Result<void> close() { return {}; }
  /// On the loop's thread, once, before the other calls: its sink goes through the recording in this file. What it
  /// returns is called on the recording's lane after this writer is closed, once the recording is closed too and has
  /// its last account; the text that it returns goes to the log. Null: nothing is to be called.
  virtual std::function<std::string()> goes_through(const std::string& recording) {
    (void)recording;
    return {};
  }
  /// The sink calls it once: `this` if the writer is a RecordingWriter, else null.
  virtual RecordingWriter* as_recording() noexcept { return nullptr; }
  /// The same for a Sender (sender.hpp).
  virtual Sender* as_sender() noexcept { return nullptr; }
};

class Sink : public Handle {
 public:
  Sink() noexcept = default;
  /// SetupError: a pattern that is none, a topic without a description under an exact name, a topic that the writer
  /// refuses; of a writer that is opened at set-up (recording_writer.hpp), what its opening met while the loop did not
  /// run.
  Sink(Loop& loop, SinkConfig config, std::unique_ptr<Writer> writer);

  /// Zeros once it is closed.
  SinkCounts counts() const noexcept;
  Health health() const noexcept;
  SinkStatus status() const;
  /// Why it could not store when it tried last; none: it could, or that is not known yet.
  std::error_code obstacle() const noexcept;
  /// Errors of this sink; without a handler they go to the loop's.
  void on_error(Callback<void(const ErrorReport&)> handler);
  /// Hands over what is queued now, without waiting for the batch to fill.
  void flush();
  /// Hands over what is queued now; `done` is called on the loop when that is stored and, as far as the writer can see
  /// to it, survives a power cut. When storing fails, it is tried again first; of a sink that is closed, never.
  void sync(Callback<void()> done);
  /// Takes nothing from here on, and stores what is queued while the loop turns, for `close_deadline` at most; then
  /// `done` is called with the number of events that were lost, and the sink may be closed, not from within it.
  void finish(Callback<void(std::uint64_t lost)> done);
  /// Of one that finishes: a sink of this name that is made before its end opens nothing until then, and queues what
  /// comes. They have one file.
  void end_before(const std::string& successor);
};

}  // namespace rtdata
