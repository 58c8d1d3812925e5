// Handler: a callback that may replace itself or close its owner while it runs.
#pragma once

#include <cstdint>
#include <utility>

#include "rtdata/loop/callback.hpp"

namespace rtdata::detail {

/// It is removed for the call and restored afterwards, unless another one was set meanwhile.
template <class Argument>
class Handler {
 public:
  void set(Callback<void(const Argument&)> function) {
    ++changes_;
    function_ = std::move(function);
  }
  void reset() noexcept {
    ++changes_;
    function_.reset();
  }
  explicit operator bool() const noexcept { return static_cast<bool>(function_); }

  /// Throws what the function throws.
  void operator()(const Argument& argument) {
    struct PutBack {
      Handler& handler;
      Callback<void(const Argument&)> function = std::move(handler.function_);
      std::uint32_t changes = handler.changes_;
      ~PutBack() {
        if (handler.changes_ == changes) handler.function_ = std::move(function);
      }
    } running{*this};
    running.function(argument);
  }

 private:
  Callback<void(const Argument&)> function_;
  std::uint32_t changes_ = 0;
};

}  // namespace rtdata::detail
