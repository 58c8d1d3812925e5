// tcp_rows, mqtt_msgs: what it costs to send an event to a receiver on this machine.
#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <cstring>
#include <ctime>
#include <string>
#include <vector>

#include "harness.hpp"
#include "payloads.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/tcp.hpp"
#ifdef RTDATA_BENCH_MQTT
#include <mosquitto.h>

#include "rtdata/sinks/mqtt.hpp"
#endif

namespace bench {
namespace {

constexpr unsigned batch_rows = 512;
constexpr rtdata::Duration batch_period = std::chrono::milliseconds{1};

sockaddr_in at_port(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(port);
  return address;
}

/// Listens at a port that was free; its number.
int listen_anywhere(std::uint16_t& port) {
  const int listener = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address = at_port(0);
  socklen_t size = sizeof address;
  if (::bind(listener, reinterpret_cast<sockaddr*>(&address), size) != 0 || ::listen(listener, 4) != 0) return -1;
  ::getsockname(listener, reinterpret_cast<sockaddr*>(&address), &size);
  port = ntohs(address.sin_port);
  return listener;
}

/// Another process, whose time does not count: reads whatever comes.
class Reader {
 public:
  Reader() {
    const int listener = listen_anywhere(port_);
    process_ = ::fork();
    if (process_ == 0) {
      settle_other_thread();
      static char bytes[1 << 20];
      for (;;) {
        const int peer = ::accept(listener, nullptr, nullptr);
        while (::read(peer, bytes, sizeof bytes) > 0) {
        }
        ::close(peer);
      }
    }
    ::close(listener);
  }
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  ~Reader() {
    ::kill(process_, SIGKILL);
    ::waitpid(process_, nullptr, 0);
  }
  std::uint16_t port() const { return port_; }

 private:
  std::uint16_t port_ = 0;
  pid_t process_ = -1;
};

/// Publishes a batch every millisecond, until all is stored. Process CPU time an event.
template <class MakeSink>
double sent_cpu(unsigned batches, MakeSink make_sink) {
  rtdata::Loop loop;
  rtdata::Feed<Eight> feed(loop, {.name = "chamber", .topic = "test/climate"});
  auto sink = make_sink(loop);
  const std::uint64_t rows = std::uint64_t{batches} * batch_rows;
  // The connection is not measured.
  feed.publish(reading(0));
  sink.flush();
  unsigned left = batches;
  std::int64_t begin = 0;
  rtdata::Ticker ticker(loop, batch_period, [&](const rtdata::Tick&) {
    if (sink.counts().stored == 0) return;
    if (begin == 0) begin = process_cpu_ns();
    if (left == 0) {
      if (sink.counts().stored == rows + 1) loop.stop();
      return;
    }
    --left;
    for (unsigned i = 0; i < batch_rows; ++i) feed.publish(reading(i));
    if (left == 0) sink.flush();
  });
  loop.run();
  return static_cast<double>(process_cpu_ns() - begin) / static_cast<double>(rows);
}

class Rhythm {
 public:
  void wait() {
    due_ += std::chrono::nanoseconds{batch_period}.count();
    const timespec until{due_ / 1'000'000'000, static_cast<long>(due_ % 1'000'000'000)};
    ::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr);
  }

 private:
  std::int64_t due_ = monotonic_ns();
};

/// The events of a batch as this codec writes them.
std::vector<std::vector<std::byte>> encoded(rtdata::Codec& codec) {
  std::vector<std::vector<std::byte>> all(batch_rows);
  for (unsigned i = 0; i < batch_rows; ++i) {
    const rtdata::Event<Eight> event{{rtdata::from_nanoseconds(1'772'366'400'000'000'000 + 8000 * i), i + 1, "chamber"},
                                     reading(i)};
    const rtdata::EventView plain("test/climate", event);
    codec
        .encode(rtdata::EventView("test/climate", event, plain.description(), plain.payload(),
                                  "123e4567-e89b-12d3-a456-426614174000"),
                all[i])
        .or_throw();
  }
  return all;
}

/// Each record copied into a buffer, which is written when it has 64.
double bare_tcp(std::uint16_t port, unsigned batches) {
  const auto codec = rtdata::make_raw_codec();
  const auto records = encoded(*codec);
  const int fd = ::socket(AF_INET, SOCK_STREAM, 0);
  const sockaddr_in address = at_port(port);
  if (::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) return 0;
  std::vector<std::byte> buffer(64 * 512);
  Rhythm rhythm;
  const std::int64_t begin = process_cpu_ns();
  for (unsigned batch = 0; batch < batches; ++batch) {
    rhythm.wait();
    std::size_t size = 0, count = 0;
    for (const auto& record : records) {
      std::memcpy(buffer.data() + size, record.data(), record.size());
      size += record.size();
      if (++count % 64 != 0) continue;
      for (std::size_t done = 0; done < size;) {
        const ssize_t written = ::send(fd, buffer.data() + done, size - done, MSG_NOSIGNAL);
        if (written <= 0) return 0;
        done += static_cast<std::size_t>(written);
      }
      size = 0;
    }
  }
  const std::int64_t end = process_cpu_ns();
  ::close(fd);
  return static_cast<double>(end - begin) / (static_cast<double>(batches) * batch_rows);
}

