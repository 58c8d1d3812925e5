// A bus of one's own: motors on CAN that answer a request. One class is the bus, one what is at a place on it; drivers,
// configurations, timeouts and accounts are then as on I2C. With an argument it talks by SocketCAN: 11_own_bus can0
#include <linux/can.h>
#include <net/if.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "rtdata/config/system.hpp"
#include "rtdata/sensors/driver.hpp"

using namespace rtdata::literals;
using Exchange = std::function<int(can_frame& frame)>;  // sends it and waits for the answer; 0, or an errno

class CanBus;
class CanNode : public rtdata::BusDevice {
 public:
  using Bus = CanBus;
  struct Place {
    unsigned node = 1;
    friend constexpr auto parameters(rtdata::type_tag<Place>) {
      return rtdata::parameter_list(
          rtdata::parameter("node", &Place::node, "number of the node", rtdata::range(1, 127)));
    }
  };
  CanNode(std::shared_ptr<const Exchange> exchange, unsigned node) : exchange_(std::move(exchange)), node_(node) {}
  /// Blocks: on the bus's lane.
  rtdata::Result<can_frame> ask(std::uint8_t what) {
    if (is_abandoned()) return rtdata::Error{rtdata::Errc::closed, "cannot ask the node", "", "it was given up", ""};
    can_frame frame{};
    frame.can_id = node_, frame.can_dlc = 8, frame.data[0] = what;
    if (const int error = (*exchange_)(frame); error != 0)
      return rtdata::system_error(error, "cannot ask the node", "node " + std::to_string(node_));
    return frame;
  }

 private:
  std::shared_ptr<const Exchange> exchange_;  // shared: a request that hangs may outlive the bus
  unsigned node_;
};

class CanBus : public rtdata::Bus {
 public:
  static constexpr std::string_view type = "can";
  CanBus(const std::string& name, Exchange exchange)
      : Bus(name, 100ms), exchange_(std::make_shared<const Exchange>(std::move(exchange))) {}
  CanNode device(const CanNode::Place& place) const { return {exchange_, place.node}; }
  static std::string text_of(const CanNode::Place& place) { return "node " + std::to_string(place.node); }

 private:
  std::shared_ptr<const Exchange> exchange_;
};

struct Speed {
  double speed = 0;
  RTDATA_FIELDS(Speed, (speed, "/min"))
};
class Motor {  // its driver
 public:
  using Config = rtdata::NoParameters;
  using Value = Speed;
  using Device = CanNode;
  static constexpr std::string_view type = "motor", description = "speed of a motor on CAN";
  explicit Motor(const Config&) {}
  rtdata::Result<Speed> read(CanNode& node) {
    const auto answer = node.ask(0x21);
    return answer ? rtdata::Result(Speed{answer->data[0] * 256. + answer->data[1]}) : answer.error();
  }
};

Exchange socketcan(const std::string& interface) {
  const int fd = ::socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW);
  sockaddr_can address{};
  address.can_family = AF_CAN, address.can_ifindex = static_cast<int>(::if_nametoindex(interface.c_str()));
  if (::bind(fd, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0)
    throw rtdata::SetupError(rtdata::system_error(errno, "cannot use the CAN interface", interface));
  return [fd](can_frame& frame) {
    const canid_t node = frame.can_id;
    if (::write(fd, &frame, sizeof frame) != static_cast<ssize_t>(sizeof frame)) return errno;
    for (pollfd wait{fd, POLLIN, 0}; ::poll(&wait, 1, 50) > 0;)
      if (::read(fd, &frame, sizeof frame) == static_cast<ssize_t>(sizeof frame) && frame.can_id == node + 128)
        return 0;
    return ETIMEDOUT;
  };
}
int memory(can_frame& frame) {  // for want of a CAN bus: node 2 alone answers
  if (frame.can_id != 2) return ETIMEDOUT;
  frame.can_id += 128, frame.data[0] = 4, frame.data[1] = 210;
  return 0;
}

int main(int argc, char** argv) {
  rtdata::Registry registry;
  registry.add_bus<rtdata::NoParameters>("can", "a CAN bus", [=](rtdata::Runtime&, const std::string& name, auto&) {
    return CanBus(name, argc > 1 ? socketcan(argv[1]) : Exchange(memory));
  });
  registry.add_driver<Motor>();
  rtdata::Loop loop{rtdata::Loop::Manual{}};
  loop.on_error([](const rtdata::ErrorReport&) {});  // of node 3, which is not there
  rtdata::System system(loop, registry, rtdata::parse_config(R"({"buses": {"c": {"type": "can"}}, "sensors": [
      {"name": "left", "type": "motor", "bus": "c", "node": 2, "rate": "10 Hz"},
      {"name": "right", "type": "motor", "bus": "c", "node": 3, "rate": "10 Hz"}]})"));
  int good = 0;
  const auto check = loop.subscribe<Speed>("left", [&](const rtdata::Event<Speed>& e) { good += e->speed == 1234; });
  loop.advance(1min);
  const bool is_right = good >= 599 && system.sensor("right").counts().published == 0 && loop.runtime().balances();
  return is_right || argc > 1 ? 0 : 1;
}
