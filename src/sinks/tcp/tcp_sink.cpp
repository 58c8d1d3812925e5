#include "rtdata/sinks/tcp.hpp"

#include <algorithm>
#include <cerrno>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "net/tls_mistakes.hpp"
#include "net/tls_session.hpp"
#include "net/tls_stream.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/detail/io/loaded_library.hpp"
#include "sinks/core/peer_config.hpp"

namespace rtdata {
namespace {

using detail::TlsContext;
using detail::TlsStream;

constexpr const char* cannot_make_tcp = "cannot make tcp sink";
constexpr std::size_t most_read = 4096;         // at once
constexpr int most_reads = 16;                  // in a turn of the loop
constexpr std::size_t most_written = 1U << 20;  // the same, in bytes
constexpr std::size_t most_line = 256;          // of an acknowledgement
constexpr char ack = 0x06, nak = 0x15;
constexpr Duration short_life = std::chrono::seconds{1};  // the next connection must last longer before it is used
constexpr Duration probation = std::chrono::milliseconds{500};

/// The connection on the loop. Shared, because an answer may end the sink while one of its functions runs.
class Connection : public std::enable_shared_from_this<Connection> {
 public:
  Connection(Loop& loop, const TcpConfig& config, std::shared_ptr<const TlsContext> tls)
      : loop_(loop),
        config_(config),
        tls_(std::move(tls)),
        stream_(
            loop.core(), "sink " + config.sink.name, [this](const Result<void>& result) { opened(result); },
            [this] { ready(); }),
        more_(loop, [this] { go_on(); }) {}

  void send(const Parcel& parcel, Answer answer) {
    const auto self = shared_from_this();
    if (trouble_) return answer.again(*std::exchange(trouble_, {}), Duration{0});
    const std::size_t confirmed = answer.confirmed();
    const std::size_t begin = confirmed == 0 ? 0 : parcel.rows()[confirmed - 1].end;
    under_way_.push_back({&parcel, std::move(answer), begin, confirmed});
    if (stream_.is_open()) return write();
    if (!stream_.is_connecting()) stream_.connect(config_.host, config_.port, config_.connect_timeout, tls_);
  }
  /// Half an event may have been sent: no other can follow it.
  void cancel() {
    under_way_.clear();
    close();
  }
  void end() {
    under_way_.clear();
    more_.close();
    if (stream_.is_open()) {
      char rest[most_read];  // what is left unread would make the kernel throw away what is still to be sent
      for (int i = 0; i < most_reads && stream_.read(rest, sizeof rest) > 0; ++i) {
      }
      stream_.end_writing();
    }
    stream_.close();
  }

 private:
  struct UnderWay {
    const Parcel* parcel;
    Answer answer;
    std::size_t written = 0;    // bytes
    std::size_t confirmed = 0;  // rows
  };

  std::string peer() const { return config_.host + " port " + std::to_string(config_.port); }
  bool is_confirmed() const noexcept { return config_.acknowledge != Acknowledge::none; }

  void opened(const Result<void>& result) {
    const auto self = shared_from_this();
    if (!result) return fail(result.error());
    opened_at_ = loop_.now();
    // A server with TLS may refuse this machine's certificate only after the handshake.
    is_on_probation_ = std::exchange(is_distrusted_, false) || (tls_ != nullptr && !is_confirmed());
    if (is_on_probation_) return more_.start(std::min<Duration>(probation, config_.sending.timeout / 2));
    write();
  }

  void ready() {
    const auto self = shared_from_this();
    read();
    if (stream_.is_open()) write();
  }
  void read() {
    char bytes[most_read];
    for (int i = 0; stream_.is_open() && (i < most_reads || stream_.has_unread()); ++i) {
      const ssize_t got = stream_.read(bytes, sizeof bytes);
      if (got < 0 && errno == EINTR) continue;
      if (got < 0 && errno == EAGAIN) break;
      if (got < 0) return fail(stream_.failure(errno));
      if (got == 0)
        return fail({Errc::disconnected, "lost the connection", peer(), "the peer has closed it",
                     "the program connects to it again"});
      if (is_confirmed()) take({bytes, static_cast<std::size_t>(got)});  // else what the peer says means nothing
    }
  }
  void go_on() {
    const auto self = shared_from_this();
    is_on_probation_ = false;
    if (stream_.is_open()) write();
  }

