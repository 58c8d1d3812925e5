// Programs that are killed at random moments while they send through a recording, to a receiver that counts, and that
// breaks off and dies at random too.
#include <doctest/doctest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <string_view>
#include <tuple>

#include "rtdata/recording/recording.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "rtdata/sinks/tcp.hpp"
#include "sinks/answering_peer.hpp"
#include "sinks/killed.hpp"
#include "sinks/recordings.hpp"
#ifdef RTDATA_WITH_HTTP
#include "rtdata/sinks/http.hpp"
#endif
#ifdef RTDATA_WITH_MQTT
#include "rtdata/sinks/mqtt.hpp"
#endif

using namespace rtdata;
using namespace rtdata::literals;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

struct Pulse {
  std::int64_t count = 0;
  friend constexpr auto describe(type_tag<Pulse>) { return record("pulse", field("count", &Pulse::count, "1")); }
};

/// Keeps each event in a file before it answers. One in a hundred answers is a connection that ends, before the event
/// is kept or after it.
class Receiver {
 public:
  Receiver(std::string path, Answering answering) : path_(std::move(path)), answering_(std::move(answering)) {
    listener_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    REQUIRE(listener_ >= 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    REQUIRE(::bind(listener_, reinterpret_cast<sockaddr*>(&address), size) == 0);
    REQUIRE(::listen(listener_, 16) == 0);
    REQUIRE(::getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &size) == 0);
    port_ = ntohs(address.sin_port);
  }
  Receiver(const Receiver&) = delete;
  Receiver& operator=(const Receiver&) = delete;
  ~Receiver() {
    kill();
    ::close(listener_);
  }

  std::uint16_t port() const { return port_; }
  void start(unsigned seed) {
    child_ = ::fork();
    if (child_ != 0) return;
    try {
      serve(seed);
    } catch (...) {
    }
    ::_exit(1);
  }
  /// Until it is started again, the kernel accepts connections that nobody answers.
  void kill() {
    if (child_ <= 0) return;
    ::kill(child_, SIGKILL);
    ::waitpid(child_, nullptr, 0);
    child_ = 0;
  }

 private:
  struct Peer {
    std::string in;
    bool is_over = false;
  };

  void serve(unsigned seed) {
    std::mt19937 random(seed);
    std::map<int, Peer> peers;
    std::ofstream file(path_, std::ios::app);
    for (;;) {
      std::vector<pollfd> watched{{listener_, POLLIN, 0}};
      for (const auto& [fd, peer] : peers) watched.push_back({fd, POLLIN, 0});
      ::poll(watched.data(), watched.size(), -1);
      for (const pollfd& one : watched) {
        if (one.revents == 0) continue;
        if (one.fd == listener_) {
          if (const int fd = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC); fd >= 0) peers[fd];
          continue;
        }
        Peer& peer = peers[one.fd];
        char bytes[65536];
        const ssize_t got = ::recv(one.fd, bytes, sizeof bytes, 0);
        if (got > 0) peer.in.append(bytes, static_cast<std::size_t>(got));
        peer.is_over = got <= 0;
        while (!peer.is_over) {
          std::string event;
          const std::string answer = answering_(peer.in, event);
          if (answer.empty()) break;
          const bool is_lost = !event.empty() && random() % 100 == 0, is_kept = !is_lost || random() % 2 == 0;
          if (is_kept) (file << event).flush();
          if (is_lost) {
            peer.is_over = true;
            break;
          }
          peer.is_over = ::send(one.fd, answer.data(), answer.size(), MSG_NOSIGNAL) !=
                         static_cast<ssize_t>(answer.size());
        }
        if (!peer.is_over) continue;
        ::close(one.fd);
        peers.erase(one.fd);
      }
    }
  }
  const std::string path_;
  const Answering answering_;
  int listener_ = -1;
  std::uint16_t port_ = 0;
  pid_t child_ = 0;
};

struct Kind {
  Answering answering;
  std::function<Sink(Loop&, std::uint16_t port)> make;
};
const SendingConfig sending{.window = 4, .parcel_rows = 20, .timeout = 300ms};
const SinkConfig sink_config{
    .name = "peer", .batch_time = 5ms, .retry_first = 5ms, .retry_longest = 50ms, .through = "recording"};

/// A run of the program; ends when it is killed, or when all is sent.
void send(const std::string& path, const Kind& kind, std::uint16_t port, bool is_last) {
  Loop loop;
  loop.on_error([](const ErrorReport&) {});
  loop.runtime().on_log([](const LogRecord&) {});
  SqliteSink recording(loop, {.path = path, .sink = {.name = "recording", .batch_time = 5ms}});
  const Sink sink = kind.make(loop, port);
  std::int64_t published = 0;
  Sensor<Pulse> sensor;
  if (!is_last) {
    sensor = Sensor<Pulse>(loop, {.name = "pulse", .topic = "plant/pulse", .rate = 2_kHz},
                           [&] { return Pulse{++published}; });
  }
  Ticker look(loop, {.period = 20ms}, [&](const Tick&) {
    if (is_last && sink.status().backlog && sink.counts().queued == 0) loop.stop();
  });
  Timer limit(loop, [&] { loop.stop(); });
  limit.start(30s);
  loop.run();
  sensor.close();
  loop.close(5s);
}

