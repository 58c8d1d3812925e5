// What nobody thought of: every call of the user's code does any public verb on its own and on other handles, moves and
// assigns them, and throws, at random. Whatever they do, nothing is used after it went, and every account balances.
//
// RTDATA_TEST_SEEDS="1 10000" does it with so many other seeds from the first on.
#include <doctest/doctest.h>
#include <sys/eventfd.h>
#include <unistd.h>
#include <uv.h>

#include <array>
#include <atomic>
#include <csignal>
#include <cstdlib>
#include <map>
#include <memory>
#include <mutex>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/recording_writer.hpp"
#include "rtdata/sinks/sink.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using sinks::Number;

namespace {

enum class Loops { manual, owned, attached, tiers, manual_tiers };

bool has_tiers(Loops kind) { return kind == Loops::tiers || kind == Loops::manual_tiers; }

/// Where user code is called.
enum class In { outside, callback, destructor, writer };

class World;

/// Among the captures of every callback: its destructor is user code.
class Captured {
 public:
  explicit Captured(World& world) : world_(&world) {}
  Captured(Captured&& other) noexcept : world_(std::exchange(other.world_, nullptr)) {}
  ~Captured();

 private:
  World* world_;
};

/// A payload whose constructor and destructor are user code.
class Meddler {
 public:
  explicit Meddler(World& world) : world_(&world) {}
  Meddler(Meddler&& other);
  ~Meddler();

 private:
  World* world_;
};

/// What a writer has stored; kept when it goes.
struct Stored {
  std::atomic<std::uint64_t> rows{0};
  std::map<std::string, std::uint64_t> last;  // sequence by origin; the lane's
  std::atomic<bool> is_ordered{true};
};

/// What writers on lanes use; kept when their loop goes, since one may have been left behind there.
struct LaneSide {
  std::mutex mutex;
  std::mt19937 random;
  int budget = 20;
  Loop* loop = nullptr;  // null: it is about to go
  /// With a chance of one in n.
  bool one_in(unsigned n) {
    const std::lock_guard lock(mutex);
    return random() % n == 0;
  }
};

class ChaosWriter final : public RecordingWriter {
 public:
  ChaosWriter(World& world, std::shared_ptr<Stored> stored);
  ~ChaosWriter() override;
  Result<void> open() override { return on_lane("open"); }
  Result<void> write(Batch& batch) override;
  Result<void> flush() override { return on_lane("flush"); }
  Result<void> close() override { return on_lane("close"); }
  std::optional<Error> take_warning() override;
  Result<void> add_topic(std::uint32_t, std::string_view, const Description&) override;
  LiveCounts* live_counts(std::uint32_t) override;

 private:
  Result<void> on_lane(const char* what);
  World& world_;  // on a lane in real time not to be used: it may be gone
  const bool is_manual_;
  const std::shared_ptr<LaneSide> lane_;
  std::shared_ptr<Stored> stored_;
};

/// The handles of one loop, and what user code does with them. Of its loop's thread.
class World {
 public:
  World(Loops kind, unsigned seed) : kind_(kind), random_(seed) {
    lane->random.seed(seed + 1);
    event_ = ::eventfd(1, EFD_NONBLOCK);  // readable for good
  }
  ~World() { ::close(event_); }

  Loop* loop = nullptr;                   // null: gone
  std::unique_ptr<Tier>* tier = nullptr;  // the main loop's; null: there is none any more
  World* other = nullptr;
  int budget = 0;  // of verbs, so that it ends
  bool is_of_tier = false;
  bool is_manual() const { return kind_ == Loops::manual || kind_ == Loops::manual_tiers; }

  int below(int n) { return static_cast<int>(random_() % static_cast<unsigned>(n)); }

