// The HTTP sink at real servers: one that misbehaves as it is told (http_server.py), and nginx (http_tls_test.cpp).
#ifdef RTDATA_WITH_HTTP
#include "rtdata/sinks/http.hpp"
#include "has.hpp"

#include <fcntl.h>
#include <sys/socket.h>

#include <map>

#include "rtdata/loop/ledger.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "sinks/http_bench.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;
using Json = HttpServer::Json;

namespace {

using rtdata::test::has;

/// How often each event came, by its key; the server took it each time.
std::map<std::string, int> arrivals(const HttpServer& server) {
  std::map<std::string, int> keys;
  for (const Json& event : server.events())
    ++keys[event["run"].get<std::string>() + " " + event["origin"].get<std::string>() + " " + event["sequence"].dump()];
  return keys;
}

/// Everything published has come, once each, and the account says the same.
void check_all_once(HttpBench& bench, const HttpServer& server) {
  CHECK_MESSAGE(bench.is_all_sent(), bench.said());
  CHECK(server.sequences() == bench.all());
  for (const auto& one : arrivals(server)) CHECK_MESSAGE(one.second == 1, one.first);
  const SinkCounts counts = bench.sink.counts();
  CHECK(counts.balances());
  CHECK(counts.offered == bench.published);
  CHECK(counts.stored == bench.published);
}

#define NEEDS_PYTHON()                                              \
  if (!is_program(python)) {                                        \
    MESSAGE("skipped: there is no " << python << ", which serves"); \
    return;                                                         \
  }

}  // namespace

TEST_SUITE_BEGIN("sinks");

TEST_CASE("US-32 a server of HTTP gets the final account in the last request, when it is asked for") {
  if (!is_program(python)) {
    MESSAGE("skipped: there is no python3");
    return;
  }
  HttpServer server;
  HttpBench bench({.server = {.url = server.url()}, .sink = {.topics = {"#", account_topic}}});
  bench.publish(42);
  CHECK(bench.is_all_sent());
  bench.publish(3);
  std::optional<std::uint64_t> lost;
  bench.loop.drain(20s, [&](std::uint64_t count) { lost = count; });
  CHECK(wait_for(bench.loop, [&] { return lost.has_value(); }));
  CHECK(lost == 0);
  const auto events = server.events();
  REQUIRE(events.size() == 46);
  CHECK(events.back()["topic"] == account_topic);
  CHECK(events.back()["run"] == events.front()["run"]);
  CHECK(events.back()["data"]["name"] == "chamber");
  CHECK(events.back()["data"]["published"] == 45);
}

TEST_CASE("US-32 events go out by HTTP: JSON in arrays, with their keys, many on one connection") {
  NEEDS_PYTHON();
  HttpServer server;
  HttpBench bench(
      {.server = {.url = server.url("/in?a=b"), .headers = {{"X-Site", "roof"}, {"X-Empty", ""}}, .bearer = "token-1"},
       .sending = {.window = 4, .parcel_rows = 10}});
  for (int i = 0; i < 5; ++i) {
    bench.publish(40);
    CHECK(bench.is_all_sent());
  }
  check_all_once(bench, server);
  std::set<int> connections;
  std::set<std::string> keys;
  for (const Json& request : server.requests()) {
    connections.insert(request["port"].get<int>());
    const Json& headers = request["headers"];
    keys.insert(headers["Idempotency-Key"].get<std::string>());
    CHECK(request["method"] == "POST");
    CHECK(request["path"] == "/in?a=b");
    CHECK(headers["Content-Type"] == "application/json");
    CHECK(headers["Authorization"] == "Bearer token-1");
    CHECK(headers["X-Site"] == "roof");
    CHECK(headers["X-Empty"] == "");
    CHECK(!headers.contains("Expect"));
    CHECK(headers["User-Agent"].get<std::string>().starts_with("rtdata/"));
    const Json events = Json::parse(request["body"].get<std::string>());
    CHECK(events.size() <= 10);
    CHECK(events[0]["topic"] == "test/number");
    CHECK(events[0]["origin"] == "chamber");
    CHECK(events[0]["run"].get<std::string>().size() == 36);
    CHECK(events[0]["data"]["value"].get<double>() == events[0]["sequence"].get<double>());
  }
  CHECK(connections.size() <= 4);
  CHECK(keys.size() == server.request_count());
  CHECK(bench.errors.empty());
}

