// What happens to a recording, and to the clock, while sinks that go through it send.
#include <doctest/doctest.h>
#include <sys/mount.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>

#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"
#include "sinks/killed.hpp"
#include "sinks/through_run.hpp"

using namespace sinks;
using recordings::Folder;

namespace {

SinkCounts last_counts(Loop& loop, const std::string& name) {
  for (const SinkStatus& sink : loop.runtime().sinks())
    if (sink.name == name) return sink.counts;
  return {};
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE(
      "US-32 a clock that is set by an hour while parcels are under way: each event once, in order, with its UTC") {
    for (const Duration hour : {Duration{1h}, Duration{-1h}}) {
      CAPTURE(hour.count());
      Folder folder;
      ManualClock clock(Time{} + std::chrono::hours{24 * 20'000});
      clock.set_accuracy(2ms);
      Runtime runtime({.clock = &clock});
      runtime.on_log([](const LogRecord&) {});
      Loop loop(runtime, {});
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
      auto peer = std::make_shared<ScriptedPeer::Script>();
      peer->sending.timeout = 30s;
      bool holds = true;
      peer->on_send = [&](const Parcel& parcel, Answer answer) {
        if (holds) return peer->hold(parcel, std::move(answer));
        peer->take(parcel, std::move(answer));
      };
      SqliteSink recording(loop, {.path = folder / "run.db", .sink = {.name = "recording"}});
      Sink sink(loop, {.name = "peer", .batch_time = 100ms, .through = "recording"},
                std::make_unique<ScriptedPeer>(peer));
      std::vector<Time> right;
      Ticker ticker(loop, {.period = 10ms}, [&](const Tick&) {
        right.push_back(clock.realtime());
        loop.topic<Number>("a").publish({static_cast<double>(right.size())});
      });
      loop.advance(5s);
      REQUIRE(peer->held.size() == 1);
      const std::uint64_t under_way = peer->held_parcels[0]->rows().back().sequence;
      const std::size_t before = right.size();
      clock.set_realtime(clock.realtime() + hour);  // the deadlines of parcels are of another clock
      loop.advance(10s);
      CHECK(peer->sent == 1);
      CHECK(peer->cancelled == 0);
      holds = false;
      while (!peer->held.empty()) peer->take_held(0);
      loop.advance(10s);
      ticker.close();
      loop.advance(1s);
      CHECK(count_all_once(*peer) == right.size());
      CHECK(errors.empty());
      CHECK(sink.counts().stored == right.size());
      CHECK(sink.counts().balances());
      CHECK(loop.close(5s) == 0);
      recordings::check_balanced(folder / "run.db");
      // What was read after the clock was set has the UTC that the recording has, and from then on what the clock
      // showed.
      for (const auto& event : peer->events) {
        if (event.sequence <= under_way) continue;
        const Duration off = event.time - right.at(event.sequence - 1);
        if (event.sequence > before) CHECK_MESSAGE(std::chrono::abs(off) <= 5ms, event.sequence);
        if (event.sequence % 100 != 0) continue;
        const std::int64_t utc = recordings::number(
            folder / "run.db", "SELECT utc_ns FROM \"a~utc\" WHERE sequence = " + std::to_string(event.sequence));
        CHECK_MESSAGE(std::abs(to_nanoseconds(event.time) - utc) <= 5'000'000, event.sequence);
      }
    }
  }

  TEST_CASE("another program locks the recording while it is sent: what is committed goes out, the rest follows") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db";
    Run run(path, peer);
    run.publish(100);
    run.loop.advance(2s);
    REQUIRE(peer->events.size() == 100);
    {
      auto other = sqlite::Database::open(path, sqlite::Database::Mode::write);
      other.execute("BEGIN IMMEDIATE");  // in a log of its own, others may read
      run.publish(50);
      run.loop.advance(1s);
      CHECK(peer->events.size() == 100);
      CHECK(run.recording.health() == Health::faulted);
      CHECK(run.sink.health() == Health::ok);
      CHECK(run.recording.counts().queued == 50);
      other.execute("ROLLBACK");
    }
    run.publish(7);
    run.loop.advance(5s);
    CHECK(count_all_once(*peer) == 157);
    CHECK(run.recording.health() == Health::ok);
    CHECK(run.sink.counts().stored == 157);
    CHECK(run.loop.close(5s) == 0);
    recordings::check_balanced(path);
  }

  TEST_CASE("the disk of the recording is full while it is sent: nothing is lost, and all is sent once there is room") {
    Folder folder;
    const int status = status_of([&] {
      const std::string disk = folder / "disk";
      std::filesystem::create_directory(disk);
      if (::unshare(CLONE_NEWNS) != 0 || ::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
          ::mount("none", disk.c_str(), "tmpfs", 0, "size=512k") != 0)
        ::_exit(77);
      const auto need = [](bool is_so, int step) {
        if (!is_so) ::_exit(step);
      };
      std::ofstream(disk + "/ballast") << std::string(160'000, 'x');
      bool is_away = true;
      const Peer peer = peer_away_while(is_away);
      Run run(disk + "/run.db", peer);
      int seconds = 0;
      for (; run.recording.health() != Health::faulted && seconds < 200; ++seconds) {
        run.publish(100);
        run.loop.advance(1s);
      }
      need(run.recording.health() == Health::faulted, 2);
      need(run.recording.counts().all_dropped() == 0, 3);
      // The peer is there again: what is committed goes out, although no position finds room.
      const std::uint64_t committed = run.recording.counts().stored;
      is_away = false;
      run.loop.advance(5s);
      need(peer->events.size() == committed, 4);
      need(run.recording.health() == Health::faulted, 5);
      std::filesystem::remove(disk + "/ballast");
      run.loop.advance(5s);
      run.publish(10);
      run.loop.advance(5s);
      need(run.recording.health() == Health::ok, 6);
      need(count_all_once(*peer) == static_cast<std::size_t>(run.published), 7);
      need(run.sink.counts().stored == static_cast<std::uint64_t>(run.published) && run.sink.counts().balances(), 8);
      need(run.loop.close(5s) == 0, 9);
      need(recordings::verified(disk + "/run.db").verdict() == Verdict::balanced, 10);
      ::_exit(0);
    });
    if (WIFEXITED(status) && WEXITSTATUS(status) == 77) {
      MESSAGE("skipped: mounting a small file system is not permitted here");
      return;
    }
    CHECK(WIFEXITED(status));
    CHECK(WEXITSTATUS(status) == 0);
  }

  TEST_CASE(
      "a disk that is full at the start ends nothing: what waits in the recording is sent, and it records later") {
    Folder folder;
    const int status = status_of([&] {
      const std::string disk = folder / "disk";
      std::filesystem::create_directory(disk);
      if (::unshare(CLONE_NEWNS) != 0 || ::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
          ::mount("none", disk.c_str(), "tmpfs", 0, "size=1m") != 0)
        ::_exit(77);
      const auto need = [](bool is_so, int step) {
        if (!is_so) ::_exit(step);
      };
      bool is_away = true;
      const Peer peer = peer_away_while(is_away);
      {
        Run before(disk + "/run.db", peer);
        before.publish(100);
        before.loop.advance(5s);
        need(before.loop.close(5s) == 0, 2);
      }
      {
        std::ofstream ballast(disk + "/ballast");
        while (ballast << std::string(1024, 'x') << std::flush) {
        }
      }
      is_away = false;
      Run run(disk + "/run.db", peer);  // does not throw
      need(run.recording.health() == Health::faulted, 3);
      run.publish(10);
      run.loop.advance(5s);
      need(peer->events.size() == 100, 4);
      need(run.recording.health() == Health::faulted, 5);
      std::filesystem::remove(disk + "/ballast");
      run.loop.advance(10s);
      need(run.recording.health() == Health::ok, 6);
      need(run.sink.health() == Health::ok, 7);
      need(count_all_once(*peer) == 110, 8);
      need(run.loop.close(5s) == 0, 9);
      need(recordings::verified(disk + "/run.db").verdict() == Verdict::balanced, 10);
      ::_exit(0);
    });
    if (WIFEXITED(status) && WEXITSTATUS(status) == 77) {
      MESSAGE("skipped: mounting a small file system is not permitted here");
      return;
    }
    CHECK(WIFEXITED(status));
    CHECK(WEXITSTATUS(status) == 0);
  }

  TEST_CASE(
      "a recording that is deleted while parcels are under way: their answers count, and the sink says why it ends") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    peer->on_send = [&](const Parcel& parcel, Answer answer) { peer->hold(parcel, std::move(answer)); };
    const std::string path = folder / "run.db";
    Run run(path, peer);
    run.publish(20);
    run.loop.advance(1500ms);
    REQUIRE(peer->held.size() == 2);
    std::filesystem::remove(path);
    run.publish(20);
    run.loop.advance(500ms);
    while (!peer->held.empty()) peer->take_held(0);
    run.loop.advance(2s);
    CHECK(run.sink.health() == Health::faulted);
    CHECK(run.sink.status().reason.find("has ended") != std::string::npos);
    CHECK(run.sink.counts().stored == 20);
    CHECK(run.sink.counts().balances());
    CHECK(count_all_once(*peer) == 20);
    const MonotonicTime begin = run.loop.now();
    (void)run.loop.close(5s);
    CHECK(run.loop.now() - begin <= 5s);
  }

  TEST_CASE("rows that a limit deletes while they are under way are sent and not counted as dropped") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    peer->sending.timeout = 10min;
    bool holds = true;
    peer->on_send = [&](const Parcel& parcel, Answer answer) {
      if (holds) return peer->hold(parcel, std::move(answer));
      peer->take(parcel, std::move(answer));
    };
    Run run(folder / "run.db", peer, {.name = "peer"}, {.path = "", .max_age = 5s});
    Ticker ticker(run.loop, {.period = 10ms}, [&](const Tick&) { run.publish(1); });
    run.loop.advance(2s);
    REQUIRE(peer->held.size() == 2);
    std::set<std::uint64_t> under_way;
    for (const Parcel* parcel : peer->held_parcels)
      for (const auto& row : parcel->rows()) under_way.insert(row.sequence);
    run.loop.advance(30s);  // they are older than the limit by far
    REQUIRE(recordings::number(folder / "run.db", "SELECT min(sequence) FROM a") >
            static_cast<std::int64_t>(*under_way.rbegin()));
    holds = false;
    while (!peer->held.empty()) peer->take_held(0);
    run.loop.advance(10s);
    ticker.close();
    CHECK(run.loop.close(5s) == 0);
    std::set<std::uint64_t> arrived;
    for (const auto& event : peer->events) arrived.insert(event.sequence);
    CHECK(arrived.size() == peer->events.size());
    for (const std::uint64_t sequence : under_way) CHECK(arrived.count(sequence) == 1);
    const SinkCounts counts = last_counts(run.loop, "peer");
    CHECK(counts.offered == static_cast<std::uint64_t>(run.published));
    CHECK(counts.stored == arrived.size());
    CHECK(counts.all_dropped() == counts.offered - counts.stored);
    CHECK(counts.queued == 0);
    CHECK(Recording::open(folder / "run.db").or_throw().backlogs().or_throw().at(0).unsent == counts.all_dropped());
  }

  TEST_CASE("a backlog of a week: in order, in turns, with no more memory than a batch needs") {
    constexpr int fast = 150'000, slow = 1500;
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    peer->sending = {.window = 4, .parcel_rows = 500};
    bool is_away = true;
    std::size_t largest = 0;
    peer->on_send = [&](const Parcel& parcel, Answer answer) {
      if (is_away) return answer.again(away);
      largest = std::max(largest, parcel.rows().size());
      peer->take(parcel, std::move(answer));
    };
    const std::string path = folder / "run.db";
    {
      Run run(path, peer);
      // A week at one event in 4 s, of one topic; another has a hundredth of that.
      for (int hour = 0; hour < 168; ++hour) {
        run.publish((fast + 167 - hour) / 168);
        run.publish((slow + 167 - hour) / 168, "b");
        run.loop.advance(1h);
      }
      CHECK(run.sink.counts().queued == static_cast<std::uint64_t>(run.published));
      CHECK(run.loop.close(5s) == 0);
      CHECK(run.published == fast + slow);
    }
    is_away = false;
    Run run(path, peer);
    run.loop.advance(1min);
    CHECK(count_all_once(*peer) == fast + slow);
    CHECK(run.sink.counts().offered == fast + slow);
    CHECK(run.sink.counts().stored == fast + slow);
    CHECK(run.sink.counts().queued == 0);
    CHECK(largest <= 500);
    std::size_t last_of_slow = 0;
    for (std::size_t i = 0; i < peer->events.size(); ++i)
      if (peer->events[i].topic == "b") last_of_slow = i;
    CHECK(last_of_slow < (fast + slow) / 4);  // the fast topic does not hold it back
    CHECK(run.loop.close(5s) == 0);
  }
}
