/// TlsConfig: how a connection is encrypted, and how its ends prove who they are.
///
///     "tls": {"ca_file": "/etc/rtdata/ca.pem", "certificate": "node7.pem", "key": "node7.key"}
///
/// The peer's certificate is checked unless that is switched off: that an authority which this machine trusts has
/// signed it, that it is valid now, and that it is for the host that was asked for. A machine whose clock is far off
/// finds no certificate valid.
///
/// A value; any thread.
#pragma once

#include <string>
#include <vector>

#include "rtdata/data/parameter.hpp"

namespace rtdata {

struct TlsConfig {
  /// Whether the peer has to prove who it is. False: anybody between this machine and the peer can read and change
  /// everything.
  bool verify = true;
  std::string ca_file = {};      ///< the authorities (PEM) that are trusted; empty: those of this machine
  std::string certificate = {};  ///< file (PEM) by which this machine proves who it is, where the peer asks for it
  std::string key = {};          ///< file (PEM) with the private key of `certificate`
  std::string key_password = {};

  friend constexpr auto parameters(type_tag<TlsConfig>) {
    return parameter_list(
        parameter("verify", &TlsConfig::verify,
                  "false: the peer need not prove who it is, so that anybody between can read and change everything"),
        parameter("ca_file", &TlsConfig::ca_file,
                  "file (PEM) with the authorities that are trusted; default: those of this machine"),
        parameter("certificate", &TlsConfig::certificate,
                  "file (PEM) by which this machine proves who it is, where the peer asks for it"),
        parameter("key", &TlsConfig::key, "file (PEM) with the private key of the certificate"),
        parameter("key_password", &TlsConfig::key_password, "of the key, where it has one"));
  }
};

struct TlsMistake {
  std::string key;  ///< "certificate"
  std::string message;
};
/// What is wrong with it by itself: a certificate without a key, a file that cannot be read. Opens the files; nothing
/// is sent.
std::vector<TlsMistake> mistakes_of(const TlsConfig& config);

}  // namespace rtdata
