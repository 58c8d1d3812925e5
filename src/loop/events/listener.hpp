// The runtime's interface of sinks: they listen to its loop and are drained at its end.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "rtdata/data/error.hpp"
#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/clock.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

class OriginCore;
class SinkNode;
class TopicCore;

/// Gets everything that a recording holds besides events. Implemented by sinks and bridges to other loops. Called on
/// the loop's thread.
class Listener {
 public:
  /// On an error it cannot take the topic; `on_refusal` is then called with the error, when user code may run.
  virtual Result<void> on_topic(TopicCore& topic) = 0;
  virtual void on_refusal(const Error&) {}
  /// `OriginCore::made_of` was set.
  virtual void on_made_of(OriginCore&) {}
  virtual void on_gap(OriginCore& origin, const Gap& gap) = 0;
  virtual void on_segment(OriginCore& origin, const Segment& segment) = 0;
  /// `count` equal errors from `first` to `last`.
  virtual void on_error(Time first, Time last, std::string_view object, const Error& error, std::uint64_t count) = 0;
  /// `count` changes of one object from `first` to `last`; passes the last one.
  virtual void on_health(Time, Time, const HealthChange&, std::uint64_t) {}

 protected:
  ~Listener() = default;
};

/// The runtime's interface of a sink.
class Recorder : public Listener {
 public:
  virtual void on_clock(const ClockPair& pair) = 0;
  virtual void on_configuration(const ConfigurationChange&) {}
  virtual SinkStatus status() const = 0;
  virtual const std::string& name() const noexcept = 0;
  /// The counts of offered events.
  virtual SinkCounts counts() const noexcept = 0;
  /// True if it, or its recording (`through`), takes a topic of this name.
  virtual bool wants(std::string_view) const noexcept { return false; }
  /// Null: another kind of recorder.
  virtual SinkNode* as_sink() noexcept { return nullptr; }
  /// Stores the queue and closes; calls `done` later, on the loop, with the number of lost events.
  virtual void drain(MonotonicTime deadline, Callback<void(std::uint64_t lost)> done) = 0;

 protected:
  ~Recorder() = default;
};

}  // namespace rtdata::detail
