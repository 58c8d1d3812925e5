#include "io/enabling.hpp"

#include <array>

namespace rtdata::detail {
namespace {

struct Enabling {
  std::string_view device, advice;
};
// From raspi-config(1) and the README of the overlays. In `raspi-config nonint`, 0 means on.
constexpr std::array<Enabling, 6> all{{
    {"/dev/i2c-",
     "switch I2C on: on a Raspberry Pi `sudo raspi-config nonint do_i2c 0`, or a line `dtparam=i2c_arm=on` in "
     "/boot/firmware/config.txt, then reboot; elsewhere `sudo modprobe i2c-dev`, and for good a line `i2c-dev` "
     "in /etc/modules"},
    {"/dev/spidev",
     "switch SPI on: on a Raspberry Pi `sudo raspi-config nonint do_spi 0`, or a line `dtparam=spi=on` in "
     "/boot/firmware/config.txt, then reboot; elsewhere `sudo modprobe spidev`, and a device tree overlay that "
     "gives the controller a spidev"},
    {"/dev/serial0",
     "switch the serial port on, and the login on it off: on a Raspberry Pi `sudo raspi-config nonint do_serial_hw 0` "
     "and `sudo raspi-config nonint do_serial_cons 1`, then reboot"},
    {"/dev/ttyAMA",
     "switch the serial port on, and the login on it off: on a Raspberry Pi `sudo raspi-config nonint do_serial_hw 0` "
     "and `sudo raspi-config nonint do_serial_cons 1`, then reboot"},
    {"/dev/pps", "add a line `dtoverlay=pps-gpio,gpiopin=18` to /boot/firmware/config.txt, then reboot"},
    {"/sys/bus/w1",
     "switch 1-Wire on: on a Raspberry Pi a line `dtoverlay=w1-gpio` in /boot/firmware/config.txt, then "
     "reboot"},
}};

}  // namespace

std::string how_to_enable(std::string_view device) {
  for (const Enabling& one : all)
    if (device.starts_with(one.device)) return std::string(one.advice);
  return {};
}

}  // namespace rtdata::detail
