// rt_*, bridge_*, isolation, lossless, idle_wakeups, long_run: what tiers and the loop keep in long and loaded runs.
#include <fcntl.h>
#include <malloc.h>
#include <sched.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>
#include <uv.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <functional>
#include <memory>
#include <semaphore>
#include <string>
#include <thread>
#include <vector>

#ifdef RTDATA_BENCH_SQLITE
#include <sqlite3.h>

#include "rtdata/recording/sqlite.hpp"
#endif

#include "bare.hpp"
#include "harness.hpp"
#include "payloads.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace bench {
namespace {

constexpr rtdata::Scheduling real_time{rtdata::SchedulingPolicy::fifo, 80};
constexpr rtdata::Duration period{millisecond};

/// Runs in a thread that may be given the policy and priority of fast tiers.
bool is_real_time_permitted() {
  bool is_permitted = false;
  std::thread([&] { is_permitted = bool(rtdata::set_scheduling(real_time)); }).join();
  return is_permitted;
}

rtdata::Tier::Config fast_tier() {
  return {.name = "fast", .policy = real_time.policy, .priority = real_time.priority};
}

// ---- lateness

/// All percentiles that are asked for, in us, of one series.
std::vector<double> percentiles(std::vector<double> lateness) {
  return {percentile(lateness, 0.5) / 1e3, percentile(lateness, 0.99) / 1e3, percentile(lateness, 0.999) / 1e3};
}

std::vector<double> tier_lateness(const rtdata::Tier::Config& config, std::size_t ticks) {
  rtdata::Loop main;
  rtdata::Tier fast(main, config);
  std::binary_semaphore is_done{0};
  std::vector<double> lateness;
  lateness.reserve(ticks);
  rtdata::Ticker ticker(fast.loop(), period, [&](const rtdata::Tick& tick) {
    if (lateness.size() == ticks) return;
    lateness.push_back(static_cast<double>(monotonic_ns() - tick.due.time_since_epoch().count()));
    if (lateness.size() == ticks) is_done.release();
  });
  fast.start();
  is_done.acquire();
  fast.stop();
  return percentiles(std::move(lateness));
}

/// From the first tick on, `due` or a whole number of periods later.
std::vector<double> bare_lateness(std::size_t ticks, std::int64_t due = on_grid(monotonic_ns())) {
  std::vector<double> lateness;
  lateness.reserve(ticks);
  std::thread([&] {
    ::prctl(PR_SET_TIMERSLACK, 1UL);
    if (!rtdata::set_scheduling(real_time)) return;
    const BareTimer timer;
    timer.arm(due);
    while (lateness.size() < ticks) {
      timer.wait();
      const std::int64_t now = monotonic_ns();
      due += (now - due) / millisecond * millisecond;  // as a Ticker does, the latest tick that has come due is taken
      lateness.push_back(static_cast<double>(now - due));
      due += millisecond;
      timer.arm(due);
    }
  }).join();
  return percentiles(std::move(lateness));
}

/// A tier and two bare loops at the same time, a third of a period after each other: what the machine does to one of
/// them it does to all, so that their tails can be compared.
Round lateness_at_once(std::size_t ticks, bool is_other_first) {
  Round round;
  std::atomic<std::int64_t> first{0};
  rtdata::Loop main;
  rtdata::Tier fast(main, fast_tier());
  std::vector<double> lateness;
  lateness.reserve(ticks);
  std::binary_semaphore has_begun{0};
  std::binary_semaphore is_done{0};
  rtdata::Ticker ticker(fast.loop(), period, [&](const rtdata::Tick& tick) {
    const std::int64_t due = tick.due.time_since_epoch().count();
    if (lateness.size() == ticks) return;
    lateness.push_back(static_cast<double>(monotonic_ns() - due));
    if (lateness.size() == 1) {
      first = due;
      has_begun.release();
    }
    if (lateness.size() == ticks) is_done.release();
  });
  fast.start();
  has_begun.acquire();
  const auto bare = [&](std::int64_t thirds) {
    return bare_lateness(ticks, first + 10 * millisecond + thirds * millisecond / 3);
  };
  std::thread other([&] { round.again = bare(is_other_first ? 1 : 2); });
  round.limit = bare(is_other_first ? 2 : 1);
  other.join();
  is_done.acquire();
  fast.stop();
  round.value = percentiles(std::move(lateness));
  return round;
}

/// The same three of cyclictest, on this thread's processor; empty when it cannot be run.
std::vector<double> cyclictest(std::size_t ticks) {
  constexpr std::size_t most = 400'000;  // ns
  const std::string command = "cyclictest -p80 -i1000 -q -m -N -l" + std::to_string(ticks) + " -a" +
                              std::to_string(::sched_getcpu()) + " -h" + std::to_string(most) + " 2>/dev/null";
  std::FILE* output = ::popen(command.c_str(), "r");
  if (output == nullptr) return {};
  std::vector<double> lateness;
  char line[200];
  while (std::fgets(line, sizeof line, output) != nullptr) {
    unsigned long nanoseconds = 0;
    unsigned long count = 0;
    if (line[0] != '#' && std::sscanf(line, "%lu %lu", &nanoseconds, &count) == 2)
      lateness.insert(lateness.end(), count, static_cast<double>(nanoseconds));
  }
  if (::pclose(output) != 0 || lateness.empty()) return {};
  lateness.resize(ticks, static_cast<double>(most));  // those beyond the histogram
  return percentiles(std::move(lateness));
}

std::string text_of(const std::vector<double>& percentiles) {
  char text[100];
  std::snprintf(text, sizeof text, "p50 %.1f, p99 %.1f, p999 %.1f us", percentiles[0], percentiles[1], percentiles[2]);
  return text;
}

void add_wanted(Report& report, const std::vector<Figure>& figures) {
  for (const Figure& figure : figures) {
    if (!figure.name.empty() && report.wants(figure.name)) report.add(figure);
  }
}

void bench_lateness(Report& report) {
  constexpr std::size_t ticks = 3000;
  const bool wants_tail = report.wants("rt_lateness_p99") || report.wants("rt_lateness_p999");
  if (report.wants("rt_lateness_p50")) {  // what disturbs the machine does not change it: each runs alone
    add_wanted(report, measure_pairs(
                           {{.name = "rt_lateness_p50", .unit = "us", .reach = 1.05}, {}, {}},
                           [] { return tier_lateness(fast_tier(), ticks); }, [] { return bare_lateness(ticks); }, 7));
  }
  if (wants_tail) {
    add_wanted(report, measure_rounds(
                           {{},
                            {.name = "rt_lateness_p99", .unit = "us", .reach = 1.1},
                            {.name = "rt_lateness_p999", .unit = "us", .reach = 1.25}},
                           [](int number) { return lateness_at_once(ticks, number % 2 != 0); }, 8));
  }
  if (!wants_tail && !report.wants("rt_lateness_p50")) return;
  const auto cyclic = cyclictest(ticks);
  report.remark("cyclictest: " + (cyclic.empty() ? "not installed" : text_of(cyclic)));
}

void bench_spin(Report& report) {
  if (!report.wants("rt_spin_p50") && !report.wants("rt_spin_p99")) return;
  constexpr std::size_t ticks = 1000;
  const bool has_cyclictest = !cyclictest(10).empty();
  auto config = fast_tier();
  config.spin = std::chrono::microseconds{120};
  config.keep_cpu_awake = true;
  const std::string note = has_cyclictest ? "against cyclictest" : "against the bare loop: cyclictest is not installed";
  add_wanted(report, measure_pairs(
                         {{.name = "rt_spin_p50", .unit = "us", .reach = 0.1, .note = note},
                          {.name = "rt_spin_p99", .unit = "us", .reach = 0.6, .note = note},
                          {}},
                         [&] { return tier_lateness(config, ticks); },
                         [&] { return has_cyclictest ? cyclictest(ticks) : bare_lateness(ticks); }, 7));
}

/// Another thread of this processor that never waits, and one elsewhere that writes to the disk, while it lives.
class Load {
 public:
  explicit Load(const std::string& folder) : file_(folder, "load") {
    busy_ = std::thread([this] {
      while (!is_over_.load(std::memory_order_relaxed)) {
      }
    });
    writer_ = std::thread([this] {
      settle_other_thread();
      const int fd = ::open(file_.path().c_str(), O_WRONLY | O_CREAT, 0600);
      const std::vector<char> block(std::size_t{1} << 18, 'x');
      for (unsigned i = 0; fd >= 0 && !is_over_.load(std::memory_order_relaxed); i = (i + 1) % 256) {
        if (::pwrite(fd, block.data(), block.size(), static_cast<off_t>(i * block.size())) < 0) break;
        if (i % 16 == 0) ::fdatasync(fd);
      }
      if (fd >= 0) ::close(fd);
    });
  }
  Load(const Load&) = delete;
  Load& operator=(const Load&) = delete;
  ~Load() {
    is_over_ = true;
    busy_.join();
    writer_.join();
  }

