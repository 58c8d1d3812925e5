// A TCP connection to a server, on the loop. Nothing in it waits: names are looked up on a lane.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "net/host_lookup.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"

namespace rtdata::detail {

/// A peer that disappears silently is noticed within a minute, also without data to send.
void keep_alive(int fd) noexcept;

/// Owner: the node whose stream it is. Thread: the loop's.
class TcpStream {
 public:
  /// `owner` is its name in reports: "sensor gps". `opened` is called once for each `connect` that is not closed
  /// before, also from within it; `ready` while the connection is readable or has ended, and
  /// while it takes bytes if that is wanted. Both may close the stream and
  /// destroy it.
  TcpStream(LoopCore& loop, std::string owner, std::function<void(const Result<void>&)> opened,
            std::function<void()> ready);
  TcpStream(const TcpStream&) = delete;
  TcpStream& operator=(const TcpStream&) = delete;
  ~TcpStream();

  /// Closes the connection before, if any, and connects to the first of the host's addresses that answers; each has
  /// `limit` to do so. A numeric address is not looked up, nor is "localhost", which is ::1, then 127.0.0.1.
  void connect(const std::string& host, std::uint16_t port, Duration limit);
  bool is_open() const noexcept { return fd_ >= 0 && !is_connecting_; }
  bool is_connecting() const noexcept { return is_connecting_; }
  /// Blocks until `opened` has been called, for `at_most`. For set-up only.
  void wait(Duration at_most);
  void close() noexcept;
  /// The same, for good: before the loop is gone.
  void end() noexcept;
  /// The socket of an open connection, which is the caller's from now on; the stream is closed.
  int release() noexcept;
  /// As read(2), never blocks.
  ssize_t read(char* to, std::size_t most) noexcept;
  /// False: the peer is gone, or accepts no more data now.
  bool send(std::string_view text) noexcept;
  /// As write(2), never blocks and never raises SIGPIPE.
  ssize_t write(const std::byte* from, std::size_t size) noexcept;
  /// Whether `ready` is called while the connection takes bytes.
  void want_to_write(bool wanted);
  /// The number of written bytes that the peer's machine has not confirmed, as far as known; also after the connection
  /// was lost, until `close`.
  std::size_t unconfirmed() const noexcept;
  /// The peer sees the end of the written data.
  void end_writing() noexcept;

 private:
  void try_next();
  /// Checks the result of the current attempt.
  void take_attempt();
  void attempt_failed(int error_number);
  void done(const Result<void>& result);
  void drop_socket() noexcept;
  Error failure(int error_number) const;

  LoopCore& loop_;
  const std::string owner_;
  const std::function<void(const Result<void>&)> opened_;
  const std::function<void()> ready_;
  std::string host_;
  std::uint16_t port_ = 0;
  Duration limit_{0};
  std::vector<HostLookup::Address> addresses_;
  std::size_t next_ = 0;  // of these
  int fd_ = -1;
  FdWatch watch_;
  Timer timeout_;
  int last_error_ = 0;
  bool is_connecting_ = false;
  HostLookup lookup_;
};

}  // namespace rtdata::detail
