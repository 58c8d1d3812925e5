#include "rtdata/sinks/console.hpp"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <poll.h>
#include <unistd.h>

#include "data/payloads.hpp"
#include "rtdata/config/read.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

struct Pipe {
  Pipe() {
    REQUIRE(::pipe2(ends, O_CLOEXEC) == 0);
    ::fcntl(ends[0], F_SETFL, O_NONBLOCK);
  }
  ~Pipe() {
    close_reader();
    ::close(ends[1]);
  }
  void close_reader() {
    if (ends[0] >= 0) ::close(ends[0]);
    ends[0] = -1;
  }
  bool has_text() const {
    pollfd reader{ends[0], POLLIN, 0};
    return ::poll(&reader, 1, 0) == 1;
  }
  std::string read_all() {
    std::string text;
    char buffer[4096];
    for (ssize_t got; (got = ::read(ends[0], buffer, sizeof buffer)) > 0;)
      text.append(buffer, static_cast<std::size_t>(got));
    return text;
  }
  int ends[2];
};

struct Label {
  text<15> word;
  friend constexpr auto describe(type_tag<Label>) { return record("label", field("word", &Label::word)); }
};

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("the console shows time, topic, origin, number and fields with units") {
    Pipe pipe;
    Loop loop{Loop::Manual{}};
    loop.advance(123ms);  // the manual time of day starts at 22:13:20
    ConsoleSink sink(loop, {.descriptor = pipe.ends[1]});
    Feed<payloads::Climate> room(loop, {.name = "room", .topic = "room/climate"});
    room.publish({21.5, 40});
    Feed<Label> label(loop, {.name = "label"});
    Label word;
    word.word.assign("a\x1b[31m\xc2\x9b").or_throw();
    label.publish(word);
    loop.advance(200ms);
    CHECK(pipe.read_all() ==
          "22:13:20.123 room/climate room #1 temperature=21.5 Cel humidity=40 %RH\n"
          "22:13:20.123 label label #1 word=a\\x1b[31m\\xc2\\x9b\n");
    CHECK(sink.counts().stored == 2);
  }

  TEST_CASE("a reader that has gone ends the console, and not the program") {
    Pipe pipe;
    Loop loop{Loop::Manual{}};
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    ConsoleSink sink(loop, {.descriptor = pipe.ends[1]});
    loop.topic<Number>("a").publish({1});
    loop.advance(1s);
    pipe.close_reader();
    for (int i = 0; i < 5; ++i) {
      loop.topic<Number>("a").publish({2});
      loop.advance(1s);
    }
    CHECK(sink.health() == Health::faulted);
    CHECK(sink.counts().stored == 1);
    CHECK(sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] == 5);
    CHECK(errors == std::vector<std::string>{"printing has ended: descriptor " + std::to_string(pipe.ends[1]) +
                                             ": its reader has closed it"});
    CHECK(loop.close() == 0);
  }

  TEST_CASE("NFR-1 a pipe that nobody reads does not stop the loop") {
    Pipe pipe;
    Loop loop;
    std::uint64_t reports = 0;
    loop.on_error([&](const ErrorReport&) { ++reports; });
    ConsoleConfig config{.descriptor = pipe.ends[1]};
    config.sink.queue_bytes = 256 << 10;
    config.sink.close_deadline = 0ms;
    ConsoleSink sink(loop, config);
    const auto topic = loop.topic<Number>("a");
    Ticker ticker(loop, 100us, [&](const Tick&) {
      for (int i = 0; i < 100; ++i) topic.publish({1});
      if (sink.counts().all_dropped() > 0 && pipe.has_text()) loop.stop();
    });
    loop.run();
    ticker.close();
    sink.close();
    const SinkStatus last = loop.runtime().sinks().front();
    CHECK(last.counts.balances());
    CHECK(last.counts.all_dropped() > 0);
    CHECK(pipe.read_all().size() > 0);
  }

  TEST_CASE("the console tells what it cannot print to") {
    Pipe pipe;
    Loop loop{Loop::Manual{}};
    CHECK_THROWS_AS(ConsoleSink(loop, {.descriptor = pipe.ends[0]}), SetupError);
    CHECK_THROWS_AS(ConsoleSink(loop, {.descriptor = 9999}), SetupError);
    CHECK(parameters_of<ConsoleConfig>().size() == 13);
  }
}
