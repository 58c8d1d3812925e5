#include "rtdata/sensors/limit.hpp"

#include <algorithm>
#include <utility>

#include "data/saturating.hpp"
#include "data/setting_mistake.hpp"
#include "loop/events/made_of.hpp"
#include "process/number_field.hpp"
#include "rtdata/data/config_value.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/topic.hpp"
#include "sensors/core/feed_node.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_watch = "cannot watch limits";

std::string no_such_number(const LimitConfig& config) {
  return "the topic \"" + config.on + "\" has no number `" + (config.field.empty() ? "value" : config.field) + "`";
}

/// True if one is too low and the other too high.
bool are_opposite(LimitLevel a, LimitLevel b) {
  const auto is_low = [](LimitLevel level) { return level == LimitLevel::low || level == LimitLevel::low_low; };
  const auto is_high = [](LimitLevel level) { return level == LimitLevel::high || level == LimitLevel::high_high; };
  return (is_low(a) && is_high(b)) || (is_high(a) && is_low(b));
}

}  // namespace

namespace detail {

class LimitNode final : public FeedNode {
 public:
  LimitNode(Loop& loop, const FeedConfig& feed, const LimitConfig& config)
      : FeedNode(loop.core(), feed, payload_type<Alarm>()),
        config_(config),
        watch_(config.settings()),
        silence_(loop, [this] { look_for_silence(); }),
        held_(loop, [this] { report_held(); }) {
    set_numbered();  // it makes its events itself
  }

  /// Separate, because a subscription may fail.
  void subscribe(Loop& loop) {
    subscription_ = loop.subscribe(config_.on, [this](const EventView& event) { take(event); });
    subscription_.set_name("sensor " + origin_.name + " on " + config_.on);
    set_made_of(origin_, {config_.on});
    begin();
  }

  void start() override {
    if (is_running() || !is_open()) return;
    FeedNode::start();
    begin();
  }
  void stop() override {
    if (!is_running()) return;
    Call call(*this);
    silence_.stop();
    held_.stop();
    FeedNode::stop();
    const Time now = loop()->runtime.event_time(loop()->now());
    if (is_ending_) {
      // The end of the run or of this limit is not a change of the value; publishes changes held back by `join`.
      if (waiting_ > 0) tell(now);
      return;
    }
    // Publishes `unknown`, because followers of the alarm would keep its last event although nobody watches.
    if (watch_.take_unknown() || !has_published_) tell(now);
  }
  void stop_schedule(MonotonicTime end) override {
    is_ending_ = true;
    silence_.stop();
    held_.stop();
    FeedNode::stop_schedule(end);
  }

  bool acknowledge() {
    if (!is_running() || !watch_.acknowledge()) return false;
    tell(loop()->runtime.event_time(loop()->now()));
    return true;
  }
  const LimitState& state() const noexcept { return watch_.state(); }
  void change(const LimitConfig& config) {
    watch_.change(config.settings());
    const Duration silence = std::exchange(config_.silence, config.silence);
    config_.join = config.join;
    if (!is_running() || silence == config.silence) return;
    silence_.stop();
    if (config.silence > Duration{0}) silence_.start(config.silence);
  }

 private:
  void begin() {
    is_ending_ = false;
    watch_.reset();
    has_published_ = false;
    heard_ = loop()->now();
    if (config_.silence > Duration{0}) silence_.start(config_.silence);
  }

  void take(const EventView& event) {
    if (!is_running()) return;
    Call call(*this);
    heard_ = loop()->now();
    if (description_ != event.description().serial()) {
      description_ = event.description().serial();
      field_ = number_field(event.description(), config_.field);
    }
    const std::optional<double> value = field_ == nullptr ? std::nullopt : number_in(*field_, event.payload().data());
    const bool has_changed = value ? watch_.take(*value, event.time()) : watch_.take_unknown();
    if (field_ == nullptr) {
      if (has_changed || !has_published_) tell(event.time());
      fail({Errc::not_found, cannot_watch, object_name(), no_such_number(config_), "check the fields of the topic"});
      return;
    }
    consider(has_changed, event.time());
  }

  /// Publishes a change, or joins it with others during `join`.
  void consider(bool has_changed, Time time) {
    if (has_changed) ++waiting_;
    if (waiting_ == 0 && has_published_) return;
    const LimitLevel alarm = watch_.state().alarm;
    const Duration passed = has_published_ ? span_between(published_, time) : config_.join;
    const bool is_over = passed >= config_.join;
    if (!is_over && severity(alarm) <= worst_ && !are_opposite(alarm, published_alarm_)) {
      if (!held_.is_running()) held_.start(config_.join - passed);
      return;
    }
    worst_ = is_over ? severity(alarm) : std::max(worst_, severity(alarm));
    tell(time);
  }
  void report_held() {
    if (!is_running() || waiting_ == 0) return;
    Call call(*this);
    worst_ = severity(watch_.state().alarm);
    tell(loop()->runtime.event_time(loop()->now()));
  }