 private:
  const Scratch file_;
  std::atomic<bool> is_over_{false};
  std::thread busy_;
  std::thread writer_;
};

void bench_loaded(Report& report) {
  if (!report.wants("rt_lateness_load_p99")) return;
  constexpr std::size_t ticks = 2000;
  const Load load(report.options().disk);
  add_wanted(report, measure_rounds(
                         {{}, {.name = "rt_lateness_load_p99", .unit = "us", .reach = 1.15}, {}},
                         [](int number) { return lateness_at_once(ticks, number % 2 != 0); }, 8));
}

// ---- bridges

constexpr unsigned burst_events = 500;
constexpr unsigned bursts_on_their_way = 8;
constexpr unsigned bursts = 800;
constexpr unsigned crossing_events = bursts * burst_events;

rtdata::Runtime::Config rings_for_all() {
  rtdata::Runtime::Config config;
  config.ring_events = std::size_t{bursts_on_their_way} * burst_events;
  return config;
}

/// The fast tier publishes bursts, so many that the other side always has some to take, and never more than there is
/// room.
class Crossing {
 public:
  Crossing() : runtime_(rings_for_all()), main_(runtime_, {}), fast_(main_, {.cpus = {::sched_getcpu()}}) {
    feed_ = rtdata::Feed<Eight>(fast_.loop(), {.name = "feed"});
    subscription_ = main_.subscribe<Eight>("feed", [this](const rtdata::Event<Eight>& event) {
      sum_ += event->a;
      ++count_;
      if (count_ % burst_events == 0 && count_ / burst_events + bursts_on_their_way <= bursts) send_burst();
      if (count_ == crossing_events) main_.stop();
    });
    main_.run_for(std::chrono::milliseconds{20});
  }
  double measure() {
    settle_other_thread();
    count_ = 0;
    const std::int64_t begin = process_cpu_ns();
    for (unsigned i = 0; i < bursts_on_their_way; ++i) send_burst();
    main_.run_for(std::chrono::seconds{20});
    const std::int64_t end = process_cpu_ns();
    settle_thread();
    keep(sum_);
    if (count_ != crossing_events) return 1e9;
    return static_cast<double>(end - begin) / crossing_events;
  }

