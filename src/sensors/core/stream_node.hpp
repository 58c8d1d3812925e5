// The base of sensors with a connection: reconnecting, silence, and the gaps of both.
#pragma once

#include <string_view>

#include "data/backoff.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "sensors/core/source_node.hpp"

namespace rtdata::detail {

class StreamNode : public SourceNode {
 public:
  void stop() override {
    if (is_open()) end();
  }
  void stop_schedule(MonotonicTime end) override;
  bool is_reading() const noexcept override { return false; }
  void set_rate(Rate) override;
  Rate rate() const noexcept override { return {}; }
  bool is_running() const noexcept override { return is_running_; }

 protected:
  struct Waits {
    Duration silence{0};  ///< 0: it may be silent
    Duration retry_first{0};
    Duration retry_longest{0};
  };
  StreamNode(LoopCore& loop, const FeedConfig& feed, PayloadType type, Waits waits);

  /// Tries to connect; `opened` or `lose` is called now or later.
  virtual void open_stream() = 0;
  /// Ends the connection, or the attempt.
  virtual void close_stream() noexcept = 0;
  /// The error to report when nothing has come for `silence`.
  virtual Error silence_error() const = 0;
  /// Called after the silence was reported.
  virtual void fell_silent() {}

  /// Starts running; the caller then calls `open_stream`.
  void begin() noexcept;
  void end() noexcept;
  /// The connection is open. Without `silence` this ends the gap; with `silence` the first sample ends it.
  void opened();
  /// There is no connection since `since`: faulted, tried again later. With `silence` the gap begins at the last
  /// sample; without, a connection with bytes but no sample counts as none.
  void lose(const Error& error, MonotonicTime since);
  /// One or more samples came just now.
  void heard();
  /// Bytes came, from which samples are made: this ends a silence.
  void heard_bytes();
  /// A sample that `only` does not select: it counts as filtered.
  void leave_out();
  /// A sample that could be used.
  void succeed();
  /// No sample, and no problem.
  void set_healthy();
  /// Takes a decoded sample. False: its processing found it unusable, which is reported.
  bool take_or_fail(void* payload, Time time);
  /// Takes a sample that could not be decoded.
  void fail(const Error& error);
  /// Reports the error; the sensor is degraded because of it.
  void degrade(const Error& error);
  bool is_silent() const noexcept { return is_silent_; }
  MonotonicTime heard_at() const noexcept { return heard_at_; }
  void on_close() noexcept override;

 private:
  void look_for_silence();
  /// Notes a received sample, which ends an absence.
  void came() noexcept;

  const Waits waits_;
  Timer retry_;
  Timer silence_;
  Backoff backoff_;
  MonotonicTime heard_at_{};  // when something came last, or it was opened
  MonotonicTime came_at_{};   // the same of a sample
  bool is_connected_ = false;
  bool has_come_ = false;   // a sample, since it was opened
  bool has_heard_ = false;  // bytes
  bool is_silent_ = false;  // silent for too long
  bool is_running_ = false;
};

}  // namespace rtdata::detail
