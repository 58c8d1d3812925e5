// What a sink does with a Sender, from memory: parcels, the window, answers of all kinds, and its end.
#include <doctest/doctest.h>

#include <algorithm>
#include <memory>
#include <numeric>
#include <optional>

#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/sender.hpp"
#include "sinks/scripted_peer.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

struct Bench {
  Loop loop{Loop::Manual{}};
  std::shared_ptr<ScriptedPeer::Script> peer = std::make_shared<ScriptedPeer::Script>();
  std::vector<std::string> errors;
  double published = 0;

  Bench() {
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
  }
  Sink make(SinkConfig with = {
                .name = "peer", .batch_rows = 30, .batch_time = 10ms, .retry_first = 100ms, .retry_longest = 1s}) {
    return Sink(loop, std::move(with), std::make_unique<ScriptedPeer>(peer));
  }
  void publish(int count) {
    for (int i = 0; i < count; ++i) loop.topic<Number>("a").publish({++published});
  }
  std::vector<std::uint64_t> all() const {
    std::vector<std::uint64_t> sequences(static_cast<std::size_t>(published));
    std::iota(sequences.begin(), sequences.end(), 1);
    return sequences;
  }
};

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE(
      "US-32 from memory, too, the final accounts are sent when all events are settled, however wide the window") {
    for (const std::size_t rows_of_parcel : {10, 7}) {  // with 40 events: accounts in parcels of their own, or not
      CAPTURE(rows_of_parcel);
      Bench bench;
      bench.peer->sending = {.window = 4, .parcel_rows = rows_of_parcel};
      std::size_t beside_events = 0, accounts = 0;
      bench.peer->on_send = [&](const Parcel& parcel, Answer answer) {
        const bool is_account = parcel.rows().back().info->topic == account_topic;
        accounts += is_account ? 1 : 0;
        if (is_account && bench.peer->events.size() + parcel.rows().size() < 40) ++beside_events;
        bench.peer->hold(parcel, std::move(answer));
      };
      Sink sink = bench.make({.name = "peer", .topics = {"#", account_topic}, .batch_rows = 1000, .batch_time = 1h});
      std::vector<std::unique_ptr<Feed<Number>>> feeds;
      for (int i = 0; i < 20; ++i)
        feeds.push_back(std::make_unique<Feed<Number>>(
            bench.loop, FeedConfig{.name = "chamber" + std::to_string(i), .topic = "room"}));
      for (int i = 0; i < 40; ++i) feeds[static_cast<std::size_t>(i % 20)]->publish({static_cast<double>(i)});
      std::optional<std::uint64_t> lost;
      bench.loop.drain(20s, [&](std::uint64_t count) { lost = count; });
      for (int turn = 0; turn < 1000 && !lost; ++turn) {
        bench.loop.advance(10ms);
        while (!bench.peer->held.empty()) bench.peer->take_held(bench.peer->held.size() - 1);  // the later ones first
      }
      CHECK(lost == 0);
      REQUIRE(bench.peer->events.size() == 60);
      CHECK(beside_events == 0);
      CHECK(accounts >= 2);
      CHECK(bench.peer->most_held > 1);
      const auto first_account = std::find_if(bench.peer->events.begin(), bench.peer->events.end(),
                                              [](const auto& event) { return event.topic == account_topic; });
      CHECK(std::all_of(first_account, bench.peer->events.end(),
                        [](const auto& event) { return event.topic == account_topic; }));
    }
  }

  TEST_CASE("US-32 events go to a peer in parcels, in order, each with its key") {
    Bench bench;
    Sink sink = bench.make();
    bench.publish(95);
    bench.loop.advance(2s);
    CHECK(bench.peer->sequences() == bench.all());
    CHECK(bench.peer->sent == 10);
    CHECK(sink.counts().stored == 95);
    CHECK(sink.counts().queued == 0);
    CHECK(sink.counts().balances());
    for (const auto& event : bench.peer->events) {
      CHECK(event.run.size() == 36);
      CHECK(event.run == bench.peer->events.front().run);
      CHECK(event.topic == "a");
    }
    CHECK(bench.loop.close(1s) == 0);
    CHECK(bench.peer->begun == 1);
    CHECK(bench.peer->ended == 1);
    CHECK(bench.peer->cancelled == 0);
  }

  TEST_CASE("no more parcels than the window are under way; they are answered in any order and counted in order") {
    Bench bench;
    bench.peer->sending.window = 3;
    bench.peer->on_send = [&](const Parcel& parcel, Answer answer) { bench.peer->hold(parcel, std::move(answer)); };
    Sink sink = bench.make({.name = "peer", .batch_rows = 60});
    bench.publish(60);
    bench.loop.advance(100ms);
    REQUIRE(bench.peer->held.size() == 3);
    bench.peer->take_held(2);
    bench.peer->take_held(1);
    bench.loop.advance(1ms);
    CHECK(bench.peer->held.size() == 3);
    CHECK(sink.counts().stored == 0);
    CHECK(sink.counts().queued == 60);
    bench.peer->take_held(0);
    CHECK(sink.counts().stored == 30);
    CHECK(sink.counts().balances());
    while (!bench.peer->held.empty()) {
      bench.peer->take_held(0);
      bench.loop.advance(1ms);
    }
    CHECK(sink.counts().stored == 60);
    CHECK(bench.peer->most_held == 3);
    auto sequences = bench.peer->sequences();
    std::sort(sequences.begin(), sequences.end());
    CHECK(sequences == bench.all());
  }

  TEST_CASE("a long backlog of topics that take turns goes out in order, each event once") {
    Bench bench;
    bool is_away = true;
    bench.peer->take_unless(is_away);
    Sink sink = bench.make();
    constexpr int count = 40'000;  // 32 bytes each: twenty chunks of the queue
    for (int i = 0; i < count; ++i) {
      bench.publish(1);
      if (i % 7 == 0) bench.loop.topic<Number>("b").publish({0});
    }
    bench.loop.advance(100ms);
    CHECK(bench.peer->events.empty());
    is_away = false;
    bench.loop.advance(5s);
    std::vector<std::uint64_t> of_a, of_b;
    for (const auto& event : bench.peer->events) (event.topic == "a" ? of_a : of_b).push_back(event.sequence);
    CHECK(of_a == bench.all());
    CHECK(of_b.size() == (count + 6) / 7);
    CHECK(std::is_sorted(of_b.begin(), of_b.end()));
    CHECK(sink.counts().stored == bench.peer->events.size());
    CHECK(sink.counts().balances());
  }

  TEST_CASE("what the peer does not have is sent again: nothing is lost while it is away, and the delay doubles") {
    Bench bench;
    bool is_away = true;
    bench.peer->take_unless(is_away);
    Sink sink = bench.make();
    bench.publish(50);
    bench.loop.advance(10s);
    CHECK(sink.health() == Health::faulted);
    CHECK(sink.status().reason.find("it is away") != std::string::npos);
    CHECK(bench.peer->sent >= 10);
    CHECK(bench.peer->sent <= 16);  // 100, 200, 400, 800 ms, then each second, less some jitter; one parcel each
    CHECK(sink.counts().queued == 50);
    CHECK(!bench.errors.empty());
    is_away = false;
    bench.loop.advance(2s);
    CHECK(sink.health() == Health::ok);
    CHECK(bench.peer->sequences() == bench.all());
    CHECK(sink.counts().stored == 50);
    CHECK(sink.counts().balances());
  }

  TEST_CASE("the peer's own wish is what is waited for") {
    Bench bench;
    std::vector<MonotonicTime> at;
    bench.peer->on_send = [&](const Parcel& parcel, Answer answer) {
      at.push_back(bench.loop.now());
      if (at.size() == 1) return answer.again(away, 7s);
      bench.peer->take(parcel, std::move(answer));
    };
    Sink sink = bench.make();
    bench.publish(5);
    bench.loop.advance(20s);
    REQUIRE(at.size() == 2);
    CHECK(at[1] - at[0] >= 7s);
    CHECK(at[1] - at[0] < 7s + 10ms);
  }

  TEST_CASE("rows that the peer or the format refuses are dropped, counted and reported") {
    Bench bench;
    bench.peer->unencodable = 5;
    bench.peer->on_send = [&](const Parcel& parcel, Answer answer) {
      for (std::size_t i = 0; i < parcel.rows().size(); ++i) {
        if (parcel.rows()[i].sequence % 7 != 0) continue;
        answer.refuse(i, {Errc::bad_data, "refused", "peer", "a multiple of seven", ""});
        answer.refuse(i, {Errc::bad_data, "refused", "peer", "twice", ""});
      }
      answer.acknowledge();
    };
    Sink sink = bench.make();
    bench.publish(30);
    bench.loop.advance(2s);
    CHECK(sink.counts().stored == 30 - 1 - 4);
    CHECK(sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] == 5);
    CHECK(sink.counts().balances());
    CHECK(sink.health() == Health::ok);
    REQUIRE(bench.errors.size() == 1);
    CHECK(bench.errors[0].find("the first of 5") != std::string::npos);
  }

  TEST_CASE("a parcel without an answer is given up and sent again, and an answer that comes too late is ignored") {
    Bench bench;
    Answer late;
    bench.peer->on_send = [&](const Parcel& parcel, Answer answer) {
      if (bench.peer->sent == 1) {
        late = std::move(answer);
        return;
      }
      bench.peer->take(parcel, std::move(answer));
    };
    Sink sink = bench.make();
    bench.publish(10);
    bench.loop.advance(1050ms);
    CHECK(sink.health() == Health::faulted);
    CHECK(bench.peer->cancelled == 1);
    CHECK(!late);
    late.acknowledge();
    CHECK(sink.counts().stored == 0);
    bench.loop.advance(2s);
    CHECK(bench.peer->sequences() == bench.all());
    CHECK(sink.counts().stored == 10);
    late.again(away);
    CHECK(sink.health() == Health::ok);
  }

  TEST_CASE("the time for an answer is that of the parcel which waits longest, whatever is answered around it") {
    Bench bench;
    std::vector<Answer> kept;
    bench.peer->on_send = [&](const Parcel& parcel, Answer answer) {
      if (bench.peer->sent == 2) {
        kept.push_back(std::move(answer));  // for ever
      } else {
        bench.peer->take(parcel, std::move(answer));
      }
    };
    Sink sink = bench.make();
    bench.publish(30);
    bench.loop.advance(500ms);
    const std::uint64_t before = sink.counts().stored;
    CHECK(before > 0);
    CHECK(before < 30);
    bench.loop.advance(400ms);
    CHECK(bench.peer->cancelled == 0);
    CHECK(sink.health() == Health::ok);
    bench.loop.advance(150ms);
    CHECK(bench.peer->cancelled == 1);
    bench.loop.advance(2s);
    CHECK(sink.counts().stored == 30);
    CHECK(bench.peer->cancelled == 1);
    CHECK(sink.health() == Health::ok);
  }

  TEST_CASE("an answer that is forgotten, and a sender that throws, are failures like others") {
    Bench bench;
    bench.peer->on_send = [&](const Parcel& parcel, Answer answer) {
      if (bench.peer->sent == 1) return;
      if (bench.peer->sent == 2) throw std::runtime_error("out of luck");
      bench.peer->take(parcel, std::move(answer));
    };
    Sink sink = bench.make();
    bench.publish(10);
    bench.loop.advance(5s);
    CHECK(bench.peer->sequences() == bench.all());
    REQUIRE(bench.errors.size() == 2);  // each failure once
    CHECK(bench.errors[0].find("gave no answer") != std::string::npos);
    CHECK(bench.errors[1].find("out of luck") != std::string::npos);
  }

  TEST_CASE("a sender that throws while it holds the answer waits for no time-out, and nothing is counted twice") {
    Bench bench;
    bench.peer->sending.timeout = 1h;
    bench.peer->on_send = [&](const Parcel& parcel, Answer answer) {
      if (bench.peer->sent != 2) return bench.peer->take(parcel, std::move(answer));
      bench.peer->hold(parcel, std::move(answer));
      throw std::runtime_error("out of luck");
    };
    Sink sink = bench.make();
    bench.publish(30);
    bench.loop.advance(50ms);
    CHECK(sink.health() == Health::faulted);
    CHECK(sink.status().reason.find("out of luck") != std::string::npos);
    CHECK(bench.peer->cancelled == 1);
    CHECK(sink.counts().stored == 10);
    bench.loop.advance(1s);
    CHECK(bench.peer->sequences() == bench.all());
    CHECK(sink.counts().stored == 30);
    CHECK(sink.counts().balances());
    CHECK(sink.health() == Health::ok);
    CHECK(bench.errors.size() == 1);
  }

  TEST_CASE("a sender that throws after it has answered is told, and what it answered holds") {
    Bench bench;
    bench.peer->on_send = [&](const Parcel& parcel, Answer answer) {
      if (bench.peer->sent == 1) answer.refuse(3, away);
      bench.peer->take(parcel, std::move(answer));
      throw std::runtime_error("out of luck");
    };
    Sink sink = bench.make();
    bench.publish(30);
    bench.loop.advance(20ms);
    CHECK(bench.peer->sent == 3);  // nothing waits
    CHECK(sink.counts().stored == 29);
    CHECK(sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] == 1);
    CHECK(sink.counts().balances());
    CHECK(sink.health() == Health::ok);
    CHECK(std::count_if(bench.errors.begin(), bench.errors.end(), [](const std::string& error) {
            return error.find("out of luck") != std::string::npos;
          }) == 1);  // the same again is joined
    CHECK(bench.loop.close(1s) == 0);
  }

  TEST_CASE("a sender that throws when it begins is tried again, and begins once") {
    Bench bench;
    int attempts = 0;
    bench.peer->on_begin = [&] {
      if (++attempts < 3) throw std::runtime_error("not yet");
    };
    Sink sink = bench.make();
    bench.publish(30);
    bench.loop.advance(20ms);
    CHECK(sink.health() == Health::faulted);
    CHECK(bench.peer->sent == 0);
    bench.loop.advance(1s);
    CHECK(attempts == 3);
    CHECK(bench.peer->begun == 1);
    CHECK(bench.peer->sequences() == bench.all());
    CHECK(sink.health() == Health::ok);
    CHECK(bench.errors.size() == 2);
  }

  TEST_CASE(
      "US-32 a sender from memory sends UTC as it is known when it sends; what was queued before the clock was set, "
      "too") {
    ManualClock clock;
    Runtime runtime({.clock = &clock});
    Loop loop(runtime, {});
    auto peer = std::make_shared<ScriptedPeer::Script>();
    Sink sink(loop, {.name = "peer", .batch_time = 1s}, std::make_unique<ScriptedPeer>(peer));
    const Time start = loop.time();
    loop.topic<Number>("a").publish({1});
    loop.advance(2s);
    loop.topic<Number>("a").publish({2});  // waits in memory while the clock is set
    clock.set_realtime(clock.realtime() + 1h);
    loop.advance(2s);
    loop.topic<Number>("a").publish({3});
    loop.advance(2s);
    REQUIRE(peer->events.size() == 3);
    CHECK(peer->events[0].time == start);
    CHECK(peer->events[1].time == start + 2s + 1h);
    CHECK(peer->events[2].time == start + 4s + 1h);
  }

  TEST_CASE("a limit on bytes is kept, on average") {
    Bench bench;
    bench.peer->sending.bytes_per_second = 800;  // 100 events
    Sink sink = bench.make();
    bench.publish(1000);
    bench.loop.advance(5s);
    CHECK(sink.counts().stored >= 400);
    CHECK(sink.counts().stored <= 520);
    bench.loop.advance(6s);
    CHECK(bench.peer->sequences() == bench.all());
  }

  TEST_CASE("closing sends what is left; when the peer stays away the rest is lost, counted and told, in time") {
    for (const bool is_away : {false, true}) {
      Bench bench;
      bench.peer->on_send = [&](const Parcel& parcel, Answer answer) {
        if (is_away) return bench.peer->hold(parcel, std::move(answer));
        bench.peer->take(parcel, std::move(answer));
      };
      Sink sink = bench.make();
      bench.publish(25);
      const MonotonicTime begin = bench.loop.now();
      CHECK(bench.loop.close(3s) == (is_away ? 25 : 0));
      CHECK(bench.loop.now() - begin <= 3s + 10ms);
      CHECK(bench.peer->ended == 1);
      CHECK((bench.peer->cancelled > 1) == is_away);  // its time-outs, and the end
    }
  }

  TEST_CASE("of a parcel that is answered before the end, what was acknowledged is counted as stored") {
    Bench bench;
    bench.peer->on_send = [&](const Parcel& parcel, Answer answer) {
      if (bench.peer->sent == 2) return bench.peer->hold(parcel, std::move(answer));
      bench.peer->take(parcel, std::move(answer));
    };
    Sink sink = bench.make();
    bench.publish(25);
    CHECK(bench.loop.close(500ms) == 15);
    const SinkStatus status = bench.loop.runtime().sinks().back();
    CHECK(status.counts.stored == 10);
    CHECK(status.counts.balances());
  }

  TEST_CASE("a sink with a sender is destroyed in each state, and in its own error handler") {
    for (int state = 0; state < 4; ++state) {
      Bench bench;
      std::optional<Sink> sink;
      bench.peer->on_send = [&](const Parcel& parcel, Answer answer) {
        if (state == 1) return bench.peer->hold(parcel, std::move(answer));
        if (state >= 2) return answer.again(away);
        bench.peer->take(parcel, std::move(answer));
      };
      sink.emplace(bench.make());
      if (state == 3) sink->on_error([&](const ErrorReport&) { sink.reset(); });
      bench.publish(40);
      if (state > 0) bench.loop.advance(1200ms);
      sink.reset();
      bench.loop.advance(5s);
      const SinkStatus status = bench.loop.runtime().sinks().back();
      CHECK(status.counts.offered >= 30);
      CHECK(status.counts.balances());
    }
  }

  TEST_CASE("a peer that does not answer costs no tick of a sensor") {
    Bench bench;
    bench.peer->on_send = [&](const Parcel& parcel, Answer answer) { bench.peer->hold(parcel, std::move(answer)); };
    Sink sink = bench.make();
    std::uint64_t missed = 0, ticks = 0;
    Ticker ticker(bench.loop, {.period = 1ms}, [&](const Tick& tick) {
      missed += tick.missed;
      ++ticks;
      bench.publish(1);
    });
    bench.loop.advance(5s);
    CHECK(ticks >= 5000);
    CHECK(missed == 0);
    CHECK(sink.counts().balances());
  }
}
