/// Modbus: registers and bits of a device that speaks Modbus, as the fields of a topic.
///
///     rtdata::ModbusBus bus({.host = "192.168.1.20"});
///     rtdata::DriverSensor<rtdata::Modbus> meter(loop, {.name = "meter", .rate = 2_Hz}, bus, {.unit = 1},
///         {.fields = {{.name = "voltage", .address = 0, .type = Kind::u16, .scale = 0.1, .unit = "V"},
///                     {.name = "energy", .address = 10, .type = Kind::f32, .unit = "kW.h"}}});
///
/// - Each tick reads all fields: those that lie one behind the other in one request, others in one of their own; with
///   `gap`, those too between which there are so many registers that no field has. A request that fails fails the
///   reading.
/// - Numbers are put together in `word_order`, high word and high byte first ("abcd") unless it says otherwise; where
///   it has the low byte of a register first, that is so of numbers of one register, too.
/// - A number with a `scale` or an `offset` is published as a double, raw * scale + offset; others as they are. Coils
///   and discrete inputs are bools.
/// - `no_value` is the raw number by which the device says that there is none (0x8000, 65535 ...), of an integer with
///   or without its sign: the field is then absent, as it is with a float that is no number. Without `no_value` such a
///   float makes the reading unreadable.
/// - An answer with a wrong checksum, or to something else, is unreadable; the device's exceptions are reported by
///   name.
///
/// In the library rtdata::modbus. Driver (driver.hpp): used on the bus's lane.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rtdata/io/modbus.hpp"
#include "rtdata/sensors/driver.hpp"

namespace rtdata {

/// One value of a device.
struct ModbusField {
  std::string name = {};
  ModbusTable table = ModbusTable::holding;
  std::uint16_t address = 0;  ///< of its first register, from 0
  Kind type = Kind::u16;      ///< of the registers: integers of 16 to 64 bits, float, double
  double scale = 1;
  double offset = 0;                    ///< added after scaling
  std::string unit = {};                ///< UCUM
  std::optional<double> no_value = {};  ///< the raw number that stands for none

  friend constexpr auto parameters(type_tag<ModbusField>) {
    return parameter_list(
        parameter("name", &ModbusField::name, "name of the field", required, TextIs::field),
        parameter("table", &ModbusField::table,
                  "what it is one of: registers (holding, input) or bits (coil, discrete)"),
        parameter("address", &ModbusField::address, "of its first register or bit, from 0", required),
        parameter("type", &ModbusField::type, "type of the value in the registers",
                  choices(value("int16", Kind::i16), value("int32", Kind::i32), value("int64", Kind::i64),
                          value("uint16", Kind::u16), value("uint32", Kind::u32), value("uint64", Kind::u64),
                          value("float", Kind::f32), value("double", Kind::f64)),
                  only_with("table", "holding", "input")),
        parameter("scale", &ModbusField::scale, "factor", not_zero, only_with("table", "holding", "input")),
        parameter("offset", &ModbusField::offset, "added after scaling", only_with("table", "holding", "input")),
        parameter("unit", &ModbusField::unit, "unit of the value (UCUM)", TextIs::unit),
        parameter("no_value", &ModbusField::no_value, "the raw number that stands for none",
                  only_with("table", "holding", "input")));
  }
};

/// In which order the bytes of a number lie in the registers; a is the highest of four.
enum class WordOrder { abcd, cdab, badc, dcba };
constexpr auto describe(type_tag<WordOrder>) {
  return enumeration("word_order", value("abcd", WordOrder::abcd), value("cdab", WordOrder::cdab),
                     value("badc", WordOrder::badc), value("dcba", WordOrder::dcba));
}

class Modbus {
 public:
  static constexpr std::string_view type = "modbus";
  static constexpr std::string_view aliases = "rs485 plc";
  static constexpr std::string_view description = "registers of a device that speaks Modbus, over a serial line or TCP";
  static constexpr std::string_view notes =
      "The bus is a `modbus` one. Addresses count from 0: a document's register 40001 is `\"address\": 0` of the "
      "holding "
      "registers, 30001 `\"address\": 0` of the input registers. More: [modbus.md](modbus.md).";
  struct Config {
    std::vector<ModbusField> fields = {};
    WordOrder word_order = WordOrder::abcd;  ///< badc and dcba: also of numbers of one register
    unsigned gap = 0;                        ///< registers, or bits, that are read along though no field has them
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("fields", &Config::fields, "what is read", required),
          parameter(
              "word_order", &Config::word_order,
              "the bytes of numbers, the highest of four called a; badc and dcba swap those of one register, too"),
          parameter("gap", &Config::gap, "addresses that may be read along though no field has them", range(0, 120)));
    }
    /// Checks that the fields can be read and described.
    friend void check_config(const Config& config, const ConfigItem& item, Problems& problems);
  };
  using Value = DescribedValue;
  using Device = ModbusDevice;
  static constexpr ChipSample samples[] = {{.members = R"("fields": [{"name": "x", "address": 0}])"}};
  static Result<std::shared_ptr<const Description>> describe(const Config& config);

  /// SetupError (bad-argument, bad-description): a configuration that cannot work.
  explicit Modbus(const Config& config);
  /// The line or server is there; whether the unit answers is what each read says.
  Result<void> open(ModbusDevice&) { return {}; }
  Reading<DescribedValue> read(ModbusDevice& device);

  /// What is asked for at a time.
  struct Request {
    ModbusTable table = ModbusTable::holding;
    std::uint16_t first = 0;
    unsigned count = 0;
    std::vector<std::size_t> fields = {};  ///< that it brings, as places in the list
  };
  static std::vector<Request> requests(const Config& config);
  /// The number in these registers: as many as the type needs, one after the other. Errors: not-a-number.
  static Result<double> decode(const ModbusField& field, std::span<const std::uint16_t> words, WordOrder order);
  /// The bits of the number, the lowest in the lowest.
  static std::uint64_t bits_of(std::span<const std::uint16_t> words, WordOrder order) noexcept;

 private:
  Result<void> put(DescribedValue& value, std::size_t index, std::span<const std::uint16_t> words) const;
  const Config config_;
  const std::shared_ptr<const Description> description_;
  const std::vector<Request> requests_;
};

}  // namespace rtdata
