// The http sensor at a real server, tests/sinks/http_server.py: what it answers, what cannot be used, and its faults.
#ifdef RTDATA_WITH_HTTP
#include "rtdata/sensors/http.hpp"

#include <doctest/doctest.h>

#include <cstring>
#include <fstream>
#include <optional>

#include "has.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/gaps.hpp"
#include "rtdata/loop/timer.hpp"
#include "sanitized.hpp"
#include "sensors/fixture.hpp"
#include "sinks/certificates.hpp"
#include "sinks/http_bench.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace sinks;
using namespace std::chrono_literals;
using rtdata::test::has;
using Rows = std::vector<std::vector<double>>;

namespace {

/// A loop, what its sensors publish (all fields are double), and what they complain of.
struct Hearing {
  explicit Hearing(Loop& its_loop) : loop(its_loop) {
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error);
    });
    heard = loop.subscribe("#", [this](const EventView& event) {
      rows.emplace_back(event.payload().size() / sizeof(double));
      std::memcpy(rows.back().data(), event.payload().data(), event.payload().size());
    });
  }
  std::string last_error() const { return errors.empty() ? "" : errors.back().text(); }
  Loop& loop;
  std::vector<Error> errors;
  Rows rows;
  Subscription heard;
};

struct VirtualTime {
  Loop manual{Loop::Manual{}};
};

/// In virtual time, in which the server answers at once: a tick a second.
struct Bench : private VirtualTime, Hearing {
  explicit Bench(HttpSensorConfig config, SensorConfig settings = {}, std::vector<std::string> certificate = {})
      : Hearing(manual), server(std::move(certificate)) {
    if (config.server.url.empty()) config.server.url = server.url("/data");
    if (config.fields.empty()) config.fields = {{.name = "x"}};
    if (settings.name.empty()) settings.name = "s";
    settings.rate = 1_Hz;
    settings.start = false;
    sensor = HttpSensor(loop, settings, config);
  }
  /// The events of one tick with this answer.
  Rows rows_of(const std::string& content, const std::string& mode = "answer") {
    server.folder().write("answer", content);
    return rows_in(mode);
  }
  Rows rows_in(const std::string& mode) {
    server.become(mode);
    rows.clear();
    sensor.start();
    loop.advance(1ms);
    reason = sensor.status().reason;
    sensor.stop();
    CHECK(sensor.counts().balances());
    return rows;
  }
  /// Why one tick brought no event.
  std::string error_of(const std::string& content) {
    server.folder().write("answer", content);
    return error_in("answer");
  }
  std::string error_in(const std::string& mode) {
    CHECK(rows_in(mode).empty());
    CHECK(sensor.health() != Health::ok);
    return reason;
  }

  HttpServer server;
  HttpSensor sensor;
  std::string reason;  // of the last tick that was asked for
};

/// With real time; until it is so, for a minute at most.
template <class IsSo>
bool run_until(Loop& loop, const IsSo& is_so) {
  bool done = false;
  Ticker look(loop, 1ms, [&](const Tick& tick) {
    done = is_so();
    if (done || tick.index > 60000) loop.stop();
  });
  loop.run();
  return done;
}

std::vector<std::string> problems_of(const std::string& members) {
  std::vector<std::string> lines;
  const std::string sensor = R"({"name": "s", "type": "http", "rate": "1 Hz", )" + members + "}";
  for (const Problem& problem :
       plan_system(standard_registry(), parse_config(R"({"sensors": [)" + sensor + "]}", "f.json")).problems)
    lines.push_back(problem.text());
  return lines;
}

}  // namespace

TEST_SUITE_BEGIN("sensors");
#ifdef RTDATA_WITH_PATTERN

TEST_CASE("US-17 a pattern takes bytes of an answer, which comes whole and needs no frame") {
  CHECK(problems_of(R"x("url": "http://h/", "format": "pattern", "pattern": "^\\x07(?<v>..)",
                        "fields": [{"name": "v", "wire": "uint16"}])x")
            .empty());
}
#endif

