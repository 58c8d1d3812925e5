// Transfers of libcurl on a loop, with its watches and timers.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <unordered_map>

#include "net/libcurl.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/watch.hpp"

namespace rtdata::detail {

/// Owner: the sender. Thread: the loop's.
class CurlMulti {
 public:
  /// `done` is called once for each transfer that ends by itself, which is removed by then. It may add and remove
  /// others, and destroy this object.
  using Done = std::function<void(CURL* easy, CURLcode result)>;
  struct Config {
    std::string name = {};            ///< in reports
    std::size_t connections = 8;      ///< at most
    bool keeps_sigpipe_away = false;  ///< the TLS library may write without MSG_NOSIGNAL
  };
  CurlMulti(Loop& loop, Config config, Done done);
  CurlMulti(const CurlMulti&) = delete;
  CurlMulti& operator=(const CurlMulti&) = delete;
  /// All transfers have been removed.
  ~CurlMulti();

  /// Prepares a transfer for use here.
  void prepare(CURL* easy);
  /// Starts it; false when it cannot be.
  bool add(CURL* easy);
  /// Ends it, also if it is not there. Its connection is closed.
  void remove(CURL* easy) noexcept;

 private:
  struct Socket {
    FdWatch watch;
    FdWatch::Events events = FdWatch::readable;
    bool is_idle = false;         // libcurl waits for nothing of it
    bool has_been_heard = false;  // something has come: it is connected
  };
  static int on_socket(CURL*, curl_socket_t fd, int wants, void* self, void*);
  static int on_timer(CURLM*, long milliseconds, void* self);
  static int on_close_socket(void* self, curl_socket_t fd);
  void watch(int fd, FdWatch::Events events);
  void ready(int fd, const FdEvent& event);
  void act(curl_socket_t fd, int mask);
  void act_once(curl_socket_t fd, int mask);
  void arm();

  Loop& loop_;
  const Config config_;
  const Done done_;
  CURLM* multi_ = nullptr;
  std::unordered_map<int, Socket> sockets_;
  Timer timer_;
  long timeout_ms_ = -1;                         // that libcurl asked for last; -1: none
  std::chrono::steady_clock::time_point due_{};  // of the timer, while it runs. libcurl knows no virtual time
  int running_ = 0;
  bool is_acting_ = false;
  std::shared_ptr<bool> is_alive_ = std::make_shared<bool>(true);
};

}  // namespace rtdata::detail
