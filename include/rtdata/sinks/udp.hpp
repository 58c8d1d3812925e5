/// UdpSink: sends one JSON object in each datagram, for live plots in PlotJuggler or your own script.
///
///     rtdata::UdpSink view(loop, {.host = "192.168.1.7"});
///
///     {"timestamp":1772366400.25,"room/climate":{"temperature":21.5,"origin":"chamber","sequence":7,"run":"9f1c"}}
///
/// `timestamp` is in seconds since the Unix epoch, the fields are below their topic. Any other format of the registry
/// can be sent, one event per datagram ("cbor", "influx", "raw").
///
/// No guarantees: events may be lost or arrive in another order; an event counts as sent when the kernel has taken it.
/// If the network reports that nobody listens at the peer, this is reported and counted as refused (one event for each
/// such report); sending continues. An event that is longer than a datagram is refused.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's; events are encoded on the sink's lane.
/// Errors of the constructor (SetupError): bad-argument (no host, no port, csv), not-found (no such format); those of
/// `Sink`.
#pragma once

#include <cstdint>
#include <string>

#include "rtdata/data/codec.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/sinks/sender.hpp"

namespace rtdata {

class ConfigItem;
class Problems;

struct UdpConfig {
  std::string host = "localhost";  ///< a name or an address; broadcasts and groups are addresses, too
  std::uint16_t port = 9870;       ///< PlotJuggler's own
  std::string format = "fields";   ///< "fields": the object above; or a format of the registry
  std::size_t longest = 65507;     ///< bytes of a datagram; more than 1472 go in several packets
  SendingConfig sending = {.window = 1, .parcel_rows = 256};
  SinkConfig sink = {.batch_time = std::chrono::milliseconds{20},  // for a live view
                     .queue_bytes = std::size_t{4} << 20,
                     .when_full = WhenFull::drop_oldest,
                     .close_deadline = std::chrono::seconds{1}};  ///< name: "udp" by default

  friend constexpr auto parameters(type_tag<UdpConfig>) {
    return parameter_list(
        parameter("host", &UdpConfig::host, "the receiver: a name or an address"),
        parameter("port", &UdpConfig::port, "its port; PlotJuggler's is 9870", at_least(1)),
        parameter("format", &UdpConfig::format,
                  "fields (an object with timestamp and the fields by topic), jsonl, cbor, influx or raw"),
        parameter("longest", &UdpConfig::longest, "longer events are refused; more than 1472 go in several packets",
                  unit("By"), range(64, 65507)),
        include_member(&UdpConfig::sending), include_member(&UdpConfig::sink));
  }
};

/// Checks rules over several parameters: a valid host, and a format that can be sent.
void check_config(const UdpConfig& config, const ConfigItem& item, Problems& problems);

class UdpSink : public Sink {
 public:
  UdpSink() noexcept = default;
  /// `formats` is used during the call only.
  UdpSink(Loop& loop, UdpConfig config, const CodecRegistry& formats = CodecRegistry::standard());
};

}  // namespace rtdata
