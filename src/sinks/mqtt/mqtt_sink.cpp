#include "rtdata/sinks/mqtt.hpp"

#include <mqtt_protocol.h>

#include <algorithm>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "net/mqtt_connection.hpp"
#include "sinks/core/peer_config.hpp"

namespace rtdata {
namespace {

constexpr const char* what = "cannot make mqtt sink";
constexpr std::size_t most_under_way = 1000;  // messages in the library, which it may queue
constexpr std::size_t slot_count = 4096;      // by the lower bits of their numbers
constexpr unsigned last_number = 65535;

detail::MqttOptions options_of(const MqttConfig& config) {
  detail::MqttOptions options{.most_sent = static_cast<int>(most_under_way)};
  if (config.will) options.will = {config.will->topic, config.will->message, config.will->qos, config.will->retain};
  return options;
}

// A broker of MQTT 3.1.1 does not say which packet is too large for it: it ends the connection.
constexpr Duration patience = std::chrono::seconds{1};  // a connection that lasts for this long is a good one
constexpr int most_losses = 3;                          // with the same event, each of a good connection

/// MQTT 5 says that the broker will never take the message. A missing permission is not such a case: it can be given.
bool is_refusal(int reason) {
  return reason >= 0x80 && reason != MQTT_RC_QUOTA_EXCEEDED && reason != MQTT_RC_RECEIVE_MAXIMUM_EXCEEDED &&
         reason != MQTT_RC_PACKET_ID_IN_USE && reason != MQTT_RC_SERVER_BUSY && reason != MQTT_RC_NOT_AUTHORIZED;
}

class Publishing final : public detail::MqttConnection {
 public:
  Publishing(Loop& loop, const MqttConfig& config)
      : MqttConnection(loop, "sink " + config.sink.name, config.broker, options_of(config)),
        config_(config),
        good_at_(loop, [this] {
          is_on_trial_ = false;
          work();
        }) {
    slots_.resize(slot_count);
  }

  void send(const Parcel& parcel, Answer answer) {
    Progress progress;
    if (const auto found = begun_.find(&parcel); found != begun_.end()) {
      if (found->second.is_of(parcel)) progress = std::move(found->second);
      begun_.erase(found);
    }
    progress.begin(parcel);
    under_way_.push_back({++parcels_, &parcel, std::move(answer), std::move(progress)});
    if (is_idle()) {
      connect();
    } else {
      work();
    }
  }
  void cancel() {
    keep_progress(std::exchange(under_way_, {}));
    drop();
  }
  void end() {
    under_way_.clear();
    good_at_.close();
    MqttConnection::end();
  }

 private:
  /// The progress of a parcel, so that only the rest is sent again.
  struct Progress {
    const SlotInfo* info = nullptr;  // of its first row
    std::uint64_t sequence = 0;      // the same
    std::vector<bool> is_done;       // by row
    std::vector<std::pair<std::size_t, Error>> refused;
    std::size_t unheard = 0;  // of these: taken, and thrown away

    bool is_of(const Parcel& parcel) const noexcept {
      const Parcel::Row& first = parcel.rows().front();
      return info == first.info && sequence == first.sequence && is_done.size() == parcel.rows().size();
    }
    void begin(const Parcel& parcel) {
      info = parcel.rows().front().info;
      sequence = parcel.rows().front().sequence;
      is_done.resize(parcel.rows().size());
    }
    void refuse(std::size_t row, Error why) {
      is_done[row] = true;
      refused.emplace_back(row, std::move(why));
    }
  };
  struct UnderWay {
    std::uint64_t id;
    const Parcel* parcel;
    Answer answer;
    Progress progress;
    std::size_t next = 0;     // row to be given to the library
    std::size_t waiting = 0;  // rows that are with it
    std::optional<Error> forbidden = {};
    bool is_done() const noexcept { return waiting == 0 && next == parcel->rows().size(); }
  };
  /// A message that is with the library.
  struct Message {
    int number = 0;  // 0: none
    std::uint64_t parcel = 0;
    std::size_t row = 0;
  };

