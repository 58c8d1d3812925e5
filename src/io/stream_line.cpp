#include "io/stream_line.hpp"

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <map>
#include <utility>

#include "io/child_process.hpp"
#include "io/tty.hpp"

namespace rtdata {
namespace detail {
namespace {

/// Milliseconds for poll, rounded up, so that no time is left when it returns.
int milliseconds(Duration left) {
  const auto ms = std::chrono::ceil<std::chrono::milliseconds>(std::max(left, Duration{0})).count();
  return static_cast<int>(std::min<std::int64_t>(ms, 1'000'000));
}

constexpr const char* cannot_connect = "cannot connect";

/// The texts for each kind of line.
struct LineWords {
  const char *cannot_write, *cannot_open, *hangs, *hangs_advice, *lost, *gone, *advice;
};
constexpr std::array<LineWords, 3> words_of_lines{{
    {"cannot write to the serial line", "cannot open the serial line", "opening it hangs in the kernel",
     "unplug the device, and plug it in again", "lost the serial line", "the device has disappeared",
     "check the plug and the cable; it is opened again when it is back"},
    {"cannot write to the server", "cannot connect", "an earlier attempt still hangs",
     "check the name server, or set `host` to an IP address", "lost the connection", "the server has closed it",
     "it is opened again when it is back"},
    {"cannot write to the program", "cannot start the program", "an earlier attempt still hangs",
     "check the disk of the program", "lost the program", "it has ended, or closed its terminal",
     "check the program: `run` it by hand; it is started again"},
}};
const LineWords& words_of(StreamLine::Kind::Sort sort) noexcept {
  return words_of_lines[static_cast<std::size_t>(sort)];
}

/// The programs that answer, by the descriptor of their terminal.
class AskedPrograms {
 public:
  void kill_all() noexcept {
    const std::lock_guard lock(mutex_);
    for (const auto& [output, child] : children_) ::kill(-child.pid, SIGKILL);
  }
  /// How it has ended; empty: it runs.
  std::string end_of(int output) {
    const std::lock_guard lock(mutex_);
    const auto found = children_.find(output);
    return found == children_.end() ? std::string() : detail::end_of(found->second);
  }
  void add(const Child& child) {
    const std::lock_guard lock(mutex_);
    children_[child.output] = child;
  }
  void end(int output) noexcept {
    std::unique_lock lock(mutex_);
    const auto found = children_.find(output);
    if (found == children_.end()) return;
    const Child child = found->second;
    children_.erase(found);
    lock.unlock();
    end_child(child);
  }

