// Modbus Application Protocol V1.1b3: 6.1 to 6.4, the functions that read. The order of words depends on the device.
#include "rtdata/sensors/modbus.hpp"
#include "data/setting_mistake.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <utility>

#include "data/field_layout.hpp"
#include "data/load.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/data/text.hpp"

namespace rtdata {
namespace {

constexpr unsigned most_addresses = 65536;

bool is_of_bits(ModbusTable table) { return table == ModbusTable::coil || table == ModbusTable::discrete; }

/// The number of addresses of the field.
unsigned width_of(const ModbusField& field) {
  if (is_of_bits(field.table)) return 1;
  return field.type == Kind::text ? field.registers.value_or(0)
                                  : static_cast<unsigned>(detail::size_of(field.type) / 2);
}
bool is_computed(const ModbusField& field) { return field.scale != 1 || field.offset != 0 || field.scale_from; }
bool may_be_absent(const ModbusField& field) {
  return !is_of_bits(field.table) && (!field.no_value.empty() || field.scale_from);
}
Kind published_kind(const ModbusField& field) {
  if (is_of_bits(field.table) || field.bit) return Kind::boolean;
  return is_computed(field) ? Kind::f64 : field.type;
}

/// The type of the same size: signed for an unsigned type, and the reverse.
Kind other_sign(Kind kind) {
  switch (kind) {
    case Kind::i16:
      return Kind::u16;
    case Kind::u16:
      return Kind::i16;
    case Kind::i32:
      return Kind::u32;
    case Kind::u32:
      return Kind::i32;
    case Kind::i64:
      return Kind::u64;
    case Kind::u64:
      return Kind::i64;
    default:
      return kind;
  }
}

/// True if registers of this type can hold the number.
bool can_be_raw(Kind type, double number) {
  if (type == Kind::f32) return std::abs(number) <= std::numeric_limits<float>::max();
  if (!detail::is_integer_kind(type)) return std::isfinite(number);
  const int bits = static_cast<int>(8 * detail::size_of(type));
  // 2^64 is the double nearest to the largest number of 64 bits.
  const double most = bits == 64 ? std::ldexp(1.0, bits) : std::ldexp(1.0, bits) - 1;
  return number == std::trunc(number) && number >= -std::ldexp(1.0, bits - 1) && number <= most;
}

Error refused(const ModbusField& field, std::string why, std::string advice) {
  return {Errc::bad_argument, "cannot use this field", "field " + field.name, std::move(why), std::move(advice)};
}

/// Checks the registers, except their addresses.
Result<void> check_registers(const ModbusField& field) {
  const std::string type(name_of(field.type));
  if (field.type == Kind::text) {
    if (width_of(field) == 0)
      return refused(field, "a text needs `registers`", "set `registers` to the number of registers");
    if (is_computed(field) || field.bit || field.mask || !field.no_value.empty())
      return refused(field, "a text is not a number",
                     "remove the settings for numbers: `scale`, `bit`, `no_value` ...");
    return {};
  }
  if (detail::size_of(field.type) < 2)
    return refused(field, "registers cannot contain a " + type, "choose another `type`");
  if (field.registers)
    return refused(field, "only a text can have `registers`", "remove it: a " + type + " has a fixed size");
  const auto bits = static_cast<unsigned>(8 * detail::size_of(field.type));
  if (field.bit && (!detail::is_integer_kind(field.type) || *field.bit >= bits))
    return refused(field, "a " + type + " has no bit " + std::to_string(*field.bit), "set `bit` or `type`");
  if (field.bit && (is_computed(field) || field.mask))
    return refused(field, "a single bit is not a number", "remove the settings for numbers: `scale`, `mask` ...");
  if (field.mask) {
    const bool is_unsigned = field.type == Kind::u16 || field.type == Kind::u32 || field.type == Kind::u64;
    if (!is_unsigned)
      return refused(field, "`mask` works only for numbers without a sign", "set `type` to uint16 or the like");
    if (*field.mask == 0 || (bits < 64 && *field.mask >> bits != 0))
      return refused(field, "a " + type + " has none of the bits of its `mask`, or not all", "set `mask`");
  }
  if (!std::isfinite(field.scale) || field.scale == 0 || !std::isfinite(field.offset))
    return refused(field, "its scale is 0, or it is not a number", "set `scale`");
  for (const double none : field.no_value)
    if (!can_be_raw(field.type, none))
      return refused(field, "registers of type " + type + " can never contain its `no_value`",
                     "set `no_value` to the raw number, before `scale` and `offset`");
  return {};
}

}  // namespace

Result<std::shared_ptr<const Description>> Modbus::describe(const Config& config) {
  if (config.most_registers > ModbusDevice::most_registers)
    return Error{Errc::bad_argument, "cannot use these fields", "", "a request can have at most 125 registers",
                 "set `most_registers`"};
  DescriptionBuilder builder("modbus");
  for (const ModbusField& field : config.fields) {
    if (!is_of_bits(field.table))
      if (auto good = check_registers(field); !good) return std::move(good).error();
    const unsigned width = width_of(field);
    if (field.address + width > most_addresses)
      return refused(field, "it goes beyond address 65535", "set another `address`");
    if (!is_of_bits(field.table) && width > config.most_registers)
      return refused(field,
                     "it has " + std::to_string(width) + " registers, but a request may have only " +
                         std::to_string(config.most_registers),
                     "set a larger `most_registers`: with two requests, the value could be half old and half new");
    using Presence = DescriptionBuilder::Presence;
    if (published_kind(field) == Kind::text) {
      builder.text(field.name, 2 * std::size_t{width});
    } else {
      builder.field(field.name, published_kind(field), field.unit,
                    may_be_absent(field) ? Presence::optional : Presence::always);
    }
  }
  if (config.fields.empty())
    return Error{Errc::bad_argument, "cannot use these fields", "", "there are no fields", "list them in `fields`"};
  auto made = builder.build();
  if (made && (*made)->size() > max_payload_size)
    return Error{Errc::bad_argument, "cannot use these fields", "", "they need more than 4 KiB",
                 "divide them among sensors"};
  return made;
}

void check_config(const Modbus::Config& config, const ConfigItem& item, Problems& problems) {
  const auto described = Modbus::describe(config);
  if (described) return;
  const Error& e = described.error();
  detail::add_mistake({"fields", (e.where.empty() ? "" : e.where + ": ") + e.why, e.advice}, item, problems);
}

std::vector<Modbus::Request> Modbus::requests(const Config& config) {
  struct Item {
    ModbusTable table;
    unsigned first, width;
    std::optional<std::size_t> field;  // unset: a register of `scale_from`
  };
  std::vector<Item> items;
  for (std::size_t i = 0; i < config.fields.size(); ++i) {
    const ModbusField& field = config.fields[i];
    items.push_back({field.table, field.address, width_of(field), i});
    if (field.scale_from && !is_of_bits(field.table)) items.push_back({field.table, *field.scale_from, 1, {}});
  }
  std::stable_sort(items.begin(), items.end(), [](const Item& a, const Item& b) {
    return std::pair(a.table, a.first) < std::pair(b.table, b.first);
  });
  std::vector<Request> made;
  for (const Item& item : items) {
    const unsigned end = item.first + item.width;
    const std::size_t most = is_of_bits(item.table) ? ModbusDevice::most_bits : config.most_registers;
    if (made.empty() || made.back().table != item.table ||
        item.first > made.back().first + made.back().count + config.gap || end - made.back().first > most)
      made.push_back({item.table, static_cast<std::uint16_t>(item.first), 0, {}});
    made.back().count = std::max(made.back().count, end - made.back().first);
    if (item.field) made.back().fields.push_back(*item.field);
  }
  return made;
}

namespace {

/// The register with its bytes in this order.
std::uint16_t ordered(std::uint16_t word, WordOrder order) {
  const bool is_swapped = order == WordOrder::badc || order == WordOrder::dcba;
  return is_swapped ? static_cast<std::uint16_t>(word >> 8 | (word & 0xff) << 8) : word;
}

}  // namespace

std::uint64_t Modbus::bits_of(std::span<const std::uint16_t> words, WordOrder order) noexcept {
  const bool is_reversed = order == WordOrder::cdab || order == WordOrder::dcba;
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < words.size(); ++i)
    bits = bits << 16 | ordered(words[is_reversed ? words.size() - 1 - i : i], order);
  return bits;
}