  bool has_more() const override {
    if (is_on_trial_ || (is_careful_ && messages_ > 0)) return false;
    if (messages_ >= most_under_way || slot_of(next_number()).number != 0) return false;
    return std::any_of(under_way_.begin(), under_way_.end(),
                       [](const UnderWay& one) { return one.next < one.parcel->rows().size(); });
  }
  int next_number() const noexcept { return static_cast<int>(static_cast<unsigned>(last_number_) % last_number + 1); }
  const Message& slot_of(int number) const noexcept { return slots_[static_cast<unsigned>(number) % slot_count]; }
  Message& slot_of(int number) noexcept { return slots_[static_cast<unsigned>(number) % slot_count]; }

  void connected() override {
    is_good_ = true;
    is_on_trial_ = is_careful_;
    if (is_careful_) good_at_.start(patience);
  }

  int give(std::size_t& left) override {
    if (is_on_trial_) return MOSQ_ERR_SUCCESS;
    for (UnderWay& one : under_way_) {
      while (one.next < one.parcel->rows().size()) {
        if (one.progress.is_done[one.next]) {
          ++one.next;
          continue;
        }
        if (is_careful_ && messages_ > 0) return MOSQ_ERR_SUCCESS;
        if (left == 0 || messages_ >= most_under_way) return MOSQ_ERR_SUCCESS;
        const int expected = next_number();
        if (slot_of(expected).number != 0) return MOSQ_ERR_SUCCESS;  // an old one is unanswered
        const std::size_t row = one.next++;
        --left;
        const auto bytes = one.parcel->bytes(row);
        // Before the call, which may tell at once that it is done.
        slot_of(expected) = {expected, one.id, row};
        ++messages_;
        ++one.waiting;
        int number = 0;
        const int status = mosquitto_publish_v5(handle(), &number, topic_of(one.parcel->rows()[row]).c_str(),
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
        one.progress.refuse(row, {Errc::bad_data, "cannot be sent by MQTT", topic_of(one.parcel->rows()[row]),
                                  client_->reason(status), "check the topic and the size of the event"});
      }
    }
    return MOSQ_ERR_SUCCESS;
  }

  /// Processes the library's notifications after it has returned.
  void take() override {
    const auto client = client_;
    bool is_short_of_room = false, is_unheard = false;
    int why = 0;
    for (const auto& [number, given] : client->published) {
      const int reason = given;  // for a lambda
      Message& message = slot_of(number);
      if (message.number != number) continue;
      const Message ended = std::exchange(message, {});
      --messages_;
      const auto of = std::find_if(under_way_.begin(), under_way_.end(),
                                   [&](const UnderWay& one) { return one.id == ended.parcel; });
      if (of == under_way_.end()) continue;
      --of->waiting;
      const auto refusal = [&](const char* advice) {
        return Error{Errc::not_permitted, "the broker refuses the event", topic_of(of->parcel->rows()[ended.row]),
                     mosquitto_reason_string(reason), advice};
      };
      if (reason == MQTT_RC_NOT_AUTHORIZED) {
        if (!of->forbidden)
          of->forbidden = refusal(
              "permit it in the broker's access control, or remove the topic from `topics`; events wait");
      } else if (is_refusal(reason)) {
        of->progress.refuse(ended.row, refusal("check the topic and what the broker's log says"));
      } else if (reason >= 0x80) {
        is_short_of_room = true;
        why = reason;
      } else if (reason == MQTT_RC_NO_MATCHING_SUBSCRIBERS && config_.wait_for_subscriber) {
        is_unheard = true;
      } else {
        losses_ = 0;
        if (reason == MQTT_RC_NO_MATCHING_SUBSCRIBERS && !config_.retain) {
          ++of->progress.unheard;
          of->progress.refuse(ended.row, {Errc::disconnected, "the broker has discarded the event",
                                          topic_of(of->parcel->rows()[ended.row]), "there was no subscriber",
                                          "subscribe with a persistent session, or set `wait_for_subscriber` or "
                                          "`retain`"});
        } else {
          of->progress.is_done[ended.row] = true;
        }
      }
    }
    client->published.clear();
    if (is_short_of_room) return fail(Errc::busy, "the broker accepts no more events", mosquitto_reason_string(why));
    if (is_unheard) return fail(Errc::busy, "there is no subscriber", "events wait until there is one");
    for (bool is_any = true; is_any && client_ == client;) {
      const auto done = std::find_if(under_way_.begin(), under_way_.end(),
                                     [](const UnderWay& one) { return one.is_done(); });
      is_any = done != under_way_.end();
      if (!is_any) break;
      UnderWay one = std::move(*done);
      under_way_.erase(done);
      if (one.forbidden) {
        begun_.insert_or_assign(one.parcel, std::move(one.progress));
        one.answer.again(std::move(*one.forbidden), config_.sink.retry_longest);
        continue;
      }
      is_careful_ = is_careful_ && one.progress.refused.size() > one.progress.unheard;
      for (auto& [row, error] : one.progress.refused) one.answer.refuse(row, std::move(error));
      one.answer.acknowledge();
    }
  }
  void keep_progress(std::vector<UnderWay> ended) {
    for (UnderWay& one : ended) begun_.insert_or_assign(one.parcel, std::move(one.progress));
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
    if (const auto with = std::exchange(lost_with_, {})) look_at_loss(*with, error);
    std::vector<UnderWay> ended = std::exchange(under_way_, {});
    std::vector<Answer> answers;
    for (UnderWay& one : ended) answers.push_back(std::move(one.answer));
    keep_progress(std::move(ended));
    for (Answer& answer : answers) answer.again(error);
  }
  /// A good connection was lost while these messages were unanswered. Sent one by one, that of an event which the
  /// broker cannot take shows.
  void look_at_loss(const std::vector<Message>& with, const Error& error) {
    if (is_v5() || error.code != make_error_code(Errc::disconnected)) return;
    if (!is_careful_) {
      is_careful_ = ++losses_ >= most_losses - 1;
      return;
    }
    const auto of = std::find_if(under_way_.begin(), under_way_.end(),
                                 [&](const UnderWay& one) { return one.id == with.front().parcel; });
    if (with.size() != 1 || of == under_way_.end()) return;
    const std::pair key{of->parcel, with.front().row};
    suspected_ = std::exchange(suspect_, key) == key ? suspected_ + 1 : 1;
    if (suspected_ < most_losses) return;
    of->progress.refuse(
        with.front().row,
        {Errc::does_not_fit, "the broker does not take the event", topic_of(of->parcel->rows()[with.front().row]),
         "it has ended " + std::to_string(most_losses) + " connections on which nothing else was sent",
         "MQTT 3.1.1 gives no reason; most probably the event, of " +
             std::to_string(of->parcel->bytes(with.front().row).size()) +
             " bytes, is larger than the broker's packet limit"});
    suspected_ = 0;
  }
  void forget() override {
    if (std::exchange(is_good_, false) && !is_on_trial_ && messages_ > 0) {
      lost_with_.emplace();
      for (const Message& message : slots_)
        if (message.number != 0) lost_with_->push_back(message);
    } else {
      lost_with_.reset();
    }
    good_at_.stop();
    is_on_trial_ = false;
    std::fill(slots_.begin(), slots_.end(), Message{});
    messages_ = 0;
    last_number_ = 0;
  }

  const MqttConfig config_;
  std::vector<UnderWay> under_way_;
  std::map<const Parcel*, Progress> begun_;  // and are to be sent again
  std::uint64_t parcels_ = 0;
  std::vector<Message> slots_;
  std::size_t messages_ = 0;  // in them
  int last_number_ = 0;
  // MQTT 3.1.1: the event for which the broker ends connections.
  Timer good_at_;
  bool is_good_ = false;      // the broker has accepted the connection
  bool is_on_trial_ = false;  // whether it lasts, before anything is sent on it
  bool is_careful_ = false;   // one message at a time
  int losses_ = 0;            // of connections, since a message was confirmed
  std::optional<std::vector<Message>> lost_with_;
  std::pair<const Parcel*, std::size_t> suspect_{};
  int suspected_ = 0;
  std::vector<std::pair<const SlotInfo*, std::string>> topics_;  // by slot
};

class MqttSender final : public Sender {
 public:
  MqttSender(MqttConfig config, std::unique_ptr<Codec> codec) : config_(std::move(config)), codec_(std::move(codec)) {}