 private:
  std::mutex mutex_;
  std::map<int, Child> children_;
};
AskedPrograms& asked_programs() noexcept {
  // Never destroyed: a thread that hangs in a program's answer may still come back while this program ends.
  static AskedPrograms& all = *new AskedPrograms;
  [[maybe_unused]] static const int at_exit = std::atexit([] { asked_programs().kill_all(); });
  return all;
}

}  // namespace

struct StreamLine::Line {
  Line(int fd_, void (*close_)(int) noexcept) : fd(fd_), close(close_) {}
  Line(const Line&) = delete;
  Line& operator=(const Line&) = delete;
  ~Line() { close(fd); }
  const int fd;
  void (*const close)(int) noexcept;
};

Result<void> StreamLine::open() {
  const Result<std::shared_ptr<Line>> line = opened();
  if (!line) return line.error();
  return {};
}

Result<void> StreamLine::write(std::span<const std::uint8_t> bytes, Duration timeout) {
  const auto until = std::chrono::steady_clock::now() + timeout;
  const Result<std::shared_ptr<Line>> line = opened();
  if (!line) return line.error();
  while (!bytes.empty()) {
    const ssize_t done = kind_.sort == Kind::Sort::connection
                             ? ::send((*line)->fd, bytes.data(), bytes.size(), MSG_NOSIGNAL)
                             : ::write((*line)->fd, bytes.data(), bytes.size());
    const int number = done < 0 ? errno : 0;
    if (done > 0) {
      bytes = bytes.subspan(static_cast<std::size_t>(done));
    } else if (number == EAGAIN || done == 0) {
      const Result<bool> ready = wait(*line, POLLOUT, until - std::chrono::steady_clock::now());
      if (!ready) return ready.error();
      if (!*ready)
        return Error{Errc::timed_out, words_of(kind_.sort).cannot_write, kind_.name,
                     std::to_string(bytes.size()) + " bytes were not accepted within " + to_string(timeout),
                     "check whether the device is stopped"};
    } else if (number != EINTR) {
      return gone(*line, number);
    }
  }
  return {};
}

Result<std::size_t> StreamLine::read(std::span<std::uint8_t> bytes, Duration timeout) {
  const auto until = std::chrono::steady_clock::now() + timeout;
  const Result<std::shared_ptr<Line>> line = opened();
  if (!line) return line.error();
  for (;;) {
    const ssize_t got = ::read((*line)->fd, bytes.data(), bytes.size());
    const int number = got < 0 ? errno : 0;
    if (got > 0) return static_cast<std::size_t>(got);
    if (got == 0 && !bytes.empty()) return gone(*line, EIO);  // hung up
    if (number != EAGAIN && number != EINTR && number != 0) return gone(*line, number);
    const Result<bool> ready = wait(*line, POLLIN, until - std::chrono::steady_clock::now());
    if (!ready) return ready.error();
    if (!*ready) return std::size_t{0};
  }
}

void StreamLine::drop() {
  const std::lock_guard lock(mutex_);
  line_ = nullptr;
}

Result<std::shared_ptr<StreamLine::Line>> StreamLine::opened() {
  const LineWords& words = words_of(kind_.sort);
  {
    const std::lock_guard lock(mutex_);
    if (line_ != nullptr) return line_;
    if (std::exchange(is_opening_, true))
      return Error{Errc::busy, words.cannot_open, kind_.name, words.hangs, words.hangs_advice};
  }
  const Result<int> fd = kind_.open();
  const std::lock_guard lock(mutex_);
  is_opening_ = false;
  if (!fd) return fd.error();
  return line_ = std::make_shared<Line>(*fd, kind_.close);
}

/// The next call opens it again.
Error StreamLine::gone(const std::shared_ptr<Line>& line, int number) {
  {
    const std::lock_guard lock(mutex_);
    if (line_ == line) line_ = nullptr;
  }
  const LineWords& words = words_of(kind_.sort);
  const bool has_ended = number == EIO ||
                         (kind_.sort == Kind::Sort::connection ? number == ECONNRESET || number == EPIPE
                                                               : number == ENXIO || number == ENODEV);
  std::string how = kind_.sort == Kind::Sort::program ? asked_programs().end_of(line->fd) : std::string();
  if (has_ended)
    return {Errc::disconnected, words.lost, kind_.name, how.empty() ? words.gone : std::move(how), words.advice};
  return system_error(number, words.lost, kind_.name, words.advice);
}

Result<bool> StreamLine::wait(const std::shared_ptr<Line>& line, short what, Duration left) {
  struct pollfd one {
    line->fd, what, 0
  };
  const int ready = ::poll(&one, 1, milliseconds(left));
  if (ready < 0) {
    const int number = errno;
    if (number == EINTR) return true;
    return gone(line, number);
  }
  if (ready > 0 && (one.revents & (what | POLLIN)) == 0) return gone(line, EIO);  // a hang-up or an error only
  return ready > 0;
}

Result<int> connect_to(const std::string& host, std::uint16_t port, Duration limit) {
  const std::string server = host + " port " + std::to_string(port);
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (const int status = ::getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found); status != 0)
    return Error{Errc::not_found, cannot_connect, server, ::gai_strerror(status), "check `host`"};
  const std::unique_ptr<addrinfo, void (*)(addrinfo*)> list(found, ::freeaddrinfo);
  int number = ECONNREFUSED;
  for (const addrinfo* one = list.get(); one != nullptr; one = one->ai_next) {
    const int fd = ::socket(one->ai_family, one->ai_socktype | SOCK_NONBLOCK | SOCK_CLOEXEC, one->ai_protocol);
    if (fd < 0) {
      number = errno;
      continue;
    }
    number = ::connect(fd, one->ai_addr, one->ai_addrlen) == 0 ? 0 : errno;
    if (number == EINPROGRESS) {
      struct pollfd ready {
        fd, POLLOUT, 0
      };
      const int count = ::poll(&ready, 1, milliseconds(limit));
      socklen_t size = sizeof number;
      if (count == 0) {
        number = ETIMEDOUT;
      } else if (count < 0 || ::getsockopt(fd, SOL_SOCKET, SO_ERROR, &number, &size) != 0) {
        number = errno;
      }
    }
    if (number == 0) {
      const int on = 1;
      ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
      return fd;
    }
    ::close(fd);
  }
  Error error = system_error(number, cannot_connect, server, "check `host` and `port`, and whether the device is on");
  if (number == ECONNREFUSED || number == EHOSTUNREACH || number == ENETUNREACH) error.code = Errc::disconnected;
  return error;
}

std::shared_ptr<SerialTransport> make_program_line(std::vector<std::string> run) {
  const std::string name = run.front();
  const auto open = [run = std::move(run)]() -> Result<int> {
    const Result<Child> child = start_child(run, ChildPrints::answers);
    if (!child) return child.error();
    asked_programs().add(*child);
    return child->output;
  };
  return std::make_shared<StreamLine>(
      StreamLine::Kind{name, open, [](int fd) noexcept { asked_programs().end(fd); }, StreamLine::Kind::Sort::program});
}

}  // namespace detail

std::shared_ptr<SerialTransport> make_tcp_line(std::string host, std::uint16_t port, Duration limit) {
  return std::make_shared<detail::StreamLine>(detail::StreamLine::Kind{
      host + " port " + std::to_string(port), [host, port, limit] { return detail::connect_to(host, port, limit); },
      [](int fd) noexcept { ::close(fd); }, detail::StreamLine::Kind::Sort::connection});
}

std::shared_ptr<SerialTransport> make_kernel_serial(std::string device, SerialSettings settings) {
  return std::make_shared<detail::StreamLine>(detail::StreamLine::Kind{
      device, [device, settings] { return detail::open_tty(device, settings); }, &detail::close_tty});
}

}  // namespace rtdata
