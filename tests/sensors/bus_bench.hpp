// A loop in virtual time with a bus that is made of memory, and all that was told.
#pragma once

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/loop/loop.hpp"
#include "rtdata/testing/fake_i2c.hpp"
#include "rtdata/testing/fake_spi.hpp"
#include "sensors/fixture.hpp"

template <class BusOf, class Wires>
struct BusBench {
  std::shared_ptr<Wires> wires = std::make_shared<Wires>();
  BusOf bus{std::string(BusOf::type) + "1", wires, {.timeout = std::chrono::milliseconds{100}}};
  rtdata::Loop loop{rtdata::Loop::Manual{}};
  std::vector<std::string> errors;
  BusBench() {
    be_quiet(loop);
    loop.on_error([this](const rtdata::ErrorReport& report) { errors.push_back(report.error.text()); });
  }
  bool told(const std::string& part) const {
    return std::any_of(errors.begin(), errors.end(),
                       [&](const std::string& error) { return error.find(part) != std::string::npos; });
  }
};
using I2cBench = BusBench<rtdata::I2cBus, rtdata::FakeI2c>;
using SpiBench = BusBench<rtdata::SpiBus, rtdata::FakeSpi>;
