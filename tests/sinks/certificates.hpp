// Certificates of every kind, made by OpenSSL, for servers that the tests start.
#pragma once

#include <doctest/doctest.h>
#include <unistd.h>

#include <cstdlib>
#include <string>
#include <vector>

#include "app/process.hpp"

namespace sinks {

inline const std::string openssl = "/usr/bin/openssl";

/// An authority, and certificates of a server on this machine: right, expired, self-signed, of another name; one of a
/// client, with a password on its key. Made once.
class Certificates {
 public:
  static const Certificates& all() {
    static const Certificates made;
    return made;
  }
  std::string operator/(const std::string& name) const { return folder_.path() + "/" + name; }
  std::vector<std::string> of(const std::string& name) const {
    return {*this / (name + ".pem"), *this / (name + ".key")};
  }

 private:
  Certificates() {
    const std::string key = " -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes ";
    run("req -x509" + key + "-keyout ca.key -out ca.pem -days 30 -subj /CN=authority");
    run("req -x509" + key +
        "-keyout self.key -out self.pem -days 30 -subj /CN=localhost -addext subjectAltName=IP:127.0.0.1");
    const auto signed_by_ca = [&](const std::string& name, const std::string& names, const std::string& days) {
      run("req" + key + "-keyout " + name + ".key -out " + name + ".csr -subj /CN=" + name);
      folder_.write(name + ".ext", "subjectAltName=" + names + "\n");
      run("x509 -req -in " + name + ".csr -CA ca.pem -CAkey ca.key -CAcreateserial -days " + days + " -extfile " +
          name + ".ext -out " + name + ".pem");
    };
    signed_by_ca("right", "DNS:localhost,IP:127.0.0.1", "30");
    signed_by_ca("expired", "DNS:localhost,IP:127.0.0.1", "-1");
    signed_by_ca("other", "DNS:other.example", "30");
    signed_by_ca("client", "DNS:node7", "30");
    run("ec -in client.key -aes128 -passout pass:key-s3cret -out locked.key");
  }
  void run(const std::string& arguments) const {
    const std::string command = "cd " + folder_.path() + " && " + openssl + " " + arguments + " 2>>errors";
    REQUIRE_MESSAGE(std::system(command.c_str()) == 0, folder_.read("errors"));
  }
  rtdata::test::Folder folder_;
};

}  // namespace sinks

#define NEEDS_PROGRAM(program)                     \
  if (::access((program).c_str(), X_OK) != 0) {    \
    MESSAGE("skipped: there is no " << (program)); \
    return;                                        \
  }
