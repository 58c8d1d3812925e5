#include "app/core/gpio_place.hpp"
#include "app/core/standard_drivers.hpp"
#include "net/http_url.hpp"
#include "rtdata/outputs/command.hpp"
#include "rtdata/outputs/gpio.hpp"
#include "rtdata/outputs/http.hpp"
#include "rtdata/outputs/mqtt.hpp"
#include "rtdata/outputs/pwm.hpp"
#include "rtdata/outputs/serial.hpp"

namespace rtdata::app {

void add_shipped_outputs(Registry& registry) {
#ifdef RTDATA_WITH_GPIO
  registry.add_output<GpioActuatorConfig>(
      "gpio", "a GPIO line", [](const GpioActuatorConfig& config) { return std::make_unique<GpioActuator>(config); },
      [](PartPlan& plan, const GpioActuatorConfig& config) { plan.place = place_of(config.line.text, config.chip); },
      {.aliases = "relay led valve lamp pump heater buzzer"});
#endif
  registry.add_output<PwmConfig>(
      "pwm", "the duty cycle of a channel of a PWM chip of the kernel",
      [](const PwmConfig& config) { return std::make_unique<PwmActuator>(config); },
      [](PartPlan& plan, const PwmConfig& config) {
        plan.place = {"PWM chip",
                      std::to_string(config.chip) + ", channel " + std::to_string(config.channel) +
                          (config.root == PwmConfig{}.root ? "" : ", below " + config.root),
                      ""};
      });
  registry.add_output<SerialActuatorConfig>(
      "serial", "a device that is set by a text, on a serial line or a TCP connection",
      [](const SerialActuatorConfig& config) { return std::make_unique<SerialActuator>(config); },
      [](PartPlan& plan, const SerialActuatorConfig& config) {
        if (config.host.empty())
          plan.place = {"", config.device, ""};
        else
          plan.place = {"server", config.host + " port " + std::to_string(config.port), ""};
      });
  registry.add_output<CommandActuatorConfig>(
      "command", "a program of your own that sets the value",
      [](const CommandActuatorConfig& config) { return std::make_unique<CommandActuator>(config); },
      [](PartPlan&, const CommandActuatorConfig&) {}, {.aliases = "script shell python exec kasa uhubctl plug"});
#ifdef RTDATA_WITH_MQTT
  registry.add_output<MqttActuatorConfig>(
      "mqtt", "a device that is set by a message to a broker of MQTT",
      [](const MqttActuatorConfig& config) { return std::make_unique<MqttActuator>(config); },
      [](PartPlan& plan, const MqttActuatorConfig& config) {
        plan.place = {"MQTT topic", config.to + " of " + config.broker.host + ", message " + config.text, ""};
        plan.place.more = std::to_string(config.broker.port);
      });
#endif
#ifdef RTDATA_WITH_HTTP
  registry.add_output<HttpActuatorConfig>(
      "http", "a device that is set by a request to a URL",
      [](const HttpActuatorConfig& config) { return std::make_unique<HttpActuator>(config); },
      [](PartPlan& plan, const HttpActuatorConfig& config) {
        const auto url = detail::parse_http_url(config.server.url);
        if (!url) return;
        plan.place = {"server", url->origin, "two outputs with the same requests would set one device"};
        plan.place.more = config.server.url.substr(config.server.url.find("//") + 2) + " " + config.text;
        if (config.method == HttpMethod::get) plan.place.more.resize(plan.place.more.size() - config.text.size());
      });
#endif
}

}  // namespace rtdata::app
