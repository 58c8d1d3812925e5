// What it costs to look at a run.
// subscribe_events: CPU of an event to one reader, raw, beside a handler that formats by hand and writes 64 at a time.
// page_cost: CPU of a program that records 8 sensors of 1 kHz and 8 fields, with one page open, beside none.
// page_ticks: the ticks it misses with 32 readers, half of them stopped in turns, beside none.
// history: time to what a page first shows of a day at 100 Hz, beside one read of 1000 of its steps by SQL.
#include "harness.hpp"

#ifdef RTDATA_BENCH_PAGE
#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <signal.h>
#include <sqlite3.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <memory>
#include <stdexcept>

#include "app/control/control_socket.hpp"
#include "app/control/readers.hpp"
#include "app/page/page_history.hpp"
#include "by_hand.hpp"
#include "child.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/feed.hpp"
#endif

namespace bench {

#ifdef RTDATA_BENCH_PAGE
namespace {

using namespace rtdata;

constexpr const char* token = "0123456789abcdef0123456789abcdef";
constexpr std::uint16_t port = 18437;

// ---- subscribe_events

/// Reads this many lines.
void read_lines(int fd, std::size_t lines) {
  std::array<char, 64 << 10> buffer;
  while (lines > 0) {
    pollfd ready{fd, POLLIN, 0};
    if (::poll(&ready, 1, 10'000) != 1) throw std::runtime_error("subscribe_events: nothing comes");
    const ssize_t size = ::read(fd, buffer.data(), buffer.size());
    if (size <= 0) throw std::runtime_error("subscribe_events: the reader is disconnected");
    lines -= std::min(lines, static_cast<std::size_t>(std::count(buffer.data(), buffer.data() + size, '\n')));
  }
}

constexpr unsigned events_a_round = 512, rounds = 100;

struct Pair {
  Pair() {
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, ends.data()) != 0)
      throw std::runtime_error("subscribe_events: no socket");
  }
  ~Pair() { ::close(ends[0]); }
  Pair(const Pair&) = delete;
  Pair& operator=(const Pair&) = delete;
  std::array<int, 2> ends{};
};

/// CPU ns of each event, publishing and reading too.
template <class Publish>
double cost_of_events(int fd, const Publish& publish) {
  const std::int64_t begin = process_cpu_ns();
  for (unsigned round = 0; round < rounds; ++round) {
    publish(round);
    read_lines(fd, events_a_round);
  }
  return static_cast<double>(process_cpu_ns() - begin) / (rounds * events_a_round);
}

double cost_of_reader() {
  Loop loop;
  auto topic = loop.topic<Eight>("test/climate");
  app::Readers readers(loop, "0-0");
  readers.set({.most = 1, .recordings = {}});
  const Pair pair;
  readers.add(pair.ends[1], app::StreamRequest{});
  loop.run_for(std::chrono::milliseconds{50});
  topic.publish(reading(0));
  read_lines(pair.ends[0], 3);  // the answer, the units, the event
  return cost_of_events(pair.ends[0], [&](unsigned round) {
    for (unsigned i = 0; i < events_a_round; ++i) topic.publish(reading(round * events_a_round + i));
    loop.poll();
  });
}

double cost_by_hand() {
  Loop loop;
  auto topic = loop.topic<Eight>("test/climate");
  Pair pair;
  constexpr unsigned batch = 64;
  std::vector<char> text(batch * 1024);
  char* end = text.data();
  unsigned waiting = 0;
  const Subscription handler = topic.subscribe(loop, [&](const Event<Eight>& event) {
    end = json_by_hand(end, to_nanoseconds(event.time), event.sequence, *event);
    if (++waiting < batch) return;
    if (::write(pair.ends[1], text.data(), static_cast<std::size_t>(end - text.data())) != end - text.data())
      throw std::runtime_error("subscribe_events: cannot write");
    end = text.data();
    waiting = 0;
  });
  const double cost = cost_of_events(pair.ends[0], [&](unsigned round) {
    for (unsigned i = 0; i < events_a_round; ++i) {
      topic.publish(reading(round * events_a_round + i));
      if (i % batch == batch - 1) loop.poll();
    }
  });
  ::close(pair.ends[1]);
  return cost;
}

void bench_subscribe_events(Report& report) {
  unsettle_thread();  // the readers have a thread of their own
  report.add(measure_pair({.name = "subscribe_events", .unit = "CPU ns/event", .reach = 1.5}, cost_of_reader,
                          cost_by_hand, 7));
  settle_thread();
}

// ---- of a whole program

constexpr int seconds_of_run = 4;

void write_configuration() {
  std::ofstream file("eight.json");
  file << R"({"name": "eight", "page": {"listen": "127.0.0.1:)" << port << R"(", "token": ")" << token
       << R"("}, "sensors": [)";
  for (int i = 0; i < 8; ++i)
    file << (i == 0 ? "" : ", ") << R"({"name": "s)" << i << R"(", "type": "eight", "rate": "1 kHz"})";
  file << R"(], "sinks": [{"type": "sqlite", "path": "eight.db"}]})";
}

