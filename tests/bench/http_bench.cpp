// http_rows: what a row costs that goes out by HTTP.
#include "harness.hpp"

#ifdef RTDATA_BENCH_HTTP

#include <arpa/inet.h>
#include <curl/curl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <signal.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "payloads.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/http.hpp"

namespace bench {
namespace {

constexpr unsigned rows_of_post = 100;
constexpr unsigned window = 8;
constexpr unsigned posts = 480;
constexpr unsigned rows = posts * rows_of_post;

/// A server of HTTP in a process of its own, on another processor where there is one: reads what comes and answers 200.
class Receiver {
 public:
  Receiver() {
    const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    const bool is_listening = ::bind(fd, reinterpret_cast<const sockaddr*>(&address), size) == 0 &&
                              ::listen(fd, 64) == 0 &&
                              ::getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size) == 0;
    if (is_listening) url_ = "http://127.0.0.1:" + std::to_string(ntohs(address.sin_port)) + "/ingest";
    process_ = is_listening ? ::fork() : -1;
    if (process_ == 0) {
      settle_other_thread();
      serve(fd);
      ::_exit(0);
    }
    ::close(fd);
  }
  Receiver(const Receiver&) = delete;
  Receiver& operator=(const Receiver&) = delete;
  ~Receiver() {
    if (process_ <= 0) return;
    ::kill(process_, SIGKILL);
    ::waitpid(process_, nullptr, 0);
  }
  const std::string& url() const noexcept { return url_; }

 private:
  struct Peer {
    int fd;
    std::string head;
    std::size_t body = 0;  // bytes of it that are to come
  };

