#include "rtdata/sinks/udp.hpp"

#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "net/host_lookup.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/loop/watch.hpp"
#include "sinks/core/peer_config.hpp"

namespace rtdata {
namespace {

using detail::HostLookup;

constexpr const char* cannot_make_udp = "cannot make udp sink";
constexpr const char* fields_format = "fields";
constexpr std::size_t most_at_once = 64;
constexpr Duration name_age = std::chrono::seconds{60};  // then the name is looked up again

/// {"timestamp":seconds,"topic":{fields,"origin":...,"sequence":...}}: the texts are those of the JSON codec.
class FieldsCodec final : public Codec {
 public:
  std::string_view name() const noexcept override { return fields_format; }
  bool is_text() const noexcept override { return true; }

  Result<void> encode(const EventView& event, std::vector<std::byte>& out) override {
    line_.clear();
    if (event.topic() == "timestamp")
      return Error{Errc::bad_name, "cannot send", "topic timestamp", "that key is used for the time",
                   "give it another name"};
    if (auto done = json_->encode(event, line_); !done) return done;
    const std::string_view line(reinterpret_cast<const char*>(line_.data()), line_.size());
    // {"topic":T,"time":N,"origin":O,"sequence":S,"run":R,"data":{...}}: within a text, quotes have a backslash.
    constexpr std::string_view topic_key = "{\"topic\":", time_key = ",\"time\":", origin_key = ",\"origin\":",
                               data_key = ",\"data\":{";
    const std::size_t time = line.find(time_key), origin = line.find(origin_key, time),
                      data = line.find(data_key, origin), fields = data + data_key.size();
    const std::string_view values = line.substr(fields, line.size() - fields - std::string_view("}}\n").size());
    const std::int64_t ns = to_nanoseconds(event.time());
    constexpr std::int64_t second = 1'000'000'000;
    const std::uint64_t magnitude = ns < 0 ? ~static_cast<std::uint64_t>(ns) + 1 : static_cast<std::uint64_t>(ns);
    char seconds[40];
    std::snprintf(seconds, sizeof seconds, "%s%llu.%09llu", ns < 0 ? "-" : "",
                  static_cast<unsigned long long>(magnitude / second),
                  static_cast<unsigned long long>(magnitude % second));
    text_.assign("{\"timestamp\":").append(seconds).append(",");
    text_.append(line.substr(topic_key.size(), time - topic_key.size())).append(":{").append(values);
    if (!values.empty()) text_ += ',';
    text_.append(line.substr(origin + 1, data - origin - 1)).append("}}");
    const auto* from = reinterpret_cast<const std::byte*>(text_.data());
    out.insert(out.end(), from, from + text_.size());
    return {};
  }
  Result<DecodedEvent> decode(std::span<const std::byte>, const Description&) override {
    return Error{Errc::bad_argument, "cannot read the format", fields_format, "it is for sending only", "use json"};
  }

 private:
  const std::unique_ptr<Codec> json_ = make_json_codec();
  std::vector<std::byte> line_;
  std::string text_;
};

/// Shared, since an answer may end the sink while one of its functions runs.
class Datagrams : public std::enable_shared_from_this<Datagrams> {
 public:
  Datagrams(Loop& loop, const UdpConfig& config)
      : config_(config),
        loop_(loop),
        name_("sink " + config.sink.name),
        lookup_(loop.core(), name_, [this](Result<std::vector<HostLookup::Address>> found) {
          const auto self = shared_from_this();
          looked_up_at_ = loop_.now();
          if (fd_ >= 0) return found ? move_to(*found) : void();  // what is known serves until there is news
          if (!found) return fail(found.error());
          open(*found);
        }) {}
  ~Datagrams() { close(); }

