// What lies behind a Runtime.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <unordered_set>
#include <vector>

#include "data/hidden.hpp"
#include "loop/deadline.hpp"
#include "loop/handler.hpp"
#include "loop/origin_core.hpp"
#include "loop/placed_list.hpp"
#include "loop/priority_mutex.hpp"
#include "loop/repeats.hpp"
#include "loop/topic_core.hpp"
#include "rtdata/loop/health.hpp"
#include "rtdata/loop/load.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

class Bridge;
class Channel;
struct Passage;
class TierCore;

/// What wants to know of everything that a recording holds besides events. Called on the loop's thread.
class Listener {
 public:
  /// Errors: it cannot take the topic; then `on_refusal` is called with them, when user code may run.
  virtual Result<void> on_topic(TopicCore& topic) = 0;
  virtual void on_refusal(const Error&) {}
  /// One that is new in this run.
  virtual void on_origin(OriginCore&) {}
  virtual void on_gap(OriginCore& origin, const Gap& gap) = 0;
  virtual void on_segment(OriginCore& origin, const Segment& segment) = 0;
  /// `count` of them, alike, from `first` to `last`.
  virtual void on_error(Time first, Time last, std::string_view object, const Error& error, std::uint64_t count) = 0;
  /// `count` changes of one object from `first` to `last`, of which the last one is given.
  virtual void on_health(Time, Time, const HealthChange&, std::uint64_t) {}

 protected:
  ~Listener() = default;
};

/// A sink, as the runtime sees it.
class Recorder : public Listener {
 public:
  virtual void on_clock(const ClockPair& pair) = 0;
  virtual SinkStatus status() const = 0;
  /// Hands over all that is queued, closes; `done` is called later, on the loop, with what was lost.
  virtual void drain(MonotonicTime deadline, Callback<void(std::uint64_t lost)> done) = 0;

 protected:
  ~Recorder() = default;
};

/// A sensor or feed, as the runtime sees it.
class SensorEntry : public Node {
 public:
  using Node::Node;
  virtual void stop() = 0;
  virtual const OriginCore& origin() const noexcept = 0;
  virtual Duration schedule_period() const noexcept = 0;
  virtual bool is_active() const noexcept = 0;
  virtual Health health() const noexcept = 0;
  virtual std::string_view reason() const noexcept = 0;
  /// Ends the schedule at `end`, up to which all is counted; a read under way may finish and be published.
  virtual void stop_schedule(MonotonicTime end) = 0;
  virtual bool is_reading() const noexcept = 0;
  /// A read on the stack, if there is one, is in flight in the account from now on.
  virtual void count_read_begun() noexcept {}
  /// Nothing when there is nothing to read: the program feeds it.
  virtual std::optional<SensorLoad> load() const { return {}; }

  std::uint32_t place = 0;  ///< in the runtime's list
};

/// Origins are found by their names.
struct ByName {
  using is_transparent = void;
  static std::string_view name(std::string_view name) noexcept { return name; }
  static std::string_view name(const OriginCore& origin) noexcept { return origin.name; }
  std::size_t operator()(const auto& one) const noexcept { return std::hash<std::string_view>{}(name(one)); }
  bool operator()(const auto& a, const auto& b) const noexcept { return name(a) == name(b); }
};

SensorStatus status_of(const SensorEntry& sensor);

/// How a payload reads in errors: the name of its description, or that of its C++ type.
std::string payload_name(const PayloadType& type);
/// Of a payload that is not trivially copyable.
Error cannot_cross(const TopicCore& topic);

/// What a bridge tells the other side of before anything of it is sent.
struct Announcement {
  Bridge* bridge;
  Channel* channel;  ///< of a topic; null: its payload cannot cross
  Passage* passage;  ///< of one of its origins; null: the topic itself
  std::string name;
  PayloadType type;
};

class RuntimeCore {
 public:
  RuntimeCore(Runtime& face, Runtime::Config config);
  ~RuntimeCore();

