// mosquitto, the real broker, as a program of the tests' own.
#pragma once

#include <arpa/inet.h>
#include <doctest/doctest.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>
#include <string>
#include <thread>

#include "listening.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sinks/sink_kinds.hpp"

namespace sinks {

using namespace std::chrono_literals;

inline std::string broker_program() {
  for (const char* path : {"/usr/sbin/mosquitto", "/usr/local/sbin/mosquitto", "/usr/bin/mosquitto"})
    if (::access(path, X_OK) == 0) return path;
  return "";
}

/// mosquitto on a port of this machine that was free.
class Broker {
 public:
  explicit Broker(const std::string& more = "allow_anonymous true\n") : more_(more) {
    FakeGpsd finder;
    port_ = finder.port();
    finder.vanish();
    start();
  }
  Broker(const Broker&) = delete;
  Broker& operator=(const Broker&) = delete;
  ~Broker() { kill(); }
  void start() {
    std::ofstream(directory_ / "conf") << "listener " << port_ << " 127.0.0.1\nuser root\n" << more_;
    const std::string program = broker_program(), conf = directory_ / "conf", log = directory_ / "log";
    process_ = ::fork();
    if (process_ == 0) {
      if (std::freopen(log.c_str(), "a", stderr) == nullptr || std::freopen(log.c_str(), "a", stdout) == nullptr)
        ::_exit(1);
      ::execl(program.c_str(), "mosquitto", "-c", conf.c_str(), static_cast<char*>(nullptr));
      ::_exit(127);
    }
    REQUIRE_MESSAGE(rtdata::test::comes_to_listen(port_), content(log));
  }
  void kill() {
    if (process_ <= 0) return;
    ::kill(process_, SIGKILL);
    ::waitpid(process_, nullptr, 0);
    process_ = -1;
  }
  void signal(int number) const { ::kill(process_, number); }
  std::uint16_t port() const { return port_; }
  std::string log() const { return content(directory_ / "log"); }
  std::string write(const std::string& name, const std::string& text) {
    std::ofstream(directory_ / name) << text;
    return directory_ / name;
  }

 private:
  Directory directory_;
  std::string more_;
  std::uint16_t port_ = 0;
  pid_t process_ = -1;
};

}  // namespace sinks

#define NEEDS_BROKER()                              \
  if (broker_program().empty()) {                   \
    MESSAGE("skipped: mosquitto is not installed"); \
    return;                                         \
  }
