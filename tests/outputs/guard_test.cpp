// The guard process: programs that are killed, stopped, hang or lose it while an output is on. Real processes and
// time; the bounds are generous, since the machine may be busy.
#include "rtdata/outputs/guard.hpp"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "app/run/stop_signals.hpp"
#include "outputs/output_log.hpp"
#include "outputs/terminal.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/outputs/gpio.hpp"
#include "rtdata/outputs/serial.hpp"
#include "rtdata/sinks/sink.hpp"
#include "rtdata/testing/fake_gpio.hpp"
#include "sanitized.hpp"
#include "sensors/fixture.hpp"
#include "sinks/killed.hpp"

using namespace rtdata;
using namespace std::chrono_literals;

namespace {

constexpr auto patience = 60s;

/// Writes each value as a line of a file, which any process can read. While there is a file PATH.mute it takes nothing,
/// and each try is a line of PATH.tries. While there is PATH.sluggish a value takes half a second. One with "slow" in
/// its path takes its time, one with "locked" is for one process, and slow when it is mute.
class FileActuator final : public Actuator {
 public:
  explicit FileActuator(std::string path) : path_(std::move(path)) {}
  ~FileActuator() override {
    if (is_open_) write("gone");
    if (lock_ >= 0) ::close(lock_);
  }
  Result<void> open(std::optional<double> value) override {
    if (path_.find("refused") != std::string::npos)
      return Error{Errc::busy, "cannot open", path_, "somebody has it", "ask them"};
    if (path_.find("locked") != std::string::npos) {
      lock_ = ::open((path_ + ".lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
      if (::flock(lock_, LOCK_EX | LOCK_NB) != 0) return Error{Errc::busy, "cannot open", path_, "in use", "end that"};
    }
    if (is_mute()) return mute();
    if (path_.find("slow") != std::string::npos) std::this_thread::sleep_for(1s);
    is_open_ = true;
    write("open " + (value ? std::to_string(*value).substr(0, 3) : "kept"));
    return {};
  }
  Result<void> set(double value) override {
    if (value == 9) return Error{Errc::io_failed, "cannot set", path_, "9 is too much", ""};
    if (value == 13) ::abort();
    if (is_mute()) return mute();
    if (::access((path_ + ".sluggish").c_str(), F_OK) == 0) std::this_thread::sleep_for(500ms);
    write("set " + std::to_string(value).substr(0, 3));
    return {};
  }

 private:
  bool is_mute() const { return ::access((path_ + ".mute").c_str(), F_OK) == 0; }
  Error mute() const {
    std::ofstream(path_ + ".tries", std::ios::app) << "tried" << std::endl;
    if (lock_ >= 0) std::this_thread::sleep_for(300ms);
    return {Errc::timed_out, "cannot set", path_, "it is mute", ""};
  }
  void write(const std::string& text) const { std::ofstream(path_, std::ios::app) << text << std::endl; }
  std::string path_;
  bool is_open_ = false;
  int lock_ = -1;
};

std::unique_ptr<Actuator> make_file(const std::string& path) {
  if (path.find("no-such") != std::string::npos) throw std::runtime_error("there is no " + path);
  return std::make_unique<FileActuator>(path);
}

std::vector<std::string> lines_of(const std::string& path) {
  std::ifstream file(path);
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);) lines.push_back(line);
  return lines;
}
/// Waits until it is the last line; returns for how long.
Duration wait_for(const std::string& path, const std::string& line) {
  const auto began = std::chrono::steady_clock::now();
  for (;;) {
    const auto lines = lines_of(path);
    const auto took = std::chrono::steady_clock::now() - began;
    if (!lines.empty() && lines.back() == line) return took;
    if (took > patience) {
      CHECK_MESSAGE(false, "never \"" << line << "\", but \"" << (lines.empty() ? "" : lines.back()) << "\"");
      return took;
    }
    std::this_thread::sleep_for(1ms);
  }
}

/// All its threads.
void wait_until_stopped(pid_t process) {
  const auto is_stopped = [&] {
    for (const auto& task : std::filesystem::directory_iterator("/proc/" + std::to_string(process) + "/task")) {
      std::ifstream file(task.path() / "stat");
      std::string line;
      if (!std::getline(file, line) || line.find(") T ") == std::string::npos) return false;
    }
    return true;
  };
  while (!is_stopped()) std::this_thread::sleep_for(1ms);
}

/// A program of its own, with an output that it sets to 1, and then does what it is told.
struct Program {
  enum class Does { turns, hangs, crashes, ends, is_killed_while_it_gives_back };
  explicit Program(const std::string& path, Does does = Does::turns) {
    process = ::fork();
    if (process != 0) return;
    for (const int fatal : {SIGSEGV, SIGABRT}) ::signal(fatal, SIG_DFL);
    {
      OutputGuard guard(make_file);
      Runtime runtime({.guard = &guard});
      Loop loop(runtime, {});
      be_quiet(loop);
      Output output(loop, {.name = "o", .watchdog = 200ms}, {}, path);
      output.set(1).or_throw();
      const Timer later(loop, 300ms, [&] {
        if (does == Does::hangs) std::this_thread::sleep_for(1min);
        if (does == Does::crashes) ::raise(SIGSEGV);
        if (does == Does::ends) ::_exit(0);  // without any destructor
        if (does == Does::is_killed_while_it_gives_back) output.finish([] {});
      });
      const Timer end(loop, 500ms, [&] {
        if (does == Does::is_killed_while_it_gives_back) ::raise(SIGKILL);
      });
      loop.run_for(1min);
    }
    ::_exit(0);
  }
  ~Program() {
    kill(SIGKILL);
    ::waitpid(process, nullptr, 0);
  }
  void kill(int number) const { ::kill(process, number); }
  pid_t process = -1;
};

struct Bench {
  ScratchDirectory directory;
  std::string path = directory.file("device");
  OutputGuard guard{make_file};
  Runtime runtime{{.guard = &guard}};
  Loop loop{runtime, {}};
  std::vector<std::string> errors, causes;
  Subscription seen;
  Output output;

