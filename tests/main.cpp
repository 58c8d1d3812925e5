#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <doctest/doctest.h>

#include <iostream>

#include "app/process.hpp"

namespace {

/// Shows what the programs of a test have written, with the first of its checks that fails.
struct ProcessOutput : doctest::IReporter {
  explicit ProcessOutput(const doctest::ContextOptions&) {}
  void log_assert(const doctest::AssertData& checked) override {
    if (!checked.m_failed || has_shown_) return;
    has_shown_ = true;
    std::cout << rtdata::test::Process::all_output();
  }
  void test_case_start(const doctest::TestCaseData&) override { has_shown_ = false; }
  void report_query(const doctest::QueryData&) override {}
  void test_run_start() override {}
  void test_run_end(const doctest::TestRunStats&) override {}
  void test_case_reenter(const doctest::TestCaseData&) override {}
  void test_case_end(const doctest::CurrentTestCaseStats&) override {}
  void test_case_exception(const doctest::TestCaseException&) override {}
  void subcase_start(const doctest::SubcaseSignature&) override {}
  void subcase_end() override {}
  void log_message(const doctest::MessageData&) override {}
  void test_case_skipped(const doctest::TestCaseData&) override {}

 private:
  bool has_shown_ = false;
};

REGISTER_LISTENER("process_output", 0, ProcessOutput);

}  // namespace
