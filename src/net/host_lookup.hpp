// The addresses of a host: names are looked up on a lane, so that the loop never waits for a name server.
#pragma once

#include <sys/socket.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "loop/core/loop_core.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/detail/loop/lane.hpp"

namespace rtdata::detail {

/// Why this cannot be a host; empty: it may be one.
std::string obstacle_of_host(const std::string& host);

/// Owner: the user of the address. Thread: the loop's.
class HostLookup {
 public:
  struct Address {
    sockaddr_storage socket{};
    socklen_t size = 0;
    const sockaddr* get() const noexcept { return reinterpret_cast<const sockaddr*>(&socket); }
  };
  using Found = std::function<void(Result<std::vector<Address>>)>;

  /// `owner` is its name in reports: "sensor gps". `found` is called once for each `start` that is not cancelled
  /// before, also from within it. It may destroy the lookup.
  HostLookup(LoopCore& loop, std::string owner, Found found);
  HostLookup(const HostLookup&) = delete;
  HostLookup& operator=(const HostLookup&) = delete;
  ~HostLookup();

  /// A numeric address is not looked up, nor is "localhost", which is ::1, then 127.0.0.1.
  void start(const std::string& host, std::uint16_t port);
  void cancel() noexcept;
  /// The same, for good: before the loop is gone. Does not wait for a silent name server.
  void end() noexcept;
  bool is_under_way() const noexcept { return job_ != nullptr; }
  /// Blocks until it is found, for `at_most`. For set-up only.
  void wait(Duration at_most);

 private:
  class Job;
  void job_done(Job& job, LaneJob::Outcome outcome);
  Error unknown(std::string why) const;

  LoopCore& loop_;
  const std::string owner_;
  const Found found_;
  std::string host_;
  std::unique_ptr<Lane> lane_;   // made for the first name
  std::shared_ptr<Job> job_;     // the job whose result is needed
  std::weak_ptr<Job> last_job_;  // also a job that is abandoned and still runs
};

}  // namespace rtdata::detail
