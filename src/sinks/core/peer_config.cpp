#include "sinks/core/peer_config.hpp"

#include <utility>

#include "rtdata/data/error.hpp"

namespace rtdata::detail {

std::string obstacle_of_format(const std::string& format) {
  return format == "csv" ? "CSV rows do not contain the topic: choose another format" : "";
}

void require_host(const char* what, const std::string& host, std::uint16_t port) {
  if (std::string why = obstacle_of_host(host); !why.empty())
    throw SetupError({Errc::bad_argument, what, host, std::move(why), ""});
  if (port == 0) throw SetupError({Errc::bad_argument, what, host, "there is no port", "set `port`"});
}

std::unique_ptr<Codec> codec_to_send(const char* what, const std::string& format, const CodecRegistry& formats) {
  if (std::string why = obstacle_of_format(format); !why.empty())
    throw SetupError({Errc::bad_argument, what, format, std::move(why), ""});
  return formats.make(format == "jsonl" ? "json" : format).or_throw();
}

}  // namespace rtdata::detail
