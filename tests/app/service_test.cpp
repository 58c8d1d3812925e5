// What a service manager hears, with a socket of the test in its place.
#include "app/run/service.hpp"

#include <doctest/doctest.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <semaphore>
#include <sstream>
#include <string>
#include <vector>

#include "app/process.hpp"
#include "paths.hpp"
#include "rtdata/loop/runtime.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using app::Service;
using app::ServiceManager;
using test::Folder;
using test::Process;

namespace {

const std::string program = rtdata::test::built("rtdata_test_program");

/// The manager's end of $NOTIFY_SOCKET, set in the environment while it lives. "@..." is an abstract address.
class FakeManager {
 public:
  explicit FakeManager(const std::string& address, const char* watchdog_usec = nullptr) {
    fd_ = ::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    sockaddr_un name{};
    name.sun_family = AF_UNIX;
    REQUIRE(address.size() < sizeof name.sun_path);
    std::memcpy(name.sun_path, address.data(), address.size());
    const bool is_abstract = address.front() == '@';
    if (is_abstract) name.sun_path[0] = '\0';
    const std::size_t length = offsetof(sockaddr_un, sun_path) + address.size() + (is_abstract ? 0 : 1);
    REQUIRE(::bind(fd_, reinterpret_cast<const sockaddr*>(&name), static_cast<socklen_t>(length)) == 0);
    ::setenv("NOTIFY_SOCKET", address.c_str(), 1);
    if (watchdog_usec != nullptr) ::setenv("WATCHDOG_USEC", watchdog_usec, 1);
  }
  FakeManager(const FakeManager&) = delete;
  FakeManager& operator=(const FakeManager&) = delete;
  ~FakeManager() {
    ::unsetenv("NOTIFY_SOCKET");
    ::unsetenv("WATCHDOG_USEC");
    ::close(fd_);
  }
  /// What has come since the last call, and is kept in `all`.
  std::vector<std::string> take() {
    std::vector<std::string> taken;
    char buffer[4096];
    for (ssize_t size; (size = ::recv(fd_, buffer, sizeof buffer, 0)) >= 0;)
      taken.emplace_back(buffer, static_cast<std::size_t>(size));
    all.insert(all.end(), taken.begin(), taken.end());
    return taken;
  }
  /// Waits for a message that begins so, for a minute at most.
  bool wait_for(const std::string& begin) {
    for (int looks = 0; looks < 600; ++looks) {
      take();
      if (count(begin) > 0) return true;
      pollfd ready{fd_, POLLIN, 0};
      ::poll(&ready, 1, 100);
    }
    return false;
  }
  std::ptrdiff_t count(const std::string& begin) const {
    return std::count_if(all.begin(), all.end(), [&](const std::string& one) { return one.starts_with(begin); });
  }
  std::vector<std::string> all;

 private:
  int fd_ = -1;
};

/// Runs the loop until the condition holds, for a minute at most.
template <class Condition>
bool run_until(Loop& loop, Condition condition) {
  bool held = false;
  unsigned looks = 0;
  Ticker look(loop, 5ms, [&](const Tick&) {
    held = condition();
    if (held || ++looks == 12'000) loop.stop();
  });
  loop.run();
  return held;
}

std::string abstract_address() { return "@rtdata-test-" + std::to_string(::getpid()); }

}  // namespace

TEST_SUITE_BEGIN("app");

/// How long the log says that the slow sensor held the loop at first; 0: it does not say.
static double held_ms(const std::string& log) {
  const std::string before = "sensor slow: held the loop for ";
  const std::size_t at = log.find(before);
  if (at == std::string::npos) return 0;
  std::istringstream text(log.substr(at + before.size()));
  double value = 0;
  std::string unit;
  text >> value >> unit;
  return unit.starts_with("ms") ? value : value * 1e3;
}

TEST_CASE("NFR-2 the service manager is told through its socket, by path and by abstract name") {
  const Folder folder;
  for (const std::string& address : {folder.path() + "/notify", abstract_address()}) {
    FakeManager fake(address, "3000000");
    ServiceManager manager;
    CHECK(manager.watchdog() == 3s);
    CHECK(manager.tell("READY=1\nSTATUS=running"));
    CHECK(fake.take() == std::vector<std::string>{"READY=1\nSTATUS=running"});
  }
}

TEST_CASE("NFR-2 without a service manager nothing is told; one that has gone is an error, not a wait") {
  {
    ServiceManager none;
    CHECK(none.watchdog() == Duration{0});
    CHECK(none.tell("READY=1"));
  }
  const Folder folder;
  ::setenv("NOTIFY_SOCKET", (folder.path() + "/gone").c_str(), 1);
  ::setenv("WATCHDOG_USEC", "soon", 1);
  {
    ServiceManager gone;
    CHECK(gone.watchdog() == Duration{0});
    const auto told = gone.tell("READY=1");
    REQUIRE_FALSE(told);
    CHECK(told.error().where == folder.path() + "/gone");
  }
  ::setenv("NOTIFY_SOCKET", ("/" + std::string(200, 'x')).c_str(), 1);
  ::setenv("WATCHDOG_USEC", "1000000", 1);
  ::setenv("WATCHDOG_PID", "1", 1);
  {
    ServiceManager too_long;
    CHECK(too_long.watchdog() == Duration{0});  // another process is watched
    CHECK_FALSE(too_long.tell("READY=1"));
  }
  ::unsetenv("NOTIFY_SOCKET");
  ::unsetenv("WATCHDOG_USEC");
  ::unsetenv("WATCHDOG_PID");
}

TEST_CASE("NFR-1 the watchdog is fed while every tier turns, and not while one hangs") {
  FakeManager fake(abstract_address(), "400000");
  Loop loop;
  loop.on_error([](const ErrorReport&) {});
  loop.runtime().on_log([](const LogRecord&) {});
  Tier fast(loop, {.name = "fast", .hold_limit = 1h});
  Tier other(loop, {.name = "other"});
  Service service(loop);
  const auto feeds_since = [&] {
    const auto taken = fake.take();
    return std::count(taken.begin(), taken.end(), "WATCHDOG=1");
  };
  CHECK(run_until(loop, [&] { return feeds_since() > 0; }));
  std::binary_semaphore release{0};
  fast.loop().post([&] { release.acquire(); });
  const std::uint64_t before = service.withheld();
  CHECK(run_until(loop, [&] { return service.withheld() > before; }));
  feeds_since();
  const std::uint64_t hanging = service.withheld();
  CHECK(run_until(loop, [&] { return service.withheld() >= hanging + 3; }));
  CHECK(feeds_since() == 0);
  release.release();
  CHECK(run_until(loop, [&] { return feeds_since() > 0; }));
}

TEST_CASE("NFR-2 a run tells that it is ready, feeds the watchdog, and tells that it stops") {
  const Folder folder;
  FakeManager fake(folder.path() + "/notify", "200000");
  folder.write(
      "bench.json",
      R"({"sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz"} ], "sinks": [ {"type": "discard"} ]})");
  Process run(folder, program, {"run", "bench.json"});
  CHECK(fake.wait_for("READY=1\n"));
  CHECK(fake.wait_for("WATCHDOG=1"));
  CHECK(fake.count("STOPPING=1") == 0);
  run.signal(SIGTERM);
  CHECK(run.end() == 0);
  fake.take();
  CHECK(fake.count("READY=1\n") == 1);
  CHECK(fake.count("STOPPING=1") == 1);
}

TEST_CASE(
    "US-9 a signal while a timed run stores what is queued does not cut that short; what is not stored is status 1") {
  const Folder folder;
  FakeManager fake(folder.path() + "/notify");
  folder.write("bench.json", R"({
    "sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz"} ],
    "sinks": [ {"type": "discard", "stalls": true, "batch_time": "10 ms", "close_deadline": "4 s"} ] })");
  Process run(folder, program, {"run", "bench.json", "--for", "300ms"});
  CHECK(fake.wait_for("STOPPING=1"));
  run.signal(SIGTERM);
  CHECK(run.end() == 1);
  CHECK(run.err.find("SIGTERM: the queued events are already being stored (a second one ends the program at once; they "
                     "are then lost)") != std::string::npos);
  CHECK(run.out.find(" events were NOT stored; LOST: ") != std::string::npos);
  CHECK(run.out.find(" dropped by sinks (a): refused; taken: ") != std::string::npos);
  CHECK(run.out.find("; ledger balances\n") != std::string::npos);
}

