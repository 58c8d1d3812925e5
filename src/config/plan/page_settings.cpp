#include "rtdata/config/page.hpp"

#include <arpa/inet.h>

#include <algorithm>
#include <array>
#include <cctype>

#include "config/read/mistakes.hpp"
#include "data/number_text.hpp"

namespace rtdata {

using config_detail::child_or_self;

namespace {

constexpr std::size_t shortest_token = 16, longest_token = 200;
constexpr std::array setting_commands{"set", "arm", "disarm", "start", "stop"};

}  // namespace

bool PageAddress::is_loopback() const noexcept { return host == "::1" || host.starts_with("127."); }

std::string PageAddress::text() const { return (is_ipv6() ? "[" + host + "]" : host) + ":" + std::to_string(port); }

Result<PageAddress> parse_page_address(std::string_view text) {
  const auto refused = [&](const char* why) {
    return Error{Errc::bad_argument, "cannot use the address of a page", std::string(text), why,
                 "write one such as 127.0.0.1:8080, [::1]:8080 or 0.0.0.0:8080"};
  };
  PageAddress address;
  std::string_view host = text, port;
  if (text.starts_with('[')) {
    const std::size_t end = text.find(']');
    if (end == std::string_view::npos) return refused("a bracket is not closed");
    host = text.substr(1, end - 1);
    port = text.substr(end + 1);
    if (!port.empty() && !port.starts_with(':')) return refused("a port such as :8080 must follow the bracket");
  } else if (const std::size_t colon = text.find(':'); colon != std::string_view::npos) {
    host = text.substr(0, colon);
    port = text.substr(colon);
  }
  if (!port.empty() && detail::read_number(port.substr(1), address.port) != std::errc{})
    return refused("its port is not a number from 0 to 65535");
  address.host = host == "localhost" ? "127.0.0.1" : host;
  std::array<unsigned char, 16> bytes{};
  if (::inet_pton(address.is_ipv6() ? AF_INET6 : AF_INET, address.host.c_str(), bytes.data()) != 1)
    return refused("it does not begin with an IP address of this machine");
  return address;
}

void check_config(const PageSettings& settings, const ConfigItem& item, Problems& problems) {
  const auto complain = [&](const char* key, std::string message) {
    problems.add(child_or_self(item, key).problem("bad-value", std::move(message)));
  };
  const bool is_allowed = std::all_of(settings.token.begin(), settings.token.end(), [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '-' || c == '_' || c == '.' || c == '~';
  });
  if (!settings.token.empty() && settings.token.size() < shortest_token)
    complain("token", "it has " + std::to_string(settings.token.size()) + " characters, and could be guessed: give " +
                          std::to_string(shortest_token) +
                          " or more, or remove `token`: then a new one is made at each start");
  if (settings.token.size() > longest_token || !is_allowed)
    complain("token", "use only letters, digits and the characters - _ . ~, at most " + std::to_string(longest_token) +
                          " of them");
  const Result<PageAddress> address = parse_page_address(settings.listen);
  if (!address) return complain("listen", address.error().why + ": " + address.error().advice);
  if (settings.tls && settings.behind_tls_proxy)
    complain("behind_tls_proxy", "give `tls` or `behind_tls_proxy`, not both");
  if (address->is_loopback() || settings.tls || settings.behind_tls_proxy) return;
  for (const std::string& command : settings.commands) {
    if (std::find(setting_commands.begin(), setting_commands.end(), command) == setting_commands.end()) continue;
    complain("commands",
             "on " + settings.listen + ", which others reach, \"" + command +
                 "\" is sent unencrypted: give `tls`, or `behind_tls_proxy` where another server encrypts it");
  }
}

}  // namespace rtdata
