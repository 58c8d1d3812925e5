#include "loop/runtime_core.hpp"

#include <algorithm>
#include <cctype>
#include <cstdio>

#include "loop/bridge.hpp"
#include "loop/loop_core.hpp"

namespace rtdata {

std::string_view name_of(DropReason reason) noexcept {
  switch (reason) {
    case DropReason::queue_full_newest: return "queue full, newest";
    case DropReason::queue_full_oldest: return "queue full, oldest";
    case DropReason::refused: return "refused";
  }
  return "unknown";
}

std::string_view name_of(Health health) noexcept {
  switch (health) {
    case Health::ok: return "ok";
    case Health::degraded: return "degraded";
    case Health::faulted: return "faulted";
  }
  return "unknown";
}

bool is_topic_name(std::string_view name) noexcept {
  if (name.empty() || name.size() > 200) return false;
  if (name.front() == '$') name.remove_prefix(1);
  bool segment_is_empty = true;
  for (const char c : name) {
    if (c == '/') {
      if (segment_is_empty) return false;
      segment_is_empty = true;
    } else if (std::isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '.' || c == '-') {
      segment_is_empty = false;
    } else {
      return false;
    }
  }
  return !segment_is_empty;
}

bool is_topic_pattern(std::string_view pattern) noexcept {
  std::string name(pattern);
  if (name == "#") return true;
  if (name.ends_with("/#")) name.resize(name.size() - 2);
  for (std::size_t begin = 0; begin <= name.size();) {
    const std::size_t end = std::min(name.find('/', begin), name.size());
    if (end - begin == 1 && name[begin] == '+') name[begin] = 'x';
    begin = end + 1;
  }
  return is_topic_name(name);
}

bool topic_matches(std::string_view pattern, std::string_view name) noexcept {
  if (!name.empty() && name.front() == '$' && (pattern.empty() || pattern.front() != '$')) return false;
  for (;;) {
    if (pattern == "#") return true;
    const std::size_t pattern_end = std::min(pattern.find('/'), pattern.size());
    const std::size_t name_end = std::min(name.find('/'), name.size());
    const std::string_view level = pattern.substr(0, pattern_end);
    if (level != "+" && level != name.substr(0, name_end)) return false;
    const bool pattern_done = pattern_end == pattern.size();
    const bool name_done = name_end == name.size();
    if (name_done && !pattern_done) return pattern.substr(pattern_end) == "/#";  // "a/#" matches "a" too
    if (pattern_done || name_done) return pattern_done && name_done;
    pattern.remove_prefix(pattern_end + 1);
    name.remove_prefix(name_end + 1);
  }
}

namespace detail {

std::string payload_name(const PayloadType& type) {
  if (type.description != nullptr) return "\"" + type.description->name() + "\"";
  // "... payload_type() [with T = NAME]" or "[T = NAME]"
  const std::string_view text = type.type_name;
  const auto begin = text.find("T = ");
  return std::string(begin == text.npos ? text : text.substr(begin + 4, text.find_last_of(']') - begin - 4));
}

RuntimeCore::RuntimeCore(Runtime& face_, Runtime::Config config_) : face(face_), config(std::move(config_)) {
  use_clock(config.clock != nullptr ? *config.clock : system_clock_);
}

RuntimeCore::~RuntimeCore() {
  // Handles hold pointers into topics and origins; the loops, which close them, are gone by now.
}

void RuntimeCore::use_clock(Clock& clock) {
  clock_ = &clock;
  start_ = {clock.monotonic(), clock.realtime(), "start"};
  offset_ = start_.realtime.time_since_epoch() - start_.monotonic.time_since_epoch();
  last_offset_ = offset_;
}

bool RuntimeCore::look_at_clock(const char* always_source) {
  const ClockPair pair{clock_->monotonic(), clock_->realtime(), always_source == nullptr ? "step" : always_source};
  const Duration offset = pair.realtime.time_since_epoch() - pair.monotonic.time_since_epoch();
  const Duration moved = offset - last_offset_;
  const bool stepped = moved > std::chrono::milliseconds{1} || moved < -std::chrono::milliseconds{1};
  if (!stepped && always_source == nullptr) return false;
  last_offset_ = offset;
  if (stepped) {
    log(LogLevel::warning, "clock",
        "the time of day was set by " + to_string(moved) + "; recorded times go on without a jump, the step is recorded");
  }
  for (Listener* listener : listeners) listener->on_clock(pair);
  return true;
}

TopicCore* RuntimeCore::find_topic(std::string_view name) noexcept {
  const auto found = topic_by_name_.find(name);
  return found == topic_by_name_.end() ? nullptr : found->second;
}

TopicCore& RuntimeCore::topic(std::string_view name, PayloadType type) {
  if (TopicCore* existing = find_topic(name)) {
    const auto& have = existing->type;
    if ((have.description != nullptr) != (type.description != nullptr) ||
        (have.description == nullptr && have.type_key != type.type_key)) {
      throw SetupError({Errc::description_differs, "cannot use topic", std::string(name),
                        "it carries " + payload_name(have) + ", here " + payload_name(type) + " is meant", "use one type a topic"});
    }
    if (have.description != nullptr && have.description != type.description) {
      if (!have.description->same_meaning(*type.description)) {
        std::string why = "it carries \"" + have.description->name() + "\", here \"" + type.description->name() + "\" is meant";
        for (const std::string& difference : have.description->differences(*type.description)) why += "; " + difference;
        throw SetupError({Errc::description_differs, "cannot use topic", std::string(name), why,
                          "give the second one a topic of its own"});
      }
      if (have.size != type.size || have.alignment != type.alignment) {
        throw SetupError({Errc::description_differs, "cannot use topic", std::string(name),
                          "the same fields lie differently in memory", "use one struct for it"});
      }
    }
    return *existing;
  }
  if (!is_topic_name(name)) {
    throw SetupError({Errc::bad_name, "cannot make topic", "\"" + std::string(name) + "\"", "not a topic name",
                      "use letters, digits, _ . - in levels joined by /, such as \"room/climate\""});
  }
  std::string lower(name);
  std::transform(lower.begin(), lower.end(), lower.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (const auto [other, is_new] = name_by_lower_case_.try_emplace(lower, name); !is_new) {
    throw SetupError({Errc::bad_name, "cannot make topic", std::string(name),
                      "topic " + other->second + " differs from it in case only", "choose another name"});
  }
  topics_.push_back(std::make_unique<TopicCore>(*this, std::string(name), std::move(type)));
  TopicCore& made = *topics_.back();
  topic_by_name_.emplace(made.name, &made);
  struct Refusal {
    LoopCore* loop;
    std::string handler;
    Error error;
  };
  std::vector<Refusal> refused;  // told of at the end, since a report may run user code
  for (SubscriptionNode* node : patterns) {
    if (!topic_matches(node->pattern(), made.name)) continue;
    if (auto linked = made.link(*node->loop(), *node); !linked) refused.push_back({node->loop(), node->name, std::move(linked).error()});
  }
  const auto told = listeners;
  for (Listener* listener : told) listener->on_topic(made);
  for (const Refusal& refusal : refused) report(refusal.loop, refusal.handler, refusal.error);
  return made;
}

OriginCore& RuntimeCore::claim_origin(std::string_view name, TopicCore& topic) {
  if (name.empty() || name.size() > 200 || std::any_of(name.begin(), name.end(), [](unsigned char c) { return c < ' '; })) {
    throw SetupError({Errc::bad_name, "cannot make sensor", "\"" + std::string(name) + "\"",
                      "a name has 1 to 200 characters and no control characters", "give it another `name`"});
  }
  OriginCore* const found = find_origin(name);
  if (found == nullptr) {
    OriginCore& made = make_origin(name, topic);
    made.is_claimed = true;
    for (Listener* listener : listeners) listener->on_origin(made);
    return made;
  }
  OriginCore& known = *found;
  if (known.is_claimed || known.is_mirror) {
    throw SetupError({Errc::busy, "cannot make sensor", std::string(name), "there is one of that name already",
                      "give each sensor a `name` of its own"});
  }
  if (&known.topic != &topic) {
    throw SetupError({Errc::busy, "cannot make sensor", std::string(name),
                      "earlier in this run it published on topic " + known.topic.name, "choose another name or that topic"});
  }
  known.is_claimed = true;
  return known;
}

OriginCore* RuntimeCore::find_origin(std::string_view name) noexcept {
  const auto found = origins_.find(name);
  // Elements of a set are const for the sake of their key, the name, which is const in itself.
  return found == origins_.end() ? nullptr : const_cast<OriginCore*>(&*found);
}

OriginCore& RuntimeCore::make_origin(std::string_view name, TopicCore& topic) {
  auto& made = const_cast<OriginCore&>(*origins_.emplace(name, topic, static_cast<std::uint32_t>(topic.origins().size())).first);
  topic.origins().push_back(&made);
  return made;
}

OriginCore& RuntimeCore::mirror_origin(std::string_view name, TopicCore& topic) {
  if (find_origin(name) != nullptr) {
    throw SetupError({Errc::busy, "cannot take over sensor", std::string(name), "there is one of that name on another tier already",
                      "give each sensor a `name` of its own"});
  }
  OriginCore& made = make_origin(name, topic);
  made.is_mirror = true;
  return made;
}

OriginCore& RuntimeCore::program_origin(TopicCore& topic) {
  // One for each topic and loop: a sequence belongs to one topic.
  if (topic.program_origin == nullptr) {
    const std::string of_tier = hub != nullptr ? "@" + loops.front()->config.name : "";
    topic.program_origin = &claim_origin("program:" + topic.name + of_tier, topic);
  }
  return *topic.program_origin;
}

SensorStatus status_of(const SensorEntry& sensor) {
  const OriginCore& origin = sensor.origin();
  return {origin.name,     origin.topic.name,            sensor.schedule_period(), sensor.is_active(),
          sensor.health(), std::string(sensor.reason()), origin.counts};
}

void RuntimeCore::log(LogLevel level, std::string_view object, std::string_view text, std::string_view error_id) {
  if (hub != nullptr && !on_log) {
    hub->loops.front()->post([hub = hub, level, object = std::string(object), text = std::string(text), id = std::string(error_id)] {
      hub->log(level, object, text, id);
    });
  } else if (on_log) {
    on_log({level, event_time(clock_->monotonic()), object, text, error_id});
  } else if (level >= LogLevel::warning) {
    std::fprintf(stderr, "rtdata: %s: %.*s: %.*s\n", level == LogLevel::error ? "error" : "warning",
                 static_cast<int>(object.size()), object.data(), static_cast<int>(text.size()), text.data());
  }
}

void RuntimeCore::report(LoopCore* loop, std::string_view object, const Error& error) {
  constexpr std::size_t most_remembered = 256;
  const MonotonicTime now = clock_->monotonic();
  for (Repeat& repeat : repeats_) {
    if (repeat.object != object || repeat.error.code != error.code) continue;
    if (now - repeat.last_written < std::chrono::seconds{1}) {
      if (repeat.held_back++ == 0 && loop != nullptr) loop->flush_repeats_at(repeat.last_written + std::chrono::seconds{1});
      return;
    }
    const std::uint64_t count = repeat.held_back + 1;
    repeat.held_back = 0;
    repeat.last_written = now;
    write(loop, object, error, count);
    return;
  }
  if (repeats_.size() >= most_remembered) {
    flush_repeats(Repeats::all);
    repeats_.clear();
  }
  repeats_.push_back({std::string(object), error, now, 0});
  write(loop, object, error, 1);
}

void RuntimeCore::flush_repeats(Repeats which) {
  const MonotonicTime now = clock_->monotonic();
  for (std::size_t i = 0; i < repeats_.size(); ++i) {
    if (repeats_[i].held_back == 0 || (which == Repeats::old && now - repeats_[i].last_written < std::chrono::seconds{1})) {
      continue;
    }
    const Repeat repeat = repeats_[i];
    repeats_[i].held_back = 0;
    repeats_[i].last_written = now;
    write(nullptr, repeat.object, repeat.error, repeat.held_back);
  }
}

void RuntimeCore::write(LoopCore* loop, std::string_view object, const Error& error, std::uint64_t count) noexcept try {
  const Time time = event_time(clock_->monotonic());
  for (Listener* listener : listeners) listener->on_error(time, object, error, count);
  if (loop == nullptr && !loops.empty()) loop = loops.front();
  if (loop != nullptr && loop->on_error) {
    // Taken out for the call: it may set another, and an error met in it goes to the log rather than round in a circle.
    Callback<void(const ErrorReport&)> handler = std::move(loop->on_error);
    try {
      handler({object, error, count});
    } catch (...) {
      log(LogLevel::error, object, error.text() + " (and the handler of errors threw)", error.id());
    }
    if (!loop->on_error) loop->on_error = std::move(handler);
    return;
  }
  std::string text = error.text();
  if (count > 1) text += " (" + std::to_string(count) + " times)";
  log(LogLevel::error, object, text, error.id());
} catch (...) {  // out of memory, or the handler of log records threw: nothing is left to tell it to
}

}  // namespace detail

Runtime::Runtime() : Runtime(Config{}) {}
Runtime::Runtime(Config config) : core_(std::make_unique<detail::RuntimeCore>(*this, std::move(config))) {}
Runtime::~Runtime() = default;

const Runtime::Config& Runtime::config() const noexcept { return core_->config; }
void Runtime::on_log(Callback<void(const LogRecord&)> handler) { core_->on_log = std::move(handler); }

std::vector<SensorStatus> Runtime::sensors() const {
  std::vector<SensorStatus> all;
  for (const auto* sensor : core_->sensors) all.push_back(detail::status_of(*sensor));
  for (const auto* bridge : core_->inbound) bridge->add_statuses(all);
  return all;
}

std::vector<SinkStatus> Runtime::sinks() const {
  std::vector<SinkStatus> all = core_->closed_sinks;
  for (const auto* recorder : core_->recorders) all.push_back(recorder->status());
  return all;
}

std::vector<TopicStatus> Runtime::topics() const {
  std::vector<TopicStatus> all;
  for (const auto& topic : core_->topics()) {
    std::uint64_t published = 0;
    for (const auto* origin : topic->origins()) published += origin->sequence;
    all.push_back({topic->name, topic->type.description, published, topic->subscription_counts()});
  }
  return all;
}

bool Runtime::balances() const {
  for (const detail::OriginCore& origin : core_->origins()) {
    if (!origin.counts.balances() || (origin.counts.published != origin.sequence && !origin.is_mirror)) return false;
  }
  for (const SinkStatus& sink : sinks()) {
    if (!sink.counts.balances()) return false;
  }
  for (const auto& topic : core_->topics()) {
    if (!topic->subscription_counts().balances()) return false;
  }
  return true;
}

bool Runtime::has_loss() const {
  for (const detail::OriginCore& origin : core_->origins()) {
    if (origin.counts.has_loss()) return true;
  }
  for (const SinkStatus& sink : sinks()) {
    if (sink.counts.all_dropped() > 0) return true;
  }
  return false;
}

}  // namespace rtdata