TEST_CASE("US-17 what a URL answers are events: JSON by its keys, CSV after its heading, rows of labels") {
  NEEDS_PROGRAM(python);
  {
    Bench json({.fields = {{.name = "power", .key = "meters.1.power"},
                           {.name = "rain", .key = "rain.rate", .suffix = " mm/Hr"},
                           {.name = "on", .words = {{"ON", 1}, {"OFF", 0}}}}});
    CHECK(json.rows_of(R"({"meters": [{"power": 1}, {"power": 21.5}], "rain": {"rate": "0.3 mm/Hr"}, "on": "ON"})") ==
          Rows{{21.5, 0.3, 1}});
    CHECK(json.rows_of(R"({"on": "OFF", "rain": {"rate": "1 mm/Hr"}, "meters": [0, {"power": -2e1, "x": null}]})",
                       "chunked") == Rows{{-20, 1, 0}});
    const auto request = json.server.requests().front();
    CHECK(request["method"] == "GET");
    CHECK(request["path"] == "/data");
    CHECK(json.sensor.counts().published == 2);
    CHECK(json.sensor.counts().taken == 2);
    CHECK(json.sensor.health() == Health::ok);
  }
  {
    Bench list({.fields = {{.name = "x", .key = "1.t"}}});
    CHECK(list.rows_of(R"([{"t": 1}, {"t": 2}])") == Rows{{2}});
  }
  {
    Bench csv({.format = LineFormat::csv,
               .fields = {{.name = "a"}, {}, {.name = "b"}},
               .separator = ';',
               .skip_lines = 2,
               .only = LineMatch{.column = 2, .is = {"north", "south"}}});
    CHECK(csv.rows_of("station\r\na;where;b\r\n\r\n1;west;2\r\n3;south;4.5\r\n5;north;6\r\n") == Rows{{3, 4.5}});
    CHECK(csv.rows_of("station\na;where;b\n1;west;2\n").empty());
    CHECK(csv.sensor.counts().filtered == 1);
    CHECK(csv.errors.empty());
    CHECK(has(csv.error_of("station\na;where;b\n"), "there is no line after `skip_lines`"));
  }
  Bench labels({.format = LineFormat::labels,
                .fields = {{.name = "load", .key = "node_load1"}, {.name = "t", .key = "temp{chip=\"cpu\"}"}},
                .separator = ' '});
  CHECK(labels.rows_of("# HELP node_load1 1m load average.\n# TYPE node_load1 gauge\nnode_load1 0.21\n"
                       "temp{chip=\"disk\"} 30\ntemp{chip=\"cpu\"} 4.15e+01\n") == Rows{{0.21, 41.5}});
  CHECK(has(labels.error_of("node_load1 0.21\n"), "the answer has no \"temp{chip=\"cpu\"}\""));
#ifdef RTDATA_WITH_PATTERN
  Bench page({.format = LineFormat::pattern,
              .fields = {{.name = "t"}, {.name = "h"}},
              .pattern = R"((?s)Temp</td><td>(?<t>[-0-9.]+).*Hum</td><td>(?<h>[0-9]+))"});
  CHECK(page.rows_of("<html>\n<td>Temp</td><td>-2.5 C</td>\n<td>Hum</td><td>81 %</td></html>") == Rows{{-2.5, 81}});
  CHECK(has(page.error_of("<html>busy</html>"), "`pattern` does not match"));
#endif
}

TEST_CASE("US-7 an answer whose value was not published is asked for again in full") {
  NEEDS_PROGRAM(python);
  Bench bench({}, {.name = "s", .process = {{"x", {.calibration = Calibration{.most = 5}}}}});
  bench.server.become("answer ETag:\"one\"");
  bench.server.folder().write("answer", R"({"x": 9})");
  bench.sensor.start();
  bench.loop.advance(3500ms);
  CHECK(bench.rows.empty());
  CHECK(bench.sensor.counts().repeated == 0);
  CHECK(bench.sensor.counts().unreadable == 4);
  CHECK(bench.sensor.health() != Health::ok);
  CHECK(bench.server.requests().back()["if-none-match"].is_null());
}