  SendingConfig sending() const override { return config_.sending; }
  void begin(Loop& loop) override { connection_ = std::make_shared<Publishing>(loop, config_); }
  void send(const Parcel& parcel, Answer answer) override { connection_->send(parcel, std::move(answer)); }
  void cancel() override { connection_->cancel(); }
  void end() override {
    const auto connection = std::move(connection_);
    connection->end();
  }
  Result<void> encode(const Record& record, std::vector<std::byte>& out) override {
    const std::size_t before = out.size();
    auto encoded = codec_->encode(record.keyed_view(), out);
    // A message needs no line end.
    if (encoded && codec_->is_text() && out.size() > before && out.back() == std::byte{'\n'}) out.pop_back();
    return encoded;
  }

 private:
  const MqttConfig config_;
  const std::unique_ptr<Codec> codec_;  // lane
  std::shared_ptr<Publishing> connection_;
};

MqttConfig named(MqttConfig config) {
  if (config.sink.name.empty()) config.sink.name = "mqtt";
  return config;
}

/// Why missing subscribers cannot be detected; empty: they can.
std::string obstacle_of_waiting(const MqttConfig& config) {
  if (!config.wait_for_subscriber) return {};
  if (config.qos == 0) return "with qos 0 the broker confirms no event: set qos 1";
  // The broker says so in its first answer, but the library does not pass that on.
  if (config.qos == 2) return "with qos 2 the broker does not report that there is no subscriber: set qos 1";
  return config.broker.version == MqttVersion::v311 ? "only version 5 of MQTT reports that there is no subscriber" : "";
}

/// The mistake in a topic with marks; empty: none.
std::string obstacle_of_pattern(const std::string& topic) {
  for (std::size_t begin = topic.find('{'); begin != std::string::npos; begin = topic.find('{', begin + 1)) {
    const std::size_t end = topic.find_first_of("{}/", begin + 1);
    if (end == std::string::npos || topic[end] != '}') continue;
    const std::string mark = topic.substr(begin, end + 1 - begin);
    if (mark != "{topic}" && mark != "{origin}") return "there is no " + mark + ", only {topic} and {origin}";
  }
  return detail::obstacle_of_topic(topic);
}

std::vector<detail::SettingMistake> mistakes_of(const MqttConfig& config) {
  std::vector<detail::SettingMistake> mistakes = detail::mistakes_of(config.broker);
  const auto add = [&](const char* key, std::string why) {
    if (!why.empty()) mistakes.push_back({key, std::move(why)});
  };
  add("format", detail::obstacle_of_format(config.format));
  add("topic", obstacle_of_pattern(config.topic));
  if (config.will) add("will.topic", detail::obstacle_of_topic(config.will->topic));
  add("wait_for_subscriber", obstacle_of_waiting(config));
  if (config.qos > 2 || (config.will && config.will->qos > 2)) add("qos", "it is 0, 1 or 2");
  return mistakes;
}

std::unique_ptr<Sender> sender_of(const MqttConfig& config, const CodecRegistry& formats) {
  detail::libmosquitto.load().or_throw();
  for (const detail::SettingMistake& mistake : mistakes_of(config)) throw mistake.error(what);
  return std::make_unique<MqttSender>(named(config), detail::codec_to_send(what, config.format, formats));
}

}  // namespace

void check_config(const MqttConfig& config, const ConfigItem& item, Problems& problems) {
  if (!detail::add_not_installed(detail::libmosquitto.load(), item, problems)) return;
  detail::add_mistakes(mistakes_of(config), item, problems);
}

MqttSink::MqttSink(Loop& loop, MqttConfig config, const CodecRegistry& formats)
    : Sink(loop, named(config).sink, sender_of(config, formats)) {}

}  // namespace rtdata
