/// Modbus: registers and bits of a device that speaks Modbus, as the fields of a topic.
///
///     rtdata::ModbusBus bus({.host = "192.168.1.20"});
///     rtdata::DriverSensor<rtdata::Modbus> meter(loop, {.name = "meter", .rate = 2_Hz}, bus, {.unit = 1},
///         {.fields = {{.name = "voltage", .address = 0, .type = rtdata::Kind::u16, .scale = 0.1, .unit = "V"},
///                     {.name = "energy", .address = 10, .type = rtdata::Kind::f32, .unit = "kW.h"}}});
///
/// - Each tick reads all fields: consecutive ones in one request, others in separate requests; with `gap`, a request
///   may include this many unused registers between two fields. No request has more than `most_registers`, and none
///   ends within a field. If a request fails, the reading fails.
/// - Numbers are assembled in `word_order`, by default high word and high byte first ("abcd"), of the sensor or of the
///   field. An order with the low byte of a register first also applies to numbers of one register and to texts.
/// - A number with a `scale`, an `offset` or a `scale_from` is published as a double, raw * scale + offset; others
///   unchanged. Coils and discrete inputs are bools.
/// - `scale_from` is the register, in the same table, of a signed power of ten by which the number is multiplied too
///   (SunSpec's scale factor, -10 to 10), read with each reading. With 0x8000 in it the field is absent; with another
///   number the reading is unreadable.
/// - `bit` publishes one bit of an integer as a bool, `mask` some bits of an unsigned one, moved down to bit 0.
/// - A text has two bytes in each of its `registers`, the high one first, up to the first NUL, without blanks at the
///   end.
/// - `no_value` lists the raw numbers, of all bits, that the device sends for a missing value (0x8000, 65535 ...), for
///   integers as signed or unsigned number: the field is then absent. With `no_value` a float that is NaN is absent
///   too; without it, NaN makes the reading unreadable.
/// - An answer with a wrong checksum, or to another request, is unreadable; the device's exceptions are reported by
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

/// The order of the bytes of a number in the registers; a is the highest of four.
enum class WordOrder { abcd, cdab, badc, dcba };
constexpr auto describe(type_tag<WordOrder>) {
  return enumeration("word_order", value("abcd", WordOrder::abcd), value("cdab", WordOrder::cdab),
                     value("badc", WordOrder::badc), value("dcba", WordOrder::dcba));
}

/// One value of a device.
struct ModbusField {
  std::string name = {};
  ModbusTable table = ModbusTable::holding;
  std::uint16_t address = 0;  ///< of its first register, from 0
  Kind type = Kind::u16;      ///< of the registers: integers of 16 to 64 bits, float, double, text
  double scale = 1;
  double offset = 0;                             ///< added after scaling
  std::string unit = {};                         ///< UCUM
  std::vector<double> no_value = {};             ///< raw numbers that mean no value
  std::optional<WordOrder> word_order = {};      ///< unset: `word_order` of the sensor
  std::optional<unsigned> registers = {};        ///< number of registers of a text
  std::optional<unsigned> bit = {};              ///< publishes only this bit, 0 is the lowest
  std::optional<std::uint64_t> mask = {};        ///< publishes these bits; unset: all
  std::optional<std::uint16_t> scale_from = {};  ///< address of the register with its power of ten

