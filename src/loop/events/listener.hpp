// What the runtime knows of sinks: they listen to what happens on its loop, and are drained at its end.
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

/// Gets everything that a recording holds besides events: a sink's, or a bridge to another loop. Called on the loop's
/// thread.
class Listener {
 public:
  /// Error: it cannot take the topic. Then `on_refusal` is called with it, when user code may run.
  virtual Result<void> on_topic(TopicCore& topic) = 0;
  virtual void on_refusal(const Error&) {}
  /// `OriginCore::made_of` was set.
  virtual void on_made_of(OriginCore&) {}
  virtual void on_gap(OriginCore& origin, const Gap& gap) = 0;
  virtual void on_segment(OriginCore& origin, const Segment& segment) = 0;
  /// `count` of them, alike, from `first` to `last`.
  virtual void on_error(Time first, Time last, std::string_view object, const Error& error, std::uint64_t count) = 0;
  /// `count` changes of one object from `first` to `last`, of which the last one is given.
  virtual void on_health(Time, Time, const HealthChange&, std::uint64_t) {}

 protected:
  ~Listener() = default;
};

/// A sink, as the runtime knows it.
class Recorder : public Listener {
 public:
  virtual void on_clock(const ClockPair& pair) = 0;
  virtual void on_configuration(const ConfigurationChange&) {}
  virtual SinkStatus status() const = 0;
  virtual const std::string& name() const noexcept = 0;
  /// Of what it was offered.
  virtual SinkCounts counts() const noexcept = 0;
  /// Whether it takes a topic of this name, or goes through something that does.
  virtual bool wants(std::string_view) const noexcept { return false; }
  /// Null: something else that records.
  virtual SinkNode* as_sink() noexcept { return nullptr; }
  /// Hands over all that is queued, closes; `done` is called later, on the loop, with what was lost.
  virtual void drain(MonotonicTime deadline, Callback<void(std::uint64_t lost)> done) = 0;

 protected:
  ~Recorder() = default;
};

}  // namespace rtdata::detail
