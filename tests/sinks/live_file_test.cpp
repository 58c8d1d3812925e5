// What of a run survives a kill, where it lies, and who may touch it.
#include "recording/live_file.hpp"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <sched.h>
#include <sys/file.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "recording/private_folder.hpp"
#include "recording/recording_lock.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/recording/runs.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "rtdata/sensors/feed.hpp"
#include "sinks/killed.hpp"
#include "sinks/recordings.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;
using recordings::number;

namespace {

/// An environment variable while this lives.
class Variable {
 public:
  Variable(const char* name, const char* value) : name_(name) {
    if (const char* before = std::getenv(name)) before_ = before;
    set(value);
  }
  Variable(const Variable&) = delete;
  ~Variable() { set(before_ ? before_->c_str() : nullptr); }

 private:
  void set(const char* value) {
    if (value != nullptr) {
      ::setenv(name_, value, 1);
    } else {
      ::unsetenv(name_);
    }
  }
  const char* name_;
  std::optional<std::string> before_;
};

/// The counts of recordings made while this lives are in this folder, wherever the tests run.
struct LiveFolder {
  Directory directory;
  Variable service{"RUNTIME_DIRECTORY", directory.path.c_str()};
  std::vector<std::string> files() const {
    std::vector<std::string> all;
    for (const auto& entry : std::filesystem::directory_iterator(directory.path)) all.push_back(entry.path());
    return all;
  }
  LiveFolder() { ::chmod(directory.path.c_str(), 0700); }
};

mode_t mode_of(const std::string& path) {
  struct stat about {};
  REQUIRE(::lstat(path.c_str(), &about) == 0);
  return about.st_mode & 07777;
}

bool is_there(const std::string& path) { return ::access(path.c_str(), F_OK) == 0; }

std::string word(const std::string& path, const std::string& query) {
  const auto database = sqlite::Database::open(path, sqlite::Database::Mode::read);
  auto statement = database.prepare(query);
  return statement.step() ? std::string(statement.text(0)) : std::string();
}

/// Runs in a child, which is killed when it comes to its end. Its status otherwise.
int killed_at_end(const std::function<void()>& work) {
  return status_of([&] {
    work();
    ::raise(SIGKILL);
  });
}

/// Publishes so many events, of which those of the first 10 are committed.
void record_some(const SqliteConfig& config, int events, const std::function<void()>& while_open = {}) {
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, config);
  Feed<Number> feed(loop, {.name = "feed", .topic = "a"});
  loop.advance(1s);
  for (int i = 0; i < 10; ++i) feed.publish({1});
  loop.advance(1s);
  for (int i = 10; i < events; ++i) feed.publish({1});
  if (while_open) while_open();
  if (events > 10) ::raise(SIGKILL);
  loop.close();
}

std::vector<std::string> log_of(const std::string& path) {
  std::vector<std::string> log;
  Loop loop{Loop::Manual{}};
  loop.runtime().on_log([&](const LogRecord& line) { log.emplace_back(line.text); });
  SqliteSink sink(loop, {.path = path});
  loop.advance(2s);
  loop.close();
  return log;
}