  void write() {
    if (is_on_probation_ || std::exchange(is_writing_, true)) return;  // an answer has brought the next parcel
    std::size_t left = most_written;
    bool is_full = false;
    while (left > 0 && !is_full && stream_.is_open()) {
      const auto next = std::find_if(under_way_.begin(), under_way_.end(),
                                     [](const UnderWay& one) { return one.written < one.parcel->bytes().size(); });
      if (next == under_way_.end()) break;
      const auto bytes = next->parcel->bytes().subspan(next->written);
      const ssize_t done = stream_.write(bytes.data(), std::min(bytes.size(), left));
      if (done < 0 && errno == EINTR) continue;
      if (done < 0 && errno == EAGAIN) {
        is_full = true;
      } else if (done < 0) {
        const Error error = stream_.failure(errno);
        read();  // what the peer said before it went: answers, or an alert with its reason
        is_writing_ = false;
        if (stream_.is_open()) fail(error);
        return;
      } else {
        next->written += static_cast<std::size_t>(done);
        left -= std::min(left, static_cast<std::size_t>(done));
        if (!is_confirmed() && next->written == next->parcel->bytes().size()) acknowledge_first();
      }
    }
    is_writing_ = false;
    if (!stream_.is_open()) return;
    if (is_full != wants_to_write_) stream_.want_to_write(wants_to_write_ = is_full);
    if (left == 0) more_.start(Duration{0});
  }

  void take(std::string_view bytes) {
    take_acknowledgements(bytes);
    if (!under_way_.empty() && stream_.is_open()) under_way_.front().answer.confirm(under_way_.front().confirmed);
  }
  void take_acknowledgements(std::string_view bytes) {
    while (!bytes.empty() && stream_.is_open()) {
      if (config_.acknowledge == Acknowledge::byte) {
        const char c = bytes.front();
        bytes.remove_prefix(1);
        if (c != ack && c != nak) return garbage("the byte " + std::to_string(static_cast<unsigned char>(c)));
        confirm(c == nak ? std::optional<std::string>("the peer does not take it") : std::nullopt);
        continue;
      }
      const std::size_t size = std::min(bytes.find('\n'), bytes.size());
      line_.append(bytes.substr(0, size));
      bytes.remove_prefix(size);
      if (line_.size() > most_line) return garbage("a line of more than " + std::to_string(most_line) + " bytes");
      if (bytes.empty()) return;
      bytes.remove_prefix(1);
      std::string line = std::exchange(line_, {});
      if (line.ends_with('\r')) line.pop_back();
      if (line == "ok") {
        confirm({});
      } else if (line == "no" || line.starts_with("no ")) {
        confirm(line.size() > 3 ? line.substr(3) : "the peer does not take it");
      } else {
        return garbage("\"" + line + "\"");
      }
    }
  }
  /// The next event, which the peer has, or refuses.
  void confirm(std::optional<std::string> refusal) {
    if (under_way_.empty()) return garbage("more than it was sent");
    UnderWay& first = under_way_.front();
    const auto& rows = first.parcel->rows();
    if (rows[first.confirmed].end > first.written) return garbage("an event that it was not sent");
    const std::size_t row = first.confirmed++;
    const bool is_last = first.confirmed == rows.size();
    if (refusal) first.answer.refuse(row, {Errc::bad_data, "refused", peer(), std::move(*refusal), ""});
    if (is_last) acknowledge_first();
  }
  void garbage(const std::string& got) {
    if (under_way_.empty()) has_trouble_ = true;  // the next parcel reports it
    fail({Errc::bad_data, "cannot understand the peer", peer(), "it acknowledges " + got,
          "set `acknowledge` as the peer answers: docs/sending.md"});
  }

  void acknowledge_first() {
    Answer answer = std::move(under_way_.front().answer);
    under_way_.erase(under_way_.begin());
    answer.acknowledge();
  }

