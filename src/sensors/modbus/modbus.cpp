// Modbus Application Protocol V1.1b3: 6.1 to 6.4 the functions that read. Orders of words are the devices' own.
#include "rtdata/sensors/modbus.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>

#include "data/field_layout.hpp"
#include "rtdata/data/config_item.hpp"

namespace rtdata {
namespace {

constexpr unsigned most_addresses = 65536;

bool is_of_bits(ModbusTable table) { return table == ModbusTable::coil || table == ModbusTable::discrete; }

/// Addresses that the field takes.
unsigned width_of(const ModbusField& field) {
  return is_of_bits(field.table) ? 1 : static_cast<unsigned>(detail::size_of(field.type) / 2);
}
bool is_computed(const ModbusField& field) { return field.scale != 1 || field.offset != 0; }
bool may_be_absent(const ModbusField& field) { return field.no_value && !is_of_bits(field.table); }
Kind published_kind(const ModbusField& field) {
  if (is_of_bits(field.table)) return Kind::boolean;
  return is_computed(field) ? Kind::f64 : field.type;
}

bool is_integer(Kind kind) { return kind != Kind::f32 && kind != Kind::f64; }

/// The same number of bits, with a sign for one without, and the other way round.
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

/// Whether registers of this type can hold it.
bool can_be_raw(Kind type, double number) {
  if (type == Kind::f32) return std::abs(number) <= std::numeric_limits<float>::max();
  if (!is_integer(type)) return std::isfinite(number);
  const int bits = static_cast<int>(8 * detail::size_of(type));
  // 2^64 is the nearest double of the largest of 64 bits.
  const double most = bits == 64 ? std::ldexp(1.0, bits) : std::ldexp(1.0, bits) - 1;
  return number == std::trunc(number) && number >= -std::ldexp(1.0, bits - 1) && number <= most;
}

Error refused(const ModbusField& field, std::string why, std::string advice) {
  return {Errc::bad_argument, "cannot use this field", "field " + field.name, std::move(why), std::move(advice)};
}

}  // namespace

Result<std::shared_ptr<const Description>> Modbus::describe(const Config& config) {
  DescriptionBuilder builder("modbus");
  for (const ModbusField& field : config.fields) {
    if (!is_of_bits(field.table) && detail::size_of(field.type) < 2)
      return refused(field, "registers hold no " + std::string(name_of(field.type)), "choose another `type`");
    if (field.address + width_of(field) > most_addresses)
      return refused(field, "it goes beyond address 65535", "set another `address`");
    if (!std::isfinite(field.scale) || field.scale == 0 || !std::isfinite(field.offset))
      return refused(field, "its scale is 0, or it is not a number", "set `scale`");
    if (may_be_absent(field) && !can_be_raw(field.type, *field.no_value))
      return refused(field, "registers of type " + std::string(name_of(field.type)) + " never hold its `no_value`",
                     "set the raw number, before `scale` and `offset`");
    using Presence = DescriptionBuilder::Presence;
    builder.field(field.name, published_kind(field), field.unit,
                  may_be_absent(field) ? Presence::optional : Presence::always);
  }
  if (config.fields.empty())
    return Error{Errc::bad_argument, "cannot use these fields", "", "there are none", "list them in `fields`"};
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
  const ConfigItem* at = item.find("fields");
  problems.add((at != nullptr ? *at : item)
                   .problem("bad-value", (e.where.empty() ? "" : e.where + ": ") + e.why +
                                             (e.advice.empty() ? "" : "; ") + e.advice));
}

std::vector<Modbus::Request> Modbus::requests(const Config& config) {
  std::vector<std::size_t> order(config.fields.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  const auto key = [&](std::size_t i) { return std::pair(config.fields[i].table, config.fields[i].address); };
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return key(a) < key(b); });
  std::vector<Request> made;
  for (const std::size_t i : order) {
    const ModbusField& field = config.fields[i];
    const unsigned end = field.address + width_of(field);
    const std::size_t most = is_of_bits(field.table) ? ModbusDevice::most_bits : ModbusDevice::most_registers;
    if (!made.empty() && made.back().table == field.table &&
        field.address <= made.back().first + made.back().count + config.gap && end - made.back().first <= most) {
      made.back().count = std::max(made.back().count, end - made.back().first);
      made.back().fields.push_back(i);
    } else {
      made.push_back({field.table, field.address, width_of(field), {i}});
    }
  }
  return made;
}

