#include "app/run/log.hpp"

#include <doctest/doctest.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <sstream>
#include <string>

#include "rtdata/app/program.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace rtdata::app;
using sinks::content;
using sinks::Directory;

namespace {

/// Lines that are numbered from `first` on, none of which has to wait so long that it is thrown away.
void write_lines(Log& log, int first, int count) {
  for (int i = first; i < first + count; ++i) {
    log.write(LogLevel::info, "test", "line " + std::to_string(i));
    if (i % 50 == 0) REQUIRE(log.wait_until_written(std::chrono::seconds{60}));
  }
  REQUIRE(log.wait_until_written(std::chrono::seconds{60}));
}

/// The numbers of the lines are those from `first` on. The number of lines.
int check_lines(const std::string& text, int first) {
  std::istringstream lines(text);
  int count = 0;
  for (std::string line; std::getline(lines, line); ++count)
    CHECK(line.ends_with(" info test: line " + std::to_string(first + count)));
  return count;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("NFR-7 the log file rotates by size: no line is lost or divided, and so many files are kept") {
    Directory directory;
    const std::string path = directory / "run.log";
    Log log;
    log.open(path, {.max_bytes = 4096, .keep = 3}).or_throw();
    write_lines(log, 1000, 60);
    CHECK(check_lines(content(path), 1000) == 60);
    write_lines(log, 1060, 100);
    CHECK(std::filesystem::exists(path + ".1"));
    CHECK_FALSE(std::filesystem::exists(path + ".3"));
    CHECK(check_lines(content(path + ".2") + content(path + ".1") + content(path), 1000) == 160);
    write_lines(log, 1160, 500);
    CHECK_FALSE(std::filesystem::exists(path + ".4"));
    std::string all;
    for (const char* end : {".3", ".2", ".1", ""}) {
      CHECK(std::filesystem::file_size(path + end) <= 4096);
      all += content(path + end);
    }
    const int first = std::stoi(all.substr(all.find(" line ") + 6));
    CHECK(check_lines(all, first) == 1660 - first);
  }

  TEST_CASE("NFR-7 a log file that is taken away is made anew") {
    Directory directory;
    const std::string path = directory / "run.log";
    Log log;
    log.open(path, {}).or_throw();
    write_lines(log, 1, 3);
    std::filesystem::rename(path, path + ".old");
    write_lines(log, 4, 2);
    std::filesystem::remove(path);
    write_lines(log, 6, 1);
    CHECK(check_lines(content(path + ".old"), 1) == 3);
    CHECK(check_lines(content(path), 6) == 1);
  }

  TEST_CASE("NFR-7 a fatal signal is told in the file that is written, after it has rotated too") {
    Directory directory;
    const std::string path = directory / "run.log";
    const pid_t child = ::fork();
    if (child == 0) {
      std::signal(SIGABRT, SIG_DFL);
      Log log;
      if (!log.open(path, {.max_bytes = 4096, .keep = 3})) ::_exit(1);
      const FatalSignals fatal(log);
      for (int i = 0; i < 100; ++i) {
        log.write(LogLevel::info, "test", "line");
        log.wait_until_written(std::chrono::seconds{60});
      }
      ::raise(SIGABRT);
      ::_exit(2);
    }
    int status = 0;
    REQUIRE(::waitpid(child, &status, 0) == child);
    REQUIRE(WIFSIGNALED(status));
    CHECK(std::filesystem::exists(path + ".1"));
    const std::string text = content(path);
    CHECK(text.find("fatal signal " + std::to_string(SIGABRT)) != std::string::npos);
    CHECK(content(path + ".1").find("fatal signal") == std::string::npos);
  }

  TEST_CASE("NFR-7 the log is made with the permissions of the configuration less the umask, also when it rotates") {
    const mode_t before = ::umask(022);
    const auto mode_of = [](const std::string& path) {
      struct stat about {};
      REQUIRE(::stat(path.c_str(), &about) == 0);
      return about.st_mode & 07777;
    };
    for (const auto& one :
         std::initializer_list<std::pair<const char*, mode_t>>{{"0640", 0640}, {"0666", 0644}, {"600", 0600}}) {
      const std::string permissions = one.first;
      const mode_t mode = one.second;
      CAPTURE(permissions);
      Directory directory;
      const std::string path = directory / "run.log";
      Log log;
      log.open(path, {.max_bytes = 4096, .keep = 3, .permissions = permissions}).or_throw();
      write_lines(log, 1000, 300);
      for (const char* end : {"", ".1", ".2"}) CHECK(mode_of(path + end) == mode);
    }
    ::umask(before);
    Directory directory;
    Log log;
    CHECK_FALSE(log.open(directory / "run.log", {.permissions = "0777"}).has_value());
    CHECK_FALSE(std::filesystem::exists(directory / "run.log"));
  }

  TEST_CASE("NFR-7 check refuses permissions that are none") {
    const auto report = [](const std::string& item) {
      return plan_system(standard_registry(), parse_config("{" + item + "}")).report();
    };
    const auto items = [](const std::string& permissions) {
      const std::string own = R"("permissions": )" + permissions + "}";
      return std::vector<std::string>{R"("sinks": [{"type": "sqlite", "path": "run.db", )" + own + "]",
                                      R"("sinks": [{"type": "file", "path": "run.jsonl", )" + own + "]",
                                      R"("log": {)" + own};
    };
    for (const char* right : {"\"0640\"", "\"644\"", "\"0600\""}) {
      for (const std::string& item : items(right)) CHECK_MESSAGE(report(item).find("error") == std::string::npos, item);
    }
    for (const char* wrong : {"\"\"", "\"0755\"", "\"0999\"", "\"0440\"", "\"rw\"", "\"06400\""}) {
      for (const std::string& item : items(wrong))
        CHECK_MESSAGE(report(item).find("permissions are octal digits") != std::string::npos, item);
    }
    for (const std::string& item : items("420")) CHECK_FALSE(report(item).empty());
    for (const std::string& item : items(R"({"env": "PATH"})"))
      CHECK(report(item).find("permissions are not secret") != std::string::npos);
  }

  TEST_CASE("NFR-7 check refuses limits of the log that say nothing") {
    const auto report = [](const std::string& log) {
      return plan_system(standard_registry(), parse_config(R"({"log": )" + log + "}")).report();
    };
    CHECK(report(R"({"max_bytes": 100000, "keep": 2})").empty());
    CHECK(report(R"({"max_bytes": 0})").empty());
    CHECK(report(R"({"max_bytes": 100})").find("out of range") != std::string::npos);
    CHECK(report(R"({"keep": 0})").find("out of range") != std::string::npos);
  }
}
