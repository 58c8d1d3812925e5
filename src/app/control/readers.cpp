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
#include <map>
#include <system_error>
#include <utility>

#include "app/control/past_reader.hpp"
#include "app/control/request.hpp"
#include "rtdata/detail/io/descriptor.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/loop/gaps.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::app {
namespace {

constexpr Duration idle_pace = std::chrono::milliseconds{100};  // while nobody reads
constexpr Duration look_pace = std::chrono::milliseconds{50};   // how often the main loop checks requests of the thread
constexpr Duration longest_reading = std::chrono::seconds{30};  // of a slice: a disk may stall
constexpr Duration end_patience = std::chrono::milliseconds{300};
constexpr Duration thread_patience = std::chrono::seconds{2};
constexpr std::size_t sent_at_once = std::size_t{64} << 10;  // while more is made
constexpr std::size_t most_kept = std::size_t{4} << 20;
constexpr std::size_t most_beside = std::size_t{256} << 10;

}  // namespace

/// The data shared by the loop and the thread, either of which may end later.
struct Readers::Shared {
  struct Arrival {
    detail::Descriptor fd;
    StreamRequest request = {};
    std::string sink = {};                  // whose recording is read first; empty: none
    std::shared_ptr<PastReader> past = {};  // of that
    Arrival* next = nullptr;
  };
  struct Connection;
  struct Reading;

  Shared(std::shared_ptr<LiveFeed::Ring> ring_, std::string run_, Duration to_time_)
      : ring(std::move(ring_)), run(std::move(run_)), to_time(to_time_) {}
  ~Shared();

  const std::shared_ptr<LiveFeed::Ring> ring;
  const std::string run;
  const Duration to_time;  // from the monotonic line to the time of events
  std::atomic<Arrival*> arrivals{nullptr};
  std::atomic<std::size_t> readers{0};
  std::atomic<bool> quit{false};
  std::atomic<bool> is_broken{false};         // the thread cannot serve
  std::atomic<std::uint64_t> asked_mark{0};   // the last mark that the thread requested
  std::atomic<std::uint64_t> stored_mark{0};  // events published before this mark can be read in the recordings

  // The thread's
  void serve() noexcept;
  void turn(Ticker& ticker);
  void take_arrivals();
  void take_events();
  void take_mark(std::uint64_t number);
  void go_on_with_past(Connection& of);
  void end_all();
  Time now() const { return Time{std::chrono::steady_clock::now().time_since_epoch() + to_time}; }
  std::list<Connection> connections;
  StreamOrigins origins;
  EventLine line;
  detail::Lane* lane = nullptr;  // on which recordings are read
};

struct Readers::Shared::Connection {
  Connection(Arrival& arrival, const std::string& current_run)
      : descriptor(std::move(arrival.fd)),
        stream(std::move(arrival.request), current_run, arrival.sink),
        past(std::move(arrival.past)) {}
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  /// Sends as much as the reader takes now.
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
    has_gone = has_gone || (has_ended && stream.text().empty());
  }
  /// True if it reads fast enough for more recorded events, of which none are dropped.
  bool has_room() const noexcept { return stream.text().size() < EventStream::most_bytes / 2; }
  /// The current run; empty: its recording has none.
  std::string_view current_run() const { return runs.empty() ? std::string_view() : runs.rbegin()->second; }
  /// Keeps live events for later.
  void keep(const PackedEvent& event) {
    if (kept.size() + event.bytes > most_kept) {  // the recording has it, and will be read further
      kept.clear();
      given_of_kept = 0;
      step = Step::reads;
      return;
    }
    const auto* const bytes = reinterpret_cast<const std::byte*>(&event);
    kept.insert(kept.end(), bytes, bytes + event.bytes);
  }

  /// Keeps an event of the current run while an earlier run is read. False: there is no room; it is sent at once, under
  /// the name of the earlier run.
  bool keep_beside(const PackedEvent& event) {
    if (beside.size() + event.bytes > most_beside) return false;
    const auto* const bytes = reinterpret_cast<const std::byte*>(&event);
    beside.insert(beside.end(), bytes, bytes + event.bytes);
    return true;
  }

  const detail::Descriptor descriptor;
  const int fd = descriptor.fd();
  EventStream stream;
  bool is_full = false;  // until the next turn
  bool has_gone = false;
  bool has_ended = false;  // with what it is being sent

  // While it is not live
  enum class Step {
    reads,    // the events stored until now
    waits,    // for the mark
    settles,  // until the events before the mark are stored
    ends      // reads that
  };
  std::shared_ptr<PastReader> past;  // also later: descriptions are its
  std::shared_ptr<Reading> reading;  // on the lane
  bool has_read = false;             // a slice at least
  PastReader::Slice slice;
  std::size_t given_of_slice = 0;
  std::map<std::uint32_t, std::string> runs;  // uuids
  Step step = Step::reads;
  std::uint64_t mark = 0;
  std::vector<std::byte> kept;  // PackedEvents
  std::size_t given_of_kept = 0;
  std::vector<std::byte> beside;  // gaps and changes of health that came meanwhile
  std::size_t given_of_beside = 0;
};

