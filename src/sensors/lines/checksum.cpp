#include "sensors/lines/checksum.hpp"

#include <algorithm>
#include <charconv>
#include <optional>

#include "data/hex_bytes.hpp"
#include "data/load.hpp"
#include "sensors/core/sysfs_file.hpp"

namespace rtdata::detail {
namespace {

using Type = ChecksumType;
using Form = ChecksumForm;

/// By the names of the catalogue of Greg Cook: CRC-8/SMBUS, /MAXIM-DOW, /NRSC-5, /DVB-S2, CRC-16/ARC, /MODBUS,
/// /IBM-3740, /XMODEM, /IBM-SDLC, /MCRF4XX, CRC-32/ISO-HDLC. `crc8_4d` is in the manual of the lidar LD06.
struct Crc {
  unsigned bits = 0;
  std::uint32_t polynomial = 0, first = 0, last_xor = 0;
  bool is_reflected = false;
};
std::optional<Crc> crc_of(Type type) noexcept {
  switch (type) {
    case Type::crc8:
      return Crc{8, 0x07, 0, 0, false};
    case Type::crc8_maxim:
      return Crc{8, 0x31, 0, 0, true};
    case Type::crc8_nrsc5:
      return Crc{8, 0x31, 0xff, 0, false};
    case Type::crc8_dvb_s2:
      return Crc{8, 0xd5, 0, 0, false};
    case Type::crc8_4d:
      return Crc{8, 0x4d, 0, 0, false};
    case Type::crc16_arc:
      return Crc{16, 0x8005, 0, 0, true};
    case Type::crc16_modbus:
      return Crc{16, 0x8005, 0xffff, 0, true};
    case Type::crc16_ccitt:
      return Crc{16, 0x1021, 0xffff, 0, false};
    case Type::crc16_xmodem:
      return Crc{16, 0x1021, 0, 0, false};
    case Type::crc16_x25:
      return Crc{16, 0x1021, 0xffff, 0xffff, true};
    case Type::crc16_mcrf4xx:
      return Crc{16, 0x1021, 0xffff, 0, true};
    case Type::crc32:
      return Crc{32, 0x04c11db7, 0xffffffff, 0xffffffff, true};
    default:
      return std::nullopt;
  }
}

std::uint32_t reflected(std::uint32_t value, unsigned bits) noexcept {
  std::uint32_t result = 0;
  for (unsigned i = 0; i < bits; ++i)
    if ((value >> i & 1) != 0) result |= std::uint32_t{1} << (bits - 1 - i);
  return result;
}

[[noreturn]] void refuse_checksum(const char* why, const char* advice) {
  throw SetupError({Errc::bad_argument, "cannot use this checksum", "checksum", why, advice});
}

Error wrong_checksum(std::string why) {
  return {Errc::bad_data, "cannot use a line", "", std::move(why), "check `checksum`"};
}

}  // namespace

Checksum::Checksum(const LineChecksum& config) : config_(config) {
  if (config.type == Type::sum6 && config.form != Form::character)
    refuse_checksum("`sum6` is one character", "set `form` to character");
  if (config.type != Type::sum6 && config.form == Form::character)
    refuse_checksum("only `sum6` is one character", "set `form`");
  if (config.covers_after && config.after.empty())
    refuse_checksum("`covers_after` needs `after`", "set `after`, or remove `covers_after`");
  if (config.optional && config.after.empty())
    refuse_checksum("`optional` needs `after`: without it the program cannot tell whether a line has a checksum",
                    "set `after`, or remove `optional`");
  auto appended = bytes_of_hex(config.append_hex);
  if (!appended) refuse_checksum("`append_hex` is not bytes", "write two hexadecimal digits for each, such as \"32\"");
  appended_ = *std::move(appended);
  const bool is_sum = config.type == Type::sum8 || config.type == Type::sum16;
  if (config.complement != Complement::none && !is_sum)
    refuse_checksum("`complement` works only with `sum8` and `sum16`", "remove it");
  if (config.type == Type::sum16 || config.type == Type::fletcher16) bytes_ = 2;
  const auto crc = crc_of(config.type);
  if (!crc) return;
  is_crc_ = true;
  bytes_ = crc->bits / 8;
  first_ = crc->first;
  last_xor_ = crc->last_xor;
  is_reflected_ = crc->is_reflected;
  const std::uint32_t polynomial = is_reflected_ ? reflected(crc->polynomial, crc->bits) : crc->polynomial;
  const std::uint32_t top = std::uint32_t{1} << (crc->bits - 1);
  for (std::uint32_t byte = 0; byte < tables_[0].size(); ++byte) {
    std::uint32_t value = is_reflected_ ? byte : byte << (crc->bits - 8);
    for (int bit = 0; bit < 8; ++bit) {
      if (is_reflected_) {
        value = (value & 1) != 0 ? value >> 1 ^ polynomial : value >> 1;
      } else {
        value = (value & top) != 0 ? value << 1 ^ polynomial : value << 1;
      }
    }
    tables_[0][byte] = value;
  }
  for (std::size_t k = 1; is_reflected_ && k < tables_.size(); ++k)
    for (std::size_t byte = 0; byte < tables_[k].size(); ++byte)
      tables_[k][byte] = tables_[k - 1][byte] >> 8 ^ tables_[0][tables_[k - 1][byte] & 0xff];
}

/// Its length in the text.
std::size_t Checksum::width() const noexcept { return config_.form == Form::hex ? 2 * bytes_ : bytes_; }

std::uint32_t Checksum::crc(std::string_view of, std::uint32_t value) const noexcept {
  const auto& table = tables_[0];
  if (is_reflected_) {
    for (; of.size() >= 4; of.remove_prefix(4)) {  // four bytes at a time, as the machines we run on have them
      value ^= load<std::uint32_t>(reinterpret_cast<const std::byte*>(of.data()));
      value = tables_[3][value & 0xff] ^ tables_[2][value >> 8 & 0xff] ^ tables_[1][value >> 16 & 0xff] ^
              table[value >> 24];
    }
    for (const char c : of) value = value >> 8 ^ table[(value ^ static_cast<unsigned char>(c)) & 0xff];
  } else if (bytes_ == 1) {
    for (const char c : of) value = table[(value ^ static_cast<unsigned char>(c)) & 0xff];
  } else {
    const std::size_t top = 8 * bytes_ - 8;
    for (const char c : of) value = value << 8 ^ table[(value >> top ^ static_cast<unsigned char>(c)) & 0xff];
  }
  return value;
}

std::uint32_t Checksum::of(std::string_view of) const noexcept {
  if (is_crc_) {
    std::uint32_t value = crc(of, first_);
    if (!appended_.empty()) value = crc(appended_, value);
    return (value ^ last_xor_) & (bytes_ == 4 ? ~std::uint32_t{0} : (std::uint32_t{1} << (8 * bytes_)) - 1);
  }
  std::uint32_t sum = 0, sum_of_sums = 0, parity = 0;
  for (const std::string_view part : {of, std::string_view(appended_)}) {
    for (const char c : part) {
      const auto byte = static_cast<unsigned char>(c);
      sum += byte;
      sum_of_sums += sum;
      parity ^= byte;
    }
  }
  if (config_.complement == Complement::ones) sum = ~sum;
  if (config_.complement == Complement::twos) sum = 0u - sum;
  switch (config_.type) {
    case Type::xor8:
      return parity;
    case Type::sum8:
      return sum & 0xff;
    case Type::sum16:
      return sum & 0xffff;
    case Type::fletcher16:
      return (sum & 0xff) << 8 | (sum_of_sums & 0xff);
    case Type::lrc:
      return (0u - sum) & 0xff;
    default:  // sum6
      return (sum & 0x3f) + 0x20;
  }
}

bool Checksum::read(std::string_view written, std::uint32_t& number) const noexcept {
  if (config_.form == Form::hex) {
    const auto [end, status] = std::from_chars(written.data(), written.data() + written.size(), number, 16);
    return status == std::errc{} && end == written.data() + written.size();
  }
  number = 0;
  for (std::size_t i = 0; i < written.size(); ++i) {
    const auto byte = static_cast<unsigned char>(written[i]);
    number |= static_cast<std::uint32_t>(byte) << (config_.form == Form::little ? 8 * i : 8 * (written.size() - 1 - i));
  }
  return true;
}

/// The bytes of the checksum itself may be equal to `after`.
std::size_t Checksum::place_of_after(std::string_view text) const noexcept {
  if (config_.form == Form::hex) return text.rfind(config_.after);
  const std::size_t behind = config_.after.size() + width();
  if (text.size() < behind) return std::string_view::npos;
  const std::size_t at = text.size() - behind;
  return text.substr(at).starts_with(config_.after) ? at : std::string_view::npos;
}

Checksum::Place Checksum::place_in(std::string_view text) const noexcept {
  Place place;
  text.remove_suffix(std::min(text.size(), config_.behind));
  if (config_.after.empty()) {
    place.end = text.size() < width() ? 0 : text.size() - width();
    place.written = text.substr(place.end);
    place.covered = place.end;
  } else {
    place.end = place_of_after(text);
    if (place.end == std::string_view::npos) return place;
    const std::size_t begin = place.end + config_.after.size();
    place.written = text.substr(begin);
    if (config_.form == Form::hex) place.written = trimmed(place.written);
    place.covered = config_.covers_after ? begin : place.end;
  }
  place.covered -= std::min(place.covered, config_.before);
  place.is_whole = place.written.size() == width() && place.covered >= config_.from &&
                   read(place.written, place.number);
  if (place.is_whole) place.right = of(text.substr(config_.from, place.covered - config_.from));
  return place;
}

bool Checksum::is_damaged(std::string_view text) const noexcept {
  if (config_.after.empty()) return false;  // the line may be of another kind, without a checksum
  const Place place = place_in(text);
  return place.end != std::string_view::npos && (!place.is_whole || place.number != place.right);
}

Result<std::string_view> Checksum::checked(std::string_view text) const {
  const Place place = place_in(text);
  if (place.end == std::string_view::npos) {
    if (config_.optional) return text;
    return wrong_checksum("it has no checksum after \"" + config_.after + "\"");
  }
  if (!place.is_whole) return wrong_checksum("its checksum is missing or cut off");
  if (place.number != place.right) {
    const auto shown = [&](std::uint32_t value) {
      char digits[9];
      return std::string(digits, std::to_chars(digits, digits + sizeof digits, value, 16).ptr);
    };
    return wrong_checksum("its checksum is " + shown(place.number) + ", but should be " + shown(place.right) +
                          " (hexadecimal)");
  }
  return text.substr(0, place.end);
}

}  // namespace rtdata::detail
