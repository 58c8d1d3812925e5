#include "rtdata/sensors/trigger.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <limits>
#include <utility>

#include "data/saturating.hpp"
#include "data/setting_mistake.hpp"
#include "loop/events/made_of.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "process/expression_sources.hpp"
#include "rtdata/data/config_value.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/topic.hpp"
#include "sensors/core/feed_node.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_pass = "cannot pass on events";
constexpr const char*
    processes_elsewhere = "events are passed on unchanged: set `process` of the sensor that publishes them";
constexpr std::size_t most_at_once = 500;  // events that are published, since topics have room for 1024 that wait
constexpr Duration between_parts = std::chrono::milliseconds{1};

/// Why the topics are invalid; empty: they are valid.
std::string refusal_of(const TriggerConfig& config) {
  const std::vector<std::string> topics = detail::topics_of(config.on, config.with);
  for (auto topic = topics.begin(); topic != topics.end(); ++topic) {
    if (!is_topic_name(*topic)) return "\"" + *topic + "\" is not a topic";
    if (std::find(topics.begin(), topic, *topic) != topic) return "the topic \"" + *topic + "\" is listed twice";
  }
  return "";
}

}  // namespace

namespace detail {

/// Events of one size, the oldest first. Allocates its memory at once.
class EventRing {
 public:
  EventRing(std::size_t room, std::size_t payload_bytes)
      : room_(room), stride_(stride_of(payload_bytes)), bytes_(payload_bytes) {
    memory_.resize(room_ * stride_);
  }
  /// Of one event.
  static std::size_t stride_of(std::size_t payload_bytes) noexcept {
    return sizeof(std::int64_t) + (payload_bytes + 7) / 8 * 8;
  }
  bool is_full() const noexcept { return end_ - begin_ == room_; }
  /// Counts all events so far; those from `begin` on are stored.
  std::uint64_t begin() const noexcept { return begin_; }
  std::uint64_t end() const noexcept { return end_; }
  Time oldest() const noexcept {
    std::int64_t time = 0;
    std::memcpy(&time, at(begin_), sizeof time);
    return Time{Duration{time}};
  }
  std::byte* payload() noexcept { return const_cast<std::byte*>(at(begin_)) + sizeof(std::int64_t); }
  void pop() noexcept { ++begin_; }
  void push(Time time, const std::byte* payload) noexcept {
    const std::int64_t number = time.time_since_epoch().count();
    std::byte* const to = const_cast<std::byte*>(at(end_++));
    std::memcpy(to, &number, sizeof number);
    std::memcpy(to + sizeof number, payload, bytes_);
  }

 private:
  const std::byte* at(std::uint64_t number) const noexcept { return memory_.data() + number % room_ * stride_; }

  const std::size_t room_, stride_, bytes_;
  std::vector<std::byte> memory_;
  std::uint64_t begin_ = 0, end_ = 0;
};

class TriggerNode final : public FeedNode {
 public:
  TriggerNode(Loop& loop, const FeedConfig& feed, const TriggerConfig& config,
              const std::shared_ptr<const Description>& description)
      : FeedNode(loop.core(), feed, described_type(description)),
        config_(config),
        description_(description),
        when_(config.when, names_of({config.when})),
        sources_(topics_of(config.on, config.with), when_.names()),
        ring_(config.events, description->size()),
        more_(loop, [this] {
          Call call(*this);
          publish_some();
        }) {
    set_numbered();  // it makes its events from those of other origins
  }

  /// Separate, because a subscription may fail.
  void subscribe(Loop& loop) {
    subscriptions_ = sources_.subscribe(loop, "sensor " + origin_.name,
                                        [this](std::size_t from, const EventView& event) { take(from, event); });
    set_made_of(origin_, sources_.topics());
    recall();
  }

