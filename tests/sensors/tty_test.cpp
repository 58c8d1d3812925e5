#include "io/tty.hpp"

#include <asm/ioctls.h>
#include <asm/termbits.h>
#include <doctest/doctest.h>
#include <fcntl.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <cerrno>

#include "sensors/termios2.hpp"

using namespace rtdata;

TerminalSettings terminal_settings(int fd) {
  struct termios2 tty {};
  ::ioctl(fd, TCGETS2, &tty);
  int exclusive = 0;
  ::ioctl(fd, TIOCGEXCL, &exclusive);
  return {tty.c_ispeed, tty.c_ospeed, tty.c_cflag, tty.c_lflag, exclusive != 0};
}

bool terminals_can_be_set_up() {
  const int master = ::open("/dev/ptmx", O_RDWR | O_NOCTTY | O_CLOEXEC);
  if (master < 0) return true;  // what is wrong here is for the tests to say
  struct termios2 tty {};
  const bool can = ::ioctl(master, TCGETS2, &tty) == 0 || (errno != ENOTTY && errno != ENOSYS);
  ::close(master);
  return can;
}

TEST_SUITE_BEGIN("sensors");

TEST_CASE("US-13 every character size, parity and number of stop bits becomes the kernel's flags") {
  const auto flags = [](unsigned size, Parity parity, unsigned stop_bits) {
    return detail::control_flags({9600, size, parity, stop_bits}).value() & (CSIZE | PARENB | PARODD | CMSPAR | CSTOPB);
  };
  CHECK(flags(8, Parity::none, 1) == CS8);
  CHECK(flags(7, Parity::even, 1) == (CS7 | PARENB));
  CHECK(flags(6, Parity::odd, 2) == (CS6 | PARENB | PARODD | CSTOPB));
  CHECK(flags(5, Parity::mark, 1) == (CS5 | PARENB | PARODD | CMSPAR));
  CHECK(flags(8, Parity::space, 2) == (CS8 | PARENB | CMSPAR | CSTOPB));
  CHECK(!detail::control_flags({0, 8, Parity::none, 1}));
  CHECK(!detail::control_flags({9600, 4, Parity::none, 1}));
  CHECK(!detail::control_flags({9600, 9, Parity::none, 1}));
  CHECK(!detail::control_flags({9600, 8, Parity::none, 3}));
  CHECK(!detail::control_flags({9600, 8, Parity::none, 0}));
  CHECK((detail::control_flags({.hangup = true}).value() & HUPCL) != 0);
  CHECK((detail::control_flags({}).value() & HUPCL) == 0);
  CHECK(detail::control_flags({.rts = true}));
  CHECK(detail::control_flags({.rts = true, .rs485 = Rs485::rts_high}).error().code == Errc::bad_argument);
}

TEST_CASE("US-13 serial lines are tested where they can be") {
  if (!terminals_can_be_set_up()) MESSAGE("skipped: serial lines, which cannot be set up here (an emulator?)");
}

TEST_CASE("US-13 what is no serial line is told") {
  CHECK(detail::open_tty("/dev/null", {}).error().code == Errc::bad_argument);
  CHECK(detail::open_tty("/nowhere/tty", {}).error().code == Errc::not_found);
}

TEST_SUITE_END();
