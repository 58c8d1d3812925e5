#include "io/name_lookup.hpp"

#include <netdb.h>

#include <cstring>
#include <utility>

namespace rtdata::detail {
namespace {

constexpr std::size_t most_addresses = 16;

/// 0, or an error of getaddrinfo. Blocks unless `flags` say that the host is a number.
int look_up(const std::string& host, std::uint16_t port, int flags, std::vector<SocketAddress>& to) {
  addrinfo hints{};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = flags | AI_NUMERICSERV;
  addrinfo* found = nullptr;
  const int status = ::getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found);
  if (status != 0) return status;
  const std::unique_ptr<addrinfo, void (*)(addrinfo*)> owned(found, ::freeaddrinfo);
  for (const addrinfo* one = found; one != nullptr && to.size() < most_addresses; one = one->ai_next) {
    SocketAddress address;
    if (one->ai_addrlen > sizeof address.socket) continue;
    std::memcpy(&address.socket, one->ai_addr, one->ai_addrlen);
    address.size = one->ai_addrlen;
    to.push_back(address);
  }
  return to.empty() ? EAI_NONAME : 0;
}

}  // namespace

class NameLookup::Job final : public LaneJob {
 public:
  Job(NameLookup& lookup, std::string host, std::uint16_t port) : owner(&lookup), host_(std::move(host)), port_(port) {}
  void run() noexcept override {
    try {
      status = look_up(host_, port_, AI_ADDRCONFIG, addresses);
    } catch (...) {
      status = EAI_MEMORY;
    }
  }
  void done(Outcome outcome) override {
    if (owner != nullptr) owner->looked_up(*this, outcome);
  }

  NameLookup* owner;  // null: nobody waits for it any more. The loop's thread
  int status = 0;
  std::vector<SocketAddress> addresses;

 private:
  const std::string host_;
  const std::uint16_t port_;
};

NameLookup::~NameLookup() {
  cancel();
  if (lane_ != nullptr && !last_job_.expired()) lane_->leave_behind();  // a silent name server holds nobody
}

void NameLookup::start(const std::string& host, std::uint16_t port, Done done) {
  cancel();
  std::vector<SocketAddress> addresses;
  if (host == "localhost") {
    look_up("::1", port, AI_NUMERICHOST, addresses);
    look_up("127.0.0.1", port, AI_NUMERICHOST, addresses);
    return done(std::move(addresses), "");
  }
  if (look_up(host, port, AI_NUMERICHOST, addresses) == 0) return done(std::move(addresses), "");
  if (lane_ == nullptr) lane_ = std::make_unique<Lane>(loop_, "name of " + owner_, limit);
  done_ = std::move(done);
  job_ = std::make_shared<Job>(*this, host, port);
  last_job_ = job_;
  const std::shared_ptr<Job> job = job_;
  if (lane_->submit(job) || job_ != job) return;
  job_ = nullptr;
  const Done none = std::exchange(done_, nullptr);
  none({}, "no thread can look it up: earlier attempts still hang");
}

void NameLookup::looked_up(Job& job, LaneJob::Outcome outcome) {
  const std::shared_ptr<Job> ended = std::exchange(job_, nullptr);
  const Done done = std::exchange(done_, nullptr);
  if (outcome == LaneJob::Outcome::cancelled) return;
  if (outcome == LaneJob::Outcome::given_up) return done({}, "the name servers did not answer in " + to_string(limit));
  if (job.status != 0) return done({}, ::gai_strerror(job.status));
  done(std::move(job.addresses), "");
}

void NameLookup::cancel() noexcept {
  if (job_ != nullptr) job_->owner = nullptr;
  job_ = nullptr;
  done_ = nullptr;
}

void NameLookup::wait(Duration at_most) {
  if (job_ != nullptr) lane_->wait(at_most);
}

}  // namespace rtdata::detail
