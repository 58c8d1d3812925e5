// The rules that every sink keeps, each over every kind.
#include <doctest/doctest.h>

#include <map>

#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

/// What was published, to be compared with what is stored.
class Source {
 public:
  explicit Source(Loop& loop) : loop_(loop) {}
  void publish(const std::string& topic, int count) {
    for (int i = 0; i < count; ++i) {
      const double value = static_cast<double>(++published_) / 4;
      loop_.topic<Number>(topic).publish({value});
      rows_[topic].push_back({topic, rows_[topic].size() + 1, value});
    }
  }
  std::uint64_t count() const { return published_; }
  const std::map<std::string, std::vector<Row>>& rows() const { return rows_; }

 private:
  Loop& loop_;
  std::uint64_t published_ = 0;
  std::map<std::string, std::vector<Row>> rows_;
};

std::map<std::string, std::vector<Row>> by_topic(const std::vector<Row>& rows) {
  std::map<std::string, std::vector<Row>> sorted;
  for (const Row& row : rows) sorted[row.topic].push_back(row);
  return sorted;
}

/// Calls with each kind, a manual loop and a store; errors that sinks report are expected here.
template <class Test>
void over_all_kinds(Test&& test) {
  for (const SinkKind& kind : sink_kinds()) {
    CAPTURE(kind.name);
    const auto store = kind.make();
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    test(*store, loop);
  }
}

SinkConfig config() {
  return {.name = "sink", .batch_rows = 10, .batch_time = 1s, .queue_bytes = 256 << 10, .retry_first = 100ms};
}

