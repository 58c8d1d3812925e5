// Sinks that go through a recording: what is committed there is sent, in order, once it is; the position is kept in it.
#include <doctest/doctest.h>

#include <csignal>
#include <filesystem>
#include <map>
#include <numeric>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "recording/sqlite_writer.hpp"
#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/recording/export.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/sender.hpp"
#include "sinks/core/row_feed.hpp"
#include "sinks/killed.hpp"
#include "sinks/through_run.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;
using namespace rtdata::literals;
using recordings::Folder;
using recordings::number;
using recordings::sql;

namespace {

std::uint64_t unsent_in(const std::string& path) {
  return Recording::open(path).or_throw().backlogs().or_throw().at(0).unsent;
}

Verdict verdict_of(const std::string& path) { return verify(Recording::open(path).or_throw()).or_throw().verdict(); }

struct Falling {
  std::int64_t ROWID = 0;
  double oid = 0;
  RTDATA_FIELDS(Falling, (ROWID), (oid))
};

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-32 what is recorded is sent once it is committed, with the key that it has in the recording") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db";
    {
      Run run(path, peer);
      run.publish(250);
      run.publish(40, "b/c");
      run.loop.advance(1s);
      CHECK(count_all_once(*peer) == 290);
      CHECK(run.sink.counts().stored == 290);
      CHECK(run.sink.counts().offered == 290);
      CHECK(run.sink.counts().queued == 0);
      run.publish(17);
      CHECK(run.loop.close(5s) == 0);  // rows first, then what is to be sent, then the recording
      CHECK(run.errors.empty());
    }
    CHECK(count_all_once(*peer) == 307);
    auto recorded = Recording::open(path).or_throw();
    const auto runs = recorded.runs().or_throw();
    REQUIRE(runs.size() == 1);
    CHECK(runs[0].state == RunState::closed);
    CHECK(peer->events.front().run == runs[0].uuid);
    CHECK(verdict_of(path) == Verdict::balanced);
    CHECK(number(path, "SELECT row FROM rtdata_position WHERE sink = 'peer' AND table_name = 'a'") == 267);
    CHECK(number(path, "SELECT row FROM rtdata_position WHERE sink = 'peer' AND table_name = 'b/c'") == 40);
  }

  TEST_CASE("while the peer is away everything waits in the recording, over starts, and goes out in order") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db";
    bool is_away = true;
    peer->take_unless(is_away);
    for (int start = 0; start < 3; ++start) {
      Run run(path, peer);
      run.publish(100);
      run.loop.advance(3s);
      CHECK(run.sink.health() == Health::faulted);
      CHECK(run.sink.counts().queued == 100 * static_cast<std::uint64_t>(start + 1));
      const MonotonicTime begin = run.loop.now();
      CHECK(run.loop.close(10s) == 0);  // nothing is lost, and the peer is not waited for
      CHECK(run.loop.now() - begin < 2s);
      CHECK(run.loop.runtime().sinks().back().counts.balances());
    }
    CHECK(peer->events.empty());
    is_away = false;
    Run run(path, peer);
    run.publish(5);
    run.loop.advance(3s);
    CHECK(count_all_once(*peer) == 305);
    CHECK(run.sink.counts().stored == 305);
    CHECK(run.sink.counts().balances());
    CHECK(run.loop.close(1s) == 0);
    CHECK(verdict_of(path) == Verdict::balanced);
  }

  TEST_CASE("what is recorded after a kill that came before the sink looked into the recording is sent, too") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db";
    {  // its first transaction says that the sink is there
      sqlite::RunInfo info;
      info.started = Time{1s};
      sqlite::SqliteWriter writer({.path = path}, info);
      REQUIRE(writer.open());
      detail::RowFeedConfig config;
      config.sink = "peer";
      config.topics = {"#"};
      const auto feed = writer.feed(config);
      REQUIRE(writer.flush());
    }
    {
      Loop loop{Loop::Manual{}};
      loop.runtime().on_log([](const LogRecord&) {});
      SqliteSink recording(loop, {.path = path});
      for (int i = 1; i <= 30; ++i) loop.topic<Number>("a").publish({static_cast<double>(i)});
      CHECK(loop.close(5s) == 0);
    }
    const auto waiting = Recording::open(path).or_throw().backlogs().or_throw();
    REQUIRE(waiting.size() == 1);
    CHECK(waiting[0].events == 30);
    Run run(path, peer);
    run.published = 30;
    run.publish(5);
    run.loop.advance(3s);
    CHECK(count_all_once(*peer) == 35);
    CHECK(run.loop.close(1s) == 0);
  }

  TEST_CASE("events with times of before the start are sent, too, and a sink that comes later gets what is committed") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>(), other = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db";
    Run run(path, peer);
    Feed<Number> feed(run.loop, {.name = "old", .topic = "a"});
    const auto publish = [&](Time time) { feed.publish({++run.published}, time); };
    for (int i = 1; i <= 100; ++i) publish(Time{1s} + i * 1ms);
    run.loop.advance(2s);
    publish(run.loop.time());
    publish(Time{1s});  // a late one
    run.loop.advance(2s);
    CHECK(count_all_once(*peer) == 102);
    const Sink late(run.loop, {.name = "late", .through = "recording"}, std::make_unique<ScriptedPeer>(other));
    for (int i = 0; i < 10; ++i) publish(Time{2s});
    run.loop.advance(2s);
    CHECK(other->events.size() == 10);
    CHECK(count_all_once(*peer) == 112);
    CHECK(run.loop.close(5s) == 0);
    CHECK(number(path, "SELECT row FROM rtdata_position WHERE sink = 'late' AND table_name = 'a'") == 112);
    CHECK(verdict_of(path) == Verdict::balanced);
  }

  TEST_CASE("a topic that is added to a sink begins with what comes then, or at its first row, as a new sink does") {
    for (const From from : {From::now, From::beginning}) {
      CAPTURE(static_cast<int>(from));
      Folder folder;
      auto peer = std::make_shared<ScriptedPeer::Script>();
      const std::string path = folder / "run.db";
      std::size_t came = 0;
      for (const char* const topics : {"a", "#"}) {
        Run run(path, peer, {.name = "peer", .topics = {topics}, .from = from});
        run.published = static_cast<double>(came);
        run.publish(10, "a");
        run.publish(10, "b");
        run.loop.advance(3s);
        CHECK(run.loop.close(1s) == 0);
        const std::size_t expected = came == 0 ? 10 : from == From::now ? 30 : 40;
        CHECK(peer->events.size() == expected);
        came = peer->events.size();
      }
    }
  }

  TEST_CASE("what is recorded while it closes waits for a peer that is away then, whenever it closes") {
    for (const auto before : {0ms, 1ms, 500ms, 999ms, 1000ms, 1001ms}) {
      Folder folder;
      auto peer = std::make_shared<ScriptedPeer::Script>();
      const std::string path = folder / "run.db";
      bool is_away = true;
      peer->take_unless(is_away);
      {
        Run run(path, peer);
        run.publish(250);
        run.loop.advance(before);
        run.publish(20, "b");
        CHECK(run.loop.close(10s) == 0);
        for (const SinkStatus& sink : run.loop.runtime().sinks()) {
          CHECK(sink.counts.balances());
          CHECK(sink.counts.offered == 270);  // what was committed last waits, too
          if (sink.name == "peer") CHECK(sink.counts.queued == 270);
        }
      }
      is_away = false;
      Run run(path, peer);
      run.loop.advance(2s);
      CHECK(count_all_once(*peer) == 270);
      CHECK(run.loop.close(1s) == 0);
    }
  }

  TEST_CASE("a backlog is known by its events, bytes and age, and by when it is gone; also from the recording alone") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    peer->sending.parcel_rows = 10;
    const std::string path = folder / "run.db";
    bool is_away = true;
    peer->on_send = [&](const Parcel& parcel, Answer answer) {
      if (is_away) return answer.again(away);
      if (peer->sent % 2 == 0) answer.refuse(0, away);
      peer->take(parcel, std::move(answer));
    };
    {
      Run run(path, peer);
      CHECK(run.sink.status().backlog.has_value());
      CHECK(run.sink.status().backlog->age == 0s);
      CHECK(run.sink.status().backlog->catch_up == Duration{0});
      run.publish(300);
      run.loop.advance(60s);
      run.publish(100, "b");
      run.loop.advance(10s);
      const auto backlog = run.sink.status().backlog;
      REQUIRE(backlog);
      CHECK(run.sink.counts().queued == 400);
      CHECK(backlog->bytes == 400 * sizeof(Number));  // also those of "b", at whose table it looks when it goes on
      CHECK(backlog->age >= 69s);
      CHECK(backlog->age <= 71s);
      CHECK_FALSE(backlog->catch_up);  // it is away
      CHECK(run.loop.close(10s) == 0);
      const auto last = run.loop.runtime().sinks();
      const auto of = std::find_if(last.begin(), last.end(), [](const SinkStatus& one) { return one.name == "peer"; });
      REQUIRE(of != last.end());
      REQUIRE(of->backlog);
      CHECK(of->counts.queued == 400);
      CHECK(of->backlog->age >= 69s);
    }
    const auto stored = Recording::open(path).or_throw().backlogs().or_throw();
    REQUIRE(stored.size() == 1);
    CHECK(stored[0].sink == "peer");
    CHECK(stored[0].events == 400);
    CHECK(stored[0].bytes == 400 * sizeof(Number));
    CHECK(stored[0].refused == 0);
    REQUIRE(stored[0].oldest);
    // 10 rows a parcel, and at most 100 bytes a second: 8 events of 8 bytes each.
    is_away = false;
    peer->sending.bytes_per_second = 8 * sizeof(Number);
    {
      Run run(path, peer);
      CHECK(run.sink.counts().queued == 400);
      run.loop.advance(20s);
      const auto backlog = run.sink.status().backlog;
      REQUIRE(backlog);
      REQUIRE(backlog->catch_up);
      const double left = static_cast<double>(run.sink.counts().queued);
      const double seconds = std::chrono::duration<double>(*backlog->catch_up).count();
      CHECK(left > 200);
      CHECK(seconds > left / 8 * 0.8);
      CHECK(seconds < left / 8 * 1.25);
      CHECK(run.loop.close(1ms) == 0);
    }
    const auto after = Recording::open(path).or_throw().backlogs().or_throw();
    REQUIRE(after.size() == 1);
    CHECK(after[0].events + peer->events.size() == 400);
    CHECK(after[0].refused > 0);
  }

  TEST_CASE("US-32 the final account goes out last at the end; it waits as all else does while the peer is away") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db";
    bool is_away = false;
    peer->take_unless(is_away);
    const std::vector<std::string> topics{"#", account_topic};
    const auto run_once = [&] {
      Run run(path, peer, {.name = "peer", .topics = topics}, {.path = "", .sink = {.topics = topics}});
      Feed<Number> feed(run.loop, {.name = "chamber", .topic = "room"});
      for (int i = 1; i <= 7; ++i) feed.publish({static_cast<double>(i)});
      run.loop.advance(3s);
      feed.publish({8});
      CHECK(run.loop.close(5s) == 0);
      CHECK(run.loop.runtime().sinks().back().counts.balances());
    };
    run_once();
    REQUIRE(peer->events.size() == 9);
    CHECK(peer->events.back().topic == account_topic);
    CHECK(std::count_if(peer->events.begin(), peer->events.end(),
                        [](const auto& event) { return event.topic == account_topic; }) == 1);
    is_away = true;
    run_once();
    CHECK(peer->events.size() == 9);
    is_away = false;
    run_once();
    CHECK(peer->events.size() == 27);
    CHECK(count_all_once(*peer) == 27);
    auto recorded = Recording::open(path).or_throw();
    auto accounts = recorded.events<FinalCounts>(account_topic).or_throw();
    int count = 0;
    while (const auto* event = accounts.next().or_throw()) {
      ++count;
      CHECK(event->data.name == "chamber");
      CHECK(event->data.topic == "room");
      CHECK(event->data.published == 8);
      CHECK(event->data.lost == 0);
    }
    CHECK(count == 3);
    CHECK(verdict_of(path) == Verdict::balanced);
  }

  TEST_CASE("US-32 the final account has the sensors, too, that were removed before the end") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db";
    const std::vector<std::string> topics{"#", account_topic};
    Run run(path, peer, {.name = "peer", .topics = topics}, {.path = "", .sink = {.topics = topics}});
    Feed<Number> stays(run.loop, {.name = "stays", .topic = "room"});
    Feed<Number> goes(run.loop, {.name = "goes", .topic = "room"});
    Feed<Number> mute(run.loop, {.name = "mute", .topic = "room"});
    Sensor<Number> ticks(run.loop, {.name = "ticks", .topic = "ticks", .rate = 10_Hz}, [] { return Number{1}; });
    for (int i = 1; i <= 3; ++i) goes.publish({static_cast<double>(i)});
    stays.publish({4});
    run.loop.advance(1s);
    const std::uint64_t ticked = ticks.counts().published;
    CHECK(ticked >= 10);
    ticks.close();
    goes.close();
    mute.close();
    {  // the name again, removed again
      Feed<Number> again(run.loop, {.name = "goes", .topic = "room"});
      again.publish({5});
    }
    CHECK(run.loop.close(5s) == 0);
    std::map<std::string, std::uint64_t> published;
    auto recorded = Recording::open(path).or_throw();
    auto accounts = recorded.events<FinalCounts>(account_topic).or_throw();
    while (const auto* event = accounts.next().or_throw()) {
      const std::string name(event->data.name.view());
      CHECK_MESSAGE(published.emplace(name, event->data.published).second, name);
    }
    CHECK(published.size() == 3);
    CHECK(published["goes"] == 4);
    CHECK(published["stays"] == 1);
    CHECK(published["ticks"] == ticked);
    CHECK(verdict_of(path) == Verdict::balanced);
  }

  TEST_CASE("US-32 what waits for a sink that another of its name follows counts once, for that one") {
    Folder folder;
    bool is_away = true;
    const Peer peer = peer_away_while(is_away);
    Run run(folder / "run.db", peer, {.name = "peer"});
    const auto queued = [&] {
      std::uint64_t sum = 0;
      for (const SinkStatus& sink : run.loop.runtime().sinks()) {
        CHECK(sink.counts.balances());
        if (sink.backlog) sum += sink.counts.queued;
      }
      return sum;
    };
    const auto replace = [&] {
      run.sink = Sink();
      run.sink = Sink(run.loop, {.name = "peer", .through = "recording"}, std::make_unique<ScriptedPeer>(peer));
    };
    run.publish(30);
    run.loop.advance(2s);
    CHECK(queued() == 30);
    replace();
    run.loop.advance(2s);
    CHECK(queued() == 30);
    run.sink = Sink();  // removed: what waits for it stays
    run.publish(12);
    run.loop.advance(2s);
    CHECK(queued() == 30);
    run.sink = Sink(run.loop, {.name = "peer", .through = "recording"}, std::make_unique<ScriptedPeer>(peer));
    run.loop.advance(2s);
    CHECK(queued() == 42);
    replace();
    is_away = false;
    run.loop.advance(2s);
    CHECK(peer->events.size() == 42);
    CHECK(queued() == 0);
    // Of another recording, or another name: that does not follow it.
    is_away = true;
    run.publish(5);
    run.loop.advance(2s);
    run.sink = Sink();
    SqliteSink other(run.loop, {.path = folder / "other.db", .sink = {.name = "other"}});
    Sink elsewhere(run.loop, {.name = "peer", .through = "other"}, std::make_unique<ScriptedPeer>(peer));
    run.sink = Sink(run.loop, {.name = "renamed", .through = "recording"}, std::make_unique<ScriptedPeer>(peer));
    run.loop.advance(2s);
    CHECK(queued() == 5);
    run.loop.close(1s);
  }

  TEST_CASE("US-32 the final account of a run goes out when everything else is settled, however many tables wait") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    peer->sending = {.window = 4, .parcel_rows = 10};
    bool is_away = true;
    std::size_t under_way_with_account = 0;
    peer->on_send = [&](const Parcel& parcel, Answer answer) {
      if (is_away) return answer.again(away);
      for (const auto& row : parcel.rows())
        if (row.info->topic == account_topic) under_way_with_account += peer->held.size() + parcel.rows().size() - 1;
      peer->hold(parcel, std::move(answer));
    };
    const std::string path = folder / "run.db";
    const std::vector<std::string> topics{"#", account_topic};
    const auto make = [&] {
      return std::make_unique<Run>(path, peer, SinkConfig{.name = "peer", .topics = topics},
                                   SqliteConfig{.path = "", .sink = {.topics = topics}});
    };
    {
      const auto run = make();
      Feed<Number> feed(run->loop, {.name = "chamber", .topic = "room"});
      for (int i = 1; i <= 300; ++i) feed.publish({static_cast<double>(i)});
      run->publish(500);
      run->publish(20, "b");
      run->loop.advance(3s);
      CHECK(run->loop.close(5s) == 0);
    }
    is_away = false;
    const auto run = make();
    for (int turn = 0; turn < 1000 && (run->sink.counts().queued > 0 || run->sink.counts().offered == 0); ++turn) {
      run->loop.advance(10ms);
      while (!peer->held.empty()) peer->take_held(peer->held.size() - 1);  // the later ones arrive first
    }
    REQUIRE(peer->events.size() == 821);
    CHECK(peer->events.back().topic == account_topic);
    CHECK(under_way_with_account == 0);
    CHECK(run->sink.counts().balances());
  }

  TEST_CASE("a sink begins with what comes now, or at the beginning; another goes at its own speed") {
    Folder folder;
    const std::string path = folder / "run.db";
    auto none = std::make_shared<ScriptedPeer::Script>();
    {
      Run run(path, none, {.name = "early"});
      run.publish(100);
      run.loop.close(1s);
    }
    auto now = std::make_shared<ScriptedPeer::Script>(), all = std::make_shared<ScriptedPeer::Script>();
    {
      Run run(path, now, {.name = "now"});
      Sink other(run.loop, {.name = "all", .through = "recording", .from = From::beginning},
                 std::make_unique<ScriptedPeer>(all));
      run.publish(30);
      run.loop.advance(2s);
      CHECK(now->events.size() == 30);
      CHECK(all->events.size() == 130);
      CHECK(run.loop.close(1s) == 0);
    }
    CHECK(count_all_once(*now) == 30);
    CHECK(count_all_once(*all) == 130);
    {
      // The second start goes on, whatever `from` says.
      Run run(path, all, {.name = "all", .from = From::beginning});
      run.loop.advance(2s);
      run.loop.close(1s);
    }
    CHECK(all->events.size() == 130);
  }

  TEST_CASE("topics are chosen by pattern, and tables take turns") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    peer->sending = {.window = 1, .parcel_rows = 5, .timeout = 1s};
    peer->on_send = [&](const Parcel& parcel, Answer answer) { peer->hold(parcel, std::move(answer)); };
    Run run(folder / "run.db", peer, {.name = "peer", .topics = {"room/+"}, .batch_rows = 10});
    run.publish(2000, "room/fast");
    run.publish(10, "room/slow");
    run.publish(10, "hall/other");
    run.loop.advance(1100ms);
    for (int i = 0; i < 12 && !peer->held.empty(); ++i) {
      peer->take_held(0);
      run.loop.advance(20ms);
    }
    const auto slow = std::count_if(peer->events.begin(), peer->events.end(),
                                    [](const auto& event) { return event.topic == "room/slow"; });
    INFO(peer->events.size() << " events");
    CHECK(slow == 10);
    CHECK(run.sink.counts().offered == 2010);
  }

  TEST_CASE("a kill repeats what was acknowledged since the position was stored, and loses nothing") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db", killed = folder / "killed.db";
    {
      Run run(path, peer);
      run.publish(100);
      run.loop.advance(1s);
      run.publish(100);
      run.loop.advance(1s);
      CHECK(peer->events.size() == 200);
      // As the files are when the program is killed now.
      for (const char* part : {"", "-wal"}) std::filesystem::copy_file(path + part, killed + part);
      run.loop.close(1s);
    }
    Run run(killed, peer);
    run.loop.advance(2s);
    CHECK(run.sink.counts().balances());
    CHECK(run.loop.close(1s) == 0);
    CHECK(peer->events.size() >= 200);
    CHECK(peer->events.size() <= 300);
    std::vector<std::uint64_t> sequences = peer->sequences();
    std::sort(sequences.begin(), sequences.end());
    sequences.erase(std::unique(sequences.begin(), sequences.end()), sequences.end());
    CHECK(sequences.size() == 200);
  }

  TEST_CASE("rows that a limit of the recording deletes before they are sent are counted for the sink") {
    Folder folder;
    bool is_away = true;
    const Peer peer = peer_away_while(is_away);
    const std::string path = folder / "run.db";
    Run run(path, peer, {.name = "peer"}, {.path = "", .max_age = 5s});
    Ticker ticker(run.loop, {.period = 10ms}, [&](const Tick&) { run.publish(1); });
    run.loop.advance(30s);
    is_away = false;
    run.loop.advance(20s);
    ticker.close();
    CHECK(run.loop.close(5s) == 0);
    const SinkCounts counts = run.loop.runtime().sinks().front().name == "peer"
                                  ? run.loop.runtime().sinks().front().counts
                                  : run.loop.runtime().sinks().back().counts;
    CHECK(counts.offered == static_cast<std::uint64_t>(run.published));
    CHECK(counts.all_dropped() > 1000);
    CHECK(counts.all_dropped() < 3000);
    CHECK(counts.stored == peer->events.size());
    CHECK(counts.balances());
    CHECK(counts.queued == 0);
  }

  TEST_CASE("rows that a limit deletes while the peer is away are counted when they are deleted, also in the queue") {
    for (const bool is_renewed : {false, true}) {
      CAPTURE(is_renewed);
      Folder folder;
      bool is_away = true;
      const Peer peer = peer_away_while(is_away);
      const std::string path = folder / "run.db";
      std::uint64_t published = 0, dropped = 0, waiting = 0;
      {
        Run run(path, peer, {.name = "peer"}, {.path = "", .max_age = 5s});
        Ticker ticker(run.loop, {.period = 10ms}, [&](const Tick&) { run.publish(1); });
        std::uint64_t before = 0;
        for (int i = 0; i < 30; ++i) {
          run.loop.advance(1s);
          const SinkCounts counts = run.sink.counts();
          CHECK(counts.balances());
          CHECK(counts.all_dropped() >= before);
          before = counts.all_dropped();
        }
        CHECK(before > 1000);
        ticker.close();
        run.loop.close(1s);
        const SinkCounts counts = run.sink.counts();
        CHECK(counts.offered == static_cast<std::uint64_t>(run.published));
        CHECK(counts.balances());
        CHECK(counts.queued == static_cast<std::uint64_t>(number(path, "SELECT count(*) FROM a")));
        published = counts.offered;
        dropped = counts.all_dropped();
        waiting = counts.queued;
      }
      CHECK(unsent_in(path) == dropped);
      if (is_renewed) sql(path, "VACUUM");
      is_away = false;
      Run run(path, peer);
      run.publish(1);
      run.loop.advance(10s);
      CHECK(run.sink.counts().all_dropped() == 0);  // they were counted
      run.loop.close(1s);
      CHECK(peer->events.size() == waiting + 1);
      CHECK(dropped + waiting == published);
    }
  }

  TEST_CASE("US-26 rows that a limit deletes before they are sent are in the recording's account, after a kill too") {
    Folder folder;
    const std::string path = folder / "run.db";
    const auto run_for = [&](int seconds, const auto& each) {
      bool is_away = true;
      const Peer peer = peer_away_while(is_away);
      Run run(path, peer, {.name = "peer"}, {.path = "", .max_age = 5s});
      Ticker ticker(run.loop, {.period = 10ms}, [&](const Tick&) { run.publish(1); });
      for (int i = 0; i < seconds; ++i) {
        run.loop.advance(1s);
        each(run);
      }
    };
    // Of each state of the file: all rows that were ever in it.
    constexpr const char* all = "SELECT (SELECT count(*) FROM a) + (SELECT total(count) FROM rtdata_unsent)";
    std::ptrdiff_t warnings = 0;
    run_for(20, [&](Run& run) {
      CHECK(number(path, all) == number(path, "SELECT max(rowid) FROM a"));
      warnings = std::count_if(run.errors.begin(), run.errors.end(), [](const std::string& error) {
        return error.find("events are deleted before they are sent") != std::string::npos;
      });
      CHECK(warnings == (number(path, "SELECT count(*) FROM rtdata_unsent") > 0 ? 1 : 0));
    });
    CHECK(warnings == 1);
    CHECK(number(path, "SELECT count(*) FROM rtdata_error WHERE text LIKE '%the peer of peer%'") == 1);
    std::uint64_t before = unsent_in(path);
    CHECK(before > 1000);
    CHECK(before < 2000);
    sinks::killed_in([&] {
      run_for(20, [](Run&) {});
      int seconds = 0;
      run_for(20, [&](Run&) {
        if (++seconds == 19) ::kill(::getpid(), SIGKILL);
      });
    });
    CHECK(number(path, all) == number(path, "SELECT max(rowid) FROM a"));
    CHECK(unsent_in(path) > 3 * before);
    before = unsent_in(path);
    auto peer = std::make_shared<ScriptedPeer::Script>();
    {
      Run run(path, peer);  // it is sealed, and all that is left is sent
      run.loop.advance(10s);
      CHECK(run.loop.close(5s) == 0);
    }
    CHECK(peer->events.size() == static_cast<std::size_t>(number(path, "SELECT count(*) FROM a")));
    CHECK(unsent_in(path) == before);
    const VerifyReport report = verify(Recording::open(path).or_throw()).or_throw();
    CHECK(report.exit_code() == 0);
    CHECK(report.unsent == std::map<std::string, std::uint64_t>{{"peer", before}});
    CHECK(report.text().find("LOST: " + std::to_string(before) +
                             " events that `max_bytes`, `max_age` or `rtdata rm` deleted") != std::string::npos);
    CHECK(report.to_json().find("\"peer\": " + std::to_string(before)) != std::string::npos);
    for (const bool is_json : {false, true}) {
      std::ostringstream out, err;
      CHECK(app::info({.database = path, .show_as = is_json ? app::ShowAs::json : app::ShowAs::text}, out, err) == 0);
      CHECK(out.str().find((is_json ? "\"unsent\": " : "deleted before they were sent: ") + std::to_string(before)) !=
            std::string::npos);
    }
  }

  TEST_CASE("a new sink that begins at the beginning has lost nothing that was deleted before it came") {
    Folder folder;
    auto none = std::make_shared<ScriptedPeer::Script>(), peer = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db";
    {
      Run run(path, none, {.name = "other"}, {.path = "", .max_age = 2s});
      Ticker ticker(run.loop, {.period = 10ms}, [&](const Tick&) { run.publish(1); });
      run.loop.advance(10s);
      ticker.close();
      run.loop.close(1s);
    }
    const auto there = static_cast<std::uint64_t>(number(path, "SELECT count(*) FROM a"));
    REQUIRE(there < 500);
    Run run(path, peer, {.name = "peer", .from = From::beginning});
    run.loop.advance(3s);
    run.loop.close(1s);
    CHECK(run.sink.counts().offered == there);
    CHECK(run.sink.counts().all_dropped() == 0);
    CHECK(peer->events.size() == there);
  }

  TEST_CASE(
      "US-26 the age of a row is by UTC: a clock that was wrong at first deletes nothing, and keeps nothing for ever") {
    constexpr std::int64_t day = 86'400'000'000'000;
    for (const std::int64_t wrong_by : {-116 * day, 0 * day, 31 * 365 * day}) {
      CAPTURE(wrong_by);
      Folder folder;
      auto peer = std::make_shared<ScriptedPeer::Script>();
      const std::string path = folder / "run.db";
      {
        Run run(path, peer);
        run.publish(500);
        run.loop.advance(5s);
        run.loop.close(1s);
      }
      // As if the clock had been wrong when the run began; and, ahead, as if nobody had set it right.
      const std::string by = std::to_string(wrong_by);
      sql(path, "UPDATE a SET time = time + " + by + "; UPDATE rtdata_run SET clock_offset = clock_offset + " + by +
                    ", started = started + " + by + ", ended = ended + " + by +
                    ", boot_id = 'before'; "
                    "UPDATE rtdata_utc SET boot_id = 'before'");
      if (wrong_by > 0) sql(path, "UPDATE rtdata_utc SET \"offset\" = \"offset\" + " + by);
      for (const Duration age : {Duration{30 * 24h}, Duration{10s}}) {
        Run run(path, peer, {.name = "peer"}, {.path = "", .max_age = age});
        Ticker ticker(run.loop, {.period = 100ms}, [&](const Tick&) { run.publish(1); });
        run.loop.advance(20s);
        ticker.close();
        run.loop.close(1s);
        CHECK(number(path, "SELECT count(*) FROM a WHERE run = 1") == (age > 1min ? 500 : 0));
      }
      CHECK(number(path, "SELECT count(*) FROM a") < 120);
    }
  }

  TEST_CASE("VACUUM of a recording that is recorded costs no event, whether the peer is there or not") {
    for (const bool is_there : {true, false}) {
      CAPTURE(is_there);
      Folder folder;
      bool is_away = false;
      const Peer peer = peer_away_while(is_away);
      const std::string path = folder / "run.db";
      Run run(path, peer, {.name = "peer"}, {.path = "", .max_age = 4s});
      Ticker ticker(run.loop, {.period = 10ms}, [&](const Tick&) { run.publish(1); });
      Ticker other(run.loop, {.period = 70ms}, [&](const Tick&) { run.publish(1, "b"); });
      for (int i = 0; i < 10; ++i) {
        run.loop.advance(7s);
        is_away = !is_there;
        run.loop.advance(2s);
        sql(path, "VACUUM");
        is_away = false;
      }
      run.loop.advance(5s);
      ticker.close();
      other.close();
      CHECK(run.loop.close(5s) == 0);
      const SinkCounts counts = run.sink.counts();
      CHECK(counts.offered == static_cast<std::uint64_t>(run.published));
      CHECK(counts.all_dropped() == 0);
      CHECK(unsent_in(path) == 0);
      CHECK(counts.stored == counts.offered);
      CHECK(counts.balances());
      CHECK(count_all_once(*peer) == static_cast<std::size_t>(run.published));
      CHECK(verify(Recording::open(path).or_throw()).or_throw().exit_code() == 0);
    }
  }

  TEST_CASE("refused rows are kept in the recording with the reason") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    peer->unencodable = 3;
    peer->on_send = [&](const Parcel& parcel, Answer answer) {
      for (std::size_t i = 0; i < parcel.rows().size(); ++i) {
        if (parcel.rows()[i].sequence == 7) answer.refuse(i, {Errc::bad_data, "refused", "peer", "seven", ""});
      }
      answer.acknowledge();
    };
    const std::string path = folder / "run.db";
    Run run(path, peer);
    run.publish(20);
    run.loop.advance(3s);
    CHECK(run.sink.counts().stored == 18);
    CHECK(run.sink.counts().balances());
    run.loop.close(1s);
    CHECK(number(path, "SELECT count(*) FROM rtdata_refused") == 2);
    CHECK(number(path, "SELECT sequence FROM rtdata_refused WHERE reason LIKE '%seven%'") == 7);
    CHECK(number(path, "SELECT sequence FROM rtdata_refused WHERE reason LIKE '%the test says so%'") == 3);
  }

  TEST_CASE("however many rows are refused at once, the key of each is kept") {
    for (const bool by_encoding : {false, true}) {
      CAPTURE(by_encoding);
      Folder folder;
      auto peer = std::make_shared<ScriptedPeer::Script>();
      peer->sending = {.window = 4, .parcel_rows = 1000, .timeout = 1s};
      peer->on_send = [&](const Parcel& parcel, Answer answer) {
        for (std::size_t i = 0; i < parcel.rows().size(); ++i)
          answer.refuse(i, {Errc::bad_data, "refused", "peer", "it takes none", ""});
        answer.acknowledge();
      };
      const std::string path = folder / "run.db";
      Run run(path, peer);
      if (by_encoding) {
        peer->unencodable = 5;
        for (int i = 0; i < 50'000; ++i) run.loop.topic<Number>("a").publish({5});
      } else {
        run.publish(50'000);
      }
      run.loop.advance(20s);
      CHECK(run.sink.counts().queued == 0);
      CHECK(run.sink.counts().all_dropped() == 50'000);
      CHECK(run.sink.counts().balances());
      CHECK(run.loop.close(5s) == 0);
      CHECK(number(path, "SELECT count(*) FROM rtdata_refused") == 50'000);
    }
  }

  TEST_CASE("a peer that refuses everything costs a recording with a limit not its data: the newest keys are kept") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    peer->on_send = [&](const Parcel& parcel, Answer answer) {
      for (std::size_t i = 0; i < parcel.rows().size(); ++i)
        answer.refuse(i, {Errc::bad_data, "refused", "peer", "it takes none", ""});
      answer.acknowledge();
    };
    const std::string path = folder / "run.db";
    {
      Run run(path, peer, {.name = "peer"}, {.path = "", .max_bytes = 4 << 20});
      for (int i = 0; i < 40; ++i) {
        run.publish(5000);
        run.loop.advance(2s);
      }
      CHECK(run.sink.counts().balances());
      CHECK(run.loop.close(5s) == 0);
    }
    CHECK(number(path, "SELECT count(*) FROM a") > 20'000);
    CHECK(number(path, "SELECT count(*) FROM rtdata_refused") > 500);
    CHECK(number(path, "SELECT count(*) FROM rtdata_refused") < 2000);
    CHECK(number(path, "SELECT max(sequence) FROM rtdata_refused") == 200'000);
    const Recording recording = Recording::open(path).or_throw();
    const RecordedBacklog of = recording.backlogs().or_throw().at(0);
    CHECK(of.refused == 200'000);
    CHECK(of.refused_keys == static_cast<std::uint64_t>(number(path, "SELECT count(*) FROM rtdata_refused")));
    CHECK(std::filesystem::file_size(path) <= 4 << 20);
  }

  TEST_CASE("rows that got other numbers are found by their key, and an older copy of a recording is told") {
    for (const bool is_older_copy : {false, true}) {
      Folder folder;
      auto peer = std::make_shared<ScriptedPeer::Script>();
      const std::string path = folder / "run.db", copy = folder / "copy.db";
      {
        Run run(path, peer);
        run.publish(10);
        run.loop.close(1s);
      }
      if (is_older_copy) {
        std::filesystem::copy_file(path, copy);
      }
      {
        Run run(path, peer);
        run.publish(50);
        run.loop.close(1s);
      }
      CHECK(peer->events.size() == 60);
      sql(path, is_older_copy ? "DELETE FROM a WHERE run = 2" : "UPDATE a SET rowid = rowid + 1000");
      Run run(path, peer);
      run.publish(3);
      run.loop.advance(2s);
      run.loop.close(1s);
      CHECK(has(run.log, is_older_copy ? "or it is an older copy" : "continues after the event that was sent last"));
      CHECK(peer->events.size() == (is_older_copy ? 60 + 10 + 3 : 60 + 3));
    }
  }

  TEST_CASE("a field has a name that SQL has for the numbers of rows: rows keep their order, limits and account") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db";
    Run run(path, peer, {.name = "peer"}, {.path = "", .max_age = 10s});
    constexpr std::uint64_t count = 300;
    for (std::uint64_t i = 1; i <= count; ++i) {
      run.loop.topic<Falling>("falling").publish({static_cast<std::int64_t>(1000 - i), static_cast<double>(i % 7)});
      run.loop.advance(100ms);
    }
    run.loop.advance(1s);
    CHECK(peer->events.size() == count);
    CHECK(count_all_once(*peer) == count);
    CHECK(run.loop.close(5s) == 0);
    recordings::check_balanced(path);
    const Recording recording = Recording::open(path).or_throw();
    auto rows = recording.rows({.topic = "falling"}).or_throw();
    std::uint64_t last = 0;
    while (const RecordedRow* row = rows.next().or_throw()) {
      const Falling* const value = row->event().as<Falling>();
      REQUIRE(value != nullptr);
      CHECK(value->ROWID == static_cast<std::int64_t>(1000 - row->header().sequence));
      if (last != 0) CHECK(row->header().sequence == last + 1);
      if (last == 0) CHECK(row->header().sequence > 100);  // those before are too old
      last = row->header().sequence;
    }
    CHECK(last == count);
    std::ostringstream csv;
    CHECK(export_rows(recording, {.filter = {.topic = "falling", .limit = 3}}, csv).or_throw().rows == 3);
    CHECK(csv.str().find("time,origin,sequence,ROWID,oid\n") == 0);
  }

  TEST_CASE("rows that got other numbers before the first was sent are found, too") {
    Folder folder;
    auto none = std::make_shared<ScriptedPeer::Script>(), peer = std::make_shared<ScriptedPeer::Script>();
    bool is_away = true;
    peer->take_unless(is_away);
    const std::string path = folder / "run.db";
    {
      Run run(path, none, {.name = "other"});
      run.publish(100);
      run.loop.close(1s);
    }
    {
      Run run(path, peer);  // begins after the 100
      run.publish(50);
      run.loop.advance(2s);
      run.loop.close(1s);
    }
    sql(path, "DELETE FROM a WHERE run = 1 AND sequence <= 90; VACUUM");
    REQUIRE(number(path, "SELECT max(rowid) FROM a") == 60);
    is_away = false;
    Run run(path, peer);
    run.publish(3);
    run.loop.advance(2s);
    CHECK(run.loop.close(1s) == 0);
    CHECK(count_all_once(*peer) == 53);
    CHECK(has(run.log, "were renumbered"));
  }

  TEST_CASE("a row that cannot be read is left out, told and counted, and nothing is sent again for it") {
    Folder folder;
    auto none = std::make_shared<ScriptedPeer::Script>(), peer = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db";
    {
      Run run(path, none, {.name = "other"});
      run.publish(10);
      run.loop.close(1s);
    }
    sql(path, "UPDATE a SET value = 'broken' WHERE sequence IN (4, 10)");
    for (int start = 0; start < 3; ++start) {
      Run run(path, peer, {.name = "peer", .from = From::beginning});
      run.loop.advance(3s);
      CHECK(run.sink.counts().balances());
      CHECK(run.sink.counts().all_dropped() == (start == 0 ? 2 : 0));
      CHECK(has(run.log, "left out") == (start == 0));
      CHECK(run.loop.close(1s) == 0);
      CHECK(peer->sequences() == std::vector<std::uint64_t>{1, 2, 3, 5, 6, 7, 8, 9});
    }
  }

  TEST_CASE("a recording that is deleted or closed faults the sinks that go through it") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    const std::string path = folder / "run.db";
    Run run(path, peer);
    run.publish(10);
    run.loop.advance(2s);
    std::filesystem::remove(path);
    run.publish(10);
    run.loop.advance(2s);
    CHECK(run.sink.health() == Health::faulted);
    CHECK(run.sink.status().reason.find("has ended") != std::string::npos);
    Run other(folder / "other.db", peer);
    other.recording.close();
    CHECK(other.sink.health() == Health::faulted);
    CHECK(other.sink.status().reason.find("was closed") != std::string::npos);
    other.loop.advance(2s);
    CHECK(other.loop.close(1s) == 0);
  }

  TEST_CASE("`through` names a recording of the same loop") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    Loop loop{Loop::Manual{}};
    const auto make = [&](const std::string& through) {
      return Sink(loop, {.name = "peer", .through = through}, std::make_unique<ScriptedPeer>(peer));
    };
    CHECK_THROWS_WITH_AS(make("none"), doctest::Contains("there is no such sink"), SetupError);
    SqliteSink recording(loop, {.path = folder / "run.db", .sink = {.name = "recording"}});
    CHECK_THROWS_WITH_AS(make("recoding"), doctest::Contains("available: recording"), SetupError);
    CHECK_THROWS_WITH_AS(SqliteSink(loop, {.path = folder / "b.db", .sink = {.name = "b", .through = "recording"}}),
                         doctest::Contains("a recording itself"), SetupError);
    Sink plain(loop, {.name = "plain"}, std::make_unique<ScriptedPeer>(peer));
    CHECK_THROWS_WITH_AS(make("plain"), doctest::Contains("not a recording"), SetupError);
  }

  TEST_CASE("a recording commits within the shortest time of the sinks that go through it") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    Run run(folder / "run.db", peer, {.name = "peer", .batch_time = 50ms},
            {.path = "", .sink = {.topics = {"a", "b/#"}, .batch_time = 10s}});
    run.loop.advance(1s);
    run.publish(1);
    run.loop.advance(101ms);
    CHECK(peer->events.size() == 1);
  }

  TEST_CASE("a peer that hangs while a sensor is recorded costs no tick, and the ledger closes") {
    Folder folder;
    auto peer = std::make_shared<ScriptedPeer::Script>();
    peer->on_send = [&](const Parcel& parcel, Answer answer) { peer->hold(parcel, std::move(answer)); };
    const std::string path = folder / "run.db";
    Run run(path, peer);
    std::uint64_t missed = 0;
    Ticker ticker(run.loop, {.period = 1ms}, [&](const Tick& tick) {
      missed += tick.missed;
      run.publish(1);
    });
    run.loop.advance(5s);
    CHECK(missed == 0);
    ticker.close();
    const MonotonicTime begin = run.loop.now();
    CHECK(run.loop.close(8s) == 0);
    CHECK(run.loop.now() - begin < 8s);
    CHECK(verdict_of(path) == Verdict::balanced);
    const auto runs = Recording::open(path).or_throw().runs().or_throw();
    CHECK(runs.back().state == RunState::closed);
  }
}
