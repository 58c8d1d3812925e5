/// TlsConfig: encryption of a connection and identity of both sides.
///
///     "tls": {"ca_file": "/etc/rtdata/ca.pem", "certificate": "node7.pem", "key": "node7.key"}
///
/// Unless switched off, the peer's certificate is checked: a trusted authority must have signed it, it must be valid
/// now, and it must name the host. With a wrong clock, no certificate is valid.
///
/// A value; any thread.
#pragma once

#include <string>

#include "rtdata/data/parameter.hpp"

namespace rtdata {

struct TlsConfig {
  /// True: the peer must prove its identity. False: anyone between this machine and the peer can read and change
  /// everything.
  bool verify = true;
  std::string ca_file = {};      ///< trusted authorities (PEM); empty: those of this machine
  std::string certificate = {};  ///< this machine's certificate (PEM file), if the peer asks for one
  std::string key = {};          ///< file (PEM) with the private key of `certificate`
  std::string key_password = {};

  friend constexpr auto parameters(type_tag<TlsConfig>) {
    return parameter_list(
        parameter(
            "verify", &TlsConfig::verify,
            "false: the peer's identity is not checked; anybody between the two can then read and change everything"),
        parameter("ca_file", &TlsConfig::ca_file,
                  "file (PEM) with the trusted authorities; default: those of this computer"),
        parameter("certificate", &TlsConfig::certificate,
                  "file (PEM) with the certificate of this computer, if the peer asks for one"),
        parameter("key", &TlsConfig::key, "file (PEM) with the private key of the certificate"),
        parameter("key_password", &TlsConfig::key_password, "password of the key, if it has one"));
  }
};

}  // namespace rtdata
