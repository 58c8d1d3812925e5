// publish_1, publish_10: what an event of 64 bytes costs from publishing to the last handler. handlers_100,
// handlers_1000: what each of many handlers of one topic costs, in bursts of events.
#include <cstring>
#include <functional>
#include <memory>
#include <vector>

#include "harness.hpp"
#include "payloads.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/sensors/feed.hpp"

namespace bench {
namespace {

constexpr unsigned events_a_callback = 1000;
constexpr unsigned callbacks = 100;

/// One callback publishes, the loop delivers; the feed keeps its account and gives sequence and time.
class Published {
 public:
  explicit Published(int handlers) {
    feed_ = rtdata::Feed<Eight>(loop_, {.name = "feed"});
    for (int i = 0; i < handlers; ++i) {
      subscriptions_.push_back(loop_.topic<Eight>("feed").subscribe(loop_, [this](const rtdata::Event<Eight>& event) {
        ++count_;
        sum_ += event->a;
      }));
    }
  }

  double measure() {
    const std::int64_t begin = thread_cpu_ns();
    for (unsigned i = 0; i < callbacks; ++i) {
      loop_.post([this] {
        rtdata::Time time = loop_.time();
        for (unsigned n = 0; n < events_a_callback; ++n) feed_.publish(payload_, time += rtdata::Duration{1});
      });
      loop_.poll();
    }
    const std::int64_t end = thread_cpu_ns();
    keep(sum_);
    if (count_ != std::uint64_t{callbacks} * events_a_callback * subscriptions_.size()) return 1e9;
    count_ = 0;
    return static_cast<double>(end - begin) / (callbacks * events_a_callback);
  }

 private:
  rtdata::Loop loop_;
  rtdata::Feed<Eight> feed_;
  std::vector<rtdata::Subscription> subscriptions_;
  Eight payload_ = reading(7);
  std::uint64_t count_ = 0;
  double sum_ = 0;
};

/// The event is made and the functions are called at once.
class Direct {
 public:
  explicit Direct(int handlers) {
    for (int i = 0; i < handlers; ++i) {
      functions_.emplace_back([this](const rtdata::Event<Eight>& event) {
        ++count_;
        sum_ += event->a;
      });
    }
  }

  double measure() {
    const std::int64_t begin = thread_cpu_ns();
    rtdata::Time time{};
    for (unsigned i = 0; i < callbacks * events_a_callback; ++i) {
      rtdata::Event<Eight> event;
      event.time = time += rtdata::Duration{1};
      event.sequence = ++sequence_;
      event.origin = "feed";
      event.data = payload_;
      keep(event);
      for (const auto& function : functions_) function(event);
    }
    const std::int64_t end = thread_cpu_ns();
    keep(sum_);
    return static_cast<double>(end - begin) / (callbacks * events_a_callback);
  }

 private:
  std::vector<std::function<void(const rtdata::Event<Eight>&)>> functions_;
  Eight payload_ = reading(7);
  std::uint64_t sequence_ = 0;
  std::uint64_t count_ = 0;
  double sum_ = 0;
};

// ---- many handlers

/// A handler keeps the newest value. One that adds up would be measured waiting for its own sum, in ours alone: it is
/// called for some events one after the other.
struct Tally {
  std::uint64_t count = 0;
  double last = 0;
  void add(const rtdata::Event<Eight>& event) {
    ++count;
    last = event->a;
  }
};

constexpr unsigned events_a_burst = 500;
constexpr std::size_t calls_a_measurement = 5'000'000;

double ns_per_call(std::int64_t begin, std::int64_t end, unsigned events, const std::vector<Tally>& tallies) {
  std::uint64_t calls = 0;
  for (const Tally& tally : tallies) calls += tally.count;
  return calls == events * tallies.size() ? static_cast<double>(end - begin) / static_cast<double>(calls) : 1e9;
}

class ManyHandlers {
 public:
  explicit ManyHandlers(std::size_t handlers) : tallies_(handlers) {
    feed_ = rtdata::Feed<Eight>(loop_, {.name = "feed"});
    for (Tally& tally : tallies_) {
      subscriptions_.push_back(loop_.topic<Eight>("feed").subscribe(
          loop_, [&tally](const rtdata::Event<Eight>& event) { tally.add(event); }));
    }
  }
  double measure() {
    for (Tally& tally : tallies_) tally = {};
    const auto bursts = static_cast<unsigned>(calls_a_measurement / events_a_burst / tallies_.size());
    const std::int64_t begin = thread_cpu_ns();
    for (unsigned i = 0; i < bursts; ++i) {
      loop_.post([this] {
        rtdata::Time time = loop_.time();
        for (unsigned n = 0; n < events_a_burst; ++n) feed_.publish(payload_, time += rtdata::Duration{1});
      });
      loop_.poll();
    }
    return ns_per_call(begin, thread_cpu_ns(), bursts * events_a_burst, tallies_);
  }

 private:
  std::vector<Tally> tallies_;
  rtdata::Loop loop_;
  rtdata::Feed<Eight> feed_;
  std::vector<rtdata::Subscription> subscriptions_;
  Eight payload_ = reading(7);
};

/// A list of functions with their contexts, called for each event as it is made.
class ManyFunctions {
 public:
  explicit ManyFunctions(std::size_t handlers) : tallies_(handlers) {
    for (Tally& tally : tallies_) {
      handlers_.push_back(
          {[](void* context, const rtdata::Event<Eight>& event) { static_cast<Tally*>(context)->add(event); }, &tally});
    }
  }
  double measure() {
    for (Tally& tally : tallies_) tally = {};
    const auto events = static_cast<unsigned>(calls_a_measurement / tallies_.size());
    const std::int64_t begin = thread_cpu_ns();
    rtdata::Time time{};
    for (unsigned i = 0; i < events; ++i) {
      rtdata::Event<Eight> event;
      event.time = time += rtdata::Duration{1};
      event.sequence = ++sequence_;
      event.origin = "feed";
      event.data = payload_;
      keep(event);
      for (const Handler& handler : handlers_) handler.function(handler.context, event);
    }
    return ns_per_call(begin, thread_cpu_ns(), events, tallies_);
  }

 private:
  struct Handler {
    void (*function)(void* context, const rtdata::Event<Eight>& event);
    void* context;
  };
  std::vector<Tally> tallies_;
  std::vector<Handler> handlers_;
  Eight payload_ = reading(7);
  std::uint64_t sequence_ = 0;
};

}  // namespace

void bench_publish(Report& report) {
  for (const std::size_t handlers : {std::size_t{100}, std::size_t{1000}}) {
    const std::string name = "handlers_" + std::to_string(handlers);
    if (!report.wants(name)) continue;
    ManyHandlers ours(handlers);
    ManyFunctions limit(handlers);
    report.add(measure_pair(
        {.name = name, .unit = "ns/handler", .reach = 1.5}, [&] { return ours.measure(); },
        [&] { return limit.measure(); }, 15));
  }
  for (const int handlers : {1, 10}) {
    const std::string name = "publish_" + std::to_string(handlers);
    if (!report.wants(name)) continue;
    Published published(handlers);
    Direct direct(handlers);
    report.add(measure_pair(
        {.name = name, .unit = "ns/event", .reach = handlers == 1 ? 2.0 : 1.5}, [&] { return published.measure(); },
        [&] { return direct.measure(); }, 15));
  }
}

}  // namespace bench