TEST_CASE(
    "US-32 US-31 every format by its name, with its type: one event a request, PUT, gzip, a format of one's own") {
  NEEDS_PYTHON();
  class Hash final : public Codec {
   public:
    std::string_view name() const noexcept override { return "hash"; }
    Result<void> encode(const EventView& event, std::vector<std::byte>& out) override {
      if (event.sequence() == 3) return Error{Errc::does_not_fit, "cannot write", "", "three is too many", ""};
      out.push_back(std::byte{'#'});
      return {};
    }
    Result<DecodedEvent> decode(std::span<const std::byte>, const Description&) override {
      return Error{Errc::bad_data, "", "", "", ""};
    }
  };
  HttpServer server;
  const auto body_of = [&](HttpConfig config, const CodecRegistry& formats = CodecRegistry::standard()) {
    server.forget();
    HttpBench bench(config, formats);
    bench.publish(3);
    REQUIRE_MESSAGE(bench.is_all_sent(), bench.said());
    return server.requests();
  };
  auto requests = body_of({.server = {.url = server.url()}, .format = "jsonl"});
  CHECK(requests.at(0)["headers"]["Content-Type"] == "application/x-ndjson");
  CHECK(server.sequences() == std::set<std::uint64_t>{1, 2, 3});

  requests = body_of(
      {.server = {.url = server.url()}, .method = HttpMethod::put, .sending = {.window = 1, .parcel_rows = 1}});
  CHECK(requests.size() == 3);
  CHECK(requests.at(1)["method"] == "PUT");
  CHECK(Json::parse(requests.at(1)["body"].get<std::string>())["sequence"] == 2);

  requests = body_of({.server = {.url = server.url()}, .format = "cbor"});
  CHECK(requests.at(0)["headers"]["Content-Type"] == "application/cbor-seq");
  CHECK(requests.at(0)["body"].get<std::string>().size() > 3 * 80);

  requests = body_of({.server = {.url = server.url(), .user = "u", .password = "pass"}, .format = "influx"});
  CHECK(requests.at(0)["headers"]["Content-Type"] == "text/plain; charset=utf-8");
  CHECK(requests.at(0)["headers"]["Authorization"] == "Basic dTpwYXNz");
  CHECK(requests.at(0)["body"].get<std::string>().starts_with("test/number,origin=chamber value=1,sequence=1i,run=\""));

  requests = body_of({.server = {.url = server.url()}, .content_type = "text/x", .compression = HttpCompression::gzip});
  CHECK(requests.at(0)["headers"]["Content-Encoding"] == "gzip");
  CHECK(requests.at(0)["headers"]["Content-Type"] == "text/x");
  CHECK(server.sequences() == std::set<std::uint64_t>{1, 2, 3});

  CodecRegistry formats = CodecRegistry::standard();
  formats.add("hash", [] { return std::make_unique<Hash>(); }).or_throw();
  requests = body_of({.server = {.url = server.url()}, .format = "hash"}, formats);
  CHECK(requests.at(0)["body"] == "##");
  CHECK(requests.at(0)["headers"]["Content-Type"] == "application/octet-stream");
  Loop loop{Loop::Manual{}};
  CHECK_THROWS_AS(HttpSink(loop, {.server = {.url = server.url()}, .format = "hash"}), SetupError);
  CHECK_THROWS_AS(HttpSink(loop, {.server = {.url = "nonsense"}}), SetupError);
}