 private:
  void send_burst() {
    fast_.loop().post([this] {
      rtdata::Time time = fast_.loop().time();
      for (unsigned n = 0; n < burst_events; ++n) feed_.publish(payload_, time += rtdata::Duration{1});
    });
  }
  rtdata::Runtime runtime_;
  rtdata::Loop main_;
  rtdata::Tier fast_;
  rtdata::Feed<Eight> feed_;
  rtdata::Subscription subscription_;
  Eight payload_ = reading(7);
  alignas(64) std::uint64_t count_ = 0;  // the receiver's, and not in a line of cache with what the sender reads
  double sum_ = 0;
};

/// A ring of events between two libuv loops, each woken by a uv_async_t; the handler gets the event where it lies.
class BareCrossing {
 public:
  double measure() {
    const int fast_cpu = ::sched_getcpu();
    head_ = tail_ = 0;
    credits_ = bursts_on_their_way;
    count_ = 0;
    is_over_ = false;
    uv_loop_t receiver;
    uv_loop_init(&receiver);
    uv_async_init(&receiver, &news_, [](uv_async_t* async) { static_cast<BareCrossing*>(async->data)->take(); });
    uv_loop_init(&sender_);
    uv_async_init(&sender_, &credit_, [](uv_async_t* async) { static_cast<BareCrossing*>(async->data)->send(); });
    news_.data = credit_.data = this;
    settle_other_thread();
    std::thread fast([this, fast_cpu] {
      cpu_set_t one;
      CPU_ZERO(&one);
      CPU_SET(static_cast<std::size_t>(fast_cpu), &one);
      ::sched_setaffinity(0, sizeof one, &one);
      uv_run(&sender_, UV_RUN_DEFAULT);
    });
    const std::int64_t begin = process_cpu_ns();
    uv_async_send(&credit_);
    uv_run(&receiver, UV_RUN_DEFAULT);
    const std::int64_t end = process_cpu_ns();
    fast.join();
    uv_loop_close(&receiver);
    uv_loop_close(&sender_);
    settle_thread();
    keep(sum_);
    return static_cast<double>(end - begin) / crossing_events;
  }

