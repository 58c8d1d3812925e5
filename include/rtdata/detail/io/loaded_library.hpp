/// LoadedLibrary: a third-party library, loaded when a part that needs it is first checked or made, so that other users
/// do not need it.
///
/// A header for each library (libcurl.hpp, ...) lists its functions. Each becomes an object of the same name in
/// namespace rtdata, which unqualified calls find before the function itself. Call `load` first; checking or making
/// such a part does this.
#pragma once

#include <atomic>
#include <cassert>
#include <mutex>
#include <span>

#include "rtdata/data/error.hpp"

namespace rtdata {

class ConfigItem;
class Problems;

namespace detail {

/// A function of a loaded library. `Pointer`: to the function.
template <class Pointer>
class LoadedFunction {
 public:
  operator Pointer() const noexcept {
    assert(address != nullptr);  // `load` must be called before
    return reinterpret_cast<Pointer>(address);
  }
  void* address = nullptr;
};

class LoadedLibrary {
 public:
  struct Function {
    const char* name;
    void** address;
  };
  /// `part`: the beginning of errors: "type http". `sonames`: the first existing one is used. All arguments must
  /// outlive it.
  constexpr LoadedLibrary(const char* part, const char* name, const char* package, std::span<const char* const> sonames,
                          std::span<const Function> functions) noexcept
      : part_(part), name_(name), package_(package), sonames_(sonames), functions_(functions) {}
  LoadedLibrary(const LoadedLibrary&) = delete;
  LoadedLibrary& operator=(const LoadedLibrary&) = delete;

  /// Any thread; the first call blocks while it loads the library, which stays until the process ends. Error: not-found
  /// (missing, cannot be loaded, or lacks a function); a later call tries again.
  Result<void> load();

 private:
  const char* const part_;
  const char* const name_;
  const char* const package_;
  const std::span<const char* const> sonames_;
  const std::span<const Function> functions_;
  std::mutex mutex_;
  std::atomic<void*> handle_ = nullptr;  // set when all functions were found
};

/// Adds the error of a library to the problems of an item, as `not-installed`. Returns true without an error.
bool add_not_installed(const Result<void>& loaded, const ConfigItem& item, Problems& problems);

}  // namespace detail
}  // namespace rtdata

/// The object of a function, and its line in the list of its library.
#define RTDATA_LOADED_FUNCTION(function) inline constinit detail::LoadedFunction<decltype(&::function)> function;
#define RTDATA_LOADED_NAME(function) {#function, &rtdata::function.address},

/// Outside namespaces: the objects of `functions`, a list as RTDATA_LIBZ, and the library rtdata::detail::`name`. The
/// others are as of LoadedLibrary, the sonames last.
// clang-format off
#define RTDATA_LOADED_LIBRARY(name, functions, part, title, package, ...)                              \
  namespace rtdata {                                                                                   \
  functions(RTDATA_LOADED_FUNCTION)                                                                    \
  namespace detail {                                                                                   \
  inline constexpr const char* name##_sonames[] = {__VA_ARGS__};                                       \
  inline constexpr LoadedLibrary::Function name##_functions[] = {functions(RTDATA_LOADED_NAME)};       \
  inline constinit LoadedLibrary name{part, title, package, name##_sonames, name##_functions};         \
  }                                                                                                    \
  }
// clang-format on
