#include "sinks/http/curl_multi.hpp"

#include <unistd.h>

#include <algorithm>
#include <optional>
#include <utility>

#include "io/no_sigpipe.hpp"

namespace rtdata::detail {

CurlMulti::CurlMulti(Loop& loop, Config config, Done done)
    : loop_(loop), config_(std::move(config)), done_(std::move(done)) {
  // First, since a loop that is being closed takes no timer, and what the constructor has of libcurl would be leaked.
  timer_ = Timer(loop_, Timer::Config{config_.name}, [this] {
    const std::shared_ptr<bool> alive = is_alive_;
    act(CURL_SOCKET_TIMEOUT, 0);
    if (!*alive || running_ == 0) return;
    long left = -1;  // it does not ask again for what it has asked for already, and in virtual time may not be due yet
    curl_multi_timeout(multi_, &left);
    timeout_ms_ = left == 0 ? 1 : left;
    arm();
  });
  multi_ = curl_multi_init();
  if (multi_ == nullptr) throw std::bad_alloc();
  const long connections = static_cast<long>(config_.connections);
  curl_multi_setopt(multi_, CURLMOPT_SOCKETFUNCTION, &CurlMulti::on_socket);
  curl_multi_setopt(multi_, CURLMOPT_SOCKETDATA, this);
  curl_multi_setopt(multi_, CURLMOPT_TIMERFUNCTION, &CurlMulti::on_timer);
  curl_multi_setopt(multi_, CURLMOPT_TIMERDATA, this);
  curl_multi_setopt(multi_, CURLMOPT_PIPELINING, static_cast<long>(CURLPIPE_MULTIPLEX));
  curl_multi_setopt(multi_, CURLMOPT_MAX_HOST_CONNECTIONS, connections);
  curl_multi_setopt(multi_, CURLMOPT_MAXCONNECTS, connections);
}

CurlMulti::~CurlMulti() {
  *is_alive_ = false;
  std::optional<NoSigpipe> guard;
  if (config_.keeps_sigpipe_away) guard.emplace();
  curl_multi_cleanup(multi_);  // closes connections, for which it calls on_close_socket
}

void CurlMulti::prepare(CURL* easy) {
  curl_easy_setopt(easy, CURLOPT_NOSIGNAL, 1L);
  curl_easy_setopt(easy, CURLOPT_CLOSESOCKETFUNCTION, &CurlMulti::on_close_socket);
  curl_easy_setopt(easy, CURLOPT_CLOSESOCKETDATA, this);
}

bool CurlMulti::add(CURL* easy) {
  if (curl_multi_add_handle(multi_, easy) != CURLM_OK) return false;
  ++running_;
  if (!is_acting_) act(CURL_SOCKET_TIMEOUT, 0);  // begins at once, not when the timer has fired
  return true;
}

void CurlMulti::remove(CURL* easy) noexcept {
  std::optional<NoSigpipe> guard;
  if (config_.keeps_sigpipe_away) guard.emplace();
  curl_multi_remove_handle(multi_, easy);
}

int CurlMulti::on_socket(CURL*, curl_socket_t fd, int wants, void* self, void*) {
  auto& multi = *static_cast<CurlMulti*>(self);
  if (wants == CURL_POLL_REMOVE) {
    const auto socket = multi.sockets_.find(fd);
    if (socket == multi.sockets_.end()) return 0;
    // The connection may be used again in a moment: the watch stays until then, or until the socket is closed. But of
    // one that was never connected libcurl does not tell that (it has closed it by now, and its number may be
    // somebody else's).
    if (socket->second.has_been_heard) {
      socket->second.is_idle = true;
    } else {
      multi.sockets_.erase(socket);
    }
    return 0;
  }
  try {
    multi.watch(fd, wants == CURL_POLL_IN    ? FdWatch::readable
                    : wants == CURL_POLL_OUT ? FdWatch::writable
                                             : FdWatch::readable_and_writable);
    return 0;
  } catch (...) {
    return -1;  // the transfers fail
  }
}

void CurlMulti::watch(int fd, FdWatch::Events events) {
  Socket& socket = sockets_[fd];
  socket.is_idle = false;
  if (socket.watch.is_open() && socket.events == events) return;
  socket.events = events;
  if (socket.watch.is_open()) return socket.watch.set_events(events);
  socket.watch = FdWatch(loop_, fd, events, config_.name, [this, fd](const FdEvent& event) { ready(fd, event); });
}

void CurlMulti::ready(int fd, const FdEvent& event) {
  const auto socket = sockets_.find(fd);
  if (socket == sockets_.end()) return;
  if (socket->second.is_idle) {  // the peer has closed it, most probably: libcurl looks before it uses it again
    sockets_.erase(socket);
    return;
  }
  const std::shared_ptr<bool> alive = is_alive_;
  socket->second.has_been_heard = socket->second.has_been_heard || (event.readable && !event.hung_up);
  const int readable = event.readable || event.hung_up ? CURL_CSELECT_IN : 0;
  act(fd, readable | (event.writable ? CURL_CSELECT_OUT : 0));
  if (!*alive || !event.hung_up) return;
  const auto still = sockets_.find(fd);  // the watch is silent after an error until `set_events`
  if (still != sockets_.end() && !still->second.is_idle) still->second.watch.set_events(still->second.events);
}

int CurlMulti::on_close_socket(void* self, curl_socket_t fd) {
  static_cast<CurlMulti*>(self)->sockets_.erase(fd);  // before the descriptor
  return ::close(fd);
}

int CurlMulti::on_timer(CURLM*, long milliseconds, void* self) {
  static_cast<CurlMulti*>(self)->timeout_ms_ = milliseconds;  // nothing of libcurl may be called from here
  return 0;
}

void CurlMulti::act_once(curl_socket_t fd, int mask) {
  std::optional<NoSigpipe> guard;
  if (config_.keeps_sigpipe_away) guard.emplace();
  curl_multi_socket_action(multi_, fd, mask, &running_);
}

void CurlMulti::act(curl_socket_t fd, int mask) {
  constexpr int most_rounds = 100;
  const std::shared_ptr<bool> alive = is_alive_;
  is_acting_ = true;
  act_once(fd, mask);
  for (int round = 0; round < most_rounds; ++round) {
    int left = 0;
    while (CURLMsg* const message = curl_multi_info_read(multi_, &left)) {
      if (message->msg != CURLMSG_DONE) continue;
      CURL* const easy = message->easy_handle;
      const CURLcode result = message->data.result;
      remove(easy);
      done_(easy, result);
      if (!*alive) return;
    }
    if (timeout_ms_ != 0) break;
    timeout_ms_ = -1;
    act_once(CURL_SOCKET_TIMEOUT, 0);
  }
  is_acting_ = false;
  arm();
}

void CurlMulti::arm() {
  if (running_ == 0) {  // nothing of an idle connection keeps the loop
    timer_.stop();
    std::erase_if(sockets_, [](const auto& socket) { return socket.second.is_idle; });
    return;
  }
  if (timeout_ms_ < 0) return;  // a timer that runs already costs a look
  const auto due = std::chrono::steady_clock::now() + std::chrono::milliseconds{timeout_ms_};
  if (timer_.is_running() && due_ <= due) return;
  due_ = due;
  timer_.start(std::chrono::milliseconds{timeout_ms_});
}

}  // namespace rtdata::detail
