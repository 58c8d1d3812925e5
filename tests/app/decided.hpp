/// What a machine of a rocket has decided, as its recording says.
#pragma once

#include <chrono>
#include <map>
#include <string>
#include <vector>

#include "app/process.hpp"
#include "paths.hpp"
#include "rtdata/fsm/machine.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::test {

struct Decided {
  std::vector<std::string> states;
  std::map<std::string, double> at;  // s, of the first arrival
  std::map<std::string, std::string> cause;
};

inline Decided decided_in(const std::string& recording) {
  Decided decided;
  auto file = Recording::open(recording).or_throw();
  auto changes = file.events<fsm::StateChange>("flight").or_throw();
  while (const auto* change = changes.next().or_throw()) {
    const std::string to((*change)->to);
    decided.states.push_back(to);
    decided.at.try_emplace(to, std::chrono::duration<double>(change->time.time_since_epoch()).count());
    decided.cause.try_emplace(to, (*change)->cause);
  }
  return decided;
}

inline int run(const Folder& folder, std::vector<std::string> arguments, std::string* err = nullptr) {
  Process process(folder, built("rtdata"), std::move(arguments));
  const int status = process.end();
  if (err != nullptr) *err = process.err;
  return status;
}

}  // namespace rtdata::test