namespace {

/// The text up to the first NUL, without blanks at the end.
std::string text_of(std::span<const std::uint16_t> words, WordOrder order) {
  std::string text;
  for (const std::uint16_t word : words) {
    text += static_cast<char>(ordered(word, order) >> 8);
    text += static_cast<char>(ordered(word, order) & 0xff);
  }
  text.resize(std::min(text.find('\0'), text.size()));
  text.resize(text.find_last_not_of(' ') + 1);
  return text;
}

/// The number with these bits, of this kind.
double number_of(Kind kind, std::uint64_t bits) {
  if (kind == Kind::f64) return std::bit_cast<double>(bits);
  if (kind == Kind::f32) return static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(bits)));
  return detail::for_integer(kind,
                             [bits](auto zero) { return static_cast<double>(static_cast<decltype(zero)>(bits)); });
}

constexpr std::uint16_t no_exponent = 0x8000;
constexpr int most_exponent = 10;  // SunSpec Device Information Model Specification, sunssf

/// True if the bits of a field mean that the device has no value.
bool is_none(const ModbusField& field, std::uint64_t bits) {
  if (field.no_value.empty()) return false;
  const double raw = number_of(field.type, bits);
  return std::isnan(raw) || std::any_of(field.no_value.begin(), field.no_value.end(), [&](double none) {
           if (field.type == Kind::f32) return raw == static_cast<double>(static_cast<float>(none));
           return raw == none || number_of(other_sign(field.type), bits) == none;
         });
}

