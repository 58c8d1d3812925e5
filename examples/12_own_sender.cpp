// A sender of one's own: lines of JSON as datagrams to a port of this machine, through a recording, so that what is not
// sent waits there. Listen with `nc -kul 9870`, then: 12_own_sender 9870
#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <iostream>

#include "rtdata/data/codec.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sinks/sender.hpp"

using namespace std::chrono_literals;

class Datagrams final : public rtdata::Sender {
 public:
  explicit Datagrams(std::uint16_t port) { peer_.sin_port = htons(port); }
  rtdata::SendingConfig sending() const override { return {.window = 1, .parcel_rows = 1}; }
  rtdata::Result<void> encode(const rtdata::Record& record, std::vector<std::byte>& out) override {
    return json_->encode(record.keyed_view(), out);  // on the sink's own thread
  }
  void begin(rtdata::Loop&) override { socket_ = ::socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0); }
  void send(const rtdata::Parcel& parcel, rtdata::Answer answer) override {
    const auto bytes = parcel.bytes();
    const auto* to = reinterpret_cast<const sockaddr*>(&peer_);
    if (::sendto(socket_, bytes.data(), bytes.size(), 0, to, sizeof peer_) >= 0) return answer.acknowledge();
    answer.again(rtdata::system_error(errno, "cannot send", "port " + std::to_string(ntohs(peer_.sin_port))));
  }
  void cancel() override {}
  void end() override { ::close(socket_); }

 private:
  std::unique_ptr<rtdata::Codec> json_ = rtdata::make_json_codec();
  sockaddr_in peer_{AF_INET, 0, {htonl(INADDR_LOOPBACK)}, {}};
  int socket_ = -1;
};

struct Count {
  std::int64_t count = 0;
  RTDATA_FIELDS(Count, (count, "1"))
};

int main(int argc, char** argv) {
  const auto port = static_cast<std::uint16_t>(argc > 1 ? std::atoi(argv[1]) : 9870);
  rtdata::Loop loop;
  rtdata::SqliteSink recording(loop, {.path = "own_sender.db", .sink = {.name = "recording"}});
  rtdata::Sink sender(loop, {.name = "datagrams", .batch_time = 100ms, .through = "recording"},
                      std::make_unique<Datagrams>(port));
  std::int64_t count = 0;
  rtdata::Ticker ticker(loop, {.period = 10ms},
                        [&](const rtdata::Tick&) { loop.topic<Count>("counter").publish({++count}); });
  loop.run_for(1s);
  ticker.close();
  loop.close(5s);
  std::cout << "sent " << loop.runtime().sinks().front().counts.stored << " of " << count << "\n";
}
