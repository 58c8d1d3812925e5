// Files that are rotated: every event is in one of them, once and as a whole.
#include <doctest/doctest.h>
#include <fcntl.h>
#include <sys/file.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "rtdata/app/program.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/data/codec.hpp"
#include "rtdata/sinks/file.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

/// Names of the files in the folder, as `ls` gives them.
std::vector<std::string> names_in(const std::filesystem::path& folder) {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    names.push_back(entry.path().filename().string());
  std::sort(names.begin(), names.end());
  return names;
}

/// Values of all events of these files, one after the other; each begins with its header and has whole events.
std::vector<double> values_in(const std::filesystem::path& folder, const char* format) {
  auto codec = CodecRegistry::standard().make(format).or_throw();
  std::vector<double> values;
  for (const std::string& name : names_in(folder)) {
    CAPTURE(name);
    const std::string text = content((folder / name).string());
    std::span<const std::byte> left = std::as_bytes(std::span(text));
    const std::string header = codec->header(*description_of<Number>());
    CHECK(text.starts_with(header));
    left = left.subspan(std::min(header.size(), left.size()));
    while (!left.empty()) {
      const std::size_t size = codec->first_event(left);
      REQUIRE(size > 0);
      values.push_back(decode<Number>(*codec, left.first(size)).or_throw().data.value);
      left = left.subspan(size);
    }
  }
  return values;
}

std::vector<double> numbers(int first, int last) {
  std::vector<double> all;
  for (int i = first; i <= last; ++i) all.push_back(i);
  return all;
}