TEST_CASE("US-17 a URL may be asked by a request with a text, and with the right to read it") {
  NEEDS_PROGRAM(python);
  Bench post({.server = {.url = {}, .headers = {{"X-Site", "roof"}}, .bearer = "token of mine"},
              .method = HttpMethod::post,
              .text = R"({"id":1,"method":"Switch.GetStatus"})",
              .fields = {{.name = "w", .key = "result.apower"}}});
  CHECK(post.rows_of(R"({"id": 1, "result": {"apower": 8.9}})") == Rows{{8.9}});
  const auto request = post.server.requests().front();
  CHECK(request["method"] == "POST");
  CHECK(request["body"] == R"({"id":1,"method":"Switch.GetStatus"})");
  CHECK(request["headers"]["Content-Type"] == "application/json");
  CHECK(request["headers"]["Authorization"] == "Bearer token of mine");
  CHECK(request["headers"]["X-Site"] == "roof");

  Bench basic({.server = {.url = {}, .user = "me", .password = "open"}});
  CHECK(basic.rows_of(R"({"x": 1})") == Rows{{1}});
  CHECK(basic.server.requests().front()["headers"]["Authorization"] == "Basic bWU6b3Blbg==");

  Bench digest({.server = {.url = {}, .user = "admin", .password = "s3cret"}, .digest = true});
  CHECK(digest.rows_of(R"({"x": 2})", "digest") == Rows{{2}});
  Bench wrong({.server = {.url = {}, .user = "admin", .password = "other-s3cret"}, .digest = true});
  const std::string error = wrong.error_in("digest");
  CHECK_MESSAGE(has(error, "the server answers 401 Unauthorized"), error);
  CHECK(has(error, "set the right `user` and `password`"));
}

TEST_CASE("US-17 what the server has marked as unchanged is no event, and counts as repeated") {
  NEEDS_PROGRAM(python);
  Bench bench({});
  bench.server.folder().write("answer", R"({"x": 1})");
  bench.server.become("answer ETag:\"one\"");
  bench.sensor.start();
  bench.loop.advance(2500ms);
  CHECK(bench.rows == Rows{{1}});
  CHECK(bench.sensor.counts().repeated == 2);
  bench.server.folder().write("answer", R"({"x": 2})");
  bench.server.become("answer ETag:\"two\"");
  bench.loop.advance(2s);
  CHECK(bench.rows == Rows{{1}, {2}});
  CHECK(bench.sensor.counts().repeated == 3);
  bench.server.folder().write("answer", "{");  // it cannot be read, and is not what is asked about from now on
  bench.server.become("answer ETag:\"three\"");
  bench.loop.advance(2s);
  CHECK(bench.sensor.counts().unreadable == 2);
  CHECK(bench.sensor.counts().taken == 5);
  CHECK(bench.sensor.counts().balances());
  CHECK(bench.server.requests().back()["headers"]["If-None-Match"] == "\"two\"");
  // That nothing is new is no answer to who did not ask whether it is.
  bench.sensor.stop();
  CHECK(has(bench.error_in("status 304"), "the server answers 304"));
}

TEST_CASE("US-7 what a server says instead of data is a failure with its reason, and no secret is shown") {
  NEEDS_PROGRAM(python);
  Bench bench({.server = {.url = {}, .bearer = "secret-token"}, .timeout = 300ms});
  std::string error = bench.error_in("status 503 -- restarting, secret-token");
  CHECK_MESSAGE(has(error, "the server answers 503 Service Unavailable: restarting, (secret)"), error);
  CHECK(bench.errors.back().code == Errc::busy);
  CHECK(has(bench.error_in("status 404"), "correct `url`: the server has nothing there"));
  CHECK(has(bench.error_in("status 429"), "set a smaller `rate`"));
  CHECK(has(bench.error_in("status 204"), "an answer with data must have status 200"));
  error = bench.error_in("status 302 Location:http://other.example/secret-path");
  CHECK_MESSAGE(
      has(error, "the server answers 302 Found: the server redirects to http://other.example: if that is right"),
      error);
  CHECK(!has(error, "secret-path"));
  CHECK(has(bench.error_in("status 301 Location:/index.json"), "correct `url`: the server redirects to another path"));
  CHECK(bench.server.request_count() == 6);  // no redirection was followed
  error = bench.error_in("hang");
  CHECK_MESSAGE(has(error, "it did not answer within 300 ms"), error);
  CHECK(bench.errors.back().code == Errc::timed_out);
  CHECK(has(bench.error_in("drip"), "it did not answer within 300 ms"));
  CHECK(has(bench.error_in("trickle"), "its answer was not complete within 300 ms"));
  CHECK(has(bench.error_in("half"), "the connection was closed before the answer"));
  CHECK(has(bench.error_in("lost"), "the connection was closed before the answer"));
  bench.error_in("garbage");
  CHECK(bench.sensor.counts().failed == 12);
  CHECK(bench.sensor.counts().unreadable == 0);
  CHECK(bench.rows_of(R"({"x": 1})") == Rows{{1}});
  CHECK(bench.sensor.health() == Health::ok);
}