  explicit Bench(OutputConfig config = {}, std::string device = {}) {
    if (!device.empty()) path = std::move(device);
    be_quiet(loop);
    loop.on_error([this](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.why);
    });
    seen = loop.subscribe<OutputChange>("o", [this](const Event<OutputChange>& event) {
      constexpr const char* names[] = {"start", "set",    "input",    "stale",   "lease",
                                       "arm",   "disarm", "watchdog", "failure", "stop"};
      causes.push_back(std::string(names[static_cast<int>(event->cause)]) + (event->done ? "" : " not done"));
    });
    config.name = "o";
    output = Output(
        loop, config, [this] { return make_file(path); }, path);
  }
  long count(const std::string& cause) const { return std::count(causes.begin(), causes.end(), cause); }
  /// Until the condition holds.
  template <class Condition>
  bool turn_until(const Condition& condition) {
    bool holds = false;
    const Ticker look(loop, 2ms, [&](const Tick&) {
      if ((holds = condition())) loop.stop();
    });
    const Timer limit(loop, patience, [&] { loop.stop(); });
    loop.run();
    return holds;
  }
};

using Lines = std::vector<std::string>;

}  // namespace

TEST_SUITE("outputs") {
  TEST_CASE("US-35 guard: it holds the device, says what it did, and hands it back safe") {
    Bench b;
    CHECK(b.output.is_guarded());
    CHECK(b.output.value() == 0);
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    b.output.set(9).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 0; }));
    b.output.close();
    CHECK(lines_of(b.path) == Lines{"open 0.0", "set 1.0", "gone", "open 0.0", "set 0.0", "gone"});
    CHECK(b.errors == Lines{"9 is too much"});
    CHECK(b.guard.process() > 0);
    CHECK(b.guard.process() != ::getpid());
  }

  TEST_CASE("US-35 guard: a device that cannot be taken is refused with its reason") {
    ScratchDirectory directory;
    OutputGuard guard(make_file);
    Runtime runtime({.guard = &guard});
    Loop loop(runtime, {});
    be_quiet(loop);
    for (const auto& [name, why] : {std::pair{"refused", "somebody has it"}, std::pair{"no-such", "there is no "}})
      CHECK_THROWS_WITH_AS(Output(loop, {.name = "o"}, {}, directory.file(name)), doctest::Contains(why), SetupError);
    Output good(loop, {.name = "o"}, {}, directory.file("good"));
    CHECK(good.value() == 0);
  }

  TEST_CASE("US-35 guard: a program that is killed, crashes or ends without a word leaves its output safe") {
    for (const auto does : {Program::Does::turns, Program::Does::crashes, Program::Does::ends}) {
      ScratchDirectory directory;
      const std::string path = directory.file("device");
      Program program(path, does);
      if (does == Program::Does::turns) {
        wait_for(path, "set 1.0");
        program.kill(SIGKILL);
      }
      const Duration took = wait_for(path, "gone");
      CHECK(lines_of(path) == Lines{"open 0.0", "set 1.0", "set 0.0", "gone"});
      MESSAGE("safe and given back after " << std::chrono::duration<double, std::milli>(took).count() << " ms");
    }
  }

  TEST_CASE("US-35 guard: a program that is stopped or hangs has a safe output after its watchdog") {
    for (const auto does : {Program::Does::turns, Program::Does::hangs}) {
      ScratchDirectory directory;
      const std::string path = directory.file("device");
      Program program(path, does);
      wait_for(path, "set 1.0");
      if (does == Program::Does::turns) program.kill(SIGSTOP);
      const Duration took = wait_for(path, "set 0.0");
      MESSAGE("safe after " << std::chrono::duration<double, std::milli>(took).count() << " ms");
      program.kill(SIGKILL);
      wait_for(path, "gone");
    }
  }

  TEST_CASE("US-35 guard: after its watchdog an output takes no value until it is armed, and says so") {
    Bench b({.watchdog = 100ms});
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    const Timer hang(b.loop, 0ms, [] { std::this_thread::sleep_for(500ms); });
    CHECK(b.turn_until([&] { return !b.output.is_armed(); }));
    CHECK(lines_of(b.path) == Lines{"open 0.0", "set 1.0", "set 0.0"});
    CHECK(b.output.value() == 0);
    CHECK(b.output.health() == Health::degraded);
    CHECK(b.errors == Lines{"the loop did not turn for 100 ms"});
    CHECK(b.output.set(1).error().code == Errc::not_permitted);
    b.output.arm("me").or_throw();
    CHECK(b.output.health() == Health::ok);
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    CHECK(b.causes == Lines{"start", "set", "watchdog", "set not done", "arm", "set"});
    CHECK(lines_of(b.path) == Lines{"open 0.0", "set 1.0", "set 0.0", "set 1.0"});
  }

  TEST_CASE(
      "US-35 guard: a safe value that the device did not take is not done, and is tried until it is, armed or not") {
    Bench b({.watchdog = 500ms});
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    std::ofstream(b.path + ".mute").flush();
    const Timer hang(b.loop, 0ms, [] { std::this_thread::sleep_for(1500ms); });
    CHECK(b.turn_until([&] { return b.count("failure not done") > 0; }));
    REQUIRE(b.causes.size() >= 4);
    b.causes.resize(4);
    CHECK(b.causes == Lines{"start", "set", "watchdog not done", "failure not done"});
    CHECK_FALSE(b.output.is_armed());
    CHECK_FALSE(b.output.value().has_value());
    CHECK(b.output.health() == Health::faulted);
    CHECK(b.errors == Lines{"the loop did not turn for 500 ms, and the device did not accept the value: it is mute"});
    b.output.arm("me").or_throw();
    CHECK(b.output.set(0).error().code == Errc::io_failed);
    // The guard goes on to try, more often than the program asks.
    const auto own_tries = [&] {
      return static_cast<long>(lines_of(b.path + ".tries").size()) - b.count("failure not done");
    };
    const long before = own_tries();
    CHECK(b.turn_until([&] { return own_tries() >= before + 5; }));
    CHECK(lines_of(b.path) == Lines{"open 0.0", "set 1.0", "gone"});
    CHECK(b.errors.size() == 1);
    std::filesystem::remove(b.path + ".mute");
    CHECK(b.turn_until([&] { return b.output.value() == 0; }));
    CHECK(b.output.health() == Health::ok);
    CHECK(lines_of(b.path)[3] == "open 0.0");
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    CHECK(lines_of(b.path).back() == "set 1.0");
  }

  TEST_CASE("US-35 guard: an output that had failed is well again when the guard has set it safe") {
    Bench b({.watchdog = 300ms});
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    std::ofstream(b.path + ".mute").flush();
    b.output.set(2).or_throw();
    CHECK(b.turn_until([&] { return b.count("failure not done") == 1; }));
    std::filesystem::remove(b.path + ".mute");
    const Timer hang(b.loop, 0ms, [] { std::this_thread::sleep_for(800ms); });
    CHECK(b.turn_until([&] { return b.count("watchdog") == 1; }));
    b.output.arm("me").or_throw();
    CHECK(b.output.health() == Health::ok);
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
  }

  TEST_CASE("US-35 guard: that it had to act is told also when the run ends in the turn that hung") {
    for (const bool is_mute : {false, true}) {
      Bench b({.watchdog = 100ms});
      b.output.set(1).or_throw();
      CHECK(b.turn_until([&] { return b.output.value() == 1; }));
      if (is_mute) std::ofstream(b.path + ".mute").flush();
      const Timer hang(b.loop, 0ms, [&] {
        std::this_thread::sleep_for(500ms);
        b.loop.stop();
      });
      b.loop.run();
      CHECK(b.loop.close(10s) == 0);
      const std::string not_done = is_mute ? " not done" : "";
      CHECK(b.causes == Lines{"start", "set", "watchdog" + not_done, "stop" + not_done});
      CHECK(b.errors ==
            (is_mute ? Lines{"the loop did not turn for 100 ms, and the device did not accept the value: it is mute",
                             "it is mute"}
                     : Lines{"the loop did not turn for 100 ms"}));
    }
  }

  TEST_CASE("US-35 guard: while that of a killed program tries to set a device safe, the next program waits for it") {
    ScratchDirectory directory;
    const std::string path = directory.file("locked");
    {
      Program program(path);
      wait_for(path, "set 1.0");
      std::ofstream(path + ".mute").flush();
    }
    while (lines_of(path + ".tries").size() < 2) std::this_thread::sleep_for(1ms);
    Bench b({}, path);
    CHECK(b.output.health() == Health::faulted);
    CHECK_FALSE(b.output.value().has_value());
    REQUIRE(b.errors.size() == 1);
    CHECK(b.errors[0].ends_with("; the guard of its earlier output still tries to set it safe"));
    std::filesystem::remove(path + ".mute");
    CHECK(b.turn_until([&] { return b.output.value() == 0; }));
    CHECK(b.output.health() == Health::ok);
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    CHECK(b.errors.size() == 1);
  }

  TEST_CASE("US-35 guard: that of a killed program goes on when somebody else has the device for a while") {
    ScratchDirectory directory;
    const std::string path = directory.file("locked"), tries = path + ".tries";
    {
      Program program(path);
      wait_for(path, "set 1.0");
      std::ofstream(path + ".mute").flush();
    }
    while (lines_of(tries).size() < 2) std::this_thread::sleep_for(1ms);
    const int lock = ::open((path + ".lock").c_str(), O_RDWR | O_CLOEXEC);
    while (::flock(lock, LOCK_EX | LOCK_NB) != 0) std::this_thread::sleep_for(1ms);  // between two of its tries
    std::this_thread::sleep_for(1s);
    const std::size_t before = lines_of(tries).size();
    ::close(lock);
    const auto began = std::chrono::steady_clock::now();
    while (lines_of(tries).size() == before && std::chrono::steady_clock::now() - began < patience)
      std::this_thread::sleep_for(1ms);
    CHECK(lines_of(tries).size() > before);
    std::filesystem::remove(path + ".mute");
    const auto is_safe = [&] {
      const auto lines = lines_of(path);
      return lines.size() > 2 && lines[lines.size() - 2] == "open 0.0" && lines.back() == "gone";
    };
    while (!is_safe() && std::chrono::steady_clock::now() - began < patience) std::this_thread::sleep_for(1ms);
    CHECK(is_safe());
  }

  TEST_CASE("US-35 guard: an output that ended unsafe is remembered, and one that is made anew takes its device over") {
    ScratchDirectory directory;
    Bench b({}, directory.file("locked"));
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    std::ofstream(b.path + ".mute").flush();
    b.output.close();
    CHECK(b.guard.ended_unsafe() == Lines{"output o"});
    Output again(b.loop, {.name = "o"}, {}, b.path);
    CHECK(again.health() == Health::faulted);
    CHECK(b.guard.ended_unsafe() == Lines{"output o"});
    std::filesystem::remove(b.path + ".mute");
    CHECK(b.turn_until([&] { return again.value() == 0; }));
    again.set(1).or_throw();
    CHECK(b.turn_until([&] { return again.value() == 1; }));
    again.close();
    CHECK(b.guard.ended_unsafe().empty());
    CHECK(lines_of(b.path).back() == "gone");
  }

  TEST_CASE("US-35 guard: an output that ended unsafe, and is safe later, is told in the log") {
    ScratchDirectory directory;
    Bench b({}, directory.file("device"));
    Lines log;
    b.runtime.on_log([&](const LogRecord& record) {
      if (record.text.find("safe value") != std::string_view::npos) log.push_back(std::string(record.text));
    });
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    std::ofstream(b.path + ".mute").flush();
    b.output.close();
    CHECK(b.guard.ended_unsafe() == Lines{"output o"});
    CHECK(b.turn_until([&] { return lines_of(b.path + ".tries").size() > 2; }));
    CHECK(log.empty());
    std::filesystem::remove(b.path + ".mute");
    CHECK(b.turn_until([&] { return !log.empty(); }));
    CHECK(log == Lines{"it has its safe value now"});
    CHECK(b.guard.ended_unsafe().empty());
    CHECK(lines_of(b.path).back() == "gone");
  }

  TEST_CASE("US-35 guard: that it tries no more is told: in the log, and on standard error when the program has gone") {
    ScratchDirectory directory;
    const std::string path = directory.file("device"), said = directory.file("said");
    const int standard = ::dup(STDERR_FILENO), file = ::open(said.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
    ::dup2(file, STDERR_FILENO);
    ::close(file);
    auto program = std::make_unique<Program>(path);
    ::dup2(standard, STDERR_FILENO);
    ::close(standard);
    wait_for(path, "set 1.0");
    std::ofstream(path + ".mute").flush();
    program.reset();  // killed
    Bench b({}, directory.file("other"));
    Lines log;
    b.runtime.on_log([&](const LogRecord& record) {
      if (record.text.find("safe value") != std::string_view::npos) log.push_back(std::string(record.text));
    });
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    std::ofstream(b.path + ".mute").flush();
    b.output.close();
    CHECK(b.turn_until([&] { return !log.empty(); }));
    const std::string
        text = "its device has not accepted the safe value for 10 s, and the guard no longer tries: it is mute";
    REQUIRE(log.size() == 1);
    CHECK(log[0] == text);
    CHECK(b.guard.ended_unsafe() == Lines{"output o"});
    CHECK(b.turn_until([&] { return !lines_of(said).empty(); }));
    CHECK(lines_of(said) == Lines{"rtdata-guard: output o: " + text});
  }

  TEST_CASE("US-35 guard: what an output of another program waits for is nothing to a device that somebody has") {
    ScratchDirectory directory;
    const std::string path = directory.file("locked");
    {
      Program program(path);
      wait_for(path, "set 1.0");
      std::ofstream(path + ".mute").flush();
    }
    while (lines_of(path + ".tries").size() < 2) std::this_thread::sleep_for(1ms);
    CHECK_THROWS_WITH_AS(Bench({}, directory.file("refused")), doctest::Contains("somebody has it"), SetupError);
    std::filesystem::remove(path + ".mute");
    wait_for(path, "gone");
  }

  TEST_CASE(
      "US-35 guard: a device that went away between two values is told, set safe when it is back, and set again") {
    ScratchDirectory directory;
    const std::string line = directory.file("line");
    auto device = std::make_unique<outputs_test::Terminal>();
    std::filesystem::create_symlink(device->name, line);
    OutputGuard guard([line](const std::string&) {
      return std::make_unique<SerialActuator>(SerialActuatorConfig{.device = line, .text = "V{value}\n"});
    });
    Runtime runtime({.guard = &guard});
    Loop loop(runtime, {});
    be_quiet(loop);
    outputs_test::OutputLog log(loop, "o");
    Output output(loop, {.name = "o"}, {}, "line");
    output.set(1).or_throw();
    const auto turn_until = [&](const std::function<bool()>& condition) {
      const Ticker look(loop, 2ms, [&](const Tick&) {
        if (condition()) loop.stop();
      });
      const Timer limit(loop, patience, [&] { loop.stop(); });
      loop.run();
      return condition();
    };
    CHECK(turn_until([&] { return output.value() == 1; }));
    CHECK(device->reads("V1\n"));
    std::filesystem::remove(line);
    device.reset();  // unplugged
    CHECK(turn_until([&] { return log.lines.size() >= 4; }));
    CHECK(log.lines[2] == "failure 0 failed: the device is gone");
    CHECK(output.health() == Health::faulted);
    CHECK_FALSE(output.value().has_value());
    CHECK(output.set(1).error().code == Errc::io_failed);
    device = std::make_unique<outputs_test::Terminal>();
    std::filesystem::create_symlink(device->name, line);
    CHECK(turn_until([&] { return output.value() == 0; }));
    CHECK(output.health() == Health::ok);
    output.set(1).or_throw();
    CHECK(turn_until([&] { return output.value() == 1; }));
    CHECK(device->reads("V0\nV1\n"));
  }

  TEST_CASE("US-35 US-36 guard: a GPIO chip that goes away is noticed, and its line is safe when it is back") {
    ScratchDirectory directory;
    const std::string gone = directory.file("gone"), levels = directory.file("levels");
    auto chips = std::make_shared<FakeGpio>();
    chips->add_chip("gpiochip0", 8);
    OutputGuard guard([=](const std::string&) -> std::unique_ptr<Actuator> {
      /// In the guard: the chip is away while there is the file.
      class Line final : public GpioActuator {
       public:
        Line(std::shared_ptr<FakeGpio> its_chips, std::string its_gone, std::string its_levels)
            : GpioActuator({.line = 3}, its_chips), chips_(its_chips), gone_(its_gone), levels_(its_levels) {}
        Result<void> open(std::optional<double> value) override { return look(), told(GpioActuator::open(value)); }
        Result<void> set(double value) override { return look(), told(GpioActuator::set(value)); }
        Result<void> check() override { return look(), GpioActuator::check(); }

       private:
        void look() {
          const bool is_gone = std::filesystem::exists(gone_), was_gone = chips_->chips().empty();
          if (is_gone && !was_gone) chips_->unplug("gpiochip0");
          if (!is_gone && was_gone) chips_->plug_in("gpiochip0");
        }
        Result<void> told(Result<void> result) {
          if (result) std::ofstream(levels_, std::ios::app) << chips_->level("gpiochip0", 3) << std::endl;
          return result;
        }
        std::shared_ptr<FakeGpio> chips_;
        std::string gone_, levels_;
      };
      return std::make_unique<Line>(chips, gone, levels);
    });
    Runtime runtime({.guard = &guard});
    Loop loop(runtime, {});
    be_quiet(loop);
    outputs_test::OutputLog log(loop, "o");
    Output output(loop, {.name = "o"}, {}, "line");
    const auto turn_until = [&](const std::function<bool()>& condition) {
      const Ticker look(loop, 2ms, [&](const Tick&) {
        if (condition()) loop.stop();
      });
      const Timer limit(loop, patience, [&] { loop.stop(); });
      loop.run();
      return condition();
    };
    output.set(1).or_throw();
    CHECK(turn_until([&] { return output.value() == 1; }));
    std::ofstream(gone).flush();
    CHECK(turn_until([&] { return output.health() == Health::faulted; }));
    CHECK(turn_until([&] { return log.lines.size() >= 3; }));
    CHECK(log.lines[2] == "failure 0 failed: the chip is gone");
    CHECK_FALSE(output.value().has_value());
    std::filesystem::remove(gone);
    CHECK(turn_until([&] { return output.value() == 0; }));
    CHECK(output.health() == Health::ok);
    output.set(1).or_throw();
    CHECK(turn_until([&] { return output.value() == 1; }));
    output.close();
    CHECK(lines_of(levels) == Lines{"0", "1", "0", "1", "0"});
  }

  TEST_CASE("US-35 guard: a loop that turns keeps its output for much longer than the watchdog") {
    Bench b({.watchdog = 400ms});
    b.output.set(1).or_throw();
    b.loop.run_for(2s);
    CHECK(b.output.value() == 1);
    CHECK(b.causes == Lines{"start", "set"});
  }

  TEST_CASE(
      "US-35 guard: a slow device is given back while the loop turns, and one is taken; others keep their values") {
    OutputConfig config;
    config.watchdog = 200ms;
    Bench b(config);
    const std::string other_path = b.directory.file("other");
    Output other(b.loop, {.name = "other", .watchdog = 200ms}, {}, other_path);
    for (Output* output : {&b.output, &other}) output->set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1 && other.value() == 1; }));
    std::ofstream(b.path + ".sluggish") << "";
    bool is_done = false, is_taken = false;
    int turns = 0;  // while the device is being given back
    const Ticker ticker(b.loop, 10ms, [&](const Tick&) { turns += is_done ? 0 : 1; });
    b.output.finish([&] { is_done = true; });
    CHECK_FALSE(b.output.value() == 0);
    CHECK(b.turn_until([&] { return is_done; }));
    CHECK(turns > 0);
    CHECK(lines_of(b.path) == Lines{"open 0.0", "set 1.0", "set 0.0", "gone"});
    CHECK_FALSE(b.output.has_ended_unsafe());
    CHECK(b.guard.ended_unsafe().empty());

    const std::string slow_path = b.directory.file("slow");
    Output slow(b.loop, {.name = "slow"}, {}, slow_path, Output::Takes::later);
    CHECK(slow.set(1).has_value());
    slow.when_taken([&](Result<void> result) { is_taken = result.has_value(); });
    CHECK(lines_of(slow_path).empty());
    CHECK(b.turn_until([&] { return slow.value() == 1; }));
    CHECK(is_taken);
    CHECK(lines_of(slow_path) == Lines{"open 0.0", "set 1.0"});

    const std::string refused_path = b.directory.file("refused");
    Output refused(b.loop, {.name = "refused"}, {}, refused_path, Output::Takes::later);
    std::string why;
    refused.when_taken([&](Result<void> result) { why = result ? "taken" : result.error().why; });
    CHECK(b.turn_until([&] { return !why.empty(); }));
    CHECK(why == "somebody has it");
    CHECK(refused.set(1).error().code == Errc::closed);
    refused.close();

    CHECK(other.is_armed());
    CHECK(other.value() == 1);
    CHECK(lines_of(other_path) == Lines{"open 0.0", "set 1.0"});
    CHECK(b.count("watchdog") == 0);
  }

  TEST_CASE("US-35 guard: a program that is killed while it gives a slow device back leaves that safe") {
    ScratchDirectory directory;
    const std::string path = directory.file("device");
    std::ofstream(path + ".sluggish") << "";
    const Program program(path, Program::Does::is_killed_while_it_gives_back);
    wait_for(path, "gone");
    CHECK(lines_of(path) == Lines{"open 0.0", "set 1.0", "set 0.0", "gone"});
  }

  TEST_CASE(
      "US-35 guard: one that does not answer when a device is given back is told, and what comes of it later, too") {
    Bench b;
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    ::kill(b.guard.process(), SIGSTOP);
    wait_until_stopped(b.guard.process());
    bool is_done = false;
    b.output.finish([&] { is_done = true; });
    CHECK(b.turn_until([&] { return is_done; }));
    CHECK(b.errors == Lines{"its guard does not answer"});
    CHECK(b.output.has_ended_unsafe());
    CHECK(b.guard.ended_unsafe() == Lines{"output o"});
    ::kill(b.guard.process(), SIGCONT);
    wait_for(b.path, "gone");
    CHECK(b.turn_until([&] { return b.guard.ended_unsafe().empty(); }));
    CHECK(lines_of(b.path) == Lines{"open 0.0", "set 1.0", "set 0.0", "gone"});
  }

  TEST_CASE("US-35 guard: an output keeps its value while the loop waits for the device of another") {
    OutputConfig config;
    config.watchdog = 200ms;
    Bench b(config);
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    Output slow(b.loop, {.name = "slow"}, {}, b.directory.file("slow"));  // for a second
    CHECK(b.turn_until([&] { return slow.value() == 0; }));
    CHECK(b.output.is_armed());
    CHECK(b.output.value() == 1);
    CHECK(b.count("watchdog") == 0);
    CHECK(lines_of(b.path) == Lines{"open 0.0", "set 1.0"});
  }

  TEST_CASE(
      "US-35 guard: an output keeps its value while the loop waits for a disk, as when a reload closes a recording") {
    struct SlowDisk final : Writer {
      Result<void> open() override { return {}; }
      Result<void> write(Batch&) override { return {}; }
      Result<void> close() override {
        std::this_thread::sleep_for(1s);
        return {};
      }
    };
    OutputConfig config;
    config.watchdog = 200ms;
    Bench b(config);
    Sink sink(b.loop, {.name = "disk", .topics = {"#"}}, std::make_unique<SlowDisk>());
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    sink.close();  // waits
    b.loop.run_for(300ms);
    CHECK(b.output.is_armed());
    CHECK(b.output.value() == 1);
    CHECK(b.count("watchdog") == 0);
    CHECK(lines_of(b.path) == Lines{"open 0.0", "set 1.0"});
  }

  TEST_CASE("US-35 guard: when it is killed the program takes the device, sets it safe, and stays so") {
    for (const bool crashes : {false, true}) {
      Bench b;
      b.output.set(1).or_throw();
      CHECK(b.turn_until([&] { return b.output.value() == 1; }));
      if (crashes)
        b.output.set(13).or_throw();
      else
        ::kill(b.guard.process(), SIGKILL);
      CHECK(b.turn_until([&] { return !b.output.is_guarded() && b.output.value() == 0; }));
      CHECK(lines_of(b.path) == Lines{"open 0.0", "set 1.0", "open 0.0"});
      CHECK(b.output.health() == Health::faulted);
      CHECK_FALSE(b.output.is_armed());
      CHECK(b.output.arm("me").error().code == Errc::disconnected);
      CHECK(b.errors == Lines{"its guard has ended"});
      b.output.close();
      CHECK(lines_of(b.path).back() == "gone");
      // One that is made now, as by a reload, is held safe by the program.
      const std::string path = b.directory.file("later");
      Output later(
          b.loop, {.name = "later"}, [&] { return make_file(path); }, path);
      CHECK(later.value() == 0);
      CHECK_FALSE(later.is_armed());
      CHECK(later.health() == Health::faulted);
      CHECK(later.set(1).error().code == Errc::not_permitted);
      CHECK(lines_of(path) == Lines{"open 0.0"});
    }
  }

  TEST_CASE("US-35 guard: one that is stopped while an output is not safe is told of") {
    Bench b({.watchdog = 50ms});
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    ::kill(b.guard.process(), SIGSTOP);
    CHECK(b.turn_until([&] { return !b.errors.empty(); }));
    CHECK(b.errors == Lines{"its guard does not run"});
    CHECK(b.output.health() == Health::faulted);
    ::kill(b.guard.process(), SIGCONT);
  }

  TEST_CASE("US-35 guard: it ignores what terminals and service managers send to all") {
    Bench b;
    // The last one is what a service manager's watchdog sends to all processes of a service.
    for (const int number : {SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGABRT}) ::kill(b.guard.process(), number);
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
  }

  TEST_CASE("US-35 guard: a program that is aborted together with its guard leaves its output safe") {
    ScratchDirectory directory;
    const std::string path = directory.file("device");
    Program program(path);
    wait_for(path, "set 1.0");
    const std::string parent = " " + std::to_string(program.process) + " ";
    for (const auto& process : std::filesystem::directory_iterator("/proc")) {
      std::ifstream file(process.path() / "stat");
      std::string line;
      if (!std::getline(file, line) || line.find("(rtdata-guard)") == std::string::npos) continue;
      if (line.substr(line.rfind(')')).find(parent) != std::string::npos)
        ::kill(std::stoi(process.path().filename()), SIGABRT);
    }
    program.kill(SIGABRT);
    wait_for(path, "gone");
    CHECK(lines_of(path) == Lines{"open 0.0", "set 1.0", "set 0.0", "gone"});
  }

  TEST_CASE("US-35 guard: a hang disarms what is armed, though it has its safe value") {
    for (const Arming armed : {Arming::at_start, Arming::by_command}) {
      Bench b({.watchdog = 200ms, .armed = armed});
      if (armed == Arming::by_command) b.output.arm("me").or_throw();
      b.loop.run_for(100ms);
      const Timer hang(b.loop, 0ms, [] { std::this_thread::sleep_for(1s); });
      CHECK(b.turn_until([&] { return !b.output.is_armed(); }));
      CHECK(b.output.set(1).error().code == Errc::not_permitted);
      CHECK(b.errors == Lines{"the loop did not turn for 200 ms"});
      CHECK(lines_of(b.path) == Lines{"open 0.0"});
      b.output.arm("me").or_throw();
      b.output.set(1).or_throw();
      CHECK(b.turn_until([&] { return b.output.value() == 1; }));
      // What is disarmed has nothing to lose.
      b.output.disarm("me").or_throw();
      CHECK(b.turn_until([&] { return b.output.value() == 0; }));
      const long trips = b.count("watchdog");
      const Timer again(b.loop, 0ms, [] { std::this_thread::sleep_for(1s); });
      b.loop.run_for(500ms);
      CHECK(b.count("watchdog") == trips);
    }
  }

  TEST_CASE("US-35 guard: what takes long before the loop turns disarms nothing") {
    Bench b({.watchdog = 100ms});
    std::this_thread::sleep_for(500ms);
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    CHECK(b.output.is_armed());
  }

  TEST_CASE("US-35 guard: a program that is about to end has safe outputs, which take nothing more") {
    Bench b({.watchdog = 200ms});
    b.output.set(1).or_throw();
    CHECK(b.turn_until([&] { return b.output.value() == 1; }));
    b.guard.make_all_safe();
    CHECK(b.turn_until([&] { return b.output.value() == 0; }));
    CHECK(b.output.set(1).error().code == Errc::closed);
    CHECK(b.output.arm("me").error().code == Errc::closed);
    b.output.close();
    b.loop.poll();
    CHECK(lines_of(b.path) == Lines{"open 0.0", "set 1.0", "set 0.0", "set 0.0", "gone"});
    CHECK(b.count("stop") == 1);
  }

  TEST_CASE("US-35 guard: SIGTERM makes all outputs safe and ends a program whose main loop hangs") {
    if (test::thread_sanitized) {
      MESSAGE("skipped: the thread sanitizer ends a guard whose program was forked by one with threads");
      return;
    }
    ScratchDirectory directory;
    const std::string main_device = directory.file("main"), tier_device = directory.file("tier");
    const pid_t process = sinks::fork_without_threads();
    if (process == 0) try {
        app::StopSignals signals;
        OutputGuard guard(make_file);
        Runtime runtime({.guard = &guard});
        Loop loop(runtime, {});
        be_quiet(loop);
        Tier tier(loop, {.name = "fast"});
        const Output here(loop, {.name = "here", .watchdog = 1h}, {}, main_device);
        Output there(tier.loop(), {.name = "there", .watchdog = 1s}, {}, tier_device);
        const Ticker sets(tier.loop(), 10ms, [&](const Tick&) { (void)there.set(1); });
        signals.attach(loop, {[&](const char*) { loop.stop(); }, [] { return std::uint64_t{0}; },
                              [](const char*, std::optional<std::uint64_t>) { ::_exit(2); }, [] {},
                              [&] { guard.make_all_safe(); }, [](const char*) { ::_exit(7); }});
        const Timer hangs(loop, 100ms, [&] {
          std::ofstream(directory.file("hangs")) << "yes" << std::endl;
          std::this_thread::sleep_for(1h);
        });
        loop.run();
        ::_exit(3);
      } catch (const std::exception& e) {
        std::fprintf(stderr, "%s\n", e.what());
        ::_exit(4);
      }
    wait_for(directory.file("hangs"), "yes");
    wait_for(tier_device, "set 1.0");
    ::kill(process, SIGTERM);
    int status = 0;
    REQUIRE(::waitpid(process, &status, 0) == process);
    CHECK(WIFEXITED(status));
    CHECK(WEXITSTATUS(status) == 7);
    wait_for(tier_device, "gone");
    // By its own loop, before the guard saw that the program had gone.
    CHECK(lines_of(tier_device) == Lines{"open 0.0", "set 1.0", "set 0.0", "gone"});
  }

  TEST_CASE("US-35 guard: an output that is made anew again and again takes no more memory") {
    ScratchDirectory directory;
    OutputGuard guard(make_file);
    Runtime runtime({.guard = &guard});
    Loop loop(runtime, {});
    be_quiet(loop);
    const auto megabytes = [&] {  // of address space
      std::ifstream file("/proc/" + std::to_string(guard.process()) + "/statm");
      std::size_t pages = 0;
      file >> pages;
      return pages * static_cast<std::size_t>(::sysconf(_SC_PAGESIZE)) / 1'000'000;
    };
    const auto make = [&](int count) {
      for (int i = 0; i < count; ++i) Output(loop, {.name = "o"}, {}, directory.file("device")).close();
    };
    make(20);
    const std::size_t before = megabytes();
    make(100);
    CHECK(megabytes() < before + 200);  // a stack each: 800
  }

  TEST_CASE("US-35 guard: many outputs, made and closed again and again") {
    ScratchDirectory directory;
    OutputGuard guard(make_file);
    Runtime runtime({.guard = &guard});
    Loop loop(runtime, {});
    be_quiet(loop);
    std::vector<std::string> paths;
    for (int i = 0; i < 20; ++i) paths.push_back(directory.file("device" + std::to_string(i)));
    for (int round = 0; round < 3; ++round) {
      std::vector<Output> outputs;
      for (int i = 0; i < 20; ++i)
        outputs.emplace_back(loop, OutputConfig{.name = "o" + std::to_string(i)}, MakeActuator{},
                             paths[static_cast<std::size_t>(i)]);
      for (Output& output : outputs) output.set(1).or_throw();
      loop.run_for(20ms);
    }
    for (const std::string& path : paths) {
      Lines expected;
      for (int round = 0; round < 3; ++round)
        expected.insert(expected.end(), {"open 0.0", "set 1.0", "set 0.0", "gone"});
      CHECK(lines_of(path) == expected);
    }
  }
}
