#include "sinks/http/http_sender.hpp"

namespace rtdata {
namespace {

std::unique_ptr<Sender> make_sender(HttpConfig config, const CodecRegistry& formats) {
  auto codec = formats.make(config.format == "jsonl" ? "json" : config.format).or_throw();
  return std::make_unique<detail::HttpSender>(std::move(config), std::move(codec));
}

}  // namespace

HttpSink::HttpSink(Loop& loop, HttpConfig config, const CodecRegistry& formats)
    : Sink(loop, config.sink, make_sender(config, formats)) {}

}  // namespace rtdata
