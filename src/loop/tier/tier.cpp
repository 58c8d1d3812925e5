#include "rtdata/loop/tier.hpp"

#include <pthread.h>
#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <exception>

#include "data/name.hpp"
#include "loop/core/fatal.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/core/no_thread.hpp"
#include "loop/core/signals_blocked.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/bridge.hpp"
#include "loop/tier/tier_core.hpp"

namespace rtdata {
namespace detail {
namespace {

constexpr std::size_t least_ring_bytes = 1024;
constexpr Duration longest_spin = std::chrono::milliseconds{10};

Runtime::Config runtime_config(Loop& main) {
  Runtime::Config config = main.runtime().config();
  config.configuration.clear();
  if (ManualClock* manual = main.core().manual_clock()) config.clock = manual;
  return config;
}

Loop::Config loop_config(const Tier::Config& tier) {
  return {.name = tier.name,
          .delivery_budget = tier.delivery_budget,
          .hold_limit = tier.hold_limit,
          .phase_grid = tier.phase_grid,
          .spin = tier.spin,
          .timer_slack = tier.timer_slack};
}

const Tier::Config& checked(Loop& main, const Tier::Config& config) {
  const auto refuse = [&](Errc code, std::string why, std::string what_to_do) {
    throw SetupError({code, "cannot make tier", quoted_name(config.name), std::move(why), std::move(what_to_do)});
  };
  const RuntimeCore& hub = main.core().runtime;
  if (hub.hub != nullptr) refuse(Errc::bad_argument, "its main loop belongs to a tier itself", "give it the main loop");
  if (!is_name(config.name)) refuse(Errc::bad_name, name_rule, "give it another `name`");
  if (config.name == main.config().name)
    refuse(Errc::bad_argument, "the main loop has that name", "give it a `name` of its own");
  for (TierCore* tier : hub.tiers) {
    if (tier->config.name == config.name)
      refuse(Errc::bad_argument, "there is one of that name already", "give each tier a `name` of its own");
    if (tier->is_running())
      refuse(Errc::busy, "tier " + tier->config.name + " runs already", "make all tiers before the main loop runs");
  }
  const PriorityRange range = priority_range(config.policy);
  if (config.priority < range.lowest || config.priority > range.highest) {
    refuse(Errc::bad_argument,
           "priority " + std::to_string(config.priority) + " does not go with policy " +
               std::string(name_of(config.policy)),
           "use " + std::to_string(range.lowest) + " to " + std::to_string(range.highest));
  }
  if (config.ring_bytes < least_ring_bytes) {
    refuse(Errc::bad_argument, "rings of " + std::to_string(config.ring_bytes) + " bytes have no room for anything",
           "give `ring_bytes` " + std::to_string(least_ring_bytes) + " or more");
  }
  if (config.spin < Duration{0} || config.spin > longest_spin) {
    refuse(Errc::bad_argument, "the tier would spin for " + to_string(config.spin) + " before each deadline",
           "give `spin` 0 s to " + to_string(longest_spin));
  }
  for (const int cpu : config.cpus) {
    if (cpu < 0 || cpu >= CPU_SETSIZE)
      refuse(Errc::bad_argument, "there is no processor " + std::to_string(cpu), "count from 0");
  }
  return config;
}

/// Puts a tier's runtime below that of the main loop.
Runtime& below(Loop& main, Runtime& runtime) {
  runtime.core().hub = &main.core().runtime;
  runtime.core().clock_log.share_line(main.core().runtime.clock_log);
  return runtime;
}

}  // namespace

TierCore::TierCore(Loop& main_, Tier::Config config_)
    : config(checked(main_, config_)),
      main(main_),
      runtime(runtime_config(main_)),
      loop(below(main_, runtime), loop_config(config)) {
  make_bridges();
  main.core().runtime.tiers.push_back(this);
}

void TierCore::make_bridges() {
  // Processes announcements of the others before the new tier gets any.
  main.core().runtime.receive_all();
  for (TierCore* tier : main.core().runtime.tiers) tier->runtime.core().receive_all();
  const auto connect = [&](LoopCore& other) {
    bridges_.push_back(std::make_unique<Bridge>(loop.core(), other, config.ring_bytes));
    bridges_.push_back(std::make_unique<Bridge>(other, loop.core(), config.ring_bytes));
  };
  connect(main.core());
  for (TierCore* tier : main.core().runtime.tiers) connect(tier->loop.core());
}

TierCore::~TierCore() {
  // Removes bridges to other tiers while neither side turns.
  const auto tiers = main.core().runtime.tiers;
  std::vector<TierCore*> interrupted;
  for (TierCore* tier : tiers) {
    if (tier == this || !tier->is_running()) continue;
    tier->stop();
    interrupted.push_back(tier);
  }
  stop();
  for (Bridge* bridge : runtime.core().outbound) bridge->hand_over();  // there is room for what the end brings
  loop.core().close_nodes();
  runtime.core().names.release_all();
  main.core().runtime.exchange.tiers_were_balanced &= runtime.balances();
  main.core().runtime.exchange.tiers_had_loss |= runtime.has_loss();
  for (Bridge* bridge : runtime.core().outbound) bridge->finish();
  for (const TierCore* tier : tiers) {
    if (tier == this) continue;
    auto& theirs = const_cast<TierCore*>(tier)->bridges_;
    std::erase_if(theirs, [this](const auto& bridge) {
      return &bridge->from() == &loop.core() || &bridge->to() == &loop.core();
    });
  }
  bridges_.clear();
  std::erase(main.core().runtime.tiers, this);
  for (const auto& drain : drains_) main.post([drain] { end(*drain); });
  for (TierCore* tier : interrupted) tier->start_again();
}

void TierCore::start_again() noexcept {
  try {
    start();
  } catch (const SetupError& error) {
    main.core().runtime.log(LogLevel::error, "tier " + config.name, error.error().text(), error.error().id());
  }
}

void TierCore::start() {
  if (is_running()) return;
  was_started_ = true;
  quit_.store(false, std::memory_order_relaxed);
  ended_.clear();
  warnings.clear();
  loop.core().note_turning();
  loop.core().ref();
  main.core().ref();
  ::sched_getaffinity(0, sizeof(cpu_set_t), &loop.core().lanes.processors.emplace());
  const SignalsBlocked for_the_tier;
  VirtualThreads* const threads = main.core().virtual_threads();  // null in real time
  if (threads != nullptr) threads->add(virtual_thread_);
  Latch is_set_up;  // not std::binary_semaphore: see lane.cpp
  try {
    thread_ = std::thread([this, threads, &is_set_up] {
      if (threads != nullptr) threads->begin(virtual_thread_);
      loop.core().bind_to_this_thread();
      if (threads == nullptr) set_up_thread();
      is_set_up.set();
      run();
      loop.core().unbind();
      ended_.set();
      if (threads != nullptr) threads->end(virtual_thread_);
    });
    main.core().wait_for(is_set_up, Duration::max());
  } catch (const std::system_error&) {
    if (threads != nullptr) threads->remove(virtual_thread_);
    loop.core().unref();
    main.core().unref();
    throw SetupError(no_thread("cannot start tier", config.name));
  }
}

void TierCore::run() {
  while (!quit_.load(std::memory_order_acquire))
    loop.run();  // a callback may have stopped the loop, but a tier ends with its main loop
}

void TierCore::check_may_end() noexcept {
  if (!may_only_ask()) {
    if (!is_running()) loop.core().check_may_end();
    return;
  }
  end_program({Errc::busy, "a tier is destroyed where it may not be", "tier " + config.name,
               "it is destroyed on another thread than its main loop's, or within a call of a sink's writer",
               "destroy it on its main loop"});
}

void TierCore::stop() noexcept {
  constexpr Duration patience = std::chrono::seconds{5};
  if (stop_within(patience) || may_only_ask()) return;
  main.core().runtime.log(
      LogLevel::error, "tier " + config.name,
      "is waited for: " + where() + " has not returned since it was told to stop, " + to_string(patience) + " ago",
      id(Errc::not_turning));
  while (!stop_within(std::chrono::hours{1})) {
  }
}

std::string TierCore::where() {
  std::string name = loop.core().nodes.doing();
  return name.empty() ? "a callback" : name;
}

bool TierCore::may_only_ask() noexcept { return is_on_its_thread() || main.core().is_run_by_another_thread(); }

bool TierCore::stop_within(Duration at_most) noexcept {
  const bool only_asks = may_only_ask();  // its thread may have begun before `start` has returned
  if (!only_asks && !is_running()) return true;
  quit_.store(true, std::memory_order_release);
  loop.stop();
  if (only_asks || !main.core().wait_for(ended_, at_most)) return false;
  join();
  return true;
}

bool TierCore::is_running() noexcept {
  if (thread_.joinable() && ended_.is_set()) join();  // it ended after it was given up
  return thread_.joinable();
}

void TierCore::join() noexcept {
  thread_.join();
  if (latency_fd_ >= 0) ::close(std::exchange(latency_fd_, -1));
  loop.core().unref();
  main.core().unref();
  loop.core().forget_stop();
  scheduling = {};
  *unknown_ = {};  // it can be asked here
  const auto waits = [](const auto& drain) { return static_cast<bool>(drain->done); };
  if (std::none_of(drains_.begin(), drains_.end(), waits)) return;
  main.core().call_own("tier " + config.name, [&] {  // no memory: the drain notices it at its deadline
    main.post([this, &hub = main.core().runtime] {
      if (std::find(hub.tiers.begin(), hub.tiers.end(), this) != hub.tiers.end()) finish_drains();
    });
  });
}

void TierCore::call(Callback<void()> function) {
  if (!loop.core().runs_elsewhere()) return function();
  main.core().check_thread("cannot call",
                           "tier " + config.name);  // a waiting Writer could hold something that the tier waits for
  loop.core().call_there(std::move(function));
}

void TierCore::drain(Duration deadline, Callback<void()> done) {
  std::erase_if(drains_, [](const auto& one) { return !one->done; });
  drains_.push_back(std::make_shared<Drain>(Drain{std::move(done), later(main.now(), deadline)}));
  const auto drain = drains_.back();
  if (!is_running()) return go_on(drain);
  loop.post([this, deadline, drain] {
    loop.drain(deadline, [this, drain](std::uint64_t) {
      sending_for_.push_back(drain);
      send_last_accounts();
    });
  });
}

void TierCore::finish_drains() {
  const auto drains = drains_;
  for (const auto& drain : drains) {
    if (!is_running()) go_on(drain);
  }
}

void TierCore::go_on(const std::shared_ptr<Drain>& drain) {
  if (!drain->done || loop.core().is_ending()) return;  // the loop's destructor ends the objects that are left
  if (loop.core().is_in_user_code()) {                  // by what sets it up: as soon as that has returned
    return main.post([this, &hub = main.core().runtime, drain] {
      if (std::find(hub.tiers.begin(), hub.tiers.end(), this) == hub.tiers.end()) return end(*drain);
      if (!is_running()) return go_on(drain);
      this->drain(std::max(span_between(main.now(), drain->deadline), Duration{0}), [drain] { end(*drain); });
    });
  }
  Bridge& bridge = bridge_to_main();
  bridge.hand_over();  // there is room for what the end brings
  loop.close(std::max(span_between(main.now(), drain->deadline), Duration{0}));
  bridge.finish();
  end(*drain);
}

void TierCore::end(Drain& drain) {
  if (drain.done) std::exchange(drain.done, {})();
}

void TierCore::send_last_accounts() {
  if (bridge_to_main().sending.send_accounts() > 0) {  // until the main loop has made room, or gives this tier up
    sending_ = Timer(loop, std::chrono::milliseconds{1}, [this] { send_last_accounts(); });
    return;
  }
  for (Bridge* bridge : runtime.core().outbound) bridge->sending.send_accounts();
  was_balanced_.store(runtime.balances(), std::memory_order_release);
  had_loss_.store(runtime.has_loss(), std::memory_order_release);
  for (auto& drain : std::exchange(sending_for_, {})) {
    main.post([drain = std::move(drain), unknown = unknown_] {
      if (unknown->latest == drain) *unknown = {};  // it came out after all
      end(*drain);
    });
  }
}

void TierCore::give_up() {
  Unknown now{"", drains_.empty() ? nullptr : drains_.back()};
  add_unknown(now.text);
  *unknown_ = std::move(now);
}

struct TierCore::Answer {
  BridgeSender::AccountsSent sent{};
  Latch is_there;
};

void TierCore::ask_account() {
  answer_ = std::make_shared<Answer>();
  const auto tell = [&bridge = bridge_to_main(), answer = answer_] {
    answer->sent = bridge.sending.send_all_accounts();
    answer->is_there.set();
  };
  if (loop.core().runs_elsewhere()) {
    loop.post(tell);
  } else {
    tell();
  }
}

void TierCore::wait_for_account(Duration at_most) {
  BridgeReceiver& receiving = bridge_to_main().receiving;
  if (!main.core().wait_for(answer_->is_there, at_most)) return;
  receiving.receive_up_to(answer_->sent.position);
  if (has_whole_account()) return;
  receiving.receive();
  ask_account();
}

bool TierCore::has_whole_account() noexcept {
  return answer_->is_there.is_set() && answer_->sent.left == 0 &&
         bridge_to_main().receiving.received() == answer_->sent.position;
}

void TierCore::add_unknown(std::string& to) {
  // The latest of its ticks and events known on the main loop.
  Time last = Time::min();
  for (const SensorStatus& sensor : main.runtime().sensors()) {
    const OriginCore* origin = sensor.loop == config.name ? main.core().runtime.find_origin(sensor.name) : nullptr;
    if (origin == nullptr) continue;
    last = std::max(last, origin->last_time);
    if (origin->has_segment()) last = std::max(last, origin->segment(main.now()).end);
  }
  to += (to.empty() ? "tier " : "; tier ") + config.name + " did not return from " + where() +
        ": what its sensors did after " + (last == Time::min() ? "its start" : to_iso8601(last)) + " is not known";
}

Bridge& TierCore::bridge_to_main() noexcept {
  return **std::find_if(bridges_.begin(), bridges_.end(), [this](const auto& bridge) {
    return &bridge->from() == &loop.core() && &bridge->to() == &main.core();
  });
}

bool TierCore::look_at_turning(Duration limit) {
  RuntimeCore& hub = main.core().runtime;
  const std::string name = "tier " + config.name;
  const MonotonicTime now = main.core().now();
  const bool has_answered = answered_.load(std::memory_order_acquire) == asked_;
  if (has_answered || !is_running()) {
    asked_at_ = now;
    if (has_answered && is_running())
      loop.post([this, question = ++asked_] {
        answered_.store(question, std::memory_order_release);
        loop.core().note_turning();
      });
    if (std::exchange(is_stuck_, false)) {
      hub.health_changed("tier", config.name, Health::ok, "");
      hub.log(LogLevel::info, name, is_running() ? "turns again" : "was stopped");  // last: it may run user code
    }
    return true;
  }
  if (is_stuck_) return false;
  if (now - asked_at_ > limit) {
    is_stuck_ = true;
    loop.core().note_standing(asked_at_);  // it is no longer waited for
    if (answered_.load(std::memory_order_acquire) == asked_) loop.core().note_turning();
    const Error error{Errc::not_turning, "does not turn", "",
                      "it has not returned from " + where() + " for more than " + to_string(limit),
                      "find what blocks in its sensors and handlers, and what else uses its processor"};
    hub.health_changed("tier", config.name, Health::faulted, error.what + ": " + error.why);
    hub.report(&main.core(), name, error);  // as above
    return false;
  }
  return true;
}

}  // namespace detail

namespace {

Duration checked_limit(Duration limit) {
  if (limit >= std::chrono::milliseconds{1}) return limit;
  throw SetupError(
      {Errc::bad_argument, "cannot watch tiers", "", "the limit is " + to_string(limit), "use at least 1 ms"});
}

}  // namespace

TierWatch::TierWatch(Loop& main, Duration limit)
    : all_turn_(std::make_shared<bool>(true)),
      ticker_(main, Ticker::Config{.period = checked_limit(limit) / 4, .name = "watch of tiers"},
              [&main, limit, told = all_turn_](const Tick&) {
                bool all_turn = true;
                const auto& tiers = main.core().runtime.tiers;
                for (std::size_t i = 0; i < tiers.size(); ++i) {  // a report may run user code, which may destroy one
                  if (!tiers[i]->look_at_turning(limit)) all_turn = false;
                }
                *told = all_turn;
              }) {}

Tier::Tier(Loop& main, Config config) : core_(std::make_unique<detail::TierCore>(main, std::move(config))) {}
Tier::~Tier() { core_->check_may_end(); }
Loop& Tier::loop() noexcept { return core_->loop; }
const Tier::Config& Tier::config() const noexcept { return core_->config; }
void Tier::start() { core_->start(); }
void Tier::stop() noexcept { core_->stop(); }
bool Tier::stop_within(Duration at_most) noexcept { return core_->stop_within(at_most); }
std::string Tier::doing() const { return core_->loop.core().nodes.doing(); }
bool Tier::is_running() const noexcept { return core_->is_running(); }
void Tier::call_erased(Callback<void()> function) { core_->call(std::move(function)); }
Scheduling Tier::scheduling() const noexcept { return core_->scheduling; }
const std::vector<std::string>& Tier::warnings() const noexcept { return core_->warnings; }

}  // namespace rtdata
