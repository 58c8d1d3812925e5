#include "loop/runtime/runtime_core.hpp"

#include <algorithm>
#include <utility>

#include "data/first_line.hpp"
#include "data/name.hpp"
#include "loop/core/fatal.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/tier/bridge.hpp"
#include "loop/tier/tier_core.hpp"

namespace rtdata::detail {

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
    : face(face_), config(std::move(config_)), clock_log(*this, config.clock), reports(*this, config.secrets) {
  constexpr std::size_t most_ring_events = std::size_t{1} << 24;
  if (config.ring_events > most_ring_events) {
    throw SetupError({Errc::bad_argument, "cannot make a runtime", quoted_name(config.name),
                      "rings of " + std::to_string(config.ring_events) + " events are too large",
                      "give `ring_events` " + std::to_string(most_ring_events) + " or less"});
  }
}

RuntimeCore::~RuntimeCore() {
  if (own_loop != nullptr || calling > 0) {
    end_program(
        {Errc::busy, "a runtime is destroyed too early", quoted_name(config.name),
         own_loop != nullptr ? "loop " + own_loop->config.name + " still uses it" : "this is one of its callbacks",
         "let it outlive its loop, and return from its callbacks first"});
  }
  // Handles have pointers to topics and origins; the loops, which close the handles, were destroyed before.
}

const std::string& RuntimeCore::run_uuid() {
  if (run_uuid_.empty()) run_uuid_ = first_line("/proc/sys/kernel/random/uuid");
  return run_uuid_;
}

std::string RuntimeCore::uuid_for_recording() {
  return recorded_.emplace_back(recorded_.empty() ? run_uuid() : first_line("/proc/sys/kernel/random/uuid"));
}

bool RuntimeCore::has_recorded(const std::string& uuid) const {
  return std::find(recorded_.begin(), recorded_.end(), uuid) != recorded_.end();
}

void RuntimeCore::attach(LoopCore& loop) {
  reports.attach(loop);
  own_loop = &loop;
}

void RuntimeCore::forget(LoopCore& loop) noexcept {
  for (const auto& topic : topics_) topic->abandon();
  own_loop = nullptr;
  reports.detach(loop);
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
                        "the topic carries " + payload_name(have) + ", but " + payload_name(type) + " is meant here",
                        "use one type per topic"});
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
  topics_.push_back(std::make_unique<TopicCore>(*this, std::string(name), std::move(type)));
  TopicCore& made = *topics_.back();
  topic_by_name_.emplace(made.name, &made);
  for (SubscriptionNode* node : patterns) {
    if (!topic_matches(node->pattern(), made.name)) continue;
    if (auto linked = made.link(*node); !linked) keep_report(node->loop(), node->name, std::move(linked).error());
  }
  for (Listener* listener : listeners) {
    if (auto taken = listener->on_topic(made); !taken) reports.keep_refusal(*listener, std::move(taken).error());
  }
  return made;
}

OriginCore* RuntimeCore::find_origin(std::string_view name) noexcept {
  const auto found = origins_.find(name);
  // Elements of a set are const to protect the key; here the key, the name, is itself const.
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
    topic.program_origin = &names.claim("program:" + topic.name + of_tier, topic, OriginCore::Supply::feed);
    topic.program_origin->counts.lost_is_known = true;  // nothing before it can lose events
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
  for (Bridge* bridge : inbound) bridge->receiving.receive();
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
  for (Bridge* bridge : outbound) bridge->sending.wake();
}

void RuntimeCore::turn_done() {
  for (Bridge* bridge : outbound) bridge->sending.turn_done();
  report_kept();
}

}  // namespace rtdata::detail