  void send(const Parcel& parcel, Answer answer) {
    const auto self = shared_from_this();
    parcel_ = &parcel;
    answer_ = std::move(answer);
    next_ = 0;
    if (fd_ < 0) return lookup_.start(config_.host, config_.port);
    if (loop_.now() - looked_up_at_ > name_age && !lookup_.is_under_way()) {
      looked_up_at_ = loop_.now();
      lookup_.start(config_.host, config_.port);
    }
    send_some();
  }
  void cancel() {
    lookup_.cancel();
    parcel_ = nullptr;
    answer_ = {};
    if (watch_.is_open()) watch_.close();
  }
  void end() {
    cancel();
    close();
  }

 private:
  std::string peer() const { return config_.host + " port " + std::to_string(config_.port); }

  void open(const std::vector<HostLookup::Address>& addresses) {
    const int error_number = connect_to(addresses);
    if (error_number == 0) return send_some();
    fail(system_error(error_number, "cannot send", peer(), "check the network and its routes"));
  }

  /// The name has these addresses now.
  void move_to(const std::vector<HostLookup::Address>& addresses) {
    const auto is_peer = [this](const HostLookup::Address& address) {
      return address.size == peer_.size && std::memcmp(&address.socket, &peer_.socket, peer_.size) == 0;
    };
    if (std::any_of(addresses.begin(), addresses.end(), is_peer)) return;
    const int before = std::exchange(fd_, -1);
    if (connect_to(addresses) != 0) {  // there is no way to them yet
      fd_ = before;
      return;
    }
    const bool waits_for_room = watch_.is_open();
    if (waits_for_room) watch_.close();  // before the descriptor
    ::close(before);
    if (waits_for_room) send_some();
  }

  /// To the first of them that there is a way to; returns 0, or the number of the error.
  int connect_to(const std::vector<HostLookup::Address>& addresses) {
    int error_number = EADDRNOTAVAIL;
    for (const HostLookup::Address& address : addresses) {
      // "localhost" is ::1 first; receivers mostly have 127.0.0.1, which cannot be found out by connecting.
      if (addresses.size() > 1 && config_.host == "localhost" && address.socket.ss_family == AF_INET6) continue;
      fd_ = ::socket(address.socket.ss_family, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
      if (fd_ < 0) {
        error_number = errno;
        continue;
      }
      const int on = 1;
      (void)::setsockopt(fd_, SOL_SOCKET, SO_BROADCAST, &on, sizeof on);
      if (::connect(fd_, address.get(), address.size) == 0) {
        peer_ = address;
        return 0;
      }
      error_number = errno;
      ::close(fd_);
      fd_ = -1;
    }
    return error_number;
  }

  void send_some() {
    if (parcel_ == nullptr) return;
    const auto& rows = parcel_->rows();
    while (next_ < rows.size()) {
      std::array<mmsghdr, most_at_once> messages{};
      std::array<iovec, most_at_once> pieces{};
      const std::size_t count = std::min(most_at_once, rows.size() - next_);
      for (std::size_t i = 0; i < count; ++i) {
        const auto bytes = parcel_->bytes(next_ + i);
        pieces[i] = {const_cast<std::byte*>(bytes.data()), bytes.size()};
        messages[i].msg_hdr.msg_iov = &pieces[i];
        messages[i].msg_hdr.msg_iovlen = 1;
      }
      const int sent = ::sendmmsg(fd_, messages.data(), static_cast<unsigned>(count), MSG_DONTWAIT | MSG_NOSIGNAL);
      if (sent > 0) {
        next_ += static_cast<std::size_t>(sent);
        continue;
      }
      const int error_number = errno;
      if (error_number == EINTR) continue;
      if (error_number == EAGAIN || error_number == ENOBUFS) return wait_for_room();
      if (error_number == ECONNREFUSED) {
        report_no_receiver();  // of an earlier datagram, reported once; this one was not sent
      } else if (error_number == EMSGSIZE) {
        answer_.refuse(next_++, {Errc::does_not_fit, "cannot send", peer(), "it is too long for a datagram there",
                                 "send less in one event, or by tcp"});
      } else {
        close();
        return fail(system_error(error_number, "cannot send", peer(), "check the network and its routes"));
      }
    }
    int error_number = 0;
    socklen_t size = sizeof error_number;
    if (::getsockopt(fd_, SOL_SOCKET, SO_ERROR, &error_number, &size) == 0 && error_number == ECONNREFUSED)
      report_no_receiver();
    parcel_ = nullptr;
    Answer answer = std::move(answer_);
    answer.acknowledge();
  }
  void report_no_receiver() {
    answer_.refuse(next_ > 0 ? next_ - 1 : 0,
                   {Errc::disconnected, "no program receives it", peer(), "no program there listens at this port",
                    "start the receiver; sending continues"});
  }
  void wait_for_room() {
    if (watch_.is_open()) return;
    watch_ = FdWatch(loop_, fd_, static_cast<FdWatch::Events>(FdWatch::readable_and_writable), name_,
                     [this](const FdEvent&) {
                       const auto self = shared_from_this();
                       watch_.close();
                       send_some();
                     });
  }
  void fail(const Error& error) {
    parcel_ = nullptr;
    Answer answer = std::move(answer_);
    answer.again(error);
  }
  void close() {
    if (watch_.is_open()) watch_.close();  // before the descriptor
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }

  const UdpConfig config_;
  Loop& loop_;
  const std::string name_;
  HostLookup lookup_;
  MonotonicTime looked_up_at_{};
  int fd_ = -1;
  HostLookup::Address peer_;  // that it is connected to
  FdWatch watch_;
  const Parcel* parcel_ = nullptr;
  Answer answer_;
  std::size_t next_ = 0;  // row
};

class UdpSender final : public Sender {
 public:
  UdpSender(UdpConfig config, std::unique_ptr<Codec> codec) : config_(std::move(config)), codec_(std::move(codec)) {
    config_.sending.window = 1;  // the kernel answers at once
  }