  Runtime& face;
  const Runtime::Config config;
  Clock& clock() noexcept { return *clock_; }
  /// A manual loop brings its own.
  void use_clock(Clock& clock);
  void use_manual_clock() { use_clock(manual_clock_); }
  bool has_injected_clock() const noexcept { return config.clock != nullptr; }

  Time event_now() const noexcept { return event_time(clock_->monotonic()); }
  Time event_time(MonotonicTime at) const noexcept { return later(Time{offset_}, at.time_since_epoch()); }
  MonotonicTime monotonic_of(Time time) const noexcept {
    return MonotonicTime{difference(offset_, time.time_since_epoch())};
  }
  const ClockPair& start() const noexcept { return start_; }
  /// Records the time of day when it was set (moved against the monotonic line by more than 1 ms), when its accuracy is
  /// another, once in a while as long as that is known, or always when an occasion is given. Returns whether it did.
  bool look_at_clock(const char* occasion = nullptr);
  /// See Runtime::note_wall_clock.
  Result<void> note_wall_clock(ClockPair pair);
  /// The time of day now; offsets that differ by less than 1 ms are the noise of reading two clocks, and are one.
  ClockPair read_clock(const char* occasion) noexcept;
  /// What a recording that begins now must know of clocks: the pair now and the last ones of other sources.
  std::vector<ClockPair> clock_pairs();

  /// SetupError: bad-name, description-differs.
  TopicCore& topic(std::string_view name, PayloadType type) {
    TopicCore& found = find_or_make_topic(name, std::move(type));
    report_kept();
    return found;
  }
  /// The same, for who calls `report_kept` later.
  TopicCore& find_or_make_topic(std::string_view name, PayloadType type);
  TopicCore* find_topic(std::string_view name) noexcept;
  const std::vector<std::unique_ptr<TopicCore>>& topics() const noexcept { return topics_; }
  /// Claims the origin for one sensor or feed of this loop. One that another loop has given up goes on here. SetupError
  /// (bad-name, busy): the name is taken, on this loop or another, or was on another topic, or of another kind.
  OriginCore& claim_origin(std::string_view name, TopicCore& topic, OriginCore::Supply supply);
  /// Gives up the claim.
  void release(OriginCore& origin) noexcept;
  /// The main loop's gets a tier: from here on names are kept for all loops.
  void share_names();
  /// Gives up all, as when its tier goes.
  void release_all() noexcept;
  OriginCore* find_origin(std::string_view name) noexcept;
  /// The origin of the program's own events on a topic.
  OriginCore& program_origin(TopicCore& topic);
  const auto& origins() const noexcept { return origins_; }

  std::vector<SubscriptionNode*> patterns;  ///< subscriptions that new topics are offered to
  std::vector<Listener*> listeners;
  std::vector<Recorder*> recorders;  ///< those of the listeners that are sinks
  void attach(Recorder& recorder) {
    recorders.reserve(recorders.size() + 1);
    closed_sinks.reserve(closed_sinks.size() + recorders.size() + 1);  // its end finds a place
    listeners.push_back(&recorder);
    recorders.push_back(&recorder);
  }
  void detach(Recorder& recorder) noexcept {
    std::erase(listeners, &recorder);
    std::erase(recorders, &recorder);
  }
  std::vector<SinkStatus> closed_sinks;  ///< as they ended
  std::string unknown_end;               ///< what those that the last drain closed do not know of tiers; empty: all is
  PlacedList<SensorEntry, &SensorEntry::place> sensors;
  LoopCore* own_loop = nullptr;  ///< while it has one
  unsigned calling = 0;          ///< calls of user code on the stack, see LoopCore::Calling
  void attach(LoopCore& loop);
  /// The loop ends: its topics cancel what is queued, and the log gets the reports that were kept for it.
  void forget(LoopCore& loop) noexcept;
  /// The tier that still uses the loop, for people; empty: none.
  std::string user_of_loop() const;
  /// The main loop's: starts those that were never started. SetupError.
  void start_tiers();
  /// The same; reports the error, and does not try it again in each turn.
  void start_tiers_in_turn() noexcept;
  /// That of the main loop.
  RuntimeCore& main() noexcept { return hub != nullptr ? *hub : *this; }