  void tell(Time time) {
    const LimitState& state = watch_.state();
    Alarm alarm{state.level, state.alarm, state.alarm != LimitLevel::normal, state.acknowledged,
                state.value, state.limit, waiting_ > 1 ? waiting_ - 1 : 0};
    held_.stop();
    waiting_ = 0;
    published_alarm_ = state.alarm;
    published_ = time;
    has_published_ = true;
    publish(&alarm, time);
  }

  void look_for_silence() {
    const MonotonicTime due = heard_ + config_.silence;
    if (loop()->now() < due) return silence_.start(due - loop()->now());
    silence_.start(config_.silence);
    if (health() == Health::faulted) return;
    Call call(*this);
    if (watch_.take_unknown()) ++waiting_;
    if (waiting_ > 0 || !has_published_) tell(loop()->runtime.event_time(loop()->now()));
    if (!is_open()) return;
    fault({Errc::timed_out, cannot_watch, object_name(),
           "the topic \"" + config_.on + "\" has had no event for " + to_string(config_.silence),
           "the limit continues with the next event of that topic; a longer `silence` bridges longer pauses"});
  }

  void on_close() noexcept override {
    is_ending_ = true;
    subscription_.close();
    silence_.close();
    held_.close();
    FeedNode::on_close();
  }

  LimitConfig config_;
  LimitWatch watch_;
  Subscription subscription_;
  Timer silence_;
  Timer held_;  // fires when `join` is over, while a change is held back
  MonotonicTime heard_{};
  std::uint64_t description_ = 0;  // description of the field; 0: none yet
  const Leaf* field_ = nullptr;
  std::uint32_t waiting_ = 0;                        // changes that were not published
  int worst_ = 0;                                    // of what was published since `join` began
  LimitLevel published_alarm_ = LimitLevel::normal;  // the alarm that was published last
  bool has_published_ = false;
  bool is_ending_ = false;  // it is closed, or the run's schedules have ended
  Time published_{};
};

}  // namespace detail

void check_config(const LimitConfig& config, const ConfigItem& item, Problems& problems) {
  if (const auto good = check_limits(config.settings()); !good)
    problems.add(item.problem("bad-value", good.error().why + "; " + good.error().advice));
  if (!is_topic_name(config.on))
    problems.add(detail::item_of(item, "on").problem("bad-value", "\"" + config.on + "\" is not a topic"));
}

void check_limit_field(const LimitConfig& config,
                       const std::function<const Description*(std::string_view topic)>& payload_of,
                       const ConfigItem& item, Problems& problems) {
  const Description* const payload = payload_of(config.on);
  if (payload == nullptr || detail::number_field(*payload, config.field) != nullptr) return;
  std::vector<std::string> numbers;
  for (const Leaf& leaf : payload->leaves())
    if (detail::number_field(*payload, leaf.path) != nullptr) numbers.push_back(leaf.path);
  std::string why = no_such_number(config);
  const std::string nearest = nearest_name(config.field, numbers);
  if (nearest.empty() && !numbers.empty()) {
    why += "; available:";
    for (const std::string& number : numbers) why += " " + number;
  }
  problems.add(detail::item_of(item, config.field.empty() ? "on" : "field").problem("unknown-field", why, nearest));
}

LimitSensor::LimitSensor(Loop& loop, FeedConfig feed, LimitConfig config) {
  if (!is_topic_name(config.on))
    throw SetupError(
        {Errc::bad_argument, cannot_watch, "sensor " + feed.name, "\"" + config.on + "\" is not a topic", ""});
  auto* const node = new detail::LimitNode(loop, feed, config);
  *this = LimitSensor(node);
  node->subscribe(loop);
}

void LimitSensor::change(const LimitConfig& config) {
  check_limits(config.settings()).or_throw();
  auto* const limit = static_cast<detail::LimitNode*>(node());
  if (limit == nullptr || !limit->is_open()) return;
  if (!limit->loop()->runs_elsewhere()) return limit->change(config);
  limit->loop()->ask_there([limit, config] {
    if (limit->is_open()) limit->change(config);
    return true;
  });
}

bool LimitSensor::acknowledge() {
  auto* const limit = static_cast<detail::LimitNode*>(node());
  if (limit == nullptr || !limit->is_open()) return false;
  if (!limit->loop()->runs_elsewhere()) return limit->acknowledge();
  return limit->loop()->ask_there([limit] { return limit->is_open() && limit->acknowledge(); });
}

LimitState LimitSensor::state() const {
  auto* const limit = static_cast<detail::LimitNode*>(node());
  if (limit == nullptr || !limit->is_open()) return {};
  if (!limit->loop()->runs_elsewhere()) return limit->state();
  return limit->loop()->ask_there([limit] { return limit->state(); });
}

}  // namespace rtdata
