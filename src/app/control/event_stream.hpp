// A stream of events as lines of JSON, for one reader: what docs/subscribe.md describes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "app/control/event_ring.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/data/time.hpp"

namespace rtdata::app {

/// The request of a reader.
struct StreamRequest {
  static constexpr std::size_t most_topics = 64;
  std::vector<std::string> topics = {"#"};  ///< patterns
  Duration step{0};                         ///< 0: each event
  std::optional<Time> from = {};            ///< none: now
  std::optional<Duration> ago = {};         ///< the same, as a time before now
  std::string of = {};  ///< the sink whose recording has the earlier events; empty: the first that fits
  Duration pace = std::chrono::milliseconds{10};  ///< of what is sent; at least

  bool wants_past() const noexcept { return from || ago; }
  /// True if its patterns match the topic.
  bool names(std::string_view topic) const noexcept;
  /// Every reader gets these, too, as they come.
  static bool is_beside(std::string_view topic) noexcept;
};
/// True if a line of the control socket is a request for events.
bool asks_for_events(std::string_view line);
/// Errors: bad-argument, whose `why` answers the reader.
Result<StreamRequest> stream_request(std::string_view line);

/// One origin on one topic.
struct StreamOrigin {
  std::size_t index = 0;  ///< among all that the readers know
  std::string topic;
  std::string quoted_topic, quoted_origin;  ///< in JSON
};
class StreamOrigins {
 public:
  const StreamOrigin& of(const PackedEvent& event);

 private:
  struct Hash {
    using is_transparent = void;
    std::size_t operator()(std::string_view text) const noexcept { return std::hash<std::string_view>{}(text); }
  };
  std::unordered_map<std::string, StreamOrigin, Hash, std::equal_to<>> all_;
};

/// The line of one event, made when it is first needed, for all streams.
class EventLine {
 public:
  void set(const PackedEvent& event) noexcept {
    event_ = &event;
    line_.clear();
  }
  std::string_view text();

 private:
  const PackedEvent* event_ = nullptr;
  const std::unique_ptr<Codec> codec_ = make_json_codec();
  std::vector<std::byte> line_;
};

/// Events of one origin, summed up.
class StepSums {
 public:
  bool is_empty() const noexcept { return count_ == 0; }
  Time from() const noexcept { return from_; }
  Time until() const noexcept { return until_; }
  /// The events of this description have the same fields: continues with them.
  bool goes_on_with(const Description* description);
  const Description* description() const noexcept { return description_; }
  /// The first event of a step.
  void begin(const PackedEvent& event, Time from, Time until);
  void add(const PackedEvent& event);
  /// A later step of the same fields becomes part of this one.
  void add(const StepSums& later);
  void extend(Time until) noexcept { until_ = until; }
  void clear() noexcept { count_ = 0; }
  void append_to(std::string& text, const StreamOrigin& origin) const;

 private:
  void set(const Description* description);
  struct Number {
    std::uint64_t count = 0;
    double least = 0, most = 0, mean = 0, last = 0;
  };
  const Description* description_ = nullptr;
  Time from_{}, until_{};
  std::uint64_t count_ = 0, first_ = 0, last_ = 0;
  std::vector<const Leaf*> leaves_;  // that are numbers
  std::vector<Number> numbers_;
};

/// Turns events into the text for one reader. The waiting text is limited: beyond `most_bytes`, events are counted and
/// summed up until the reader has read most of it.
///
/// Owner and thread: the readers'. The code that sends the text reports how much was sent.
class EventStream {
 public:
  static constexpr std::size_t most_bytes = std::size_t{256} << 10;

  /// `recording`: the sink that is read first; empty: it begins live.
  EventStream(StreamRequest request, std::string_view run, std::string_view recording);
  void take(const PackedEvent& event, const StreamOrigin& origin, EventLine& line);
  /// Called after events, and from time to time without any: adds complete steps, counts of dropped events, a sign of
  /// life.
  void turn(Time now);
  /// Later events belong to this run, until the next call: sequences begin again.
  void begin_run(std::string_view uuid);
  /// Events from now on are live.
  void go_live(Time now);
  bool is_live() const noexcept { return is_live_; }
  Duration pace() const noexcept { return request_.pace; }
  bool takes(std::string_view topic) const noexcept { return StreamRequest::is_beside(topic) || request_.names(topic); }
  /// True for topics that are live from the beginning, even while a recording is read.
  bool takes_beside(std::string_view topic) const noexcept {
    return StreamRequest::is_beside(topic) && !request_.names(topic);
  }
  /// The last line: {"KEY": why}.
  void end(const char* key, std::string_view why);

  std::string_view text() const noexcept { return std::string_view(text_).substr(sent_); }
  void sent(std::size_t bytes);

 private:
  struct State {
    bool is_known = false;  // the two below
    bool is_taken = false;
    std::uint64_t last = 0;             // last sequence that was sent, summed up or counted as dropped; 0: none
    const Description* told = nullptr;  // that with whose units its topic was told last, in this run
    StepSums step;
    StepSums held;  // of the dropped events
    const StreamOrigin* origin = nullptr;
  };
  State& state_of(const StreamOrigin& origin);
  void tell_units(State& state, const Description& description);
  void drop(const StreamOrigin& origin, std::uint64_t count);
  void add_to_step(State& state, const PackedEvent& event);
  void give_step(State& state);
  void hold(State& state, const PackedEvent& event);
  void tell_dropped(const std::string& quoted_topic, std::uint64_t count);
  void catch_up();
  void look_whether_behind() noexcept { is_behind_ = is_behind_ || text_.size() - sent_ > most_bytes; }

  const StreamRequest request_;
  std::vector<State> states_;                      // by index of the origin
  std::map<std::string, std::string> units_told_;  // by quoted topic: the last
  std::string text_;
  std::size_t sent_ = 0;
  bool is_live_ = true;
  bool is_behind_ = false;
  std::string run_;
  std::map<std::string, std::uint64_t> dropped_;  // by quoted topic, while it is behind
  Time next_end_ = Time::max();                   // of a step
  Time last_line_{};
  bool has_new_lines_ = false;
};

}  // namespace rtdata::app
