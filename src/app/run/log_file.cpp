#include "app/run/log_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <system_error>

#include "config/plan/written_file.hpp"
#include "config/read/mistakes.hpp"

namespace rtdata::app {
namespace {

/// Why the log cannot use this file, because the part writes it; empty: it can.
std::string conflict_with(const PartPlan& part, const SystemPlan& plan, const config_detail::WrittenFile& log) {
  const StoredTopics& stores = *part.stores;
  if (stores.path.empty() || stores.path == "-") return "";
  std::string why = conflict(log, config_detail::written_file(part, stores.path));
  if (!stores.file_of_topic) return why;
  for (const PartPlan& other : plan.parts) {
    if (!why.empty()) break;
    if (other.publishes && stores.wants(other.publishes->topic))
      why = conflict(log, config_detail::written_file(part, stores.file_of_topic(other.publishes->topic)));
  }
  return why;
}

/// Why the log cannot append to the file; empty: it can.
std::string obstacle(const std::string& file) {
  struct stat about {};
  if (::stat(file.c_str(), &about) == 0) {
    if (S_ISDIR(about.st_mode)) return "it is a folder";
    return ::faccessat(AT_FDCWD, file.c_str(), W_OK, AT_EACCESS) == 0 ? "" : std::generic_category().message(errno);
  }
  const std::filesystem::path path(file);
  const std::string folder = path.has_parent_path() ? path.parent_path().string() : ".";
  return ::faccessat(AT_FDCWD, folder.c_str(), W_OK | X_OK, AT_EACCESS) == 0
             ? ""
             : folder + ": " + std::generic_category().message(errno);
}

}  // namespace

std::string log_file_of(const SystemPlan& plan, const std::string& given) {
  if (!given.empty()) return given;
  if (!plan.settings.log.file.empty()) return plan.settings.log.file;
  const std::string stem = std::filesystem::path(plan.document.file).stem().string();
  return (stem.empty() ? "rtdata" : stem) + ".log";
}

bool check_log_file(const std::string& file, SystemPlan& plan) {
  const auto add = [&](Problems& to, const char* id, const std::string& message) {
    const ConfigItem* const log = config_detail::child_of(plan.document.root, "log");
    const ConfigItem* const at = log != nullptr ? config_detail::child_of(*log, "file") : nullptr;
    to.add((at != nullptr ? *at : plan.document.root).problem(id, message));
  };
  const bool is_reported = file == plan.settings.log.file;  // by the plan
  bool is_free = true;
  const auto refuse = [&](const std::string& message) {
    is_free = false;
    if (!is_reported) add(plan.problems, "duplicate-path", message);
  };
  const config_detail::WrittenFile log{file, "the log", [&](const std::string& path, const std::string& other) {
                                         return config_detail::is_rotated_log(plan.settings.log, path, other);
                                       }};
  if (!plan.document.file.empty() && !conflict(log, {plan.document.file, "the configuration", {}}).empty())
    refuse("the log \"" + file + "\" would overwrite the configuration; choose another file for the log");
  for (const PartPlan& part : plan.parts) {
    const std::string why = part.stores ? conflict_with(part, plan, log) : "";
    if (!why.empty())
      refuse("the log would be \"" + file + "\": " + why + " for the log (`log.file`, or --log), or for the sink");
  }
  if (const std::string why = obstacle(file); !why.empty() && plan.good())
    add(plan.warnings, "cannot-write",
        "the log file \"" + file + "\" cannot be written: " + why + "; nothing is logged");
  return is_free;
}

}  // namespace rtdata::app