  /// One call of user code.
  void act(In in) {
    constexpr int deepest = 4;
    if (loop == nullptr || is_ending || depth_ >= deepest) return;
    const bool was_in_writer = in_writer_;
    in_writer_ = in_writer_ || in == In::writer;
    ++depth_;
    for (int verbs = below(3); verbs > 0 && budget > 0; --verbs) {
      --budget;
      try {
        do_something(in_writer_ ? In::writer : in);
      } catch (const SetupError&) {            // refused
      } catch (const std::runtime_error& e) {  // of a payload that was moved
        CHECK(std::string(e.what()) == "a callback throws");
      }
    }
    --depth_;
    in_writer_ = was_in_writer;
    if (in == In::callback && below(15) == 0) throw std::runtime_error("a callback throws");
  }
  const std::shared_ptr<LaneSide> lane = std::make_shared<LaneSide>();
  /// On a lane of a loop in real time, only this; `side` is locked, and its loop is there.
  void act_on_lane(LaneSide& side) {
    if (side.budget <= 0) return;
    const auto chosen = side.random() % 4;
    if (chosen < 2) {
      --side.budget;
      side.loop->post([this, captured = Captured(*this)] { act(In::callback); });
    } else if (chosen == 2) {
      side.loop->stop();
    }
  }
  /// The loop that lanes may use; null before it goes.
  void give_lanes(Loop* used) {
    const std::lock_guard lock(lane->mutex);
    lane->loop = used;
  }

  /// In random order.
  void close_all() {
    for (int i = 0; i < 40; ++i) close_one(below(kinds), In::outside);
    for (int what = 0; what < kinds; ++what) {
      for (int i = 0; i < slots; ++i) close_at(what, i);
    }
  }
  void open_lane_budget() {
    const std::lock_guard lock(lane->mutex);
    lane->budget = 20;
  }
  std::vector<std::pair<std::string, std::shared_ptr<Stored>>> writers;

 private:
  static constexpr int slots = 3;
  static constexpr int kinds = 8;

  auto handler() {
    return [this, captured = Captured(*this)](const auto&...) { act(In::callback); };
  }
  Duration some_time() {
    switch (below(12)) {
      case 0:
        return Duration::max();
      case 1:
        return Duration::min();
      case 2:
        return 0s;
      default:
        return 100us * (1 + below(50));
    }
  }
  std::string some_topic() { return "t/" + std::to_string(below(3)); }
  std::string some_name() { return "n" + std::to_string(below(6)); }

  struct Device {
    World* world;
    Captured captured;
    bool lies;
    Result<void> open() {
      world->act(In::callback);
      if (world->below(4) == 0) return Error{Errc::io_failed, "cannot open", "", "at random", ""};
      return {};
    }
    Result<Number> read() {
      world->act(In::callback);
      if (world->below(5) == 0) return Error{Errc::io_failed, "cannot read", "", "at random", ""};
      return Number{1};
    }
    void close() { world->act(In::callback); }
  };

  void make(int what, In in) {
    const int i = below(slots);
    switch (what) {
      case 0:
        timers_[i] = Timer(*loop, some_time(), handler());
        return;
      case 1:
        tickers_[i] = Ticker(*loop, {.period = 1ms * (1 + below(3)), .phase = some_time()}, handler());
        return;
      case 2:
        switch (below(4)) {
          case 0:
            subscriptions_[i] = loop->subscribe(below(2) == 0 ? "#" : "t/+", handler());
            return;
          case 1:
            subscriptions_[i] = loop->topic<Meddler>("meddler").subscribe(*loop, handler());
            return;
          case 2:
            subscriptions_[i] = loop->subscribe<Number>("#", handler());
            return;
          default:
            subscriptions_[i] = loop->topic<Number>(some_topic()).subscribe(*loop, handler());
            return;
        }
      case 3: {
        SensorConfig config{
            .name = some_name(), .topic = some_topic(), .rate = Rate::from_period(1ms * (1 + below(3)))};
        config.phase = some_time();
        config.faulted_after = 1 + static_cast<unsigned>(below(3));
        config.retry_first = 1ms;
        config.retry_longest = below(4) == 0 ? Duration::max() : 5ms;
        config.required = below(5) == 0;
        config.start = below(5) != 0;
        config.on_overrun = static_cast<OnOverrun>(below(3));
        if (below(4) == 0) {
          meddlers_[i] = Sensor<Meddler>(*loop, {.name = "m" + some_name(), .topic = "meddler", .rate = config.rate},
                                         [this, captured = Captured(*this)] {
                                           act(In::callback);
                                           return Meddler(*this);
                                         });
        } else {
          sensors_[i] = Sensor<Number>(*loop, config, Device{this, Captured(*this), false});
        }
        return;
      }
      case 4:
        feeds_[i] = Feed<Number>(*loop, {.name = some_name(), .topic = some_topic()});
        return;
      case 5: {
        if (tier != nullptr || other == nullptr || in == In::outside) {
          SinkConfig config{.name = "sink" + std::to_string(writers.size()), .topics = {below(2) == 0 ? "#" : "t/0"}};
          config.batch_rows = static_cast<std::size_t>(1 + below(60));
          config.batch_time = below(4) == 0 ? Duration::max() : 1ms * (1 + below(5));
          config.queue_bytes = 256 << 10;
          config.when_full = below(2) == 0 ? WhenFull::drop_newest : WhenFull::drop_oldest;
          config.retry_first = 1ms;
          config.retry_longest = 4ms;
          config.close_deadline = below(4) == 0 ? 0ms : 200ms;
          auto stored = std::make_shared<Stored>();
          writers.emplace_back(config.name, stored);
          sinks_[i] = Sink(*loop, config, std::make_unique<ChaosWriter>(*this, stored));
        }
        return;
      }
      case 6:
        signals_[i] = SignalWatch(*loop, SIGUSR2, handler());
        return;
      default:
        watches_[i].close();  // one watch a descriptor
        if (watches_[(i + 1) % slots].is_open() || watches_[(i + 2) % slots].is_open()) return;
        watches_[i] = FdWatch(*loop, event_, FdWatch::readable, handler());
        return;
    }
  }

