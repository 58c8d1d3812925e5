// What the tests of sensors share: files of their own, and a log of errors.
#pragma once

#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/testing/fake_i2c.hpp"

/// A directory that is gone after the test.
class ScratchDirectory {
 public:
  ScratchDirectory() {
    char name[] = "/tmp/rtdata_test_XXXXXX";
    path_ = ::mkdtemp(name);
  }
  ScratchDirectory(const ScratchDirectory&) = delete;
  ScratchDirectory& operator=(const ScratchDirectory&) = delete;
  ~ScratchDirectory() {
    for (const std::string& file : files_) ::unlink(file.c_str());
    for (auto at = directories_.rbegin(); at != directories_.rend(); ++at) ::rmdir(at->c_str());
    ::rmdir(path_.c_str());
  }
  const std::string& path() const { return path_; }
  std::string file(const std::string& name) {
    const std::string path = path_ + "/" + name;
    for (auto at = path.find('/', path_.size() + 1); at != std::string::npos; at = path.find('/', at + 1)) {
      if (::access(path.substr(0, at).c_str(), F_OK) == 0) continue;
      directories_.push_back(path.substr(0, at));
      [[maybe_unused]] const int made = ::system(("mkdir -p '" + directories_.back() + "'").c_str());
    }
    files_.push_back(path);
    return path;
  }
  std::string file(const std::string& name, const std::string& content) {
    const std::string path = file(name);
    write(path, content);
    return path;
  }
  static void write(const std::string& path, const std::string& content) {
    std::ofstream(path, std::ios::trunc) << content;
  }

 private:
  std::string path_;
  std::vector<std::string> files_;
  std::vector<std::string> directories_;
};

/// Sets registers to a number of so many bytes, the highest one first: the identity of a chip.
inline void put_code(rtdata::FakeI2cChip& chip, std::uint8_t number, std::uint32_t value, std::size_t size) {
  while (size-- > 0) chip.set(number++, {static_cast<std::uint8_t>(value >> 8 * size)});
}

/// Keeps what goes to the log away from the test's output.
inline void be_quiet(rtdata::Loop& loop) {
  loop.runtime().on_log([](const rtdata::LogRecord&) {});
}