TEST_CASE("US-32 NFR-1 a server that is not there yet, is killed in the middle, and comes back: everything arrives") {
  NEEDS_PYTHON();
  HttpServer server;
  server.kill();
  HttpBench bench({.server = {.url = server.url()}, .sending = {.window = 2, .parcel_rows = 5}});
  std::uint64_t ticks = 0;
  Ticker ticker(bench.loop, 10ms, [&](const Tick&) { ++ticks; });
  bench.publish(23);
  CHECK(bench.is_faulted());
  CHECK_MESSAGE(has(bench.reason(), "no program listens there"), bench.reason());
  bench.loop.advance(60s);
  CHECK(ticker.missed() == 0);
  CHECK(ticks >= 6000);
  CHECK(bench.sink.counts().queued == 23);
  server.start();
  bench.loop.advance(10s);
  check_all_once(bench, server);
  CHECK(bench.sink.health() == Health::ok);

  bench.publish(7);
  CHECK(bench.is_all_sent());
  server.kill();
  bench.publish(30);
  CHECK(bench.is_faulted());
  server.start();
  bench.loop.advance(11s);
  check_all_once(bench, server);
}

TEST_CASE("US-32 a server that takes the events and gives no answer: they come again, under the same keys") {
  NEEDS_PYTHON();
  for (const char* mode : {"hang", "lost", "half"}) {
    CAPTURE(mode);
    HttpServer server;
    server.become(mode);
    HttpBench bench({.server = {.url = server.url()}, .sending = {.window = 1, .parcel_rows = 10, .timeout = 5s}});
    bench.publish(10);
    REQUIRE(wait_for(bench.loop, [&] { return server.request_count() >= 1; }));
    if (std::string(mode) == "hang") bench.loop.advance(5s);
    CHECK(bench.is_faulted());
    CHECK_MESSAGE(has(bench.reason(), std::string(mode) == "hang" ? "there was no answer in 5 s" : "closed before"),
                  bench.reason());
    server.become("ok");
    bench.loop.advance(1s);
    check_all_once(bench, server);
    const auto requests = server.requests();
    CHECK(requests.front()["headers"]["Idempotency-Key"] == requests.back()["headers"]["Idempotency-Key"]);
    CHECK(requests.front()["body"] == requests.back()["body"]);
  }
}

TEST_CASE("US-32 NFR-1 a server that answers a byte a second, garbage, without an end, or closes in the middle") {
  NEEDS_PYTHON();
  const std::map<std::string, std::string> modes{{"drip", "there was no answer in 2 s"},
                                                 {"garbage", "the answer is not HTTP"},
                                                 {"endless", "longer than 1 MiB"},
                                                 {"close", "closed before"}};
  for (const auto& each : modes) {
    const auto& mode = each.first;
    const auto& reason = each.second;
    CAPTURE(mode);
    HttpServer server;
    server.become(mode);
    HttpBench bench({.server = {.url = server.url()}, .sending = {.timeout = 2s}});
    bench.publish(50);
    REQUIRE(wait_for(bench.loop, [&] { return server.request_count() >= 1; }));
    if (mode == "drip") bench.loop.advance(2s);
    CHECK(bench.is_faulted());
    CHECK_MESSAGE(has(bench.reason(), reason), bench.reason());
    CHECK(bench.sink.counts().queued == 50);
    server.become("ok");
    bench.loop.advance(1s);
    check_all_once(bench, server);
  }
}

