// What the program shows of a run.
#include "app/account.hpp"

#include <doctest/doctest.h>

#include "app/live_view.hpp"
#include "rtdata/loop/loop.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

bool has(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("the table and the live view say what sinks dropped of each topic, while it runs and at the end") {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    const auto script = std::make_shared<ScriptedWriter::Script>();
    app::LiveView view(loop);
    Sink sink(loop, {.name = "script", .batch_rows = 10}, std::make_unique<ScriptedWriter>(script));
    script->refused_value = 4;
    for (int i = 1; i <= 10; ++i) loop.topic<Number>("some/a").publish({static_cast<double>(i)});
    for (int i = 0; i < 3; ++i) loop.topic<Number>("some/b").publish({10});
    loop.advance(2s);
    const auto dropped = [&](const app::RunAccount& account, std::string_view topic) {
      for (const app::TopicAccount& one : account.topics)
        if (one.topic == topic) return one.dropped;
      return std::uint64_t{999};
    };
    app::RunAccount account = app::account_of(loop.runtime());
    CHECK(dropped(account, "some/a") == 1);
    CHECK(dropped(account, "some/b") == 0);
    CHECK(account.dropped == 1);
    const std::string frame = view.frame(account, 100, 24, "");
    CHECK(has(frame, "failed    lost dropped  last value"));
    CHECK(has(frame, "       0       0       1  10 V"));
    CHECK(has(app::summary(account, {}),
              "topic   events  late  missed  failed  lost  dropped  health\n"
              "some/a      10     0       0       0     0        1  ok\n"
              "some/b       3     0       0       0     0        0  ok\n"));

    // What is never stored counts for its topic too.
    script->failures = 1'000'000;
    for (int i = 0; i < 5; ++i) loop.topic<Number>("some/b").publish({20});
    CHECK(loop.close(1s) == 5);
    account = app::account_of(loop.runtime());
    CHECK(dropped(account, "some/a") == 1);
    CHECK(dropped(account, "some/b") == 5);
    CHECK(account.dropped == 6);
  }
}
