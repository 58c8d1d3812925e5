#include "net/libz.hpp"
#include "sinks/http/http_sender.hpp"

namespace rtdata {
namespace {

std::unique_ptr<Sender> make_sender(HttpConfig config, const CodecRegistry& formats) {
  auto codec = formats.make(config.format == "jsonl" ? "json" : config.format).or_throw();
  return std::make_unique<detail::HttpSender>(std::move(config), std::move(codec));
}

}  // namespace

namespace detail {

std::vector<SettingMistake> mistakes_of(const HttpConfig& config) {
  std::vector<SettingMistake> mistakes = mistakes_of(config.server);
  if (config.method == HttpMethod::get) mistakes.push_back({"method", "it must be post or put"});
  if (config.format == "csv")
    mistakes.push_back(
        {"format", "CSV rows contain neither the topic nor the column names: use json, jsonl, cbor or influx"});
  if (!is_one_line(config.content_type))
    mistakes.push_back({"content_type", "it has a line break or another control character"});
  return mistakes;
}

}  // namespace detail

void check_config(const HttpConfig& config, const ConfigItem& item, Problems& problems) {
  if (!detail::add_not_installed(detail::load_curl(), item, problems)) return;
  if (config.compression == HttpCompression::gzip) detail::add_not_installed(detail::libz.load(), item, problems);
  detail::add_mistakes(detail::mistakes_of(config), item, problems);
}

HttpSink::HttpSink(Loop& loop, HttpConfig config, const CodecRegistry& formats)
    : Sink(loop, config.sink, make_sender(config, formats)) {}

}  // namespace rtdata