void record(const FileConfig& config, int first, int last) {
  Loop loop{Loop::Manual{}};
  FileSink sink(loop, config);
  const auto topic = loop.topic<Number>("a");
  for (int i = first; i <= last; ++i) topic.publish({static_cast<double>(i)});
  CHECK(loop.close() == 0);
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-30 files rotate by size: nothing is lost at the seams, nor over restarts, and the names sort") {
    for (const char* format : {"json", "csv", "raw"}) {
      CAPTURE(format);
      Directory directory;
      const FileConfig config{.path = directory / "run.dat", .format = format, .rotate = {.bytes = 4096}};
      record(config, 1001, 2000);
      record(config, 2001, 2003);
      record(config, 2004, 3000);
      const auto names = names_in(directory / "");
      REQUIRE(names.size() > 5);
      CHECK(names.front() == "run-00000001.dat");
      CHECK(names.back() == "run.dat");
      for (const std::string& name : names) {
        CHECK(std::filesystem::file_size(directory / name) <= 4096);
        if (name != "run.dat") CHECK(std::filesystem::file_size(directory / name) > 3900);
      }
      CHECK(values_in(directory / "", format) == numbers(1001, 3000));
    }
  }

  TEST_CASE("US-30 a file for each topic rotates on its own") {
    Directory directory;
    {
      Loop loop{Loop::Manual{}};
      FileSink sink(loop, {.path = directory / "{topic}.csv", .format = "csv", .rotate = {.bytes = 4096}});
      const auto fast = loop.topic<Number>("fast");
      const auto slow = loop.topic<Number>("slow");
      for (int i = 0; i < 1000; ++i) {
        fast.publish({static_cast<double>(i)});
        if (i % 100 == 0) slow.publish({static_cast<double>(i)});
      }
    }
    const auto names = names_in(directory / "");
    CHECK(std::count_if(names.begin(), names.end(), [](const auto& n) { return n.starts_with("slow"); }) == 1);
    CHECK(std::count_if(names.begin(), names.end(), [](const auto& n) { return n.starts_with("fast"); }) > 5);
    CHECK(values_in(directory / "", "csv").size() == 1010);
  }

  TEST_CASE("US-30 files rotate by time, at its multiples") {
    Directory directory;
    Loop loop{Loop::Manual{}};
    FileSink sink(loop, {.path = directory / "run.jsonl", .rotate = {.time = 10s}});
    const auto topic = loop.topic<Number>("a");
    const std::int64_t start = to_nanoseconds(loop.time());
    std::vector<std::int64_t> periods;
    for (int i = 0; i < 50; ++i) {
      periods.push_back(to_nanoseconds(loop.time()) / 10'000'000'000);
      topic.publish({static_cast<double>(i)});
      loop.advance(1s);
    }
    CHECK(start > 0);
    periods.erase(std::unique(periods.begin(), periods.end()), periods.end());
    CHECK(names_in(directory / "").size() == periods.size());
    CHECK(periods.size() >= 5);
    CHECK(values_in(directory / "", "json") == numbers(0, 49));
    loop.advance(60s);  // without events, no files
    CHECK(names_in(directory / "").size() == periods.size());
  }

  TEST_CASE("US-30 a file from before the restart is closed when its time is over") {
    Directory directory;
    const FileConfig config{.path = directory / "run.jsonl", .rotate = {.time = 1h}};
    record(config, 1, 1);
    std::int64_t now = 0;
    {
      Loop loop{Loop::Manual{}};
      now = to_nanoseconds(loop.time());
    }
    const timespec times[2] = {{now / 1'000'000'000 - 7200, 0}, {now / 1'000'000'000 - 7200, 0}};
    REQUIRE(::utimensat(AT_FDCWD, config.path.c_str(), times, 0) == 0);
    record(config, 2, 2);
    CHECK(names_in(directory / "") == std::vector<std::string>{"run-00000001.jsonl", "run.jsonl"});
    CHECK(values_in(directory / "", "json") == numbers(1, 2));
  }

  TEST_CASE("files are made with the permissions of the configuration less the umask, those after them too") {
    const mode_t before = ::umask(022);
    const auto mode_of = [](const std::string& path) {
      struct stat about {};
      REQUIRE(::stat(path.c_str(), &about) == 0);
      return about.st_mode & 07777;
    };
    for (const char* format : {"jsonl", "csv", "raw"}) {
      for (const auto& one : std::initializer_list<std::pair<const char*, mode_t>>{
               {"0640", 0640}, {"0666", 0644}, {"644", 0644}, {"0600", 0600}}) {
        CAPTURE(format);
        const std::string permissions = one.first;
        const mode_t mode = one.second;
        CAPTURE(permissions);
        Directory directory;
        const std::string path = directory / "run.txt";
        record({.path = path, .format = format, .rotate = {.bytes = 4096}, .permissions = permissions}, 1, 300);
        std::size_t files = 0;
        for (const auto& entry : std::filesystem::directory_iterator(directory.path)) {
          CHECK(mode_of(entry.path().string()) == mode);
          ++files;
        }
        CHECK(files > 1);
        if (format != std::string("jsonl")) continue;
        { std::ofstream(path, std::ios::app) << "half"; }
        record({.path = path, .format = format, .permissions = permissions}, 301, 301);
        CHECK(mode_of(path + ".half") == mode);
      }
    }
    ::umask(before);
    Directory directory;
    Loop loop{Loop::Manual{}};
    CHECK_THROWS_AS(FileSink(loop, {.path = directory / "run.jsonl", .permissions = "0777"}), SetupError);
    CHECK_FALSE(std::filesystem::exists(directory / "run.jsonl"));
  }

  TEST_CASE("US-30 keep: the oldest go, none that somebody writes, and numbers go on") {
    Directory directory;
    FileConfig config{.path = directory / "run.jsonl", .rotate = {.bytes = 4096}, .keep = 3};
    record(config, 1001, 2000);
    auto names = names_in(directory / "");
    REQUIRE(names.size() == 4);
    const auto values = values_in(directory / "", "json");
    CHECK(values == numbers(static_cast<int>(values.front()), 2000));
    const std::string held = directory / names[0];
    const int fd = ::open(held.c_str(), O_RDONLY | O_CLOEXEC);
    REQUIRE(::flock(fd, LOCK_EX) == 0);
    record(config, 2001, 3000);
    CHECK(std::filesystem::exists(held));
    ::close(fd);
    const auto after = names_in(directory / "");
    CHECK(after[1] > names[2]);
    CHECK(values_in(directory / "", "json").back() == 3000);
  }

  TEST_CASE("US-30 killed at the seam: what is there goes on, and no number is used twice") {
    Directory directory;
    const FileConfig config{.path = directory / "run.csv", .format = "csv", .rotate = {.bytes = 4096}};
    record(config, 1001, 1100);
    // A new file was made and its name not yet exchanged with that of the full one.
    const std::size_t files = names_in(directory / "").size();
    std::ofstream(directory / "run-00000009.csv").flush();
    std::filesystem::permissions(directory / "run-00000009.csv", std::filesystem::perms::none);
    record(config, 1101, 2000);
    for (const std::string& name : names_in(directory / "")) CHECK(std::filesystem::file_size(directory / name) > 0);
    CHECK(names_in(directory / "").size() > files);
    CHECK(values_in(directory / "", "csv") == numbers(1001, 2000));
  }

  TEST_CASE("US-30 an empty file with a number that is another's stays, and its number is left out") {
    Directory directory;
    std::ofstream(directory / "run-00000007.csv").flush();
    const FileConfig config{.path = directory / "run.csv", .format = "csv", .rotate = {.bytes = 4096}};
    record(config, 1001, 1300);
    CHECK(std::filesystem::file_size(directory / "run-00000007.csv") == 0);
    CHECK(std::filesystem::file_size(directory / "run-00000008.csv") > 0);
    record({.path = directory / "run.csv", .format = "csv"}, 1301, 1302);  // the one of before is set aside
    CHECK(std::filesystem::file_size(directory / "run-00000007.csv") == 0);
    std::filesystem::remove(directory / "run-00000007.csv");
    const auto names = names_in(directory / "");
    CHECK(names.front() == "run-00000008.csv");
    auto all = values_in(directory / "", "csv");
    CHECK(all == numbers(1001, 1302));
  }

  TEST_CASE("NFR-1 a full disk at the seam: each event is there once when there is room") {
    Directory directory;
    const std::string disk = directory / "disk";
    std::filesystem::create_directory(disk);
    if (::mount("none", disk.c_str(), "tmpfs", 0, "size=1m") != 0) {
      MESSAGE("skipped: mounting a small disk is not permitted here");
      return;
    }
    for (const char* format : {"json", "csv", "raw"}) {
      CAPTURE(format);
      std::ofstream(directory / "disk/ballast") << std::string(1'010'000, 'x');
      Loop loop{Loop::Manual{}};
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
      FileSink sink(loop, {.path = disk + "/run.dat",
                           .format = format,
                           .rotate = {.bytes = 4096},
                           .sink = {.name = "run", .batch_rows = 300}});
      const auto topic = loop.topic<Number>("a");
      for (int i = 1001; i <= 4000; ++i) {
        topic.publish({static_cast<double>(i)});
        if (i % 50 == 0) loop.advance(10ms);
      }
      loop.advance(5s);
      CHECK(sink.health() == Health::faulted);
      REQUIRE(!errors.empty());
      CHECK(errors[0] == "storage-full");
      std::filesystem::remove(disk + "/ballast");
      loop.advance(20s);
      CHECK(sink.health() == Health::ok);
      CHECK(sink.counts().stored == 3000);
      loop.close();
      CHECK(values_in(disk, format) == numbers(1001, 4000));
      for (const std::string& name : names_in(disk)) std::filesystem::remove(disk + "/" + name);
    }
    CHECK(::umount(disk.c_str()) == 0);
  }

  TEST_CASE("US-30 files that are deleted while they are written or after: it goes on") {
    Directory directory;
    Loop loop{Loop::Manual{}};
    std::size_t errors = 0;
    loop.on_error([&](const ErrorReport&) { ++errors; });
    FileSink sink(loop, {.path = directory / "run.csv", .format = "csv", .rotate = {.bytes = 4096}});
    const auto topic = loop.topic<Number>("a");
    const auto publish = [&](int first, int last) {
      for (int i = first; i <= last; ++i) topic.publish({static_cast<double>(i)});
      loop.advance(10s);
    };
    publish(1001, 1500);
    for (const std::string& name : names_in(directory / "")) std::filesystem::remove(directory / name);
    publish(1501, 2000);
    CHECK(errors == 1);
    CHECK(values_in(directory / "", "csv") == numbers(1501, 2000));
    CHECK(names_in(directory / "").front() > "run-00000002.csv");  // those that were taken away have theirs
  }

  TEST_CASE("US-30 check refuses a rotation that makes no sense") {
    Directory directory;
    const auto report = [&](const std::string& settings) {
      return plan_system(standard_registry(), parse_config(R"({"sensors": [], "sinks": [{"type": "file", "path": ")" +
                                                           directory / "run.csv" + R"(", )" + settings + "}]}"))
          .report();
    };
    CHECK(report(R"("rotate": {"bytes": 100000, "time": "1 h"}, "keep": 5)").find("error") == std::string::npos);
    CHECK(report(R"("rotate": {"bytes": 100000}, "keep": 5)").empty());
    CHECK(report(R"("rotate": {"bytes": 100})").find("out of range") != std::string::npos);
    CHECK(report(R"("rotate": {"time": "1 ms"})").find("out of range") != std::string::npos);
    CHECK(report(R"("rotate": {"size": 100000})").find("unknown key") != std::string::npos);
    CHECK(report(R"("keep": 5)").find("`keep` needs `rotate`") != std::string::npos);
    CHECK(report(R"("rotate": {}, "keep": 5)").find("`keep` needs `rotate`") != std::string::npos);
    Loop loop{Loop::Manual{}};
    CHECK_THROWS_AS(FileSink(loop, {.path = directory / "run.jsonl", .keep = 5}), SetupError);
    CHECK_THROWS_AS(FileSink(loop, {.path = directory / "run.jsonl", .rotate = {.bytes = 5}}), SetupError);
    CHECK(names_in(directory / "").empty());
  }
}