void bench_tcp(Report& report) {
  if (!report.wants("tcp_rows")) return;
  const Reader reader;
  constexpr unsigned batches = 200;
  report.add(measure_pair(
      {.name = "tcp_rows", .unit = "ns/row", .reach = 1.5},
      [&] {
        return sent_cpu(batches, [&](rtdata::Loop& loop) {
          return rtdata::TcpSink(loop, {.host = "127.0.0.1", .port = reader.port(), .format = "raw"});
        });
      },
      [&] { return bare_tcp(reader.port(), batches); }, 9));
}

#ifdef RTDATA_BENCH_MQTT

class Broker {
 public:
  Broker() {
    const int listener = listen_anywhere(port_);
    ::close(listener);
    process_ = ::fork();
    if (process_ == 0) {
      settle_other_thread();
      if (std::freopen("/dev/null", "w", stderr) == nullptr) ::_exit(1);
      ::execl("/usr/sbin/mosquitto", "mosquitto", "-p", std::to_string(port_).c_str(), static_cast<char*>(nullptr));
      ::_exit(127);
    }
    const sockaddr_in address = at_port(port_);
    for (int i = 0; i < 500 && !is_there_; ++i) {
      ::usleep(10'000);
      const int fd = ::socket(AF_INET, SOCK_STREAM, 0);
      is_there_ = ::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
      ::close(fd);
    }
  }
  Broker(const Broker&) = delete;
  Broker& operator=(const Broker&) = delete;
  ~Broker() {
    ::kill(process_, SIGKILL);
    ::waitpid(process_, nullptr, 0);
  }
  bool is_there() const { return is_there_; }
  std::uint16_t port() const { return port_; }

 private:
  std::uint16_t port_ = 0;
  pid_t process_ = -1;
  bool is_there_ = false;
};

/// The library alone, with payloads that were made before.
double bare_mqtt(std::uint16_t port, unsigned batches, int qos) {
  struct State {
    unsigned published = 0;
    bool is_connected = false;
  } state;
  const auto codec = rtdata::make_json_codec();
  const auto payloads = encoded(*codec);
  mosquitto* const client = ::mosquitto_new(nullptr, true, &state);
  ::mosquitto_int_option(client, MOSQ_OPT_PROTOCOL_VERSION, MQTT_PROTOCOL_V5);
  ::mosquitto_int_option(client, MOSQ_OPT_TCP_NODELAY, 1);
  ::mosquitto_int_option(client, MOSQ_OPT_SEND_MAXIMUM, 1000);
  ::mosquitto_connect_callback_set(
      client, [](mosquitto*, void* to, int reason) { static_cast<State*>(to)->is_connected = reason == 0; });
  ::mosquitto_publish_callback_set(client, [](mosquitto*, void* to, int) { ++static_cast<State*>(to)->published; });
  if (::mosquitto_connect(client, "127.0.0.1", port, 60) != MOSQ_ERR_SUCCESS) return 0;
  while (!state.is_connected)
    if (::mosquitto_loop(client, 100, 1) != MOSQ_ERR_SUCCESS) return 0;
  const unsigned rows = batches * batch_rows;
  const std::int64_t begin = process_cpu_ns();
  unsigned sent = 0;
  while (state.published < rows) {
    while (sent < rows && sent - state.published < 400) {
      const auto& payload = payloads[sent++ % batch_rows];
      ::mosquitto_publish_v5(client, nullptr, "test/climate", static_cast<int>(payload.size()) - 1, payload.data(), qos,
                             false, nullptr);
    }
    if (::mosquitto_loop(client, 100, 1) != MOSQ_ERR_SUCCESS) return 0;
  }
  const std::int64_t end = process_cpu_ns();
  ::mosquitto_destroy(client);
  return static_cast<double>(end - begin) / rows;
}

void bench_mqtt(Report& report) {
  if (!report.wants("mqtt_msgs")) return;
  const Broker broker;
  if (!broker.is_there()) return report.remark("mqtt_msgs: left out, there is no mosquitto");
  ::mosquitto_lib_init();
  constexpr unsigned batches = 20;
  const auto figure = [&](std::uint8_t qos) {
    return measure_pair(
        {.name = "mqtt_msgs", .unit = "ns/message", .reach = 1.15},
        [&] {
          return sent_cpu(batches, [&](rtdata::Loop& loop) {
            return rtdata::MqttSink(loop, {.broker = {.host = "127.0.0.1", .port = broker.port()}, .qos = qos});
          });
        },
        [&] { return bare_mqtt(broker.port(), batches, qos); }, 9);
  };
  report.add(figure(1));
  const Figure at_most_once = figure(0);
  report.remark("QoS 0: " + std::to_string(at_most_once.value) + " against " + std::to_string(at_most_once.limit) +
                " ns/message, ratio " + std::to_string(at_most_once.ratio));
}

#else

void bench_mqtt(Report& report) {
  if (report.wants("mqtt_msgs")) report.remark("mqtt_msgs: left out, this was built without libmosquitto");
}

#endif

}  // namespace

void bench_network(Report& report) {
  bench_tcp(report);
  bench_mqtt(report);
}

}  // namespace bench
