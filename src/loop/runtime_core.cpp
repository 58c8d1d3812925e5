#include "loop/runtime_core.hpp"

#include <pthread.h>
#include <time.h>

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <utility>

#include "loop/bridge.hpp"
#include "loop/loop_core.hpp"
#include "loop/tier_core.hpp"

namespace rtdata {

std::string_view name_of(DropReason reason) noexcept {
  switch (reason) {
    case DropReason::queue_full_newest:
      return "queue full, newest";
    case DropReason::queue_full_oldest:
      return "queue full, oldest";
    case DropReason::refused:
      return "refused";
  }
  return "unknown";
}

std::string_view name_of(Health health) noexcept {
  switch (health) {
    case Health::ok:
      return "ok";
    case Health::degraded:
      return "degraded";
    case Health::faulted:
      return "faulted";
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

Error cannot_cross(const TopicCore& topic) {
  return {Errc::bad_argument, "cannot subscribe", topic.name,
          "its payload " + payload_name(topic.type) + " is not trivially copyable and cannot cross tiers",
          "use text<N> for strings, arrays for vectors; or subscribe on the loop that publishes it"};
}

RuntimeCore::RuntimeCore(Runtime& face_, Runtime::Config config_) : face(face_), config(std::move(config_)) {
  use_clock(config.clock != nullptr ? *config.clock : system_clock_);
}

RuntimeCore::~RuntimeCore() {
  // Handles hold pointers into topics and origins; the loops, which close them, are gone by now.
}

void RuntimeCore::use_clock(Clock& clock) {
  clock_ = &clock;
  start_ = {clock.monotonic(), clock.realtime(), "system", clock.accuracy(), "start"};
  offset_ = start_.realtime.time_since_epoch() - start_.monotonic.time_since_epoch();
  last_offset_ = offset_;
  system_ = {start_, start_, start_.accuracy};
}

namespace {

constexpr std::size_t most_clock_sources = 16;
constexpr Duration clock_look_interval = std::chrono::seconds{1};
constexpr Duration least_between_pairs = std::chrono::seconds{10};  // of one source, so that a recording is not flooded
constexpr Duration most_between_pairs = std::chrono::minutes{10};

bool is_step(Duration moved) noexcept {
  constexpr Duration noise = std::chrono::milliseconds{1};
  return moved > noise || moved < -noise;
}

}  // namespace

ClockPair RuntimeCore::read_clock(const char* occasion) noexcept {
  const MonotonicTime before = clock_->monotonic();
  const Time realtime = clock_->realtime();
  const MonotonicTime at = before + (clock_->monotonic() - before) / 2;
  const Duration offset = realtime.time_since_epoch() - at.time_since_epoch();
  return {at, is_step(offset - last_offset_) ? realtime : Time{at.time_since_epoch() + last_offset_}, "system",
          clock_->accuracy(), occasion};
}

bool RuntimeCore::look_at_clock(const char* occasion) {
  ClockPair pair = read_clock(occasion);
  const Duration offset = pair.realtime.time_since_epoch() - pair.monotonic.time_since_epoch();
  const bool was_set = offset != last_offset_;
  if (!was_set && occasion == nullptr && pair.monotonic - system_.latest.monotonic < clock_look_interval) return false;
  if (was_set) {
    log(LogLevel::warning, "clock",
        "the time of day was set by " + to_string(offset - last_offset_) +
            "; recorded times go on without a jump, the step is recorded");
    last_offset_ = offset;
    // A clock that was right until now (a leap second, a machine that slept): where it stood just before.
    if (system_.latest.accuracy && system_.latest.monotonic > system_.recorded.monotonic)
      record(system_, system_.latest);
    if (occasion == nullptr) pair.occasion = "step";
  } else if (occasion == nullptr) {
    pair.occasion = pair.accuracy.has_value() == system_.recorded.accuracy.has_value() ? "regular" : "sync";
    if (!system_.is_news(pair)) {
      system_.latest = pair;
      return false;
    }
  }
  if (std::string_view(pair.occasion) == "end") {
    for (ClockSource& source : plugged_) {
      if (source.latest.monotonic > source.recorded.monotonic) record(source, source.latest);
    }
  }
  record(system_, pair);
  return true;
}

Result<void> RuntimeCore::note_wall_clock(ClockPair pair) {
  const auto refused = [&](Errc code, const char* why, const char* advice) {
    return Error{code, "cannot note the time of day", "source \"" + pair.source + "\"", why, advice};
  };
  if (pair.source.empty() || pair.source.size() > 64 || pair.source == "system") {
    return refused(Errc::bad_name, "a source has a name of 1 to 64 characters that is not \"system\"",
                   "name it after what it is: \"gps\"");
  }
  if (pair.accuracy && *pair.accuracy <= Duration{0}) {
    return refused(Errc::bad_argument, "its accuracy is not above 0",
                   "say how far the time may be from UTC, or leave it out");
  }
  if (hub != nullptr) {  // the main loop's recordings keep the clock
    hub->own_loop->post([main = hub, pair] { [[maybe_unused]] const auto noted = main->note_wall_clock(pair); });
    return {};
  }
  const auto known = std::find_if(plugged_.begin(), plugged_.end(),
                                  [&](const ClockSource& s) { return s.latest.source == pair.source; });
  if (known == plugged_.end()) {
    if (plugged_.size() == most_clock_sources)
      return refused(Errc::bad_argument, "there are 16 sources already", "use one name for each source");
    pair.occasion = "start";
    plugged_.push_back({pair, pair, pair.accuracy});
    record(plugged_.back(), pair);
    return {};
  }
  pair.occasion = known->recorded.accuracy.has_value() == pair.accuracy.has_value() ? "regular" : "sync";
  known->latest = pair;
  if (known->is_news(pair)) record(*known, pair);
  return {};
}

bool RuntimeCore::ClockSource::is_news(const ClockPair& pair) const noexcept {
  constexpr Duration most_drift = std::chrono::milliseconds{100};  // between regular pairs
  const Duration since = pair.monotonic - recorded.monotonic;
  if (since < least_between_pairs) return false;
  if (pair.accuracy.has_value() != recorded.accuracy.has_value()) return true;
  if (pair.accuracy && (since >= most_between_pairs || *pair.accuracy <= *best / 2)) return true;
  const Duration moved = std::chrono::abs((pair.realtime - recorded.realtime) - since);
  return moved > most_drift + pair.accuracy.value_or(Duration{0}) + recorded.accuracy.value_or(Duration{0});
}

void RuntimeCore::record(ClockSource& source, const ClockPair& pair) {
  const bool is_known = source.best && pair.accuracy;
  source.best = is_known ? std::min(source.best, pair.accuracy) : pair.accuracy;
  source.recorded = pair;
  source.latest = pair;
  for (Recorder* recorder : recorders) recorder->on_clock(pair);
}

std::vector<ClockPair> RuntimeCore::clock_pairs() {
  std::vector<ClockPair> pairs;
  for (const ClockSource& source : plugged_) pairs.push_back(source.latest);
  pairs.push_back(read_clock("start"));
  return pairs;
}

TopicCore* RuntimeCore::find_topic(std::string_view name) noexcept {
  const auto found = topic_by_name_.find(name);
  return found == topic_by_name_.end() ? nullptr : found->second;
}

TopicCore& RuntimeCore::find_or_make_topic(std::string_view name, PayloadType type) {
  if (TopicCore* existing = find_topic(name)) {
    const auto& have = existing->type;
    if ((have.description != nullptr) != (type.description != nullptr) ||
        (have.description == nullptr && have.type_key != type.type_key)) {
      throw SetupError({Errc::description_differs, "cannot use topic", std::string(name),
                        "it carries " + payload_name(have) + ", here " + payload_name(type) + " is meant",
                        "use one type a topic"});
    }
    if (have.description != nullptr && have.description != type.description) {
      if (!have.description->same_meaning(*type.description)) {
        std::string why = "it carries \"" + have.description->name() + "\", here \"" + type.description->name() +
                          "\" is meant";
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
  std::transform(lower.begin(), lower.end(), lower.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (const auto [other, is_new] = name_by_lower_case_.try_emplace(lower, name); !is_new) {
    throw SetupError({Errc::bad_name, "cannot make topic", std::string(name),
                      "topic " + other->second + " differs from it in case only", "choose another name"});
  }
  topics_.push_back(std::make_unique<TopicCore>(*this, std::string(name), std::move(type)));
  TopicCore& made = *topics_.back();
  topic_by_name_.emplace(made.name, &made);
  for (SubscriptionNode* node : patterns) {
    if (!topic_matches(node->pattern(), made.name)) continue;
    if (auto linked = made.link(*node); !linked) keep_report(node->loop(), node->name, std::move(linked).error());
  }
  for (Listener* listener : listeners) {
    if (auto taken = listener->on_topic(made); !taken)
      kept_.push_back({listener, nullptr, {}, std::move(taken).error()});
  }
  return made;
}

OriginCore& RuntimeCore::claim_origin(std::string_view name, TopicCore& topic) {
  if (name.empty() || name.size() > 200 ||
      std::any_of(name.begin(), name.end(), [](unsigned char c) { return c < ' '; })) {
    throw SetupError({Errc::bad_name, "cannot make sensor", "\"" + std::string(name) + "\"",
                      "a name has 1 to 200 characters and no control characters", "give it another `name`"});
  }
  receive_all();  // what another loop has published under the name comes first
  const auto refuse = [&](const std::string& why, const char* advice) {
    throw SetupError({Errc::busy, "cannot make sensor", std::string(name), why, advice});
  };
  const auto refuse_holder = [&](const RuntimeCore& holder) {
    refuse("there is one of that name already" + (&holder == this ? "" : " on loop " + holder.own_loop->config.name),
           "give each sensor a `name` of its own");
  };
  const auto refuse_topic = [&](const std::string& earlier) {
    refuse("earlier in this run it published on topic " + earlier, "choose another name or that topic");
  };
  RuntimeCore& all = hub != nullptr ? *hub : *this;
  bool is_new = false;
  OriginCore* origin = nullptr;
  if (!all.are_names_shared_) {
    origin = find_origin(name);
    if (origin != nullptr && origin->is_claimed) refuse_holder(*this);
    if (origin != nullptr && &origin->topic != &topic) refuse_topic(origin->topic.name);
    is_new = origin == nullptr;
    if (is_new) origin = &find_or_make_origin(name, topic);
  } else {
    const std::lock_guard lock(all.names_mutex_);
    Name& claim = all.names_[std::string(name)];
    if (claim.holder != nullptr) refuse_holder(*claim.holder);
    if (claim.left != nullptr && claim.left->topic != topic.name) refuse_topic(claim.left->topic);
    const OriginCore* known = find_origin(name);
    is_new = known == nullptr || known->is_mirror;
    origin = &find_or_make_origin(name, topic);
    if (is_new) origin->adopt(claim.left != nullptr ? claim.left->state : OriginCore::State{});
    claim.holder = this;
  }
  origin->is_claimed = true;
  if (is_new) {
    for (Listener* listener : listeners) listener->on_origin(*origin);
  }
  return *origin;
}

void RuntimeCore::share_names() {
  if (std::exchange(are_names_shared_, true)) return;
  for (const OriginCore& origin : origins_) {
    Name& claim = names_[origin.name];
    if (origin.is_claimed) {
      claim.holder = this;
    } else {
      claim.left = std::make_unique<Name::Left>(Name::Left{origin.topic.name, origin.state()});
    }
  }
}

void RuntimeCore::release(OriginCore& origin) noexcept {
  origin.is_claimed = false;
  RuntimeCore& all = hub != nullptr ? *hub : *this;
  if (!all.are_names_shared_) return;
  const std::lock_guard lock(all.names_mutex_);
  if (const auto found = all.names_.find(origin.name); found != all.names_.end()) release(found->first, found->second);
}

void RuntimeCore::release_all() noexcept {
  RuntimeCore& all = hub != nullptr ? *hub : *this;
  const std::lock_guard lock(all.names_mutex_);
  for (auto& [name, claim] : all.names_) {
    if (claim.holder == this) release(name, claim);
  }
}

void RuntimeCore::release(std::string_view name, Name& claim) noexcept try {
  claim.holder = nullptr;
  const OriginCore* origin = find_origin(name);
  if (claim.left == nullptr) claim.left = std::make_unique<Name::Left>(Name::Left{origin->topic.name, {}});
  claim.left->state = origin->state();
} catch (...) {  // out of memory: on another loop it begins anew
}

OriginCore* RuntimeCore::find_origin(std::string_view name) noexcept {
  const auto found = origins_.find(name);
  // Elements of a set are const for the sake of their key, the name, which is const in itself.
  return found == origins_.end() ? nullptr : const_cast<OriginCore*>(&*found);
}

OriginCore& RuntimeCore::find_or_make_origin(std::string_view name, TopicCore& topic) {
  if (OriginCore* known = find_origin(name)) return *known;
  auto& made = const_cast<OriginCore&>(
      *origins_.emplace(name, topic, static_cast<std::uint32_t>(topic.origins().size())).first);
  topic.origins().push_back(&made);
  return made;
}

OriginCore& RuntimeCore::program_origin(TopicCore& topic) {
  // One for each topic and loop: a sequence belongs to one topic.
  if (topic.program_origin == nullptr) {
    const std::string of_tier = hub != nullptr ? "@" + own_loop->config.name : "";
    topic.program_origin = &claim_origin("program:" + topic.name + of_tier, topic);
  }
  return *topic.program_origin;
}

SensorStatus status_of(const SensorEntry& sensor) {
  const OriginCore& origin = sensor.origin();
  return {origin.name,
          origin.topic.name,
          sensor.schedule_period(),
          sensor.is_active(),
          sensor.health(),
          std::string(sensor.reason()),
          origin.counts,
          sensor.is_open() ? sensor.loop()->config.name : std::string(),
          origin.first_due()};
}

constexpr std::uint32_t most_lines_under_way = 1000;  // from tiers to a main loop that does not take them

void RuntimeCore::log(LogLevel level, std::string_view object, std::string_view text, std::string_view error_id) {
  if (hub != nullptr && !on_log) {
    if (hub->lines_under_way_.fetch_add(1, std::memory_order_relaxed) >= most_lines_under_way) {
      hub->lines_under_way_.fetch_sub(1, std::memory_order_relaxed);
      hub->lines_dropped_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    hub->own_loop->post([hub = hub, level, object = std::string(object), text = std::string(text),
                         id = std::string(error_id)] {
      hub->lines_under_way_.fetch_sub(1, std::memory_order_relaxed);
      if (const auto dropped = hub->lines_dropped_.exchange(0, std::memory_order_relaxed)) {
        hub->log(LogLevel::warning, "log", std::to_string(dropped) + " lines of tiers were dropped: too many at once");
      }
      hub->log(level, object, text, id);
    });
  } else if (on_log) {
    on_log({level, event_time(clock_->monotonic()), object, text, error_id});
  } else if (level >= LogLevel::warning) {
    std::fprintf(stderr, "rtdata: %s: %.*s: %.*s\n", level == LogLevel::error ? "error" : "warning",
                 static_cast<int>(object.size()), object.data(), static_cast<int>(text.size()), text.data());
  }
}

void RuntimeCore::receive_all() {
  for (Bridge* bridge : inbound) bridge->receive();
}

void RuntimeCore::announce(Announcement announcement) {
  {
    const std::lock_guard lock(announced_mutex_);
    announced_.push_back(std::move(announcement));
  }
  has_announced_.store(true, std::memory_order_release);
}

void RuntimeCore::hear_announcements() {
  if (!has_announced_.exchange(false, std::memory_order_acquire)) return;
  std::vector<Announcement> heard;
  {
    const std::lock_guard lock(announced_mutex_);
    heard.swap(announced_);
  }
  for (Announcement& one : heard) one.bridge->hear(one);
}

void RuntimeCore::tell_of_cut_off(TopicCore& topic) {
  const SubscriptionNode* node = topic.first_subscriber();
  if (node == nullptr || topic.cut_off_from.empty()) return;
  Error error = cannot_cross(topic);
  error.where += ", which is published on loop " + std::exchange(topic.cut_off_from, {});
  keep_report(node->loop(), node->name, std::move(error));
}

void RuntimeCore::forget_announcements(const Bridge& of) {
  const std::lock_guard lock(announced_mutex_);
  std::erase_if(announced_, [&](const Announcement& one) { return one.bridge == &of; });
}

void RuntimeCore::turn_done() {
  for (Bridge* bridge : outbound) bridge->turn_done();
  report_kept();
}

void RuntimeCore::report_all_kept() {
  while (!kept_.empty()) {  // a report may bring others
    const Kept kept = std::move(kept_.front());
    kept_.erase(kept_.begin());
    if (kept.listener == nullptr) {
      report(kept.loop, kept.object, kept.error);
    } else if (std::find(listeners.begin(), listeners.end(), kept.listener) != listeners.end()) {
      kept.listener->on_refusal(kept.error);
    }
  }
}

void RuntimeCore::report(LoopCore* loop, std::string_view object, const Error& error) {
  constexpr std::size_t most_remembered = 256;
  const MonotonicTime now = clock_->monotonic();
  for (Repeat& repeat : repeats_) {
    if (repeat.object != object || repeat.error.code != error.code) continue;
    if (now - repeat.last_written < std::chrono::seconds{1}) {
      if (repeat.held_back++ == 0 && loop != nullptr)
        loop->flush_repeats_at(repeat.last_written + std::chrono::seconds{1});
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

namespace {

/// What of it fits, whole characters only.
template <std::size_t N>
text<N> fitting(std::string_view content) {
  std::size_t size = std::min(content.size(), N);
  while (size < content.size() && size > 0 && (static_cast<unsigned char>(content[size]) & 0xc0U) == 0x80U) --size;
  return text<N>(content.substr(0, size));
}

}  // namespace

void RuntimeCore::health_changed(std::string_view kind, std::string_view name, Health health,
                                 std::string_view reason) noexcept try {
  const HealthChange change{fitting<16>(kind), fitting<200>(name), health, fitting<96>(reason)};
  const Time time = event_time(clock_->monotonic());
  for (Listener* listener : listeners) listener->on_health(time, change);
  publish_from_program(topic(health_topic, payload_type<HealthChange>()), &change);
} catch (...) {  // out of memory, or the program has taken the name for another topic: health() of the object tells it
}

void RuntimeCore::flush_repeats(Repeats which) {
  const MonotonicTime now = clock_->monotonic();
  for (std::size_t i = 0; i < repeats_.size(); ++i) {
    if (repeats_[i].held_back == 0 ||
        (which == Repeats::old && now - repeats_[i].last_written < std::chrono::seconds{1})) {
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
  if (loop == nullptr) loop = own_loop;
  if (loop != nullptr && loop->on_error) {
    try {  // an error met in it goes to the log, rather than round in a circle
      loop->on_error({object, error, count});
    } catch (...) {
      log(LogLevel::error, object, error.text() + " (and the handler of errors threw)", error.id());
    }
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
void Runtime::on_log(Callback<void(const LogRecord&)> handler) { core_->on_log.set(std::move(handler)); }

Result<void> Runtime::note_wall_clock(const ClockPair& pair) { return core_->note_wall_clock(pair); }

void Runtime::note_place(std::string object, std::string place) { core_->places[std::move(object)] = std::move(place); }

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

std::vector<LoopStatus> Runtime::loops() const {
  const auto processor_time = [](pthread_t thread) {
    clockid_t clock{};
    timespec spent{};
    if (::pthread_getcpuclockid(thread, &clock) != 0 || ::clock_gettime(clock, &spent) != 0) return Duration{0};
    return Duration{std::chrono::seconds{spent.tv_sec} + std::chrono::nanoseconds{spent.tv_nsec}};
  };
  std::vector<LoopStatus> all;
  if (const detail::LoopCore* loop = core_->own_loop) {
    all.push_back({loop->config.name, core_->hub != nullptr, loop->is_running(), current_scheduling(),
                   processor_time(::pthread_self())});
  }
  for (detail::TierCore* tier : core_->tiers) {
    all.push_back({tier->config.name, true, tier->is_running(), tier->scheduling,
                   tier->is_running() ? processor_time(tier->native_thread()) : Duration{0}, tier->warnings});
  }
  return all;
}

bool Runtime::balances() const {
  if (!core_->unknown_end.empty()) return false;  // a tier hung: its account is not known
  for (const detail::OriginCore& origin : core_->origins()) {
    if (!origin.counts.balances() || (origin.counts.published != origin.sequence && !origin.is_mirror)) return false;
  }
  for (const SinkStatus& sink : sinks()) {
    if (!sink.counts.balances()) return false;
  }
  for (const auto& topic : core_->topics()) {
    if (!topic->subscription_counts().balances()) return false;
  }
  return core_->tiers_were_balanced && std::all_of(core_->tiers.begin(), core_->tiers.end(),
                                                   [](const detail::TierCore* tier) { return tier->balances(); });
}

bool Runtime::has_loss() const {
  if (core_->lost_between_loops > 0) return true;
  for (const detail::OriginCore& origin : core_->origins()) {
    if (origin.counts.has_loss()) return true;
  }
  for (const SinkStatus& sink : sinks()) {
    if (sink.counts.all_dropped() > 0) return true;
  }
  if (core_->hub != nullptr) {
    for (const auto& topic : core_->topics()) {
      if (topic->subscription_counts().dropped > 0) return true;
    }
  }
  return core_->tiers_had_loss || std::any_of(core_->tiers.begin(), core_->tiers.end(),
                                              [](const detail::TierCore* tier) { return tier->has_loss(); });
}

}  // namespace rtdata
