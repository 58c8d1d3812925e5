#include <mqtt_protocol.h>

#include <algorithm>
#include <utility>

#include "net/host_lookup.hpp"
#include "net/mqtt_connection.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/sensors/mqtt.hpp"
#include "sensors/core/stream_node.hpp"
#include "sensors/lines/line_config.hpp"
#include "sensors/lines/line_decoder.hpp"

namespace rtdata {
namespace detail {
namespace {

constexpr int most_unanswered = 1000;  // messages that the broker sends before it waits for an answer
constexpr Duration look_after = std::chrono::milliseconds{5};
constexpr const char* topic_key = "$topic";
constexpr const char* retained_key = "$retained";

LineConfig line_config(const MqttSensorConfig& config) {
  LineConfig line;
  line.format = config.format;
  line.fields = config.fields;
  line.separator = config.separator;
  line.pattern = config.pattern;
  line.only = config.only;
  line.unreadable_if = config.unreadable_if;
  line.comment.clear();
  line.max_line = config.max_message;
  return line;
}

LineDecoder decoder_of(const MqttSensorConfig& config) {
  return LineDecoder(line_config(config), {{topic_key, retained_key}, "message"});
}

MqttOptions options_of(const MqttSensorConfig& config) {
  return {.session = config.session, .most_received = most_unanswered, .longest_message = config.max_message};
}

/// Null: there is none.
const Recorder* sink_of(LoopCore& loop, const std::string& name) {
  for (const Recorder* recorder : loop.runtime.recorders)
    if (recorder->name() == name) return recorder;
  return nullptr;
}

}  // namespace

class MqttNode;

class Subscribing final : public MqttConnection {
 public:
  Subscribing(MqttNode& node, Loop& loop, const std::string& name, const MqttSensorConfig& config)
      : MqttConnection(loop, name, config.broker, options_of(config)), node_(&node), config_(config) {}
  void open() { connect(); }
  void goodbye() {
    if (!is_idle()) leave();
  }
  /// The node is closed.
  void close() {
    node_ = nullptr;
    end();
  }
  void go_on() { work(); }
  std::string server() const { return peer(); }
  void give_up(const Error& error);

 private:
  void connected() override {
    std::vector<char*> filters;
    for (const std::string& topic : config_.topics) filters.push_back(const_cast<char*>(topic.c_str()));
    const int options = is_v5() && config_.retained == MqttRetained::skip ? MQTT_SUB_OPT_SEND_RETAIN_NEVER : 0;
    const int status = mosquitto_subscribe_multiple(handle(), nullptr, static_cast<int>(filters.size()), filters.data(),
                                                    config_.qos, options, nullptr);
    if (status != MOSQ_ERR_SUCCESS) fail(Errc::disconnected, "cannot subscribe", client_->reason(status));
  }
  int give(std::size_t&) override { return MOSQ_ERR_SUCCESS; }
  bool has_more() const override { return false; }
  void take() override;
  void take_granted(const std::vector<int>& granted);
  void lost(const Error& error) override;
  bool may_read() const override;
  bool may_write() const override { return may_read(); }

  MqttNode* node_;
  const MqttSensorConfig config_;
};

class MqttNode final : public StreamNode {
 public:
  MqttNode(LoopCore& loop, const FeedConfig& feed, MqttSensorConfig config, LineDecoder decoder)
      : StreamNode(loop, feed, described_type(decoder.description()),
                   {config.silence, config.retry_first, config.retry_longest}),
        config_(std::move(config)),
        decoder_(std::move(decoder)),
        connection_(std::make_shared<Subscribing>(*this, loop.face, object_name(), config_)),
        answer_(loop.face, [this] { give_up_waiting(); }),
        stored_(loop.face, [this] { look_whether_stored(); }) {}

  void start() override {
    if (!is_open() || is_running()) return;
    begin();
    open_stream();
  }
  std::optional<SensorLoad> load() const override {
    return SensorLoad{origin_.name, Duration{0}, {}, read_time(config_)};
  }

  // ---- from the connection
  void subscribed(std::string refused) {
    Call call(*this);
    answer_.stop();
    refused_ = std::move(refused);
    opened();
    if (refused_.empty()) {
      set_healthy();
    } else {
      degrade(refusal(refused_));
    }
  }
  void was_lost(const Error& error) {
    if (is_open() && is_running()) lose(error, is_there() ? loop()->now() : began_);
  }
  /// False: the connection has been replaced or closed.
  bool take_messages(MqttClient& client) {
    if (client.arrived == 0) return true;
    Call call(*this);
    const unsigned connection = connections_;
    heard();
    time_ = loop()->runtime.event_time(heard_at());
    const std::size_t count = std::exchange(client.arrived, 0);
    for (std::size_t i = 0; i < count; ++i) {
      take_message(client.messages[i]);
      if (!is_open() || connections_ != connection) return false;
    }
    if (!config_.stored_by.empty()) hold();
    return true;
  }
  bool is_holding() const noexcept { return is_holding_; }
  static Error refusal(const std::string& what) {
    return {Errc::not_permitted, "the broker refuses a subscription", what, "its answer says so",
            "check its access control and `topics`"};
  }

