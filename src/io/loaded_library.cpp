#include "rtdata/detail/io/loaded_library.hpp"

#include <dlfcn.h>

#include <string>

#include "rtdata/data/config_item.hpp"
#include "rtdata/data/problem.hpp"

namespace rtdata::detail {

Result<void> LoadedLibrary::load() {
  if (handle_.load(std::memory_order_acquire) != nullptr) return {};
  const std::lock_guard lock(mutex_);
  if (handle_.load(std::memory_order_relaxed) != nullptr) return {};
  const auto refuse = [&](std::string why) {
    return Error{Errc::not_found, part_, "", name_ + std::move(why), std::string("apt install ") + package_};
  };
  void* handle = nullptr;
  std::string missing, broken;
  for (const char* const soname : sonames_) {
    // Resolves all functions now, so that no later call fails; never unloads, because libraries leave threads and exit
    // handlers.
    handle = ::dlopen(soname, RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
    if (handle != nullptr) break;
    const char* const said = ::dlerror();
    const std::string text = said != nullptr ? said : soname;
    // The loader names a missing library by the requested name, a found one by its path.
    std::string& why = text.starts_with(std::string(soname) + ":") ? missing : broken;
    if (why.empty()) why = text;
  }
  if (handle == nullptr && !broken.empty()) return refuse(" cannot be loaded (" + broken + ")");
  if (handle == nullptr) return refuse(" is not installed (" + missing + ")");
  for (const Function& function : functions_) {
    *function.address = ::dlsym(handle, function.name);
    if (*function.address != nullptr) continue;
    ::dlclose(handle);
    return refuse(std::string(" is older than the version that this program was built with: it has no function ") +
                  function.name);
  }
  handle_.store(handle, std::memory_order_release);
  return {};
}

bool add_not_installed(const Result<void>& loaded, const ConfigItem& item, Problems& problems) {
  if (loaded) return true;
  problems.add(item.problem("not-installed", loaded.error().text()));
  return false;
}

}  // namespace rtdata::detail
