#include <algorithm>
#include <utility>

#include "data/field_map.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/gaps.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata {
namespace detail {
namespace {

class ViewSubscription final : public SubscriptionNode {
 public:
  ViewSubscription(LoopCore& loop, std::string_view pattern, Callback<void(const EventView&)> handler)
      : SubscriptionNode(loop, pattern), handler_(std::move(handler)) {
    if (!handler_) refuse_empty("cannot subscribe", pattern);
  }
  Delivered deliver(const EventRun& run, const void*) override {
    return for_each(run, [&](const std::byte* slot) { handler_(view_of(run.topic, slot)); });
  }
  Result<std::shared_ptr<const void>> accept(const TopicCore& topic) override {
    if (topic.type.description != nullptr) return std::shared_ptr<const void>{};
    return Error{Errc::description_differs, "cannot subscribe", topic.name, "its payload has no description",
                 "subscribe with its C++ type, or describe it"};
  }

 private:
  void drop_callbacks() noexcept override { handler_.reset(); }
  Callback<void(const EventView&)> handler_;
};

}  // namespace

SubscriptionNode::SubscriptionNode(LoopCore& loop, std::string_view pattern)
    : Node(loop), name("handler of " + std::string(pattern)), pattern_(pattern), runtime_(&loop.runtime) {}

template <class Function>
void SubscriptionNode::for_each_topic(const Function& function) const {
  RuntimeCore& runtime = loop()->runtime;
  if (!is_topic_name(pattern_)) {
    for (const auto& topic : runtime.topics()) function(*topic);
  } else if (TopicCore* topic = runtime.find_topic(pattern_)) {
    function(*topic);
  }
}

void SubscriptionNode::on_close() noexcept {
  RuntimeCore& runtime = loop()->runtime;
  std::erase(runtime.patterns, this);
  for_each_topic([this](TopicCore& topic) { topic.unlink(*this); });
}

bool SubscriptionNode::report_times(CallbackStatus& status) const {
  status.name = name;
  status.times = times;
  return true;
}

void SubscriptionNode::report_exception(std::string_view what) noexcept {
  try {
    runtime_->report(loop(), name,
                     {Errc::handler_threw, "a handler threw", "", std::string(what), "the handler is still called"});
  } catch (...) {  // the report itself failed
  }
}

SubscriptionCounts SubscriptionNode::counts() const noexcept {
  SubscriptionCounts sum;
  for_each_topic([&](const TopicCore& topic) { sum.add(topic.counts_of(*this)); });
  return sum;
}

EventView view_of(const TopicCore& topic, const std::byte* slot) {
  return EventView(topic.name, *reinterpret_cast<const EventHeader*>(slot), *topic.type.description,
                   {slot + topic.payload_offset, topic.type.size});
}

void apply_field_map(const void* map, const std::byte* from, std::byte* to) {
  static_cast<const FieldMap*>(map)->apply(from, to);
}

Result<std::shared_ptr<const void>> make_field_map(const TopicCore& topic, const PayloadType& wanted) {
  const auto& have = topic.type;
  if (have.description == nullptr || wanted.description == nullptr) {
    if (have.type_key == wanted.type_key) return std::shared_ptr<const void>{};
    return Error{Errc::description_differs, "cannot subscribe", topic.name,
                 "the topic carries " + payload_name(have) + ", and the handler takes " + payload_name(wanted),
                 "use the type that the topic was made with"};
  }
  if (have.description == wanted.description) return std::shared_ptr<const void>{};
  auto map = map_fields(*have.description, *wanted.description);
  if (!map) {
    return Error{
        Errc::description_differs, "cannot subscribe", topic.name,
        "it carries " + payload_name(have) + ", the handler takes " + payload_name(wanted) + ": " + map.error().why,
        "subscribe with the fields that the topic has"};
  }
  return map->is_identity ? std::shared_ptr<const void>{} : std::make_shared<const FieldMap>(*std::move(map));
}

void attach(LoopCore& loop, SubscriptionNode& node, TopicCore* only) {
  RuntimeCore& runtime = loop.runtime;
  runtime.receive();  // earlier events are not for the new subscription
  if (only != nullptr) {
    const auto hub_of = [](RuntimeCore& core) { return core.hub != nullptr ? core.hub : &core; };
    if (&only->runtime() != &runtime &&
        hub_of(only->runtime()) == hub_of(runtime)) {  // the topic's mirror on this tier
      if (only->type.move_construct != nullptr) throw SetupError(cannot_cross(*only));
      only = &runtime.topic(only->name, only->type);
    }
    if (&only->runtime() != &runtime) {
      throw SetupError({Errc::bad_argument, "cannot subscribe", only->name,
                        "the topic belongs to another runtime than the loop", "give both loops one runtime"});
    }
    if (auto linked = only->link(node); !linked) throw SetupError(linked.error());
    runtime.exchange.report_cut_off(*only);
    runtime.report_kept();
    return;
  }
  if (!is_topic_pattern(node.pattern())) {
    throw SetupError({Errc::bad_name, "cannot subscribe", "\"" + node.pattern() + "\"", "not a topic or pattern",
                      "levels are joined by /, + stands for one level, # at the end for all below"});
  }
  // Gaps are published once their topic is there.
  if (node.pattern() == gap_topic && runtime.hub == nullptr) runtime.topic(gap_topic, payload_type<GapEvent>());
  std::vector<Error> refused;  // reported at the end, because a report may run user code
  for (const auto& topic : runtime.topics()) {
    if (!topic_matches(node.pattern(), topic->name)) continue;
    if (auto linked = topic->link(node); !linked) {
      if (topic->name == node.pattern()) throw SetupError(linked.error());
      refused.push_back(std::move(linked).error());
    }
    runtime.exchange.report_cut_off(*topic);
  }
  runtime.patterns.push_back(&node);
  const std::string name = node.name;
  for (const Error& error : refused) runtime.report(&loop, name, error);
  runtime.report_kept();
}

TopicCore& find_or_make_topic(Loop& loop, std::string_view name, PayloadType type) {
  loop.core().check_thread("cannot make topic", name);
  return loop.core().runtime.topic(name, std::move(type));
}

const std::string& topic_name(const TopicCore& topic) noexcept { return topic.name; }

void publish_from_program(TopicCore& topic, const void* payload) {
  RuntimeCore& runtime = topic.runtime();
  if (runtime.own_loop != nullptr) runtime.own_loop->check_thread("cannot publish", topic.name);
  OriginCore& origin = runtime.program_origin(topic);
  ++origin.counts.received;
  ++origin.counts.published;
  topic.publish(origin, runtime.event_time(runtime.clock().monotonic()), const_cast<void*>(payload));
}

}  // namespace detail

SubscriptionCounts Subscription::counts() const noexcept {
  return is_open() ? static_cast<detail::SubscriptionNode*>(node())->counts() : SubscriptionCounts{};
}
CallbackTimes Subscription::times() const noexcept {
  return is_open() ? static_cast<detail::SubscriptionNode*>(node())->times : CallbackTimes{};
}
void Subscription::set_name(std::string name) {
  if (!is_open()) return;
  node()->loop()->check_thread("cannot name", name);
  node()->loop()->nodes.rename(static_cast<detail::SubscriptionNode*>(node())->name, std::move(name));
}

Subscription Loop::subscribe(std::string_view pattern, Callback<void(const EventView&)> handler) {
  auto* node = new detail::ViewSubscription(core(), pattern, std::move(handler));
  Subscription subscription(node);
  detail::attach(core(), *node, nullptr);
  return subscription;
}

}  // namespace rtdata
