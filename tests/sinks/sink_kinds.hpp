/// What the contract suite runs over: every kind of sink, with a way to read back what it stored. A new kind is one
/// more entry in `sink_kinds`.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/sinks/recording_writer.hpp"
#include "rtdata/sinks/sink.hpp"

namespace sinks {

struct Number {
  double value = 0;
  friend constexpr auto describe(rtdata::type_tag<Number>) {
    return rtdata::record("number", rtdata::field("value", &Number::value, "V"));
  }
};

struct Row {
  std::string topic;
  std::uint64_t sequence = 0;
  double value = 0;
  bool operator==(const Row&) const = default;
};

/// Where one sink stores, and what is there.
class Store {
 public:
  virtual ~Store() = default;
  virtual rtdata::Sink make(rtdata::Loop& loop, rtdata::SinkConfig config) = 0;
  /// All that is stored, in order within each topic.
  virtual std::vector<Row> rows() = 0;

  // Of one whose peer is another thread or program, which virtual time does not wait for:
  virtual bool is_answered() const { return false; }
  /// Until all that is queued is stored.
  virtual void settle(rtdata::Loop&, const rtdata::Sink&) {}
  /// With all that is queued.
  virtual void close(rtdata::Loop&, rtdata::Sink& sink) { sink.close(); }
  /// The loop with all that is on it; how many events are lost.
  virtual std::uint64_t close(rtdata::Loop& loop) { return loop.close(std::chrono::seconds{10}); }
};

struct SinkKind {
  std::string name;
  std::function<std::unique_ptr<Store>()> make;
  bool is_sender = false;  ///< what it sends needs a loop that runs
};

const std::vector<SinkKind>& sink_kinds();
/// One of a part that is not always built; before main.
bool add_sink_kind(SinkKind kind);

/// A new empty directory, removed at the end.
class Directory {
 public:
  Directory();
  ~Directory();
  Directory(const Directory&) = delete;
  Directory& operator=(const Directory&) = delete;
  std::string operator/(const std::string& name) const { return path + "/" + name; }
  std::string path;
};

std::string content(const std::string& path);

/// A writer that does what a test tells it.
class ScriptedWriter : public rtdata::RecordingWriter {
 public:
  /// Shared with the test; of the lane's while that works.
  struct Script {
    std::vector<Row> rows;
    std::vector<std::size_t> batches;  // rows of each
    int failures = 0;                  // so many writes fail from here on
    int fail_every = 0;                // every so many-th write fails
    int writes = 0;
    int opens = 0;
    int closes = 0;
    int accounts = 0;
    bool ends = false;    // the next write says that the writer has ended
    bool throws = false;  // failing is throwing
    double refused_value = -1;
    std::function<void()> before_write;
    std::function<rtdata::Result<void>(std::string_view topic)> on_topic;
    bool has_last_account = false;
    std::atomic<int> writers{0};  // that live
  };
  explicit ScriptedWriter(std::shared_ptr<Script> script) : script_(std::move(script)) {
    script_->writers.fetch_add(1);
  }
  ~ScriptedWriter() override { script_->writers.fetch_sub(1); }
  rtdata::Result<void> open() override;
  rtdata::Result<void> write(rtdata::Batch& batch) override;
  rtdata::Result<void> close() override;
  rtdata::Result<void> add_topic(std::uint32_t number, std::string_view topic,
                                 const rtdata::Description& description) override;

 private:
  std::shared_ptr<Script> script_;
};

}  // namespace sinks
