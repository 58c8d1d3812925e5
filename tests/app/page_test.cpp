// The live page: real programs, asked through real sockets.
#include <arpa/inet.h>
#include <doctest/doctest.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>

#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "app/page/page_history.hpp"
#include "app/runtime_folder.hpp"
#include "has.hpp"
#include "listening.hpp"
#include "paths.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "rtdata/sensors/feed.hpp"

using namespace rtdata;
using rtdata::test::Folder;
using rtdata::test::has;
using rtdata::test::Process;
using rtdata::test::RuntimeFolder;
using namespace std::chrono_literals;
using nlohmann::json;

namespace {

const std::string program = rtdata::test::built("rtdata_test_program");
const std::string token = "a-token-for-tests-0123456789";

std::string rig(std::uint16_t port, const std::string& more = "") {
  return R"({"name": "rig", "notes": "<script>alert(1)</script>",
    "page": {"listen": "127.0.0.1:)" +
         std::to_string(port) + R"(", "token": ")" + token + "\"" + more + R"(},
    "sensors": [ {"name": "a", "type": "tallied", "rate": "200 Hz", "topic": "count/a"},
                 {"name": "b", "type": "tallied", "rate": "20 Hz", "topic": "count/b"} ],
    "sinks": [ {"type": "sqlite", "name": "rec", "path": "rig.db"} ]})";
}

/// A port that is free now.
std::uint16_t free_port() {
  const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  ::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address);
  ::getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size);
  ::close(fd);
  return ntohs(address.sin_port);
}

/// One connection of a browser, or of somebody worse.
class Connection {
 public:
  explicit Connection(std::uint16_t port) : fd_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port = htons(port);
    const timeval limit{30, 0};
    ::setsockopt(fd_, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
    ::setsockopt(fd_, SOL_SOCKET, SO_SNDTIMEO, &limit, sizeof limit);
    is_open_ = ::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  }
  Connection(Connection&& other) noexcept : fd_(std::exchange(other.fd_, -1)), is_open_(other.is_open_) {}
  Connection& operator=(Connection&&) = delete;
  ~Connection() {
    if (fd_ >= 0) ::close(fd_);
  }
  bool is_open() const { return is_open_; }
  bool send(const std::string& text) {
    std::size_t sent = 0;
    while (sent < text.size()) {
      const ssize_t size = ::send(fd_, text.data() + sent, text.size() - sent, MSG_NOSIGNAL);
      if (size <= 0) return false;
      sent += static_cast<std::size_t>(size);
    }
    return true;
  }
  /// More of what comes; empty: it was closed, or nothing came for half a minute.
  std::string receive() {
    char buffer[8192];
    const ssize_t size = ::recv(fd_, buffer, sizeof buffer, 0);
    return size > 0 ? std::string(buffer, static_cast<std::size_t>(size)) : std::string();
  }
  std::string receive_all() {
    std::string all;
    for (std::string more = receive(); !more.empty(); more = receive()) all += more;
    return all;
  }

 private:
  int fd_;
  bool is_open_;
};

std::string request(std::uint16_t port, const std::string& method, const std::string& url, const std::string& headers,
                    const std::string& body = "") {
  return method + " " + url + " HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port) + "\r\n" + headers +
         (body.empty() ? "" : "Content-Length: " + std::to_string(body.size()) + "\r\n") + "Connection: close\r\n\r\n" +
         body;
}
const std::string allowed = "Authorization: Bearer " + token + "\r\n";

struct Answer {
  int status = 0;  // 0: none
  std::string headers, body;
  json parsed() const { return json::parse(body, nullptr, false); }
};
Answer answer_to(std::uint16_t port, const std::string& text) {
  Connection connection(port);
  if (!connection.is_open() || !connection.send(text)) return {};
  const std::string all = connection.receive_all();
  const std::size_t end = all.find("\r\n\r\n");
  if (end == std::string::npos) return {};
  return {std::atoi(all.substr(9, 3).c_str()), all.substr(0, end), all.substr(end + 4)};
}
Answer get(std::uint16_t port, const std::string& url, const std::string& headers = allowed) {
  return answer_to(port, request(port, "GET", url, headers));
}
Answer post(std::uint16_t port, const json& command, const std::string& headers = allowed) {
  return answer_to(port,
                   request(port, "POST", "/command", headers + "Content-Type: application/json\r\n", command.dump()));
}