  void start() override {
    if (is_running() || !is_open()) return;
    FeedNode::start();
    when_.reset();
    sources_.forget();
    first_.reset();
    troubles_ = 0;
    recall();
  }
  void stop() override {
    empty();
    FeedNode::stop();
  }
  void stop_schedule(MonotonicTime end) override {
    empty();
    FeedNode::stop_schedule(end);
  }

 private:
  enum Trouble : unsigned { no_name = 1, too_old = 2, fails = 4, condition = 7, short_ring = 8, other_payload = 16 };

  void put(std::size_t from, const EventView& event) {
    sources_.put(from, event,
                 [this](std::size_t name, std::optional<double> value) { set_or_unknown(when_, name, value); });
  }
  /// Takes the last events of topics `with` that publish only changes.
  void recall() {
    sources_.recall(loop()->face, [this](std::size_t from, const EventView& event) {
      if (from != 0) put(from, event);
    });
  }
  void take(std::size_t from, const EventView& event) {
    if (!is_running()) return;
    Call call(*this);
    put(from, event);
    const Time now = event.time();
    if (!first_) first_ = now;
    if (from == 0) {
      if (!is_alike(event.description())) return refuse();
      if (ring_.is_full()) make_room(now);
      clear(other_payload);
      if (!is_running()) return;  // the handler of a report has stopped it
      ring_.push(now, event.payload().data());
    }
    forget_before(now);
    if (holds(now)) released_ = ring_.end();
    publish_some();
  }

  /// True if the ring has room for it.
  bool is_alike(const Description& description) {
    if (description.serial() == serial_) return true;
    if (!description_->same_layout(description) || !description_->same_meaning(description)) return false;
    serial_ = description.serial();
    return true;
  }

  void refuse() {
    ++origin_.counts.received;
    ++origin_.counts.unreadable;
    tell(other_payload, Errc::bad_data,
         [&] { return "the topic \"" + config_.on + "\" has other fields than at the start"; });
  }

  bool holds(Time now) {
    if (const ExpressionSources::Source* const lacking = sources_.lacking(now, config_.age)) {
      const bool may_come = !lacking->has_come && lacking->missing == nullptr &&
                            span_between(*first_, now) <= config_.age;
      if (may_come) return false;
      const bool is_name = lacking->missing != nullptr;
      tell(is_name ? no_name : too_old, is_name ? Errc::not_found : Errc::timed_out,
           [&] { return "`when` has no value: " + ExpressionSources::why(*lacking, config_.age); });
      return false;
    }
    const ExpressionResult result = when_.evaluate(now);
    if (result.has_failed()) {
      tell(fails, Errc::bad_data, [&] { return "`when` fails: " + when_.why(); });
      return false;
    }
    clear(condition);
    return result.is_true();
  }
  /// Reports once each time that it begins.
  template <class Why>
  void tell(Trouble trouble, Errc code, Why&& why) {
    if ((troubles_ & trouble) != 0) return;
    if ((trouble & condition) != 0) troubles_ &= ~unsigned{condition};
    troubles_ |= trouble;
    complain({code, cannot_pass, object_name(), why(),
              trouble == short_ring ? "set more `events`" : "no event is passed on until then"},
             Health::degraded);
  }
  void clear(Trouble trouble) {
    if ((troubles_ & trouble) == 0) return;
    troubles_ &= ~unsigned{trouble};
    if (troubles_ == 0 && is_open()) set_health(Health::ok, nullptr);
  }

  /// Removes events that are too old and will not be published.
  void forget_before(Time now) {
    const std::uint64_t before = ring_.begin();
    while (ring_.begin() != ring_.end() && ring_.begin() >= released_ && ring_.oldest() < now &&
           span_between(ring_.oldest(), now) > config_.before)
      forget();
    if (ring_.begin() != before) clear(short_ring);
  }
  void forget() noexcept {
    ++origin_.counts.received;
    ++origin_.counts.filtered;
    ring_.pop();
  }
  void make_room(Time now) {
    if (ring_.begin() < released_) return publish_one();
    const Duration reach = span_between(ring_.oldest(), now);
    forget();
    if (reach > config_.before) return clear(short_ring);
    tell(short_ring, Errc::does_not_fit, [&] {
      return "the ring is full with " + std::to_string(config_.events) + " events: they reach back " +
             to_string(reach) + ", not " + to_string(config_.before);
    });
  }

