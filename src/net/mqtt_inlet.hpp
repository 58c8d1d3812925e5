// How what a broker sends reaches libmosquitto, which ends the program at some packets that are none.
#pragma once

#include <cstddef>
#include <string>

#include "net/mqtt_packet.hpp"

namespace rtdata::detail {

struct MqttClient;

/// Without TLS, what comes is looked at: the library gets whole packets, and only such as the broker may send. It
/// reads as many as it likes at a time, so it never reads the connection, but a pair of sockets that has what is good.
/// Of a message that is longer than may be used, it gets a byte more than that, so that memory is bounded. Over TLS it
/// reads by itself. Used by one thread at a time.
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

  /// Has the client's library read what has come at `connection`, a descriptor of its socket, until nothing is left to
  /// be read (`is_empty`), or `most` messages have come, which is counted down. The status is the library's.
  int read(MqttClient& client, int connection, std::size_t& most, bool& is_empty);

 private:
  int read_encrypted(MqttClient& client, std::size_t& most, bool& is_empty);
  int take_in(int connection);
  void look();
  int give(MqttClient& client, int connection, std::size_t& most);
  std::size_t unread() const noexcept;

  Config config_;
  int to_library_ = -1, of_library_ = -1;  // the two ends of the pair
  std::string in_;                         // has come, and is not looked at
  std::string out_;                        // is good, and not in the pair
  std::size_t payload_ = 0;                // bytes of a message that are still to come
  std::size_t used_ = 0;                   // of them for the library
  int ending_ = 0;                         // the library's status, once it has had all that is good
  std::string why_;                        // of that
};

}  // namespace rtdata::detail
