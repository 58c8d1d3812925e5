#include "net/tls_stream.hpp"

#include <cerrno>
#include <utility>

namespace rtdata::detail {
namespace {

constexpr std::size_t most_received = 16384;  // at once

}  // namespace

TlsStream::TlsStream(LoopCore& loop, const std::string& owner, std::function<void(const Result<void>&)> opened,
                     std::function<void()> ready)
    : stream_(
          loop, owner, [this](const Result<void>& result) { connected(result); }, [this] { stream_ready(); }),
      handshake_limit_(loop.face,
                       [this] {
                         handshake_ended(Error{Errc::timed_out, "cannot connect", peer(),
                                               "the TLS handshake took longer than " + to_string(limit_),
                                               "check that the server speaks TLS at this port"});
                       }),
      opened_(std::move(opened)),
      ready_(std::move(ready)) {}

void TlsStream::connect(const std::string& host, std::uint16_t port, Duration limit,
                        std::shared_ptr<const TlsContext> tls) {
  close();
  host_ = host;
  port_ = port;
  limit_ = limit;
  tls_ = std::move(tls);
  stream_.connect(host, port, limit);
}

void TlsStream::close() noexcept {
  stream_.close();
  handshake_limit_.stop();
  session_.reset();
  is_open_ = has_failed_ = wants_to_write_ = is_watched_ = false;
  end_.reset();
  encrypted_ = 0;
}

void TlsStream::connected(const Result<void>& result) {
  if (result && tls_ != nullptr) {
    session_.emplace(tls_, host_);
    handshake_limit_.start(limit_);
    return shake_hands();
  }
  is_open_ = static_cast<bool>(result);
  opened_(result);
}

void TlsStream::stream_ready() {
  if (session_ && !is_open_) return shake_hands();
  if (session_) {
    flush();
    watch();
  }
  ready_();
}

void TlsStream::shake_hands() {
  for (;;) {
    const auto state = session_->handshake();
    flush();  // sends the alert to the peer, too
    if (state == TlsSession::State::done) return handshake_ended({});
    if (state == TlsSession::State::failed || state == TlsSession::State::ended) {
      Error error = session_->error();
      error.where = peer();
      return handshake_ended(std::move(error));
    }
    if (receive()) continue;
    if (!end_) return watch();
    return handshake_ended(
        *end_ != 0 ? system_error(*end_, "cannot connect", peer(), "the connection was lost during the TLS handshake")
                   : Error{Errc::disconnected, "cannot connect", peer(),
                           "the peer closed the connection during the TLS handshake",
                           "check that the server speaks TLS at this port; see its log"});
  }
}

void TlsStream::handshake_ended(const Result<void>& result) {
  handshake_limit_.stop();
  if (result) {
    is_open_ = true;
    watch();
  } else {
    close();
  }
  opened_(result);
}

bool TlsStream::receive() {
  std::byte bytes[most_received];
  for (;;) {
    const ssize_t got = stream_.read(reinterpret_cast<char*>(bytes), sizeof bytes);
    if (got > 0) {
      session_->take({bytes, static_cast<std::size_t>(got)});
      return true;
    }
    if (got < 0 && errno == EINTR) continue;
    if (got == 0) end_ = 0;
    if (got < 0 && errno != EAGAIN) end_ = errno;
    return false;
  }
}

bool TlsStream::flush() noexcept {
  for (;;) {
    const auto bytes = session_->output();
    if (bytes.empty()) return true;
    const ssize_t done = stream_.write(bytes.data(), bytes.size());
    if (done < 0 && errno == EINTR) continue;
    if (done < 0) return false;
    session_->sent(static_cast<std::size_t>(done));
  }
}

ssize_t TlsStream::read(char* to, std::size_t most) {
  if (!session_) return stream_.read(to, most);
  for (;;) {
    std::size_t got = 0;
    switch (session_->read(to, most, got)) {
      case TlsSession::State::done:
        return static_cast<ssize_t>(got);
      case TlsSession::State::ended:
        return 0;
      case TlsSession::State::failed:
        flush();
        has_failed_ = true;
        errno = EPROTO;
        return -1;
      case TlsSession::State::more:
        break;
    }
    if (receive()) continue;
    watch();  // the session may have an answer of its own
    if (!end_) {
      errno = EAGAIN;
      return -1;
    }
    if (*end_ == 0) return 0;
    errno = *end_;
    return -1;
  }
}

ssize_t TlsStream::write(const std::byte* from, std::size_t size) {
  if (!session_) return stream_.write(from, size);
  if (encrypted_ == 0) {
    if (!flush()) return -1;
    encrypted_ = session_->write({from, size});
    if (encrypted_ == 0) {
      has_failed_ = true;
      errno = EPROTO;
      return -1;
    }
  }
  if (!flush()) return -1;
  return static_cast<ssize_t>(std::exchange(encrypted_, 0));
}

Error TlsStream::failure(int error_number) const {
  if (!has_failed_)
    return system_error(error_number, "lost the connection", peer(), "the program connects to it again");
  Error error = session_->error();
  error.where = peer();
  return error;
}

void TlsStream::want_to_write(bool wanted) {
  wants_to_write_ = wanted;
  watch();
}

void TlsStream::watch() {
  const bool is_wanted = wants_to_write_ || (session_ && !session_->output().empty());
  if (std::exchange(is_watched_, is_wanted) != is_wanted) stream_.want_to_write(is_wanted);
}

std::size_t TlsStream::unconfirmed() const noexcept {
  return stream_.unconfirmed() + (session_ ? session_->output().size() : 0);
}

void TlsStream::end_writing() {
  if (session_) {
    session_->send_close_notify();
    flush();
  }
  stream_.end_writing();
}

}  // namespace rtdata::detail
