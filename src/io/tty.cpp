#include "io/tty.hpp"

// <asm/termbits.h> has termios2 with arbitrary speeds; it cannot be included together with <termios.h>.
#include <asm/ioctls.h>
#include <asm/termbits.h>
#include <fcntl.h>
#include <linux/serial.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <tuple>

#include "io/enabling.hpp"

namespace rtdata::detail {
namespace {

constexpr const char* cannot_open = "cannot open the serial line";

Error bad_setting(std::string why, const char* advice) {
  return {Errc::bad_argument, "cannot use these serial settings", "", std::move(why), advice};
}

std::string first_line_of(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  return line;
}

/// The process that has locked the file, according to the kernel's list; 0: none.
long locked_by(const std::string& path) {
  struct stat status {};
  if (::stat(path.c_str(), &status) != 0) return 0;
  // "1: FLOCK  ADVISORY  WRITE 1234 00:05:678 0 EOF": the process, then the file's device and inode
  char file[64];
  std::snprintf(file, sizeof file, "%02x:%02x:%llu", major(status.st_dev), minor(status.st_dev),
                static_cast<unsigned long long>(status.st_ino));
  std::ifstream locks("/proc/locks");
  std::string line;
  while (std::getline(locks, line)) {
    std::istringstream words(line);
    std::string number, kind, mode, access, where;
    long process = 0;
    if (words >> number >> kind >> mode >> access >> process >> where && kind == "FLOCK" && where == file)
      return process;
  }
  return 0;
}

Error busy_error(const std::string& path) {
  const long process = locked_by(path);
  if (process == ::getpid())
    return {Errc::busy, cannot_open, path, "this program has already opened it",
            "use a serial line only for `serial` sensors of one tier with the same settings, or for one bus, or for "
            "one output"};
  if (process > 0) {
    const std::string name = first_line_of("/proc/" + std::to_string(process) + "/comm");
    return {Errc::busy, cannot_open, path,
            (name.empty() ? "a program" : name) + " (process " + std::to_string(process) + ") uses it",
            name == "rtdata-guard"
                ? "end the run that uses the output; the guard ends after it, when the output is safe"
                : "end it: only one program can use a serial line"};
  }
  return {Errc::busy, cannot_open, path, "another program uses it",
          "`fuser -v " + path + "` shows its name; end it (often it is ModemManager or brltty)"};
}

Error open_error(int number, const std::string& path) {
  switch (number) {
    case EACCES:
      return system_error(number, cannot_open, path,
                          "add the user to the device's group (`sudo usermod -aG dialout $USER`) and log in again");
    case EBUSY:
      return busy_error(path);
    case ENOENT:
    case ENXIO:
    case ENODEV:
      return system_error(number, cannot_open, path,
                          detail::how_to_enable(path).empty()
                              ? "plug it in, or check `device`; `ls /dev/serial/by-id` lists the lines"
                              : detail::how_to_enable(path));
    default:
      return system_error(number, cannot_open, path);
  }
}

bool is_pseudo_terminal(int fd) noexcept {
  struct stat status {};
  return ::fstat(fd, &status) == 0 && major(status.st_rdev) >= 136 && major(status.st_rdev) <= 143;
}

Error cannot_do(const std::string& path, std::string why, const char* advice) {
  return {Errc::out_of_range, "cannot set up the serial line", path, std::move(why), advice};
}

/// The modem lines, and how the driver of an RS-485 line is switched.
Result<void> set_lines(int fd, const std::string& path, const SerialSettings& settings) {
  if (settings.rs485) {
    const bool is_high = *settings.rs485 == Rs485::rts_high;
    const unsigned wanted = SER_RS485_ENABLED | (is_high ? SER_RS485_RTS_ON_SEND : SER_RS485_RTS_AFTER_SEND);
    constexpr unsigned ours = SER_RS485_ENABLED | SER_RS485_RTS_ON_SEND | SER_RS485_RTS_AFTER_SEND;
    struct serial_rs485 mode {};  // delays and the rest stay as the machine's description has them
    bool done = ::ioctl(fd, TIOCGRS485, &mode) == 0;
    mode.flags = (mode.flags & ~ours) | wanted;
    done = done && ::ioctl(fd, TIOCSRS485, &mode) == 0 && ::ioctl(fd, TIOCGRS485, &mode) == 0;
    if (!done || (mode.flags & ours) != wanted)
      return cannot_do(path, "its driver cannot switch an RS-485 line in this way",
                       "remove `rs485`: most adapters switch by themselves");
  }
  int lines = 0;
  if (settings.hangup && ::ioctl(fd, TIOCMGET, &lines) != 0)
    return cannot_do(path, "it has no lines that `hangup` could clear", "remove it");
  for (const auto& [is_set, bit, key] :
       {std::tuple{settings.dtr, TIOCM_DTR, "dtr"}, std::tuple{settings.rts, TIOCM_RTS, "rts"}}) {
    if (!is_set) continue;
    int bits = bit;
    if (::ioctl(fd, *is_set ? TIOCMBIS : TIOCMBIC, &bits) == 0) continue;
    if (errno == EIO || errno == ENODEV) return open_error(errno, path);
    return cannot_do(path, std::string("it has no line that `") + key + "` could set", "remove it");
  }
  return {};
}

Result<void> set_up(int fd, const std::string& path, const SerialSettings& settings, unsigned flags) {
  struct termios2 tty {};
  if (::ioctl(fd, TCGETS2, &tty) != 0) {
    return Error{Errc::bad_argument, cannot_open, path, "it is not a serial line", "check `device`"};
  }
  if (::flock(fd, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK) {
    return busy_error(path);
  }
  ::ioctl(fd, TIOCEXCL);  // others get EBUSY from now on (root does not; the lock stops root)
  tty.c_iflag = settings.parity == Parity::none ? 0 : INPCK;
  tty.c_oflag = 0;
  tty.c_lflag = 0;
  tty.c_cflag = flags | BOTHER | (BOTHER << IBSHIFT);
  tty.c_ispeed = tty.c_ospeed = settings.baud_rate;
  tty.c_cc[VMIN] = 1;
  tty.c_cc[VTIME] = 0;
  if (::ioctl(fd, TCSETS2, &tty) != 0)
    return system_error(errno, "cannot set up the serial line", path, "check its settings");
  struct termios2 now {};
  if (::ioctl(fd, TCGETS2, &now) != 0) return system_error(errno, "cannot set up the serial line", path);
  // A driver sets the nearest possible speed and reports it. Pseudo terminals have no speed.
  const double off = static_cast<double>(now.c_ospeed) / settings.baud_rate - 1;
  const unsigned format = CSIZE | CSTOPB | PARENB | PARODD | CMSPAR | HUPCL;
  if (off > 0.03 || off < -0.03) {
    return Error{
        Errc::out_of_range, "cannot set up the serial line", path,
        "it does not support " + std::to_string(settings.baud_rate) + " Bd, but only " + std::to_string(now.c_ospeed),
        "change `baud_rate`"};
  }
  if ((now.c_cflag & format) != (flags & format) && !is_pseudo_terminal(fd)) {
    return Error{Errc::out_of_range, "cannot set up the serial line", path,
                 "it does not support this character size, parity, stop bits or hang-up",
                 "change `character_size`, `parity`, `stop_bits` or `hangup`"};
  }
  return set_lines(fd, path, settings);
}

}  // namespace

Result<unsigned> control_flags(const SerialSettings& settings) {
  constexpr unsigned sizes[] = {CS5, CS6, CS7, CS8};
  if (settings.baud_rate == 0) return bad_setting("a baud rate of 0", "set `baud_rate`, such as 9600");
  if (settings.character_size < 5 || settings.character_size > 8)
    return bad_setting("a character has 5 to 8 bits", "set `character_size`");
  if (settings.stop_bits < 1 || settings.stop_bits > 2)
    return bad_setting("there are 1 or 2 stop bits", "set `stop_bits`");
  unsigned flags = CREAD | CLOCAL | sizes[settings.character_size - 5];
  if (settings.rts && settings.rs485) return bad_setting("with `rs485` the kernel sets RTS", "remove `rts` or `rs485`");
  if (settings.stop_bits == 2) flags |= CSTOPB;
  if (settings.hangup) flags |= HUPCL;
  switch (settings.parity) {
    case Parity::none:
      break;
    case Parity::even:
      flags |= PARENB;
      break;
    case Parity::odd:
      flags |= PARENB | PARODD;
      break;
    case Parity::mark:
      flags |= PARENB | PARODD | CMSPAR;
      break;
    case Parity::space:
      flags |= PARENB | CMSPAR;
      break;
  }
  return flags;
}

Result<int> open_tty(const std::string& path, const SerialSettings& settings) {
  Result<unsigned> flags = control_flags(settings);
  if (!flags) return std::move(flags).error();
  const int fd = ::open(path.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
  if (fd < 0) return open_error(errno, path);
  if (Result<void> done = set_up(fd, path, settings, *flags); !done) {
    ::close(fd);
    return std::move(done).error();
  }
  return fd;
}

void close_tty(int fd) noexcept {
  // On a pseudo terminal the mark would outlive this descriptor and lock ourselves out too.
  ::ioctl(fd, TIOCNXCL);
  ::close(fd);
}

}  // namespace rtdata::detail