TEST_CASE("US-32 a server that answers 500 for a minute, or asks for time") {
  NEEDS_PYTHON();
  HttpServer server;
  server.become("status 500 -- out of order");
  HttpBench bench({.server = {.url = server.url()}, .sink = {.name = "collector"}});
  bench.publish(10);
  CHECK(bench.is_faulted());
  CHECK_MESSAGE(has(bench.reason(), "500 Internal Server Error: out of order"), bench.reason());
  for (int second = 0; second < 60; ++second) {
    bench.loop.advance(1s);
    for (int i = 0; i < 5; ++i) (void)wait_for(bench.loop, [looks = 0]() mutable { return ++looks > 1; });
  }
  CHECK(server.request_count() >= 5);
  CHECK(server.request_count() <= 20);  // the delay doubles, up to 10 s
  server.become("ok");
  bench.loop.advance(11s);
  check_all_once(bench, server);

  for (const std::string wish : {"30", "date"}) {
    CAPTURE(wish);
    server.forget();
    std::string after = wish;
    if (wish == "date") {
      char text[64];
      const std::time_t in = std::time(nullptr) + 31;
      std::tm parts{};
      ::gmtime_r(&in, &parts);
      std::strftime(text, sizeof text, "%a,_%d_%b_%Y_%H:%M:%S_GMT", &parts);
      after = text;
    }
    server.become("status 503 Retry-After:" + after);
    bench.publish(1);
    CHECK(bench.is_faulted());
    server.become("ok");
    server.forget();
    bench.loop.advance(25s);
    CHECK(server.request_count() == 0);
    bench.loop.advance(7s);
    CHECK(bench.is_all_sent());
    CHECK(server.request_count() == 1);
  }
}

TEST_CASE("US-32 an answer that repeats the request shows no secret of the URL, and no half of one") {
  NEEDS_PYTHON();
  HttpServer server;
  const std::string token = "s3cr3t-token-of-the-header";
  for (const std::string& answer :
       {std::string("Cannot POST /hook/0123456789abcdef?key=fedcba9876543210"), std::string("no hook 0123456789abcdef"),
        std::string("the key fedcba9876543210 has expired"), std::string(190, 'x') + token}) {
    CAPTURE(answer);
    server.become("status 404 -- " + answer);
    HttpBench bench({.server = {.url = server.url("/hook/0123456789abcdef?key=fedcba9876543210"), .bearer = token}});
    bench.publish(1);
    CHECK(bench.is_faulted());
    CHECK(has(bench.reason(), "404"));
    for (const char* secret : {"0123456789", "fedcba", "s3cr3t"})
      CHECK_MESSAGE(!has(bench.said(), secret), bench.said());
  }
}

TEST_CASE("US-32 a secret of the URL or of a header is not shown when the server repeats it decoded, or alone") {
  NEEDS_PYTHON();
  HttpServer server;
  for (const char* answer : {"Cannot POST /in/t0k3n7?token=urlS3cret!&key=a b+c", "token urlS3cret! is wrong",
                             "token urlS3cret%21 is wrong", "no key: a b+c", "path t0k3n7", "no site hush5"}) {
    CAPTURE(answer);
    server.become(std::string("status 404 -- ") + answer);
    HttpBench bench({.server = {.url = server.url("/in/t0k3n7?token=urlS3cret%21&key=a+b%2Bc&bucket=bench"),
                                .headers = {{"X-Key", "hush5"}}}});
    bench.publish(1);
    CHECK(bench.is_faulted());
    CHECK_MESSAGE(has(bench.said(), "(secret)"), bench.said());
    for (const char* secret : {"urlS3cret", "a b+c", "a+b", "t0k3n7", "hush5"})
      CHECK_MESSAGE(!has(bench.said(), secret), bench.said());
  }
  server.become("status 404 -- bucket bench not found");  // a word of InfluxDB's is none
  HttpBench bench({.server = {.url = server.url("/api/v2/write?org=lab&bucket=bench")}});
  bench.publish(1);
  CHECK(bench.is_faulted());
  CHECK_MESSAGE(has(bench.said(), "bucket bench not found"), bench.said());
}