 private:
  void open_stream() override {
    began_ = loop()->now();
    if (!is_all_stored()) return lose(not_stored(), began_);
    is_holding_ = false;
    answer_.start(config_.broker.connect_timeout);
    connection_->open();
  }
  void close_stream() noexcept override {
    ++connections_;
    answer_.stop();
    stored_.stop();
    loop()->call_own(object_name(), [&] { connection_->goodbye(); });
    is_holding_ = false;
  }
  /// The connection and its subscriptions are ready.
  bool is_there() const noexcept { return !answer_.is_running(); }
  void give_up_waiting() {
    connection_->give_up({Errc::timed_out, "cannot connect", connection_->server(),
                          "no answer within " + to_string(config_.broker.connect_timeout),
                          "check that it is an MQTT broker"});
  }

  void take_message(const MqttClient::Message& message) {
    if (message.is_retained && config_.retained == MqttRetained::skip) {
      ++origin_.counts.received;
      ++origin_.counts.repeated;
      return;
    }
    if (message.payload.size() > config_.max_message) {
      return fail({Errc::does_not_fit, "cannot use a message", message.topic,
                   "it is longer than " + std::to_string(config_.max_message) + " bytes",
                   "set a larger `max_message` if messages can be longer"});
    }
    std::string_view text = message.payload;
    while (!decoder_.has_bytes() && (text.ends_with('\n') || text.ends_with('\r'))) text.remove_suffix(1);
    if (!decoder_.is_meant(text)) return leave_out();
    Result<void> done = decoder_.decode(text);
    if (done) done = decoder_.give(topic_key, message.topic);
    if (done) done = decoder_.give(retained_key, message.is_retained ? "true" : "false");
    if (!done) {
      Error error = std::move(done).error();
      error.where = message.topic + (error.where.empty() ? "" : ", " + error.where);
      return fail(error);
    }
    if (take_or_fail(decoder_.payload(), time_) && is_open() && is_running() && refused_.empty()) succeed();
  }

  // ---- answers wait until the sink has stored what came
  void hold() {
    const Recorder* const sink = sink_of(*loop(), config_.stored_by);
    const SinkCounts counts = sink != nullptr ? sink->counts() : SinkCounts{};
    stored_when_ = counts.stored + counts.queued;
    is_holding_ = true;
    held_since_ = loop()->now();
    stored_.start(look_after);
  }
  bool is_all_stored() const {
    if (config_.stored_by.empty()) return true;
    const Recorder* const sink = sink_of(*loop(), config_.stored_by);
    if (sink == nullptr) return false;
    const SinkCounts counts = sink->counts();
    return counts.stored >= stored_when_ || counts.queued == 0;
  }
  void look_whether_stored() {
    Call call(*this);
    if (is_all_stored()) {
      is_holding_ = false;
      connection_->go_on();
    } else if (loop()->now() - held_since_ < config_.broker.keepalive) {
      stored_.start(look_after);
    } else {
      connection_->give_up(not_stored());
    }
  }
  Error not_stored() const {
    return {Errc::busy, "messages wait at the broker", connection_->server(),
            "sink " + config_.stored_by + " has not stored those that came",
            "find out why the sink stores nothing; the broker sends them again"};
  }
  Error silence_error() const override {
    return {Errc::timed_out, "nothing comes", connection_->server(), "no message within " + to_string(config_.silence),
            "check the sender; `silence` is how long it may be silent"};
  }
  void on_close() noexcept override {
    StreamNode::on_close();
    loop()->call_own(object_name(), [&] { connection_->close(); });
    answer_.close();
    stored_.close();
  }

