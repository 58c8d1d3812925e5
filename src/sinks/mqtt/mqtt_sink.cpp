#include "rtdata/sinks/mqtt.hpp"

#include <mqtt_protocol.h>

#include <algorithm>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "io/mqtt_connection.hpp"
#include "rtdata/data/config_item.hpp"
#include "sinks/core/peer_config.hpp"

namespace rtdata {
namespace {

constexpr const char* what = "cannot make mqtt sink";
constexpr std::size_t most_under_way = 1000;  // messages in the library, which it may queue
constexpr std::size_t slot_count = 4096;      // by the lower bits of their numbers
constexpr unsigned last_number = 65535;

MqttBroker broker_of(const MqttConfig& config) {
  return {config.host,     config.port, config.version,   config.client_id,      config.user,
          config.password, config.tls,  config.keepalive, config.connect_timeout};
}

detail::MqttOptions options_of(const MqttConfig& config) {
  detail::MqttOptions options{.most_sent = static_cast<int>(most_under_way)};
  if (config.will) options.will = {config.will->topic, config.will->message, config.will->qos, config.will->retain};
  return options;
}

/// Of MQTT 5: the message will never be taken.
bool is_refusal(int reason) {
  return reason >= 0x80 && reason != MQTT_RC_QUOTA_EXCEEDED && reason != MQTT_RC_RECEIVE_MAXIMUM_EXCEEDED &&
         reason != MQTT_RC_PACKET_ID_IN_USE && reason != MQTT_RC_SERVER_BUSY;
}

class Publishing final : public detail::MqttConnection {
 public:
  Publishing(Loop& loop, const MqttConfig& config, bool is_text)
      : MqttConnection(loop, "sink " + config.sink.name, broker_of(config), options_of(config)),
        config_(config),
        is_text_(is_text) {
    slots_.resize(slot_count);
  }

  void send(const Parcel& parcel, Answer answer) {
    under_way_.push_back({++parcels_, &parcel, std::move(answer)});
    if (is_idle()) {
      connect();
    } else {
      work();
    }
  }
  void cancel() {
    under_way_.clear();
    drop();
  }
  void end() {
    under_way_.clear();
    MqttConnection::end();
  }

 private:
  struct UnderWay {
    std::uint64_t id;
    const Parcel* parcel;
    Answer answer;
    std::size_t next = 0;     // row to be given to the library
    std::size_t waiting = 0;  // rows that are with it
  };
  /// A message that is with the library.
  struct Message {
    int number = 0;  // 0: none
    std::uint64_t parcel = 0;
    std::size_t row = 0;
  };

  bool has_more() const override {
    if (messages_ >= most_under_way || slot_of(next_number()).number != 0) return false;
    return std::any_of(under_way_.begin(), under_way_.end(),
                       [](const UnderWay& one) { return one.next < one.parcel->rows().size(); });
  }
  int next_number() const noexcept { return static_cast<int>(static_cast<unsigned>(last_number_) % last_number + 1); }
  const Message& slot_of(int number) const noexcept { return slots_[static_cast<unsigned>(number) % slot_count]; }
  Message& slot_of(int number) noexcept { return slots_[static_cast<unsigned>(number) % slot_count]; }

  int give(std::size_t& left) override {
    for (UnderWay& one : under_way_) {
      while (one.next < one.parcel->rows().size()) {
        if (left == 0 || messages_ >= most_under_way) return MOSQ_ERR_SUCCESS;
        const int expected = next_number();
        if (slot_of(expected).number != 0) return MOSQ_ERR_SUCCESS;  // an old one is unanswered
        const std::size_t row = one.next++;
        --left;
        auto bytes = one.parcel->bytes(row);
        if (is_text_ && !bytes.empty() && bytes.back() == std::byte{'\n'}) bytes = bytes.first(bytes.size() - 1);
        // Before the call, which may tell at once that it is done.
        slot_of(expected) = {expected, one.id, row};
        ++messages_;
        ++one.waiting;
        int number = 0;
        const int status = ::mosquitto_publish_v5(handle(), &number, topic_of(one.parcel->rows()[row]).c_str(),
                                                  static_cast<int>(bytes.size()), bytes.data(), config_.qos,
                                                  config_.retain, nullptr);
        if (number != 0) last_number_ = number;
        if (status == MOSQ_ERR_SUCCESS && number == expected) continue;
        slot_of(expected) = {};
        --messages_;
        --one.waiting;
        if (status == MOSQ_ERR_SUCCESS) return MOSQ_ERR_PROTOCOL;  // not as the library numbers its messages
        if (status != MOSQ_ERR_INVAL && status != MOSQ_ERR_PAYLOAD_SIZE && status != MOSQ_ERR_OVERSIZE_PACKET &&
            status != MOSQ_ERR_MALFORMED_UTF8)
          return status;
        one.answer.refuse(row, {Errc::bad_data, "cannot be sent by MQTT", topic_of(one.parcel->rows()[row]),
                                client_->reason(status), "look at the topic and the size of the event"});
      }
    }
    return MOSQ_ERR_SUCCESS;
  }