/// One slice of a recording. The connection may be gone when it is done.
struct Readers::Shared::Reading final : detail::LaneJob {
  explicit Reading(std::shared_ptr<PastReader> from_) : from(std::move(from_)) {}
  void run() noexcept override { slice = from->read(); }
  void done(Outcome outcome) override {
    is_done = true;
    is_late = outcome != Outcome::finished;
  }
  const std::shared_ptr<PastReader> from;
  PastReader::Slice slice;  // if the job is late, the lane's thread still has it
  bool is_late = false;
  bool is_done = false;
};

Readers::Shared::~Shared() {
  for (Arrival* one = arrivals.load(); one != nullptr;) delete std::exchange(one, one->next);
}

void Readers::Shared::serve() noexcept try {
  ::setpriority(PRIO_PROCESS, 0, 19);  // Linux sets it for this thread alone, and for the threads that it starts
  Loop loop({.name = "readers", .hold_limit = std::chrono::hours{1}});
  detail::Lane reading(loop.core(), "recordings", longest_reading);
  lane = &reading;
  Ticker ticker;
  ticker = Ticker(loop, {.period = idle_pace, .name = "readers"}, [&](const Tick&) {
    if (quit.load(std::memory_order_acquire)) return loop.stop();
    turn(ticker);
  });
  loop.run();
  end_all();
  reading.abandon_thread();        // a slice that is being read
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
    if (!one.stream.is_live() && !one.has_ended) go_on_with_past(one);
    one.stream.turn(time);
    one.send();
  }
  const std::size_t gone = connections.remove_if([](const Connection& one) { return one.has_gone; });
  readers.fetch_sub(gone, std::memory_order_release);
  Duration pace = idle_pace;
  for (const Connection& one : connections) pace = std::min(pace, one.stream.pace());
  ticker.set_period(pace);
}

void Readers::Shared::take_arrivals() {
  for (Arrival* one = arrivals.exchange(nullptr, std::memory_order_acquire); one != nullptr;) {
    connections.emplace_back(*one, run);
    delete std::exchange(one, one->next);
  }
}

void Readers::Shared::take_events() {
  ring->take([this](const PackedEvent& event) {
    if (event.is_mark()) return take_mark(event.sequence);
    const StreamOrigin& origin = origins.of(event);
    line.set(event);
    for (Connection& one : connections) {
      if (!one.stream.is_live() && one.stream.takes_beside(event.topic()) && one.keep_beside(event)) continue;
      if (one.stream.is_live() || one.stream.takes_beside(event.topic())) {
        one.stream.take(event, origin, line);
        if (one.stream.text().size() > sent_at_once) one.send();
      } else if (one.step > Connection::Step::waits && one.stream.takes(event.topic())) {
        one.keep(event);
      }
    }
  });
}

void Readers::Shared::take_mark(std::uint64_t number) {
  for (Connection& one : connections)
    if (one.step == Connection::Step::waits && one.mark <= number) one.step = Connection::Step::settles;
}

void Readers::Shared::go_on_with_past(Connection& of) {
  using Step = Connection::Step;
  const auto give = [&](const std::vector<std::byte>& events, std::size_t& given) {
    while (given < events.size() && of.has_room()) {
      const auto& event = *reinterpret_cast<const PackedEvent*>(events.data() + given);
      of.stream.begin_run(event.run != 0 ? of.runs[event.run] : of.current_run());
      line.set(event);
      of.stream.take(event, origins.of(event), line);
      given += event.bytes;
    }
    return given == events.size();
  };
  if (of.reading != nullptr) {
    if (!of.reading->is_done) return;
    of.slice = {};
    if (of.reading->is_late)
      of.slice.failed = "the disk did not answer in time";
    else
      of.slice = std::move(of.reading->slice);
    of.given_of_slice = 0;
    of.reading.reset();
    for (auto& [number, uuid] : of.slice.runs) of.runs[number] = std::move(uuid);
  }
  if (!give(of.slice.events, of.given_of_slice)) return;
  if (!of.slice.failed.empty()) {
    of.stream.end("error", of.slice.failed);
    of.has_ended = true;
    return;
  }
  const auto read = [&] {
    of.slice = {};
    of.reading = std::make_shared<Reading>(of.past);
    if (!lane->submit(of.reading)) of.reading.reset();  // a thread hangs: the next turn tries again
  };
  if (of.slice.has_more || !of.has_read) {
    of.has_read = true;
    return read();
  }
  switch (of.step) {
    case Step::reads:
      of.step = Step::waits;
      of.mark = asked_mark.load(std::memory_order_relaxed) + 1;
      return asked_mark.store(of.mark, std::memory_order_release);
    case Step::waits:
      return;
    case Step::settles:
      if (stored_mark.load(std::memory_order_acquire) < of.mark) return;
      of.step = Step::ends;
      return read();
    case Step::ends:
      if (!give(of.beside, of.given_of_beside) || !give(of.kept, of.given_of_kept)) return;
      of.beside = {};
      of.kept = {};
      of.slice = {};
      of.stream.begin_run(of.current_run());
      return of.stream.go_live(now());
  }
}