  void close_at(int what, int i) {
    const auto at = static_cast<std::size_t>(i);
    switch (what) {
      case 0:
        return timers_[at].close();
      case 1:
        return tickers_[at].close();
      case 2:
        return subscriptions_[at].close();
      case 3:
        sensors_[at].close();
        return meddlers_[at].close();
      case 4:
        return feeds_[at].close();
      case 5:
        return sinks_[at].close();
      case 6:
        return signals_[at].close();
      default:
        return watches_[at].close();
    }
  }
  void close_one(int what, In) { close_at(what, below(slots)); }

  template <class T>
  void move_some(std::array<T, slots>& handles) {
    T& from = handles[static_cast<std::size_t>(below(slots))];
    T& to = handles[static_cast<std::size_t>(below(slots))];
    switch (below(3)) {
      case 0:
        to = std::move(from);
        return;
      case 1:
        std::swap(from, to);
        return;
      default: {
        const T taken(std::move(from));
        return;
      }
    }
  }
  void move_one(int what) {
    switch (what) {
      case 0:
        return move_some(timers_);
      case 1:
        return move_some(tickers_);
      case 2:
        return move_some(subscriptions_);
      case 3:
        return below(2) == 0 ? move_some(sensors_) : move_some(meddlers_);
      case 4:
        return move_some(feeds_);
      case 5:
        return move_some(sinks_);
      case 6:
        return move_some(signals_);
      default:
        return move_some(watches_);
    }
  }

  void use(int what) {
    const auto i = static_cast<std::size_t>(below(slots));
    switch (what) {
      case 0:
        below(2) == 0 ? timers_[i].start(some_time()) : timers_[i].stop();
        if (below(9) == 0) timers_[i].start_at(MonotonicTime{some_time()});
        return;
      case 1:
        below(3) == 0 ? tickers_[i].start() : below(2) == 0 ? tickers_[i].stop() : tickers_[i].set_period(some_time());
        return;
      case 2:
        subscriptions_[i].set_name("renamed");
        CHECK(subscriptions_[i].counts().balances());
        return;
      case 3:
        return use_sensor(below(2) == 0 ? static_cast<AnySensor&>(sensors_[i]) : meddlers_[i]);
      case 4:
        return use_feed(feeds_[i]);
      case 5:
        switch (below(3)) {
          case 0:
            return sinks_[i].flush();
          case 1:
            return sinks_[i].on_error(handler());
          default:
            CHECK(sinks_[i].status().counts.balances());
            return;
        }
      case 6:
        // A tier's thread takes no signals. Unwatched, it would end the process.
        if (signals_[i].is_open() && !is_of_tier) ::raise(SIGUSR2);
        return;
      default:
        return watches_[i].set_events(below(2) == 0 ? FdWatch::readable : FdWatch::writable);
    }
  }

