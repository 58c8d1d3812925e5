// A short recording in which the n-th call of one kind fails: of operator new, of SQLite's memory, of its files. Each
// ends as an exception, as an error that is told, or as if nothing had been; and what is on the disk is a recording. A
// program of its own, since it replaces operator new. Each try is a process, so that its end says what became of it.
//
//     RTDATA_FAULTS="1 100000 1" rtdata_fault_tests       the first, the last, every so many-th call; default: a sample
//     RTDATA_FAULT="17 20" rtdata_fault_tests -tc='memory:*'   20 from the 17th on, in this process: for a debugger
#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <doctest/doctest.h>
#include <fcntl.h>
#include <sqlite3.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <limits>
#include <map>
#include <new>
#include <sstream>
#include <string>

#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "rtdata/sensors/analog.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"

namespace {

/// Counts calls of one kind and lets some of them fail. Of the thread of the test: lanes of a manual loop have none of
/// their own.
class Fault {
 public:
  void arm(long nth, long count) {
    calls_ = 0;
    first_ = nth;
    last_ = count < std::numeric_limits<long>::max() - nth ? nth + count : std::numeric_limits<long>::max();
    has_failed_ = false;
  }
  void disarm() { first_ = 0; }
  bool is_due() {
    if (first_ == 0 || ++calls_ < first_ || calls_ >= last_) return false;
    has_failed_ = true;
    return true;
  }
  bool has_failed() const { return has_failed_; }

 private:
  long calls_ = 0;
  long first_ = 0;  // 0: none fails
  long last_ = 0;
  bool has_failed_ = false;
};

Fault of_new, of_sqlite_memory, of_files;

void* allocate(std::size_t size, std::size_t alignment) {
  void* memory = nullptr;
  if (of_new.is_due() ||
      ::posix_memalign(&memory, std::max(alignment, sizeof(void*)), std::max<std::size_t>(size, 1)) != 0)
    throw std::bad_alloc();
  return memory;
}

}  // namespace