std::string text_after(const std::string& line, std::string_view name) {
  const std::size_t at = line.find(name);
  REQUIRE(at != std::string::npos);
  const std::size_t begin = at + name.size();
  return line.substr(begin, line.find_first_of("\",}", begin) - begin);
}

void kill_at_random(const Kind& kind) {
  recordings::Folder folder;
  const std::string path = folder / "run.db", received = folder / "received.jsonl";
  Receiver receiver(received, kind.answering);
  const char* const wanted = std::getenv("RTDATA_TEST_SEEDS");  // "FIRST COUNT", to look for more
  char* rest = nullptr;
  const unsigned long first = wanted != nullptr ? std::strtoul(wanted, &rest, 10) : 1;
  const unsigned long count = wanted != nullptr ? std::strtoul(rest, nullptr, 10) : 6;
  // On a slow machine none of so many may live until its first rows are stored: then more follow, which live longer.
  const auto has_rows = [&] {
    const auto recording = Recording::open(path);
    return recording && !recording->topics().or_throw().empty();
  };
  useconds_t longer = 0;
  for (unsigned long seed = first; seed < first + count || (longer < 20'000'000 && !has_rows()); ++seed) {
    CAPTURE(seed);
    if (seed >= first + count) longer = 2 * longer + 100'000;
    std::mt19937 random(static_cast<unsigned>(seed));
    receiver.start(static_cast<unsigned>(seed));
    const pid_t child = fork_without_threads();
    if (child == 0) {
      send(path, kind, receiver.port(), false);
      ::_exit(0);
    }
    const auto wait = [&] { ::usleep(longer + static_cast<useconds_t>(20000 + random() % 200000)); };  // what is tried
    wait();
    if (random() % 4 == 0) {
      receiver.kill();
      wait();
      if (random() % 2 == 0) receiver.start(static_cast<unsigned>(seed));
    }
    ::kill(child, SIGKILL);
    REQUIRE(::waitpid(child, nullptr, 0) == child);
    receiver.kill();
  }
  receiver.start(0);
  // A run that a slow machine does not let finish is followed by another one; what counts is what the file says waits.
  std::uint64_t waiting = 1;
  for (int runs = 0; runs < 10 && waiting > 0; ++runs) {
    const pid_t last = fork_without_threads();
    if (last == 0) {
      send(path, kind, receiver.port(), true);
      ::_exit(0);
    }
    int status = 0;
    REQUIRE(::waitpid(last, &status, 0) == last);
    REQUIRE(WIFEXITED(status));
    const auto backlogs = Recording::open(path).value().backlogs();
    REQUIRE(backlogs);
    REQUIRE(backlogs->size() == 1);
    waiting = backlogs->front().events;
  }
  CHECK(waiting == 0);
  receiver.kill();

  using Key = std::tuple<std::string, std::string, std::string>;
  std::map<Key, std::string> events;
  std::size_t lines = 0, halves = 0;
  std::ifstream file(received);
  for (std::string line; std::getline(file, line); ++lines) {
    if (line.empty() || line.back() != '}') {  // the receiver was killed while it kept it
      ++halves;
      continue;
    }
    const Key key{text_after(line, "\"run\":\""), text_after(line, "\"origin\":\""), text_after(line, "\"sequence\":")};
    const auto [known, is_new] = events.try_emplace(key, text_after(line, "\"count\":"));
    if (!is_new) CHECK(known->second == text_after(line, "\"count\":"));
  }
  const auto recorded = static_cast<std::size_t>(recordings::number(path, "SELECT count(*) FROM \"plant/pulse\""));
  MESSAGE(recorded << " events, of which " << lines - halves - events.size() << " came again");
  CHECK(events.size() == recorded);
  CHECK(recorded > 0);
  CHECK(recordings::number(path, "SELECT count(*) FROM rtdata_refused") == 0);
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("NFR-1 killed at random moments while it sends by TCP: no event is missing") {
    kill_at_random({answer_line, [](Loop& loop, std::uint16_t port) -> Sink {
                      return TcpSink(loop, {.host = "127.0.0.1",
                                            .port = port,
                                            .acknowledge = Acknowledge::line,
                                            .sending = sending,
                                            .sink = sink_config});
                    }});
  }

#ifdef RTDATA_WITH_HTTP
  TEST_CASE("NFR-1 killed at random moments while it sends by HTTP: no event is missing") {
    kill_at_random({answer_request, [](Loop& loop, std::uint16_t port) -> Sink {
                      return HttpSink(loop, {.server = {.url = "http://127.0.0.1:" + std::to_string(port) + "/"},
                                             .format = "jsonl",
                                             .sending = sending,
                                             .sink = sink_config});
                    }});
  }
#endif

#ifdef RTDATA_WITH_MQTT
  TEST_CASE("NFR-1 killed at random moments while it sends by MQTT: no event is missing") {
    kill_at_random({answer_packet, [](Loop& loop, std::uint16_t port) -> Sink {
                      MqttConfig config;
                      config.broker.host = "127.0.0.1";
                      config.broker.port = port;
                      config.qos = 1;
                      config.broker.connect_timeout = 1s;
                      config.sending = sending;
                      config.sink = sink_config;
                      return MqttSink(loop, config);
                    }});
  }
#endif
}
