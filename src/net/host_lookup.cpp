#include "net/host_lookup.hpp"

#include <arpa/inet.h>
#include <netdb.h>

#include <algorithm>
#include <cstring>
#include <utility>

namespace rtdata::detail {
namespace {

constexpr Duration lookup_limit = std::chrono::seconds{10};
constexpr std::size_t most_addresses = 16;

/// 0, or an error of getaddrinfo. Blocks unless `flags` say that the host is a number.
int look_up(const std::string& host, std::uint16_t port, int flags, std::vector<HostLookup::Address>& to) {
  addrinfo hints{};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;  // one socket type, so that each address comes once
  hints.ai_flags = flags | AI_NUMERICSERV;
  addrinfo* found = nullptr;
  const int status = ::getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found);
  if (status != 0) return status;
  const std::unique_ptr<addrinfo, void (*)(addrinfo*)> owned(found, ::freeaddrinfo);
  for (const addrinfo* one = found; one != nullptr && to.size() < most_addresses; one = one->ai_next) {
    HostLookup::Address address;
    if (one->ai_addrlen > sizeof address.socket) continue;
    std::memcpy(&address.socket, one->ai_addr, one->ai_addrlen);
    address.size = one->ai_addrlen;
    to.push_back(address);
  }
  return to.empty() ? EAI_NONAME : 0;
}

}  // namespace

/// getaddrinfo has no time limit of its own.
class HostLookup::Job final : public LaneJob {
 public:
  Job(HostLookup& lookup, std::string host, std::uint16_t port) : owner(&lookup), host_(std::move(host)), port_(port) {}
  void run() noexcept override {
    try {
      status = look_up(host_, port_, AI_ADDRCONFIG, addresses);
    } catch (...) {
      status = EAI_MEMORY;
    }
  }
  void done(Outcome outcome) override {
    if (owner != nullptr) owner->job_done(*this, outcome);
  }

  HostLookup* owner;  // null: no longer waited for. The loop's thread
  int status = 0;
  std::vector<Address> addresses;

 private:
  const std::string host_;
  const std::uint16_t port_;
};

HostLookup::HostLookup(LoopCore& loop, std::string owner, Found found)
    : loop_(loop), owner_(std::move(owner)), found_(std::move(found)) {}

HostLookup::~HostLookup() { end(); }

void HostLookup::start(const std::string& host, std::uint16_t port) {
  cancel();
  host_ = host;
  std::vector<Address> addresses;
  if (host == "localhost") {
    look_up("::1", port, AI_NUMERICHOST, addresses);
    look_up("127.0.0.1", port, AI_NUMERICHOST, addresses);
    return found_(std::move(addresses));
  }
  if (look_up(host, port, AI_NUMERICHOST, addresses) == 0) return found_(std::move(addresses));
  if (lane_ == nullptr) lane_ = std::make_unique<Lane>(loop_, "name of " + owner_, lookup_limit);
  job_ = std::make_shared<Job>(*this, host, port);
  last_job_ = job_;
  const std::shared_ptr<Job> job = job_;
  if (!lane_->submit(job) && job_ == job) {
    job_ = nullptr;
    found_(unknown("no thread is free to look up the name: earlier attempts still hang"));
  }
}

void HostLookup::cancel() noexcept {
  if (job_ != nullptr) job_->owner = nullptr;
  job_ = nullptr;
}

void HostLookup::end() noexcept {
  cancel();
  if (lane_ != nullptr && !last_job_.expired()) lane_->abandon_thread();
  lane_ = nullptr;
}

void HostLookup::wait(Duration at_most) {
  if (job_ != nullptr) lane_->wait(at_most);
}

void HostLookup::job_done(Job& job, LaneJob::Outcome outcome) {
  const std::shared_ptr<Job> ended = std::exchange(job_, nullptr);
  if (outcome == LaneJob::Outcome::cancelled) return;
  if (outcome == LaneJob::Outcome::given_up)
    return found_(unknown("the name servers did not answer within " + to_string(lookup_limit)));
  if (job.status != 0) return found_(unknown(::gai_strerror(job.status)));
  found_(std::move(job.addresses));
}

Error HostLookup::unknown(std::string why) const {
  return {Errc::not_found, "cannot connect", host_, std::move(why), "check the host name, or use an IP address"};
}

std::string obstacle_of_host(const std::string& host) {
  if (host.empty()) return "there is no host";
  if (host.find("://") != std::string::npos) return "it is a URL: write only the name or the address";
  const bool has_other = std::any_of(host.begin(), host.end(), [](char c) {
    return static_cast<unsigned char>(c) <= ' ' || c == '/' || c == '\\' || c == '"' || c == 0x7f;
  });
  if (has_other) return "it is neither a host name nor an address";
  if (host.front() == '[') return "it has brackets, as in a URL: write only the address";
  if (const std::size_t colon = host.find(':'); colon != std::string::npos) {
    const std::string address = host.substr(0, host.find('%'));  // without its zone
    in6_addr ignored{};
    if (::inet_pton(AF_INET6, address.c_str(), &ignored) != 1) {
      const bool is_one = host.find(':', colon + 1) == std::string::npos;
      return is_one ? "it contains a port: write the port as `port`" : "it is neither a host name nor an address";
    }
  }
  return host.size() > 253 ? "it is too long for a host name" : "";
}

}  // namespace rtdata::detail
