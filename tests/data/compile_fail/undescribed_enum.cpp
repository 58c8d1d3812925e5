// expect: a field is an enumeration without a `describe`
#include "rtdata/data/describe.hpp"

enum class State { idle, running };
struct Machine {
  std::optional<State> state;
  RTDATA_FIELDS(Machine, (state))
};

const auto& description = rtdata::description_of<Machine>();