  static void serve(int listener) {
    const int poll = ::epoll_create1(EPOLL_CLOEXEC);
    epoll_event event{EPOLLIN, {}};
    ::epoll_ctl(poll, EPOLL_CTL_ADD, listener, &event);
    std::vector<char> buffer(1 << 18);
    for (;;) {
      epoll_event ready[32];
      const int count = ::epoll_wait(poll, ready, 32, -1);
      for (int i = 0; i < count; ++i) {
        auto* const peer = static_cast<Peer*>(ready[i].data.ptr);
        if (peer == nullptr) {
          auto* const fresh = new Peer{::accept4(listener, nullptr, nullptr, SOCK_CLOEXEC), {}};
          const int on = 1;
          ::setsockopt(fresh->fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
          event.data.ptr = fresh;
          ::epoll_ctl(poll, EPOLL_CTL_ADD, fresh->fd, &event);
          continue;
        }
        const ssize_t got = ::recv(peer->fd, buffer.data(), buffer.size(), 0);
        if (got <= 0) {
          ::close(peer->fd);
          delete peer;
          continue;
        }
        take(*peer, {buffer.data(), static_cast<std::size_t>(got)});
      }
    }
  }

  static void take(Peer& peer, std::string_view bytes) {
    while (!bytes.empty()) {
      if (peer.body == 0) {
        const std::size_t before = peer.head.size();
        peer.head += bytes.substr(0, 2048);
        const std::size_t end = peer.head.find("\r\n\r\n");
        if (end == std::string::npos) return;
        const std::size_t length = peer.head.find("Content-Length: ");
        peer.body = std::strtoul(peer.head.c_str() + length + 16, nullptr, 10);
        bytes.remove_prefix(end + 4 - before);
        peer.head.clear();
      }
      const std::size_t taken = std::min(bytes.size(), peer.body);
      bytes.remove_prefix(taken);
      peer.body -= taken;
      if (peer.body > 0) return;
      constexpr std::string_view answer = "HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n";
      (void)::send(peer.fd, answer.data(), answer.size(), MSG_NOSIGNAL);
    }
  }

  pid_t process_ = -1;
  std::string url_;
};

/// Process CPU time a row, from the first publish until the last is acknowledged. Some windows ahead wait in the queue,
/// so that the sink has something to send whenever it may, as the limit has.
double http_sink_row(const std::string& url, const std::string& format) {
  rtdata::Loop loop;
  rtdata::Feed<Eight> feed(loop, {.name = "chamber", .topic = "test/climate"});
  rtdata::HttpConfig config;
  config.server.url = url;
  config.format = format;
  config.sending.window = window;
  config.sending.parcel_rows = rows_of_post;
  rtdata::HttpSink sink(loop, config);
  constexpr unsigned at_a_time = window * rows_of_post;
  unsigned left = rows / at_a_time;
  const std::int64_t begin = process_cpu_ns();
  rtdata::Ticker ticker(loop, std::chrono::milliseconds{1}, [&](const rtdata::Tick&) {
    constexpr unsigned ahead = 8;
    const std::uint64_t stored = sink.counts().stored;
    if (left == 0 && stored == rows) return loop.stop();
    while (left > 0 && rows / at_a_time - left < stored / at_a_time + ahead) {
      for (unsigned i = 0; i < at_a_time; ++i) feed.publish(reading(i));
      if (--left == 0) sink.flush();
    }
  });
  loop.run();
  return static_cast<double>(process_cpu_ns() - begin) / rows;
}

/// The bodies that the sink would send.
std::vector<std::string> make_bodies(const std::string& format) {
  const auto codec = rtdata::CodecRegistry::standard().make(format).or_throw();
  std::vector<std::string> bodies(posts);
  std::vector<std::byte> bytes;
  std::uint64_t sequence = 0;
  for (std::string& body : bodies) {
    bytes.clear();
    for (unsigned i = 0; i < rows_of_post; ++i) {
      const rtdata::Event<Eight> event{
          {rtdata::from_nanoseconds(1'772'366'400'000'000'000 + static_cast<std::int64_t>(sequence)), ++sequence,
           "chamber"},
          reading(i)};
      const rtdata::EventView view("test/climate", event);
      codec
          ->encode(rtdata::EventView("test/climate", event, view.description(), view.payload(),
                                     "8e03978e-40d5-43e8-bc93-6894a57f9324"),
                   bytes)
          .or_throw();
      if (format == "json") bytes.back() = std::byte{','};
    }
    body = format == "json" ? "[" : "";
    body.append(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    if (format == "json") body.back() = ']';
  }
  return bodies;
}

/// libcurl with nothing else: eight easy handles that are used again and again, and epoll.
class BareCurl {
 public:
  BareCurl(const std::string& url, const std::vector<std::string>& bodies, const std::string& type) : bodies_(bodies) {
    poll_ = ::epoll_create1(EPOLL_CLOEXEC);
    multi_ = ::curl_multi_init();
    ::curl_multi_setopt(multi_, CURLMOPT_SOCKETFUNCTION, &BareCurl::on_socket);
    ::curl_multi_setopt(multi_, CURLMOPT_SOCKETDATA, this);
    ::curl_multi_setopt(
        multi_, CURLMOPT_TIMERFUNCTION, +[](CURLM*, long milliseconds, void* self) {
          static_cast<BareCurl*>(self)->timeout_ = milliseconds;
          return 0;
        });
    ::curl_multi_setopt(multi_, CURLMOPT_TIMERDATA, this);
    headers_ = ::curl_slist_append(::curl_slist_append(nullptr, type.c_str()), "Expect:");
    for (unsigned i = 0; i < window; ++i) {
      CURL* const easy = ::curl_easy_init();
      ::curl_easy_setopt(easy, CURLOPT_URL, url.c_str());
      ::curl_easy_setopt(easy, CURLOPT_NOSIGNAL, 1L);
      ::curl_easy_setopt(easy, CURLOPT_POST, 1L);
      ::curl_easy_setopt(easy, CURLOPT_HTTPHEADER, headers_);
      ::curl_easy_setopt(
          easy, CURLOPT_WRITEFUNCTION, +[](char*, std::size_t, std::size_t size, void*) { return size; });
      easies_.push_back(easy);
    }
  }
  BareCurl(const BareCurl&) = delete;
  BareCurl& operator=(const BareCurl&) = delete;
  ~BareCurl() {
    for (CURL* easy : easies_) ::curl_easy_cleanup(easy);
    ::curl_multi_cleanup(multi_);
    ::curl_slist_free_all(headers_);
    ::close(poll_);
  }

  double row() {
    const std::int64_t begin = process_cpu_ns();
    for (CURL* easy : easies_) start(easy);
    act(CURL_SOCKET_TIMEOUT, 0);
    while (done_ < bodies_.size()) {
      epoll_event ready[16];
      const int count = ::epoll_wait(poll_, ready, 16, timeout_ < 0 ? -1 : static_cast<int>(timeout_));
      if (count == 0) act(CURL_SOCKET_TIMEOUT, 0);
      for (int i = 0; i < count; ++i)
        act(ready[i].data.fd, ((ready[i].events & ~static_cast<unsigned>(EPOLLOUT)) != 0 ? CURL_CSELECT_IN : 0) |
                                  ((ready[i].events & EPOLLOUT) != 0 ? CURL_CSELECT_OUT : 0));
    }
    return static_cast<double>(process_cpu_ns() - begin) / rows;
  }

 private:
  static int on_socket(CURL*, curl_socket_t fd, int wants, void* self, void* is_known) {
    auto& bare = *static_cast<BareCurl*>(self);
    epoll_event event{};
    event.events = (wants != CURL_POLL_OUT ? EPOLLIN : 0U) | (wants != CURL_POLL_IN ? EPOLLOUT : 0U);
    event.data.fd = fd;
    if (wants == CURL_POLL_REMOVE) return ::epoll_ctl(bare.poll_, EPOLL_CTL_DEL, fd, nullptr);
    ::epoll_ctl(bare.poll_, is_known != nullptr ? EPOLL_CTL_MOD : EPOLL_CTL_ADD, fd, &event);
    ::curl_multi_assign(bare.multi_, fd, &bare);
    return 0;
  }
  void start(CURL* easy) {
    if (next_ == bodies_.size()) return;
    const std::string& body = bodies_[next_++];
    ::curl_easy_setopt(easy, CURLOPT_POSTFIELDS, body.data());
    ::curl_easy_setopt(easy, CURLOPT_POSTFIELDSIZE, static_cast<long>(body.size()));
    ::curl_multi_add_handle(multi_, easy);
  }
  void act(curl_socket_t fd, int mask) {
    int running = 0;
    ::curl_multi_socket_action(multi_, fd, mask, &running);
    for (;;) {
      int left = 0;
      while (CURLMsg* const message = ::curl_multi_info_read(multi_, &left)) {
        CURL* const easy = message->easy_handle;
        ::curl_multi_remove_handle(multi_, easy);
        ++done_;
        start(easy);
      }
      if (timeout_ != 0) return;
      timeout_ = -1;
      ::curl_multi_socket_action(multi_, CURL_SOCKET_TIMEOUT, 0, &running);
    }
  }

  const std::vector<std::string>& bodies_;
  int poll_ = -1;
  CURLM* multi_ = nullptr;
  curl_slist* headers_ = nullptr;
  std::vector<CURL*> easies_;
  long timeout_ = -1;
  std::size_t next_ = 0, done_ = 0;
};

}  // namespace

void bench_http(Report& report) {
  if (!report.wants("http_rows")) return;
  const Receiver receiver;
  if (receiver.url().empty()) return report.remark("http_rows: left out, no port can be listened to");
  ::curl_global_init(CURL_GLOBAL_DEFAULT);
  const auto pairs = [&](const std::string& format, const std::string& type) {
    const std::vector<std::string> bodies = make_bodies(format);
    return measure_pair(
        {.name = "http_rows", .unit = "ns/row", .reach = 1.3}, [&] { return http_sink_row(receiver.url(), format); },
        [&] { return BareCurl(receiver.url(), bodies, "Content-Type: " + type).row(); });
  };
  report.add(pairs("cbor", "application/cbor-seq"));
  const Figure json = pairs("json", "application/json");
  report.remark("as JSON: " + std::to_string(json.value) + " against " + std::to_string(json.limit) + " ns/row");
}

}  // namespace bench

#else

namespace bench {

void bench_http(Report& report) {
  if (report.wants("http_rows")) report.remark("http_rows: left out, this was built without libcurl");
}

}  // namespace bench

#endif