  friend constexpr auto parameters(type_tag<ModbusField>) {
    return parameter_list(
        parameter("name", &ModbusField::name, "name of the field", required, TextIs::field),
        parameter("table", &ModbusField::table,
                  "table of the value: registers (holding, input) or bits (coil, discrete)"),
        parameter("address", &ModbusField::address, "address of the first register or bit, from 0", required),
        parameter("type", &ModbusField::type, "type of the value in the registers",
                  choices(value("int16", Kind::i16), value("int32", Kind::i32), value("int64", Kind::i64),
                          value("uint16", Kind::u16), value("uint32", Kind::u32), value("uint64", Kind::u64),
                          value("float", Kind::f32), value("double", Kind::f64), value("text", Kind::text)),
                  only_with("table", "holding", "input")),
        parameter("scale", &ModbusField::scale, "factor", not_zero, only_with("table", "holding", "input")),
        parameter("offset", &ModbusField::offset, "added after scaling", only_with("table", "holding", "input")),
        parameter("unit", &ModbusField::unit, "unit of the value (UCUM)", TextIs::unit),
        parameter("no_value", &ModbusField::no_value, "raw numbers that mean no value, such as [-32768]",
                  only_with("table", "holding", "input")),
        parameter("word_order", &ModbusField::word_order, "order of its bytes; default: `word_order` of the sensor",
                  only_with("table", "holding", "input")),
        parameter("registers", &ModbusField::registers, "number of registers of a text", range(1, 125),
                  only_with("type", "text")),
        parameter("bit", &ModbusField::bit, "publishes only this bit of the number, as a bool; 0 is the lowest",
                  range(0, 63), only_with("table", "holding", "input")),
        parameter("mask", &ModbusField::mask, "publishes these bits of the number, moved down to bit 0; default: all",
                  at_least(1), only_with("table", "holding", "input")),
        parameter("scale_from", &ModbusField::scale_from,
                  "address of the register with the power of ten to multiply by (SunSpec's scale factor)",
                  only_with("table", "holding", "input")));
  }
};

class Modbus {
 public:
  static constexpr std::string_view type = "modbus";
  static constexpr std::string_view aliases = "rs485 plc";
  static constexpr std::string_view description = "registers of a device that speaks Modbus, over a serial line or TCP";
  static constexpr std::string_view notes =
      "The bus is a `modbus` one. Addresses count from 0: register 40001 of a manual is `\"address\": 0` of the "
      "holding registers, 30001 `\"address\": 0` of the input registers. More: [modbus.md](modbus.md).";
  struct Config {
    std::vector<ModbusField> fields = {};
    WordOrder word_order = WordOrder::abcd;  ///< badc and dcba: also for numbers of one register
    unsigned gap = 0;                        ///< how many unused registers or bits a request may include
    unsigned most_registers = ModbusDevice::most_registers;  ///< of one request
    friend constexpr auto parameters(type_tag<Config>) {
      return parameter_list(
          parameter("fields", &Config::fields, "values to read", required),
          parameter("word_order", &Config::word_order,
                    "order of the bytes of numbers: a is the highest of four; badc and dcba also swap the bytes within "
                    "a register"),
          parameter("gap", &Config::gap,
                    "number of addresses between two fields that may be read although no field has them",
                    range(0, 120)),
          parameter("most_registers", &Config::most_registers,
                    "most registers of a request; a field is never divided between two requests", range(1, 125)));
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
  /// Sends nothing: each read shows if the unit answers.
  Result<void> open(ModbusDevice&) { return {}; }
  Reading<DescribedValue> read(ModbusDevice& device);

  /// One request.
  struct Request {
    ModbusTable table = ModbusTable::holding;
    std::uint16_t first = 0;
    unsigned count = 0;
    std::vector<std::size_t> fields = {};  ///< the fields that it reads, as indexes in the list
  };
  static std::vector<Request> requests(const Config& config);
  /// The number in these registers: as many as the type needs, one after the other, in the field's order or this one.
  /// `exponent`: its power of ten. Errors: not-a-number.
  static Result<double> decode(const ModbusField& field, std::span<const std::uint16_t> words, WordOrder order,
                               int exponent = 0);
  /// The bits of the number, the lowest in the lowest.
  static std::uint64_t bits_of(std::span<const std::uint16_t> words, WordOrder order) noexcept;

 private:
  /// Where a field's registers are among all that are read.
  struct Source {
    const Leaf* leaf = nullptr;
    std::size_t first = 0;
    std::size_t exponent = 0;  ///< the register of `scale_from`
  };
  Result<void> put(DescribedValue& value, std::size_t index) const;
  const Config config_;
  const std::shared_ptr<const Description> description_;
  const std::vector<Request> requests_;
  std::vector<Source> sources_;       // of each field
  std::vector<std::uint16_t> words_;  // of all requests, one after the other; a bit is a word
};

}  // namespace rtdata
