// A TCP port of this machine to which the devices of several sensors connect.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "net/ip_address.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"

namespace rtdata::detail {

/// Owner: its users, the last of which closes the port. Thread: the loop's.
class TcpListener : public std::enable_shared_from_this<TcpListener> {
 public:
  class User {
   public:
    /// A connection of this user's device. The user owns the descriptor.
    virtual void take_connection(int fd) = 0;
    /// A connection belongs to no user or could not be accepted. The first user is told.
    virtual void connection_refused(Error why) = 0;

   protected:
    ~User() = default;
  };

  /// The port that sensors of this loop have opened, or a new port. `place`: for errors.
  static Result<std::shared_ptr<TcpListener>> open(LoopCore& loop, const IpAddress& address, const std::string& place);
  ~TcpListener();
  TcpListener(const TcpListener&) = delete;
  TcpListener& operator=(const TcpListener&) = delete;

  /// `from`: the address of the device; empty: any address that no other user has. Errors: busy (another user has this
  /// address).
  Result<void> add(User& user, const std::optional<IpAddress>& from);
  void remove(const User& user) noexcept;

 private:
  struct Device {
    User* user;
    std::optional<IpAddress> from;
  };
  TcpListener(LoopCore& loop, const IpAddress& address, std::string place, int fd);
  void watch();
  void take();

  LoopCore& loop_;
  const IpAddress address_;
  const std::string place_;
  const int fd_;
  FdWatch connections_;
  Timer later_;  // after an error that lasts
  std::vector<Device> devices_;
};

}  // namespace rtdata::detail
