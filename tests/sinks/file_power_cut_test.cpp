// What a kill or a power cut leaves of a file: what was forced onto the disk is there, and of what was written since
// then a part, in front of nothing or of zeros, where the disk knew the length and not the content.
#include <doctest/doctest.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "data/payloads.hpp"
#include "rtdata/sinks/file.hpp"
#include "sinks/sink_kinds.hpp"

namespace {

/// A disk that this test cuts off. The real one need not be waited for: what it has is what is noted here.
struct Disk {
  Disk() { now = this; }
  ~Disk() { now = nullptr; }
  bool is_noting = true;
  std::map<ino_t, off_t> synced;  // how much of each file is on it
  static inline Disk* now = nullptr;
};

}  // namespace

/// The C library's, but for the files of a test that has a disk of its own.
extern "C" int fdatasync(int fd) {
  if (Disk::now == nullptr) return static_cast<int>(::syscall(SYS_fdatasync, fd));
  struct stat about {};
  if (Disk::now->is_noting && ::fstat(fd, &about) == 0) Disk::now->synced[about.st_ino] = about.st_size;
  return 0;
}

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

/// Publishes numbers from `first` on, in batches of 4, each forced onto the disk; returns what was told.
std::string record_numbers(const std::string& path, const char* format, int first, int count, int unsynced) {
  std::string told;
  Loop loop{Loop::Manual{}};
  loop.runtime().on_log([](const LogRecord&) {});
  loop.on_error([&](const ErrorReport& report) { told += report.error.text() + '\n'; });
  FileSink sink(loop, {.path = path,
                       .format = format,
                       .sync = FileSync::batch,
                       .rotate = {.time = 24h * 360},
                       .sink = {.batch_rows = 4}});
  const auto topic = loop.topic<Number>("a");
  for (int i = 0; i < count; ++i) {
    topic.publish({static_cast<double>(first + i)});
    loop.advance(1ms);
    if (i + 1 == count - unsynced) {
      sink.flush();
      loop.advance(1ms);
      Disk::now->is_noting = false;  // what follows is not on the disk yet
    }
  }
  loop.close();
  return told;
}

std::vector<int> numbers_in(const std::string& path, const char* format) {
  const auto codec = CodecRegistry::standard().make(format).or_throw();
  const std::string text = content(path);
  std::span<const std::byte> left = std::as_bytes(std::span(text));
  if (!codec->header(*description_of<Number>()).empty()) left = left.subspan(codec->first_event(left));
  std::vector<int> all;
  while (!left.empty()) {
    const std::size_t size = codec->first_event(left);
    REQUIRE(size > 0);
    all.push_back(static_cast<int>(decode<Number>(*codec, left.first(size)).or_throw().data.value));
    left = left.subspan(size);
  }
  return all;
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE(
      "a file is whole after a kill and a power cut at any byte: what was synced is there, half an event is not") {
    constexpr int sure = 8, all = 14;
    for (const char* format : {"json", "csv", "raw"}) {
      CAPTURE(std::string(format));
      const Directory directory;
      const std::string path = directory / "run";
      Disk disk;
      record_numbers(path, format, 0, all, all - sure);
      REQUIRE(disk.synced.size() == 1);
      const auto least = static_cast<std::size_t>(disk.synced.begin()->second);
      const std::string whole = content(path);
      REQUIRE(least > 0);
      REQUIRE(least < whole.size());
      for (std::size_t length = least; length <= whole.size(); ++length) {
        for (const std::size_t zeros : {std::size_t{0}, whole.size() - length}) {
          // Raw events have nothing by which zeros in one could be told from a value.
          if (zeros != 0 && std::string_view(format) == "raw") continue;
          CAPTURE(length);
          CAPTURE(zeros);
          std::filesystem::remove(path);
          std::filesystem::remove(path + ".half");
          const std::string left = whole.substr(0, length) + std::string(zeros, '\0');
          std::ofstream(path, std::ios::binary) << left;
          const std::string told = record_numbers(path, format, 100, 3, 0);
          const std::vector<int> numbers = numbers_in(path, format);
          REQUIRE(numbers.size() >= sure + 3);
          for (int i = 0; i < static_cast<int>(numbers.size()) - 3; ++i)
            CHECK(numbers[static_cast<std::size_t>(i)] == i);
          for (int i = 0; i < 3; ++i) CHECK(numbers[numbers.size() - 3 + static_cast<std::size_t>(i)] == 100 + i);
          // Each byte that was there is in the file or beside it, and who starts is told of the latter.
          const std::string file = content(path);
          const std::string half = std::filesystem::exists(path + ".half") ? content(path + ".half") : "";
          CHECK(file.substr(0, left.size() - half.size()) + half == left);
          CHECK(told.empty() == half.empty());
        }
      }
    }
  }
}
