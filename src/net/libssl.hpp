// OpenSSL's libssl, and the libcrypto that it needs, loaded when it is first needed: loaded_library.hpp.
#pragma once

#include <openssl/err.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>

#include "rtdata/detail/io/loaded_library.hpp"

// clang-format off
#define RTDATA_LIBSSL(of) \
  of(BIO_ctrl) of(BIO_free) of(BIO_new) of(BIO_read) of(BIO_s_mem) of(BIO_write) of(ERR_clear_error) \
  of(ERR_get_error) of(ERR_reason_error_string) of(SSL_CTX_check_private_key) of(SSL_CTX_ctrl) of(SSL_CTX_free) \
  of(SSL_CTX_load_verify_file) of(SSL_CTX_new) of(SSL_CTX_set_default_passwd_cb) \
  of(SSL_CTX_set_default_passwd_cb_userdata) of(SSL_CTX_set_default_verify_paths) of(SSL_CTX_set_verify) \
  of(SSL_CTX_use_PrivateKey_file) of(SSL_CTX_use_certificate_chain_file) of(SSL_ctrl) of(SSL_do_handshake) \
  of(SSL_free) of(SSL_get0_param) of(SSL_get_error) of(SSL_get_verify_result) of(SSL_has_pending) of(SSL_new) \
  of(SSL_read_ex) of(SSL_set1_host) of(SSL_set_bio) of(SSL_set_connect_state) of(SSL_set_hostflags) \
  of(SSL_shutdown) of(SSL_write_ex) of(TLS_client_method) of(X509_VERIFY_PARAM_set1_ip_asc) \
  of(X509_verify_cert_error_string)
// clang-format on

#define RTDATA_TEXT_OF(number) #number
#define RTDATA_NUMBER_AS_TEXT(number) RTDATA_TEXT_OF(number)

RTDATA_LOADED_LIBRARY(libssl, RTDATA_LIBSSL, "`tls`", "OpenSSL", "libssl" RTDATA_NUMBER_AS_TEXT(OPENSSL_SHLIB_VERSION),
                      "libssl.so." RTDATA_NUMBER_AS_TEXT(OPENSSL_SHLIB_VERSION))
