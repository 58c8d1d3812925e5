// A connection to an MQTT broker: libmosquitto on the loop. Connecting and looking up names happen on a lane.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "data/setting_mistake.hpp"
#include "net/libmosquitto.hpp"
#include "net/mqtt_inlet.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"
#include "rtdata/net/mqtt.hpp"

namespace rtdata::detail {

/// A client of the library for one connection; its state ends with the connection.
struct MqttClient {
  struct Message {
    std::string topic, payload;
    bool is_retained = false;
  };
  mosquitto* handle = nullptr;
  std::unique_ptr<MqttInlet> inlet;            // by which it reads
  std::optional<int> answer;                   // of the broker to the connection
  std::optional<int> goodbye;                  // why the broker has ended it
  std::vector<std::pair<int, int>> published;  // number and reason
  std::optional<std::vector<int>> granted;     // the answer to a subscription, for each of its filters
  std::vector<Message> messages;               // that came; the first `arrived` of them, the others keep their memory
  std::size_t arrived = 0;
  std::size_t longest_message = 0;  // of a longer one, one byte more is kept
  std::string trouble;              // the library's description of it
  bool is_encrypted = false;
  bool verifies = false;  // the broker's certificate
  long distrust = 0;      // what is wrong with that: X509_V_ERR_...
  std::string key_password;

  MqttClient() = default;
  MqttClient(const MqttClient&) = delete;
  MqttClient& operator=(const MqttClient&) = delete;
  ~MqttClient();
  std::string reason(int status) const;
  /// Why there is no connection, after a call of the library that failed.
  Error failure(int status, bool is_connected) const;
};

/// How the broker must handle the connection.
struct MqttOptions {
  struct Will {
    std::string topic, message;
    std::uint8_t qos = 0;
    bool retain = false;
  };
  std::optional<Will> will = {};
  Duration session{0};    ///< how long the broker keeps messages after a disconnect; 0: not at all
  int most_sent = 0;      ///< unanswered messages to the broker; 0: the library's default
  int most_received = 0;  ///< the same, to us
  std::optional<std::size_t> longest_message = {};  ///< longest accepted message; empty: it accepts no messages
};

std::uint16_t port_of(const MqttBroker& broker) noexcept;
/// Why messages cannot be published there; empty: they can.
std::string obstacle_of_topic(const std::string& topic);
/// Settings that cannot be right, or that MQTT cannot represent.
std::vector<SettingMistake> mistakes_of(const MqttBroker& broker);
/// A topic that both filters match (the broker sends such a message twice); empty: there is none.
std::string topic_of_both(std::string_view one, std::string_view other);

/// Makes the client's handle and connects it: blocks, as looking up names does. Status: the library's. The broker's
/// answers come through the library's loop. The caller handles SIGPIPE.
int connect_client(MqttClient& client, const MqttBroker& broker, const MqttOptions& options, bool is_v5);
/// True if the broker refuses the connection because it does not support MQTT 5.
bool is_older(int answer) noexcept;
/// True if it may have ended the connection because it does not support MQTT 5: old brokers hang up on an unknown
/// version.
bool may_be_older(int status) noexcept;
/// For display.
std::string refusal_of(int answer, bool is_v5);

class MqttConnecting;

/// Shared, because callbacks may destroy the owner. All on the loop's thread.
class MqttConnection : public std::enable_shared_from_this<MqttConnection> {
 public:
  MqttConnection(Loop& loop, std::string name, const MqttBroker& broker, MqttOptions options);
  virtual ~MqttConnection();
  MqttConnection(const MqttConnection&) = delete;
  MqttConnection& operator=(const MqttConnection&) = delete;

 protected:
  static constexpr std::size_t most_in_a_turn = 256;  // messages given to the library, or taken from it

  // ---- what a kind of connection does
  /// The broker has accepted the connection.
  virtual void connected() {}
  /// Passes pending messages to the library and counts them down. Returns the library's status.
  virtual int give(std::size_t& left) = 0;
  /// Processes notifications of the library. May end the connection.
  virtual void take() = 0;
  /// True if `give` has something to pass.
  virtual bool has_more() const = 0;
  /// The connection was lost or could not be made; it is already closed.
  virtual void lost(const Error& error) = 0;
  /// It is being closed.
  virtual void forget() {}
  virtual bool may_read() const { return true; }
  virtual bool may_write() const { return true; }

  bool is_idle() const noexcept { return client_ == nullptr && job_ == nullptr; }
  void connect();
  /// Lets the library do its work and processes the results; repeats if answers allow new parcels.
  void work();
  void fail(Errc code, const char* failed, std::string why, const char* advice = "the program connects to it again");
  /// `where` is filled in.
  void fail(Error error);
  void drop();
  /// Disconnects properly.
  void leave();
  /// The same, permanently.
  void end();

  std::string peer() const;
  bool is_connected() const noexcept { return is_connected_; }
  bool is_v5() const noexcept { return is_v5_; }
  mosquitto* handle() const noexcept { return client_->handle; }
  Loop& loop() const noexcept { return loop_; }
  std::shared_ptr<MqttClient> client_;

 private:
  void connecting_ended(MqttConnecting& job, LaneJob::Outcome outcome);
  int call_library(std::size_t& left);
  bool take_answer(int status);
  bool try_older();
  void watch();
  void end_lane() noexcept;

  const MqttBroker broker_;
  const MqttOptions options_;
  Loop& loop_;
  const std::string name_;
  bool is_v5_;
  bool has_tried_older_ = false;
  Timer more_;    // continues in the next turn of the loop
  Timer upkeep_;  // the library's timed work
  std::unique_ptr<Lane> lane_;
  std::shared_ptr<MqttConnecting> job_;     // the job whose result is needed
  std::weak_ptr<MqttConnecting> last_job_;  // also a job that is abandoned and still runs
  int fd_ = -1;
  FdWatch watch_;
  bool is_connected_ = false;
  bool is_readable_ = false;
  bool is_working_ = false;
  unsigned watched_ = 0;
};

}  // namespace rtdata::detail
