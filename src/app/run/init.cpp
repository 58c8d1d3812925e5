#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <fstream>
#include <iostream>

#include "app/core/configuration_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/run/async_writer.hpp"
#include "app/run/starter.hpp"
#include "data/listed.hpp"
#include "rtdata/config/format.hpp"

namespace rtdata::app {

namespace {

/// Writes the schema beside the starter file, which refers to it; replaces an old one, because the schema belongs to
/// this program. Empty: it cannot be written; only the editor's help is missing then.
std::string write_schema(const Registry& registry, const std::string& file) {
  const std::filesystem::path path = std::filesystem::path(file).parent_path() / schema_file;
  std::ofstream out(path);
  out << registry.schema() << "\n";
  return out.flush() ? path.string() : "";
}

}  // namespace

int init(const Registry& registry, const std::string& file) {
  if (const ConfigFormats formats; formats.find(file) == nullptr) {
    std::vector<std::string> known = formats.extensions();
    std::erase(known, "");
    const Error error{Errc::bad_argument, "cannot write the starter file", file,
                      "`rtdata run` reads no configuration with this extension",
                      "choose a name that ends with " + detail::listed(known)};
    print_error(std::cerr, error);
    return exit_other;
  }
  const std::string text = starter_file(registry, file);
  const int fd = ::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (fd < 0) {
    const int failed = errno;
    const std::string folder = std::filesystem::path(file).parent_path().string();
    const Error error = system_error(failed, "cannot write the starter file", file,
                                     failed == EEXIST ? "choose another name, or move that file away"
                                     : failed == ENOENT && !folder.empty() ? "make the folder first: mkdir -p " + folder
                                                                           : "");
    print_error(std::cerr, error);
    return exit_other;
  }
  int failed = write_fully(fd, text.data(), text.size());
  if (::close(fd) != 0 && failed == 0) failed = errno;
  if (failed != 0) {
    print_error(std::cerr, system_error(failed, "cannot write the starter file", file));
    ::unlink(file.c_str());
    return exit_other;
  }
  std::cout << "wrote " << file;
  if (const std::string schema = write_schema(registry, file); !schema.empty())
    std::cout << " and, for editors, " << schema;
  std::cout << "\nnext: rtdata run " << file << " --for 10s" << std::endl;
  return exit_good;
}

}  // namespace rtdata::app
