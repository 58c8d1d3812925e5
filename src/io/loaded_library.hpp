// Libraries of others that are loaded when a part that needs them is first checked or made: who uses no such part does
// without them.
//
// A header of ours for each (libcurl.hpp, ...) lists the functions that are used. Each becomes an object of the same
// name in namespace rtdata, which unqualified names find there before the function itself, and which is called like it.
// Calls are for after `load`, which what checks or makes such a part calls first.
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
    assert(address != nullptr);  // load comes first
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
  /// `part`, as errors begin: "type http". `sonames`: the first of them that is there serves. All outlive it.
  constexpr LoadedLibrary(const char* part, const char* name, const char* package, std::span<const char* const> sonames,
                          std::span<const Function> functions) noexcept
      : part_(part), name_(name), package_(package), sonames_(sonames), functions_(functions) {}
  LoadedLibrary(const LoadedLibrary&) = delete;
  LoadedLibrary& operator=(const LoadedLibrary&) = delete;

  /// Any thread; blocks while the library is read, the first time. It stays until the process ends. Error:
  /// not-found (it is not there, cannot be loaded, or lacks a function); a later call tries again.
  Result<void> load();

 private:
  const char* const part_;
  const char* const name_;
  const char* const package_;
  const std::span<const char* const> sonames_;
  const std::span<const Function> functions_;
  std::mutex mutex_;
  std::atomic<void*> handle_ = nullptr;  // once all functions have been found
};

/// Adds the error of a library to what `check` tells of an item, as `not-installed`. Returns whether there is none.
bool add_not_installed(const Result<void>& loaded, const ConfigItem& item, Problems& problems);

}  // namespace detail
}  // namespace rtdata

/// The object of a function, and its line in the list of its library.
#define RTDATA_LOADED_FUNCTION(function) inline constinit detail::LoadedFunction<decltype(&::function)> function;
#define RTDATA_LOADED_NAME(function) {#function, &rtdata::function.address},