void pause(int ms) {
  const timespec time{ms / 1000, ms % 1000 * 1'000'000L};
  ::nanosleep(&time, nullptr);
}

pid_t start_run() {
  for (const char* file : {"eight.db", "eight.db-wal", "eight.db-shm"}) ::unlink(file);
  return start({beside("rtdata_bench_program"), "run", "eight.json", "--for", std::to_string(seconds_of_run) + "s"});
}

/// An open page's stream; -1: there is none.
int open_page() {
  const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const std::string request = "GET /events HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port) +
                              "\r\nAuthorization: Bearer " + token + "\r\n\r\n";
  for (int tries = 0; tries < 100; ++tries) {
    if (::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) {
      if (::write(fd, request.data(), request.size()) == static_cast<ssize_t>(request.size())) return fd;
      break;
    }
    pause(20);
  }
  ::close(fd);
  return -1;
}

/// Reads until the other side ends; the bytes.
std::size_t read_all(int fd) {
  std::array<char, 64 << 10> buffer;
  std::size_t all = 0;
  for (ssize_t size = 0; (size = ::read(fd, buffer.data(), buffer.size())) > 0;) all += static_cast<std::size_t>(size);
  ::close(fd);
  return all;
}

void bench_page_cost(Report& report) {
  write_configuration();
  bool is_shown = true;
  const auto figure = measure_pair(
      {.name = "page_cost", .unit = "CPU s", .reach = 1.1},
      [&] {
        const pid_t child = start_run();
        const int page = open_page();
        is_shown = is_shown && page >= 0 && read_all(page) > 10'000;
        return cpu_seconds(child);
      },
      [&] { return cpu_seconds(start_run()); }, 5);
  is_shown ? report.add(figure) : report.remark("page_cost: left out, the page gave nothing");
}

/// Ticks that were missed, and rows that a sink lost.
struct Lost {
  double missed = 0, dropped = 0;
};
Lost lost_in_recording() {
  Lost lost;
  const Recording recording = Recording::open("eight.db").or_throw();
  for (const LedgerEntry& entry : recording.ledger(1).or_throw()) {
    lost.missed += static_cast<double>(entry.sensor.missed);
    lost.dropped += static_cast<double>(entry.dropped());
  }
  return lost;
}

