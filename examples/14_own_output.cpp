// An output of one's own: the shipped GPIO line, extended for a compressor, which must rest before it is switched on
// again. A guard holds it: it is off, too, when this program hangs or is killed. (The chip is one of memory here.)
#include <rtdata/loop/loop.hpp>
#include <rtdata/loop/runtime.hpp>
#include <rtdata/loop/timer.hpp>
#include <rtdata/outputs/gpio.hpp>
#include <rtdata/outputs/guard.hpp>
#include <rtdata/testing/fake_gpio.hpp>

#include <chrono>
#include <cstdio>
#include <memory>
#include <thread>

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

class Compressor final : public rtdata::GpioActuator {
 public:
  using GpioActuator::GpioActuator;
  // On a thread of the guard: waiting holds nothing but this output.
  rtdata::Result<void> set(double value) override {
    if (value == 1) std::this_thread::sleep_until(off_since_ + 50ms);
    if (value == 0) off_since_ = Clock::now();
    return GpioActuator::set(value);
  }

 private:
  Clock::time_point off_since_ = Clock::now();
};

int main() {
  auto chip = std::make_shared<rtdata::FakeGpio>();
  chip->add_chip("gpiochip0", 8);
  const auto make = [chip] { return std::make_unique<Compressor>(rtdata::GpioActuatorConfig{.line = 5}, chip); };
  rtdata::OutputGuard guard([make](const std::string&) { return make(); });  // before there are threads

  rtdata::Runtime runtime({.guard = &guard});
  rtdata::Loop loop(runtime, {});
  const auto changes = loop.subscribe<rtdata::OutputChange>("compressor", [](const auto& event) {
    if (event->done) std::printf("%.0f after %.0f ms\n", *event->done, event->took * 1000);
  });
  rtdata::Output compressor(loop, {.name = "compressor", .lease = 150ms, .watchdog = 1s}, make, "compressor");
  compressor.set(1, "example").or_throw();
  // Nobody sets it again: it is off when its lease is over.
  loop.run_for(400ms);
  return compressor.value() == 0 ? 0 : 1;
}
