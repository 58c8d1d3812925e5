/// ConsoleSink: prints events as readable lines on standard output.
///
///     rtdata::ConsoleSink console(loop, {});
///
///     12:00:00.123 room/climate room #12 temperature=21.5 Cel humidity=40 %RH
///
/// Time of day (UTC unless set otherwise), topic, origin, sequence, then the fields with their units. Control
/// characters within texts are written as `\x1b`.
///
/// The sink's lane writes the lines: a stopped terminal or a slow pipe delays nothing else; the queue fills, then
/// events are dropped and counted. When the reader of a pipe has ended, the sink ends too: it is faulted, this is
/// reported, and further events are refused. The program gets no SIGPIPE.
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's. Errors of the constructor (SetupError):
/// bad-argument (a descriptor that is not open for writing); those of `Sink`.
#pragma once

#include "rtdata/data/parameter.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata {

enum class ConsoleTime { utc, local };
constexpr auto describe(type_tag<ConsoleTime>) {
  return enumeration("time", value("utc", ConsoleTime::utc), value("local", ConsoleTime::local));
}

struct ConsoleConfig {
  int descriptor = 1;                   ///< 1: standard output, 2: standard error; a copy is used
  ConsoleTime time = ConsoleTime::utc;  ///< local: as TZ or /etc/localtime says
  /// Smaller queue and faster output than other sinks: a person reads it.
  SinkConfig sink = {.name = "console",
                     .batch_time = std::chrono::milliseconds{100},
                     .queue_bytes = std::size_t{4} << 20,
                     .close_deadline = std::chrono::seconds{1}};

  friend constexpr auto parameters(type_tag<ConsoleConfig>) {
    return parameter_list(parameter("descriptor", &ConsoleConfig::descriptor, "1: standard output, 2: standard error",
                                    range(0, 1'000'000)),
                          parameter("time", &ConsoleConfig::time, "time zone of the printed times"),
                          include_member(&ConsoleConfig::sink));
  }
};

/// Checks that the descriptor is open for writing.
void check_config(const ConsoleConfig& config, const ConfigItem& item, Problems& problems);

class ConsoleSink : public Sink {
 public:
  ConsoleSink() noexcept = default;
  ConsoleSink(Loop& loop, ConsoleConfig config);
};

}  // namespace rtdata
