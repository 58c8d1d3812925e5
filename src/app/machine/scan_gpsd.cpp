#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>

#include "app/machine/scanner.hpp"
#include "io/enabling.hpp"

namespace rtdata::app {

void scan_gpsd(Scanner& scanner) {
  if (!scanner.files.is_this_machine()) return;
  const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (fd < 0) return;
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(2947);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  int status = ::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address);
  if (status != 0 && errno == EINPROGRESS) {
    pollfd wait{fd, POLLOUT, 0};
    socklen_t size = sizeof status;
    if (::poll(&wait, 1, 500) != 1 || ::getsockopt(fd, SOL_SOCKET, SO_ERROR, &status, &size) != 0) status = -1;
  }
  ::close(fd);
  if (status != 0) return scanner.hint("gpsd", "no gpsd: " + std::string(detail::how_to_start_gpsd));
  scanner.add({"gpsd", "localhost:2947", "a GPS service"});
  scanner.sensor(scanner.scan.devices.back(), "gps", "gps");
}

}  // namespace rtdata::app
