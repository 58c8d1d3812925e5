#include "app/control/readers.hpp"

#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <exception>
#include <list>
#include <system_error>
#include <utility>

#include "app/control/request.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::app {
namespace {

constexpr Duration pace = std::chrono::milliseconds{10};        // of what is sent
constexpr Duration idle_pace = std::chrono::milliseconds{100};  // while nobody reads
constexpr Duration look_pace = std::chrono::seconds{1};         // of the main loop, whether anybody reads
constexpr Duration end_patience = std::chrono::milliseconds{300};
constexpr Duration thread_patience = std::chrono::seconds{2};
constexpr std::size_t sent_at_once = std::size_t{64} << 10;  // while more is made

}  // namespace

/// What the loop and the thread both have: the one may be late with its end.
struct Readers::Shared {
  struct Connection {
    Connection(int fd_, StreamRequest request, std::string_view run) : fd(fd_), stream(std::move(request), run) {}
    Connection(const Connection&) = delete;
    Connection& operator=(const Connection&) = delete;
    ~Connection() { ::close(fd); }

    /// As much as it takes now.
    void send() {
      while (!has_gone && !is_full && !stream.text().empty()) {
        const ssize_t size = ::send(fd, stream.text().data(), stream.text().size(), MSG_DONTWAIT | MSG_NOSIGNAL);
        if (size >= 0) {
          stream.sent(static_cast<std::size_t>(size));
        } else if (errno == EAGAIN) {
          is_full = true;
        } else if (errno != EINTR) {
          has_gone = true;
        }
      }
    }

    const int fd;
    EventStream stream;
    bool is_full = false;  // until the next turn
    bool has_gone = false;
  };

  struct Arrival {
    int fd;
    StreamRequest request;
    Arrival* next;
  };

  Shared(std::shared_ptr<LiveFeed::Ring> ring_, std::string run_, Duration to_time_)
      : ring(std::move(ring_)), run(std::move(run_)), to_time(to_time_) {}
  ~Shared() {
    for (Arrival* one = arrivals.load(); one != nullptr;) {
      ::close(one->fd);
      delete std::exchange(one, one->next);
    }
  }

  const std::shared_ptr<LiveFeed::Ring> ring;
  const std::string run;
  const Duration to_time;  // from the monotonic line to the time of events
  std::atomic<Arrival*> arrivals{nullptr};
  std::atomic<std::size_t> readers{0};
  std::atomic<bool> quit{false};
  std::atomic<bool> is_broken{false};  // the thread cannot serve

  // The thread's
  void serve() noexcept;
  void turn(Ticker& ticker);
  void take_arrivals();
  void take_events();
  void end_all();
  Time now() const { return Time{std::chrono::steady_clock::now().time_since_epoch() + to_time}; }
  std::list<Connection> connections;
  StreamOrigins origins;
  EventLine line;
};

void Readers::Shared::serve() noexcept try {
  ::setpriority(PRIO_PROCESS, 0, 19);  // of this thread alone, as Linux has it
  Loop loop({.name = "readers", .hold_limit = std::chrono::hours{1}});
  Ticker ticker;
  ticker = Ticker(loop, {.period = pace, .name = "readers"}, [&](const Tick&) {
    if (quit.load(std::memory_order_acquire)) return loop.stop();
    turn(ticker);
  });
  loop.run();
  end_all();
} catch (const std::exception&) {  // no memory, no descriptors
  is_broken.store(true);
  readers.store(0);
  connections.clear();
}

void Readers::Shared::turn(Ticker& ticker) {
  take_arrivals();
  for (Connection& one : connections) one.is_full = false;
  take_events();
  const Time time = now();
  for (Connection& one : connections) {
    one.stream.turn(time);
    one.send();
  }
  const std::size_t gone = connections.remove_if([](const Connection& one) { return one.has_gone; });
  readers.fetch_sub(gone, std::memory_order_release);
  ticker.set_period(connections.empty() ? idle_pace : pace);
}

void Readers::Shared::take_arrivals() {
  for (Arrival* one = arrivals.exchange(nullptr, std::memory_order_acquire); one != nullptr;) {
    connections.emplace_back(one->fd, std::move(one->request), run);
    delete std::exchange(one, one->next);
  }
}

void Readers::Shared::take_events() {
  ring->take([this](const PackedEvent& event) {
    const StreamOrigin& origin = origins.of(event);
    line.set(event);
    for (Connection& one : connections) {
      one.stream.take(event, origin, line);
      if (one.stream.text().size() > sent_at_once) one.send();
    }
  });
}

void Readers::Shared::end_all() {
  take_arrivals();
  take_events();
  for (Connection& one : connections) {
    one.stream.end("the run has ended");
    one.send();
  }
  const auto until = std::chrono::steady_clock::now() + end_patience;
  const auto waits = [](const Connection& one) { return !one.has_gone && !one.stream.text().empty(); };
  while (std::any_of(connections.begin(), connections.end(), waits) && std::chrono::steady_clock::now() < until) {
    ::poll(nullptr, 0, 10);
    for (Connection& one : connections) {
      one.is_full = false;
      one.send();
    }
  }
  connections.clear();
}

Readers::Readers(Loop& loop, std::string run, std::size_t most)
    : loop_(loop),
      most_(most),
      feed_(loop),
      shared_(std::make_shared<Shared>(feed_.ring(), std::move(run),
                                       loop.time().time_since_epoch() - loop.now().time_since_epoch())) {}

Readers::~Readers() {
  if (!thread_.joinable()) return;
  looking_.close();
  feed_.end();
  shared_->quit.store(true, std::memory_order_release);
  if (ended_.wait_for(thread_patience) == std::future_status::ready) {
    thread_.join();
  } else {
    thread_.detach();  // it has not got the processor; it touches what it shares, and nothing else
  }
}

std::string Readers::refusal() const {
  if (shared_->is_broken.load()) return "it cannot serve readers: it has run out of memory or descriptors";
  if (shared_->readers.load(std::memory_order_acquire) < most_) return {};
  return std::to_string(most_) +
         " readers are served at a time, and there are so many: end one, or give \"control\" a larger \"readers\"";
}

void Readers::add(int fd, StreamRequest request) {
  if (!thread_.joinable()) {
    std::promise<void> ended;
    ended_ = ended.get_future();
    try {
      thread_ = std::thread([shared = shared_, ended = std::move(ended)]() mutable {
        shared->serve();
        ended.set_value();
      });
    } catch (const std::system_error&) {
      const std::string line = answer_line("error", "the system gives no thread for readers") + "\n";
      [[maybe_unused]] const ssize_t size = ::send(fd, line.data(), line.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
      ::close(fd);
      return;
    }
  }
  for (const std::string& topic : request.topics) feed_.bring(topic);
  feed_.bring(health_topic);
  shared_->readers.fetch_add(1, std::memory_order_acq_rel);
  auto* const arrival = new Shared::Arrival{fd, std::move(request), shared_->arrivals.load(std::memory_order_relaxed)};
  while (!shared_->arrivals.compare_exchange_weak(arrival->next, arrival, std::memory_order_release)) {
  }
  if (!looking_) looking_ = Ticker(loop_, {.period = look_pace, .name = "readers"}, [this](const Tick&) { look(); });
}

void Readers::look() {
  if (feed_.ring()->has_lost.load(std::memory_order_relaxed)) feed_.tell_lost();
  if (shared_->readers.load(std::memory_order_acquire) > 0) return;
  feed_.end();
  looking_.close();
}

}  // namespace rtdata::app