  void publish_some() {
    for (std::size_t i = 0; ring_.begin() < released_; ++i) {
      if (i == most_at_once) return more_.start(between_parts);
      publish_one();
      if (!is_running()) return;
    }
  }
  void publish_one() {
    const Time time = ring_.oldest();
    std::byte* const payload = ring_.payload();
    ring_.pop();
    if (take_sample(payload, time) == Fate::unusable) complain_of_input(unusable_error());
  }

  /// No more events come.
  void empty() noexcept {
    more_.stop();
    if (!is_running()) return;
    try {
      while (ring_.begin() < released_) publish_one();
    } catch (const std::exception& thrown) {
      loop()->runtime.log(LogLevel::error, object_name(), thrown.what());
    }
    while (ring_.begin() != ring_.end()) forget();
    released_ = ring_.end();
  }

  void on_close() noexcept override {
    subscriptions_.clear();
    empty();
    more_.close();
    FeedNode::on_close();
  }

  const TriggerConfig config_;
  const std::shared_ptr<const Description> description_;
  Expression when_;
  ExpressionSources sources_;
  EventRing ring_;
  Timer more_;
  std::vector<Subscription> subscriptions_;
  std::uint64_t serial_ = 0;    // with an equal description
  std::uint64_t released_ = 0;  // events before this position in the ring must be published
  std::optional<Time> first_;   // since the start
  unsigned troubles_ = 0;
};

}  // namespace detail

void check_config(const TriggerConfig& config, const ConfigItem& item, Problems& problems) {
  if (const std::string why = refusal_of(config); !why.empty()) problems.add(item.problem("bad-value", why));
  detail::check_expression(config.when, detail::item_of(item, "when"), problems);
}

void check_trigger_names(const TriggerConfig& config,
                         const std::function<const Description*(std::string_view topic)>& payload_of,
                         const ConfigItem& item, Problems& problems) {
  detail::check_field_names(config.when, detail::topics_of(config.on, config.with), payload_of,
                            detail::item_of(item, "when"), problems);
  if (const ConfigItem* const process = item.find("process"); process != nullptr && !process->keys().empty())
    problems.add(process->problem("bad-value", processes_elsewhere));
}

TriggerSensor::TriggerSensor(Loop& loop, FeedConfig feed, TriggerConfig config) {
  const auto refuse = [&](Errc code, std::string why, std::string advice = "") {
    throw SetupError({code, cannot_pass, "sensor " + feed.name, std::move(why), std::move(advice)});
  };
  if (const std::string why = refusal_of(config); !why.empty()) refuse(Errc::bad_argument, why);
  if (!feed.process.empty()) refuse(Errc::bad_argument, processes_elsewhere);
  const detail::TopicCore* const topic = loop.core().runtime.find_topic(config.on);
  if (topic == nullptr)
    refuse(Errc::not_found, "there is no topic \"" + config.on + "\" yet", "make the part that publishes it first");
  if (topic->type.description == nullptr)
    refuse(Errc::bad_description, "the topic \"" + config.on + "\" has no description of its values");
  const std::uint64_t memory = std::min<std::uint64_t>(
      static_cast<std::uint64_t>(::sysconf(_SC_PHYS_PAGES)) * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE)),
      std::numeric_limits<std::size_t>::max() / 2);
  if (config.events > memory / detail::EventRing::stride_of(topic->type.size))
    refuse(Errc::io_failed,
           "a ring of " + std::to_string(config.events) + " events takes more memory than this machine has",
           "make `events` smaller");
  auto* const node = new detail::TriggerNode(loop, feed, config, topic->type.description);
  *this = TriggerSensor(node);
  node->subscribe(loop);
}

}  // namespace rtdata
