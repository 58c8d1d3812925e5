#include "rtdata/sensors/query.hpp"

#include <algorithm>
#include <array>

#include "data/hex_bytes.hpp"
#include "data/setting_mistake.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "sensors/lines/line_config.hpp"
#include "sensors/lines/line_decoder.hpp"

namespace rtdata {
namespace {

detail::SettingMistake mistake_in_request(const Query::Config& config) {
  if (config.request.empty() && config.request_hex.empty())
    return {"request", "there is no request", "set `request` or `request_hex`"};
  if (!config.request.empty() && !config.request_hex.empty())
    return {"request_hex", "there is also a `request`", "remove one of them"};
  const auto bytes = detail::bytes_of_hex(config.request_hex);
  if (!bytes || (config.request.empty() && bytes->empty()))
    return {"request_hex", "these are not bytes", "write two hexadecimal digits for each, such as \"02 4d 0d\""};
  return {};
}

/// The settings of the answer, in the form of lines that a device sends by itself.
LineConfig as_lines(const Query::Config& config) {
  LineConfig lines;
  lines.format = config.format;
  lines.fields = config.fields;
  lines.separator = config.separator;
  lines.pattern = config.pattern;
  lines.frame = config.frame;
  lines.unreadable_if = config.unreadable_if;
  lines.checksum = config.checksum;
  lines.comment = "";
  lines.max_line = Query::longest_answer;
  return lines;
}

std::string request_of(const Query::Config& config) {
  if (const auto mistake = mistake_in_request(config)) throw mistake.error("cannot use this query");
  return config.request.empty() ? *detail::bytes_of_hex(config.request_hex) : config.request;
}

}  // namespace

void check_config(const Query::Config& config, const ConfigItem& item, Problems& problems) {
  detail::add_mistake(mistake_in_request(config), item, problems);
  detail::check_at_open(config.at_open_hex, item, problems);
  detail::check_at_open(config.prepare_hex, item, problems, "prepare_hex");
  if (const ConfigItem* const at = item.find("prepare_wait");
      at != nullptr && config.prepare_wait > Duration{0} && config.prepare.empty() && config.prepare_hex.empty())
    problems.add(at->problem("bad-value", "`prepare_wait` needs `prepare`"));
  if (config.at_open_answers && config.at_open.empty() && config.at_open_hex.empty())
    detail::add_mistake({"at_open_answers", "`at_open_answers` needs `at_open`"}, item, problems);
  detail::check_lines_of(as_lines(config), detail::FrameCutter::Stream::of_one, item, problems);
}

struct Query::Decoding {
  explicit Decoding(const Config& config) : decoder(as_lines(config)) {
    if (config.frame) cutter.emplace(*config.frame, longest_answer, detail::FrameCutter::Stream::of_one);
  }
  detail::LineDecoder decoder;
  std::optional<detail::FrameCutter> cutter;  // empty: the answer is a line
};

Query::Query(const Config& config)
    : config_(config),
      request_(request_of(config)),
      at_open_(detail::texts_at_open(config.at_open, config.at_open_hex)),
      prepare_(detail::texts_at_open(config.prepare, config.prepare_hex, "prepare_hex")),
      decoding_(std::make_unique<Decoding>(config)) {}

Query::~Query() = default;

Result<void> Query::open(SerialDevice& line) {
  losses_ = line.losses();
  for (std::size_t i = 0; i < at_open_.size(); ++i) {
    const std::string& text = at_open_[i];
    const bool is_text = i < config_.at_open.size();
    const bool is_question = config_.at_open_answers || (is_text && text.find('?') != std::string::npos);
    if (is_question)
      if (auto done = line.drop_input(); !done) return done;
    if (auto done = line.write(text); !done) return done;
    if (!is_question) continue;
    if (auto done = drop_answer(line, decoding_->cutter ? Answer::frame : Answer::line, "at_open"); !done) return done;
  }
  return {};
}

/// `of`: the setting that caused the answer.
Result<void> Query::drop_answer(SerialDevice& line, Answer answer, const char* of) {
  Result<std::string> got = answer == Answer::frame ? next_frame(line)
                                                    : line.read_until(config_.answer_end, {}, longest_answer);
  for (unsigned i = 0; got && answer == Answer::line && i < config_.skip_lines; ++i)
    got = line.read_until(config_.answer_end, {}, longest_answer);
  if (got) return {};
  Error error = std::move(got).error();
  error.why = "the answer to one of `" + std::string(of) + "`: " + error.why;
  return error;
}

Result<void> Query::prepare(SerialDevice& line) {
  for (std::size_t i = 0; i < prepare_.size(); ++i) {
    if (auto done = line.drop_input(); !done) return done;
    if (auto done = line.write(prepare_[i]); !done) return done;
    const bool is_text = i < config_.prepare.size();
    if (auto done = drop_answer(line, decoding_->cutter && !is_text ? Answer::frame : Answer::line, "prepare"); !done)
      return done;
  }
  // What the device sends during this wait, such as a notice that it has measured, is dropped before the request.
  if (!prepare_.empty()) detail::lane_sleep(config_.prepare_wait);
  return {};
}

Result<std::string> Query::ask_for_frame(SerialDevice& line) {
  if (auto done = line.drop_input(); !done) return std::move(done).error();
  if (auto done = line.write(request_); !done) return std::move(done).error();
  return next_frame(line);
}

/// The next frame; bytes before it are skipped.
Result<std::string> Query::next_frame(SerialDevice& line) {
  detail::FrameCutter& cutter = *decoding_->cutter;
  cutter.reset();
  const MonotonicTime until = detail::lane_now() + line.answer_timeout();
  std::string bytes;
  std::size_t skipped = 0;
  for (;;) {
    const detail::FrameCutter::Found found = cutter.next(bytes);
    skipped += found.skipped;
    bytes.erase(0, found.skipped);
    if (found.size != 0) {
      if (auto done = line.read(std::span<std::uint8_t>()); !done) return std::move(done).error();  // it is complete
      return bytes.substr(0, found.size);
    }
    std::array<std::uint8_t, 512> some{};
    const Result<std::size_t> got = line.read_some(some, std::max(until - detail::lane_now(), Duration{0}));
    if (got) {
      bytes.append(reinterpret_cast<const char*>(some.data()), *got);
    } else if (got.error().code == Errc::timed_out && bytes.size() + skipped != 0) {
      return line.error(Errc::timed_out, "no answer",
                        std::to_string(bytes.size() + skipped) + " bytes came within " +
                            to_string(line.answer_timeout()) + ", but no complete frame",
                        "check `frame`, and `baud_rate`");
    } else {
      return got.error();
    }
  }
}

/// The port was opened again without this driver, because the device was gone for a moment.
Result<void> Query::open_if_lost(SerialDevice& line) {
  if (line.losses() == losses_ || at_open_.empty()) return {};
  if (auto done = line.drop_input(); !done) return done;
  const std::uint64_t before = losses_;
  auto opened = open(line);
  if (!opened) losses_ = before;
  return opened;
}

Reading<DescribedValue> Query::read(SerialDevice& line) {
  if (auto opened = open_if_lost(line); !opened) return std::move(opened).error();
  line.begin_reading();
  if (auto prepared = prepare(line); !prepared) return std::move(prepared).error();
  return decoding_->cutter ? read_frame(line) : read_line(line);
}

Reading<DescribedValue> Query::read_frame(SerialDevice& line) {
  const Result<std::string> answer = ask_for_frame(line);
  if (!answer) return answer.error();
  if (*answer == request_) return echoed(line);
  return decoded(line, *answer);
}

Unreadable Query::echoed(SerialDevice& line) {
  return {line.error(
      Errc::bad_data, "cannot use an answer", "it echoes the request",
      "switch off the echo of the device or the adapter, or set `echo` of the bus, or set `skip_lines` to 1")};
}

Reading<DescribedValue> Query::decoded(SerialDevice& line, std::string_view answer) {
  detail::LineDecoder& decoder = decoding_->decoder;
  const Result<std::string_view> plain = decoding_->cutter ? decoding_->cutter->plain(answer) : Result(answer);
  const Result<std::string_view> checked = plain ? decoder.checked(*plain) : plain;
  Result<void> done = checked ? Result<void>() : Result<void>(checked.error());
  const bool has_marks = config_.frame && config_.format != LineFormat::binary;
  if (done) done = decoder.decode(has_marks ? decoding_->cutter->body(*checked) : *checked);
  if (!done) {
    const Error& e = done.error();
    return Unreadable{line.error(static_cast<Errc>(e.code.value()), "cannot use an answer",
                                 (e.where.empty() ? "" : e.where + ": ") + e.why, "check `request` and `fields`"),
                      checked && decoder.says_none()};
  }
  return DescribedValue(std::span<const std::byte>(decoder.payload(), decoder.description()->size()));
}

Reading<DescribedValue> Query::read_line(SerialDevice& line) {
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
  if (text == without_end(request_)) return echoed(line);
  return decoded(line, text);
}

}  // namespace rtdata
