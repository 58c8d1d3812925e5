/// Callback: a move-only function object, as handlers and sampling functions are kept.
///
/// Small callables (up to 48 bytes that move without throwing) lie inside, larger ones on the heap; calling never
/// allocates. Calling an empty one throws std::logic_error; objects that are made with an empty one where one is needed
/// refuse it.
///
///     rtdata::Callback<int(int)> twice = [](int number) { return 2 * number; };
///     twice(21);   // 42
///
/// Owner: the holder. Thread: the holder's.
#pragma once

#include <cstddef>
#include <cstdint>
#include <new>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include "rtdata/data/time.hpp"

namespace rtdata {

template <class Signature>
class Callback;

template <class R, class... Args>
class Callback<R(Args...)> {
 public:
  Callback() noexcept = default;
  Callback(std::nullptr_t) noexcept {}
  // clang-format off
  template <class F>
    requires(!std::is_same_v<std::remove_cvref_t<F>, Callback> && std::is_invocable_r_v<R, std::decay_t<F>&, Args...>)
  Callback(F&& function) {
    // clang-format on
    using Target = std::decay_t<F>;
    static_assert(std::is_nothrow_destructible_v<Target>,
                  "rtdata: what a callback captures must not throw when it is destroyed");
    if constexpr (fits<Target>) {
      ::new (static_cast<void*>(storage_)) Target(std::forward<F>(function));
      operations_ = &inline_operations<Target>;
      call_ = [](void* storage, Args... args) -> R {
        return static_cast<R>((*std::launder(static_cast<Target*>(storage)))(std::forward<Args>(args)...));
      };
    } else {
      *reinterpret_cast<Target**>(storage_) = new Target(std::forward<F>(function));
      operations_ = &heap_operations<Target>;
      call_ = [](void* storage, Args... args) -> R {
        return static_cast<R>((**static_cast<Target**>(storage))(std::forward<Args>(args)...));
      };
    }
  }
  Callback(Callback&& other) noexcept { take(other); }
  Callback& operator=(Callback&& other) noexcept {
    if (this != &other) {
      const Callback old(std::move(*this));  // destroyed last: the destructors of its captures may use this object
      take(other);
    }
    return *this;
  }
  ~Callback() {
    if (operations_ != nullptr) operations_(storage_, nullptr);
  }

  explicit operator bool() const noexcept { return operations_ != nullptr; }
  R operator()(Args... args) { return call_(storage_, std::forward<Args>(args)...); }
  /// Destroys the function object.
  void reset() noexcept {
    if (operations_ != nullptr) const Callback old(std::move(*this));  // its captures' destructors may use this object
  }

 private:
  static constexpr std::size_t capacity = 48;
  /// Moves the target to `to`, or destroys it when `to` is null.
  using Operations = void (*)(void* storage, void* to);

  template <class Target>
  static constexpr bool fits = sizeof(Target) <= capacity &&
                               alignof(Target) <= alignof(void*) && std::is_nothrow_move_constructible_v<Target>;
  template <class Target>
  static void inline_operations(void* storage, void* to) {
    auto* target = std::launder(static_cast<Target*>(storage));
    if (to != nullptr) ::new (to) Target(std::move(*target));
    target->~Target();
  }
  template <class Target>
  static void heap_operations(void* storage, void* to) {
    auto** target = static_cast<Target**>(storage);
    if (to != nullptr) {
      *static_cast<Target**>(to) = *target;
    } else {
      delete *target;
    }
  }
  void take(Callback& other) noexcept {
    if (other.operations_ == nullptr) return;
    other.operations_(other.storage_, storage_);
    call_ = std::exchange(other.call_, &call_empty);
    operations_ = std::exchange(other.operations_, nullptr);
  }
  [[noreturn]] static R call_empty(void*, Args...) { throw std::logic_error("there is no function in this callback"); }

  R (*call_)(void*, Args...) = &call_empty;
  Operations operations_ = nullptr;
  alignas(void*) std::byte storage_[capacity];
};

/// How long the callbacks of one object took. Very short handlers are timed in groups: each group counts once.
struct CallbackTimes {
  std::uint64_t count = 0;
  Duration total{0};
  Duration max{0};
  std::uint32_t held = 0;  ///< of these, how many held the loop longer than its limit
  /// 99 of 100 calls took no longer: an estimate within about 15 %, which follows changes within some thousand calls.
  Duration p99() const noexcept { return Duration{static_cast<Duration::rep>(p99_)}; }

  void add(Duration took) noexcept {
    ++count;
    total += took;
    if (took > max) max = took;
    // Rises by an eighth after a longer call, and falls by so little after a shorter one that 99 of them cancel it.
    const auto ns = static_cast<float>(took.count());
    if (ns > p99_) {
      const float raised = p99_ * 1.125F + 1;
      p99_ = ns < raised || count == 1 ? ns : raised;
    } else {
      p99_ -= p99_ * (1.0F / 840);
    }
  }

 private:
  float p99_ = 0;
};

/// The callbacks of one object, with its name and, where a configuration file made it, its place there.
///
///     for (const rtdata::CallbackStatus& one : loop.callbacks())
///       std::cout << one.name << ": " << rtdata::to_string(one.times.max) << '\n';
struct CallbackStatus {
  std::string name;   ///< "sensor chamber", "handler of room/#"
  std::string place;  ///< "bench.json:7:5"; empty: made by the program
  CallbackTimes times;
};

}  // namespace rtdata
