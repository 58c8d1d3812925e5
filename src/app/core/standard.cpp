#include "rtdata/app/program.hpp"

#include "app/core/machines.hpp"
#include "app/core/standard_drivers.hpp"
#include "rtdata/io/i2c.hpp"
#include "rtdata/io/serial.hpp"
#include "rtdata/io/spi.hpp"
#ifdef RTDATA_WITH_MODBUS
#include "rtdata/sensors/modbus.hpp"
#endif

namespace rtdata {

template <class Bus, class Config>
static void add_bus(Registry& registry, const char* doc) {
  registry.add_bus<Config>(std::string(Bus::type), doc,
                           [](Runtime&, const std::string& name, const Config& config) { return Bus(name, config); });
}

Registry standard_registry() {
  Registry registry;
  add_bus<I2cBus, I2cConfig>(registry, "an I2C adapter of the kernel");
  add_bus<SpiBus, SpiConfig>(registry, "an SPI controller of the kernel");
  add_bus<SerialPort, SerialPortConfig>(
      registry, "devices that answer requests on a serial line, over TCP, or a program of your own that does");
#ifdef RTDATA_WITH_MODBUS
  add_bus<ModbusBus, ModbusConfig>(registry,
                                   "devices that speak Modbus, on a serial line (RTU) or behind a server (TCP)");
#endif
  app::add_register_drivers(registry);
  app::add_i2c_drivers(registry);
  app::add_gas_drivers(registry);
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
  for (const char* kind : {"output", "sensor", "sink"})
    registry.leave_out(kind, "http", "this program was built without libcurl");
#endif
#ifndef RTDATA_WITH_POSTGRESQL
  registry.leave_out("sink", "postgresql", "this program was built without libpq");
#endif
  return registry;
}

}  // namespace rtdata