  void fail(Error error) {
    const std::size_t bytes = is_confirmed() ? 0 : stream_.unconfirmed();
    const bool was_open = stream_.is_open();
    // A tunnel or a proxy whose other end is away accepts, takes bytes, and hangs up: what waits must not vanish in it.
    if (was_open && !is_confirmed()) is_distrusted_ = is_on_probation_ || loop_.now() - opened_at_ < short_life;
    close();
    if (bytes > 0) error.why += "; up to " + std::to_string(bytes) + " bytes that had been sent are lost";
    if (under_way_.empty()) {
      // Nobody waits for an answer: possible losses are reported with the next parcel.
      if (was_open && (bytes > 0 || std::exchange(has_trouble_, false))) trouble_ = std::move(error);
      return;
    }
    auto ended = std::move(under_way_);
    under_way_.clear();
    if (is_confirmed()) ended.front().answer.confirm(ended.front().confirmed);
    for (UnderWay& one : ended) one.answer.again(error);
  }
  void close() {
    stream_.close();
    more_.stop();
    line_.clear();
    wants_to_write_ = is_on_probation_ = false;
  }

  Loop& loop_;
  const TcpConfig config_;
  const std::shared_ptr<const TlsContext> tls_;  // null: not encrypted
  TlsStream stream_;
  Timer more_;  // continues in the next turn of the loop
  std::vector<UnderWay> under_way_;
  std::string line_;  // of an acknowledgement, begun
  std::optional<Error> trouble_;
  bool has_trouble_ = false;
  MonotonicTime opened_at_{};
  bool is_distrusted_ = false;  // the last connection was soon over
  bool is_on_probation_ = false;
  bool is_writing_ = false;
  bool wants_to_write_ = false;
};

class TcpSender final : public Sender {
 public:
  TcpSender(TcpConfig config, std::unique_ptr<Codec> codec) : config_(std::move(config)), codec_(std::move(codec)) {}

  SendingConfig sending() const override { return config_.sending; }
  /// On the lane: it reads files. Before `begin`.
  Result<void> open() override {
    if (!config_.tls) return {};
    auto loaded = TlsContext::load(*config_.tls);
    if (!loaded) return std::move(loaded).error();
    tls_ = std::move(*loaded);
    return {};
  }
  void begin(Loop& loop) override { connection_ = std::make_shared<Connection>(loop, config_, tls_); }
  void send(const Parcel& parcel, Answer answer) override { connection_->send(parcel, std::move(answer)); }
  void cancel() override { connection_->cancel(); }
  void end() override {
    const auto connection = std::move(connection_);
    connection->end();
  }
  Result<void> encode(const Record& record, std::vector<std::byte>& out) override {
    return codec_->encode(record.keyed_view(), out);
  }

 private:
  const TcpConfig config_;
  const std::unique_ptr<Codec> codec_;  // lane
  std::shared_ptr<const TlsContext> tls_;
  std::shared_ptr<Connection> connection_;
};

TcpConfig named(TcpConfig config) {
  if (config.sink.name.empty()) config.sink.name = "tcp";
  return config;
}

std::unique_ptr<Sender> sender_of(const TcpConfig& config, const CodecRegistry& formats) {
  detail::require_host(cannot_make_tcp, config.host, config.port);
  if (config.tls) {
    detail::load_tls().or_throw();
    for (const detail::SettingMistake& mistake : detail::mistakes_of(*config.tls)) throw mistake.error(cannot_make_tcp);
  }
  auto codec = config.format == "raw" && config.sequence
                   ? make_raw_codec({.sequence = RawConfig::Sequence::include})
                   : detail::codec_to_send(cannot_make_tcp, config.format, formats);
  return std::make_unique<TcpSender>(named(config), std::move(codec));
}

}  // namespace

void check_config(const TcpConfig& config, const ConfigItem& item, Problems& problems) {
  detail::add_mistake({"host", detail::obstacle_of_host(config.host)}, item, problems);
  detail::add_mistake({"format", detail::obstacle_of_format(config.format)}, item, problems);
  if (!config.tls) return;
  detail::add_not_installed(detail::load_tls(), detail::item_of(item, "tls"), problems);
  detail::add_mistakes(detail::mistakes_of(*config.tls), item, problems);
}

TcpSink::TcpSink(Loop& loop, TcpConfig config, const CodecRegistry& formats)
    : Sink(loop, named(config).sink, sender_of(config, formats)) {}

}  // namespace rtdata