/// The bits of the mask, shifted down to bit 0.
std::uint64_t masked(const ModbusField& field, std::uint64_t bits) {
  return field.mask ? (bits & *field.mask) >> std::countr_zero(*field.mask) : bits;
}

}  // namespace

Result<double> Modbus::decode(const ModbusField& field, std::span<const std::uint16_t> words, WordOrder order,
                              int exponent) {
  const double raw = number_of(field.type, masked(field, bits_of(words, field.word_order.value_or(order))));
  const double power = std::pow(10.0, std::abs(exponent));
  const double scaled = raw * field.scale;
  // A division rounds only once: 2301 with exponent -1 is 230.1.
  const double number = (exponent < 0 ? scaled / power : scaled * power) + field.offset;
  if (!std::isfinite(number))
    return Error{Errc::not_a_number, "cannot use a value", "field " + field.name, "it is not a number",
                 "check `address`, `type` and `word_order`; `no_value` names the raw numbers that mean \"no value\""};
  return number;
}

Modbus::Modbus(const Config& config)
    : config_(config), description_(describe(config).or_throw()), requests_(requests(config)) {
  std::size_t size = 0;
  for (const Request& request : requests_) size += request.count;
  words_.resize(size);
  /// The position of these addresses, which are in one request.
  const auto find = [&](ModbusTable table, unsigned first, unsigned width) {
    std::size_t at = 0;
    for (const Request& request : requests_) {
      if (request.table == table && first >= request.first && first + width <= request.first + request.count)
        return at + first - request.first;
      at += request.count;
    }
    return size;  // not found
  };
  for (const ModbusField& field : config_.fields) {
    sources_.push_back({description_->find(field.name), find(field.table, field.address, width_of(field)),
                        field.scale_from ? find(field.table, *field.scale_from, 1) : 0});
  }
}

Result<void> Modbus::put(DescribedValue& value, std::size_t index) const {
  const ModbusField& field = config_.fields[index];
  const auto [leaf, first, exponent_at] = sources_[index];
  std::byte* const to = value.data() + leaf->offset;
  if (is_of_bits(field.table)) {
    *to = std::byte{static_cast<std::uint8_t>(words_[first] != 0)};
    return {};
  }
  const std::span words = std::span(words_).subspan(first, width_of(field));
  const WordOrder order = field.word_order.value_or(config_.word_order);
  if (field.type == Kind::text) {
    const std::string text = text_of(words, order);
    to[0] = static_cast<std::byte>(text.size() & 0xff);
    to[1] = static_cast<std::byte>(text.size() >> 8);
    std::memcpy(to + text_length_bytes, text.data(), text.size());
    return {};
  }
  const std::uint64_t bits = bits_of(words, order);
  if (is_none(field, bits)) return {};
  int exponent = 0;
  if (field.scale_from) {
    const std::uint16_t word = ordered(words_[exponent_at], order);
    if (word == no_exponent) return {};
    exponent = static_cast<std::int16_t>(word);
    if (std::abs(exponent) > most_exponent)
      return Error{Errc::not_a_number, "cannot use a value", "field " + field.name,
                   "its scale factor is " + std::to_string(exponent) + ", but scale factors of SunSpec are -10 to 10",
                   "check `scale_from`"};
  }
  const Result<double> number = decode(field, words, order, exponent);
  if (!number) return number.error();
  if (field.bit) {
    *to = std::byte{static_cast<std::uint8_t>(bits >> *field.bit & 1)};
  } else if (is_computed(field)) {
    std::memcpy(to, &*number, sizeof(double));
  } else {
    const std::uint64_t kept = masked(field, bits);
    std::memcpy(to, &kept, detail::size_of(field.type));  // the machines that we run on put the low byte first
  }
  if (leaf->optional != nullptr) value.data()[leaf->offset + leaf->optional->value_size] = std::byte{1};
  return {};
}

Reading<DescribedValue> Modbus::read(ModbusDevice& device) {
  std::array<std::uint8_t, ModbusDevice::most_bits> flags{};
  std::size_t at = 0;
  for (const Request& request : requests_) {
    const std::span words = std::span(words_).subspan(at, request.count);
    const std::span bits = std::span(flags).first(is_of_bits(request.table) ? request.count : 0);
    const Result<void> done = is_of_bits(request.table) ? device.read_bits(request.table, request.first, bits)
                                                        : device.read_registers(request.table, request.first, words);
    if (!done && done.error().code == Errc::bad_data) return Unreadable{done.error()};
    if (!done) return done.error();
    std::copy(bits.begin(), bits.end(), words.begin());
    at += request.count;
  }
  DescribedValue value(*description_);
  for (std::size_t i = 0; i < sources_.size(); ++i) {
    if (auto put_in = put(value, i); !put_in) {
      const Error& e = put_in.error();
      return Unreadable{device.error(Errc::not_a_number, e.what, e.where + ": " + e.why, e.advice)};
    }
  }
  return value;
}

}  // namespace rtdata
