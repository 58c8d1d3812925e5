// The node of sensors that take lines of text from a descriptor: a serial line, a program's output.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sensors/lines.hpp"
#include "sensors/core/stream_node.hpp"
#include "sensors/lines/device_clock.hpp"
#include "sensors/lines/frame_cutter.hpp"
#include "sensors/lines/line_decoder.hpp"
#include "sensors/lines/nmea.hpp"

namespace rtdata::detail {

class LineNode : public StreamNode {
 public:
  void start() override;
  void stop() override;
  void stop_schedule(MonotonicTime end) override;
  std::optional<SensorLoad> load() const override;

 protected:
  /// `place`: the source of the lines, in messages. `advice`: what to check if the received bytes are not lines.
  /// SetupError: as LineDecoder.
  LineNode(LoopCore& loop, const FeedConfig& feed, LineConfig config, std::string place, const char* advice);

  // A derived class overrides `open_stream`, whose result goes to `take`, now or later: a descriptor that does not
  // block, closed with `close_source`, or the reason why it could not be opened.
  void take(Result<int> fd);
  /// Reads the source from now on: calls `take_bytes` with what it reads. Overridden where nodes share a source.
  virtual void watch_source(int fd);
  /// Bytes that were read; empty: the source has ended, with the error of `read` or 0.
  void take_bytes_read(std::string_view bytes, int error_number);
  virtual void close_source(int fd) noexcept = 0;
  /// The source has ended: the derived class calls `lose`, now or later. `error_number` is that of `read`; 0: the end
  /// of the stream.
  virtual void source_ended(int error_number) = 0;
  /// Starts running; the caller opens the source.
  void begin_lines();
  /// The first bytes are the rest of a line, however long the source is silent.
  void expect_rest_of_line();
  bool has_source() const noexcept { return fd_ >= 0; }
  /// Changes with each opening.
  unsigned opening() const noexcept { return openings_; }
  /// The source can end by itself: a line without a line end is reported then.
  void set_stream() noexcept { is_stream_ = true; }
  /// The message is complete: bytes without a line end are unreadable.
  void end_message();
  /// Stops reading from the source.
  void pause_reading() { watch_.close(); }
  void close_stream() noexcept override;
  const std::string& place() const noexcept { return place_; }
  const LineConfig& config() const noexcept { return config_; }
  void on_close() noexcept override;

 private:
  LineNode(LoopCore& loop, const FeedConfig& feed, LineConfig config, std::string place, const char* advice,
           std::unique_ptr<LineDecoder> decoder);
  Error silence_error() const override;
  void use(int fd);
  void on_ready(const FdEvent& event);
  void take_read(std::size_t before);
  void take_end(int error_number);
  void take_lines(std::size_t from);
  void take_line(std::string_view line);
  void take_frames();
  bool take_frame(std::string_view frame);
  void skip(std::string_view bytes, bool are_all);
  void report_outside(bool is_much);
  void take_decoded();
  Time time_of_decoded();
  void take_sentence(std::string_view line);
  void publish(GpsFix fix, Time time);
  void finish_fix();
  void hold(std::uint64_t lost, std::uint64_t unusable, Time time);
  void let_go();
  void refuse_held();
  void fail_unended();
  void report_unended();
  enum class End { of_source, ours };
  void report_rest(End end);
  void fail_overlong();
  void fail_line(const Error& error);

  const LineConfig config_;
  const std::string place_;
  const char* const advice_;
  std::unique_ptr<LineDecoder> decoder_;  // null: NMEA
  std::unique_ptr<NmeaFixes> fixes_;
  std::optional<FrameCutter> cutter_;  // none: lines
  std::optional<DeviceClock> clock_;
  std::size_t skipped_ = 0;         // bytes outside of frames that are not yet reported
  std::size_t reported_bytes_ = 0;  // of a frame that could not be used
  unsigned tries_ = 0;              // frames that could not be used, one within another
  const NmeaFixes::Publish publish_fix_ = [this](const GpsFix& fix, Time time) { publish(fix, time); };
  std::optional<GpsFix> last_fix_;
  struct Held {
    bool is_there = false;
    std::uint64_t lost = 0;
    std::uint64_t unusable = 0;  // lines before it
    Time time{};
    std::vector<std::max_align_t> storage = {};
    std::size_t size = 0;
    std::byte* payload() noexcept { return reinterpret_cast<std::byte*>(storage.data()); }
  };
  Held held_;
  Timer hold_;
  Timer outside_;  // since the last bytes outside of frames
  Timer quiet_;    // since the opening
  FdWatch watch_;
  int fd_ = -1;
  std::string line_;  // the bytes of the lines that are not complete, never more than max_line + most_read
  Time time_{};       // of the last read
  unsigned openings_ = 0;
  std::size_t unended_ = 0;           // bytes since the last line end
  bool is_unended_reported_ = false;  // that there are too many
  unsigned lines_to_skip_ = 0;
  std::uint64_t unusable_lines_ = 0;  // since the last good one
  bool is_first_ = true;              // only the rest of a line may have been received yet
  bool is_beginning_ = true;          // no line has been received yet
  bool is_taking_ = false;            // frames are being taken
  bool is_stream_ = false;
  bool is_overlong_ = false;  // the rest of the line is discarded
};

/// SetupError (bad-argument): settings that are invalid for any source.
void check_source(const LineConfig& config, const std::string& sensor);

}  // namespace rtdata::detail
