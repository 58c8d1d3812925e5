// The client side of TLS with OpenSSL, over bytes that the caller reads and writes.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <string>

#include "rtdata/data/error.hpp"
#include "rtdata/net/tls.hpp"

namespace rtdata::detail {

/// Advice for a server's certificate that was refused for the reason `verified` (X509_V_ERR_...). `key` is the
/// parameter with the server's name.
std::string advice_on_certificate(long verified, const std::string& key);

/// OpenSSL's verification error for the peer's certificate in a session of another library (`ssl`: its SSL*); 0: none,
/// or no OpenSSL.
long verify_result_of(void* ssl) noexcept;
/// For display.
std::string text_of_verify_result(long verified);
constexpr long other_host_name = 62;  // X509_V_ERR_HOSTNAME_MISMATCH

/// OpenSSL can be used. Errors: not-found (this was built without it, or it is not installed).
Result<void> load_tls();

/// Trusted authorities and our own certificate, read from files once for all connections to a peer.
class TlsContext {
 public:
  /// Reads the files, so it may block. Errors: those of load_tls, bad-data (a file that is not PEM, a
  /// key of another certificate, a wrong password).
  static Result<std::shared_ptr<const TlsContext>> load(const TlsConfig& config);
  ~TlsContext();
  TlsContext(const TlsContext&) = delete;
  TlsContext& operator=(const TlsContext&) = delete;

 private:
  friend class TlsSession;
  struct Impl;
  explicit TlsContext(std::unique_ptr<Impl> impl);
  const std::unique_ptr<Impl> impl_;
};

/// One connection. Never blocks. Any thread, one at a time.
class TlsSession {
 public:
  /// `host`: the name or address that the peer's certificate must be for.
  TlsSession(std::shared_ptr<const TlsContext> context, const std::string& host);
  ~TlsSession();
  TlsSession(const TlsSession&) = delete;
  TlsSession& operator=(const TlsSession&) = delete;

  enum class State {
    more,   ///< the session needs more bytes from the peer
    done,   ///< the handshake is complete; bytes were read
    ended,  ///< the peer has said goodbye
    failed  ///< `error` says why
  };
  State handshake();
  State read(char* to, std::size_t most, std::size_t& got);
  /// Encrypts up to 16 KiB. Returns the number of bytes; 0: failed.
  std::size_t write(std::span<const std::byte> bytes);
  void send_close_notify();

  /// Takes bytes from the peer.
  void take(std::span<const std::byte> bytes);
  /// True if it has decrypted bytes that were not read yet.
  bool has_unread() const noexcept;
  /// Bytes to send to the peer; valid until the next call of this object.
  std::span<const std::byte> output() const noexcept;
  void sent(std::size_t bytes);

  /// After `failed`: what, why and what to do; `where` is left to the caller.
  const Error& error() const noexcept { return error_; }

 private:
  State failed(int result);
  struct Impl;
  const std::shared_ptr<const TlsContext> context_;
  const std::unique_ptr<Impl> impl_;
  Error error_;
};

}  // namespace rtdata::detail