TEST_CASE("US-32 a token that has expired throws nothing away, and is never shown") {
  NEEDS_PYTHON();
  HttpServer server;
  for (const char* status : {"401", "403", "404", "405", "407", "301", "302"}) {
    CAPTURE(status);
    server.forget();
    server.become(std::string("status ") + status +
                  " Location:https://other.example/ -- Bearer s3cr3t-token is not known, nor "
                  "dXNlcjpzM2NyM3Q=");
    HttpBench bench({.server = {.url = server.url("/hook/of-mine?key=value"), .bearer = "s3cr3t-token"},
                     .sending = {.window = 1, .parcel_rows = 3},
                     .sink = {.name = "collector", .retry_longest = 1min}});
    bench.publish(20);
    CHECK(bench.is_faulted());
    CHECK_MESSAGE(has(bench.reason(), "nothing is discarded"), bench.reason());
    CHECK(has(bench.reason(), status));
    CHECK_MESSAGE(has(bench.said(), "(secret)"), bench.said());
    for (const char* secret : {"s3cr3t-token", "of-mine", "key=value"})
      CHECK_MESSAGE(!has(bench.said(), secret), bench.said());
    const std::size_t asked = server.request_count();
    bench.loop.advance(50s);
    CHECK(server.request_count() == asked);  // again after the longest delay only
    server.become("ok");
    server.forget();
    bench.loop.advance(20s);
    check_all_once(bench, server);
  }
}

TEST_CASE("US-32 an event that the server does not take costs itself alone, and says why") {
  NEEDS_PYTHON();
  for (const char* format : {"json", "jsonl"}) {
    HttpServer server;
    server.become("refuse 13 77 78");
    HttpBench bench({.server = {.url = server.url()}, .format = format, .sending = {.window = 3, .parcel_rows = 50}});
    bench.publish(100);
    CHECK(bench.is_all_sent());
    std::set<std::uint64_t> expected = bench.all();
    for (const std::uint64_t refused : {13, 77, 78}) expected.erase(refused);
    CHECK(server.sequences() == expected);
    for (const auto& one : arrivals(server)) CHECK_MESSAGE(one.second == 1, one.first);
    const SinkCounts counts = bench.sink.counts();
    CHECK(counts.stored == 97);
    CHECK(counts.dropped[static_cast<std::size_t>(DropReason::refused)] == 3);
    CHECK(counts.balances());
    CHECK_MESSAGE(has(bench.said(), "400 Bad Request: this value"), bench.said());
    CHECK(!has(bench.said(), "is not taken here"));
  }
}

TEST_CASE("US-32 a server that fails among halves gets the rest only, later") {
  NEEDS_PYTHON();
  HttpServer server;
  server.become("refuse 8");
  HttpBench bench({.server = {.url = server.url()}, .sending = {.window = 1, .parcel_rows = 8}});
  bench.publish(8);
  REQUIRE(wait_for(bench.loop, [&] { return server.sequences().size() >= 4; }));  // the first half has been taken
  server.become("status 503");
  (void)bench.is_faulted();
  server.become("refuse 8");
  bench.loop.advance(1s);
  CHECK(bench.is_all_sent());
  for (const auto& one : arrivals(server)) CHECK_MESSAGE(one.second == 1, one.first);
  CHECK(server.sequences() == std::set<std::uint64_t>{1, 2, 3, 4, 5, 6, 7});
  CHECK(bench.sink.counts().stored == 7);
}

TEST_CASE("US-32 what is too large for the server is sent in halves; an event that is too large by itself is refused") {
  NEEDS_PYTHON();
  HttpServer server;
  server.become("limit 1000");
  HttpBench bench({.server = {.url = server.url()}, .sending = {.window = 2, .parcel_rows = 64}});
  bench.publish(128);
  check_all_once(bench, server);
  for (const Json& request : server.requests()) CHECK(request["body"].get<std::string>().size() <= 1000);

  server.become("limit 10");
  bench.publish(4);
  CHECK(bench.is_all_sent());
  CHECK(bench.sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] == 4);
  CHECK_MESSAGE(has(bench.said(), "413 Content Too Large: too long"), bench.said());
}