void bench_page_ticks(Report& report) {
  write_configuration();
  ::setenv("RTDATA_RUNTIME_DIR", ".", 1);
  constexpr std::size_t most = 32;
  double dropped = 0;
  const auto with_readers = [&] {
    const pid_t child = start_run();
    std::vector<app::ControlClient> readers;
    for (int tries = 0; tries < 100 && readers.empty(); ++tries) {
      pause(20);
      const auto instances = app::running_instances();
      if (instances.empty()) continue;
      while (readers.size() < most) {
        auto client = app::ControlClient::connect(instances[0].path);
        if (!client) break;
        client->send(R"({"request":"subscribe"})");
        readers.push_back(*std::move(client));
      }
    }
    const std::int64_t end = monotonic_ns() + (seconds_of_run - 1) * std::int64_t{1'000'000'000};
    // Each half of a second, the other half of them reads.
    for (std::size_t turn = 0; monotonic_ns() < end; ++turn) {
      const std::int64_t end_of_turn = monotonic_ns() + 500'000'000;
      while (monotonic_ns() < end_of_turn)
        for (std::size_t i = turn % 2; i < readers.size(); i += 2) (void)readers[i].receive(Duration{0});
    }
    (void)cpu_seconds(child);
    const Lost lost = lost_in_recording();
    dropped += lost.dropped;
    if (readers.size() != most) dropped = -1;
    return lost.missed + 1;
  };
  const auto without = [&] {
    (void)cpu_seconds(start_run());
    return lost_in_recording().missed + 1;
  };
  const Figure figure = measure_pair({.name = "page_ticks", .unit = "ticks missed, and 1", .reach = 1.1}, with_readers,
                                     without, 3);
  if (dropped < 0) return report.remark("page_ticks: left out, there were no 32 readers");
  report.add(figure);
  report.remark("page_ticks: " + std::to_string(static_cast<long>(dropped)) + " rows lost");
}

// ---- history

void bench_history(Report& report) {
  constexpr std::int64_t start_ns = 1'700'000'000'000'000'000;  // where a manual loop's time of day begins
  constexpr std::int64_t period_ns = 10'000'000;
  constexpr int rows = 8'640'000;
  {
    Loop loop{Loop::Manual{}};
    const SqliteSink sink(loop, {.path = "day.db"});
    Feed<Eight> feed(loop, {.name = "board", .topic = "board"});
    for (int i = 0; i < rows; ++i) {
      feed.publish(reading(static_cast<unsigned>(i)), Time{Duration{start_ns + i * period_ns}});
      if (i % 1000 == 999) loop.advance(Duration{1000 * period_ns});
    }
    feed.close();
    loop.close();
  }
  const std::int64_t from = start_ns / 1'000'000, until = from + 86'400'000;
  const std::string request = R"({"topics":{"board":["a"]},"from":)" + std::to_string(from) + R"(,"until":)" +
                              std::to_string(until) + R"(,"step":60000})";
  const std::vector<app::PageRecording> recordings{{"day", "day.db"}};
  report.add(measure_pair(
      {.name = "history", .unit = "ms", .reach = 3},
      [&] {
        const std::int64_t begin = monotonic_ns();
        const std::string answer = app::page_history(recordings, 1, request);
        if (answer.find("\"mean\":[") == std::string::npos || answer.size() < 50'000)
          throw std::runtime_error("history: " + answer.substr(0, 200));
        return static_cast<double>(monotonic_ns() - begin) / 1e6;
      },
      [&] {
        const std::int64_t begin = monotonic_ns();
        sqlite3* database = nullptr;
        sqlite3_open_v2("day.db", &database, SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX, nullptr);
        sqlite3_stmt* statement = nullptr;
        sqlite3_prepare_v2(
            database,
            "SELECT time, \"a.min\", \"a.max\", \"a.sum\" / \"a.count\" FROM \"board~1min\" WHERE run = 1 "
            "AND origin = 'board' ORDER BY time LIMIT 1000",
            -1, &statement, nullptr);
        double sum = 0;
        int count = 0;
        for (; sqlite3_step(statement) == SQLITE_ROW; ++count) sum += sqlite3_column_double(statement, 3);
        keep(sum);
        sqlite3_finalize(statement);
        sqlite3_close(database);
        if (count != 1000) throw std::runtime_error("history: " + std::to_string(count) + " steps");
        return static_cast<double>(monotonic_ns() - begin) / 1e6;
      },
      9));
}

}  // namespace

void bench_page(Report& report) {
  if (report.wants("subscribe_events")) bench_subscribe_events(report);
  if (!report.wants("page_cost") && !report.wants("page_ticks") && !report.wants("history")) return;
  const Folder folder(report.options().memory);
  if (report.wants("page_cost")) bench_page_cost(report);
  if (report.wants("page_ticks")) bench_page_ticks(report);
  if (report.wants("history")) bench_history(report);
}
#else
void bench_page(Report&) {}
#endif

}  // namespace bench
