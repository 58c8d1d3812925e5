// A sink that goes through a recording, run from a configuration, over kills and starts; and `rtdata forward`.
#include <doctest/doctest.h>
#include <fcntl.h>
#include <linux/magic.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "app/process.hpp"
#include "app/run/data_at_risk.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "rtdata/app/program.hpp"
#include "rtdata/recording/recording.hpp"

using namespace rtdata;
using test::Folder;
using test::Process;

namespace {

using rtdata::test::program;

// The peer is a file: while somebody else has its lock, it cannot be written.
constexpr const char* configuration = R"({
  "name": "node",
  "sensors": [{"name": "cpu", "type": "host", "quantity": "cpu", "rate": "100 Hz", "topic": "host/cpu"}],
  "sinks": [
    {"name": "recording", "type": "sqlite", "path": "node.db", "batch_time": "50 ms"},
    {"name": "copy", "type": "file", "path": "copy.jsonl", "format": "json", "through": "recording",
     "retry_first": "10 ms", "retry_longest": "50 ms"}
  ]
})";

/// While it lives, the peer is away.
class Away {
 public:
  explicit Away(const Folder& folder)
      : fd_(::open((folder.path() + "/copy.jsonl").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644)) {
    REQUIRE(::flock(fd_, LOCK_EX) == 0);
  }
  Away(const Away&) = delete;
  ~Away() { ::close(fd_); }

 private:
  int fd_;
};

/// The lines of the file, and of those that the starts before it wrote.
std::vector<std::string> all_lines_of(const std::filesystem::path& path) {
  std::vector<std::string> lines;
  for (const auto& entry : std::filesystem::directory_iterator(path.parent_path())) {
    const std::filesystem::path& there = entry.path();
    if (there != path && !there.filename().string().starts_with(path.stem().string() + "-0000")) continue;
    std::ifstream file(there);
    for (std::string line; std::getline(file, line);) lines.push_back(line);
  }
  return lines;
}

std::size_t lines_of(const std::filesystem::path& path) { return all_lines_of(path).size(); }

std::size_t rows_of(const std::string& path) {
  auto rows = Recording::open(path).or_throw().rows({}).or_throw();
  std::size_t count = 0;
  while (rows.next().or_throw() != nullptr) ++count;
  return count;
}

