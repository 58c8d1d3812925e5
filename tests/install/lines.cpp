// Uses what rtdata::gpio has; a machine need not have such a line.
#include <cstdio>

#include "rtdata/io/gpio.hpp"

int main() {
  try {
    auto led = rtdata::GpioLine::output({.line = "no such line", .safe = false});
    return led.set(true) ? 0 : 1;
  } catch (const rtdata::SetupError& error) {
    std::puts(error.what());
    return error.error().code == rtdata::Errc::not_found || error.error().code == rtdata::Errc::not_permitted ? 0 : 1;
  }
}