  void use_sensor(AnySensor& sensor) {
    switch (below(6)) {
      case 0:
        sensor.start();
        return;
      case 1:
        sensor.stop();
        return;
      case 2:
        return sensor.set_rate(Rate::from_period(some_time()));
      case 3:
        return sensor.on_error(handler());
      case 4:
        static_cast<void>(sensor.status());
        return;
      default:
        static_cast<void>(sensor.counts());
        return;
    }
  }

  void use_feed(Feed<Number>& feed) {
    const Error error{Errc::bad_data, "bad", "", "at random", ""};
    switch (below(8)) {
      case 0:
        return feed.publish({1}, Time{some_time()});
      case 1:
        return feed.fail(error);
      case 2:
        return feed.fault(error);
      case 3:
        return feed.repeated();
      case 4:
        feed.set_numbered();
        return feed.lost(1);
      case 5:
        return use_sensor(feed);
      default:
        for (int n = below(40); n >= 0; --n) feed.publish({2});
        return;
    }
  }

  void use_loop(In in) {
    switch (below(in == In::writer ? 14 : 17)) {
      case 0:
        return loop->post([this, captured = Captured(*this)] { act(In::callback); });
      case 1:
        return loop->on_error(handler());
      case 2:
        return loop->runtime().on_log(handler());
      case 3:
        if (below(4) == 0) loop->drain(below(3) == 0 ? some_time() : 100ms, handler());
        return;
      case 4:
        loop->poll();
        return;
      case 5:
        if (is_manual()) loop->advance(1ms);
        if (!is_manual() && in != In::outside && kind_ != Loops::attached) loop->run_for(1ms);
        return;
      case 6:
        if (in != In::outside) loop->close(10ms);
        return;
      case 7:
        return loop->stop();
      case 8:
        static_cast<void>(loop->callbacks());
        static_cast<void>(loop->runtime().sensors());
        static_cast<void>(loop->runtime().sinks());
        static_cast<void>(loop->runtime().topics());
        static_cast<void>(loop->load());
        return;
      case 9:
        static_cast<void>(loop->runtime().balances());
        return;
      case 10:
        if (is_manual()) loop->script_lane_duration(100us * below(30));
        return;
      case 11:
        if (is_manual()) loop->manual_clock().pass(100us * below(30));
        return;
      case 12: {
        const auto noted = loop->runtime().note_wall_clock({loop->now(), Time{some_time()}, "gps", some_time()});
        static_cast<void>(noted);
        return;
      }
      case 13:
        if (tier != nullptr && other != nullptr) (*tier)->call([&](Loop&) { other->act(In::outside); });
        if (tier == nullptr && other != nullptr) other->loop->post([main = other] { main->act(In::callback); });
        return;
      case 14:
        if (tier != nullptr) use_tier();
        return;
      case 15:
        loop->topic<Meddler>("meddler").publish(Meddler(*this));
        return;
      default:
        for (int n = below(40); n >= 0; --n) loop->topic<Number>(some_topic()).publish({3});
        return;
    }
  }

  void use_tier() {
    switch (below(8)) {
      case 0:
        return (*tier)->stop();
      case 1:
        static_cast<void>((*tier)->stop_within(1ms));
        return;
      case 2:
        static_cast<void>((*tier)->doing());
        static_cast<void>(loop->runtime().loops());
        return;
      case 3:
        watch_ = std::make_unique<TierWatch>(*loop, 1ms);
        return;
      case 4:
        watch_.reset();
        return;
      case 5:
        if (below(4) == 0) end_tier();
        return;
      default:
        return (*tier)->start();
    }
  }

 public:
  /// In any callback of the main loop.
  void end_tier() {
    const std::unique_ptr<Tier> ended = tier != nullptr ? std::move(*std::exchange(tier, nullptr)) : nullptr;
    if (ended == nullptr) return;
    World& of_tier = *std::exchange(other, nullptr);
    ended->stop();
    of_tier.other = nullptr;
    if (below(2) == 0) of_tier.close_all();  // else they outlive it
    of_tier.is_ending = true;
    of_tier.give_lanes(nullptr);
  }
  /// Its loop is being destroyed, or is gone.
  bool is_ending = false;