TEST_CASE("US-7 an answer that cannot be decoded is unreadable, and it is said what it is") {
  NEEDS_PROGRAM(python);
  Bench bench({.server = {.url = {}, .bearer = "secret-token"},
               .unreadable_if = LineMatch{.key = "state", .is = {"starting"}},
               .max_answer = 1000});
  const auto is_told = [&](const std::string& content, const std::string& why) {
    const std::string error = bench.error_of(content);
    CHECK_MESSAGE(has(error, why), error);
  };
  is_told("<!DOCTYPE html><title>Log in</title>", "the answer is HTML, not JSON: check that `url` leads to the data");
  is_told("\n <html>", "the answer is HTML, not JSON");
  is_told("<?xml version=\"1.0\"?><x>1</x>", "the answer is XML, not JSON");
  is_told("", "it is empty");
  is_told(R"({"y": 1})", "the answer has no \"x\"");
  is_told(R"({"x": "secret-token"})", "\"(secret)\" is not a number");
  is_told(R"({"x": 1)", "it is not JSON");
  is_told(R"({"state": "starting", "x": 0})", "the device says that it has no value");
  is_told("{\"x\": 1" + std::string(1000, ' ') + "}", "it is longer than 1000 bytes: set a larger `max_answer`");
  CHECK(has(bench.error_in("endless"), "it is longer than 1000 bytes"));
  CHECK(bench.sensor.counts().unreadable == 10);
  CHECK(bench.sensor.counts().failed == 10);  // as ticks
  CHECK(bench.rows_of("{\"x\": 1" + std::string(992, ' ') + "}") == Rows{{1}});
}

TEST_CASE("NFR-1 an answer of 1 GB costs no more memory than the longest that is taken") {
  NEEDS_PROGRAM(python);
  Bench bench({.max_answer = 1048576});
  CHECK(bench.rows_of(R"({"x": 1})") == Rows{{1}});
  std::ofstream("/proc/self/clear_refs") << "5";  // from now on the peak is that of this test
  const auto peak_kib = [] {
    std::ifstream status("/proc/self/status");
    std::string word;
    while (status >> word && word != "VmHWM:") {
    }
    long kib = 0;
    status >> kib;
    return kib;
  };
  const long before = peak_kib();
  REQUIRE(before > 0);
  for (int i = 0; i < 5; ++i) CHECK(has(bench.error_in("gigabyte"), "it is longer than 1048576 bytes"));
  if (!rtdata::test::sanitized) CHECK(peak_kib() - before < 16384);
  CHECK(bench.rows_of(R"({"x": 2})") == Rows{{2}});
}

