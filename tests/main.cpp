#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <doctest/doctest.h>
#include <sys/resource.h>

#include <chrono>
#include <cstdint>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <string>

#include "app/process.hpp"

namespace {

struct Reporter : doctest::IReporter {
  void report_query(const doctest::QueryData&) override {}
  void test_run_start() override {}
  void test_run_end(const doctest::TestRunStats&) override {}
  void test_case_start(const doctest::TestCaseData&) override {}
  void test_case_reenter(const doctest::TestCaseData&) override {}
  void test_case_end(const doctest::CurrentTestCaseStats&) override {}
  void test_case_exception(const doctest::TestCaseException&) override {}
  void subcase_start(const doctest::SubcaseSignature&) override {}
  void subcase_end() override {}
  void log_assert(const doctest::AssertData&) override {}
  void log_message(const doctest::MessageData&) override {}
  void test_case_skipped(const doctest::TestCaseData&) override {}
};

/// Shows what the programs of a test have written, with the first of its checks that fails.
struct ProcessOutput final : Reporter {
  explicit ProcessOutput(const doctest::ContextOptions&) {}
  void log_assert(const doctest::AssertData& checked) override {
    if (!checked.m_failed || has_shown_) return;
    has_shown_ = true;
    std::cout << rtdata::test::Process::all_output();
  }
  void test_case_start(const doctest::TestCaseData&) override { has_shown_ = false; }

 private:
  bool has_shown_ = false;
};

REGISTER_LISTENER("process_output", 0, ProcessOutput);

/// A line for each test: the seconds in which its thread slept and no program that it has started computed, those that
/// it took, file and title. Of a busy machine, waiting for a processor is left out where it is the test's own thread
/// that waits.
struct Waits final : Reporter {
  explicit Waits(const doctest::ContextOptions&) {}
  void test_case_start(const doctest::TestCaseData& test) override {
    test_ = &test;
    busy_ = busy();
    began_ = std::chrono::steady_clock::now();
  }
  void test_case_end(const doctest::CurrentTestCaseStats&) override {
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - began_;
    const std::string file = test_->m_file.c_str();
    std::cout << std::fixed << std::setprecision(1) << std::setw(7) << took.count() - (busy() - busy_) << std::setw(7)
              << took.count() << "  " << file.substr(file.rfind('/') + 1) << ": " << test_->m_name << std::endl;
  }

 private:
  /// Seconds that this thread has computed or waited for a processor, and that programs which have ended have computed.
  static double busy() {
    std::uint64_t computed = 0, queued = 0;
    std::ifstream("/proc/thread-self/schedstat") >> computed >> queued;
    rusage programs{};
    ::getrusage(RUSAGE_CHILDREN, &programs);
    const auto seconds = [](const timeval& time) {
      return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_usec) / 1e6;
    };
    return static_cast<double>(computed + queued) / 1e9 + seconds(programs.ru_utime) + seconds(programs.ru_stime);
  }
  const doctest::TestCaseData* test_ = nullptr;
  double busy_ = 0;
  std::chrono::steady_clock::time_point began_;
};

REGISTER_REPORTER("waits", 0, Waits);

}  // namespace
