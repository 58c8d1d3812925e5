// What calls a function when it goes: user code in destructors.
#pragma once

#include <functional>
#include <memory>
#include <utility>

/// Calls a function when it goes.
struct AtEnd {
  explicit AtEnd(std::function<void()> f) : function(std::make_shared<std::function<void()>>(std::move(f))) {}
  AtEnd(AtEnd&&) = default;
  ~AtEnd() {
    if (function) (*function)();
  }
  std::shared_ptr<std::function<void()>> function;
};
