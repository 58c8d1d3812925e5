// forward_rows, catch_up: what sending through a recording costs, and how fast what waits there goes out.
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#ifdef RTDATA_BENCH_SQLITE
#include <sqlite3.h>

#include "rtdata/recording/sqlite.hpp"
#endif

#include "bare.hpp"
#include "harness.hpp"
#include "payloads.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/sender.hpp"

namespace bench {
namespace {

#ifdef RTDATA_BENCH_SQLITE

/// The bytes of the payloads, to a socket of this machine, or to nowhere.
class BytesSender final : public rtdata::Sender {
 public:
  explicit BytesSender(int socket) : socket_(socket) {}
  rtdata::SendingConfig sending() const override { return {.window = 8, .parcel_rows = 100}; }
  rtdata::Result<void> encode(const rtdata::Record& record, std::vector<std::byte>& out) override {
    out.insert(out.end(), record.payload.begin(), record.payload.end());
    return {};
  }
  void begin(rtdata::Loop&) override {}
  void send(const rtdata::Parcel& parcel, rtdata::Answer answer) override {
    const auto bytes = parcel.bytes();
    if (socket_ >= 0 && ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL) < 0)
      return answer.again(rtdata::system_error(errno, "cannot send", "socket"), std::chrono::milliseconds{1});
    answer.acknowledge();
  }
  void cancel() override {}

 private:
  int socket_;
};

constexpr std::int64_t waiting_rows = 200'000;
constexpr std::int64_t many_rows = 1'000'000;

/// A recording with so many rows of eight numbers.
void record(const std::string& path, std::int64_t rows) {
  rtdata::Loop loop;
  rtdata::SqliteSink recording(loop,
                               {.path = path, .sink = {.name = "recording", .queue_bytes = std::size_t{1} << 30}});
  rtdata::Feed<Eight> feed(loop, {.name = "chamber", .topic = "test/climate"});
  std::int64_t left = rows;
  rtdata::Ticker ticker(loop, std::chrono::milliseconds{1}, [&](const rtdata::Tick&) {
    for (int i = 0; i < 2000 && left > 0; ++i, --left) feed.publish(reading(static_cast<unsigned>(left)));
    if (left == 0) loop.stop();
  });
  loop.run();
  ticker.close();
  loop.close(std::chrono::minutes{1});
}

std::string copy_of(const Scratch& recording, const Scratch& to) {
  std::string command = "cp '" + recording.path() + "' '" + to.path() + "'";
  if (std::system(command.c_str()) != 0) std::abort();
  return to.path();
}

struct Sent {
  double seconds = 0;
  double cpu_ns = 0;  // a row
};

/// Sends all that waits; `hertz`: what is recorded meanwhile.
Sent send_all(const std::string& path, std::int64_t rows, int socket, int hertz) {
  rtdata::Loop loop;
  rtdata::SqliteSink recording(loop, {.path = path, .sink = {.name = "recording"}});
  rtdata::Feed<Eight> feed(loop, {.name = "chamber", .topic = "test/climate"});
  const std::int64_t begin = monotonic_ns(), cpu = process_cpu_ns();
  rtdata::Sink sink(loop, {.name = "peer", .batch_rows = 2000, .through = "recording", .from = rtdata::From::beginning},
                    std::make_unique<BytesSender>(socket));
  Sent sent;
  unsigned n = 0;
  rtdata::Ticker recorded(loop, std::chrono::nanoseconds{1'000'000'000 / (hertz == 0 ? 1 : hertz)},
                          [&](const rtdata::Tick&) {
                            if (hertz != 0) feed.publish(reading(++n));
                          });
  rtdata::Ticker look(loop, std::chrono::milliseconds{2}, [&](const rtdata::Tick&) {
    if (sink.counts().stored < static_cast<std::uint64_t>(rows)) return;
    sent.seconds = static_cast<double>(monotonic_ns() - begin) / 1e9;
    sent.cpu_ns = static_cast<double>(process_cpu_ns() - cpu) / static_cast<double>(rows);
    loop.stop();
  });
  loop.run();
  look.close();
  recorded.close();
  loop.close(std::chrono::seconds{10});
  return sent;
}

/// Every row by ranges of its number, into a buffer, as one who has no more to do would write it.
double select_by_hand(const std::string& path) {
  sqlite3* database = nullptr;
  sqlite3_open_v2(path.c_str(), &database, SQLITE_OPEN_READONLY, nullptr);
  sqlite3_stmt* query = nullptr;
  sqlite3_prepare_v2(database, "SELECT * FROM \"test/climate\" WHERE rowid > ? ORDER BY rowid LIMIT 2000", -1, &query,
                     nullptr);
  std::vector<std::byte> buffer(2000 * 128);
  const std::int64_t begin = process_cpu_ns();
  for (std::int64_t row = 0; row < waiting_rows; row += 2000) {
    sqlite3_bind_int64(query, 1, row);
    std::byte* to = buffer.data();
    while (sqlite3_step(query) == SQLITE_ROW) {
      const std::int64_t time = sqlite3_column_int64(query, 1);
      const std::int64_t sequence = sqlite3_column_int64(query, 3);
      keep(sqlite3_column_text(query, 2));
      std::memcpy(to, &time, 8);
      std::memcpy(to + 8, &sequence, 8);
      for (int column = 0; column < 8; ++column) {
        const double value = sqlite3_column_double(query, 4 + column);
        std::memcpy(to + 16 + 8 * column, &value, 8);
      }
      to += 80;
    }
    sqlite3_reset(query);
    keep(buffer[0]);
  }
  const double cpu = static_cast<double>(process_cpu_ns() - begin) / waiting_rows;
  sqlite3_finalize(query);
  sqlite3_close(database);
  return cpu;
}

/// Reads what comes, until the other side closes.
class Receiver {
 public:
  Receiver() {
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends_) != 0) std::abort();
    const int size = 1 << 20;
    ::setsockopt(ends_[0], SOL_SOCKET, SO_SNDBUF, &size, sizeof size);
    thread_ = std::thread([fd = ends_[1]] {
      settle_other_thread();
      std::vector<char> buffer(1 << 18);
      while (::recv(fd, buffer.data(), buffer.size(), 0) > 0) {
      }
    });
  }
  ~Receiver() {
    ::shutdown(ends_[0], SHUT_RDWR);
    thread_.join();
    ::close(ends_[0]);
    ::close(ends_[1]);
  }
  int socket() const { return ends_[0]; }