void check_stored(Store& store, const Source& source, const SinkCounts& counts) {
  CHECK(by_topic(store.rows()) == source.rows());
  CHECK(counts.offered == source.count());
  CHECK(counts.stored == source.count());
  CHECK(counts.all_dropped() == 0);
  CHECK(counts.queued == 0);
  CHECK(counts.balances());
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-26 US-30 every event is stored exactly once, in order") {
    over_all_kinds([](Store& store, Loop& loop) {
      Source source(loop);
      Sink sink = store.make(loop, config());
      for (int turn = 0; turn < 50; ++turn) {
        source.publish("a", turn % 7);
        source.publish("room/b", turn % 3);
        loop.advance(100ms);
      }
      loop.advance(5s);
      store.settle(loop, sink);
      check_stored(store, source, sink.counts());
      CHECK(sink.health() == Health::ok);
    });
  }

  TEST_CASE("US-26 a batch is handed over when it is full, or when its time has come") {
    over_all_kinds([](Store& store, Loop& loop) {
      Source source(loop);
      Sink sink = store.make(loop, config());
      loop.advance(1500ms);
      source.publish("a", 9);
      loop.advance(10ms);
      CHECK(sink.counts().queued == 9);
      CHECK(store.rows().empty());
      loop.advance(5s);
      store.settle(loop, sink);
      CHECK(store.rows().size() == 9);
      source.publish("a", 10);  // no time passes
      loop.advance(0ms);
      store.settle(loop, sink);
      if (sink.counts().queued != 0) loop.advance(1s);  // slow, or failed once
      check_stored(store, source, sink.counts());
    });
  }

  TEST_CASE("NFR-1 a full queue drops the newest events, and counts them") {
    over_all_kinds([](Store& store, Loop& loop) {
      Source source(loop);
      SinkConfig small = config();
      small.batch_rows = 1'000'000;
      small.close_deadline = 3h;
      Sink sink = store.make(loop, small);
      loop.script_lane_duration(1h);  // from the first batch on, the lane is busy
      source.publish("a", 20'000);
      const SinkCounts counts = sink.counts();
      CHECK(counts.offered == 20'000);
      CHECK(counts.dropped[static_cast<std::size_t>(DropReason::queue_full_newest)] > 0);
      CHECK(counts.dropped[static_cast<std::size_t>(DropReason::queue_full_oldest)] == 0);
      CHECK(counts.balances());
      loop.script_lane_duration(0ms);
      if (store.is_answered()) loop.advance(1h);  // until the lane is free
      store.close(loop, sink);
      const auto rows = store.rows();
      CHECK(rows.size() == counts.stored + counts.queued);
      std::vector<Row> sent = source.rows().at("a");
      sent.resize(rows.size());
      if (rows.size() == counts.offered - counts.all_dropped()) CHECK(rows.front() == sent.front());
      const SinkStatus last = loop.runtime().sinks().front();
      CHECK(last.counts.offered == 20'000);
      CHECK(last.counts.stored == rows.size());
      CHECK(last.counts.balances());
    });
  }

  TEST_CASE("NFR-1 a full queue drops the oldest events, and counts them") {
    over_all_kinds([](Store& store, Loop& loop) {
      Source source(loop);
      SinkConfig small = config();
      small.batch_rows = 1'000'000;
      small.close_deadline = 3h;
      small.when_full = WhenFull::drop_oldest;
      Sink sink = store.make(loop, small);
      loop.script_lane_duration(1h);
      source.publish("a", 20'000);
      const SinkCounts counts = sink.counts();
      CHECK(counts.offered == 20'000);
      CHECK(counts.dropped[static_cast<std::size_t>(DropReason::queue_full_oldest)] > 0);
      CHECK(counts.dropped[static_cast<std::size_t>(DropReason::queue_full_newest)] == 0);
      CHECK(counts.balances());
      loop.script_lane_duration(0ms);
      if (store.is_answered()) loop.advance(1h);  // until the lane is free
      store.close(loop, sink);
      const auto rows = store.rows();
      CHECK(rows.size() == counts.stored + counts.queued);
      CHECK(rows.back().value == source.rows().at("a").back().value);
      const SinkStatus last = loop.runtime().sinks().front();
      CHECK(last.counts.stored == rows.size());
      CHECK(last.counts.balances());
    });
  }

  TEST_CASE("closing a sink stores what is queued") {
    over_all_kinds([](Store& store, Loop& loop) {
      Source source(loop);
      Sink sink = store.make(loop, config());
      source.publish("a", 37);
      store.close(loop, sink);
      source.publish("a", 0);
      REQUIRE(loop.runtime().sinks().size() == 1);
      check_stored(store, source, loop.runtime().sinks().front().counts);
      loop.topic<Number>("a").publish({1});  // not offered any more
      CHECK(store.rows().size() == 37);
      CHECK(loop.runtime().balances());
    });
  }

  TEST_CASE("closing a loop closes its sinks after its sensors") {
    over_all_kinds([](Store& store, Loop& loop) {
      Sink sink = store.make(loop, config());
      Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
      std::uint64_t published = 0;
      Ticker ticker(loop, 10ms, [&](const Tick&) { feed.publish({static_cast<double>(++published)}); });

      loop.advance(1s);
      ticker.stop();
      CHECK(store.close(loop) == 0);
      CHECK(store.rows().size() == published);
      const SinkStatus last = loop.runtime().sinks().front();
      CHECK(last.counts.stored == published);
      CHECK(last.counts.balances());
      CHECK(loop.runtime().balances());
      CHECK(!loop.runtime().has_loss());
    });
  }

  TEST_CASE("a sink whose loop goes first has stored what was queued") {
    for (const SinkKind& kind : sink_kinds()) {
      CAPTURE(kind.name);
      if (kind.is_sender) continue;
      const auto store = kind.make();
      Sink sink;
      {
        Loop loop{Loop::Manual{}};
        loop.on_error([](const ErrorReport&) {});
        sink = store->make(loop, config());
        Source(loop).publish("a", 5);
      }
      CHECK(!sink.is_open());
      CHECK(store->rows().size() == 5);
    }
  }

  TEST_CASE("topics made after the sink are taken, those of ours only by name") {
    over_all_kinds([](Store& store, Loop& loop) {
      Source source(loop);
      SinkConfig all = config();
      Sink sink = store.make(loop, all);
      source.publish("late", 3);
      loop.topic<Number>("$rtdata/ledger").publish({1});
      loop.advance(3s);
      store.settle(loop, sink);
      check_stored(store, source, sink.counts());
    });
    over_all_kinds([](Store& store, Loop& loop) {
      SinkConfig own = config();
      own.topics = {"$rtdata/#"};
      Sink sink = store.make(loop, own);
      loop.topic<Number>("a").publish({1});
      loop.topic<Number>("$rtdata/ledger").publish({2});
      loop.advance(3s);
      store.settle(loop, sink);
      REQUIRE(store.rows().size() == 1);
      CHECK(store.rows().front().value == 2);
    });
  }

  TEST_CASE("an exact topic without a description, and a pattern that is none, are set-up errors") {
    over_all_kinds([](Store& store, Loop& loop) {
      loop.topic<std::string>("words");
      SinkConfig wrong = config();
      wrong.topics = {"words"};
      CHECK_THROWS_WITH_AS(store.make(loop, wrong),
                           "cannot attach sink sink: topic words: its payload has no description, so it cannot be "
                           "recorded: give its type a `describe` [bad-description]",
                           SetupError);
      wrong.topics = {"a//b"};
      CHECK_THROWS_AS(store.make(loop, wrong), SetupError);
      CHECK(loop.runtime().sinks().empty());
      Sink sink = store.make(loop, config());  // by a pattern it is passed over
      Source source(loop);
      source.publish("a", 2);
      loop.topic<std::string>("words").publish("one");
      loop.advance(3s);
      store.settle(loop, sink);
      check_stored(store, source, sink.counts());
    });
  }

  TEST_CASE("a sink may be closed from inside a handler of what it records") {
    over_all_kinds([](Store& store, Loop& loop) {
      Sink sink = store.make(loop, config());
      const Subscription subscription = loop.topic<Number>("a").subscribe(loop, [&](const Event<Number>& event) {
        if (event.sequence == 3) sink.close();
      });
      Source source(loop);
      source.publish("a", 5);
      loop.advance(10ms);
      CHECK(!sink.is_open());
      if (store.is_answered()) {  // closed there, it waits for no answer: what it has none to is counted as lost
        const SinkCounts counts = loop.runtime().sinks().front().counts;
        CHECK(counts.offered == 5);
        CHECK(counts.balances());
        CHECK(counts.queued == 0);
      } else {
        CHECK(by_topic(store.rows()) == source.rows());
      }
      CHECK(loop.runtime().balances());
    });
  }

  TEST_CASE("US-26 on a loop in real time, events are stored while they come") {
    for (const SinkKind& kind : sink_kinds()) {
      CAPTURE(kind.name);
      const auto store = kind.make();
      std::uint64_t reports = 0;
      {
        Loop loop;
        loop.on_error([&](const ErrorReport&) { ++reports; });
        SinkConfig quick = config();
        quick.queue_bytes = 4 << 20;
        quick.retry_first = 1ms;
        Sink sink = store->make(loop, quick);
        Source source(loop);
        // As long as it takes until a second batch was stored: counts are read while the lane works.
        Ticker ticker(loop, 200us, [&](const Tick&) {
          source.publish("a", 3);
          source.publish("b", 2);
          const SinkCounts counts = sink.counts();
          CHECK(counts.offered == source.count());
          CHECK(sink.status().counts.all_dropped() == 0);
          if (counts.stored >= 40) loop.stop();
        });
        loop.run();
        ticker.close();
        CHECK(loop.close() == 0);
        check_stored(*store, source, loop.runtime().sinks().front().counts);
        CHECK(loop.runtime().balances());
      }
    }
  }
}
