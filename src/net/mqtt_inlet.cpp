#include "net/mqtt_inlet.hpp"

#include <fcntl.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <string_view>
#include <system_error>

#include "net/mqtt_connection.hpp"

namespace rtdata::detail {
namespace {

constexpr std::size_t inlet_chunk = 65536;

}  // namespace

MqttInlet::MqttInlet(const Config& config) : config_(config) {
  if (config.is_encrypted) return;
  int ends[2] = {-1, -1};
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, ends) != 0)
    throw std::system_error(errno, std::generic_category(), "socketpair");
  to_library_ = ends[0];
  of_library_ = ends[1];
}

MqttInlet::~MqttInlet() {
  if (to_library_ >= 0) ::close(to_library_);
  if (of_library_ >= 0) ::close(of_library_);
}

int MqttInlet::read(MqttClient& client, int connection, std::size_t& most, bool& is_empty) {
  if (config_.is_encrypted) return read_encrypted(client, most, is_empty);
  int status = MOSQ_ERR_SUCCESS;
  if (out_.empty() && unread() == 0 && ending_ == MOSQ_ERR_SUCCESS) {
    status = take_in(connection);
    if (status != MOSQ_ERR_SUCCESS) ending_ = status;
    look();
  }
  status = give(client, connection, most);
  is_empty = out_.empty() && unread() == 0;
  if (status == MOSQ_ERR_SUCCESS && is_empty && ending_ != MOSQ_ERR_SUCCESS) {
    status = ending_;
    client.trouble = why_;
  }
  return status;
}

/// The library mostly takes one packet in each call.
int MqttInlet::read_encrypted(MqttClient& client, std::size_t& most, bool& is_empty) {
  for (;;) {
    const std::size_t before = client.arrived;
    const int status = mosquitto_loop_read(client.handle, 1);
    const std::size_t got = client.arrived - before;
    most -= std::min(most, got);
    if (status == MOSQ_ERR_SUCCESS && got != 0 && most != 0) continue;
    is_empty = status != MOSQ_ERR_SUCCESS || got == 0;
    return status;
  }
}

int MqttInlet::take_in(int connection) {
  const std::size_t before = in_.size();
  in_.resize(before + inlet_chunk);
  const ssize_t got = ::recv(connection, in_.data() + before, inlet_chunk, MSG_DONTWAIT);
  const int error = errno;
  in_.resize(before + static_cast<std::size_t>(std::max<ssize_t>(got, 0)));
  if (got > 0 || (got < 0 && (error == EAGAIN || error == EWOULDBLOCK || error == EINTR))) return MOSQ_ERR_SUCCESS;
  if (got < 0 && error != ECONNRESET) why_ = std::generic_category().message(error);
  return MOSQ_ERR_CONN_LOST;
}

/// Moves valid packets from the received data to the data for the library.
void MqttInlet::look() {
  std::size_t at = 0;
  const auto pass = [&](std::size_t size) {
    const std::size_t used = std::min(size, used_);
    out_.append(in_, at, used);
    used_ -= used;
    payload_ -= size;
    at += size;
  };
  for (;;) {
    pass(std::min(payload_, in_.size() - at));
    if (payload_ > 0) break;
    const MqttPacket packet = look_at_mqtt(std::string_view(in_).substr(at), config_.expected);
    if (packet.state == MqttPacket::State::cut) break;
    if (packet.state == MqttPacket::State::bad) {
      ending_ = MOSQ_ERR_PROTOCOL;
      why_ = std::string("it sends ") + packet.why;
      break;
    }
    config_.expected.is_accepted = true;
    payload_ = packet.payload;
    used_ = std::min(packet.payload, config_.longest_message + 1);
    out_ += in_[at];
    for (std::size_t length = packet.head - packet.prefix + used_, more = 1; more != 0; length /= 128) {
      more = length >= 128 ? 128 : 0;
      out_ += static_cast<char>(length % 128 | more);
    }
    out_.append(in_, at + packet.prefix, packet.head - packet.prefix);
    at += packet.head;
  }
  in_.erase(0, at);
}

/// While the library reads, its descriptor refers to the socket pair. It writes only at other times.
int MqttInlet::give(MqttClient& client, int connection, std::size_t& most) {
  const int socket = mosquitto_socket(client.handle);
  if (socket < 0) return MOSQ_ERR_NO_CONN;
  if (out_.empty() && unread() == 0) return MOSQ_ERR_SUCCESS;
  if (::dup3(of_library_, socket, O_CLOEXEC) < 0) return MOSQ_ERR_ERRNO;
  int status = MOSQ_ERR_SUCCESS;
  for (bool goes_on = true; goes_on;) {
    const ssize_t sent = ::send(to_library_, out_.data(), out_.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (sent > 0) out_.erase(0, static_cast<std::size_t>(sent));
    const std::size_t before = client.arrived, waiting = unread();
    status = mosquitto_loop_read(client.handle, 1);
    most -= std::min(most, client.arrived - before);
    const bool has_read = unread() < waiting;
    goes_on = status == MOSQ_ERR_SUCCESS && most != 0 && has_read && mosquitto_socket(client.handle) == socket &&
              (!out_.empty() || unread() > 0);
  }
  // If the library has closed it, the number may belong to another file.
  if (mosquitto_socket(client.handle) == socket && ::dup3(connection, socket, O_CLOEXEC) < 0) return MOSQ_ERR_ERRNO;
  return status;
}

std::size_t MqttInlet::unread() const noexcept {
  int bytes = 0;
  return ::ioctl(of_library_, FIONREAD, &bytes) == 0 && bytes > 0 ? static_cast<std::size_t>(bytes) : 0;
}

}  // namespace rtdata::detail
