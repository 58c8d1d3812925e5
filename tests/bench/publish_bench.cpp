// publish_1, publish_10: what an event of 64 bytes costs from publishing to the last handler.
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

}  // namespace

void bench_publish(Report& report) {
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