TEST_CASE("US-7 a server that is away is a fault and a gap, and good again when it is back") {
  NEEDS_PROGRAM(python);
  Bench bench({}, {.name = "s", .retry_first = 100ms, .retry_longest = 2s});
  std::string gaps;
  const auto told = bench.loop.subscribe<GapEvent>(
      gap_topic, [&](const Event<GapEvent>& gap) { gaps += std::string(gap->reason.view()) + " "; });
  bench.server.folder().write("answer", R"({"x": 1})");
  bench.server.become("answer");
  bench.server.kill();
  bench.sensor.start();
  bench.loop.advance(10s);
  CHECK(bench.sensor.health() == Health::faulted);
  CHECK(has(bench.last_error(), "Connection refused: check that the server runs"));
  CHECK(bench.rows.empty());
  const auto away = bench.sensor.counts();
  CHECK(away.failed == 11);
  bench.server.start();
  bench.loop.advance(5s);
  CHECK(bench.sensor.health() == Health::ok);
  CHECK(bench.rows.size() >= 3);
  CHECK_MESSAGE(has(gaps, "disconnected"), gaps);
  // On the connection that is kept, until the server closes it.
  const auto requests = bench.server.requests();
  CHECK(requests.back()["port"] == requests.front()["port"]);
  bench.server.kill();
  bench.server.start();
  const std::size_t before = bench.rows.size();
  bench.loop.advance(2s);
  CHECK(bench.rows.size() == before + 2);
  CHECK(bench.sensor.counts().balances());
}

TEST_CASE("US-7 with required, a server that is away or answers no data is refused at the start") {
  NEEDS_PROGRAM(python);
  Bench bench({}, {.name = "s", .required = true});
  bench.server.become("status 401");
  CHECK_THROWS_WITH_AS(bench.sensor.start(), doctest::Contains("401 Unauthorized"), SetupError);
  bench.server.folder().write("answer", "<html>");
  bench.server.become("answer");
  CHECK_THROWS_WITH_AS(bench.sensor.start(), doctest::Contains("the answer is HTML"), SetupError);
  CHECK(bench.rows_of(R"({"x": 1})") == Rows{{1}});
}

TEST_CASE("US-6 while a server hangs, nobody else waits; stopping and closing do not wait for it") {
  NEEDS_PROGRAM(python);
  HttpServer server, other_server;
  server.become("hang");
  other_server.folder().write("answer", R"({"x": 1})");
  other_server.become("answer");
  std::optional<Loop> owned(std::in_place);
  Loop& loop = *owned;
  Hearing hearing(loop);
  const auto config = [](const HttpServer& at, Duration timeout) {
    return HttpSensorConfig{.server = {.url = at.url()}, .fields = {{.name = "x"}}, .timeout = timeout};
  };
  HttpSensor hung(loop, {.name = "hung", .rate = 10_Hz}, config(server, 500ms));
  HttpSensor other(loop, {.name = "other", .rate = 20_Hz}, config(other_server, 5s));
  Sensor<sinks::Number> local(loop, {.name = "local", .rate = 100_Hz}, [] { return sinks::Number{1}; });
  REQUIRE(run_until(loop, [&] { return server.request_count() == 1; }));
  const std::uint64_t local_before = local.counts().taken, other_before = other.counts().taken;
  CHECK(run_until(loop, [&] { return hung.counts().failed > 0; }));
  CHECK(local.counts().taken > local_before);
  CHECK(other.counts().taken > other_before);
  CHECK(hung.counts().missed > 0);  // ticks while it was asked
  CHECK(has(hearing.last_error(), "it did not answer within 500 ms"));
  CHECK(other.counts().failed == 0);

  hung.close();
  hung = HttpSensor(loop, {.name = "hung", .rate = 10_Hz}, config(server, 3min));
  const std::size_t requests = server.request_count();
  REQUIRE(run_until(loop, [&] { return server.request_count() > requests; }));
  hung.stop();
  CHECK(hung.counts().balances());
  CHECK(hung.counts().published == 0);
  server.folder().write("answer", R"({"x": 2})");
  server.become("answer");
  hung.start();  // the lane is free as soon as the transfer has seen that nobody wants it any more
  CHECK(run_until(loop, [&] { return hung.counts().published > 1; }));
  server.become("hang");
  const std::size_t more = server.request_count();
  REQUIRE(run_until(loop, [&] { return server.request_count() > more && hung.counts().in_flight > 0; }));
  hung.close();
  other.close();
  local.close();
  hearing.heard.close();
  const auto begin = std::chrono::steady_clock::now();
  owned.reset();
  CHECK(std::chrono::steady_clock::now() - begin < 1min);  // the request had three minutes to go
}

