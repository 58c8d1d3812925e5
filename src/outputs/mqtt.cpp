#include "rtdata/outputs/mqtt.hpp"

#include <fcntl.h>
#include <mqtt_protocol.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <condition_variable>
#include <limits>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include "io/no_sigpipe.hpp"
#include "net/host_lookup.hpp"
#include "net/mqtt_connection.hpp"
#include "outputs/set_text.hpp"

namespace rtdata {
namespace {

constexpr const char* cannot_set_mqtt = "cannot set by MQTT";
constexpr int longest_wait_ms = 100;  // for waiting for data
constexpr Duration between_attempts = std::chrono::milliseconds{200};
constexpr Duration goodbye_limit = std::chrono::milliseconds{300};

std::vector<detail::SettingMistake> mistakes_of(const MqttActuatorConfig& config) {
  std::vector<detail::SettingMistake> mistakes = detail::mistakes_of(config.broker);
  const auto add = [&](const char* key, std::string why) {
    if (!why.empty()) mistakes.push_back({key, std::move(why)});
  };
  add("to", detail::obstacle_of_topic(config.to));
  add("qos", config.qos > 2 ? "it must be 0, 1 or 2" : "");
  add("text",
      detail::has_value_mark(config.text) ? "" : "every value would send the same message: write {value} into it");
  return mistakes;
}

}  // namespace

/// The connection, shared with its thread, which may outlive the actuator.
struct MqttActuator::Link {
  Link(MqttActuatorConfig its_config, std::optional<double> safe) : config(std::move(its_config)) {
    if (safe) options.will = {config.to, detail::set_text(config.text, *safe, config.words), config.qos, config.retain};
  }

  Link(const Link&) = delete;
  Link& operator=(const Link&) = delete;
  ~Link() {
    if (wake >= 0) ::close(wake);
  }

  // ---- the connection's thread
  void run() noexcept {
    const detail::NoSigpipe guard;
    try {
      bool is_v5 = config.broker.version != MqttVersion::v311;
      std::unique_lock lock(mutex);
      while (!is_over) {
        lock.unlock();
        connection(is_v5);
        lock.lock();
        changed.wait_for(lock, between_attempts, [this] { return is_over; });
      }
    } catch (const std::exception& thrown) {
      tell(Errc::io_failed, thrown.what());
    }
    const std::lock_guard lock(mutex);
    has_ended = true;
    changed.notify_all();
  }
  /// From connecting to its end.
  void connection(bool& is_v5) {
    detail::MqttClient client;
    int status = detail::connect_client(client, config.broker, options, is_v5);
    if (status != MOSQ_ERR_SUCCESS) return tell(Errc::disconnected, client.reason(status));
    const int socket = ::fcntl(mosquitto_socket(client.handle), F_DUPFD_CLOEXEC, 3);
    if (socket < 0) return tell(Errc::io_failed, std::generic_category().message(errno));
    while (status == MOSQ_ERR_SUCCESS) {
      status = turn(client, socket);
      const std::unique_lock lock(mutex);
      for (const auto& [number, reason] : client.published)
        if (number == awaited) result = reason;
      client.published.clear();
      if (const auto answer = std::exchange(client.answer, {})) {
        if (*answer == 0) {
          handle = client.handle;
        } else {
          const bool is_other = is_v5 && config.broker.version == MqttVersion::newest && detail::is_older(*answer);
          trouble = {Errc::not_permitted, detail::refusal_of(*answer, is_v5)};
          if (is_other) is_v5 = false;
          status = MOSQ_ERR_CONN_REFUSED;
        }
      }
      if (is_over && !mosquitto_want_write(client.handle)) break;
      changed.notify_all();
    }
    ::close(socket);
    const std::lock_guard lock(mutex);
    if (handle == nullptr && is_v5 && config.broker.version == MqttVersion::newest && detail::may_be_older(status))
      is_v5 = false;
    if (status != MOSQ_ERR_SUCCESS && trouble.why.empty()) trouble = {Errc::disconnected, client.reason(status)};
    handle = nullptr;
    is_lost = true;
    changed.notify_all();
  }
  /// Lets the library do its work, and waits a little for it. The status is the library's.
  int turn(detail::MqttClient& client, int socket) {
    const auto wants_write = [&] { return mosquitto_want_write(client.handle); };
    pollfd fds[2] = {{socket, static_cast<short>(POLLIN | (wants_write() ? POLLOUT : 0)), 0}, {wake, POLLIN, 0}};
    ::poll(fds, std::size(fds), longest_wait_ms);
    std::uint64_t times = 0;
    if (fds[1].revents != 0 && ::read(wake, &times, sizeof times) < 0) times = 0;
    errno = 0;
    int status = wants_write() ? mosquitto_loop_write(client.handle, 1) : MOSQ_ERR_SUCCESS;
    for (bool is_empty = fds[0].revents == 0; status == MOSQ_ERR_SUCCESS && !is_empty;) {
      std::size_t most = std::numeric_limits<std::size_t>::max();
      status = client.inlet->read(client, socket, most, is_empty);
    }
    return status == MOSQ_ERR_SUCCESS ? mosquitto_loop_misc(client.handle) : status;
  }
  void wake_up() noexcept {
    constexpr std::uint64_t once = 1;
    [[maybe_unused]] const ssize_t written = ::write(wake, &once, sizeof once);
  }
  void tell(Errc code, std::string why) {
    const std::lock_guard lock(mutex);
    trouble = {code, std::move(why)};
    changed.notify_all();
  }