 private:
  void do_something(In in) {
    const int what = below(kinds);
    switch (below(8)) {
      case 0:
      case 1:
        return make(what, in);
      case 2:
        return close_one(what, in);
      case 3:
        return move_one(what);
      case 4:
      case 5:
        return use(what);
      default:
        return use_loop(in);
    }
  }

  const Loops kind_;
  std::mt19937 random_;
  int depth_ = 0;
  bool in_writer_ = false;  // a call of a writer is on the stack, further out too
  int event_ = -1;
  std::array<Timer, slots> timers_;
  std::array<Ticker, slots> tickers_;
  std::array<Subscription, slots> subscriptions_;
  std::array<Sensor<Number>, slots> sensors_;
  std::array<Sensor<Meddler>, slots> meddlers_;
  std::array<Feed<Number>, slots> feeds_;
  std::array<Sink, slots> sinks_;
  std::array<FdWatch, slots> watches_;
  std::array<SignalWatch, slots> signals_;
  std::unique_ptr<TierWatch> watch_;
};

Captured::~Captured() {
  if (world_ != nullptr) world_->act(In::destructor);
}
Meddler::Meddler(Meddler&& other) : world_(other.world_) { world_->act(In::callback); }
Meddler::~Meddler() { world_->act(In::destructor); }

ChaosWriter::ChaosWriter(World& world, std::shared_ptr<Stored> stored)
    : world_(world), is_manual_(world.is_manual()), lane_(world.lane), stored_(std::move(stored)) {}
ChaosWriter::~ChaosWriter() {
  if (is_manual_) world_.act(In::destructor);
}
Result<void> ChaosWriter::on_lane(const char* what) {
  if (is_manual_) {
    world_.act(In::writer);
  } else {
    const std::lock_guard lock(lane_->mutex);
    if (lane_->loop != nullptr) world_.act_on_lane(*lane_);
  }
  if (!lane_->one_in(20)) return {};
  if (lane_->one_in(3)) throw std::runtime_error(what);
  return Error{lane_->one_in(10) ? Errc::closed : Errc::io_failed, "cannot", what, "at random", ""};
}
Result<void> ChaosWriter::write(Batch& batch) {
  if (auto done = on_lane("write"); !done) return done;
  std::vector<Record> taken;
  for (const Record& record : batch) {
    std::uint64_t& last = stored_->last[record.info->topic + " " + record.info->origin];
    if (record.header.sequence <= last) stored_->is_ordered = false;
    last = record.header.sequence;
    if (lane_->one_in(50)) {
      batch.refuse(record, {Errc::does_not_fit, "refused", "", "at random", ""});
    } else {
      stored_->rows.fetch_add(1);
    }
  }
  return {};
}
std::optional<Error> ChaosWriter::take_warning() {
  static_cast<void>(on_lane("take_warning"));
  if (lane_->one_in(8)) return Error{Errc::io_failed, "space runs out", "", "at random", ""};
  return std::nullopt;
}
Result<void> ChaosWriter::add_topic(std::uint32_t, std::string_view, const Description&) {
  world_.act(In::writer);
  if (lane_->one_in(8)) return Error{Errc::does_not_fit, "cannot take it", "", "at random", ""};
  return {};
}
LiveCounts* ChaosWriter::live_counts(std::uint32_t) {
  world_.act(In::writer);
  if (lane_->one_in(8)) throw std::runtime_error("no live counts");
  return nullptr;
}

void check(Loop& loop, World& world) {
  CHECK(loop.runtime().balances());
  const std::vector<SinkStatus> all = loop.runtime().sinks();
  for (const auto& [name, stored] : world.writers) {
    CHECK(stored->is_ordered);
    for (const SinkStatus& sink : all) {
      CHECK(sink.counts.balances());
      if (sink.name == name) CHECK(stored->rows >= sink.counts.stored);
    }
  }
}

void run(Loops kind, unsigned seed) {
  CAPTURE(static_cast<int>(kind));
  CAPTURE(seed);
  World world(kind, seed);
  World tier_world(kind, seed + 77);
  uv_loop_t host;
  std::unique_ptr<Loop> loop;
  std::unique_ptr<Tier> tier;
  if (world.is_manual()) {
    loop = std::make_unique<Loop>(Loop::Manual{.seed = kind == Loops::manual_tiers ? seed : 0});
  } else if (kind == Loops::attached) {
    REQUIRE(uv_loop_init(&host) == 0);
    loop = std::make_unique<Loop>(&host);
  } else {
    loop = std::make_unique<Loop>();
  }
  world.loop = loop.get();
  world.give_lanes(loop.get());
  loop->on_error([](const ErrorReport&) {});
  loop->runtime().on_log([](const LogRecord&) {});
  if (has_tiers(kind)) {
    tier = std::make_unique<Tier>(*loop, Tier::Config{.name = "fast"});
    world.tier = &tier;
    world.other = &tier_world;
    tier_world.is_of_tier = true;
    tier_world.loop = &tier->loop();
    tier_world.give_lanes(&tier->loop());
    tier_world.other = &world;
  }
  for (int round = 0; round < 3; ++round) {
    world.budget = tier_world.budget = 120;
    world.open_lane_budget();
    for (int i = 0; i < 15; ++i) world.act(In::outside);
    if (tier != nullptr) {
      for (int i = 0; i < 15 && tier != nullptr; ++i) tier->call([&](Loop&) { tier_world.act(In::outside); });
    }
    for (int i = 0; i < 5; ++i) {
      if (world.is_manual()) {
        loop->advance(2ms);
      } else if (kind == Loops::attached) {
        Timer end(*loop, 2ms, [] {});
        for (int turns = 0; end.is_running() && turns < 200; ++turns) uv_run(&host, UV_RUN_ONCE);
      } else {
        loop->run_for(2ms);
      }
      if (!has_tiers(kind)) check(*loop, world);
    }
  }
  // What user code does while all is closed, and destroyed, is of a budget of its own.
  world.budget = tier_world.budget = 60;
  const bool closes_first = world.below(2) == 0;
  if (closes_first) world.close_all();
  bool is_drained = false;
  if (kind == Loops::attached) {
    loop->drain(5s, [&](std::uint64_t) { is_drained = true; });
    while (!is_drained && uv_run(&host, UV_RUN_ONCE) != 0) {
    }
    CHECK(is_drained);
  } else {
    loop->stop();  // what was stopped before is over
    static_cast<void>(loop->close(5s));
  }
  world.budget = tier_world.budget = 0;
  world.close_all();
  world.budget = tier_world.budget = 60;
  if (tier != nullptr) {
    tier->stop();
    tier->call([&](Loop&) { tier_world.close_all(); });
    tier_world.budget = 0;
    tier_world.close_all();
    world.end_tier();
  }
  tier_world.loop = nullptr;
  check(*loop, world);
  for (int i = 0; i < 10; ++i) world.act(In::outside);
  world.give_lanes(nullptr);
  loop = nullptr;
  world.loop = nullptr;
  if (kind == Loops::attached) {
    while (uv_run(&host, UV_RUN_DEFAULT) != 0) {
    }
    CHECK(uv_loop_close(&host) == 0);
  }
}

void run_seeds(Loops kind, int few) {
  unsigned long first = 1;
  auto count = static_cast<unsigned long>(few);
  if (const char* asked = std::getenv("RTDATA_TEST_SEEDS")) {
    char* end = nullptr;
    first = std::strtoul(asked, &end, 10);
    count = std::strtoul(end, nullptr, 10);
  }
  for (unsigned long seed = first; seed < first + count; ++seed) run(kind, static_cast<unsigned>(seed));
}

}  // namespace

TEST_SUITE("contract") {
  TEST_CASE("callbacks do anything at random: a manual loop") { run_seeds(Loops::manual, 100); }
  TEST_CASE("callbacks do anything at random: a loop in real time") { run_seeds(Loops::owned, 10); }
  TEST_CASE("callbacks do anything at random: an attached loop") { run_seeds(Loops::attached, 10); }
  TEST_CASE("callbacks do anything at random: tiers") { run_seeds(Loops::tiers, 4); }
  TEST_CASE("callbacks do anything at random: tiers in virtual time") { run_seeds(Loops::manual_tiers, 100); }
}
