// IP addresses written as numbers.
#pragma once

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cstdint>
#include <cstring>
#include <optional>
#include <string>

#include "data/setting_mistake.hpp"

namespace rtdata::detail {

struct IpAddress {
  sockaddr_storage storage{};
  socklen_t size = 0;
  const sockaddr* get() const noexcept { return reinterpret_cast<const sockaddr*>(&storage); }
  bool is_v6() const noexcept { return storage.ss_family == AF_INET6; }
  const sockaddr_in& v4() const noexcept { return reinterpret_cast<const sockaddr_in&>(storage); }
  const sockaddr_in6& v6() const noexcept { return reinterpret_cast<const sockaddr_in6&>(storage); }
  bool is_group() const noexcept {
    return is_v6() ? IN6_IS_ADDR_MULTICAST(&v6().sin6_addr) : IN_MULTICAST(ntohl(v4().sin_addr.s_addr));
  }
  bool is_same_host(const IpAddress& other) const noexcept {
    if (storage.ss_family != other.storage.ss_family) return false;
    return is_v6() ? std::memcmp(&v6().sin6_addr, &other.v6().sin6_addr, sizeof(in6_addr)) == 0
                   : v4().sin_addr.s_addr == other.v4().sin_addr.s_addr;
  }
};

/// "192.168.1.7", "::1"; no names.
inline std::optional<IpAddress> ip_address(const std::string& text, std::uint16_t port) {
  IpAddress address;
  auto& v4 = reinterpret_cast<sockaddr_in&>(address.storage);
  auto& v6 = reinterpret_cast<sockaddr_in6&>(address.storage);
  if (::inet_pton(AF_INET, text.c_str(), &v4.sin_addr) == 1) {
    v4.sin_family = AF_INET;
    v4.sin_port = htons(port);
    address.size = sizeof v4;
    return address;
  }
  if (::inet_pton(AF_INET6, text.c_str(), &v6.sin6_addr) != 1) return std::nullopt;
  v6.sin6_family = AF_INET6;
  v6.sin6_port = htons(port);
  address.size = sizeof v6;
  return address;
}

/// `key`: parameter of this computer's address. `from`: address of the only sender; empty: all.
inline SettingMistake mistake_in_addresses(const char* key, const std::string& own, const std::string& from) {
  const auto address = ip_address(own, 0);
  if (!address) return {key, "\"" + own + "\" is not an IP address, such as 0.0.0.0"};
  if (from.empty()) return {};
  const auto sender = ip_address(from, 0);
  if (!sender) return {"from", "\"" + from + "\" is not an IP address, such as 192.168.1.7"};
  if (sender->is_v6() != address->is_v6())
    return {"from", "it is not of the same kind (IPv4 or IPv6) as `" + std::string(key) + "`"};
  return {};
}

}  // namespace rtdata::detail