TEST_CASE("NFR-1 a run names the tier that does not turn, and the sensor that held it with its place") {
  const Folder folder;
  FakeManager fake(folder.path() + "/notify", "200000");
  folder.write("bench.json", R"({
  "tiers": { "fast": { "hold_limit": "100 ms" } },
  "sensors": [
    {"name": "slow", "type": "tallied", "rate": "0.001 Hz", "hold": "900 ms", "tier": "fast"},
    {"name": "quick", "type": "tallied", "rate": "100 Hz"}
  ],
  "sinks": [ {"type": "discard"} ]
})");
  Process run(folder, program, {"run", "bench.json"});
  CHECK(run.wait_for("tier fast: does not turn"));
  CHECK(run.wait_for("tier fast: turns again"));
  CHECK(fake.wait_for("WATCHDOG=1"));
  run.signal(SIGTERM);
  CHECK(run.end() == 0);
  const std::string log = folder.read("bench.log");
  CHECK(held_ms(log) >= 900);
  CHECK(log.find("bench.json:4:") != std::string::npos);
  CHECK(log.find("[not-turning]") != std::string::npos);
  CHECK(log.find("sensor slow: held the loop 1 times in 1 calls") != std::string::npos);
}

TEST_CASE("NFR-2 a run that is refused is never ready") {
  const Folder folder;
  FakeManager fake(folder.path() + "/notify");
  folder.write("bench.json", R"({"sensors": [ {"name": "a", "type": "no such type"} ]})");
  Process run(folder, program, {"run", "bench.json"});
  CHECK(run.end() == 2);
  CHECK(fake.take().empty());
}

TEST_CASE("US-5 a sensor that holds the loop is named with its place in the file, and on_overrun stops it") {
  const Folder folder;
  folder.write("bench.json", R"({
  "sensors": [
    {"name": "slow", "type": "tallied", "rate": "100 Hz", "hold": "35 ms", "on_overrun": "stop"},
    {"name": "quick", "type": "tallied", "rate": "100 Hz"}
  ],
  "sinks": [ {"type": "discard"} ]
})");
  Process run(folder, program, {"run", "bench.json", "--for", "300ms"});
  CHECK(run.end() == 0);
  const std::string log = folder.read("bench.log");
  CHECK(held_ms(log) >= 35);
  CHECK(log.find("bench.json:3:") != std::string::npos);
  CHECK(log.find("sensor slow: held the loop 1 times in 1 calls") != std::string::npos);
  CHECK(run.out.find("faulted") != std::string::npos);
  folder.write(
      "wrong.json",
      R"({"sensors": [ {"name": "a", "type": "tallied", "rate": "1 Hz", "on_overrun": "slower"} ], "sinks": []})");
  Process check(folder, program, {"check", "wrong.json"});
  CHECK(check.end() == 2);
}

TEST_SUITE_END();
