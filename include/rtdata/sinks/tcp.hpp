/// TcpSink: sends events to a TCP server, one after the other on one connection.
///
///     rtdata::TcpSink lines(loop, {.host = "192.168.1.7", .port = 9000});
///     rtdata::TcpSink sure(loop, {.host = "collector.local", .port = 9000, .format = "raw",
///                                 .acknowledge = rtdata::Acknowledge::byte, .sink = {.through = "run.db"}});
///
/// Any format of the registry that carries the topic: "jsonl", "cbor", "influx", "raw" (docs/formats.md), or one of the
/// program's. The connection is made with the first event and made again when it is lost; names are looked up without
/// blocking the loop. A missing or slow peer delays nothing else: events wait in the queue, or with `through` in the
/// recording.
///
/// Guarantees: with `acknowledge`, the sink keeps each event until the peer has confirmed it, so every event arrives,
/// sometimes twice (after a lost connection it sends unconfirmed events again, and the last event of the old connection
/// may be incomplete). Without `acknowledge`, an event counts as sent when the kernel has taken it: if the connection
/// is lost, the data in the kernel's buffers are lost; the error gives the number of bytes.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's; events are encoded on the sink's lane.
/// Errors of the constructor (SetupError): bad-argument (no host, no port, csv), not-found (no such format); those of
/// `Sink`.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "rtdata/data/codec.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/net/tls.hpp"
#include "rtdata/sinks/sender.hpp"

namespace rtdata {

class ConfigItem;
class Problems;

/// How the peer confirms each event, in order.
enum class Acknowledge {
  none,
  byte,  ///< 0x06 (ACK): received; 0x15 (NAK): refused
  line,  ///< "ok", or "no" and a reason, with a line end
};
constexpr auto describe(type_tag<Acknowledge>) {
  return enumeration("acknowledge", value("none", Acknowledge::none), value("byte", Acknowledge::byte),
                     value("line", Acknowledge::line));
}

struct TcpConfig {
  std::string host = {};   ///< a name or an address
  std::uint16_t port = 0;  ///< of the server
  std::string format = "jsonl";
  bool sequence = false;  ///< "raw" only: with the sequence number after the origin
  Acknowledge acknowledge = Acknowledge::none;
  std::optional<TlsConfig> tls = {};                    ///< encryption; empty: none. The build needs OpenSSL
  Duration connect_timeout = std::chrono::seconds{10};  ///< for each address of the host, and again for TLS
  SendingConfig sending = {.window = 4, .parcel_rows = 1000, .parcel_bytes = std::size_t{64} << 10};
  SinkConfig sink = {.batch_time = std::chrono::milliseconds{100}};  ///< name: "tcp" by default

  friend constexpr auto parameters(type_tag<TcpConfig>) {
    using namespace std::chrono_literals;
    return parameter_list(
        parameter("host", &TcpConfig::host, "the server: a name or an address", required),
        parameter("port", &TcpConfig::port, "its port", required, at_least(1)),
        parameter("format", &TcpConfig::format, "jsonl (a JSON object per line), cbor, influx, or raw"),
        parameter("sequence", &TcpConfig::sequence, "only with raw: send the sequence number after the origin",
                  only_with("format", "raw")),
        parameter("acknowledge", &TcpConfig::acknowledge,
                  "how the peer confirms each event: not at all, by a byte (0x06, or 0x15: refused), by a line (ok, or "
                  "no and a reason)"),
        parameter("tls", &TcpConfig::tls,
                  "encryption; {} is enough if a public authority signed the server's certificate"),
        parameter("connect_timeout", &TcpConfig::connect_timeout,
                  "how long to wait for each address of the host, and then for the TLS handshake", range(10ms, 10min)),
        include_member(&TcpConfig::sending), include_member(&TcpConfig::sink));
  }
};

/// Checks rules over several parameters: a valid host, and a format that can be sent.
void check_config(const TcpConfig& config, const ConfigItem& item, Problems& problems);

class TcpSink : public Sink {
 public:
  TcpSink() noexcept = default;
  /// `formats` is used during the call only.
  TcpSink(Loop& loop, TcpConfig config, const CodecRegistry& formats = CodecRegistry::standard());
};

}  // namespace rtdata
