// Passes a broker's data to libmosquitto, which would abort the program at some invalid packets.
#pragma once

#include <cstddef>
#include <string>

#include "net/mqtt_packet.hpp"

namespace rtdata::detail {

struct MqttClient;

/// Without TLS, received data is checked: the library only gets complete packets that a broker may send. It never reads
/// the connection itself but a socket pair with the valid data. Of a message longer than the limit it gets one byte
/// more than the limit, so that memory is bounded. Over TLS the library reads by itself. Used by one thread at a time.
class MqttInlet {
 public:
  struct Config {
    MqttExpectation expected = {};
    std::size_t longest_message = 0;  ///< that is of use
    bool is_encrypted = false;
  };
  explicit MqttInlet(const Config& config);
  MqttInlet(const MqttInlet&) = delete;
  MqttInlet& operator=(const MqttInlet&) = delete;
  ~MqttInlet();

  /// Lets the client's library read the data at `connection`, a descriptor of its socket, until nothing is left
  /// (`is_empty`) or `most` messages were read; counts `most` down. Returns the library's status.
  int read(MqttClient& client, int connection, std::size_t& most, bool& is_empty);

 private:
  int read_encrypted(MqttClient& client, std::size_t& most, bool& is_empty);
  int take_in(int connection);
  void look();
  int give(MqttClient& client, int connection, std::size_t& most);
  std::size_t unread() const noexcept;

  Config config_;
  int to_library_ = -1, of_library_ = -1;  // the two ends of the pair
  std::string in_;                         // received, but not checked yet
  std::string out_;                        // valid, but not in the socket pair yet
  std::size_t payload_ = 0;                // bytes of a message that are still to come
  std::size_t used_ = 0;                   // of them for the library
  int ending_ = 0;                         // the library's status, once it has had all that is good
  std::string why_;                        // of that
};

}  // namespace rtdata::detail