TEST_CASE("US-32 redirections: followed at the same server, told elsewhere") {
  NEEDS_PYTHON();
  HttpServer server;
  server.become("status 307 Location:/elsewhere");
  HttpBench bench({.server = {.url = server.url()}, .sending = {.window = 1}});
  bench.publish(1);
  CHECK(bench.is_faulted());  // round and round
  CHECK_MESSAGE(has(bench.reason(), "in a circle"), bench.reason());
  CHECK(server.request_count() == 4);
  CHECK(server.requests().back()["path"] == "/elsewhere");
  server.become("ok");
  bench.loop.advance(11s);
  CHECK(bench.is_all_sent());
  CHECK(server.requests().back()["path"] == "/ingest");

  server.become("status 308 Location:http://127.0.0.1:9/");
  bench.publish(1);
  CHECK(bench.is_faulted());
  CHECK_MESSAGE(has(bench.reason(), "http://127.0.0.1:9"), bench.reason());
}

TEST_CASE(
    "US-32 NFR-1 a name that does not resolve is told; names are looked up again, and no thread of libcurl does it") {
  NEEDS_PYTHON();
  HttpBench lost({.server = {.url = "http://no-such-host.invalid/x"}});
  lost.publish(1);
  CHECK(lost.is_faulted());
  CHECK_MESSAGE(has(lost.reason(), "check the host name"), lost.reason());
  CHECK(lost.sink.counts().queued == 1);

  HttpServer server;
  HttpBench bench({.server = {.url = "http://localhost:" + server.port() + "/x"}});
  bench.publish(5);
  check_all_once(bench, server);
  bench.loop.advance(2min);
  bench.publish(5);
  check_all_once(bench, server);
}

TEST_CASE("US-32 through a proxy, which alone looks up the name") {
  NEEDS_PYTHON();
  HttpServer proxy;
  HttpBench bench({.server = {.url = "http://no-such-host.invalid/x",
                              .proxy = "http://127.0.0.1:" + proxy.port(),
                              .proxy_user = "me",
                              .proxy_password = "pass"}});
  bench.publish(3);
  check_all_once(bench, proxy);
  CHECK(proxy.requests().at(0)["path"] == "http://no-such-host.invalid/x");
  CHECK(proxy.requests().at(0)["headers"]["Proxy-Authorization"] == "Basic bWU6cGFzcw==");
  proxy.kill();
  bench.publish(1);
  CHECK(bench.is_faulted());
  CHECK_MESSAGE(has(bench.reason(), "http://127.0.0.1:" + proxy.port()), bench.reason());
}

TEST_CASE("US-32 NFR-1 closing at a server that does not answer ends in time, and says what was not sent") {
  NEEDS_PYTHON();
  for (const char* mode : {"hang", "deaf"}) {
    HttpServer server;
    server.become(mode);
    HttpBench bench({.server = {.url = server.url()}, .sink = {.close_deadline = 2s}});
    bench.publish(42);
    bench.loop.advance(100ms);
    CHECK(bench.loop.close(2s) == 42);
    CHECK(bench.loop.now() - MonotonicTime{} < 10s);
  }
}

TEST_CASE("a sink of HTTP that is destroyed in the middle of everything leaves nothing behind") {
  NEEDS_PYTHON();
  for (const char* mode : {"ok", "hang", "status 500", "refuse 3"}) {
    HttpServer server;
    server.become(mode);
    for (int turns = 0; turns < 6; ++turns) {
      HttpBench bench({.server = {.url = server.url()},
                       .compression = turns % 2 == 0 ? HttpCompression::none : HttpCompression::gzip,
                       .sending = {.parcel_rows = 2},
                       .sink = {.close_deadline = 0ms}});
      bench.publish(20);
      for (int i = 0; i < turns; ++i) bench.loop.poll();
      bench.sink.close();
      bench.loop.poll();
    }
  }
}