  // Tiers: each has a runtime core of its own, of which this thread touches none but its own; what one publishes comes to
  // the others through bridges.
  RuntimeCore* hub = nullptr;    ///< of the main loop; null: this is it
  std::vector<TierCore*> tiers;  ///< the hub's
  /// The hub's: knows of each tier up to one instant, and of nothing after it. Returns what it cannot know of tiers that
  /// do not answer in time; empty: nothing.
  std::string hear_tiers_out(Duration at_most);
  /// The hub's: what is not known now of tiers that a drain has given up, and that have not come out since; empty: all is.
  std::string unknown_of_tiers() const;
  /// While one lives, other loops send what they publish on topics of these patterns, whether anybody here takes it or
  /// not: what they publish after they were heard out is there for whoever takes it from then on.
  class Wanted {
   public:
    Wanted(RuntimeCore& runtime, const std::vector<std::string>& patterns);
    Wanted(const Wanted&) = delete;
    Wanted& operator=(const Wanted&) = delete;
    ~Wanted();

   private:
    RuntimeCore& runtime_;
    const std::vector<std::string>& patterns_;
  };
  bool is_wanted(std::string_view topic) const noexcept;
  std::uint64_t names_taken_over = 0;  ///< that were heard of here, by a loop from another
  bool tiers_were_balanced = true;     ///< those that are gone
  bool tiers_had_loss = false;
  std::vector<Bridge*> outbound;         ///< from this loop
  std::vector<Bridge*> inbound;          ///< to this loop
  std::uint64_t lost_between_loops = 0;  ///< events of topics that cannot be what they are elsewhere; which was reported
  /// Takes what other loops sent before the call. May report, as the next does.
  void receive() {
    receive_all();
    report_kept();
  }
  /// The same, for who calls `report_kept` later.
  void receive_all();
  /// From the sending side's thread. All that is announced to this loop is heard in this order, so that of the loops
  /// which had a name one after the other the last one comes last.
  void announce(Announcement announcement);
  void hear_announcements();
  void forget_announcements(const Bridge& of);
  /// If the topic is cut off from another loop, and somebody subscribes to it here, keeps a report of it.
  void tell_of_cut_off(TopicCore& topic);
  /// The other loops get what was published here up to now.
  void send_now() noexcept;
  /// The end of a turn of the loop: tells the other loops.
  void turn_done();
  /// Puts times on the hub's line.
  void share_time(const RuntimeCore& of) noexcept {
    start_ = of.start_;
    offset_ = of.offset_;
    last_offset_ = of.last_offset_;
  }
  OriginCore& find_or_make_origin(std::string_view name, TopicCore& topic);

  /// Throws nothing, also when the program's handler does. Equal lines of one object are joined when there are many.
  void log(LogLevel level, std::string_view object, std::string_view text, std::string_view error_id = {}) noexcept;
  /// On a tier: `what` is called on the main loop. Too much at once is dropped, and told of.
  void tell_hub(Callback<void()> what);
  /// An error met at run time: to the loop's `on_error` or the log, and into the recordings. Repeats of the same error of
  /// the same object within a second are joined, or within a minute when it had 16 of them.
  void report(LoopCore* loop, std::string_view object, const Error& error);
  /// A report may run user code, which may close or destroy anything: while something is iterated over, it is kept, and
  /// made afterwards.
  void keep_report(LoopCore* loop, std::string object, Error error) {
    kept_.push_back({nullptr, loop, std::move(object), std::move(error)});
  }
  void report_kept() {
    if (!kept_.empty()) [[unlikely]]
      report_all_kept();
  }
  /// `flush_repeats` of those due is called at this instant, or earlier.
  void flush_repeats_at(MonotonicTime due) noexcept;
  enum class Repeated { due, all };
  /// Tells of the errors, lines of the log and changes of health that were held back, as far as it is time, or of all.
  void flush_repeats(Repeated which) noexcept;
  Handler<LogRecord> on_log;

