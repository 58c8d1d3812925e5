// The local socket of an instance, in virtual time, with clients that behave and clients that do not.
#include "app/control/control_socket.hpp"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>

#include <cstring>
#include <fstream>
#include <functional>
#include <iterator>
#include <nlohmann/json.hpp>

#include "app/control/commands.hpp"
#include "app/control/request.hpp"
#include "app/control/status_source.hpp"
#include "app/control/status_view.hpp"
#include "app/runtime_folder.hpp"
#include "paths.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/sensors/sensor.hpp"

using namespace rtdata;
using namespace rtdata::app;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using rtdata::test::RuntimeFolder;

namespace {

struct Level {
  double value = 0;
  RTDATA_FIELDS(Level, (value, "V"))
};

/// A client that writes what it likes. Never waits.
class RawClient {
 public:
  explicit RawClient(const std::string& path) : fd_(::socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof address.sun_path - 1);
    REQUIRE(::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0);
  }
  RawClient(const RawClient&) = delete;
  RawClient& operator=(const RawClient&) = delete;
  ~RawClient() { close(); }
  void close() {
    if (fd_ >= 0) ::close(std::exchange(fd_, -1));
  }
  void end_sending() const { ::shutdown(fd_, SHUT_WR); }
  void send(const std::string& text) const {
    [[maybe_unused]] const ssize_t size = ::send(fd_, text.data(), text.size(), MSG_NOSIGNAL);
  }
  /// What there is to read now.
  std::string read() {
    std::string text(1 << 20, '\0');
    const ssize_t size = ::recv(fd_, text.data(), text.size(), MSG_DONTWAIT);
    has_ended = size == 0 || (size < 0 && errno == ECONNRESET);
    text.resize(size > 0 ? static_cast<std::size_t>(size) : 0);
    return text;
  }
  bool is_disconnected() {
    while (!read().empty()) {
    }
    return has_ended;
  }
  bool has_ended = false;

 private:
  int fd_ = -1;
};