 private:
  static constexpr std::size_t slots = 8192;
  void send() {
    std::uint64_t head = head_.load(std::memory_order_relaxed);
    for (unsigned credits = credits_.exchange(0); credits > 0; --credits) {
      std::int64_t time = monotonic_ns();
      for (unsigned n = 0; n < burst_events; ++n) {
        rtdata::Event<Eight>& event = ring_[head % slots];
        event.time = rtdata::Time{rtdata::Duration{++time}};
        event.sequence = ++sequence_;
        event.origin = "feed";
        event.data = payload_;
        head_.store(++head, std::memory_order_release);
      }
      head_.store(head);  // in order before libuv's look whether the other side has been told of the last one
      uv_async_send(&news_);
    }
    if (is_over_) uv_close(reinterpret_cast<uv_handle_t*>(&credit_), nullptr);
  }
  void take() {
    std::uint64_t tail = tail_;
    for (const std::uint64_t head = head_.load(std::memory_order_acquire); tail != head;) {
      handler_(ring_[tail++ % slots]);
      if (++count_ % burst_events != 0) continue;
      tail_ = tail;
      if (count_ / burst_events + bursts_on_their_way > bursts) continue;
      credits_.fetch_add(1);
      uv_async_send(&credit_);
    }
    tail_ = tail;
    if (count_ < crossing_events) return;
    is_over_ = true;
    uv_async_send(&credit_);
    uv_close(reinterpret_cast<uv_handle_t*>(&news_), nullptr);
  }
  std::vector<rtdata::Event<Eight>> ring_ = std::vector<rtdata::Event<Eight>>(slots);
  std::function<void(const rtdata::Event<Eight>&)> handler_ = [this](const rtdata::Event<Eight>& event) {
    sum_ += event->a;
  };
  Eight payload_ = reading(7);
  std::uint64_t sequence_ = 0;
  uv_loop_t sender_{};
  uv_async_t news_{};
  uv_async_t credit_{};
  alignas(64) std::atomic<std::uint64_t> head_{0};
  alignas(64) std::uint64_t tail_ = 0;  // the credits keep the sender from catching up with it
  std::atomic<unsigned> credits_{0};
  std::atomic<bool> is_over_{false};
  std::uint64_t count_ = 0;
  double sum_ = 0;
};

constexpr std::size_t latencies = 800;

/// From the fast tier on this processor to the normal one on another.
double tier_latency() {
  std::vector<double> taken;
  taken.reserve(latencies);
  const int fast_cpu = ::sched_getcpu();
  settle_other_thread();
  rtdata::Loop main;
  auto config = fast_tier();
  config.cpus = {fast_cpu};
  rtdata::Tier fast(main, config);
  rtdata::Feed<Single> feed(fast.loop(), {.name = "feed"});
  auto subscription = main.subscribe<Single>("feed", [&](const rtdata::Event<Single>& event) {
    taken.push_back(static_cast<double>(monotonic_ns()) - event->value);
    if (taken.size() == latencies) main.stop();
  });
  rtdata::Ticker ticker(fast.loop(), period,
                        [&](const rtdata::Tick&) { feed.publish({static_cast<double>(monotonic_ns())}); });
  main.run();
  fast.stop();
  settle_thread();
  taken.resize(latencies);
  return percentile(taken, 0.5) / 1e3;
}

double bare_latency() {
  std::vector<double> taken;
  taken.reserve(latencies);
  const int wake = ::eventfd(0, EFD_NONBLOCK);
  std::atomic<std::int64_t> sent{0};
  std::atomic<bool> is_over{false};
  std::thread fast([&] {
    ::prctl(PR_SET_TIMERSLACK, 1UL);
    if (!rtdata::set_scheduling(real_time)) std::abort();
    const BareTimer timer;
    for (std::int64_t due = on_grid(monotonic_ns()); !is_over; due += millisecond) {
      timer.arm(due);
      timer.wait();
      sent = monotonic_ns();
      constexpr std::uint64_t one = 1;
      if (::write(wake, &one, sizeof one) != sizeof one) std::abort();
    }
  });
  settle_other_thread();
  const int epoll = ::epoll_create1(0);
  epoll_event event{};
  event.events = EPOLLIN;
  ::epoll_ctl(epoll, EPOLL_CTL_ADD, wake, &event);
  while (taken.size() < latencies) {
    if (::epoll_wait(epoll, &event, 1, -1) != 1) continue;
    std::uint64_t count = 0;
    if (::read(wake, &count, sizeof count) == sizeof count) taken.push_back(static_cast<double>(monotonic_ns() - sent));
  }
  is_over = true;
  fast.join();
  ::close(epoll);
  ::close(wake);
  settle_thread();
  return percentile(taken, 0.5) / 1e3;
}

void bench_bridge(Report& report) {
  if (report.wants("bridge_event")) {
    Crossing crossing;
    BareCrossing bare;
    report.add(measure_pair(
        {.name = "bridge_event", .unit = "ns/event", .reach = 1.5}, [&] { return crossing.measure(); },
        [&] { return bare.measure(); }, 15));
  }
}

// ---- isolation

#ifdef RTDATA_BENCH_SQLITE

/// Spans of ticks with the disturbance and without it, turn by turn, so that what else happens to the machine happens
/// to both. The beginning of a span, in which the last one's disturbance ends, is not looked at.
constexpr unsigned span_ticks = 400;
constexpr unsigned settling_ticks = 150;
constexpr unsigned spans_a_round = 24;

/// The fast tier's lateness while a handler of the normal tier blocks again and again and its events are recorded, and
/// twice without.
Round isolation_round(const std::string& path) {
  enum Span { disturbed, quiet, quiet_again, kinds };
  std::vector<double> lateness[kinds];
  for (auto& series : lateness) series.reserve(std::size_t{span_ticks} * spans_a_round / kinds);
  const int fast_cpu = ::sched_getcpu();
  settle_other_thread();
  {
    rtdata::Loop main;
    main.on_error([](const rtdata::ErrorReport&) {});  // that the handler holds the loop
    auto config = fast_tier();
    config.cpus = {fast_cpu};
    rtdata::Tier fast(main, config);
    rtdata::Feed<Single> followed(fast.loop(), {.name = "followed"});
    rtdata::Feed<Single> other(fast.loop(), {.name = "other"});
    unsigned count = 0;
    rtdata::Ticker ticker(fast.loop(), period, [&](const rtdata::Tick& tick) {
      if (count == span_ticks * spans_a_round) return;
      const double late = static_cast<double>(monotonic_ns() - tick.due.time_since_epoch().count());
      const unsigned round = count / (kinds * span_ticks);
      const unsigned place = count / span_ticks % kinds;
      // The two quiet ones change places.
      const auto kind = static_cast<Span>(place == disturbed || round % 2 == 0 ? place : kinds - place);
      if (count % span_ticks >= settling_ticks) lateness[kind].push_back(late);
      (kind == disturbed ? followed : other).publish({late});
      if (++count == span_ticks * spans_a_round) main.stop();
    });
    const auto handler = main.subscribe("followed", [](const rtdata::EventView& event) {
      if (event.sequence() % 110 == 0) std::this_thread::sleep_for(std::chrono::milliseconds{100});
    });
    const rtdata::SqliteSink sink(
        main, {.path = path, .sink = {.topics = {"followed"}, .batch_time = std::chrono::milliseconds{50}}});
    main.run();
    fast.stop();
  }
  settle_thread();
  const auto p99 = [](std::vector<double>& series) { return std::vector<double>{percentile(series, 0.99) / 1e3}; };
  return {p99(lateness[disturbed]), p99(lateness[quiet]), p99(lateness[quiet_again])};
}

void bench_isolation(Report& report) {
  if (!report.wants("isolation")) return;
  const Scratch file(report.options().disk, "isolation.db");
  add_wanted(report, measure_rounds(
                         {{.name = "isolation", .unit = "us", .reach = 1.2}},
                         [&](int) { return isolation_round(file.path()); }, 7));
}

// ---- recording without loss

constexpr std::size_t sensor_count = 10'000;

struct Recorded {
  bool is_lossless = false;
  double rate = 0;  // events a second that were stored while they came
};

/// All sensors at one rate for a second, and a recording.
Recorded record(const std::string& folder, double rate) {
  const Scratch file(folder, "lossless.db");
  rtdata::Loop loop;
  loop.on_error([](const rtdata::ErrorReport&) {});
  const rtdata::Duration sensor_period{static_cast<std::int64_t>(1e9 * sensor_count / rate)};
  constexpr std::size_t phases = 10;
  rtdata::SqliteSink sink(loop, {.path = file.path()});
  double value = 0;
  std::deque<rtdata::Sensor<Single>> sensors;
  for (std::size_t i = 0; i < sensor_count; ++i) {
    sensors.emplace_back(loop,
                         rtdata::SensorConfig{.name = "s" + std::to_string(i),
                                              .topic = "many",
                                              .rate = rtdata::Rate::from_period(sensor_period),
                                              .phase = sensor_period / phases * static_cast<std::int64_t>(i % phases)},
                         [&value] { return Single{++value}; });
  }
  const std::int64_t begin = monotonic_ns();
  loop.run_for(std::chrono::seconds{1});
  const auto at_end = sink.counts();
  std::uint64_t missed = 0;
  for (auto& sensor : sensors) {
    const auto counts = sensor.counts();
    missed += counts.missed + counts.failed;
    sensor.stop();
  }
  sink.flush();
  while (sink.counts().queued > 0) loop.run_for(std::chrono::milliseconds{1});
  const double seconds = static_cast<double>(monotonic_ns() - begin) / 1e9;
  const auto counts = sink.counts();
  // What waits at the end would fill the queue in time, unless it is little: two transactions of 1 MiB are always
  // there.
  constexpr std::uint64_t two_transactions = 2 * 32768;
  const bool keeps_up = at_end.queued < two_transactions + at_end.offered / 20;
  return {keeps_up && missed == 0 && counts.all_dropped() == 0 && counts.stored == counts.offered,
          static_cast<double>(counts.stored) / seconds};
}

/// The highest rate, searched upwards; a rate that fails gets a second chance.
double lossless_rate(const std::string& folder) {
  Recorded best;
  const auto is_lossless = [&](double rate) {
    for (int chance = 0; chance < 2; ++chance) {
      const Recorded recorded = record(folder, rate);
      if (!recorded.is_lossless) continue;
      if (recorded.rate > best.rate) best = recorded;
      return true;
    }
    return false;
  };
  double good = 200'000;
  while (good < 2e7 && is_lossless(good)) good *= 2;
  double bad = good;
  good /= 2;
  for (int step = 0; step < 5; ++step) {
    const double middle = (good + bad) / 2;
    (is_lossless(middle) ? good : bad) = middle;
  }
  return best.rate;
}

/// The same rows in the same table, batches and settings, on a thread that does nothing else.
double bare_insert_ns(const std::string& folder) {
  const Scratch file(folder, "bare.db");
  constexpr unsigned batch_rows = 500;
  constexpr unsigned batches = 2000;
  double taken = 0;
  std::thread([&] {
    sqlite3* database = nullptr;
    if (sqlite3_open_v2(file.path().c_str(), &database,
                        SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE, nullptr) != SQLITE_OK) {
      return;
    }
    const auto execute = [&](const char* sql) { sqlite3_exec(database, sql, nullptr, nullptr, nullptr); };
    execute(
        "PRAGMA auto_vacuum=INCREMENTAL; PRAGMA journal_mode=WAL; PRAGMA synchronous=NORMAL; PRAGMA "
        "wal_autocheckpoint=0; PRAGMA journal_size_limit=67108864; PRAGMA temp_store=MEMORY;"
        "CREATE TABLE many(run INTEGER NOT NULL, time INTEGER NOT NULL, origin TEXT NOT NULL,"
        " sequence INTEGER NOT NULL, value REAL)");
    constexpr unsigned most = 20;
    std::string sql = "INSERT OR ROLLBACK INTO many(run, time, origin, sequence, value) VALUES (?,?,?,?,?)";
    for (unsigned i = 1; i < most; ++i) sql += ",(?,?,?,?,?)";
    sqlite3_stmt* statement = nullptr;
    sqlite3_prepare_v3(database, sql.c_str(), -1, SQLITE_PREPARE_PERSISTENT, &statement, nullptr);
    std::vector<std::string> names;
    for (std::size_t i = 0; i < sensor_count; ++i) names.push_back("s" + std::to_string(i));
    const std::int64_t begin = monotonic_ns();
    std::int64_t time = 1'772'366'400'000'000'000;
    unsigned row = 0;
    for (unsigned batch = 0; batch < batches; ++batch) {
      execute("BEGIN");
      for (unsigned done = 0; done < batch_rows; done += most) {
        int at = 0;
        for (unsigned i = 0; i < most; ++i, ++row) {
          const std::string& name = names[row % sensor_count];
          sqlite3_bind_int64(statement, ++at, 1);
          sqlite3_bind_int64(statement, ++at, time += 1000);
          sqlite3_bind_text64(statement, ++at, name.data(), name.size(), SQLITE_STATIC, SQLITE_UTF8);
          sqlite3_bind_int64(statement, ++at, row / sensor_count + 1);
          sqlite3_bind_double(statement, ++at, row);
        }
        if (sqlite3_step(statement) != SQLITE_DONE) return;
        sqlite3_reset(statement);
      }
      execute("COMMIT");
      if (batch % 20 == 19) sqlite3_wal_checkpoint_v2(database, nullptr, SQLITE_CHECKPOINT_PASSIVE, nullptr, nullptr);
    }
    taken = static_cast<double>(monotonic_ns() - begin) / (batches * batch_rows);
    sqlite3_finalize(statement);
    sqlite3_close(database);
  }).join();
  return taken;
}

void bench_lossless(Report& report) {
  if (!report.wants("lossless")) return;
  unsettle_thread();
  const std::string& folder = report.options().memory;
  Figure figure = measure_pair(
      {.name = "lossless", .unit = "ns/event", .reach = 1.2}, [&] { return 1e9 / lossless_rate(folder); },
      [&] { return bare_insert_ns(folder); }, 7);
  settle_thread();
  figure.note = std::to_string(std::llround(1e9 / figure.value)) + " events/s, " +
                std::to_string(std::llround(1e9 / figure.limit)) + " rows/s";
  report.add(figure);
}

#else

void bench_isolation(Report& report) {
  if (report.wants("isolation")) report.remark("isolation: left out, this was built without SQLite");
}
void bench_lossless(Report& report) {
  if (report.wants("lossless")) report.remark("lossless: left out, this was built without SQLite");
}

#endif

// ---- rest and long runs

long times_waited() {
  rusage usage{};
  ::getrusage(RUSAGE_THREAD, &usage);
  return usage.ru_nvcsw;
}

void bench_idle(Report& report) {
  if (!report.wants("idle_wakeups")) return;
  constexpr auto time = std::chrono::seconds{20};
  const auto sensor_on = [](rtdata::Loop& loop) {
    return rtdata::Sensor<Single>(loop, {.name = "slow", .rate = rtdata::Rate::hertz(1)}, [] { return Single{}; });
  };
  Figure figure{.name = "idle_wakeups", .unit = "in 20 s", .reach = 1.5};
  {
    rtdata::Loop loop;
    const auto sensor = sensor_on(loop);
    const long before = times_waited();
    loop.run_for(time);
    figure.value = static_cast<double>(times_waited() - before);
  }
  figure.limit = 20;
  figure.ratio = figure.value / figure.limit;
  report.add(figure);
  rtdata::Loop main;
  rtdata::Tier fast(main, {});
  const auto sensor = sensor_on(fast.loop());
  long on_fast = 0;
  rtdata::Timer begin(fast.loop(), std::chrono::milliseconds{1}, [&] { on_fast = -times_waited(); });
  const long before = times_waited();
  main.run_for(time);
  const long on_main = times_waited() - before;
  on_fast += fast.call([](rtdata::Loop&) { return times_waited(); });
  report.remark("with the sensor on a tier: " + std::to_string(on_fast) + " there, " + std::to_string(on_main) +
                " on the main loop");
}

void bench_long_run(Report& report) {
  if (!report.wants("long_run")) return;
  constexpr auto minute = std::chrono::minutes{1};
  constexpr std::int64_t expected = 60 * 60 * 1000;
  const auto used = [] {
    const auto info = ::mallinfo2();
    return static_cast<std::int64_t>(info.uordblks + info.hblkhd);
  };
  rtdata::Loop loop(rtdata::Loop::Manual{});
  std::int64_t wrong = 0;
  std::int64_t delivered = 0;
  rtdata::Time last{};
  const rtdata::Sensor<Single> sensor(loop, {.name = "fast", .rate = rtdata::Rate::from_period(period)},
                                      [] { return Single{}; });
  const auto subscription = loop.subscribe<Single>("fast", [&](const rtdata::Event<Single>& event) {
    if (delivered++ > 0 && event.time - last != period) ++wrong;
    last = event.time;
  });
  loop.advance(minute);
  const std::int64_t before = used();
  for (int i = 1; i < 60; ++i) loop.advance(minute);
  const std::int64_t grown = std::max<std::int64_t>(used() - before, 0);
  // The ticks at both ends of the hour are within it.
  wrong += std::max<std::int64_t>(std::abs(delivered - expected) - 1, 0);
  wrong += static_cast<std::int64_t>(sensor.counts().missed + sensor.counts().late);
  Figure figure{.name = "long_run", .unit = "ticks + bytes", .reach = 1};
  figure.value = static_cast<double>(wrong + grown);
  figure.ratio = 1 + figure.value;
  figure.note = std::to_string(delivered) + " ticks, " + std::to_string(wrong) + " of them wrong; " +
                std::to_string(grown) + " bytes grown";
  report.add(figure);
}

}  // namespace

void bench_real_time(Report& report) {
  bench_bridge(report);
  bench_lossless(report);
  bench_long_run(report);
  bench_idle(report);
  const std::vector<std::string> names{"rt_lateness_p50", "rt_lateness_p99",      "rt_lateness_p999", "rt_spin_p50",
                                       "rt_spin_p99",     "rt_lateness_load_p99", "bridge_p50",       "isolation"};
  const auto is_wanted = [&](const std::string& name) { return report.wants(name); };
  if (std::none_of(names.begin(), names.end(), is_wanted)) return;
  if (!is_real_time_permitted()) {
    for (const std::string& name : names) {
      if (is_wanted(name)) report.remark(name + ": left out, SCHED_FIFO is not permitted");
    }
    return;
  }
  if (::mlockall(MCL_CURRENT | MCL_FUTURE) != 0) report.remark("memory cannot be locked");  // as tiers do
  if (report.wants("bridge_p50"))
    report.add(measure_pair({.name = "bridge_p50", .unit = "us", .reach = 1.15}, tier_latency, bare_latency, 9));
  bench_lateness(report);
  bench_spin(report);
  bench_loaded(report);
  bench_isolation(report);
  ::munlockall();
}

}  // namespace bench