  const MqttSensorConfig config_;
  LineDecoder decoder_;
  const std::shared_ptr<Subscribing> connection_;
  Timer answer_;  // to connecting and subscribing
  Timer stored_;
  MonotonicTime began_{};     // the attempt to connect
  unsigned connections_ = 0;  // that have ended
  std::string refused_;       // the refused subscriptions; empty: none
  Time time_{};
  bool is_holding_ = false;
  std::uint64_t stored_when_ = 0;  // answer when the sink has stored this number
  MonotonicTime held_since_{};
};

void Subscribing::take() {
  if (node_ == nullptr) return;
  const auto client = client_;
  if (const auto granted = std::exchange(client->granted, {})) {
    if (granted->size() != config_.topics.size())
      return fail(Errc::bad_data, "cannot subscribe",
                  "it answers to " + std::to_string(granted->size()) + " of " + std::to_string(config_.topics.size()) +
                      " subscriptions");
    take_granted(*granted);
  }
  if (client_ == client && node_ != nullptr) node_->take_messages(*client);
}

void Subscribing::take_granted(const std::vector<int>& granted) {
  std::string refused;
  std::size_t number = 0;
  for (std::size_t i = 0; i < granted.size() && i < config_.topics.size(); ++i) {
    if (granted[i] < 0x80) continue;
    ++number;
    refused += (refused.empty() ? "" : "; ") + config_.topics[i];
    if (is_v5()) refused += std::string(" (") + mosquitto_reason_string(granted[i]) + ")";
  }
  if (number == granted.size()) {
    drop();
    return lost(MqttNode::refusal(refused));
  }
  node_->subscribed(std::move(refused));
}

void Subscribing::lost(const Error& error) {
  if (node_ != nullptr) node_->was_lost(error);
}
void Subscribing::give_up(const Error& error) {
  drop();
  lost(error);
}
bool Subscribing::may_read() const { return node_ == nullptr || !node_->is_holding(); }

namespace {

/// Why the filter is invalid; empty: it is valid.
std::string obstacle_of_filter(const std::string& filter) {
  constexpr std::string_view share = "$share/";
  std::string rest = filter;
  if (filter == "$share" || filter.starts_with(share)) {
    const std::size_t end = filter.find('/', share.size());
    const bool has_group = end != std::string::npos && end > share.size() && filter.find_first_of("+#") > end;
    if (!has_group || end + 1 == filter.size()) return "a shared subscription is written as $share/GROUP/TOPIC";
    rest = filter.substr(end + 1);
  }
  if (rest.empty()) return "it is empty";
  if (filter.find('\0') != std::string::npos || mosquitto_sub_topic_check(rest.c_str()) != MOSQ_ERR_SUCCESS)
    return "this is not an MQTT topic: + is for a whole level, # for all levels below, at the end";
  return "";
}

std::vector<SettingMistake> mistakes_in(const MqttSensorConfig& config) {
  std::vector<SettingMistake> all = mistakes_of(config.broker);
  const auto add = [&](const char* key, std::string why) { all.push_back({key, std::move(why)}); };
  const std::size_t before = all.size();
  if (config.topics.empty()) add("topics", "there are no topics");
  for (const std::string& topic : config.topics)
    if (std::string why = obstacle_of_filter(topic); !why.empty()) add("topics", "\"" + topic + "\": " + why);
  if (all.size() == before) {
    for (std::size_t i = 0; i < config.topics.size(); ++i) {
      for (std::size_t k = 0; k < i; ++k) {
        const std::string both = topic_of_both(config.topics[k], config.topics[i]);
        if (both.empty()) continue;
        add("topics",
            "\"" + config.topics[k] + "\" and \"" + config.topics[i] + "\" both match \"" + both +
                "\", and the broker sends such a message once for each: remove one, or use a separate sensor for each");
      }
    }
  }
  if (config.qos > 2) add("qos", "it must be 0, 1 or 2");
  if (config.session > Duration{0} && config.broker.client_id.empty())
    add("session", "set `client_id`: the broker recognises this sensor by it");
  if (!config.stored_by.empty() && config.qos != 1)
    add("stored_by", "it works only with `qos` 1: only then the broker waits for a confirmation");
  for (const LineField& field : config.fields) {
    if (field.key == topic_key && field.type != Kind::text)
      add("fields", "\"$topic\" is a text: set its `type` to text");
    if (field.key == retained_key && field.type != Kind::boolean)
      add("fields", "\"$retained\" is true or false: set its `type` to bool");
  }
  try {
    const LineDecoder decoder = decoder_of(config);
  } catch (const SetupError& error) {
    all.push_back(mistake_in_lines(error.error()));
  }
  return all;
}

}  // namespace
}  // namespace detail

Result<std::shared_ptr<const Description>> mqtt_description(const MqttSensorConfig& config) {
  return line_description(config.fields);
}

void check_config(const MqttSensorConfig& config, const ConfigItem& item, Problems& problems) {
  if (!detail::add_not_installed(detail::libmosquitto.load(), item, problems)) return;
  detail::add_mistakes(detail::mistakes_in(config), item, problems);
}

ReadTime read_time(const MqttSensorConfig&) { return {.on_loop = std::chrono::milliseconds{1}}; }

MqttSensor::MqttSensor(Loop& loop, FeedConfig feed, MqttSensorConfig config) {
  detail::libmosquitto.load().or_throw();
  const auto refuse = [&](Errc code, const std::string& why, const char* advice) {
    throw SetupError({code, "cannot use this broker", "sensor " + feed.name, why, advice});
  };
  for (const detail::SettingMistake& mistake : detail::mistakes_in(config))
    refuse(Errc::bad_argument, "`" + mistake.key + "`: " + mistake.why, mistake.advice.c_str());
  if (config.retry_first <= Duration{0}) refuse(Errc::bad_argument, "retry_first is not positive", "such as 100 ms");
  loop.core().check_thread("cannot make sensor", feed.name);
  if (!config.stored_by.empty() && detail::sink_of(loop.core(), config.stored_by) == nullptr)
    refuse(Errc::not_found, "there is no sink " + config.stored_by + " on its loop", "make the sink first");
  const bool starts = config.start;
  auto decoder = detail::decoder_of(config);
  auto* node = new detail::MqttNode(loop.core(), feed, std::move(config), std::move(decoder));
  MqttSensor made(node);
  if (starts) node->start();
  *this = std::move(made);
}

}  // namespace rtdata