  // ---- the actuator's thread
  Result<void> publish(const std::string& text) {
    const auto until = std::chrono::steady_clock::now() + config.timeout;
    std::unique_lock lock(mutex);
    result.reset();
    awaited = 0;
    if (!changed.wait_until(lock, until, [this] { return handle != nullptr || has_ended || is_refused(); }))
      return failed("there is no connection to the broker" + (trouble.why.empty() ? "" : ": " + trouble.why));
    if (handle == nullptr) return failed(trouble.why);
    trouble = {};
    const int status = mosquitto_publish_v5(handle, &awaited, config.to.c_str(), static_cast<int>(text.size()),
                                            text.data(), config.qos, config.retain, nullptr);
    if (status != MOSQ_ERR_SUCCESS) return failed(mosquitto_strerror(status));
    wake_up();
    if (!changed.wait_until(lock, until, [this] { return result || handle == nullptr; }))
      return failed("the broker did not confirm the message within " + to_string(config.timeout));
    if (!result) return failed("the connection was lost: " + trouble.why);
    if (*result >= 0x80) {
      trouble.code = Errc::not_permitted;
      return failed("the broker refuses the message: " + std::string(mosquitto_reason_string(*result)));
    }
    is_lost = handle == nullptr;
    return {};
  }
  Result<void> check() {
    const std::lock_guard lock(mutex);
    if (!is_lost || is_over || !options.will) return {};
    return failed("the connection was lost" + (trouble.why.empty() ? "" : ": " + trouble.why) +
                  "; the broker may have published the safe value");
  }
  bool is_refused() const { return trouble.code == Errc::not_permitted; }
  Error failed(std::string why) const {
    const bool is_refusal = is_refused();
    return {is_refusal ? Errc::not_permitted : Errc::disconnected, cannot_set_mqtt,
            config.broker.host + " port " + std::to_string(detail::port_of(config.broker)), std::move(why),
            is_refusal ? "check `user`, `password` and `client_id`, and their permissions at the broker"
                       : "check that the broker runs, and that the network reaches it"};
  }
  /// Returns whether its thread has ended.
  bool end() noexcept {
    std::unique_lock lock(mutex);
    is_over = true;
    if (handle != nullptr) mosquitto_disconnect_v5(handle, MQTT_RC_NORMAL_DISCONNECTION, nullptr);
    wake_up();
    changed.notify_all();
    return changed.wait_for(lock, goodbye_limit, [this] { return has_ended; });
  }

  struct Trouble {
    Errc code = Errc::disconnected;
    std::string why = {};
  };
  const MqttActuatorConfig config;
  detail::MqttOptions options;
  const int wake = ::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);  // from waiting for the broker
  std::thread thread;                                         // the actuator's

  std::mutex mutex;  // protects the members below
  std::condition_variable changed;
  mosquitto* handle = nullptr;  // while it is connected
  Trouble trouble;              // the last one
  int awaited = 0;              // number of the message; 0: none
  std::optional<int> result;    // of that
  bool is_lost = false;         // the connection by which the last value was set
  bool is_over = false;
  bool has_ended = false;
};

MqttActuator::MqttActuator(MqttActuatorConfig config) : config_(std::move(config)) {
  detail::libmosquitto.load().or_throw();
  for (const detail::SettingMistake& mistake : mistakes_of(config_)) throw mistake.error(cannot_set_mqtt);
}

MqttActuator::~MqttActuator() {
  if (link_ == nullptr) return;
  std::thread& thread = link_->thread;
  if (link_->end())
    thread.join();
  else
    thread.detach();
}

Result<void> MqttActuator::open(std::optional<double> value) {
  link_ = std::make_shared<Link>(config_, value);
  link_->thread = std::thread([link = link_] { link->run(); });
  return value ? set(*value) : Result<void>();
}

Result<void> MqttActuator::set(double value) {
  return link_->publish(detail::set_text(config_.text, value, config_.words));
}

Result<void> MqttActuator::check() { return link_ != nullptr ? link_->check() : Result<void>(); }

void check_config(const MqttActuatorConfig& config, const ConfigItem& item, Problems& problems) {
  if (!detail::add_not_installed(detail::libmosquitto.load(), item, problems)) return;
  detail::add_mistakes(mistakes_of(config), item, problems);
  detail::check_words(config.words, item, problems);
}

}  // namespace rtdata