/// A socket whose answers are the lines themselves, or long.
struct Echo {
  Echo() { ::signal(SIGPIPE, SIG_IGN); }  // as the program has it
  RuntimeFolder folder;
  Loop loop{Loop::Manual{}};
  std::size_t answered = 0;
  std::size_t answer_size = 0;
  std::vector<std::uint64_t> gone;
  ControlSocket socket{loop,
                       [this](std::uint64_t client, std::string_view line) -> ControlSocket::Work {
                         ++answered;
                         if (answer_size > 0) return [size = answer_size] { return std::string(size, 'x'); };
                         return [text = std::to_string(client) + ":" + std::string(line)] { return text; };
                       },
                       [this](std::uint64_t client) { gone.push_back(client); }};
  /// Enough turns for one line of each of a few clients.
  void turn(Duration duration = 100ms) {
    for (int i = 0; i < 20; ++i) {
      loop.advance(duration / 20);
      loop.poll();
    }
  }
};

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("a control socket answers line by line, whole, half and joined ones, of several clients") {
    Echo echo;
    RawClient a(echo.socket.path());
    RawClient b(echo.socket.path());
    a.send("one\n");
    echo.turn();
    CHECK(a.read() == "1:one\n");
    b.send("ha");
    echo.turn();
    CHECK(b.read().empty());
    b.send("lf\nnext\nlast\n");
    echo.turn(200ms);
    CHECK(b.read() == "2:half\n2:next\n2:last\n");
    a.send("\n");
    echo.turn();
    CHECK(a.read() == "1:\n");
    CHECK(echo.answered == 5);
    a.close();
    echo.turn();
    CHECK(echo.gone == std::vector<std::uint64_t>{1});
  }

  TEST_CASE("a control socket answers those who have ended their side, and no half line") {
    Echo echo;
    RawClient client(echo.socket.path());
    client.send("one\ntwo\nhalf");
    client.end_sending();
    echo.turn(300ms);
    CHECK(client.read() == "1:one\n1:two\n");
    CHECK(client.is_disconnected());
    CHECK(echo.gone.size() == 1);
  }

  TEST_CASE("a control socket disconnects who sends more than a line may have") {
    Echo echo;
    RawClient client(echo.socket.path());
    client.send(std::string(ControlSocket::longest_line, 'a') + "\n");
    echo.turn();
    CHECK(client.read().size() == ControlSocket::longest_line + 3);
    client.send(std::string(ControlSocket::longest_line + 1, 'a'));
    echo.turn();
    CHECK(client.is_disconnected());
    CHECK(echo.answered == 1);
  }

  TEST_CASE("a control socket keeps eight clients; whoever has asked nothing for the longest gives way to a ninth") {
    Echo echo;
    std::vector<std::unique_ptr<RawClient>> clients;
    for (std::size_t i = 0; i < ControlSocket::most_clients; ++i) {
      clients.push_back(std::make_unique<RawClient>(echo.socket.path()));
      echo.turn();
    }
    clients.front()->send("still here\n");
    echo.turn();
    CHECK(clients.front()->read() == "1:still here\n");
    RawClient ninth(echo.socket.path());
    ninth.send("x\n");
    echo.turn();
    CHECK(ninth.read() == "9:x\n");
    CHECK(clients[1]->read() == "{\"error\":\"too many clients; this one has asked nothing for the longest time\"}\n");
    CHECK(clients[1]->is_disconnected());
    CHECK(echo.gone == std::vector<std::uint64_t>{2});
    for (std::uint64_t i = 0; i < 20; ++i) {  // however many idle ones there are
      clients.push_back(std::make_unique<RawClient>(echo.socket.path()));
      echo.turn();
    }
    RawClient last(echo.socket.path());
    last.send("y\n");
    echo.turn();
    CHECK(last.read() == "30:y\n");
  }

  TEST_CASE("a control socket disconnects nobody whose answer is being made, and refuses a ninth when all are so") {
    ::signal(SIGPIPE, SIG_IGN);  // as the program has it
    RuntimeFolder folder;
    Loop loop{Loop::Manual{}};
    std::size_t taken = 0;
    ControlSocket socket{loop,
                         [&](std::uint64_t client, std::string_view line) -> ControlSocket::Work {
                           ++taken;
                           return [text = std::to_string(client) + ":" + std::string(line)] {
                             detail::lane_sleep(300ms);  // one after the other: the first is there when all have asked
                             return text;
                           };
                         },
                         [](std::uint64_t) {}};
    const auto turn = [&](Duration duration = 10ms) {
      for (int i = 0; i < 20; ++i) {
        loop.advance(duration / 20);
        loop.poll();
      }
    };
    std::vector<std::unique_ptr<RawClient>> clients;
    const auto connect = [&](const std::string& line) {
      clients.push_back(std::make_unique<RawClient>(socket.path()));
      if (!line.empty()) clients.back()->send(line + "\n");
      turn();
    };
    connect("command 1");
    for (int i = 2; i <= 7; ++i) connect("command");
    connect("");  // asks nothing
    CHECK(taken == 7);
    connect("the last");
    CHECK(taken == 8);
    CHECK(clients[7]->read() == "{\"error\":\"too many clients; this one has asked nothing for the longest time\"}\n");
    CHECK(clients[7]->is_disconnected());
    connect("one too many");
    CHECK(taken == 8);
    CHECK(clients[9]->read() ==
          "{\"error\":\"too many clients, and all of them wait for their answers: ask again\"}\n");
    CHECK(clients[9]->is_disconnected());
    turn(4s);
    CHECK(clients[0]->read() == "1:command 1\n");
    for (std::size_t i = 1; i < 7; ++i) CHECK(clients[i]->read() == std::to_string(i + 1) + ":command\n");
    CHECK(clients[8]->read() == "9:the last\n");
    connect("room again");
    turn(1s);
    CHECK(clients[10]->read() == "10:room again\n");
  }

  TEST_CASE("a control socket that closes tells whose answer was being made that the log has it") {
    RuntimeFolder folder;
    Loop loop{Loop::Manual{}};
    std::optional<ControlSocket> socket;
    socket.emplace(
        loop,
        [](std::uint64_t, std::string_view) -> ControlSocket::Work {
          return [] {
            detail::lane_sleep(1s);
            return std::string("answer");
          };
        },
        [](std::uint64_t) {});
    RawClient asks(socket->path());
    RawClient looks(socket->path());
    asks.send("command\n");
    for (int i = 0; i < 20; ++i) loop.poll();
    socket.reset();
    CHECK(asks.read() == "{\"ended\":\"the run has ended; its log says whether the command was done\"}\n");
    CHECK(looks.read() == "{\"ended\":\"the run has ended\"}\n");
  }

  TEST_CASE("a control socket gives up on who does not read, and serves the others meanwhile") {
    Echo echo;
    echo.answer_size = std::size_t{8} << 20;
    RawClient lazy(echo.socket.path());
    lazy.send("one\n");
    echo.turn();
    for (int i = 0; i < 1000; ++i) lazy.send("more\n");
    echo.turn(1s);
    CHECK(echo.answered == 1);
    echo.answer_size = 0;
    RawClient other(echo.socket.path());
    other.send("x\n");
    echo.turn(1s);
    CHECK(other.read() == "2:x\n");
    CHECK(echo.gone.empty());
    echo.turn(5s);
    CHECK(echo.gone == std::vector<std::uint64_t>{1});
    CHECK(echo.answered == 2);
  }

  TEST_CASE("a control socket without a descriptor for a client disconnects it at once, and serves the next") {
    Echo echo;
    RawClient served(echo.socket.path());
    echo.turn();
    RawClient client(echo.socket.path());
    client.send("one\n");
    rlimit before{};
    REQUIRE(::getrlimit(RLIMIT_NOFILE, &before) == 0);
    const int lowest_free = ::open("/dev/null", O_RDONLY | O_CLOEXEC);
    ::close(lowest_free);
    const rlimit none_left{static_cast<rlim_t>(lowest_free), before.rlim_max};
    REQUIRE(::setrlimit(RLIMIT_NOFILE, &none_left) == 0);
    echo.turn();
    CHECK(client.is_disconnected());
    served.send("two\n");
    echo.turn();
    CHECK(served.read() == "1:two\n");
    ::setrlimit(RLIMIT_NOFILE, &before);
    RawClient next(echo.socket.path());
    next.send("three\n");
    echo.turn();
    CHECK(next.read() == "2:three\n");
    CHECK(echo.answered == 2);
  }

  TEST_CASE("a control socket takes one connection a turn, and what a thousand clients cost is bounded") {
    Echo echo;
    std::vector<std::unique_ptr<RawClient>> clients;
    for (int i = 0; i < 1000; ++i) {
      clients.push_back(std::make_unique<RawClient>(echo.socket.path()));
      for (int k = 0; k < 3; ++k) echo.loop.poll();
    }
    echo.turn();
    std::size_t connected = 0;
    for (const auto& client : clients) connected += client->is_disconnected() ? 0 : 1;
    CHECK(connected == ControlSocket::most_clients);
    CHECK(echo.gone.size() == 1000 - ControlSocket::most_clients);
    // One that sends without end, and no end of a line: what is read of it is bounded, too.
    const std::string endless(1 << 20, 'x');
    for (int i = 0; i < 100 && !clients.back()->is_disconnected(); ++i) {
      clients.back()->send(endless);
      echo.turn();
    }
    CHECK(clients.back()->has_ended);
    CHECK(echo.answered == 0);
  }

  TEST_CASE("a control socket answers a client at most every 20 ms, however many lines it sends") {
    Echo echo;
    RawClient client(echo.socket.path());
    for (int i = 0; i < 1000; ++i) client.send("x\n");
    echo.turn(200ms);
    CHECK(echo.answered >= 8);
    CHECK(echo.answered <= 12);
  }

  TEST_CASE("the folder of control sockets is the user's alone, or it is not used") {
    RuntimeFolder folder;
    Loop loop{Loop::Manual{}};
    const auto open = [&] {
      ControlSocket(
          loop, [](std::uint64_t, std::string_view) { return [] { return std::string(); }; }, [](std::uint64_t) {});
    };
    open();
    struct stat made {};
    REQUIRE(::stat(folder.path().c_str(), &made) == 0);
    CHECK((made.st_mode & 0777) == 0700);
    CHECK(folder.sockets() == 0);  // removed at the end
    ::chmod(folder.path().c_str(), 0777);
    CHECK_THROWS_AS(open(), SetupError);
    CHECK(running_instances().empty());
  }

  TEST_CASE("times are counted within an eighth, and the largest as it was") {
    TimeCounts counts;
    CHECK(counts.percentile(0.5) == Duration{0});
    for (std::int64_t ns = 1; ns <= 100000; ++ns) counts.add(Duration{ns});
    CHECK(counts.total() == 100000);
    CHECK(counts.largest() == Duration{100000});
    for (const double fraction : {0.001, 0.1, 0.5, 0.99}) {
      const auto got = static_cast<double>(counts.percentile(fraction).count());
      CHECK(got >= fraction * 100000);
      CHECK(got <= fraction * 100000 * 1.13);
    }
    CHECK(counts.percentile(1) == Duration{100000});
    TimeCounts more;
    more.add(1h);
    more.add(counts);
    CHECK(more.total() == 100001);
    CHECK(more.largest() == 1h);
  }

  TEST_CASE("requests that are none are answered with what is wrong, and nothing else happens") {
    Loop loop{Loop::Manual{}};
    StatusSource status(loop, {.name = "x", .configuration = "x.json"});
    for (const char* line : {"", "{", "[]", "null", "\xff\xfe", "{}", R"({"request":1})", R"({"request":"stop"})",
                             R"({"request":"status","version":2})", R"({"request":"status","version":"x"})"}) {
      const auto answer = nlohmann::json::parse(status.answer(1, line)());
      CHECK_MESSAGE(answer.contains("error"), line);
      CHECK(answer.size() == 1);
    }
    CHECK(loop.callbacks().empty());
    for (const char* words : {"", R"(,"words":[])", R"(,"words":"note x")", R"(,"words":["note",1])"}) {
      const std::string line = std::string(R"({"request":"command")") + words + "}";
      CHECK(command_words(line).empty());
      CHECK(status.answer(1, line)() == R"({"error":"\"words\" of a command must be a list of at least one string"})");
    }
    const std::string newer = R"({"request":"command","version":2,"words":["stop","a"]})";
    CHECK(command_words(newer).empty());
    CHECK(
        status.answer(1, newer)() ==
        R"({"error":"the request is in version 2 of the protocol, and this program knows up to 1: use the version of the program that runs"})");
  }

  TEST_CASE("a status has counts, rates, lateness and last values, and looks only while asked") {
    Loop loop{Loop::Manual{}};
    StatusSource status(loop, {.name = "rig", .configuration = "rig.json"});
    double value = 0;
    const Sensor<Level> slow(loop, {.name = "slow", .rate = 10_Hz}, [&] {
      loop.manual_clock().pass(2ms);
      return Level{++value};
    });
    const Sensor<Level> held(loop, {.name = "held", .topic = "some/held", .rate = 10_Hz, .late_after = 1ms},
                             [&] { return Level{-value}; });
    const auto take = [&](std::uint64_t client) {
      return nlohmann::json::parse(status.answer(client, R"({"request":"status"})")());
    };
    loop.advance(1s);
    CHECK(loop.callbacks().size() == 2);
    const auto first = take(7);
    CHECK(loop.callbacks().size() == 3);  // from now on it looks
    CHECK(first["instance"]["name"] == "rig");
    CHECK(first["version"] == 1);
    CHECK(first["loops"][0]["load_percent"].is_null());
    REQUIRE(first["sensors"].size() == 2);
    CHECK(first["sensors"][0]["reached_hz"].is_null());
    CHECK(first["sensors"][0]["value"].is_null());
    const auto before = first["sensors"][0]["published"].get<int>();

    loop.advance(1s);
    const auto second = take(7);
    const auto& of_slow = second["sensors"][0];
    const auto& of_held = second["sensors"][1];
    CHECK(of_slow["published"] == before + 10);
    CHECK(of_slow["reached_hz"].get<double>() == doctest::Approx(10).epsilon(0.003));
    CHECK(of_slow["wanted_hz"] == 10.0);
    CHECK(of_slow["value"] == std::to_string(before + 10) + " V");
    CHECK(of_slow["lateness_ns"]["max"] == 0);
    CHECK(of_held["topic"] == "some/held");
    CHECK(of_held["late"] == of_held["published"]);
    CHECK(of_held["lateness_ns"]["max"] == 2000000);
    CHECK(of_held["lateness_ns"]["p50"] == 2000000);
    CHECK(second["loops"][0]["lateness_ns"]["max"] == 2000000);
    CHECK(second["callbacks"][0]["name"] == "sensor slow");
    CHECK(second["callbacks"][0]["count"] == before + 10);
    CHECK(second["callbacks"][0]["max_ns"] == 2000000);

    // Whoever asks is told the same.
    loop.advance(500ms);
    auto third = take(8);
    CHECK(third["sensors"][0]["reached_hz"].get<double>() == doctest::Approx(10).epsilon(0.01));
    third["instance"].erase("running_for_s");
    auto fourth = take(7);
    fourth["instance"].erase("running_for_s");
    CHECK(third["sensors"] == fourth["sensors"]);
    status.forget(7);
    CHECK(loop.callbacks().size() == 3);
    status.forget(8);
    CHECK(loop.callbacks().size() == 2);
  }

  TEST_CASE("the rate of a slow sensor is right, or not told, from the first answer on") {
    Loop loop{Loop::Manual{}};
    StatusSource status(loop, {.name = "rig", .configuration = "rig.json"});
    const Sensor<Level> two(loop, {.name = "two", .rate = 2_Hz}, [] { return Level{1}; });
    const Sensor<Level> tenth(loop, {.name = "tenth", .rate = 0.1_Hz}, [] { return Level{1}; });
    Duration offset = 10ms;
    SUBCASE("just after a reading") {}
    SUBCASE("between two") { offset = 260ms; }
    SUBCASE("just before one") { offset = 490ms; }
    loop.advance(offset);
    int told = 0, of_tenth = 0;
    for (int i = 0; i < 50; ++i) {
      const auto answer = nlohmann::json::parse(status.answer(7, R"({"request":"status"})")());
      for (const auto& [sensor, hertz, count] : {std::tuple{0, 2.0, &told}, {1, 0.1, &of_tenth}}) {
        const auto& reached = answer["sensors"][sensor]["reached_hz"];
        if (reached.is_null()) continue;
        CHECK(reached.get<double>() == doctest::Approx(hertz).epsilon(0.001));
        ++*count;
      }
      loop.advance(1s);
    }
    CHECK(told >= 48);
    CHECK(of_tenth >= 20);
  }

  TEST_CASE("a status says the same as a value, as JSON and as text, and its keys are those that are documented") {
    app::Status status;
    status.instance = {"rig", 4711, "2026-03-01T12:00:00Z", 2500ms, "rig.json"};
    app::Status::Sensor& sensor = status.sensors.emplace_back();
    sensor.name = "hot";
    sensor.reason = "\xff";
    sensor.health = Health::degraded;
    sensor.is_running = true;
    sensor.published = ~std::uint64_t{0};
    sensor.wanted_hz = 10;
    sensor.lateness = app::Status::Lateness{1us, 2ms, 3s};
    sensor.outages = {2, 1500ms};
    sensor.alarm = app::Status::Alarm{"high", true, false};
    sensor.state = "waits";
    sensor.in_state = 250ms;
    status.loops.emplace_back().name = "main";
    status.loops[0].hangs_in = "sensor hot";
    status.loops[0].warnings = {"no FIFO"};
    status.topics.push_back({.name = "hot", .published = 7, .dropped = 1});
    status.total = status.topics[0];
    status.sinks.resize(2);
    status.sinks[0].dropped = {1, 2, 3};
    status.sinks[0].queued = 3;
    status.sinks[0].backlog = Backlog{96, Time{1s}, 12min, 5s};
    status.parts = {{"bus", "i2c1", "i2c", {"sensor hot"}, {{"0x48", 5, 4, 3, 2us, 1us}}}};
    status.callbacks = {{"sensor hot", "main", 3, 5us, 4us}};
    status.mute = {"cold"};
    const std::string line = app::json_of(status);
    auto read = app::status_from(line);
    REQUIRE(read);
    CHECK(app::json_of(*read) == line);
    status.sensors[0].reason = "\xef\xbf\xbd";  // as JSON has what is no UTF-8
    CHECK(app::lines_of(*read, 100, 1000) == app::lines_of(status, 100, 1000));
    CHECK(app::summary(*read, 0) == app::summary(status, 0));

    // An older instance lacks keys, a newer one has more; another version is refused in words.
    auto json = nlohmann::json::parse(line);
    json["later"] = 1;
    json["sensors"][0].erase("repeated");
    json["sensors"][0].erase("alarm");
    CHECK(app::status_from(json.dump()));
    json["version"] = 2;
    const auto newer = app::status_from(json.dump());
    REQUIRE_FALSE(newer);
    CHECK(newer.error().text() ==
          "no status: instance: it speaks version 2 of the protocol, and this program up to 1: use the version of "
          "the program that runs there, or a newer one");
    for (const std::string none : {"", "[]", "1", "{}", R"({"version":"1"})", R"({"version":1,"sensors":5})", "\xff",
                                   R"({"version":1,"sensors":[{"name":7}]})", R"({"error":1})"})
      CHECK_MESSAGE(!app::status_from(none), none);
    CHECK(app::status_from(R"({"ended":"x"})").error().code == make_error_code(Errc::closed));

    std::ifstream file(rtdata::test::in_source("docs/program.md"));
    const std::string docs{std::istreambuf_iterator<char>(file), {}};
    const std::size_t begin = docs.find("\n## The status\n"), end = docs.find("\n## ", begin + 1);
    REQUIRE(begin != std::string::npos);
    const std::string table = docs.substr(begin, end - begin);
    const std::function<void(const nlohmann::json&)> check_keys = [&](const nlohmann::json& of) {
      for (const auto& item : of.items()) {
        if (of.is_object()) CHECK_MESSAGE(table.find("`" + item.key() + "`") != std::string::npos, item.key());
        if (item.value().is_structured()) check_keys(item.value());
      }
    };
    check_keys(nlohmann::json::parse(line));
  }
}
