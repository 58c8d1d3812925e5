#include "loop/runtime_core.hpp"

#include <pthread.h>
#include <time.h>

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <utility>

#include "data/rounded_time.hpp"
#include "loop/bridge.hpp"
#include "loop/fatal.hpp"
#include "loop/loop_core.hpp"
#include "loop/name.hpp"
#include "loop/tier_core.hpp"

namespace rtdata {

std::string to_string(const Outages& outages) {
  const auto time = [](Duration duration) {
    const auto s = std::chrono::duration_cast<std::chrono::seconds>(duration).count();
    const auto parts = [](std::int64_t large, const char* unit, std::int64_t small, const char* smaller) {
      const std::string text = std::to_string(large) + " " + unit;
      return small == 0 ? text : text + " " + std::to_string(small) + " " + smaller;
    };
    if (s < 60) return detail::rounded_time(static_cast<double>(duration.count()));
    if (s < 3600) return parts(s / 60, "min", s % 60, "s");
    if (s < 86400) return parts(s / 3600, "h", s % 3600 / 60, "min");
    return parts(s / 86400, "d", s % 86400 / 3600, "h");
  };
  return std::to_string(outages.number) + (outages.number == 1 ? " outage of " : " outages of ") +
         (outages.is_at_most ? "at most " : "") + time(outages.time) + (outages.number > 1 ? " together" : "");
}

std::string_view name_of(Gap::Kind kind) noexcept {
  switch (kind) {
    case Gap::Kind::missed:
      return "missed";
    case Gap::Kind::failed:
      return "failed";
    case Gap::Kind::disconnected:
      return "disconnected";
    case Gap::Kind::silent:
      return "silent";
    case Gap::Kind::joined:
      return "joined";
  }
  return "?";
}

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

RuntimeCore::RuntimeCore(Runtime& face_, Runtime::Config config_)
    : face(face_), config(std::move(config_)), secrets(config.secrets) {
  constexpr std::size_t most_ring_events = std::size_t{1} << 24;
  if (config.ring_events > most_ring_events) {
    throw SetupError({Errc::bad_argument, "cannot make a runtime", quoted_name(config.name),
                      "rings of " + std::to_string(config.ring_events) + " events are too large",
                      "give `ring_events` " + std::to_string(most_ring_events) + " or less"});
  }
  use_clock(config.clock != nullptr ? *config.clock : system_clock_);
}

RuntimeCore::~RuntimeCore() {
  if (own_loop != nullptr || calling > 0) {
    end_program(
        {Errc::busy, "a runtime is destroyed too early", quoted_name(config.name),
         own_loop != nullptr ? "loop " + own_loop->config.name + " still uses it" : "this is one of its callbacks",
         "let it outlive its loop, and return from its callbacks first"});
  }
  // Handles hold pointers into topics and origins; the loops, which close them, are gone by now.
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

OriginCore& RuntimeCore::claim_origin(std::string_view name, TopicCore& topic, OriginCore::Supply supply) {
  if (!is_name(name)) {
    throw SetupError({Errc::bad_name, "cannot make sensor", quoted_name(name), name_rule, "give it another `name`"});
  }
  receive_all();  // what another loop has published under the name comes first; here, so that under the lock little is left
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
  const auto check_supply = [&](OriginCore::Supply earlier, const SensorCounts& counts) {
    const bool is_unused = !counts.has_schedule && counts.received == 0;
    if (is_unused || earlier == OriginCore::Supply::none || earlier == supply) return;
    refuse(earlier == OriginCore::Supply::feed ? "earlier in this run it was fed, here it is to have a schedule"
                                               : "earlier in this run it had a schedule, here it is to be fed",
           "choose another name: the two are accounted for in different ways");
  };
  RuntimeCore& all = hub != nullptr ? *hub : *this;
  bool is_new = false;
  OriginCore* origin = nullptr;
  if (!all.are_names_shared_) {
    origin = find_origin(name);
    if (origin != nullptr && origin->is_claimed) refuse_holder(*this);
    if (origin != nullptr && &origin->topic != &topic) refuse_topic(origin->topic.name);
    if (origin != nullptr) check_supply(origin->supply, origin->counts);
    is_new = origin == nullptr || origin->supply == OriginCore::Supply::none;
    origin = &find_or_make_origin(name, topic);
  } else {
    const std::lock_guard lock(all.names_mutex_);
    Name& claim = all.names_[std::string(name)];
    if (claim.holder != nullptr) refuse_holder(*claim.holder);
    receive_all();  // also what the last holder published since then, before it let go
    if (claim.left != nullptr && claim.left->topic != topic.name) refuse_topic(claim.left->topic);
    if (claim.left != nullptr) check_supply(claim.left->state.supply, claim.left->state.counts);
    const OriginCore* known = find_origin(name);
    is_new = known == nullptr || known->is_mirror || known->supply == OriginCore::Supply::none;
    origin = &find_or_make_origin(name, topic);
    if (is_new) origin->adopt(claim.left != nullptr ? claim.left->state : OriginCore::State{});
    claim.holder = this;
  }
  origin->is_claimed = true;
  origin->supply = supply;
  try {
    topic.expect(*origin);  // which may call user code: not under the lock
    for (std::size_t i = 0; is_new && i < listeners.size(); ++i) listeners[i]->on_origin(*origin);
  } catch (...) {  // no memory: as if nobody had asked
    origin->supply = OriginCore::Supply::none;
    release(*origin);
    throw;
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
  send_now();  // before whoever takes the name over sends
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
  OriginCore* origin = find_origin(name);
  if (origin == nullptr) {
    auto& of_topic = topic.origins();
    if (of_topic.size() == of_topic.capacity()) of_topic.reserve(2 * of_topic.size() + 1);
    origin = const_cast<OriginCore*>(
        &*origins_.emplace(name, topic, static_cast<std::uint32_t>(of_topic.size())).first);
    of_topic.push_back(origin);
  }
  return *origin;
}

OriginCore& RuntimeCore::program_origin(TopicCore& topic) {
  // One for each topic and loop: a sequence belongs to one topic.
  if (topic.program_origin == nullptr) {
    const std::string of_tier = hub != nullptr ? "@" + own_loop->config.name : "";
    topic.program_origin = &claim_origin("program:" + topic.name + of_tier, topic, OriginCore::Supply::feed);
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
          origin.first_due(),
          origin.outages(origin.topic.runtime().event_now())};
}

void RuntimeCore::receive_all() {
  for (Bridge* bridge : inbound) bridge->receive();
}

std::string RuntimeCore::hear_tiers_out(Duration at_most) {
  constexpr Duration turn = std::chrono::milliseconds{1};  // of one tier: one that hangs takes no other's time
  const MonotonicTime end = later(own_loop->now(), at_most);
  const auto left = [&] { return std::max(end - own_loop->now(), Duration{0}); };
  std::vector<TierCore*> silent;
  std::uint64_t known_names = 0;
  do {
    receive_all();
    known_names = names_taken_over;
    for (TierCore* tier : tiers) tier->ask_account();
    silent = tiers;
    do {
      std::erase_if(silent, [&](TierCore* tier) { return tier->hear_out(std::min(left(), turn)); });
    } while (!silent.empty() && left() > Duration{0});
    // To keep the order of what two tiers publish by one name, more was taken than the tiers had told of: once more.
  } while (names_taken_over != known_names && left() > Duration{0});
  std::string unknown;
  for (TierCore* tier : silent) tier->add_unknown(unknown);
  if (unknown.empty() && names_taken_over != known_names) unknown = "names went from tier to tier all the time";
  return unknown;
}

std::string RuntimeCore::unknown_of_tiers() const {
  std::string unknown;
  for (const TierCore* tier : tiers) {
    if (tier->is_known()) continue;
    unknown += (unknown.empty() ? "" : "; ") + tier->unknown();
  }
  return unknown;
}

RuntimeCore::Wanted::Wanted(RuntimeCore& runtime, const std::vector<std::string>& patterns)
    : runtime_(runtime), patterns_(patterns) {
  runtime_.wanted_.push_back(&patterns_);
  for (const auto& topic : runtime_.topics()) topic->followers_changed();
}

RuntimeCore::Wanted::~Wanted() {
  std::erase(runtime_.wanted_, &patterns_);
  for (const auto& topic : runtime_.topics()) topic->followers_changed();
}

bool RuntimeCore::is_wanted(std::string_view topic) const noexcept {
  return std::any_of(wanted_.begin(), wanted_.end(), [&](const std::vector<std::string>* wanted) {
    return std::any_of(wanted->begin(), wanted->end(),
                       [&](const std::string& pattern) { return topic_matches(pattern, topic); });
  });
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

std::string RuntimeCore::user_of_loop() const {
  return tiers.empty() ? std::string() : "tier " + tiers.front()->config.name;
}

void RuntimeCore::start_tiers() {
  for (TierCore* tier : tiers) tier->start_first();
}

void RuntimeCore::start_tiers_in_turn() noexcept {
  try {
    start_tiers();
  } catch (const SetupError& e) {
    report(own_loop, "loop " + own_loop->config.name, e.error());
  }
}

void RuntimeCore::send_now() noexcept {
  for (Bridge* bridge : outbound) bridge->wake();
}

void RuntimeCore::turn_done() {
  for (Bridge* bridge : outbound) bridge->turn_done();
  report_kept();
}

}  // namespace detail

Runtime::Runtime() : Runtime(Config{}) {}
Runtime::Runtime(Config config) : core_(std::make_unique<detail::RuntimeCore>(*this, std::move(config))) {}
Runtime::~Runtime() = default;

const Runtime::Config& Runtime::config() const noexcept { return core_->config; }
void Runtime::on_log(Callback<void(const LogRecord&)> handler) {
  if (core_->own_loop != nullptr) {
    core_->own_loop->check_thread("cannot set on_log", "runtime");
    core_->own_loop->check_not_ending("cannot set on_log");
  }
  core_->on_log.set(std::move(handler));
}

Result<void> Runtime::note_wall_clock(const ClockPair& pair) {
  if (core_->own_loop != nullptr && core_->own_loop->is_run_by_another_thread()) {
    return Error{Errc::busy, "cannot note the time of day", "source \"" + pair.source + "\"",
                 "its loop runs on another thread, or this is a call on a lane",
                 "post a function to the loop that does it there"};
  }
  return core_->note_wall_clock(pair);
}

void Runtime::note_place(std::string object, std::string place) {
  if (core_->own_loop != nullptr) core_->own_loop->check_thread("cannot note a place", object);
  core_->places[std::move(object)] = std::move(place);
}

std::vector<SensorStatus> Runtime::sensors() const {
  std::vector<SensorStatus> all;
  for (const auto* sensor : core_->sensors.all()) all.push_back(detail::status_of(*sensor));
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
  if (detail::LoopCore* loop = core_->own_loop) {
    all.push_back({loop->config.name,
                   core_->hub != nullptr,
                   loop->is_running(),
                   current_scheduling(),
                   processor_time(::pthread_self()),
                   {},
                   loop->posts.counts()});
  }
  for (detail::TierCore* tier : core_->tiers) {
    all.push_back({tier->config.name, true, tier->is_running(), tier->scheduling,
                   tier->is_running() ? processor_time(tier->native_thread()) : Duration{0}, tier->warnings,
                   tier->loop.core().posts.counts()});
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
  return core_->tiers_were_balanced &&
         std::all_of(core_->tiers.begin(), core_->tiers.end(), [](detail::TierCore* tier) { return tier->balances(); });
}

bool Runtime::has_loss() const {
  if (core_->lost_between_loops > 0) return true;
  for (const detail::OriginCore& origin : core_->origins()) {
    if (origin.counts.has_loss() || origin.had_outage()) return true;
  }
  for (const SinkStatus& sink : sinks()) {
    if (sink.counts.all_dropped() > 0) return true;
  }
  if (core_->hub != nullptr) {
    for (const auto& topic : core_->topics()) {
      if (topic->subscription_counts().dropped > 0) return true;
    }
  }
  return core_->tiers_had_loss ||
         std::any_of(core_->tiers.begin(), core_->tiers.end(), [](detail::TierCore* tier) { return tier->has_loss(); });
}

}  // namespace rtdata