  std::unordered_map<std::string, std::string> places;  ///< in the configuration, by the object's name in reports
  std::string place_of(const std::string& object) const {
    const auto found = places.find(object);
    return found != places.end() ? found->second : std::string();
  }
  /// Something does better or worse: to the recordings, and to the topic `$rtdata/health`.
  /// The text without the secrets of the configuration.
  std::string hide(std::string text) const { return hidden(std::move(text), secrets); }
  std::vector<std::string> secrets;  ///< at first those of the configuration; of what is made later, too
  void health_changed(std::string_view kind, std::string_view name, Health health, std::string_view reason) noexcept;

 private:
  std::vector<const std::vector<std::string>*> wanted_;
  struct Kept {
    Listener* listener;  // whose refusal it is, if it still listens; null: a report
    LoopCore* loop;
    std::string object;
    Error error;
  };
  void report_all_kept();
  /// Who has the name of a sensor or feed.
  struct Name {
    struct Left {
      std::string topic;
      OriginCore::State state;
    };
    const RuntimeCore* holder = nullptr;
    std::unique_ptr<Left> left;  // by its last holder
  };
  void release(std::string_view name, Name& claim) noexcept;
  struct ObjectError {
    std::string object;
    Error error;
  };
  struct LogLine {
    LogLevel level{};
    std::string object, text, error_id;
  };
  void write(LoopCore* loop, const Joined<ObjectError>& joined) noexcept;
  void write(const Joined<HealthChange>& joined) noexcept;
  void log_line(const Joined<LogLine>& joined) noexcept;
  /// A source of the time of day.
  struct ClockSource {
    ClockPair recorded, latest;
    std::optional<Duration> best;  ///< since it is known
    /// Whether a pair says what the recorded one does not.
    bool is_news(const ClockPair& pair) const noexcept;
  };
  void record(ClockSource& source, const ClockPair& pair);

  SystemClock system_clock_;
  ManualClock manual_clock_;
  Clock* clock_;
  Duration offset_{0};
  ClockPair start_;
  Duration last_offset_{0};
  ClockSource system_;
  std::vector<ClockSource> plugged_;
  std::vector<std::unique_ptr<TopicCore>> topics_;
  std::unordered_map<std::string_view, TopicCore*> topic_by_name_;
  std::unordered_map<std::string, std::string> name_by_lower_case_;
  std::unordered_set<OriginCore, ByName, ByName> origins_;
  Repeats<ObjectError> errors_{std::chrono::seconds{1}};
  Repeats<LogLine> lines_{Duration{0}};
  Repeats<HealthChange> changes_{Duration{0}};
  // The hub's, counted by all loops: lines of the log that tiers have sent and it has not taken.
  std::atomic<std::uint32_t> reports_under_way_{0};  // from tiers, see tell_hub
  std::atomic<std::uint64_t> reports_dropped_{0};
  std::vector<Kept> kept_;
  struct Flusher final : Deadline {
    explicit Flusher(RuntimeCore& runtime_) : runtime(runtime_) {}
    void fire(MonotonicTime now) override;
    RuntimeCore& runtime;
  };
  Flusher flusher_{*this};
  PriorityMutex announced_mutex_;
  std::vector<Announcement> announced_;
  std::atomic<bool> has_announced_{false};
  PriorityMutex names_mutex_;                    // taken at set-up only
  std::unordered_map<std::string, Name> names_;  // the hub's: of all its tiers
  bool are_names_shared_ = false;                // the hub's; without tiers, its origins know who has their names
};

}  // namespace rtdata::detail
