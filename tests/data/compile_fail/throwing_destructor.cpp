// expect: what a callback captures must not throw when it is destroyed
#include "rtdata/loop/callback.hpp"

struct Throws {
  ~Throws() noexcept(false) {}
};

rtdata::Callback<void()> callback([captured = Throws()] {});