/// The stream of a page: its lines, out of the chunks that HTTP makes of it.
class Events {
 public:
  explicit Events(std::uint16_t port, const std::string& after = "") : connection_(port) {
    connection_.send("GET /events" + (after.empty() ? "" : "?after=" + after) +
                     " HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port) + "\r\n" + allowed + "\r\n");
  }
  std::optional<json> next() {
    for (;;) {
      const std::size_t end = lines_.find('\n');
      if (end != std::string::npos) {
        const std::string line = lines_.substr(0, end);
        lines_.erase(0, end + 1);
        if (line.empty()) continue;
        json parsed = json::parse(line, nullptr, false);
        CHECK_FALSE(parsed.is_discarded());
        return parsed;
      }
      const std::string more = connection_.receive();
      if (more.empty()) return std::nullopt;
      raw_ += more;
      take_chunks();
    }
  }
  json next(const std::string& key) {
    for (;;) {
      auto line = next();
      REQUIRE(line);
      if (line->contains(key)) return *line;
    }
  }
  /// The next step of the sensor.
  json next_step(const std::string& origin) {
    for (;;) {
      json line = next("until");
      if (line["origin"] == origin) return line;
    }
  }

 private:
  void take_chunks() {
    if (!has_headers_) {
      const std::size_t end = raw_.find("\r\n\r\n");
      if (end == std::string::npos) return;
      CHECK(raw_.starts_with("HTTP/1.1 200"));
      raw_.erase(0, end + 4);
      has_headers_ = true;
    }
    for (;;) {
      const std::size_t end = raw_.find("\r\n");
      if (end == std::string::npos) return;
      const std::size_t size = std::stoul(raw_.substr(0, end), nullptr, 16);
      if (raw_.size() < end + 2 + size + 2) return;
      lines_ += raw_.substr(end + 2, size);
      raw_.erase(0, end + 2 + size + 2);
      if (size == 0) return;
    }
  }
  Connection connection_;
  std::string raw_, lines_;
  bool has_headers_ = false;
};

struct MaybeOnPage {
  std::optional<double> value;
  RTDATA_FIELDS(MaybeOnPage, (value, "V"))
};

bool has_page() {
  static const bool is_in = [] {
    const Folder folder;
    Process version(folder, program, {"--version"});
    version.end();
    return !has(version.out, "page: left out");
  }();
  if (!is_in) MESSAGE("skipped: this program was built without libmicrohttpd or dygraphs");
  return is_in;
}

void end_well(Process& run, const Folder& folder) {
  run.signal(SIGTERM);
  CHECK(run.end() == 0);
  const VerifyReport report = verify(Recording::open(folder.path() + "/rig.db").or_throw()).or_throw();
  CHECK(report.verdict() == Verdict::balanced);
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("BY-1 a page is served with the token alone, under its own name, and says nothing to other pages") {
    if (!has_page()) return;
    const RuntimeFolder runtime;
    const Folder folder;
    const std::uint16_t port = free_port();
    folder.write("rig.json", rig(port));
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    CHECK(has(run.err, "page: http://127.0.0.1:" + std::to_string(port) + "/#token=" + token));

    for (const std::string url : {"/", "/page.js", "/stream.js", "/charts.js", "/page.css", "/dygraph.js"}) {
      const Answer file = get(port, url, "");
      CHECK(file.status == 200);
      CHECK(file.body.size() > 100);
      CHECK(has(file.headers, "Content-Security-Policy: default-src 'self'"));
      CHECK(has(file.headers, "X-Content-Type-Options: nosniff"));
    }
    CHECK_FALSE(has(get(port, "/", "").body, "http://"));  // nothing from another host
    for (const std::string wrong : {"", "Authorization: Bearer a-token\r\n", "Authorization: Basic x\r\n"})
      for (const std::string url : {"/status", "/events", "/history?q=1"}) CHECK(get(port, url, wrong).status == 401);
    CHECK(get(port, "/status?token=" + token, "").status == 401);  // never in a query
    CHECK(get(port, "/other").status == 404);
    CHECK(answer_to(port, request(port, "POST", "/status", allowed, "{}")).status == 405);
    const auto with_host = [&](const std::string& host) {
      return answer_to(port, "GET /status HTTP/1.1\r\nHost: " + host + "\r\n" + allowed + "Connection: close\r\n\r\n")
          .status;
    };
    CHECK(with_host("localhost:" + std::to_string(port)) == 200);
    CHECK(with_host("bad.example:" + std::to_string(port)) == 421);
    CHECK(get(port, "/status", allowed + "Origin: http://bad.example\r\n").status == 403);
    const std::string own = "Origin: http://127.0.0.1:" + std::to_string(port) + "\r\n";
    const Answer status = get(port, "/status", allowed + own);
    CHECK(status.status == 200);
    CHECK(status.parsed()["instance"]["name"] == "rig");
    CHECK(status.parsed()["sensors"].size() == 2);

    // The address with the token is kept for this user alone, and goes with the program.
    std::string kept;
    for (const auto& entry : std::filesystem::directory_iterator(runtime.path()))
      if (entry.path().extension() == ".page") kept = entry.path();
    struct stat found {};
    REQUIRE(::stat(kept.c_str(), &found) == 0);
    CHECK((found.st_mode & 0777) == 0600);
    end_well(run, folder);
    CHECK(::stat(kept.c_str(), &found) != 0);
    CHECK_FALSE(has(folder.read("rig.log"), token));
  }

#ifdef RTDATA_WITH_PAGE
  TEST_CASE("BY-1 the history of a page is refused, in words, beyond what it can count") {
    const Folder folder;
    const std::string file = folder.path() + "/huge.db";
    {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = file});
      Feed<MaybeOnPage> feed(loop, {.name = "a", .topic = "a"});
      for (int i = 0; i < 70; ++i) {
        feed.publish({.value = i % 2 == 0 ? 1.6e308 : -1.6e308});
        loop.advance(100ms);
      }
      loop.close();
    }
    const double started = static_cast<double>(
                               to_nanoseconds(Recording::open(file).or_throw().runs().or_throw()[0].started)) /
                           1e6;
    const auto ask = [&](double from, double until, double step) {
      const json question{{"topics", {{"a", {"value"}}}}, {"from", from}, {"until", until}, {"step", step}};
      return json::parse(rtdata::app::page_history({{"rec", file}}, 1, question.dump()));
    };
    const auto why = [&](double from, double until, double step) {
      return ask(from, until, step).value("error", std::string("not refused"));
    };
    CHECK(has(why(9.2e12, 9.3e12, 1e9), "\"from\" 9200000000000.0 is out of range"));
    CHECK(has(why(0, 1e300, 1e9), "\"until\" 1e+300 is out of range"));
    CHECK(has(why(0, 1e6, 1e12), "\"step\" 1000000000000.0 is out of range"));
    CHECK(has(why(0, 1e6, 0), "\"step\" 0.0 is out of range"));
    CHECK(has(why(0, 1e6, -5), "is out of range"));
    CHECK(has(why(-9.1e12, 9.1e12, 1e11), "more than 100 years"));
    CHECK(has(why(1e6, 1e6, 1000), "\"until\" is not after \"from\""));
    CHECK(has(why(0, 1e9, 1), "more than 4000 steps"));
    const std::vector<rtdata::app::PageRecording> recording{{"rec", file}};
    const auto raw = [&](const std::string& text) { return rtdata::app::page_history(recording, 1, text); };
    CHECK(has(raw("5"), "no object of"));
    CHECK(has(raw(R"({"topics":{"a":[]},"from":0,"until":"x","step":5})"), "no number of ms"));
    CHECK(has(raw(R"({"topics":{"a":[5]},"from":0,"until":9,"step":5})"), "its topics are not as"));
    // Whatever is allowed is answered.
    for (const double step : {1.0, 1000.0, 60e3, 1e9, 1e11})
      for (const double from : {-9.1e12, -1e12, -1.0, 0.0, started - 1, 9.1e12 - step}) {
        const json answer = ask(from, std::min(from + step, 9.1e12), step);
        CAPTURE(step);
        CAPTURE(from);
        CHECK_FALSE(answer.contains("error"));
      }
    // The mean of numbers whose sum is none.
    const json answer = ask(started - 60e3, started + 60e3, 60e3);
    REQUIRE_MESSAGE(answer["series"].size() == 1, answer.dump());
    for (const json& mean : answer["series"][0]["mean"]) CHECK(std::abs(mean.get<double>()) < 2e307);
  }

  TEST_CASE("BY-1 the history of a page breaks a curve where a value is absent") {
    const Folder folder;
    const std::string file = folder.path() + "/maybe.db";
    {
      Loop loop{Loop::Manual{}};
      const SqliteSink sink(loop, {.path = file});
      Feed<MaybeOnPage> feed(loop, {.name = "a", .topic = "a"});
      for (int i = 0; i < 90; ++i) {
        feed.publish({.value = i / 30 == 1 ? std::nullopt : std::optional<double>(i)});
        loop.advance(100ms);
      }
      loop.close();
    }
    const auto started = to_nanoseconds(Recording::open(file).or_throw().runs().or_throw()[0].started) / 1'000'000;
    const json question{
        {"topics", {{"a", json::array()}}}, {"from", started}, {"until", started + 60'000}, {"step", 1000}};
    const json answer = json::parse(rtdata::app::page_history({{"rec", file}}, 1, question.dump()));
    REQUIRE_MESSAGE(answer.contains("series"), answer.dump());
    REQUIRE(answer["series"].size() == 1);
    std::string kinds;  // of values, and of steps without one
    for (const json& mean : answer["series"][0]["mean"])
      if (const char kind = mean.is_null() ? '-' : 'v'; kinds.empty() || kinds.back() != kind) kinds += kind;
    CHECK(kinds == "v-v");
  }
#endif

  TEST_CASE("BY-1 the stream of a page has values, status and history, and goes on where it was after a break") {
    if (!has_page()) return;
    const RuntimeFolder runtime;
    const Folder folder;
    const std::uint16_t port = free_port();
    folder.write("rig.json", rig(port));
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    std::string id;
    std::uint64_t last = 0;
    {
      Events events(port);
      const json page = events.next("page");
      CHECK(page["page"]["goes_on"] == false);
      CHECK(page["page"]["commands"].empty());
      CHECK(events.next("about")["about"]["notes"] == "<script>alert(1)</script>");
      CHECK(events.next("status")["status"]["instance"]["name"] == "rig");
      CHECK(events.next("machine")["machine"]["disks"][0]["sink"] == "rec");
      for (int i = 0; i < 4; ++i) {
        const json step = events.next_step("a");
        if (last != 0) CHECK(step["sequence"][0] == last + 1);
        last = step["sequence"][1];
      }
      while (id.empty()) {  // on a slow machine further steps come before it
        const auto line = events.next();
        REQUIRE(line);
        if (line->contains("until") && (*line)["origin"] == "a") last = (*line)["sequence"][1];
        if (line->contains("id")) id = (*line)["id"];
      }
    }
    Events events(port, id);
    CHECK(events.next("page")["page"]["goes_on"] == true);
    const json step = events.next_step("a");
    CHECK(step["sequence"][0] == last + 1);
    last = step["sequence"][1];
    CHECK(Events(port, "0-7").next("page")["page"]["goes_on"] == false);

    const double until = step["until"].get<double>() / 1e6;
    const auto history = [&](const json& question) {
      return get(
                 port, "/history?q=" +
                           [&] {
                             std::string text;
                             for (const char c : question.dump()) {
                               char code[4];
                               std::snprintf(code, sizeof code, "%%%02x", static_cast<unsigned char>(c));
                               text += code;
                             }
                             return text;
                           }())
          .parsed();
    };
    // What the page has shown is in the recording a little later.
    json known;
    double events_known = 0;
    for (int i = 0; i < 300 && events_known < 4; ++i) {
      known = history(
          {{"topics", {{"count/b", json::array()}}}, {"from", until - 60e3}, {"until", until}, {"step", 100}});
      events_known = known["series"].empty() ? 0 : static_cast<double>(known["series"][0]["time"].size());
    }
    REQUIRE(events_known >= 4);
    CHECK(known["run"]["number"] == 1);
    CHECK(known["series"][0]["path"] == "number");
    CHECK(known["series"][0]["least"].size() == known["series"][0]["most"].size());
    CHECK(known["reached"] <= until - 59e3);
    CHECK(history({{"topics", json::object()}, {"from", 1}}).contains("error"));
    CHECK(
        history({{"topics", {{"a'; DROP", json::array()}}}, {"from", 0}, {"until", 1}, {"step", 1}}).contains("error"));
    end_well(run, folder);
    CHECK(events.next("ended")["ended"] == "the run has ended");
  }

  TEST_CASE("BY-1 a page gives the commands that the configuration lists, each recorded with who gave it") {
    if (!has_page()) return;
    const RuntimeFolder runtime;
    const Folder folder;
    const std::uint16_t port = free_port();
    folder.write("rig.json", rig(port, R"(, "commands": ["note", "stop"])"));
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    CHECK(post(port, {{"words", {"note", "valve", "replaced"}}, {"who", "Ada"}}).parsed()["done"] == "noted");
    CHECK(post(port, {{"words", {"stop", "b"}}}).parsed()["done"] == "sensor b is stopped");
    CHECK(post(port, {{"words", {"stop", "c"}}}).parsed().contains("refused"));
    CHECK(post(port, {{"words", {"start", "b"}}}).status == 403);
    CHECK(post(port, {{"words", {"reload"}}}).status == 403);
    CHECK(post(port, {{"words", {"note", "x"}}}, "").status == 401);
    CHECK(post(port, {{"words", {"note", "x"}}, {"who", "a\nb"}}).status == 400);
    CHECK(post(port, {{"words", "note"}}).status == 400);
    CHECK(answer_to(port, request(port, "POST", "/command", allowed, "{}")).status == 415);
    CHECK(answer_to(port, request(port, "POST", "/command", allowed + "Content-Type: text/plain\r\n", "{}")).status ==
          415);
    end_well(run, folder);
    const Recording recording = Recording::open(folder.path() + "/rig.db").or_throw();
    auto rows = recording.rows({.topic = "rtdata/commands"}).or_throw();
    std::vector<std::string> commands;
    while (const RecordedRow* row = rows.next().or_throw())
      commands.push_back(to_string(row->event().value("command").or_throw()) + " by " +
                         to_string(row->event().value("by").or_throw()));
    CHECK(commands == std::vector<std::string>{"note valve replaced by Ada (page, 127.0.0.1)",
                                               "stop b by page, 127.0.0.1", "stop c by page, 127.0.0.1"});
  }

  TEST_CASE("BY-1 slow, many, huge and stopped connections do not keep others from the page, nor cost a row") {
    if (!has_page()) return;
    const RuntimeFolder runtime;
    const Folder folder;
    const std::uint16_t port = free_port();
    folder.write("rig.json", rig(port));
    Process run(folder, program, {"run", "rig.json"});
    REQUIRE(run.wait_for("running rig"));
    Events first(port);
    first.next("status");
    Connection stopped(port);  // it never reads
    stopped.send("GET /events HTTP/1.1\r\nHost: 127.0.0.1\r\n" + allowed + "\r\n");
    std::vector<Connection> slow;
    for (int i = 0; i < 900; ++i) {  // that begin a request and do not go on; some get no descriptor here
      Connection& one = slow.emplace_back(port);
      if (!one.is_open()) break;
      one.send("GET /status HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ");
    }
    CHECK(slow.size() > 300);
    CHECK(get(port, "/status").status == 200);
    for (Connection& one : slow) one.send("x");
    CHECK(get(port, "/").status == 200);
    // A request of a gigabyte, which says so, does not, or never ends its headers.
    const std::string json_type = "Content-Type: application/json\r\n";
    CHECK(answer_to(port, "POST /command HTTP/1.1\r\nHost: 127.0.0.1\r\n" + allowed + json_type +
                              "Content-Length: 1073741824\r\nConnection: close\r\n\r\n")
              .status == 413);
    Connection chunked(port);
    bool is_taken = chunked.send("POST /command HTTP/1.1\r\nHost: 127.0.0.1\r\n" + allowed + json_type +
                                 "Transfer-Encoding: chunked\r\n\r\n");
    const std::string chunk = "1000\r\n" + std::string(4096, 'x') + "\r\n";
    for (int i = 0; i < 10'000 && is_taken; ++i) is_taken = chunked.send(chunk);
    CHECK_FALSE(is_taken);
    Connection headers(port);
    is_taken = headers.send("GET / HTTP/1.1\r\n");
    for (int i = 0; i < 100'000 && is_taken; ++i) is_taken = headers.send("X-Much: " + std::string(1000, 'x') + "\r\n");
    CHECK_FALSE(is_taken);
    // Garbage, and a request within another's body.
    Connection garbage(port);
    garbage.send(std::string(3000, '\xff') + "\r\n\r\n");
    garbage.receive_all();
    CHECK(get(port, "/status").status == 200);
    const json step = first.next_step("a");
    CHECK(step["count"] > 0);
    std::vector<std::unique_ptr<Events>> pages;  // a hundred pages at once
    for (int i = 0; i < 100; ++i) pages.push_back(std::make_unique<Events>(port));
    for (auto& page : pages) CHECK(page->next_step("b")["count"] > 0);
    end_well(run, folder);
  }

  TEST_CASE("BY-1 a port that is taken is an error of a configured page; without one the next free port is taken") {
    if (!has_page()) return;
    const RuntimeFolder runtime;
    const Folder folder;
    const std::uint16_t port = free_port();
    folder.write("rig.json", rig(port));
    folder.write("bare.json", R"({"name": "bare", "sensors": [{"name": "a", "type": "tallied", "rate": "20 Hz"}]})");
    {
      Process run(folder, program, {"run", "rig.json"});
      REQUIRE(run.wait_for("running rig"));
      Process other(folder, program, {"run", "bare.json", "--page", "127.0.0.1:" + std::to_string(port)});
      CHECK(other.end() == 1);
      CHECK(has(other.err, "cannot serve the page"));
      CHECK(has(other.err, "127.0.0.1:" + std::to_string(port)));
      Process one(folder, program, {"run", "bare.json", "--page"});
      REQUIRE(one.wait_for("running bare"));
      Process two(folder, program, {"run", "bare.json", "--page"});
      REQUIRE(two.wait_for("running bare"));
      const auto page_of = [](const Process& of) {
        const std::size_t at = of.err.find("page: http://");
        return at == std::string::npos ? std::string() : of.err.substr(at, of.err.find('#', at) - at);
      };
      CHECK_FALSE(page_of(one).empty());
      CHECK(page_of(one) != page_of(two));
      Events page(port);
      page.next("status");
      run.signal(SIGKILL);  // while a page is open
      CHECK(run.end() == 128 + SIGKILL);
      while (page.next()) {  // until the connection has ended
      }
    }
    Process again(folder, program, {"run", "rig.json"});  // on the same port
    REQUIRE(again.wait_for("running rig"));
    CHECK(Events(port).next("status")["status"]["instance"]["name"] == "rig");
    again.signal(SIGTERM);
    CHECK(again.end() == 0);
  }

  TEST_CASE("BY-1 check refuses a page that others could command unencrypted, a token to guess, a wrong address") {
    if (!has_page()) return;
    const Folder folder;
    const auto check = [&](const std::string& page) {
      folder.write("page.json",
                   R"({"page": )" + page + R"(, "sensors": [{"name": "a", "type": "tallied", "rate": "1 Hz"}]})");
      Process done(folder, program, {"check", "page.json"});
      const int status = done.end();
      return std::to_string(status) + " " + done.out;
    };
    for (const std::string command : {"set", "arm", "disarm", "start", "stop"}) {
      const std::string commands = R"(, "commands": ["note", ")" + command + "\"]";
      CHECK(check(R"({"listen": "127.0.0.1:8080")" + commands + "}").starts_with("0 "));
      CHECK(check(R"({"listen": "0.0.0.0:8080", "behind_tls_proxy": true)" + commands + "}").starts_with("0 "));
      const std::string refused = check(R"({"listen": "0.0.0.0:8080")" + commands + "}");
      CHECK(refused.starts_with("2 "));
      CHECK(has(refused, "\"" + command + "\" is sent unencrypted"));
    }
    CHECK(check(R"({"listen": "[::]:8080", "commands": ["note", "ack", "event"]})").starts_with("0 "));
    CHECK(has(check(R"({"listen": "127.0.0.1:8080", "token": "short"})"), "could be guessed"));
    CHECK(has(check(R"({"listen": "127.0.0.1:80000"})"), "its port is not a number from 0 to 65535"));
    CHECK(has(check(R"({"listen": "bench.example:80"})"), "it does not begin with an IP address of this machine"));
    CHECK(check(R"({"listen": "127.0.0.1", "commands": ["reload"]})").starts_with("2 "));
    // What `run` would read.
    folder.write("none.pem", "no certificate");
    const std::string unreadable = check(
        R"({"listen": "127.0.0.1", "tls": {"certificate": "none.pem", "key": "no.pem"}})");
    CHECK(unreadable.starts_with("2 "));
    CHECK(has(unreadable, "page.tls.certificate: cannot read the file none.pem: it is not PEM"));
    CHECK(has(unreadable, "page.tls.key: cannot read the file no.pem: No such file"));
    CHECK(check(R"({})").starts_with("2 "));
  }
}