TEST_CASE("US-17 HTTPS: an answer comes only from a server whose certificate is right") {
  NEEDS_PROGRAM(python);
  NEEDS_PROGRAM(openssl);
  const Certificates& certificates = Certificates::all();
  for (const std::string name : {"right", "self", "expired", "other"}) {
    CAPTURE(name);
    HttpServer server(certificates.of(name));
    server.folder().write("answer", R"({"x": 1})");
    server.become("answer");
    Loop loop{Loop::Manual{}};
    Hearing hearing(loop);
    HttpSensor sensor(
        loop, {.name = "s", .rate = 1_Hz},
        {.server = {.url = "https://127.0.0.1:" + server.port() + "/", .tls = {.ca_file = certificates / "ca.pem"}},
         .fields = {{.name = "x"}}});
    loop.advance(1ms);
    CHECK(hearing.rows == (name == "right" ? Rows{{1}} : Rows{}));
    CHECK(server.request_count() == (name == "right" ? 1 : 0));
    if (name == "right") continue;
    REQUIRE(hearing.errors.size() == 1);
    CHECK(hearing.errors[0].code == Errc::not_permitted);
    const std::string advice = name == "self"      ? "tls.ca_file"
                               : name == "expired" ? "renew the server's certificate"
                                                   : "the name of the server's certificate";
    CHECK_MESSAGE(has(hearing.last_error(), advice), hearing.last_error());
  }
}

TEST_CASE("US-17 check finds the mistakes of http sensors, and a program cannot make them") {
  const auto is_refused = [](const std::string& members, const std::string& why) {
    const auto problems = problems_of(members);
    const bool is_so = problems.size() == 1 && has(problems[0], why);
    for (const std::string& problem : problems)
      if (!is_so) MESSAGE(problem);
    CHECK_MESSAGE(is_so, members);
  };
  const std::string url = R"("url": "http://x/", )", fields = R"("fields": [{"name": "x"}])";
  CHECK(problems_of(url + fields).empty());
  is_refused(fields, "url");
  is_refused(url + R"("format": "json")", "fields");
  is_refused(R"("url": "ftp://x/", )" + fields, "the scheme is ftp");
  is_refused(R"("url": "x/", )" + fields, "it has no scheme");
  is_refused(R"("url": "http://a:b@x/", )" + fields, "with user and password in it");
  is_refused(url + R"("digest": true, )" + fields, "it needs `user` and `password`");
  is_refused(url + R"("headers": {"If-None-Match": "x"}, )" + fields, "it is set already");
  is_refused(url + R"("method": "post", "content_type": "a\nb", )" + fields, "it has a line break");
  is_refused(url + R"("format": "binary", )" + fields, "binary");
  is_refused(url + R"("only": {"column": 1, "is": ["a"]}, )" + fields, "only CSV has columns");
  is_refused(url + R"("format": "csv", "separator": "e", )" + fields, "numbers may contain this character");
  is_refused(url + R"("max_answer": 1048577, )" + fields, "max_answer");
  is_refused(url + R"("fields": [{"name": "x"}, {"name": "x"}])", "x");

  Loop loop{Loop::Manual{}};
  const auto make = [&](const HttpSensorConfig& config) { HttpSensor(loop, {.name = "s", .rate = 1_Hz}, config); };
  CHECK_THROWS_AS(make({.server = {.url = "ftp://x/"}, .fields = {{.name = "x"}}}), SetupError);
  CHECK_THROWS_AS(make({.server = {.url = "http://x/"}}), SetupError);
  CHECK_THROWS_AS(make({.server = {.url = "http://x/"}, .format = LineFormat::binary, .fields = {{.name = "x"}}}),
                  SetupError);
  CHECK_THROWS_AS(make({.server = {.url = "http://x/"}, .fields = {{.name = "x"}}, .timeout = 0s}), SetupError);
  CHECK_THROWS_AS(make({.server = {.url = "http://x/"}, .digest = true, .fields = {{.name = "x"}}}), SetupError);
}

TEST_SUITE_END();
#endif
