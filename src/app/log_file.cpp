#include "app/log_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <system_error>

namespace rtdata::app {
namespace {

/// One path for each file, however it is written.
std::filesystem::path canonical(const std::string& path) {
  std::error_code ignored;
  return std::filesystem::weakly_canonical(std::filesystem::absolute(path, ignored), ignored);
}

/// Why it cannot be appended to; empty: it can.
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

void check_log_file(const std::string& file, SystemPlan& plan) {
  const auto add = [&](Problems& to, const char* id, const std::string& message) {
    const ConfigItem* log = plan.document.root.is_object() ? plan.document.root.find("log") : nullptr;
    const ConfigItem* at = log != nullptr && log->is_object() ? log->find("file") : nullptr;
    to.add((at != nullptr ? *at : plan.document.root).problem(id, message));
  };
  const std::filesystem::path whole = canonical(file);
  if (!plan.document.file.empty() && whole == canonical(plan.document.file)) {
    add(plan.problems, "duplicate-path", "the log would be written into the configuration; choose another file for it");
  }
  for (const SinkPlan& sink : plan.sinks) {
    if (sink.path.empty() || sink.path == "-" || canonical(sink.path) != whole) continue;
    add(plan.problems, "duplicate-path",
        "the log of the program and the sink at " + sink.item.place().text() + " would write one file, \"" + file +
            "\"; choose another for the log (`log.file`, or --log), or for the sink");
  }
  if (const std::string why = obstacle(file); !why.empty() && plan.good())
    add(plan.warnings, "cannot-write",
        "the log file \"" + file + "\" cannot be written: " + why + "; nothing is logged");
}

}  // namespace rtdata::app