 private:
  int ends_[2] = {-1, -1};
  std::thread thread_;
};

}  // namespace

void bench_sending(Report& report) {
  const std::string& folder = report.options().memory;
  if (report.wants("forward_rows")) {
    const Scratch made(folder, "waiting.db"), copy(folder, "sent.db");
    record(made.path(), waiting_rows);
    report.add(measure_pair(
        {.name = "forward_rows", .unit = "ns/row", .reach = 1.5},
        [&] { return send_all(copy_of(made, copy), waiting_rows, -1, 0).cpu_ns; },
        [&] { return select_by_hand(made.path()); }, 7));
  }
  if (report.wants("catch_up")) {
    const Scratch made(folder, "waiting.db"), copy(folder, "sent.db");
    record(made.path(), many_rows);
    const auto seconds = [&](int hertz) {
      const Receiver receiver;
      return send_all(copy_of(made, copy), many_rows, receiver.socket(), hertz).seconds;
    };
    report.add(measure_pair(
        {.name = "catch_up", .unit = "s", .reach = 1.25}, [&] { return seconds(1000); }, [&] { return seconds(0); },
        5));
  }
}

#else
}  // namespace

void bench_sending(Report& report) {
  if (report.wants("forward_rows") || report.wants("catch_up"))
    report.remark("forward_rows, catch_up: left out, this was built without SQLite");
}

#endif

}  // namespace bench