std::string refusal(const SqliteConfig& config) {
  Loop loop{Loop::Manual{}};
  try {
    SqliteSink sink(loop, config);
  } catch (const SetupError& error) {
    return std::string(error.error().id()) + ": " + error.error().text();
  }
  return "";
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("a kept value is the one before or the one after, wherever its writing stops") {
    struct Two {
      int a, b;
    };
    struct alignas(64) Memory {
      sqlite::Kept<Two> kept;
    };
    Memory memory, before;
    std::memset(static_cast<void*>(&memory), 0, sizeof memory);
    auto& kept = memory.kept;
    CHECK(!kept.value());
    for (int i = 1; i <= 4; ++i) {
      std::memcpy(static_cast<void*>(&before), &memory, sizeof memory);
      kept.set({i, -i});
      CHECK(kept.value()->a == i);
      CHECK(kept.value()->b == -i);
      // What it writes before the last word of all leaves the value before as it was.
      constexpr std::size_t word = sizeof(std::atomic<std::uint64_t>);
      std::memcpy(reinterpret_cast<std::byte*>(&before) + word, reinterpret_cast<const std::byte*>(&memory) + word,
                  sizeof memory - word);
      CHECK(before.kept.value().has_value() == (i > 1));
      if (i > 1) CHECK(before.kept.value()->a == i - 1);
    }
  }

  TEST_CASE("while it records, nobody but its user can touch the counts; after a clean end nothing is left") {
    LiveFolder live;
    Directory directory;
    const std::string path = directory / "run.db";
    record_some({.path = path}, 10, [&] {
      CHECK(is_there(path + "-lock"));
      const auto files = live.files();
      REQUIRE(files.size() == 1);
      CHECK(mode_of(files[0]) == 0600);
      CHECK(files[0] == live.directory / (word(path, "SELECT uuid FROM rtdata_run") + ".live"));
    });
    CHECK(!is_there(path + "-lock"));
    CHECK(live.files().empty());
  }

  TEST_CASE("who may write the recording may open its lock, and nobody else") {
    Directory directory;
    const std::string path = directory / "run.db";
    record_some({.path = path}, 10);
    for (const auto& one : std::vector<std::pair<mode_t, mode_t>>{
             {0644, 0600}, {0640, 0600}, {0600, 0600}, {0660, 0660}, {0664, 0660}, {0666, 0666}}) {
      CAPTURE(one.first);
      REQUIRE(::chmod(path.c_str(), one.first) == 0);
      record_some({.path = path}, 10, [&] { CHECK(mode_of(path + "-lock") == one.second); });
    }
  }

  TEST_CASE("all names of a recording have one lock") {
    Directory directory;
    const std::string path = directory / "run.db";
    const std::string other = directory / "other.db";
    record_some({.path = path}, 10);
    REQUIRE(::symlink("run.db", other.c_str()) == 0);
    record_some({.path = path}, 10, [&] {
      CHECK(refusal({.path = other}).find("process " + std::to_string(::getpid()) + " records into it") !=
            std::string::npos);
    });
    CHECK(!is_there(other + "-lock"));
  }

  TEST_CASE("two users cannot record into one file, and one cannot lock the other out of hers") {
    if (::geteuid() != 0) {
      MESSAGE("skipped: being another user needs root");
      return;
    }
    Directory directory;
    REQUIRE(::chmod(directory.path.c_str(), 0777) == 0);
    const std::string path = directory / "run.db";
    record_some({.path = path}, 10);
    constexpr uid_t other = 65534;
    const auto as_other = [&](const std::function<bool()>& work) {
      const int status = killed_at_end([&] {
        if (::setgid(other) != 0 || ::setuid(other) != 0) ::_exit(2);
        ::_exit(work() ? 0 : 1);
      });
      return WIFEXITED(status) && WEXITSTATUS(status) == 0;
    };
    const pid_t holder = ::getpid();
    const std::string counts = sqlite::private_folders().back();
    // It may read the recording only.
    REQUIRE(::chmod(path.c_str(), 0644) == 0);
    record_some({.path = path}, 10, [&] {
      CHECK(as_other(
          [&] { return ::open((path + "-lock").c_str(), O_RDONLY) < 0 && ::open(counts.c_str(), O_RDONLY) < 0; }));
    });
    // It may write it.
    REQUIRE(::chmod(path.c_str(), 0666) == 0);
    record_some({.path = path}, 10, [&] {
      CHECK(as_other([&] {
        return refusal({.path = path}).find("process " + std::to_string(holder) + " records into it") !=
               std::string::npos;
      }));
    });
    // What another user's killed run has counted stays unknown; that is said, and the recording goes on.
    CHECK(WIFSIGNALED(killed_at_end([&] { record_some({.path = path}, 17); })));
    CHECK(as_other([&] { return log_of(path).at(0).find("is unknown") != std::string::npos; }));
    CHECK(number(path, "SELECT lost IS NULL FROM rtdata_run WHERE state = 'sealed'") == 1);
  }

  TEST_CASE("a service's counts are found again by who starts without its environment") {
    Directory directory;
    const std::string path = directory / "run.db";
    {
      LiveFolder live;
      CHECK(WIFSIGNALED(killed_at_end([&] { record_some({.path = path}, 17); })));
      REQUIRE(live.files().size() == 1);
      const Variable none("RUNTIME_DIRECTORY", nullptr);
      CHECK(log_of(path).at(0).find("lost 7 events") != std::string::npos);
      CHECK(live.files().empty());
    }
    CHECK(number(path, "SELECT lost FROM rtdata_run WHERE run = 1") == 7);
    CHECK(!is_there(path + "-lock"));
  }

  TEST_CASE("two runs that were killed one after the other are each sealed with what is known of it") {
    LiveFolder live;
    Directory directory;
    const std::string path = directory / "run.db";
    CHECK(WIFSIGNALED(killed_at_end([&] { record_some({.path = path}, 17); })));
    const std::string uuid = word(path, "SELECT uuid FROM rtdata_run");
    CHECK(WIFSIGNALED(killed_at_end([&] { record_some({.path = path}, 12); })));
    CHECK(number(path, "SELECT lost FROM rtdata_run WHERE uuid = '" + uuid + "'") == 7);
    CHECK(live.files().size() == 1);
    log_of(path);
    CHECK(number(path, "SELECT lost FROM rtdata_run WHERE run = 2") == 2);
    CHECK(live.files().empty());
  }

  TEST_CASE(
      "killed before the recording was opened, at a first start and later: the seal makes a run of what was lost") {
    enum class Opens { first_start, later_start, later_seal };
    for (const Opens how : {Opens::first_start, Opens::later_start, Opens::later_seal}) {
      CAPTURE(static_cast<int>(how));
      LiveFolder live;
      Directory directory;
      const std::string path = directory / "folder/run.db";
      std::optional<sqlite::RecordingLock> other;
      if (how != Opens::first_start) {
        std::filesystem::create_directory(directory / "folder");
        log_of(path);
        other = sqlite::RecordingLock::take(path).or_throw();  // such as `rtdata seal`, for a while
      }
      CHECK(WIFSIGNALED(killed_at_end([&] {
        Loop loop{Loop::Manual{}};
        loop.on_error([](const ErrorReport&) {});
        std::optional<SqliteSink> sink;
        const auto topic = loop.topic<Number>("a");
        Timer timer(loop, 0ms, [&] { sink.emplace(loop, SqliteConfig{.path = path}); });  // as in a reload
        loop.advance(1ms);
        for (int i = 0; i < 5; ++i) topic.publish({1});
        loop.advance(3s);
        for (int i = 0; i < 3; ++i) topic.publish({1});
        ::raise(SIGKILL);  // while they live
      })));
      record_some({.path = directory / "other.db"}, 10);
      CHECK(live.files().size() == 1);  // which is not of that one
      if (how == Opens::first_start) std::filesystem::create_directory(directory / "folder");
      if (other) other->remove();
      if (how != Opens::first_start) {
        const VerifyReport report = recordings::verified(path);
        CHECK(report.exit_code() == 1);
        CHECK(recordings::problems_of(report).find("A run was killed before it had opened this file") !=
              std::string::npos);
      }
      const std::vector<std::string> told = how == Opens::later_seal ? seal(path).or_throw() : log_of(path);
      REQUIRE(told.size() == 1);
      CHECK(told[0].find("8 more of sensors whose names are unknown") != std::string::npos);
      CHECK(told[0].find("killed before it had opened this file") != std::string::npos);
      CHECK(live.files().empty());
      CHECK(number(path, "SELECT run FROM rtdata_run WHERE state = 'sealed'") == (how == Opens::first_start ? 1 : 2));
      CHECK(number(path, "SELECT lost FROM rtdata_run WHERE state = 'sealed'") == 8);
      CHECK(recordings::verified(path).verdict() == Verdict::sealed);
      CHECK(log_of(path).empty());
      CHECK(number(path, "SELECT count(*) FROM rtdata_run WHERE state = 'sealed'") == 1);
    }
  }

  TEST_CASE("a start that is refused leaves no counts behind") {
    LiveFolder live;
    Directory directory;
    CHECK(refusal({.path = directory / "no/such/folder/run.db"}) != "");
    CHECK(live.files().empty());
  }

  TEST_CASE("a copy of a recording under way is not sealed with the counts of the original") {
    LiveFolder live;
    Directory directory;
    const std::string path = directory / "run.db";
    const std::string copy = directory / "copy.db";
    record_some({.path = path}, 10, [&] {
      recordings::sql(path, "VACUUM INTO '" + copy + "'");
      CHECK(log_of(copy).at(0).find("is unknown") != std::string::npos);
      CHECK(live.files().size() == 1);
      // Its lock is removed by mistake: the counts that are held still keep a second one out.
      REQUIRE(::unlink((path + "-lock").c_str()) == 0);
      CHECK(refusal({.path = path}).starts_with("busy: "));
    });
    CHECK(recordings::verified(path).verdict() == Verdict::balanced);
    CHECK(number(copy, "SELECT lost IS NULL FROM rtdata_run WHERE run = 1") == 1);
  }

  TEST_CASE("the counts of recordings that are gone are removed, those of others stay") {
    LiveFolder live;
    Directory directory;
    for (const char* name : {"gone.db", "stays.db", "away/run.db"}) {
      std::filesystem::create_directories(directory / "away");
      CHECK(WIFSIGNALED(killed_at_end([&] { record_some({.path = directory / name}, 17); })));
    }
    CHECK(live.files().size() == 3);
    std::filesystem::remove(directory / "gone.db");
    std::filesystem::rename(directory / "away", directory / "elsewhere");  // as a disk that is taken away
    std::ofstream(live.directory / "half.live") << "not whole";
    record_some({.path = directory / "new.db"}, 10);
    // "half.live" has not the mode of ours, so it is left alone.
    CHECK(live.files().size() == 3);
    std::filesystem::rename(directory / "elsewhere", directory / "away");
    for (const char* name : {"stays.db", "away/run.db"})
      CHECK(log_of(directory / name).at(0).find("lost 7 events") != std::string::npos);
    CHECK(live.files().size() == 1);
  }

  TEST_CASE("a folder that another can write is not used") {
    Directory directory;
    const std::string path = directory / "run.db";
    const std::string open_to_all = directory / "open";
    std::filesystem::create_directory(open_to_all);
    REQUIRE(::chmod(open_to_all.c_str(), 0777) == 0);
    const std::string link = directory / "link";
    std::filesystem::create_directory(directory / "target");
    REQUIRE(::symlink("target", link.c_str()) == 0);
    for (const std::string& folder : {open_to_all, link}) {
      const Variable service("RUNTIME_DIRECTORY", folder.c_str());
      record_some({.path = path}, 10, [&] {
        CHECK(std::filesystem::is_empty(folder));
        CHECK(!sqlite::PrivateFolder::open(folder));
      });
    }
    CHECK(!sqlite::PrivateFolder::open(directory / "no/such"));
    CHECK(sqlite::PrivateFolder::open(directory / "made"));
    CHECK(mode_of(directory / "made") == 0700);
  }

  TEST_CASE("counts that find no room are told, and what a kill loses is not known; no signal ends the program") {
    Directory directory;
    for (const auto& one : std::vector<std::pair<std::string, int>>{{"4k", 1}, {"128k", 1000}}) {
      const std::string& size = one.first;
      const int sensors = one.second;
      CAPTURE(size);
      const std::string path = directory / ("run" + size + ".db");
      const int status = killed_at_end([&] {
        if (::unshare(CLONE_NEWNS) != 0 || ::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
            ::mount("none", "/dev/shm", "tmpfs", 0, ("size=" + size).c_str()) != 0)
          ::_exit(77);
        ::unsetenv("RUNTIME_DIRECTORY");
        ::unsetenv("XDG_RUNTIME_DIR");
        Loop loop{Loop::Manual{}};
        std::vector<std::string> log;
        loop.runtime().on_log([&](const LogRecord& line) { log.emplace_back(line.text); });
        SqliteSink sink(loop, {.path = path});
        std::vector<Feed<Number>> feeds;
        for (int i = 0; i < sensors; ++i)
          feeds.emplace_back(loop, FeedConfig{.name = "f" + std::to_string(i), .topic = "a"});
        for (int round = 0; round < 3; ++round) {
          for (auto& feed : feeds) feed.publish({1});
          loop.advance(1100ms);
        }
        int told = 0;
        for (const std::string& line : log)
          told += line.find("if the program is killed, what it lost will not be known") != std::string::npos;
        for (auto& feed : feeds) feed.publish({1});
        if (told != 1) ::_exit(1);
        ::raise(SIGKILL);
      });
      if (WIFEXITED(status) && WEXITSTATUS(status) == 77) {
        MESSAGE("skipped: mounting a small file system is not permitted here");
        return;
      }
      CHECK(WIFSIGNALED(status));
      CHECK(WTERMSIG(status) == SIGKILL);
      CHECK(log_of(path).at(0).find("is unknown") != std::string::npos);
      CHECK(number(path, "SELECT count(*) FROM a") >= 3 * sensors);
      CHECK(number(path, "SELECT lost IS NULL FROM rtdata_run WHERE run = 1") == 1);
      CHECK(recordings::verified(path).verdict() == Verdict::sealed);
    }
  }

  TEST_CASE("a recording holds the configuration: only its user and group may read it") {
    const mode_t before = ::umask(022);
    Directory directory;
    const std::string path = directory / "run.db";
    record_some({.path = path}, 10, [&] {
      CHECK(mode_of(path) == 0640);
      CHECK(mode_of(path + "-wal") == 0640);
      CHECK(mode_of(path + "-shm") == 0640);
    });
    REQUIRE(::chmod(path.c_str(), 0644) == 0);  // as its owner wants it
    record_some({.path = path}, 10, [&] {
      CHECK(mode_of(path) == 0644);
      CHECK(mode_of(path + "-wal") == 0644);
    });
    const std::string open = directory / "open.db";
    record_some({.path = open, .permissions = "0664"}, 10, [&] {
      for (const char* end : {"", "-wal", "-shm"}) CHECK(mode_of(open + end) == 0644);  // less the umask
    });
    record_some({.path = open, .permissions = "600"}, 10, [&] { CHECK(mode_of(open) == 0644); });  // it keeps its own
    ::umask(before);
    for (const char* wrong : {"", "0", "0999", "0755", "0440", "4644", "00644", "rw-r--r--", "0x1a4", "06 4"}) {
      CAPTURE(wrong);
      Loop loop{Loop::Manual{}};
      CHECK_THROWS_AS(SqliteSink(loop, {.path = directory / "wrong.db", .permissions = wrong}), SetupError);
      CHECK_FALSE(std::filesystem::exists(directory / "wrong.db"));
    }
  }

  TEST_CASE("SQLite that has no memory for a handle is an error") {
    Directory directory;
    sqlite3_hard_heap_limit64(1);
    std::string why;
    try {
      sqlite::Database::open(directory / "run.db", sqlite::Database::Mode::write);
    } catch (const SetupError& error) {
      why = error.what();
    }
    sqlite3_hard_heap_limit64(0);
    sqlite3_soft_heap_limit64(0);
    CHECK(why.find("Cannot allocate memory") != std::string::npos);
  }
}
