#include "rtdata/sensors/levels.hpp"

#include <algorithm>
#include <cstddef>

#include "sensors/core/source_node.hpp"
#include "sensors/core/sysfs_file.hpp"

namespace rtdata {
namespace {

std::string written(const GpioLevel& level) {
  return level.chip.empty() ? level.line.text : level.chip + ":" + level.line.text;
}

/// The first line that is listed twice; null: none.
const GpioLevel* twice(const std::vector<GpioLevel>& lines) {
  for (auto one = lines.begin(); one != lines.end(); ++one)
    if (std::any_of(lines.begin(), one, [&](const GpioLevel& other) { return written(other) == written(*one); }))
      return &*one;
  return nullptr;
}

/// The lines of one opening. On the lane, until it is abandoned.
struct Session {
  Session(const LevelsConfig& config_, std::string consumer_, std::shared_ptr<GpioBackend> backend_)
      : config(config_), consumer(std::move(consumer_)), backend(std::move(backend_)) {}
  const LevelsConfig config;
  const std::string consumer;
  const std::shared_ptr<GpioBackend> backend;
  std::vector<GpioLine> lines = {};

  Result<void> open() noexcept {
    try {
      for (const GpioLevel& level : config.lines) {
        lines.push_back(GpioLine::input({.line = level.line,
                                         .chip = level.chip,
                                         .bias = level.bias,
                                         .active_low = level.active_low,
                                         .consumer = consumer},
                                        backend));
      }
      return {};
    } catch (const SetupError& error) {
      lines.clear();
      return error.error();
    } catch (const std::exception& error) {
      lines.clear();
      return Error{Errc::io_failed, "cannot use the GPIO lines", "", error.what(), ""};
    }
  }
};

class Opening final : public detail::Transaction {
 public:
  explicit Opening(std::shared_ptr<Session> session_) : session(std::move(session_)) {}
  void transact() noexcept override { result = session->open(); }
  const std::shared_ptr<Session> session;
  Result<void> result;
};

class ReadLevels final : public detail::Transaction {
 public:
  explicit ReadLevels(std::shared_ptr<Session> session) : session_(std::move(session)) {
    levels.resize(session_->config.lines.size());
  }
  void transact() noexcept override {
    result = Result<void>();
    if (session_->lines.empty()) result = session_->open();  // the one before it was abandoned
    for (std::size_t i = 0; result && i < session_->lines.size(); ++i) {
      const Result<bool> level = session_->lines[i].read();
      if (!level) result = level.error();
      if (level) levels[i] = std::byte{*level};
    }
  }
  void close() noexcept override { session_->lines.clear(); }
  std::vector<std::byte> levels;  // as in the event
  Result<void> result;

 private:
  const std::shared_ptr<Session> session_;
};

class LevelsDevice final : public detail::LaneDevice {
 public:
  LevelsDevice(std::string name, LevelsConfig config, std::shared_ptr<GpioBackend> backend)
      : consumer_("rtdata " + name), config_(std::move(config)), backend_(std::move(backend)) {}

  std::shared_ptr<detail::Transaction> make_opening() override { return std::make_shared<Opening>(make_session()); }
  Result<void> take_opening(detail::Transaction& opening) override {
    const auto& done = static_cast<Opening&>(opening);
    session_ = done.result ? done.session : nullptr;
    return done.result;
  }
  std::shared_ptr<detail::Transaction> make_transaction() override {
    auto session = std::exchange(session_, nullptr);
    return std::make_shared<ReadLevels>(session != nullptr ? std::move(session) : make_session());
  }
  detail::Sampled decode(detail::Transaction& transaction, detail::SamplePort& port) override {
    auto& read = static_cast<ReadLevels&>(transaction);
    if (!read.result) return port.fail(read.result.error());
    port.publish(read.levels.data());
    return detail::Sampled::value;
  }
  std::string lane_key() const override { return "GPIO of " + written(config_.lines.front()); }
  Duration give_up_after() const override { return config_.timeout; }
  ReadTime read_time() const override { return rtdata::read_time(config_); }
  Error given_up_error() const override {
    return {Errc::timed_out, "cannot read the GPIO lines", consumer_, "no answer within " + to_string(config_.timeout),
            "check the chip and its bus; `timeout` sets how long to wait"};
  }

 private:
  std::shared_ptr<Session> make_session() const { return std::make_shared<Session>(config_, consumer_, backend_); }

  const std::string consumer_;
  const LevelsConfig config_;
  const std::shared_ptr<GpioBackend> backend_;
  std::shared_ptr<Session> session_;  // opened, for the first read
};

}  // namespace

Result<std::shared_ptr<const Description>> levels_description(const LevelsConfig& config) {
  if (config.lines.empty())
    return Error{Errc::bad_description, "cannot use these GPIO lines", "", "there are no lines",
                 "list them in `lines`"};
  DescriptionBuilder builder("levels");
  for (const GpioLevel& level : config.lines) builder.field(level.name, Kind::boolean);
  return builder.build();
}

void check_config(const LevelsConfig& config, const ConfigItem& item, Problems& problems) {
  const ConfigItem* lines = item.find("lines");
  if (lines == nullptr) lines = &item;
  if (const auto described = levels_description(config); !described)
    problems.add(lines->problem("bad-value", described.error().why + "; " + described.error().advice));
  if (const GpioLevel* again = twice(config.lines))
    problems.add(
        lines->problem("duplicate-place", "the line " + written(*again) + " is listed twice: remove one of them"));
}

ReadTime read_time(const LevelsConfig& config) {
  return {.on_loop = detail::lane_read_on_loop,
          .on_lane = {},
          .lane = config.lines.empty() ? "" : "GPIO of " + written(config.lines.front())};
}

LevelsSensor::LevelsSensor(Loop& loop, SensorConfig sensor, LevelsConfig config, std::shared_ptr<GpioBackend> backend) {
  const auto refuse = [&](std::string why, const char* advice) {
    throw SetupError(
        {Errc::bad_argument, "cannot use these GPIO lines", "sensor " + sensor.name, std::move(why), advice});
  };
  auto type = detail::described_type(levels_description(config).or_throw());
  if (config.timeout <= Duration{0}) refuse("its timeout is not positive", "such as 1 s");
  if (const GpioLevel* again = twice(config.lines)) refuse(written(*again) + " is listed twice", "remove one of them");
  for (const GpioLevel& level : config.lines)
    if (level.line.text.empty()) refuse("`" + level.name + "` has no line", "set `line`, such as \"GPIO17\"");
  auto device = std::make_unique<LevelsDevice>(sensor.name, std::move(config), std::move(backend));
  *this = LevelsSensor(detail::make_sensor(loop, std::move(sensor), std::move(type), std::move(device)));
}

}  // namespace rtdata
