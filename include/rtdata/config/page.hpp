/// PageSettings: the settings of the live page that the program serves (docs/page.md), key `page` of the file.
///
/// Values; any thread. Errors: problems of the configuration.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/data/error.hpp"
#include "rtdata/data/parameter.hpp"

namespace rtdata {

/// Where a page is served: "127.0.0.1:8080", "[::1]:8080", "localhost:8080". Port 0: any that is free.
struct PageAddress {
  std::string host = "127.0.0.1";  ///< numbers, without brackets
  std::uint16_t port = 8080;

  bool is_ipv6() const noexcept { return host.find(':') != std::string::npos; }
  /// Only programs of this machine reach it.
  bool is_loopback() const noexcept;
  /// "127.0.0.1:8080", "[::1]:8080"
  std::string text() const;
};
/// A text without a port gets 8080. Errors: bad-argument.
Result<PageAddress> parse_page_address(std::string_view text);

/// The files of a certificate, as PEM.
struct PageTls {
  std::string certificate = {};
  std::string key = {};

  friend constexpr auto parameters(type_tag<PageTls>) {
    return parameter_list(parameter("certificate", &PageTls::certificate,
                                    "file with its certificate and those that signed it", required, TextIs::device),
                          parameter("key", &PageTls::key, "file with its private key", required, TextIs::device));
  }
};

struct PageSettings {
  std::string listen = {};                 ///< a PageAddress; empty: there is no page
  std::vector<std::string> commands = {};  ///< commands that the page may give
  std::string token = {};                  ///< empty: made at each start
  std::vector<std::string> names = {};     ///< further names of the machine in browsers' addresses
  std::optional<PageTls> tls = {};
  bool behind_tls_proxy = false;

  friend constexpr auto parameters(type_tag<PageSettings>) {
    return parameter_list(
        parameter("listen", &PageSettings::listen, "address of the page, such as 127.0.0.1:8080", required,
                  TextIs::recorded),
        parameter("commands", &PageSettings::commands, "commands that its users may give", TextIs::recorded,
                  choices("note", "ack", "event", "set", "arm", "disarm", "start", "stop")),
        parameter("token", &PageSettings::token,
                  "secret that a browser must give, at least 16 characters; default: a new one at each start"),
        parameter("names", &PageSettings::names,
                  "further names of this machine that a browser's address may have, such as bench.example",
                  TextIs::recorded),
        parameter("tls", &PageSettings::tls, "certificate for encryption; default: not encrypted"),
        parameter("behind_tls_proxy", &PageSettings::behind_tls_proxy,
                  "the page is reachable only through another server, which encrypts it"));
  }
  /// Refuses an invalid address; a token that could be guessed; without encryption, commands that set something on an
  /// address that others can reach.
  friend void check_config(const PageSettings& settings, const ConfigItem& item, Problems& problems);
};

}  // namespace rtdata