TEST_CASE("a sink of HTTP that has nothing to do watches nothing, so that it keeps no loop") {
  NEEDS_PYTHON();
  HttpServer server;
  HttpBench bench({.server = {.url = server.url()}});
  const auto watches = [&] {
    int count = 0;
    uv_walk(
        bench.loop.uv(),
        [](uv_handle_t* handle, void* to) {
          if (handle->type == UV_POLL && uv_is_active(handle) != 0) ++*static_cast<int*>(to);
        },
        &count);
    return count;
  };
  const int before = watches();
  for (int i = 0; i < 2; ++i) {
    bench.publish(10);
    CHECK(bench.is_all_sent());
    CHECK(watches() == before);
  }
}

TEST_CASE("US-30 US-32 through a recording: what a run could not send, the next one sends, each event once") {
  NEEDS_PYTHON();
  HttpServer server;
  server.kill();
  const rtdata::test::Folder folder;
  const std::string path = folder.path() + "/run.db";
  std::set<std::string> keys;
  for (int run = 0; run < 3; ++run) {
    Loop loop{Loop::Manual{}};
    loop.on_error([](const ErrorReport&) {});
    SqliteSink recording(loop, {.path = path, .sink = {.name = "recording"}});
    if (run == 2) server.start();
    HttpSink sink(
        loop, {.server = {.url = server.url()},
               .sink = {.name = "collector", .close_deadline = 1s, .through = "recording", .from = From::beginning}});
    Feed<Number> feed(loop, {.name = "chamber", .topic = "test/number"});
    for (int i = 0; i < 150; ++i) {
      feed.publish(Number{i / 4.0});
      loop.advance(10ms);
    }
    if (run == 2)
      CHECK_MESSAGE(wait_for(loop,
                             [&] {
                               loop.advance(100ms);
                               return arrivals(server).size() == 450;
                             }),
                    sink.status().reason);
    (void)loop.close(2s);
  }
  const auto came = arrivals(server);
  CHECK(came.size() == 450);
  for (const auto& each : came) {
    const auto& key = each.first;
    const auto& count = each.second;
    CHECK_MESSAGE(count == 1, std::string(key));
    keys.insert(key.substr(0, 36));
  }
  CHECK(keys.size() == 3);  // runs
  CHECK(verify(Recording::open(path).or_throw()).or_throw().exit_code() == 0);
}

TEST_CASE("US-30 US-32 FW-1 the example's node sends to its collector what it recorded while that was away") {
  NEEDS_PYTHON();
  using rtdata::test::built;
  using rtdata::test::in_source;
  using rtdata::test::Process;
  HttpServer server;
  server.kill();
  ::setenv("COLLECTOR", server.url().c_str(), 1);
  const rtdata::test::Folder folder;
  const std::string node = in_source("examples/http_node.json");
  {
    Process alone(folder, built("rtdata"), {"run", node, "--for", "500ms"});
    CHECK_MESSAGE(alone.end() == 0, alone.err);
    CHECK_MESSAGE(has(alone.out + alone.err, "no program listens"), alone.err);
  }
  server.start();
  Process run(folder, built("rtdata"), {"run", node, "--for", "500ms"});
  CHECK_MESSAGE(run.end() == 0, run.err);
  const auto came = arrivals(server);
  CHECK(came.size() >= 12);  // of two runs, at 10 Hz and 1 Hz
  std::set<std::string> runs;
  for (const auto& each : came) {
    const auto& key = each.first;
    const auto& count = each.second;
    runs.insert(key.substr(0, 36));
    CHECK(count == 1);
  }
  CHECK(runs.size() == 2);
  Process verify(folder, built("rtdata"), {"verify", "node.db"});
  CHECK_MESSAGE(verify.end() == 0, verify.out);
}

TEST_SUITE_END();
#endif
