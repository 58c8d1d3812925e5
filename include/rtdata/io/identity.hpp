/// check_identity: for drivers of chips that have an identity. If the user trusts a clone or a new revision and sets
/// its identity, the driver accepts a chip with this identity instead of the known one, and no other.
///
///     class Thermometer {                                        // a driver (driver.hpp)
///       struct Config {
///         std::optional<rtdata::IdentityCode> identity{};        // {"identity": "0x98"}; checked with the Config
///         friend constexpr auto parameters(rtdata::type_tag<Config>) {
///           return rtdata::parameter_list(rtdata::identity_parameter(&Config::identity));
///         }
///       };
///       static constexpr rtdata::KnownChip chips[] = {
///           {.name = "TMP117", .addresses = {0x48}, .identity = {{0x0f, 0x0117, 0x0fff}}}};
///       Config config_;
///       rtdata::Result<void> open(rtdata::I2cDevice& chip) {
///         return rtdata::check_identity(chip, chips[0], config_.identity);
///       }
///     };
///
/// A sensor that accepts such a chip reports it in the log and in recordings.
///
/// Errors: bad-data (another chip), those of the bus. Thread: the bus's lane; the functions without a device: any.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>

#include "rtdata/data/config_value.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/data/parameter.hpp"
#include "rtdata/io/chip.hpp"

namespace rtdata {

/// The identity that the user has set for a chip. In configurations 152 or "0x98".
struct IdentityCode {
  static constexpr std::uint32_t last = 0xffffff;
  std::uint32_t number = 0;
  constexpr IdentityCode() = default;
  constexpr IdentityCode(std::uint32_t number_) : number(number_) {}
  constexpr bool operator==(const IdentityCode&) const = default;
};

template <>
struct ConfigValue<IdentityCode> {
  static constexpr TextOrNumber accepts{0, IdentityCode::last, "^(0[xX]0*[0-9a-fA-F]{1,6}|0*[0-9]{1,7})$"};
  static bool read(const ConfigItem& item, IdentityCode& out, Problems& problems);
  static void write(IdentityCode value, ConfigItem& item);
};

/// The parameter `identity` of a driver.
template <class Config>
constexpr auto identity_parameter(std::optional<IdentityCode> Config::*member) {
  return parameter("identity", member,
                   "for a clone that you trust: the identity that it answers instead of the known one, such as "
                   "\"0x98\"; any other is refused. The log and recordings mention it");
}

/// A Config with that parameter.
template <class Config>
concept HasIdentity = requires(const Config& config) {
  requires std::is_same_v<std::remove_cvref_t<decltype(config.identity)>, std::optional<IdentityCode>>;
};

/// Errors: bad-argument (the chip has no such register, or it has fewer bits); `where` is "identity".
Result<void> check_identity_setting(const KnownChip& known, const std::optional<IdentityCode>& word);
/// "0x98 by the user's word, in place of 0x68 of an MPU-6050". Empty: the user has set none.
std::string identity_by_word(const KnownChip& known, const std::optional<IdentityCode>& word);
/// "an MPU-6050", "a BME680 or BME688".
std::string with_article(std::string_view chip);

namespace detail {
struct IdentityRefusal {
  std::string what, why;
  std::string advice;  ///< what else to do than to look for another chip; empty: nothing
  std::string clone;   ///< what to do about one that the user trusts
};
/// Empty: the chip with the identity `found` is accepted.
std::optional<IdentityRefusal> identity_refusal(const KnownChip& known, const std::optional<IdentityCode>& word,
                                                std::uint32_t found);
/// True if all bits are ones, as missing registers mostly read.
constexpr bool is_all_ones(const ChipIdentity& identity, std::uint32_t found) noexcept {
  return found == (std::uint32_t{1} << 8 * identity.size()) - 1;
}
}  // namespace detail

/// All its bits, also those that do not count.
template <class Device>
Result<std::uint32_t> read_identity(Device& chip, const ChipIdentity& identity) {
  std::array<std::uint8_t, 3> bytes{};
  const auto used = std::span(bytes).first(identity.size());
  if (auto done = chip.read_registers(identity.number, used); !done) return std::move(done).error();
  std::uint32_t found = 0;
  for (const std::uint8_t byte : used) found = found << 8 | byte;
  return found;
}

/// "it seems to be an MPU-9250: set `model`", if the chip answers as one of these, which are KnownChips, or models with
/// one as `chip`. Otherwise empty.
template <class Device, class Others>
std::string seems_to_be(Device& chip, const Others& others) {
  for (const auto& other : others) {
    const KnownChip& known = [&]() -> const KnownChip& {
      if constexpr (requires { other.chip; })
        return other.chip;
      else
        return other;
    }();
    if (!known.identity) continue;
    const Result<std::uint32_t> found = read_identity(chip, *known.identity);
    if (found && known.identity->is_of(*found) && !detail::is_all_ones(*known.identity, *found))
      return "it seems to be " + with_article(known.name) + ": set `model`";
  }
  return {};
}

/// Checks that the chip has the identity of `known` or, if the user has set one, that one. `others`: as for
/// `seems_to_be`, or a function of the device that returns such a text. `advice`: what to do if it is none of them.
template <class Device, class Others = std::span<const KnownChip>>
Result<void> check_identity(Device& chip, const KnownChip& known, const std::optional<IdentityCode>& word,
                            const Others& others = {},
                            std::string_view advice = "check which chip is at this address") {
  if (!known.identity) return {};
  const Result<std::uint32_t> found = read_identity(chip, *known.identity);
  if (!found) return found.error();
  auto refusal = detail::identity_refusal(known, word, *found);
  if (!refusal) return {};
  if (refusal->advice.empty()) {
    if constexpr (std::is_invocable_v<const Others&, Device&>)
      refusal->advice = others(chip);
    else
      refusal->advice = seems_to_be(chip, others);
    if (refusal->advice.empty())
      refusal->advice = std::string(advice) + refusal->clone;
    else if (word)
      refusal->advice += ", and remove `identity`";
  }
  return chip.error(Errc::bad_data, refusal->what, refusal->why, refusal->advice);
}

}  // namespace rtdata