  /// What the library has told, once it has returned.
  void take() override {
    const auto client = client_;
    bool is_short_of_room = false;
    int why = 0;
    for (const auto& [number, reason] : client->published) {
      Message& message = slot_of(number);
      if (message.number != number) continue;
      const Message ended = std::exchange(message, {});
      --messages_;
      const auto of = std::find_if(under_way_.begin(), under_way_.end(),
                                   [&](const UnderWay& one) { return one.id == ended.parcel; });
      if (of == under_way_.end()) continue;
      --of->waiting;
      if (is_refusal(reason)) {
        of->answer.refuse(ended.row,
                          {Errc::not_permitted, "the broker refuses the event", topic_of(of->parcel->rows()[ended.row]),
                           ::mosquitto_reason_string(reason), "look at its access control"});
      } else if (reason >= 0x80) {
        is_short_of_room = true;
        why = reason;
      }
    }
    client->published.clear();
    if (is_short_of_room) return fail(Errc::busy, "the broker takes no more", ::mosquitto_reason_string(why));
    for (bool is_any = true; is_any && client_ == client;) {
      const auto done = std::find_if(under_way_.begin(), under_way_.end(), [](const UnderWay& one) {
        return one.waiting == 0 && one.next == one.parcel->rows().size();
      });
      is_any = done != under_way_.end();
      if (!is_any) break;
      Answer answer = std::move(done->answer);
      under_way_.erase(done);
      answer.acknowledge();
    }
  }

  const std::string& topic_of(const Parcel::Row& row) {
    if (topics_.size() <= row.slot) topics_.resize(row.slot + 1);
    auto& [info, topic] = topics_[row.slot];
    if (info == row.info) return topic;
    info = row.info;
    topic = config_.topic;
    std::string origin = info->origin;
    std::replace_if(
        origin.begin(), origin.end(), [](char c) { return c == '+' || c == '#' || c == '\0'; }, '_');
    replace(topic, "{topic}", info->topic);
    replace(topic, "{origin}", origin);
    return topic;
  }
  static void replace(std::string& in, std::string_view mark, const std::string& by) {
    for (std::size_t at = in.find(mark); at != std::string::npos; at = in.find(mark, at + by.size()))
      in.replace(at, mark.size(), by);
  }

  void lost(const Error& error) override {
    auto ended = std::move(under_way_);
    under_way_.clear();
    for (UnderWay& one : ended) one.answer.again(error);
  }
  void forget() override {
    std::fill(slots_.begin(), slots_.end(), Message{});
    messages_ = 0;
    last_number_ = 0;
  }

  const MqttConfig config_;
  const bool is_text_;
  std::vector<UnderWay> under_way_;
  std::uint64_t parcels_ = 0;
  std::vector<Message> slots_;
  std::size_t messages_ = 0;  // in them
  int last_number_ = 0;
  std::vector<std::pair<const SlotInfo*, std::string>> topics_;  // by slot
};

class MqttSender final : public Sender {
 public:
  MqttSender(MqttConfig config, std::unique_ptr<Codec> codec) : config_(std::move(config)), codec_(std::move(codec)) {}

  SendingConfig sending() const override { return config_.sending; }
  void begin(Loop& loop) override { connection_ = std::make_shared<Publishing>(loop, config_, codec_->is_text()); }
  void send(const Parcel& parcel, Answer answer) override { connection_->send(parcel, std::move(answer)); }
  void cancel() override { connection_->cancel(); }
  void end() override {
    const auto connection = std::move(connection_);
    connection->end();
  }
  Result<void> encode(const Record& record, std::vector<std::byte>& out) override {
    return codec_->encode(record.keyed_view(), out);
  }

 private:
  const MqttConfig config_;
  const std::unique_ptr<Codec> codec_;  // lane
  std::shared_ptr<Publishing> connection_;
};

/// Why messages cannot go there; empty: they can.
std::string obstacle_of_topic(const std::string& topic) {
  if (topic.empty()) return "there is no topic";
  if (topic.find_first_of(std::string_view("+#\0", 3)) != std::string::npos)
    return "a topic of MQTT to publish to has no + and no #";
  return topic.size() > 1000 ? "it is too long" : "";
}

MqttConfig named(MqttConfig config) {
  if (config.sink.name.empty()) config.sink.name = "mqtt";
  return config;
}

std::unique_ptr<Sender> sender_of(const MqttConfig& config, const CodecRegistry& formats) {
  detail::require_host(what, config.host, detail::port_of(broker_of(config)));
  const auto require = [](const std::string& where, const std::string& why) {
    if (!why.empty()) throw SetupError({Errc::bad_argument, what, where, why, ""});
  };
  require(config.topic, obstacle_of_topic(config.topic));
  if (config.will) require(config.will->topic, obstacle_of_topic(config.will->topic));
  if (config.qos > 2 || (config.will && config.will->qos > 2)) require("qos", "it is 0, 1 or 2");
  require("tls", detail::obstacle_of_tls(config.tls));
  return std::make_unique<MqttSender>(named(config), detail::codec_to_send(what, config.format, formats));
}

}  // namespace

void check_config(const MqttConfig& config, const ConfigItem& item, Problems& problems) {
  detail::add_obstacle(detail::obstacle_of_host(config.host), "host", item, problems);
  detail::add_obstacle(detail::obstacle_of_format(config.format), "format", item, problems);
  detail::add_obstacle(obstacle_of_topic(config.topic), "topic", item, problems);
  if (config.will) detail::add_obstacle(obstacle_of_topic(config.will->topic), "will", item, problems);
  detail::add_obstacle(detail::obstacle_of_tls(config.tls), "tls", item, problems);
}

MqttSink::MqttSink(Loop& loop, MqttConfig config, const CodecRegistry& formats)
    : Sink(loop, named(config).sink, sender_of(config, formats)) {}

}  // namespace rtdata