  SendingConfig sending() const override { return config_.sending; }
  void begin(Loop& loop) override { datagrams_ = std::make_shared<Datagrams>(loop, config_); }
  void send(const Parcel& parcel, Answer answer) override { datagrams_->send(parcel, std::move(answer)); }
  void cancel() override { datagrams_->cancel(); }
  void end() override {
    const auto datagrams = std::move(datagrams_);
    datagrams->end();
  }
  Result<void> encode(const Record& record, std::vector<std::byte>& out) override {
    const std::size_t before = out.size();
    if (auto done = codec_->encode(record.keyed_view(), out); !done) return done;
    if (out.size() - before <= config_.longest) return {};
    return Error{Errc::does_not_fit, "cannot send", std::string(record.info->topic),
                 "the event has " + std::to_string(out.size() - before) + " bytes, a datagram at most " +
                     std::to_string(config_.longest),
                 "send less in one event, or by tcp"};
  }

 private:
  UdpConfig config_;
  const std::unique_ptr<Codec> codec_;  // lane
  std::shared_ptr<Datagrams> datagrams_;
};

UdpConfig named(UdpConfig config) {
  if (config.sink.name.empty()) config.sink.name = "udp";
  return config;
}

std::unique_ptr<Sender> sender_of(const UdpConfig& config, const CodecRegistry& formats) {
  detail::require_host(cannot_make_udp, config.host, config.port);
  auto codec = config.format == fields_format ? std::unique_ptr<Codec>(std::make_unique<FieldsCodec>())
                                              : detail::codec_to_send(cannot_make_udp, config.format, formats);
  return std::make_unique<UdpSender>(named(config), std::move(codec));
}

}  // namespace

void check_config(const UdpConfig& config, const ConfigItem& item, Problems& problems) {
  detail::add_mistake({"host", detail::obstacle_of_host(config.host)}, item, problems);
  detail::add_mistake({"format", detail::obstacle_of_format(config.format)}, item, problems);
}

UdpSink::UdpSink(Loop& loop, UdpConfig config, const CodecRegistry& formats)
    : Sink(loop, named(config).sink, sender_of(config, formats)) {}

}  // namespace rtdata