std::uint64_t Modbus::bits_of(std::span<const std::uint16_t> words, WordOrder order) noexcept {
  const bool is_reversed = order == WordOrder::cdab || order == WordOrder::dcba;
  const bool is_swapped = order == WordOrder::badc || order == WordOrder::dcba;
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < words.size(); ++i) {
    const std::uint16_t word = words[is_reversed ? words.size() - 1 - i : i];
    bits = bits << 16 | (is_swapped ? static_cast<std::uint16_t>(word >> 8 | (word & 0xff) << 8) : word);
  }
  return bits;
}

namespace {

/// The number of this kind that has these bits.
double number_of(Kind kind, std::uint64_t bits) {
  switch (kind) {
    case Kind::i16:
      return static_cast<std::int16_t>(bits & 0xffff);
    case Kind::u16:
      return static_cast<std::uint16_t>(bits & 0xffff);
    case Kind::u32:
      return static_cast<std::uint32_t>(bits & 0xffffffff);
    case Kind::i32:
      return static_cast<std::int32_t>(bits & 0xffffffff);
    case Kind::i64:
      return static_cast<double>(static_cast<std::int64_t>(bits));
    case Kind::f32:
      return static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(bits & 0xffffffff)));
    case Kind::f64:
      return std::bit_cast<double>(bits);
    default:
      return static_cast<double>(bits);
  }
}

/// Whether the bits of a field are those by which the device says that it has none.
bool is_none(const ModbusField& field, std::uint64_t bits) {
  if (!field.no_value) return false;
  const double raw = number_of(field.type, bits);
  if (field.type == Kind::f32)
    return std::isnan(raw) || raw == static_cast<double>(static_cast<float>(*field.no_value));
  return std::isnan(raw) || raw == *field.no_value || number_of(other_sign(field.type), bits) == *field.no_value;
}

}  // namespace

Result<double> Modbus::decode(const ModbusField& field, std::span<const std::uint16_t> words, WordOrder order) {
  const double raw = number_of(field.type, bits_of(words, order));
  const double number = raw * field.scale + field.offset;
  if (!std::isfinite(number))
    return Error{Errc::not_a_number, "cannot use a value", "field " + field.name, "it is not a number",
                 "check `address`, `type` and `word_order`; `no_value` names the raw number that means \"no value\""};
  return number;
}

Modbus::Modbus(const Config& config)
    : config_(config), description_(describe(config).or_throw()), requests_(requests(config)) {}

Result<void> Modbus::put(DescribedValue& value, std::size_t index, std::span<const std::uint16_t> words) const {
  const ModbusField& field = config_.fields[index];
  const Leaf& leaf = *description_->find(field.name);
  const std::uint64_t bits = bits_of(words, config_.word_order);
  if (is_none(field, bits)) return {};
  const Result<double> number = decode(field, words, config_.word_order);
  if (!number) return number.error();
  std::byte* const to = value.data() + leaf.offset;
  if (is_computed(field)) {
    std::memcpy(to, &*number, sizeof(double));
  } else {
    std::memcpy(to, &bits, leaf.size);  // the machines that we run on put the low byte first
  }
  if (leaf.optional != nullptr) value.data()[leaf.offset + leaf.optional->value_size] = std::byte{1};
  return {};
}

Reading<DescribedValue> Modbus::read(ModbusDevice& device) {
  DescribedValue value(*description_);
  std::array<std::uint16_t, ModbusDevice::most_registers> words{};
  std::array<std::uint8_t, ModbusDevice::most_bits> flags{};
  for (const Request& request : requests_) {
    const bool has_bits = is_of_bits(request.table);
    const Result<void> done = has_bits ? device.read_bits(request.table, request.first,
                                                          std::span(flags).first(request.count))
                                       : device.read_registers(request.table, request.first,
                                                               std::span(words).first(request.count));
    if (!done && done.error().code == Errc::bad_data) return Unreadable{done.error()};
    if (!done) return done.error();
    for (const std::size_t i : request.fields) {
      const ModbusField& field = config_.fields[i];
      const std::size_t at = field.address - request.first;
      if (has_bits) {
        value.data()[description_->find(field.name)->offset] = std::byte{static_cast<std::uint8_t>(flags[at] != 0)};
        continue;
      }
      if (auto put_in = put(value, i, std::span(words).subspan(at, width_of(field))); !put_in) {
        const Error& e = put_in.error();
        return Unreadable{device.error(Errc::not_a_number, e.what, e.where + ": " + e.why, e.advice)};
      }
    }
  }
  return value;
}

}  // namespace rtdata
