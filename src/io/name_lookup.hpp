// The addresses of a host. Names are looked up on a lane, since name servers may be silent for long.
#pragma once

#include <sys/socket.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "rtdata/loop/lane.hpp"

namespace rtdata::detail {

struct SocketAddress {
  sockaddr_storage socket{};
  socklen_t size = 0;
};

/// Owner: the node that connects. Thread: the loop's.
class NameLookup {
 public:
  static constexpr Duration limit = std::chrono::seconds{10};  // getaddrinfo has no time limit of its own
  /// At least one address, or why there is none.
  using Done = std::function<void(std::vector<SocketAddress>, const std::string& why)>;

  /// `owner` is its name in reports: "sensor gps".
  NameLookup(LoopCore& loop, std::string owner) : loop_(loop), owner_(std::move(owner)) {}
  NameLookup(const NameLookup&) = delete;
  NameLookup& operator=(const NameLookup&) = delete;
  ~NameLookup();

  /// Cancels the one before. `done` is called once, unless it is cancelled, also from within this call: a numeric
  /// address needs no looking up, nor does "localhost", which is ::1, then 127.0.0.1. It may destroy this object.
  void start(const std::string& host, std::uint16_t port, Done done);
  bool is_running() const noexcept { return job_ != nullptr; }
  void cancel() noexcept;
  /// Blocks until `done` has been called, for `at_most`. For set-up only.
  void wait(Duration at_most);

 private:
  class Job;
  void looked_up(Job& job, LaneJob::Outcome outcome);

  LoopCore& loop_;
  const std::string owner_;
  Done done_;
  std::unique_ptr<Lane> lane_;   // made when there is a name
  std::shared_ptr<Job> job_;     // that is waited for
  std::weak_ptr<Job> last_job_;  // also one that is not, and still runs
};

}  // namespace rtdata::detail
