// A program that the system gives too few threads, or too few descriptors.
#include <doctest/doctest.h>
#include <sys/stat.h>
#include <unistd.h>

#include "app/process.hpp"
#include "paths.hpp"

using rtdata::test::Folder;
using rtdata::test::Process;

TEST_SUITE("app") {
  TEST_CASE(
      "NFR-7 whatever number of threads the system gives: events that are not stored are told, and nothing is silent") {
    constexpr const char* setpriv = "/usr/bin/setpriv";
    if (::geteuid() != 0 || ::access(setpriv, X_OK) != 0 || ::access("/usr/bin/prlimit", X_OK) != 0) {
      MESSAGE("skipped: limits of threads bind no process of root, and becoming another user takes root and setpriv");
      return;
    }
    int without_sink = 0, whole = 0;
    for (int threads = 1; threads <= 12; ++threads) {
      CAPTURE(threads);
      const Folder folder;
      REQUIRE(::chmod(folder.path().c_str(), 0777) == 0);
      folder.write("few.json", R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "20 Hz"}],
                                   "sinks": [{"type": "file", "path": "few.jsonl"},
                                             {"type": "file", "path": "few.csv", "format": "csv", "close_deadline": "1 s"}]})");
      // A user of its own, so that nothing else counts.
      const std::string user = "--reuid=" + std::to_string(61000 + (::getpid() % 500) * 10 + threads % 10);
      Process run(folder, setpriv,
                  {user, "--clear-groups", "/usr/bin/prlimit", "--nproc=" + std::to_string(threads),
                   rtdata::test::built("rtdata"), "run", "few.json", "--for", "600ms", "--fail-on-loss"});
      const int status = run.end();
      const std::string lines = folder.read("few.jsonl");
      const auto says = [&](const char* words) { return (run.err + run.out).find(words) != std::string::npos; };
      const bool is_reported = says("the system gives no thread");
      if (status == 0) {
        ++whole;
        CHECK_FALSE(lines.empty());
        CHECK_FALSE(is_reported);
        break;
      }
      CAPTURE(run.err);
      CHECK(is_reported);
      CHECK(says("ulimit -u"));
      CHECK(says("TasksMax="));
      CHECK(says("ulimit -v"));
      const bool is_of_sink = says("cannot store");
      without_sink += is_of_sink ? 1 : 0;
      if (is_of_sink) CHECK(run.err.find(" events") != std::string::npos);  // that were lost, or wait
    }
    CHECK(whole == 1);
    CHECK(without_sink > 0);
  }

  TEST_CASE("NFR-7 whatever number of descriptors the system gives: the program ends, and says what it did not get") {
    constexpr const char* prlimit = "/usr/bin/prlimit";
    if (::access(prlimit, X_OK) != 0) {
      MESSAGE("skipped: it takes prlimit");
      return;
    }
    int refused = 0, whole = 0;
    for (int files = 3; files <= 60 && whole == 0; files += files < 24 ? 1 : 4) {
      CAPTURE(files);
      const Folder folder;
      folder.write("few.json", R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "20 Hz"}],
                                   "sinks": [{"type": "file", "path": "few.jsonl"}]})");
      Process run(folder, prlimit,
                  {"--nofile=" + std::to_string(files), rtdata::test::built("rtdata"), "run", "few.json", "--for",
                   "100ms", "--fail-on-loss"});
      const int status = run.end();
      CAPTURE(run.err);
      // UBSan asks by means of a pipe whether there is memory at an address. Without descriptors it finds none, so that
      // it takes every object with virtual functions for a wrong one. With enough of them it does not.
      if (run.err.find("UndefinedBehaviorSanitizer") != std::string::npos) {
        ++refused;
        continue;
      }
      CHECK(status >= 0);   // it ended by itself
      CHECK(status < 128);  // and not by a signal
      const std::string said = run.err + run.out;
      const bool is_reported = said.find("oo many open files") != std::string::npos ||
                               said.find("shared object") !=
                                   std::string::npos;  // of the loader: the program did not begin
      if (status == 0) ++whole;
      if (status != 0) {
        ++refused;
        CHECK(is_reported);
      }
    }
    CHECK(whole == 1);
    CHECK(refused > 3);
  }

  TEST_CASE("NFR-7 each of the signals that ask for an end is heard, without a descriptor") {
    const Folder folder;
    folder.write("few.json", R"({"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "20 Hz"}]})");
    for (const int signal : {SIGTERM, SIGINT}) {
      CAPTURE(signal);
      Process run(folder, rtdata::test::built("rtdata"), {"run", "few.json"});
      REQUIRE(run.wait_for("running few"));
      run.signal(signal);
      CHECK(run.end() == 0);
      CHECK(run.err.find("stopping on SIG") != std::string::npos);
    }
  }
}