void Readers::Shared::end_all() {
  take_arrivals();
  take_events();
  for (Connection& one : connections) {
    if (one.stream.is_live()) {
      one.stream.end("ended", "the run has ended");
    } else if (!one.has_ended) {
      one.stream.end("error",
                     "the run has ended before all that was recorded could be sent: the recording has the rest");
    }
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

Readers::Readers(Loop& loop, std::string run)
    : loop_(loop),
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
    thread_.detach();  // the thread did not get the processor; it touches only shared data
  }
}

const Readers::Recording* Readers::recording_for(const StreamRequest& request) const {
  const auto takes = [](const Recording& recording, const std::string& wanted) {
    return std::any_of(recording.topics.begin(), recording.topics.end(),
                       [&](const std::string& taken) { return covers(taken, wanted) || covers(wanted, taken); });
  };
  for (const Recording& one : settings_.recordings) {
    if (!request.of.empty() && one.sink != request.of) continue;
    if (!request.of.empty() ||
        std::any_of(request.topics.begin(), request.topics.end(), [&](const auto& topic) { return takes(one, topic); }))
      return &one;
  }
  return nullptr;
}

std::string Readers::refusal(const StreamRequest& request) const {
  if (shared_->is_broken.load()) return "the program cannot serve readers: it has run out of memory or descriptors";
  if (request.from && *request.from > loop_.time()) return "\"from\" is an instant that has not come yet";
  if (request.wants_past() && recording_for(request) == nullptr) {
    return request.of.empty() ? "no recording has these topics, so that their earlier events are not known: "
                                "remove \"from\""
                              : "there is no recording of a sink \"" + request.of + "\"";
  }
  if (shared_->readers.load(std::memory_order_acquire) < settings_.most) return {};
  return std::to_string(settings_.most) +
         " readers are connected, and no more are served: end one, or give \"control\" a larger \"readers\"";
}

void Readers::add(int fd, StreamRequest request) {
  auto arrival = std::make_unique<Shared::Arrival>();
  arrival->fd.set(fd);
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
      return;
    }
  }
  for (const std::string& topic : request.topics) feed_.bring(topic);
  feed_.bring(health_topic);
  (void)loop_.topic<GapEvent>(gap_topic);  // from now on gaps are published
  feed_.bring(gap_topic);
#ifdef RTDATA_WITH_SQLITE
  if (request.wants_past()) {
    const Recording& recording = *recording_for(request);
    if (request.ago) request.from = loop_.time() - *request.ago;
    arrival->sink = recording.sink;
    arrival->past = make_past_reader(recording.path, request.topics, *request.from);
  }
#endif
  arrival->request = std::move(request);
  shared_->readers.fetch_add(1, std::memory_order_acq_rel);
  Shared::Arrival* const next = arrival.release();
  next->next = shared_->arrivals.load(std::memory_order_relaxed);
  while (!shared_->arrivals.compare_exchange_weak(next->next, next, std::memory_order_release)) {
  }
  if (!looking_) looking_ = Ticker(loop_, {.period = look_pace, .name = "readers"}, [this](const Tick&) { look(); });
}

void Readers::look() {
  if (feed_.ring()->has_lost.load(std::memory_order_relaxed)) feed_.tell_lost();
  put_marks();
  if (shared_->readers.load(std::memory_order_acquire) > 0) return;
  feed_.end();
  looking_.close();
}

void Readers::put_marks() {
  const std::uint64_t asked = shared_->asked_mark.load(std::memory_order_acquire);
  if (asked == marked_ && marks_.empty()) return;
  std::map<std::string, const SinkStatus*> sinks;
  const std::vector<SinkStatus> all = loop_.runtime().sinks();
  for (const SinkStatus& sink : all) sinks[sink.name] = &sink;  // of several with one name, the one that exists
  if (asked != marked_ && feed_.mark(asked)) {
    Mark& mark = marks_.emplace_back();
    mark.number = marked_ = asked;
    for (const Recording& one : settings_.recordings)
      if (const auto sink = sinks.find(one.sink); sink != sinks.end())
        mark.offered[one.sink] = sink->second->counts.offered;
  }
  const auto is_stored = [&](const auto& of_sink) {
    const auto sink = sinks.find(of_sink.first);
    if (sink == sinks.end()) return true;
    const SinkCounts& counts = sink->second->counts;
    return counts.stored + counts.all_dropped() >= of_sink.second;
  };
  while (!marks_.empty() && std::all_of(marks_.front().offered.begin(), marks_.front().offered.end(), is_stored)) {
    shared_->stored_mark.store(marks_.front().number, std::memory_order_release);
    marks_.pop_front();
  }
}

}  // namespace rtdata::app