using rtdata::test::has;

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-32 forward sends with the sinks of the recording, where a configuration has two") {
    const Folder folder;
    const auto sinks = [](const std::string& first, const std::string& more) {
      return R"({"name": "node",
  "sensors": [{"name": "cpu", "type": "host", "quantity": "cpu", "rate": "100 Hz", "topic": "host/cpu"}],
  "sinks": [{"name": "one", "type": "sqlite", "path": "one.db"},
            {"name": ")" +
             first + R"(", "type": "file", "path": "copy.jsonl", "format": "json", "through": "one"},
            {"name": "two", "type": "sqlite", "path": "two.db"},
            {"name": "b", "type": "file", "path": "b.jsonl", "format": "json", "through": "two")" +
             more + "}]}";
    };
    folder.write("node.json", sinks("a", ""));
    {
      const Away away(folder);
      Process node(folder, program, {"run", "node.json", "--for", "500ms"});
      CHECK(node.end() == 0);
    }
    REQUIRE(lines_of(folder.path() + "/copy.jsonl") == 0);
    const std::size_t sent = lines_of(folder.path() + "/b.jsonl");
    std::filesystem::create_directory(folder.path() + "/home");
    std::filesystem::rename(folder.path() + "/one.db", folder.path() + "/home/x.db");
    const std::string home = folder.path() + "/home";
    {
      Process forward(folder, program, {"forward", "home/x.db", "node.json"});
      CHECK(forward.end() == 0);
      CHECK_MESSAGE(has(forward.out, "all is sent"), (forward.out + forward.err));
    }
    CHECK(lines_of(folder.path() + "/copy.jsonl") == rows_of(home + "/x.db"));
    CHECK(lines_of(folder.path() + "/b.jsonl") == sent);
    CHECK_FALSE(std::filesystem::exists(folder.path() + "/one.db"));
    // A mistake is shown at its place in the file.
    folder.write("bad.json", sinks(R"(a", "topics": "x)", ""));
    {
      Process forward(folder, program, {"forward", "home/x.db", "bad.json"});
      CHECK(forward.end() == 2);
      CHECK_MESSAGE(has(forward.err, "bad.json:4:"), forward.err);
    }
    // Sinks that the recording does not know, and another name of the file: it cannot be told.
    std::filesystem::copy(folder.path() + "/two.db", home + "/y.db");
    folder.write("other.json", R"({"sinks": [{"name": "one", "type": "sqlite", "path": "one.db"},
      {"name": "c", "type": "file", "path": "c.jsonl", "format": "json", "through": "one"},
      {"name": "two", "type": "sqlite", "path": "two.db"},
      {"name": "d", "type": "file", "path": "d.jsonl", "format": "json", "through": "two"}]})");
    {
      Process forward(folder, program, {"forward", "home/y.db", "other.json"});
      CHECK(forward.end() == 2);
      CHECK_MESSAGE(has(forward.err, "\"one\" \"two\"; it is not known which of these home/y.db is"), forward.err);
    }
  }

  TEST_CASE("US-32 what waits in a recording is sent at the next start, and a recording that was moved by forward") {
    const Folder folder;
    folder.write("node.json", configuration);
    {
      const Away away(folder);
      Process run(folder, program, {"run", "node.json", "--for", "400ms"});
      CHECK(run.end() == 0);
      CHECK_MESSAGE(has(run.out, "wait in a recording to be sent"), run.out);
      CHECK_MESSAGE(has(run.out, "wait, the oldest for"), run.out);
      const std::size_t waits = rows_of(folder.path() + "/node.db");
      Process info(folder, program, {"info", "node.db"});
      CHECK(info.end() == 0);
      CHECK_MESSAGE(has(info.out, "sinks that go through this recording\n  copy of "), info.out);
      CHECK_MESSAGE(has(info.out, ": " + std::to_string(waits) + " events ("), info.out);
      Process json(folder, program, {"info", "node.db", "--json"});
      CHECK(json.end() == 0);
      const auto backlogs = nlohmann::json::parse(json.out).at("backlogs");
      REQUIRE(backlogs.size() == 1);
      CHECK(backlogs[0]["sink"] == "copy");
      CHECK(backlogs[0]["events"] == waits);
      CHECK(backlogs[0]["oldest"].is_number());
      CHECK(backlogs[0]["refused"] == 0);
      CHECK_MESSAGE(has(run.out, "ledger balances"), run.out);
    }
    {
      Process run(folder, program, {"run", "node.json", "--for", "400ms"});
      CHECK(run.end() == 0);
      CHECK_MESSAGE(!has(run.out, "wait in a recording"), run.out);
      Process info(folder, program, {"info", "node.db"});
      CHECK(info.end() == 0);
      CHECK_MESSAGE(has(info.out, ": nothing waits\n"), info.out);
    }
    const std::size_t rows = rows_of(folder.path() + "/node.db");
    CHECK(rows > 20);
    CHECK(lines_of(folder.path() + "/copy.jsonl") == rows);
    // Once more, without a peer; then the recording is taken elsewhere.
    {
      const Away away(folder);
      Process run(folder, program, {"run", "node.json", "--for", "300ms"});
      CHECK(run.end() == 0);
    }
    std::filesystem::create_directories(folder.path() + "/home");
    std::filesystem::rename(folder.path() + "/node.db", folder.path() + "/home/moved.db");
    // The folders and devices of the node are not there.
    std::string at_home = configuration;
    at_home.replace(at_home.find("\"node.db\""), 9, "\"/nowhere/node.db\"");
    at_home.insert(at_home.rfind(']'), R"(, {"type": "file", "path": "/nowhere/all.csv"})");
    at_home.insert(at_home.find(R"("sinks")"), R"("buses": [{"name": "i2c-9", "type": "i2c", "number": 9999}], )");
    folder.write("at_home.json", at_home);
    Process forward(folder, program, {"forward", "home/moved.db", "at_home.json"});
    CHECK_MESSAGE(forward.end() == 0, forward.err);
    CHECK_MESSAGE(has(forward.out, "all is sent"), forward.out);
    CHECK(lines_of(folder.path() + "/copy.jsonl") == rows_of(folder.path() + "/home/moved.db"));
    CHECK(!std::filesystem::exists(folder.path() + "/node.db"));
    Process verify(folder, program, {"verify", "home/moved.db"});
    CHECK(verify.end() == 0);
    Process again(folder, program, {"forward", "home/moved.db", "node.json"});
    CHECK(again.end() == 0);
    CHECK(lines_of(folder.path() + "/copy.jsonl") == rows_of(folder.path() + "/home/moved.db"));
  }

  TEST_CASE("US-32 what waits for a sink that the configuration does not have is told") {
    const Folder folder;
    folder.write("node.json", configuration);
    const auto changed = [](std::string from, const std::string& to) {
      std::string text = configuration;
      text.replace(text.find(from), from.size(), to);
      return text;
    };
    folder.write("renamed.json", changed(R"("name": "copy")", R"("name": "other")"));
    Process before(folder, program, {"check", "renamed.json"});
    CHECK(before.end() == 0);
    CHECK_MESSAGE(!has(before.out, "no sink of that name"), before.out);  // there is no recording yet
    {
      const Away away(folder);
      Process run(folder, program, {"run", "node.json", "--for", "300ms"});
      CHECK(run.end() == 0);
    }
    const std::string waits = std::to_string(rows_of(folder.path() + "/node.db")) + " events (";
    const auto said = [&](std::vector<std::string> arguments, int status) {
      Process process(folder, program, std::move(arguments));
      CHECK_MESSAGE(process.end() == status, process.out << process.err);
      return process.out + process.err;
    };
    const std::string left = "node.db for a sink \"copy\", but no sink of that name goes through this recording";
    std::string text = said({"check", "renamed.json"}, 0);
    CHECK_MESSAGE(has(text, waits), text);
    CHECK_MESSAGE(has(text, left), text);
    text = said({"check", "node.json"}, 0);
    CHECK_MESSAGE(!has(text, "no sink of that name"), text);
    text = said({"forward", "node.db", "renamed.json"}, 1);
    CHECK_MESSAGE(has(text, "copy: " + waits), text);
    CHECK_MESSAGE(has(text, "but renamed.json has no sink of that name"), text);
    CHECK_MESSAGE(has(text, "not all is sent: 0 events, 0 dropped, "), text);
    text = said({"run", "renamed.json", "--for", "200ms"}, 0);
    CHECK_MESSAGE(has(text, left), text);
    // Under its name, it is sent; then there is nothing to tell.
    CHECK(has(said({"forward", "node.db", "node.json"}, 0), "all is sent"));
    text = said({"check", "renamed.json"}, 0);
    CHECK_MESSAGE(!has(text, "no sink of that name"), text);
  }

  TEST_CASE("US-32 killed at any moment, nothing that is recorded is missing at the peer") {
    const Folder folder;
    folder.write("node.json", configuration);
    for (int kill = 0; kill < 4; ++kill) {
      Process run(folder, program, {"run", "node.json", "--quiet"});
      for (int i = 0; i < 3000 && !folder.has("copy.jsonl"); ++i)
        std::this_thread::sleep_for(std::chrono::milliseconds{10});
      std::this_thread::sleep_for(std::chrono::milliseconds{37 * (kill + 1)});
      run.signal(SIGKILL);
      (void)run.end();
    }
    Process run(folder, program, {"run", "node.json", "--for", "300ms"});
    CHECK(run.end() == 0);
    std::vector<std::string> lines = all_lines_of(folder.path() + "/copy.jsonl");
    std::sort(lines.begin(), lines.end());
    lines.erase(std::unique(lines.begin(), lines.end()), lines.end());
    CHECK(lines.size() == rows_of(folder.path() + "/node.db"));
  }

  TEST_CASE("US-32 of a recording that is damaged, neither forward nor run says that all is well") {
    // What is kept of it: half of the file, or all of it with its first table's pages overwritten.
    for (const bool is_cut : {true, false}) {
      CAPTURE(is_cut);
      const Folder folder;
      folder.write("node.json", configuration);
      {
        const Away away(folder);
        Process run(folder, program, {"run", "node.json", "--for", "400ms"});
        REQUIRE(run.end() == 0);
      }
      const std::string path = folder.path() + "/node.db";
      const auto size = std::filesystem::file_size(path);
      REQUIRE(size > 40000);
      if (is_cut) {
        std::filesystem::resize_file(path, size / 2);
      } else {
        std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
        file.seekp(4096);
        file << std::string(size - 4096, '\x5a');
      }
      std::filesystem::copy_file(path, folder.path() + "/kept.db");
      {
        Process forward(folder, program, {"forward", "node.db", "node.json"});
        CHECK(forward.end() != 0);
        CHECK_MESSAGE(!has(forward.out, "all is sent: "), (forward.out + forward.err));
      }
      std::filesystem::copy_file(folder.path() + "/kept.db", path, std::filesystem::copy_options::overwrite_existing);
      {
        Process run(folder, program, {"run", "node.json", "--for", "300ms"});
        CHECK(run.end() != 0);
        CHECK_MESSAGE(!has(run.out + run.err, "nothing lost: "), (run.out + run.err));
      }
    }
  }

  TEST_CASE("forward says what it cannot do") {
    const Folder folder;
    folder.write("node.json", configuration);
    folder.write("none.json", R"({"sensors": [], "sinks": [{"type": "sqlite", "path": "node.db"}]})");
    Process missing(folder, program, {"forward", "node.db", "node.json"});
    CHECK(missing.end() == 2);
    CHECK(!std::filesystem::exists(folder.path() + "/node.db"));
    Process made(folder, program, {"run", "node.json", "--for", "100ms", "--quiet"});
    CHECK(made.end() == 0);
    Process none(folder, program, {"forward", "node.db", "none.json"});
    CHECK(none.end() == 2);
    CHECK_MESSAGE(has(none.err, "no sink of none.json goes"), none.err);
  }

  TEST_CASE("check: `through` names a recording that takes the topics") {
    const Folder folder;
    const auto checked = [&](const std::string& recording, const std::string& sink) {
      folder.write("node.json",
                   R"({"sensors": [{"name": "cpu", "type": "host", "quantity": "cpu", "rate": "1 Hz", "topic": "a/b"}],
                       "sinks": [{"name": "recording", "type": "sqlite", "path": "node.db")" +
                       recording + R"(}, {"name": "copy", "type": "file", "path": "c.jsonl", "format": "json")" + sink +
                       "}]}");
      Process check(folder, program, {"check", "node.json"});
      (void)check.end();
      return check.out + check.err;
    };
    CHECK(has(checked("", R"(, "through": "recoding")"), "did you mean \"recording\""));
    CHECK(has(checked("", R"(, "through": "copy")"), "this needs sqlite"));
    CHECK(has(checked(R"(, "through": "copy")", ""), "cannot go through another recording"));
    CHECK(has(checked(R"(, "topics": ["x/#"])", R"(, "through": "recording")"), "is not among those of the recording"));
    CHECK(!has(checked("", R"(, "through": "recording", "from": "beginning")"), "error"));
    CHECK(has(checked("", R"(, "through": "recording", "from": "yesterday")"), "beginning"));
    CHECK(has(checked(R"(, "batch_time": "500 ms")", R"(, "through": "recording", "batch_time": "20 ms")"),
              "recording: commits within 20 ms, by `batch_time` of copy; what goes through it: copy\n"));
    CHECK(has(checked(R"(, "batch_time": "500 ms")", R"(, "through": "recording")"),
              "recording: commits within 500 ms, by `batch_time` of its own; what goes through it: copy\n"));
    CHECK(!has(checked("", ""), "commits within"));
  }

  TEST_CASE("check: `stored_by` of an mqtt sensor names a sink that stores its events") {
    const Registry registry = standard_registry();
    const auto checked = [&](const std::string& sensor, const std::string& sinks) {
      return plan_system(registry, parse_config(R"({"sensors": [{"name": "phone", "type": "mqtt", "topics": ["a"],
        "topic": "phone", "fields": [{"name": "x"}])" +
                                                sensor + R"(}], "sinks": [)" + sinks + "]}"))
          .report();
    };
    const std::string recording = R"({"name": "recording", "type": "sqlite", "path": "run.db")";
    if (has(checked("", recording + "}"), "was built without")) {
      MESSAGE("skipped: there is no libmosquitto");
      return;
    }
    CHECK(checked(R"(, "stored_by": "recording", "qos": 1)", recording + "}") == "");
    CHECK(has(checked(R"(, "stored_by": "recoding", "qos": 1)", recording + "}"), "did you mean \"recording\""));
    CHECK(has(checked(R"(, "stored_by": "recording", "qos": 0)", recording + "}"), "only with `qos` 1"));
    CHECK(has(checked(R"(, "stored_by": "recording", "qos": 2)", recording + "}"), "only with `qos` 1"));
    CHECK(has(checked(R"(, "stored_by": "recording", "qos": 1)", recording + R"(, "topics": ["other"]})"),
              "does not take the topic \"phone\""));
    CHECK(
        has(checked(R"(, "stored_by": "far", "qos": 1)",
                    recording + R"(}, {"name": "far", "type": "tcp", "host": "h", "port": 9, "through": "recording"})"),
            "goes through a recording itself: name that recording"));
  }

  TEST_CASE("check: within which time a recording commits, and what waits in memory only") {
    const Registry registry = standard_registry();
    const SystemPlan plan = plan_system(registry, parse_config(R"({
      "sensors": [{"name": "cpu", "type": "host", "quantity": "cpu", "rate": "1 Hz"}],
      "sinks": [{"name": "card", "type": "sqlite", "path": "card.db", "profile": "card"},
                {"name": "other", "type": "sqlite", "path": "other.db"},
                {"type": "tcp", "name": "now", "host": "h", "port": 9, "queue_bytes": 4000000},
                {"type": "udp", "name": "view", "host": "h"},
                {"type": "tcp", "name": "slow", "host": "h", "port": 9, "through": "card", "batch_time": "1 min"},
                {"type": "tcp", "name": "fast", "host": "h", "port": 9, "through": "card", "batch_time": "3 s"},
                {"type": "console"}]})"));
    REQUIRE_MESSAGE(plan.good(), plan.report());
    CHECK(app::latencies(plan) ==
          std::vector<std::string>{
              "card: commits within 3 s, by `batch_time` of fast; what goes through it: slow, fast"});
    CHECK(app::only_in_memory(plan).starts_with("events for now (4.0 MB), view (4.2 MB) wait in memory only: "));
  }

  TEST_CASE("check: a recording on tmpfs that sinks go through loses what waits when the machine restarts") {
    struct statfs about {};
    if (::statfs("/dev/shm", &about) != 0 || about.f_type != TMPFS_MAGIC) {
      MESSAGE("skipped: /dev/shm is no tmpfs");
      return;
    }
    const Registry registry = standard_registry();
    const auto warned = [&](const std::string& through) {
      const SystemPlan plan = plan_system(registry, parse_config(R"({
        "sensors": [{"name": "cpu", "type": "host", "quantity": "cpu", "rate": "1 Hz"}],
        "sinks": [{"name": "recording", "type": "sqlite", "path": "/dev/shm/rtdata-check-test.db"},
                  {"type": "tcp", "name": "far", "host": "h", "port": 9)" +
                                                                 through + "}]}"));
      REQUIRE_MESSAGE(plan.good(), plan.report());
      return plan.document.report(plan.warnings, "warning: ");
    };
    CHECK_MESSAGE(has(warned(R"(, "through": "recording")"), "is on a file system in memory"),
                  warned(R"(, "through": "recording")"));
    CHECK(!has(warned(""), "in memory"));
  }
}