void* operator new(std::size_t size) { return allocate(size, alignof(std::max_align_t)); }
void* operator new[](std::size_t size) { return allocate(size, alignof(std::max_align_t)); }
void* operator new(std::size_t size, std::align_val_t alignment) {
  return allocate(size, static_cast<std::size_t>(alignment));
}
void* operator new[](std::size_t size, std::align_val_t alignment) {
  return allocate(size, static_cast<std::size_t>(alignment));
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete[](void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
void operator delete[](void* memory, std::size_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
void operator delete[](void* memory, std::align_val_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t, std::align_val_t) noexcept { std::free(memory); }
void operator delete[](void* memory, std::size_t, std::align_val_t) noexcept { std::free(memory); }

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;

namespace {

struct Climate {
  double temperature = 0;
  std::int64_t number = 0;
  friend constexpr auto describe(type_tag<Climate>) {
    return record("climate", field("temperature", &Climate::temperature, "Cel"), field("number", &Climate::number));
  }
};

// ---- SQLite's memory

sqlite3_mem_methods real_memory{};

void fail_sqlite_memory() {
  sqlite3_shutdown();
  sqlite3_config(SQLITE_CONFIG_GETMALLOC, &real_memory);
  sqlite3_mem_methods faulty = real_memory;
  faulty.xMalloc = [](int size) -> void* { return of_sqlite_memory.is_due() ? nullptr : real_memory.xMalloc(size); };
  faulty.xRealloc = [](void* memory, int size) -> void* {
    return of_sqlite_memory.is_due() ? nullptr : real_memory.xRealloc(memory, size);
  };
  REQUIRE(sqlite3_config(SQLITE_CONFIG_MALLOC, &faulty) == SQLITE_OK);
  REQUIRE(sqlite3_config(SQLITE_CONFIG_LOOKASIDE, 0, 0) == SQLITE_OK);  // each is a call
}

// ---- SQLite's files: those of the system, of which calls fail

int files_error = SQLITE_IOERR;  // or SQLITE_FULL
sqlite3_vfs* real_vfs = nullptr;

/// The calls of one kind of file: of the database, or of those beside it.
struct FileCalls {
  sqlite3_io_methods faulty{};  // first: what a file points to
  const sqlite3_io_methods* real = nullptr;
};
std::array<FileCalls, 8> file_calls;

const sqlite3_io_methods* real_calls(sqlite3_file* file) {
  return reinterpret_cast<const FileCalls*>(file->pMethods)->real;
}

int open_file(sqlite3_vfs*, const char* name, sqlite3_file* file, int flags, int* out_flags) {
  file->pMethods = nullptr;
  if (of_files.is_due()) return SQLITE_CANTOPEN;
  const int status = real_vfs->xOpen(real_vfs, name, file, flags, out_flags);
  if (file->pMethods == nullptr) return status;
  FileCalls* calls = file_calls.data();
  while (calls->real != nullptr && calls->real != file->pMethods) ++calls;
  if (calls->real == nullptr) {
    calls->real = file->pMethods;
    calls->faulty = *calls->real;
    sqlite3_io_methods& faulty = calls->faulty;
    faulty.xWrite = [](sqlite3_file* to, const void* data, int size, sqlite3_int64 at) {
      if (!of_files.is_due()) return real_calls(to)->xWrite(to, data, size, at);
      (void)real_calls(to)->xWrite(to, data, size / 2, at);  // as far as it came
      return files_error == SQLITE_FULL ? SQLITE_FULL : SQLITE_IOERR_WRITE;
    };
    faulty.xSync = [](sqlite3_file* of, int how) {
      return of_files.is_due() ? SQLITE_IOERR_FSYNC : real_calls(of)->xSync(of, how);
    };
    faulty.xTruncate = [](sqlite3_file* of, sqlite3_int64 size) {
      return of_files.is_due() ? SQLITE_IOERR_TRUNCATE : real_calls(of)->xTruncate(of, size);
    };
    faulty.xRead = [](sqlite3_file* from, void* data, int size, sqlite3_int64 at) {
      return of_files.is_due() ? SQLITE_IOERR_READ : real_calls(from)->xRead(from, data, size, at);
    };
    faulty.xShmMap = [](sqlite3_file* of, int region, int size, int is_to_grow, void volatile** memory) {
      return of_files.is_due() ? SQLITE_IOERR_SHMMAP : real_calls(of)->xShmMap(of, region, size, is_to_grow, memory);
    };
  }
  file->pMethods = &calls->faulty;
  return status;
}

void fail_files() {
  static sqlite3_vfs faulty;
  real_vfs = sqlite3_vfs_find(nullptr);
  faulty = *real_vfs;
  faulty.zName = "faulty";
  faulty.xOpen = open_file;
  faulty.xDelete = [](sqlite3_vfs*, const char* name, int is_synced) {
    return of_files.is_due() ? SQLITE_IOERR_DELETE : real_vfs->xDelete(real_vfs, name, is_synced);
  };
  REQUIRE(sqlite3_vfs_register(&faulty, 1) == SQLITE_OK);
}

// ---- the recording

constexpr int feed_events = 30;

/// Without any memory of C++.
void write_file(const std::string& path, std::string_view content) noexcept {
  const int file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
  const auto written = ::write(file, content.data(), content.size());
  ::close(file);
  if (written != static_cast<ssize_t>(content.size())) std::_Exit(32);
}

/// What was seen of the fault.
struct Seen {
  bool threw = false;
  std::uint64_t told = 0;
  std::uint64_t offered = 0, stored = 0, dropped = 0;
};

[[noreturn]] void end_wrongly(const char* what) {
  std::fprintf(stderr, "%s\n", what);
  std::_Exit(31);
}

/// What is set up may throw; from then on nothing does.
Seen record_something(const std::string& path, Fault& fault) {
  Seen seen;
  bool is_set_up = false;
  try {
    Loop loop{Loop::Manual{}};
    const auto note = [&](std::string_view object) noexcept { seen.told += object.starts_with("sink"); };
    loop.runtime().on_log([&](const LogRecord& line) {
      if (line.level >= LogLevel::warning) note(line.object);
    });
    loop.on_error([&](const ErrorReport& report) { note(report.object); });
    SqliteSink sink(loop, {.path = path, .sink = {.batch_time = 20ms, .retry_first = 5ms}});
    sink.on_error([&](const ErrorReport&) { ++seen.told; });
    Sensor<Climate> sensor(loop, {.name = "sensor", .topic = "room/climate", .rate = 100_Hz},
                           [n = std::int64_t{0}]() mutable -> Reading<Climate> {
                             if (++n % 7 == 0) return Error{Errc::io_failed, "the device gives no answer", "", "", ""};
                             return Climate{20, n};
                           });
    loop.advance(50ms);
    Feed<Climate> feed(loop, {.name = "feed", .topic = "other"});
    const std::string file = std::filesystem::path(path).replace_filename("adc");
    write_file(file, "17\n");
    AnalogSensor on_a_lane(loop, {.name = "adc", .rate = 50_Hz}, {.file = file});
    int delivered = 0;
    const Subscription handler = loop.subscribe("#", [&](const EventView&) { ++delivered; });
    is_set_up = true;
    for (int i = 0; i < feed_events; ++i) {
      feed.publish({1.5, i});
      loop.advance(7ms);
      if (i == feed_events / 3) write_file(file, "no number\n");
      if (i == feed_events / 2) write_file(file, "18\n");
    }
    sink.flush();
    loop.advance(50ms);
    try {
      loop.close();
    } catch (const std::bad_alloc&) {  // nothing has begun
      fault.disarm();
      loop.close();
    }
    fault.disarm();
    const SinkCounts counts = sink.counts();
    seen.offered = counts.offered;
    seen.stored = counts.stored;
    for (const std::uint64_t dropped : counts.dropped) seen.dropped += dropped;
    if (!loop.runtime().balances()) end_wrongly("the account does not balance");
  } catch (const std::exception&) {
    if (is_set_up) end_wrongly("it threw at run time");
    seen.threw = true;
  }
  return seen;
}

/// What is on the disk is a recording, which a next start goes on with.
VerifyReport check_what_is_there(const std::string& path) {
  {
    Loop loop{Loop::Manual{}};
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    loop.advance(1s);
    if (loop.close() != 0) end_wrongly("the next start lost events");
  }
  auto recording = Recording::open(path).or_throw();
  auto report = verify(recording).or_throw();
  if (report.verdict() != Verdict::balanced && report.verdict() != Verdict::sealed) {
    end_wrongly(("the recording is " + std::string(name_of(report.verdict())) + ": " + report.text()).c_str());
  }
  return report;
}

enum class Status : int { fault_not_reached = 0, as_if_nothing_had_been = 10, told = 11, threw = 12 };

struct FaultKind {
  const char* name;
  Fault* fault;
  void (*set_up)();
  long every;  // of the short kind, after the first hundred
};

/// In a process of its own.
Status try_it(const FaultKind& kind, long nth, long count, const std::string& folder) {
  Fault& fault = *kind.fault;
  ::setenv("XDG_RUNTIME_DIR", folder.c_str(), 1);  // of the live files: each try has as many calls as the others
  const std::string path = folder + "/run.db";
  fault.arm(nth, count);
  const Seen seen = record_something(path, fault);
  fault.disarm();
  const VerifyReport report = check_what_is_there(path);
  if (seen.threw) return Status::threw;
  if (seen.offered != seen.stored + seen.dropped) end_wrongly("the counts of the sink do not balance");
  const RunReport& run = report.runs.front();
  // Where there is no memory for words, the recording and the exit status tell of it.
  const bool has_words = seen.told != 0 || (kind.fault == &of_new && run.verdict == Verdict::sealed);
  if (seen.dropped != 0 && !has_words) end_wrongly("events were dropped and nobody was told");
  if (run.rows < seen.stored) end_wrongly("rows are missing that were stored");
  if (!has_words && (run.verdict != Verdict::balanced || run.rows != seen.offered))
    end_wrongly("the recording is not complete and nobody was told");
  if (!fault.has_failed()) {
    if (seen.offered < feed_events + 10) end_wrongly("the recording is too short to be one");
    if (run.verdict != Verdict::balanced || run.rows != seen.offered) end_wrongly("without a fault it is not complete");
    return Status::fault_not_reached;
  }
  return seen.told != 0 ? Status::told : Status::as_if_nothing_had_been;
}

class Folder {
 public:
  Folder() {
    std::string name = std::filesystem::temp_directory_path() / "rtdata-XXXXXX";
    REQUIRE(::mkdtemp(name.data()) != nullptr);
    path_ = name;
  }
  Folder(const Folder&) = delete;
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

void try_all(const FaultKind& kind, long count) {
  CAPTURE(std::string(kind.name));
  CAPTURE(count);
  if (const char* one = std::getenv("RTDATA_FAULT")) {
    long nth = 0, only = 1;
    std::istringstream(one) >> nth >> only;
    if (only != count) return;
    const Folder folder;
    kind.set_up();
    MESSAGE("ends with " << static_cast<int>(try_it(kind, nth, count, folder.path())));
    return;
  }
  long first = 1, last = std::numeric_limits<long>::max(), every = kind.every;
  if (const char* range = std::getenv("RTDATA_FAULTS")) std::istringstream(range) >> first >> last >> every;
  std::map<int, int> ends;
  // The first calls are those that make the loop and its parts, of which each is another: they are all tried.
  for (long nth = first; nth <= last; nth += nth < 100 ? 1 : every) {
    CAPTURE(nth);
    const Folder folder;
    const pid_t child = ::fork();
    REQUIRE(child >= 0);
    if (child == 0) {
      ::alarm(60);  // a hang ends by SIGALRM
      for (const int signal : {SIGSEGV, SIGABRT, SIGBUS, SIGFPE, SIGILL}) ::signal(signal, SIG_DFL);  // not doctest's
      kind.set_up();
      Status status{};
      try {
        status = try_it(kind, nth, count, folder.path());
      } catch (const std::exception& error) {
        end_wrongly(error.what());
      }
      std::_Exit(static_cast<int>(status));
    }
    int status = 0;
    REQUIRE(::waitpid(child, &status, 0) == child);
    CHECK_MESSAGE(WIFEXITED(status), "the " << nth << "th: ended by signal " << WTERMSIG(status));
    if (!WIFEXITED(status)) continue;
    const int end = WEXITSTATUS(status);
    CHECK_MESSAGE((end == 0 || (end >= 10 && end <= 12)), "ended with " << end);
    ++ends[end];
    if (end == 0) break;
  }
  if (first == 1 && last == std::numeric_limits<long>::max()) CHECK(ends[0] == 1);
  MESSAGE(std::string(kind.name) << ", " << count << " together: " << ends[12] << " threw, " << ends[11]
                                 << " were told, " << ends[10] << " made no difference");
}

constexpr long for_good = std::numeric_limits<long>::max();

}  // namespace

TEST_CASE("memory: the n-th allocation of C++ fails") {
  try_all({"operator new", &of_new, [] {}, 7}, 1);
  try_all({"operator new", &of_new, [] {}, 13}, 20);
}

TEST_CASE("memory: the n-th allocation fails while tickers join, leave and change their groups") {
  bool is_over = false;
  for (long nth = 1; !is_over; ++nth) {
    CAPTURE(nth);
    REQUIRE(nth < 1000);
    Loop loop{Loop::Manual{}};
    loop.runtime().on_log([](const LogRecord&) {});
    constexpr int count = 6;
    std::array<int, count> ticks{};
    std::array<Ticker, count> tickers;
    for (std::size_t i = 0; i < count; ++i)
      tickers[i] = Ticker(loop, {.period = 10ms}, [&, i](const Tick&) { ++ticks[i]; });
    loop.advance(15ms);
    const auto tried = [](auto&& function) {
      try {
        function();
      } catch (const std::bad_alloc&) {
      }
    };
    Timer within(loop, 1ms, [&] {
      tried([&] { tickers[0].set_period(3ms); });
      tickers[1].stop();
      tried([&] { tickers[1].start(); });
    });
    of_new.arm(nth, 1);
    tried([&] { tickers[2].set_period(4ms); });
    tried([&] { tickers[3].set_period(4ms); });
    tickers[4].stop();
    loop.advance(20ms);
    of_new.disarm();
    is_over = !of_new.has_failed();
    // Whatever failed: each one ticks as it says, alone or with others, and can be started anew.
    for (Ticker& ticker : tickers) {
      if (!ticker.is_running()) ticker.start();
      CHECK(ticker.is_running());
    }
    loop.advance(100ms);
    for (Ticker& ticker : tickers) ticker.set_period(5ms);
    loop.advance(50ms);
    ticks = {};
    loop.advance(1s);
    for (std::size_t i = 0; i < count; ++i) CHECK(ticks[i] == 200);
    for (Ticker& ticker : tickers) ticker.stop();
    ticks = {};
    loop.advance(1s);
    CHECK(ticks == std::array<int, count>{});
  }
}

TEST_CASE("memory of SQLite: the n-th allocation fails") {
  const FaultKind kind{"memory of SQLite", &of_sqlite_memory, fail_sqlite_memory, 997};
  try_all(kind, 1);
  try_all(kind, 1000);
}

// SQLite prepares its statements anew when the schema has changed: a topic has got its table. Without memory for that
// it may roll the transaction back and run the statement outside of it, without an error.
TEST_CASE("memory of SQLite: the n-th allocation fails of the transaction of a new topic") {
  const pid_t child = ::fork();
  REQUIRE(child >= 0);
  if (child == 0) {
    ::alarm(240);
    fail_sqlite_memory();
    bool is_over = false;
    for (long nth = 1; !is_over; nth += nth < 300 ? 1 : 5) {
      const Folder folder;
      const std::string path = folder.path() + "/run.db";
      {
        Loop loop{Loop::Manual{}};
        loop.runtime().on_log([](const LogRecord&) {});
        loop.on_error([](const ErrorReport&) {});
        SqliteSink sink(loop, {.path = path, .sink = {.batch_time = 20ms, .retry_first = 5ms}});
        Feed<Climate> feed(loop, {.name = "feed", .topic = "room/climate"});
        feed.publish({1.5, 0});
        loop.advance(2s);  // there is an account, too
        Feed<Climate> new_topic(loop, {.name = "new", .topic = "other"});
        new_topic.publish({1.5, 0});
        of_sqlite_memory.arm(nth, 1);
        feed.publish({1.5, 1});
        loop.advance(2s);
        of_sqlite_memory.disarm();
        is_over = !of_sqlite_memory.has_failed();
        if (loop.close() != 0) end_wrongly("events were lost, though there was memory again");
      }
      auto recording = Recording::open(path).or_throw();
      auto report = verify(recording).or_throw();
      if (report.verdict() != Verdict::balanced || report.runs.front().rows != 3)
        end_wrongly((std::to_string(nth) + "th: " + report.text()).c_str());
    }
    std::_Exit(0);
  }
  int status = 0;
  REQUIRE(::waitpid(child, &status, 0) == child);
  CHECK(WIFEXITED(status));
  CHECK(WEXITSTATUS(status) == 0);
}

TEST_CASE("files: the n-th call fails") {
  const FaultKind input_output{"files", &of_files, fail_files, 11};
  try_all(input_output, 1);
  try_all(input_output, 5);
  try_all(input_output, for_good);
}

TEST_CASE("files: the disk is full at the n-th call") {
  const FaultKind full{"full disk", &of_files,
                       [] {
                         files_error = SQLITE_FULL;
                         fail_files();
                       },
                       17};
  try_all(full, 1);
  try_all(full, 30);
}
