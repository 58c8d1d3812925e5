#include "rtdata/app/standard.hpp"

#include "app/core/machines.hpp"
#include "app/core/standard_drivers.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/io/serial.hpp"
#include "rtdata/io/spi.hpp"
#ifdef RTDATA_WITH_MODBUS
#include "rtdata/sensors/modbus.hpp"
#endif

namespace rtdata {

Registry standard_registry() {
  Registry registry;
  registry.add_bus<I2cConfig>(
      std::string(I2cBus::type), "an I2C adapter of the kernel",
      [](Runtime&, const std::string& name, const I2cConfig& config) { return I2cBus(name, config); });
  registry.add_bus<SpiConfig>(
      std::string(SpiBus::type), "an SPI controller of the kernel",
      [](Runtime&, const std::string& name, const SpiConfig& config) { return SpiBus(name, config); });
  registry.add_bus<SerialPortConfig>(
      std::string(SerialPort::type), "a serial line of the kernel, to devices that answer requests",
      [](Runtime&, const std::string& name, const SerialPortConfig& config) { return SerialPort(name, config); });
#ifdef RTDATA_WITH_MODBUS
  registry.add_bus<ModbusConfig>(
      std::string(ModbusBus::type), "devices that speak Modbus, on a serial line (RTU) or behind a server (TCP)",
      [](Runtime&, const std::string& name, const ModbusConfig& config) { return ModbusBus(name, config); });
#endif
  app::add_register_drivers(registry);
  app::add_i2c_drivers(registry);
  app::add_spi_drivers(registry);
  app::add_serial_drivers(registry);
#ifdef RTDATA_WITH_MODBUS
  registry.add_driver<Modbus>();
#endif
  app::add_device_sensors(registry);
  app::add_topic_sensors(registry);
  app::add_machines(registry);
  app::add_line_sensors(registry);
  app::add_recordings(registry);
  app::add_shipped_sinks(registry);
  app::add_shipped_outputs(registry);
#ifndef RTDATA_WITH_GPIO
  for (const char* type : {"counter", "edge", "gpio"})
    registry.leave_out("sensor", type, "this program was built without libgpiod");
  registry.leave_out("output", "gpio", "this program was built without libgpiod");
#endif
#ifndef RTDATA_WITH_MODBUS
  for (const char* kind : {"bus", "sensor"})
    registry.leave_out(kind, "modbus", "this program was built without libmodbus");
#endif
#ifndef RTDATA_WITH_MQTT
  for (const char* kind : {"output", "sensor", "sink"})
    registry.leave_out(kind, "mqtt", "this program was built without libmosquitto");
#endif
#ifndef RTDATA_WITH_HTTP
  for (const char* kind : {"output", "sink"})
    registry.leave_out(kind, "http", "this program was built without libcurl");
#endif
#ifndef RTDATA_WITH_POSTGRESQL
  registry.leave_out("sink", "postgresql", "this program was built without libpq");
#endif
  return registry;
}

}  // namespace rtdata
