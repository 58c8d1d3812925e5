// A TCP connection to a server that may be encrypted: like TcpStream, with a TLS handshake before it is open.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "net/tcp_stream.hpp"
#include "net/tls_session.hpp"

namespace rtdata::detail {

/// Owner: the node whose stream it is. Thread: the loop's.
class TlsStream {
 public:
  /// As TcpStream. The two functions may close the stream, but not destroy it.
  TlsStream(LoopCore& loop, const std::string& owner, std::function<void(const Result<void>&)> opened,
            std::function<void()> ready);

  /// Without `tls`, bytes are not encrypted. `limit`: for each address to answer, and again for the handshake.
  void connect(const std::string& host, std::uint16_t port, Duration limit, std::shared_ptr<const TlsContext> tls);
  bool is_open() const noexcept { return is_open_; }
  bool is_connecting() const noexcept { return !is_open_ && (stream_.is_connecting() || stream_.is_open()); }
  bool is_encrypted() const noexcept { return session_.has_value(); }
  void close() noexcept;
  /// As read(2) and write(2); never blocks. After -1 and an errno that is not EAGAIN or EINTR, `failure` says why.
  /// After a `write` with EAGAIN, pass the same data to the next `write`.
  ssize_t read(char* to, std::size_t most);
  ssize_t write(const std::byte* from, std::size_t size);
  /// True if data that was already received can be read: `ready` is not called for it.
  bool has_unread() const noexcept { return session_ && session_->has_unread(); }
  Error failure(int error_number) const;
  /// See TcpStream.
  void want_to_write(bool wanted);
  std::size_t unconfirmed() const noexcept;
  void end_writing();

 private:
  void connected(const Result<void>& result);
  void stream_ready();
  void shake_hands();
  void handshake_ended(const Result<void>& result);
  /// Requests calls while the connection accepts bytes, if needed.
  void watch();
  /// Passes received bytes to the session. False: none. `end_` tells if the connection has ended.
  bool receive();
  /// Sends what the session has for the peer. False: not all of it now; or the connection has failed.
  bool flush() noexcept;
  std::string peer() const { return host_ + " port " + std::to_string(port_); }

  TcpStream stream_;
  Timer handshake_limit_;
  const std::function<void(const Result<void>&)> opened_;
  const std::function<void()> ready_;
  std::string host_;
  std::uint16_t port_ = 0;
  Duration limit_{0};
  std::shared_ptr<const TlsContext> tls_;
  std::optional<TlsSession> session_;
  bool is_open_ = false;
  bool has_failed_ = false;      // the session
  bool wants_to_write_ = false;  // the user
  bool is_watched_ = false;      // for that, or for what the session has to send
  std::optional<int> end_;       // errno of the connection; 0: the peer has closed it
  std::size_t encrypted_ = 0;    // bytes of the last write that are not completely sent
};

}  // namespace rtdata::detail
