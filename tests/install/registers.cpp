// Uses what rtdata::modbus has; a machine need not have such a line.
#include <array>
#include <cstdint>
#include <cstdio>

#include "rtdata/io/modbus.hpp"

int main() {
  rtdata::ModbusBus bus({.device = "/no/such/line"});
  std::array<std::uint16_t, 2> words{};
  const auto done = bus.device({.unit = 3}).read_registers(rtdata::ModbusTable::holding, 0, words);
  if (done) return 1;
  std::puts(done.error().text().c_str());
  return done.error().code == rtdata::Errc::not_found ? 0 : 1;
}
