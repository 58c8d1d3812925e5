#include "rtdata/sensors/query.hpp"

#include <optional>

#include "rtdata/data/config_item.hpp"
#include "sensors/lines/hex_bytes.hpp"
#include "sensors/lines/line_decoder.hpp"

namespace rtdata {
namespace {

struct Mistake {
  const char* key;
  const char* why;
  const char* advice;
};
std::optional<Mistake> mistake_in_request(const Query::Config& config) {
  if (config.request.empty() && config.request_hex.empty())
    return Mistake{"request", "there is no request", "set `request` or `request_hex`"};
  if (!config.request.empty() && !config.request_hex.empty())
    return Mistake{"request_hex", "there is a `request` too", "remove one of them"};
  const auto bytes = detail::bytes_of_hex(config.request_hex);
  if (!bytes || (config.request.empty() && bytes->empty()))
    return Mistake{"request_hex", "these are not bytes", "two hexadecimal digits each, such as \"02 4d 0d\""};
  return std::nullopt;
}

/// The answer, as lines that come by themselves.
LineConfig as_lines(const Query::Config& config) {
  LineConfig lines;
  lines.format = config.format;
  lines.fields = config.fields;
  lines.separator = config.separator;
  lines.comment = "";
  lines.max_line = Query::longest_answer;
  return lines;
}

std::string request_of(const Query::Config& config) {
  if (const auto mistake = mistake_in_request(config))
    throw SetupError({Errc::bad_argument, "cannot use this query", mistake->key, mistake->why, mistake->advice});
  return config.request.empty() ? *detail::bytes_of_hex(config.request_hex) : config.request;
}

}  // namespace

void check_config(const Query::Config& config, const ConfigItem& item, Problems& problems) {
  if (const auto mistake = mistake_in_request(config)) {
    const ConfigItem* at = item.find(mistake->key);
    problems.add((at != nullptr ? *at : item)
                     .problem("bad-value", std::string(at != nullptr ? "" : mistake->key) +
                                               (at != nullptr ? "" : ": ") + mistake->why + "; " + mistake->advice));
  }
  check_config(as_lines(config), item, problems);
}

struct Query::Decoding {
  explicit Decoding(const Config& config) : decoder(as_lines(config)) {}
  detail::LineDecoder decoder;
};

Query::Query(const Config& config)
    : config_(config), request_(request_of(config)), decoding_(std::make_unique<Decoding>(config)) {}

Query::~Query() = default;

Result<void> Query::open(SerialDevice& line) {
  for (const std::string& command : config_.at_open) {
    if (auto done = line.write(command); !done) return done;
  }
  return {};
}

Reading<DescribedValue> Query::read(SerialDevice& line) {
  Result<std::string> answer = line.transact(request_, config_.answer_end, {}, longest_answer);
  for (unsigned i = 0; answer && i < config_.skip_lines; ++i) {
    answer = line.read_until(config_.answer_end, {}, longest_answer);
  }
  if (!answer) return std::move(answer).error();
  const auto without_end = [this](std::string_view of) {
    if (of.ends_with(config_.answer_end)) of.remove_suffix(1);
    if (of.ends_with('\r')) of.remove_suffix(1);
    return of;
  };
  const std::string_view text = without_end(*answer);
  if (text == without_end(request_))
    return Unreadable{line.error(Errc::bad_data, "cannot use an answer", "it echoes the request",
                                 "switch its echo off, or that of the adapter, or set `skip_lines` to 1")};
  detail::LineDecoder& decoder = decoding_->decoder;
  if (auto done = decoder.decode(text); !done) {
    const Error& e = done.error();
    return Unreadable{line.error(static_cast<Errc>(e.code.value()), "cannot use an answer",
                                 (e.where.empty() ? "" : e.where + ": ") + e.why, "check `request` and `fields`")};
  }
  return DescribedValue(std::span<const std::byte>(decoder.payload(), decoder.description()->size()));
}

}  // namespace rtdata
