#include "rtdata/loop/topic.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "loop/observed.hpp"
#include "loop/run_until.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using observed::Number;
using observed::Reordered;
using observed::Tracked;
using observed::WrongUnit;

namespace {

struct Taken {
  double value = 0;
  std::int64_t count = 0;
  text<16> note;
  friend constexpr auto describe(type_tag<Taken>) {
    return record("taken", field("value", &Taken::value, "V"), field("count", &Taken::count),
                  field("note", &Taken::note));
  }
};

}  // namespace

TEST_SUITE("loop") {
  TEST_CASE("US-16 every event reaches every subscriber of its topic") {
    Loop loop(Loop::Manual{});
    const auto topic = loop.topic<Number>("a/b");
    std::vector<double> typed;
    std::vector<double> viewed;
    const auto one = topic.subscribe(loop, [&](const Event<Number>& e) { typed.push_back(e->value); });
    const auto two = loop.subscribe("a/b", [&](const EventView& e) { viewed.push_back(e.as<Number>()->value); });
    for (int i = 0; i < 100; ++i) topic.publish({static_cast<double>(i), 0});
    loop.poll();
    REQUIRE(typed.size() == 100);
    CHECK(typed == viewed);
    CHECK(typed[42] == 42);
    CHECK(one.counts().delivered == 100);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("US-16 a topic whose events are of other types than the handler's names each field, and what it is") {
    Loop loop(Loop::Manual{});
    DescriptionBuilder builder("reading");
    builder.field("value", Kind::f64, "V", DescriptionBuilder::Presence::optional)
        .field("count", Kind::i32)
        .text("note", 8, DescriptionBuilder::Presence::always);
    const auto description = builder.build().or_throw();
    const AnyFeed feed(loop, {.name = "feed", .topic = "t"}, description);
    std::string refusal;
    try {
      const auto heard = loop.subscribe<Taken>("t", [](const Event<Taken>&) {});
    } catch (const SetupError& error) {
      refusal = error.what();
    }
    CAPTURE(refusal);
    CHECK(refusal.find("field value: optional double in it, double wanted") != std::string::npos);
    CHECK(refusal.find("field count: int32 in it, int64 wanted") != std::string::npos);
    CHECK(refusal.find("field note: text of 8 in it, text of 16 wanted") != std::string::npos);
    // A value that does not fit is told with its field too.
    std::vector<std::byte> payload(description->size());
    for (const Leaf& leaf : description->leaves()) {
      const Value wrong = leaf.kind == Kind::text ? Value(1.5) : Value(std::string("fast"));
      const auto done = write(leaf, payload.data(), wrong);
      REQUIRE_FALSE(done);
      CHECK(done.error().where == "field " + leaf.path);
    }
  }

  TEST_CASE("US-25 publishing never calls a handler; handlers run after the callback that published") {
    Loop loop(Loop::Manual{});
    const auto topic = loop.topic<Number>("t");
    int delivered = 0;
    const auto subscription = topic.subscribe(loop, [&](const Event<Number>& e) {
      ++delivered;
      if (e->value < 3) {
        const int before = delivered;
        topic.publish({e->value + 1, 0});  // from inside a handler
        CHECK(delivered == before);
      }
    });
    topic.publish({0, 0});
    CHECK(delivered == 0);
    CHECK(subscription.counts().queued == 1);
    loop.poll();
    CHECK(delivered == 4);
    CHECK(subscription.counts().balances());
  }

  TEST_CASE("US-25 order is first in, first out for each origin, numbered without holes, with rising times") {
    Loop loop(Loop::Manual{});
    Feed<Number> a(loop, {.name = "a", .topic = "t"});
    Feed<Number> b(loop, {.name = "b", .topic = "t"});
    std::vector<std::pair<std::string, std::uint64_t>> seen;
    Time last[2] = {Time::min(), Time::min()};
    bool rising = true;
    const auto subscription = loop.subscribe<Number>("t", [&](const Event<Number>& e) {
      seen.emplace_back(e.origin, e.sequence);
      Time& before = last[e.origin == "a" ? 0 : 1];
      rising = rising && e.time > before;
      before = e.time;
    });
    for (int i = 0; i < 50; ++i) {
      a.publish({});
      if (i % 2 == 0) b.publish({}, Time{});
    }
    loop.poll();
    CHECK(seen.size() == 75);
    std::uint64_t next[2] = {1, 1};
    for (const auto& [origin, sequence] : seen) CHECK(sequence == next[origin == "a" ? 0 : 1]++);
    CHECK(rising);
  }

  TEST_CASE("US-28 nothing published before a subscription reaches it, even if still queued") {
    Loop loop(Loop::Manual{});
    const auto topic = loop.topic<Number>("t");
    std::vector<double> first;
    std::vector<double> second;
    const auto one = topic.subscribe(loop, [&](const Event<Number>& e) { first.push_back(e->value); });
    topic.publish({1, 0});
    const auto two = topic.subscribe(loop, [&](const Event<Number>& e) { second.push_back(e->value); });
    topic.publish({2, 0});
    loop.poll();
    CHECK(first == std::vector<double>{1, 2});
    CHECK(second == std::vector<double>{2});
    CHECK(two.counts().offered == 1);
  }

  TEST_CASE("US-29 unsubscribing at any time, inside the own callback and inside another's, cancels what is queued") {
    Loop loop(Loop::Manual{});
    const auto topic = loop.topic<Number>("t");
    int calls[4] = {};
    Subscription subscriptions[4];
    for (std::size_t i = 0; i < 4; ++i) {
      subscriptions[i] = topic.subscribe(loop, [&, i](const Event<Number>& e) {
        ++calls[i];
        if (i == 1 && e->value == 5) {
          subscriptions[0].close();  // before it in the row
          subscriptions[1].close();  // itself
          subscriptions[3].close();  // after it
        }
      });
    }
    for (int i = 1; i <= 40; ++i) topic.publish({static_cast<double>(i), 0});
    loop.poll();
    CHECK(calls[0] >= 5);
    CHECK(calls[1] == 5);
    CHECK(calls[2] == 40);
    CHECK(calls[3] <= 5);
    const auto sum = loop.runtime().topics()[0].subscriptions;
    CHECK(sum.offered == 160);
    CHECK(sum.delivered == static_cast<std::uint64_t>(calls[0] + calls[1] + calls[2] + calls[3]));
    CHECK(sum.queued == 0);
    CHECK(sum.balances());
    topic.publish({});
    subscriptions[2].close();
    loop.poll();
    CHECK(calls[2] == 40);
    CHECK(loop.runtime().topics()[0].subscriptions.cancelled == 160 + 1 - sum.delivered);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("US-29 subscribing in the report of a handler that took too long, and closing that handler") {
    Loop loop(Loop::Manual{});
    const auto topic = loop.topic<Number>("a");
    std::vector<Subscription> others;
    int late = 0;
    Subscription slow = topic.subscribe(loop, [&](const Event<Number>&) { loop.manual_clock().pass(50ms); });
    loop.on_error([&](const ErrorReport&) {
      for (int i = 0; i < 50; ++i) others.push_back(topic.subscribe(loop, [&](const Event<Number>&) { ++late; }));
      slow.close();
    });
    topic.publish({});
    loop.advance(10ms);
    CHECK(others.size() == 50);
    CHECK_FALSE(slow.is_open());
    topic.publish({});
    loop.advance(10ms);
    CHECK(late == 50);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("US-25 topics that feed each other hold neither a run nor the end") {
    std::uint64_t seen = 0;
    const auto circle = [&](Loop& loop) {
      const auto a = loop.topic<Number>("a");
      const auto b = loop.topic<Number>("b");
      std::vector<Subscription> both;
      both.push_back(a.subscribe(loop, [b, &seen](const Event<Number>& e) {
        ++seen;
        b.publish(e.data);
      }));
      both.push_back(b.subscribe(loop, [a](const Event<Number>& e) { a.publish(e.data); }));
      a.publish({});
      return both;
    };
    SUBCASE("virtual time") {
      Loop loop(Loop::Manual{});
      const auto both = circle(loop);
      int ticks = 0;
      Ticker ticker(loop, 10ms, [&](const Tick&) { ++ticks; });
      loop.advance(100ms);
      CHECK(ticks == 11);
      loop.close();
      CHECK(loop.runtime().balances());
    }
    SUBCASE("real time") {
      Loop loop;
      const auto both = circle(loop);
      loop.poll();
      CHECK(run_until(loop, [&] { return seen > 10; }));
      loop.close();
      CHECK(loop.runtime().balances());
    }
    CHECK(seen > 10);
  }

  TEST_CASE("US-25 a long row of handlers that publish for the next is delivered at one instant") {
    Loop loop(Loop::Manual{});
    constexpr std::size_t length = 50;
    std::vector<Topic<Number>> topics;
    std::vector<Subscription> handlers;
    for (std::size_t i = 0; i <= length; ++i) topics.push_back(loop.topic<Number>("t" + std::to_string(i)));
    int arrived = 0;
    for (std::size_t i = 0; i < length; ++i) {
      handlers.push_back(
          topics[i].subscribe(loop, [next = topics[i + 1]](const Event<Number>& e) { next.publish(e.data); }));
    }
    handlers.push_back(topics[length].subscribe(loop, [&](const Event<Number>&) { ++arrived; }));
    topics[0].publish({});
    loop.advance(0ns);
    CHECK(arrived == 1);
  }

  TEST_CASE("US-29 subscribing inside a handler, many times over") {
    Loop loop(Loop::Manual{});
    const auto topic = loop.topic<Number>("t");
    std::vector<Subscription> more;
    int calls = 0;
    const auto subscription = topic.subscribe(loop, [&](const Event<Number>&) {
      for (int i = 0; i < 50; ++i) more.push_back(topic.subscribe(loop, [&](const Event<Number>&) { ++calls; }));
    });
    topic.publish({});
    topic.publish({});
    loop.poll();
    CHECK(calls == 0);
    CHECK(more.size() == 100);
    topic.publish({});
    loop.poll();
    CHECK(calls == 100);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("US-29 a sensor that is stopped cancels its queued events; the event in hand stays readable") {
    Loop loop(Loop::Manual{});
    Feed<Number> a(loop, {.name = "a", .topic = "t"});
    Feed<Number> b(loop, {.name = "b", .topic = "t"});
    std::vector<std::string> seen;
    const auto first = loop.subscribe<Number>("t", [&](const Event<Number>& e) {
      a.stop();
      seen.emplace_back(e.origin);
    });
    const auto second = loop.subscribe<Number>("t", [&](const Event<Number>& e) { seen.emplace_back(e.origin); });
    a.publish({});
    a.publish({});
    b.publish({});
    loop.poll();
    CHECK(seen == std::vector<std::string>{"a", "b", "b"});
    CHECK(first.counts().delivered == 2);
    CHECK(first.counts().cancelled == 1);
    CHECK(second.counts().cancelled == 2);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("US-25 a full ring drops the new event for each subscription and counts it") {
    Runtime runtime({.ring_events = 8});
    Loop loop(runtime, {});
    const auto topic = loop.topic<Number>("t");
    std::vector<double> seen;
    const auto subscription = topic.subscribe(loop, [&](const Event<Number>& e) { seen.push_back(e->value); });
    const auto other = topic.subscribe(loop, [](const Event<Number>&) {});
    for (int i = 0; i < 20; ++i) topic.publish({static_cast<double>(i), 0});
    loop.poll();
    CHECK(seen == std::vector<double>{0, 1, 2, 3, 4, 5, 6, 7});
    CHECK(subscription.counts().dropped == 12);
    CHECK(other.counts().dropped == 12);
    CHECK(runtime.topics()[0].published == 20);
    CHECK(runtime.balances());
    const auto late = topic.subscribe(loop, [](const Event<Number>&) {});
    CHECK(late.counts().dropped == 0);
  }

  TEST_CASE("US-25 a burst of deliveries does not hold back the next tick") {
    Loop loop(Loop::Manual{});
    const auto topic = loop.topic<Number>("t");
    int delivered = 0;
    const auto slow = topic.subscribe(loop, [&](const Event<Number>&) {
      ++delivered;
      loop.manual_clock().pass(400us);
    });
    Duration worst{};
    Ticker ticker(loop, 5ms, [&](const Tick& tick) { worst = std::max(worst, tick.lateness()); });
    for (int i = 0; i < 1000; ++i) topic.publish({});
    loop.advance(1s);
    CHECK(delivered == 1000);
    CHECK(ticker.missed() == 0);
    // The budget of 1 ms, and one group of at most 16 in the beginning; later groups are of one event.
    CHECK(worst <= 1ms + 16 * 400us);
  }

  TEST_CASE("US-25 a tick is late by at most the budget and one group of callbacks, whatever the handlers take") {
    for (const Duration budget : {Duration{200us}, Duration{1ms}, Duration{5ms}}) {
      for (const Duration took : {Duration{0}, Duration{4us}, Duration{60us}, Duration{700us}, Duration{8ms}}) {
        CAPTURE(budget.count());
        CAPTURE(took.count());
        Loop loop(Loop::Manual{}, {.delivery_budget = budget, .hold_limit = 1s});
        Duration takes = took;
        std::vector<Topic<Number>> topics;
        std::vector<Subscription> handlers;
        int delivered = 0;
        for (const char* name : {"a", "b", "c"}) {
          topics.push_back(loop.topic<Number>(name));
          for (int i = 0; i < 2; ++i) {
            handlers.push_back(topics.back().subscribe(loop, [&](const Event<Number>&) {
              ++delivered;
              loop.manual_clock().pass(takes);
            }));
          }
        }
        Duration worst{};
        Ticker ticker(loop, 3ms, [&](const Tick& tick) { worst = std::max(worst, tick.lateness()); });
        const auto publish = [&](int count) {
          for (int i = 0; i < count; ++i)
            for (Topic<Number>& topic : topics) topic.publish({});
        };
        publish(40);  // from which it learns what the handlers take
        loop.advance(10s);
        worst = {};
        publish(300);
        loop.advance(20s);
        CHECK(delivered == 340 * 6);
        CHECK(worst <= budget + std::max(took, Duration{5us}));  // one handler, or quick ones of 5 us together
        // Quick ones that take long all at once, once: 128 of them at most.
        takes = Duration{0};
        for (int i = 0; i < 20; ++i) {
          publish(300);
          loop.advance(10ms);
        }
        worst = {};
        takes = 50us;
        publish(300);
        loop.advance(1s);
        CHECK(worst <= budget + 128 * takes);
        CHECK(worst > Duration{0});
        worst = {};
        publish(300);
        loop.advance(1s);
        CHECK(worst <= budget + takes);
        CHECK(delivered == (340 + 20 * 300 + 600) * 6);
      }
    }
  }

  TEST_CASE("US-25 an event for many slow handlers does not hold back the next tick") {
    Loop loop(Loop::Manual{});
    const auto topic = loop.topic<Number>("t");
    std::vector<int> order;
    std::vector<Subscription> slow;
    for (int i = 0; i < 100; ++i) {
      slow.push_back(topic.subscribe(loop, [&, i](const Event<Number>& event) {
        order.push_back(event->index * 100 + i);
        loop.manual_clock().pass(100us);
      }));
    }
    Duration worst{};
    Ticker ticker(loop, 5ms, [&](const Tick& tick) { worst = std::max(worst, tick.lateness()); });
    for (int i = 0; i < 3; ++i) topic.publish({0, i});
    loop.advance(100ms);
    CHECK(worst <= 100us);  // one handler, not all of them
    CHECK(ticker.missed() == 0);
    REQUIRE(order.size() == 300);
    CHECK(std::is_sorted(order.begin(), order.end()));  // each handler once an event, and in its place
  }

  TEST_CASE("US-25 handlers of nanoseconds are timed in groups of events, however many handlers there are") {
    Loop loop(Loop::Manual{});
    const auto topic = loop.topic<Number>("t");
    std::vector<Subscription> quick;
    for (int i = 0; i < 200; ++i)
      quick.push_back(topic.subscribe(loop, [&](const Event<Number>&) { loop.manual_clock().pass(30ns); }));
    for (int i = 0; i < 1000; ++i) topic.publish({0, i});
    loop.advance(1s);
    CHECK(quick.front().counts().delivered == 1000);
    CHECK(quick.front().times().count < 50);
    CHECK(quick.front().times().max <= 5us);
  }

  TEST_CASE("US-25 one busy topic does not hold the deliveries of others") {
    Loop loop(Loop::Manual{});
    const auto busy = loop.topic<Number>("busy");
    const auto calm = loop.topic<Number>("calm");
    int delivered = 0;
    int before_calm = -1;
    const auto a = busy.subscribe(loop, [&](const Event<Number>&) { ++delivered; });
    const auto b = calm.subscribe(loop, [&](const Event<Number>&) { before_calm = delivered; });
    for (int i = 0; i < 500; ++i) busy.publish({});
    calm.publish({});
    loop.poll();
    CHECK(delivered == 500);
    CHECK(before_calm <= 16);
  }

  TEST_CASE("US-25 a handler that blocks 500 ms delays its own loop, is blamed, and the ticks it cost are counted") {
    Loop loop(Loop::Manual{});
    std::vector<std::string> blamed;
    loop.on_error([&](const ErrorReport& report) {
      CHECK(report.error.code == Errc::held_too_long);
      blamed.emplace_back(report.object);
    });
    const auto topic = loop.topic<Number>("t");
    auto blocker = topic.subscribe(loop, [&](const Event<Number>&) { loop.manual_clock().pass(500ms); });
    blocker.set_name("handler blocker");
    int others = 0;
    const auto other = topic.subscribe(loop, [&](const Event<Number>&) { ++others; });
    Ticker ticker(loop, 10ms, [&](const Tick& tick) {
      if (tick.index == 10) topic.publish({});
    });
    loop.advance(1s);
    CHECK(blamed == std::vector<std::string>{"handler blocker"});
    CHECK(ticker.fired() + ticker.missed() == 101);
    CHECK(ticker.missed() == 49);  // due at 110 ... 590, the one of 600 is taken
    CHECK(others == 1);
    CHECK(blocker.times().max == 500ms);
  }

  TEST_CASE("US-25 a handler that throws is reported, others go on, and it goes on being called") {
    Loop loop(Loop::Manual{});
    std::vector<std::string> errors;
    loop.on_error(
        [&](const ErrorReport& report) { errors.push_back(std::string(report.object) + ": " + report.error.why); });
    const auto topic = loop.topic<Number>("t");
    int bad = 0;
    int good = 0;
    const auto a = topic.subscribe(loop, [&](const Event<Number>&) {
      ++bad;
      throw std::runtime_error("no luck");
    });
    const auto b = topic.subscribe(loop, [&](const Event<Number>&) { ++good; });
    topic.publish({});
    topic.publish({});
    loop.poll();
    CHECK(bad == 2);
    CHECK(good == 2);
    CHECK(errors == std::vector<std::string>{"handler of t: no luck"});
    CHECK(a.counts().delivered == 2);
  }

  TEST_CASE("US-28 patterns: + is one level, # all below, topics made later count too, $ only when written out") {
    Loop loop(Loop::Manual{});
    int plus = 0;
    int all = 0;
    int own = 0;
    const auto one = loop.subscribe("room/+", [&](const EventView&) { ++plus; });
    const auto two = loop.subscribe("#", [&](const EventView&) { ++all; });
    const auto three = loop.subscribe("$rtdata/#", [&](const EventView&) { ++own; });
    for (const char* name : {"room", "room/a", "room/b", "room/a/deep", "$rtdata/health"})
      loop.topic<Number>(name).publish({});
    loop.poll();
    CHECK(plus == 2);
    CHECK(all == 4);
    CHECK(own == 1);
    CHECK(loop.runtime().balances());
  }

  TEST_CASE("names and patterns of topics") {
    for (const char* good : {"a", "a/b", "A.b-c_9/x", "$rtdata/x"}) CHECK(is_topic_name(good));
    for (const char* bad : {"", "/", "a/", "/a", "a//b", "a b", "+", "a/#", "a/$b", "$"})
      CHECK_FALSE(is_topic_name(bad));
    CHECK(is_topic_name(std::string(200, 'a')));
    CHECK_FALSE(is_topic_name(std::string(201, 'a')));
    for (const char* good : {"#", "+", "a/#", "+/b", "a/+/c", "$rtdata/#", "+/#"}) CHECK(is_topic_pattern(good));
    for (const char* bad : {"", "a#", "#/a", "a/#/b", "a+", "+a/b", "/#", "a/"}) CHECK_FALSE(is_topic_pattern(bad));
    CHECK(topic_matches("a/#", "a"));
    CHECK(topic_matches("+/#", "a"));
    CHECK_FALSE(topic_matches("a/+", "a"));
    CHECK_FALSE(topic_matches("+", "a/b"));
    CHECK_FALSE(topic_matches("a", "a/b"));
    CHECK_FALSE(topic_matches("+/x", "$rtdata/x"));
    CHECK_FALSE(topic_matches("#", "$rtdata/x"));
    Loop loop(Loop::Manual{});
    CHECK_THROWS_AS(loop.topic<Number>("a b"), SetupError);
    CHECK_THROWS_AS((void)loop.subscribe("a#", [](const EventView&) {}), SetupError);
    loop.topic<Number>("room");
    CHECK(loop.topic<Number>("Room").name() == "Room");  // another one
  }

  TEST_CASE("a second payload on a topic is refused, naming both") {
    Loop loop(Loop::Manual{});
    loop.topic<Number>("t");
    loop.topic<Tracked>("moved");
    const auto text_of = [&](auto&& call) {
      try {
        call();
      } catch (const SetupError& e) {
        CHECK(e.error().code == Errc::description_differs);
        return std::string(e.what());
      }
      return std::string("nothing was thrown");
    };
    const auto contains = [](const std::string& text, const char* part) {
      return text.find(part) != std::string::npos;
    };
    std::string text = text_of([&] { loop.topic<WrongUnit>("t"); });
    CHECK_MESSAGE((contains(text, "\"number\"") && contains(text, "\"wrong_unit\"")), text);
    text = text_of([&] { loop.topic<std::string>("moved"); });
    CHECK_MESSAGE((contains(text, "Tracked") && contains(text, "string")), text);
    text = text_of([&] { loop.topic<Tracked>("t"); });
    CHECK_MESSAGE((contains(text, "Tracked") && contains(text, "\"number\"")), text);
    text = text_of([&] { (void)loop.subscribe<WrongUnit>("t", [](const Event<WrongUnit>&) {}); });
    CHECK_MESSAGE((contains(text, "\"number\"") && contains(text, "unit")), text);
    text = text_of([&] { (void)loop.subscribe("moved", [](const EventView&) {}); });
    CHECK_MESSAGE(contains(text, "no description"), text);
  }

  TEST_CASE("US-28 a pattern whose type does not fit a topic is told of, and the others are delivered") {
    Loop loop(Loop::Manual{});
    std::vector<std::string> errors;
    Subscription inner;
    loop.on_error([&](const ErrorReport& report) {
      errors.emplace_back(report.object);
      loop.topic<Number>("x/made_while_telling");
    });
    loop.topic<WrongUnit>("x/wrong");
    loop.topic<Number>("x/right");
    int calls = 0;
    const auto subscription = loop.subscribe<Number>("x/+", [&](const Event<Number>&) { ++calls; });
    CHECK(errors.size() == 1);
    loop.topic<Number>("x/right").publish({});
    loop.topic<Number>("x/made_while_telling").publish({});
    loop.topic<WrongUnit>("x/wrong").publish({});
    loop.poll();
    CHECK(calls == 2);
  }

  TEST_CASE("US-16 a handler gets its fields by name from a payload that lies differently in memory") {
    Loop loop(Loop::Manual{});
    const auto topic = loop.topic<Reordered>("t");
    std::vector<Number> seen;
    const auto subscription = loop.subscribe<Number>("#", [&](const Event<Number>& e) { seen.push_back(*e); });
    topic.publish({7, 3, 1.5});
    loop.poll();
    REQUIRE(seen.size() == 1);
    CHECK(seen[0].value == 1.5);
    CHECK(seen[0].index == 3);
  }

  TEST_CASE("US-25 payloads that are not trivially copyable are moved in once and destroyed once") {
    Tracked::reset();
    {
      Runtime runtime({.ring_events = 4});
      Loop loop(runtime, {});
      const auto topic = loop.topic<Tracked>("t");
      topic.publish(Tracked("nobody listens"));
      CHECK(Tracked::alive() == 0);
      std::vector<std::string> seen;
      auto subscription = topic.subscribe(loop, [&](const Event<Tracked>& e) { seen.push_back(e->text); });
      topic.publish(Tracked("one"));
      topic.publish(Tracked("two"));
      CHECK(Tracked::alive() == 2);
      loop.poll();
      CHECK(seen == std::vector<std::string>{"one", "two"});
      CHECK(Tracked::alive() == 0);
      for (int i = 0; i < 10; ++i) topic.publish(Tracked("burst"));
      CHECK(Tracked::alive() == 4);
      CHECK(subscription.counts().dropped == 6);
      subscription.close();
      loop.poll();
      CHECK(Tracked::alive() == 0);
      CHECK(runtime.balances());
      subscription = topic.subscribe(loop, [](const Event<Tracked>&) {});
      topic.publish(Tracked("left behind"));
      Tracked::throw_on_move = true;
      CHECK_THROWS(topic.publish(Tracked("unmovable")));
      Tracked::throw_on_move = false;
      CHECK(subscription.counts().dropped == 7 - 6);
      CHECK(runtime.balances());
    }
    CHECK(Tracked::alive() == 0);
    CHECK(Tracked::copies == 0);
  }

  TEST_CASE("nothing is kept for a handler that has closed its own subscription") {
    Tracked::reset();
    Loop loop{Loop::Manual{}};
    const auto topic = loop.topic<Tracked>("t");
    Subscription subscription;
    subscription = topic.subscribe(loop, [&](const Event<Tracked>&) { subscription.close(); });
    topic.publish(Tracked("the last one"));
    loop.poll();
    CHECK(Tracked::alive() == 0);
    topic.publish(Tracked("nobody listens"));
    CHECK(Tracked::alive() == 0);
  }

  TEST_CASE("a runtime goes on after its loop: publishing without one, then on another") {
    Runtime runtime;
    Subscription orphan;
    {
      Loop loop(runtime, {});
      orphan = loop.topic<Number>("t").subscribe(loop, [](const Event<Number>&) {});
      loop.topic<Number>("t").publish({});
      CHECK(orphan.counts().queued == 1);
    }
    Loop other(runtime, {});
    CHECK_THROWS_WITH_AS(
        Loop(runtime, {.name = "third"}),
        "cannot make a loop: third: its runtime has loop main already: give each loop a runtime of its own; for a loop "
        "on another thread make a Tier [busy]",
        SetupError);
    const auto topic = other.topic<Number>("t");
    topic.publish({});
    int calls = 0;
    const auto subscription = topic.subscribe(other, [&](const Event<Number>&) { ++calls; });
    topic.publish({});
    other.poll();
    CHECK(calls == 1);
    CHECK(runtime.balances());
    Loop stranger;
    CHECK_THROWS_AS((void)topic.subscribe(stranger, [](const Event<Number>&) {}), SetupError);
  }
}
