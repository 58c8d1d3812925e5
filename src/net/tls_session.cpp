#include "net/tls_session.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#ifdef RTDATA_WITH_OPENSSL
#include "data/no_memory.hpp"
#include "net/libssl.hpp"
#endif

namespace rtdata::detail {

static constexpr const char* not_trusted = "it is not trusted";

std::string advice_on_certificate(long verified, const std::string& key) {
  switch (verified) {
    case 10:  // X509_V_ERR_CERT_HAS_EXPIRED
      return "renew the server's certificate, which has expired, or set this computer's clock (`date`)";
    case 9:  // ..._CERT_NOT_YET_VALID
      return "check this computer's clock (`date`): the server's certificate is not valid yet";
    case other_host_name:
    case 64:  // ..._IP_ADDRESS_MISMATCH
      return "use the name of the server's certificate in `" + key + "`, or get a certificate for this name";
    case 18:  // ..._DEPTH_ZERO_SELF_SIGNED_CERT
    case 19:  // ..._SELF_SIGNED_CERT_IN_CHAIN
      return "if you trust the server's self-signed certificate, set `tls.ca_file` to its file, or to that of its "
             "authority";
    default:
      return "set `tls.ca_file` to the certificate of the authority that signed the server's, or install the package "
             "ca-certificates";
  }
}

#ifdef RTDATA_WITH_OPENSSL

namespace {

constexpr std::size_t most_written = 16384;  // bytes of a TLS record

/// OpenSSL's text for the last failure, from its first cause; empties its error queue.
std::string last_reason() {
  const unsigned long code = ERR_get_error();
  ERR_clear_error();
  const char* text = code == 0 ? nullptr : ERR_reason_error_string(code);
  return text != nullptr ? text : "";
}

int password_of(char* to, int size, int, void* config) {
  const std::string& password = static_cast<const TlsConfig*>(config)->key_password;
  if (password.size() > static_cast<std::size_t>(size)) return -1;
  std::memcpy(to, password.data(), password.size());
  return static_cast<int>(password.size());
}

struct Deleter {
  void operator()(SSL* session) const noexcept { SSL_free(session); }
  void operator()(SSL_CTX* context) const noexcept { SSL_CTX_free(context); }
};

}  // namespace

long verify_result_of(void* ssl) noexcept {
  return ssl == nullptr || !load_tls() ? X509_V_OK : SSL_get_verify_result(static_cast<const SSL*>(ssl));
}
std::string text_of_verify_result(long verified) {
  return load_tls() ? X509_verify_cert_error_string(verified) : not_trusted;
}

Result<void> load_tls() { return libssl.load(); }

struct TlsContext::Impl {
  std::unique_ptr<SSL_CTX, Deleter> context;
  bool is_verified = true;
};

TlsContext::TlsContext(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TlsContext::~TlsContext() = default;

Result<std::shared_ptr<const TlsContext>> TlsContext::load(const TlsConfig& config) {
  if (auto loaded = load_tls(); !loaded) return loaded.error();
  ERR_clear_error();
  auto impl = std::make_unique<Impl>();
  impl->context.reset(SSL_CTX_new(TLS_client_method()));
  impl->is_verified = config.verify;
  SSL_CTX* const context = impl->context.get();
  const auto refuse = [](const std::string& path, const char* advice) {
    return Error{Errc::bad_data, "cannot use a file for TLS", path, last_reason(), advice};
  };
  if (context == nullptr) return refuse("OpenSSL", "");
  SSL_CTX_set_min_proto_version(context, TLS1_2_VERSION);
  SSL_CTX_set_mode(context, SSL_MODE_ENABLE_PARTIAL_WRITE | SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER);
  SSL_CTX_set_verify(context, config.verify ? SSL_VERIFY_PEER : SSL_VERIFY_NONE, nullptr);
  if (config.verify) {
    const int loaded = config.ca_file.empty() ? SSL_CTX_set_default_verify_paths(context)
                                              : SSL_CTX_load_verify_file(context, config.ca_file.c_str());
    if (loaded != 1)
      return refuse(config.ca_file.empty() ? "the authorities of this computer" : config.ca_file,
                    "check `tls.ca_file`: it must exist, be readable, and be PEM");
  }
  if (!config.certificate.empty()) {
    constexpr const char* advice = "check the files `tls.certificate` and `tls.key`, and `tls.key_password`";
    SSL_CTX_set_default_passwd_cb(context, password_of);  // otherwise OpenSSL asks at the terminal
    SSL_CTX_set_default_passwd_cb_userdata(context, const_cast<TlsConfig*>(&config));
    if (SSL_CTX_use_certificate_chain_file(context, config.certificate.c_str()) != 1)
      return refuse(config.certificate, advice);
    if (SSL_CTX_use_PrivateKey_file(context, config.key.c_str(), SSL_FILETYPE_PEM) != 1 ||
        SSL_CTX_check_private_key(context) != 1)
      return refuse(config.key, advice);
    SSL_CTX_set_default_passwd_cb_userdata(context, nullptr);
  }
  return std::shared_ptr<const TlsContext>(new TlsContext(std::move(impl)));
}

struct TlsSession::Impl {
  std::unique_ptr<SSL, Deleter> ssl;
  BIO* in = nullptr;  // its own
  BIO* out = nullptr;
};

TlsSession::TlsSession(std::shared_ptr<const TlsContext> context, const std::string& host)
    : context_(std::move(context)), impl_(std::make_unique<Impl>()) {
  const TlsContext::Impl& of = *context_->impl_;
  impl_->ssl.reset(SSL_new(of.context.get()));
  impl_->in = BIO_new(BIO_s_mem());
  impl_->out = BIO_new(BIO_s_mem());
  SSL* const ssl = impl_->ssl.get();
  if (ssl == nullptr || impl_->in == nullptr || impl_->out == nullptr) {
    BIO_free(impl_->in);
    BIO_free(impl_->out);
    no_memory();
  }
  SSL_set_bio(ssl, impl_->in, impl_->out);
  SSL_set_connect_state(ssl);
  const bool is_address = X509_VERIFY_PARAM_set1_ip_asc(SSL_get0_param(ssl), host.c_str()) == 1;
  if (is_address) return;
  ERR_clear_error();
  SSL_set_tlsext_host_name(ssl, host.c_str());
  SSL_set_hostflags(ssl, X509_CHECK_FLAG_NO_PARTIAL_WILDCARDS);
  if (SSL_set1_host(ssl, host.c_str()) != 1) no_memory();
}

TlsSession::~TlsSession() = default;

TlsSession::State TlsSession::failed(int result) {
  SSL* const ssl = impl_->ssl.get();
  switch (SSL_get_error(ssl, result)) {
    case SSL_ERROR_WANT_READ:
    case SSL_ERROR_WANT_WRITE:
      return State::more;
    case SSL_ERROR_ZERO_RETURN:
      return State::ended;
    default:
      break;
  }
  const std::string reason = last_reason();
  const long verified = SSL_get_verify_result(ssl);
  if (context_->impl_->is_verified && verified != X509_V_OK) {
    error_ = {Errc::not_permitted, "cannot trust the server", "", text_of_verify_result(verified),
              advice_on_certificate(verified, "host")};
  } else {
    error_ = {
        Errc::io_failed, "the encrypted connection failed", "",
        reason.empty() ? "the peer broke the rules of TLS" : reason,
        "check that the server speaks TLS at this port; it may also need a client certificate (`tls.certificate`)"};
  }
  return State::failed;
}

TlsSession::State TlsSession::handshake() {
  ERR_clear_error();
  const int result = SSL_do_handshake(impl_->ssl.get());
  return result == 1 ? State::done : failed(result);
}

TlsSession::State TlsSession::read(char* to, std::size_t most, std::size_t& got) {
  ERR_clear_error();
  got = 0;
  const int result = SSL_read_ex(impl_->ssl.get(), to, most, &got);
  return result == 1 ? State::done : failed(result);
}

std::size_t TlsSession::write(std::span<const std::byte> bytes) {
  ERR_clear_error();
  std::size_t written = 0;
  const int result = SSL_write_ex(impl_->ssl.get(), bytes.data(), std::min(bytes.size(), most_written), &written);
  if (result == 1) return written;
  failed(result);
  return 0;
}

void TlsSession::send_close_notify() {
  ERR_clear_error();
  SSL_shutdown(impl_->ssl.get());
  ERR_clear_error();
}

void TlsSession::take(std::span<const std::byte> bytes) {
  BIO_write(impl_->in, bytes.data(), static_cast<int>(bytes.size()));
}

bool TlsSession::has_unread() const noexcept {
  return SSL_has_pending(impl_->ssl.get()) == 1 || BIO_pending(impl_->in) > 0;
}

std::span<const std::byte> TlsSession::output() const noexcept {
  char* data = nullptr;
  const long size = BIO_get_mem_data(impl_->out, &data);
  return {reinterpret_cast<const std::byte*>(data), size > 0 ? static_cast<std::size_t>(size) : 0};
}

void TlsSession::sent(std::size_t bytes) {
  char thrown_away[4096];
  while (bytes > 0) {
    const int got = BIO_read(impl_->out, thrown_away, static_cast<int>(std::min(bytes, sizeof thrown_away)));
    if (got <= 0) return;
    bytes -= static_cast<std::size_t>(got);
  }
}

#else

long verify_result_of(void*) noexcept { return 0; }
std::string text_of_verify_result(long) { return not_trusted; }

Result<void> load_tls() {
  return Error{Errc::not_found, "cannot encrypt", "", "this program was built without OpenSSL",
               "install libssl-dev and build it again, or remove `tls`"};
}

struct TlsContext::Impl {};
TlsContext::TlsContext(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TlsContext::~TlsContext() = default;

Result<std::shared_ptr<const TlsContext>> TlsContext::load(const TlsConfig&) { return load_tls().error(); }

struct TlsSession::Impl {};
TlsSession::TlsSession(std::shared_ptr<const TlsContext> context, const std::string&) : context_(std::move(context)) {}
TlsSession::~TlsSession() = default;
TlsSession::State TlsSession::failed(int) { return State::failed; }
TlsSession::State TlsSession::handshake() { return State::failed; }
TlsSession::State TlsSession::read(char*, std::size_t, std::size_t&) { return State::failed; }
std::size_t TlsSession::write(std::span<const std::byte>) { return 0; }
void TlsSession::send_close_notify() {}
void TlsSession::take(std::span<const std::byte>) {}
bool TlsSession::has_unread() const noexcept { return false; }
std::span<const std::byte> TlsSession::output() const noexcept { return {}; }
void TlsSession::sent(std::size_t) {}

#endif

}  // namespace rtdata::detail
