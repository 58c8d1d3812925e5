// Programs that are killed at random moments while they record: what the next start says of them.
#include <doctest/doctest.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <csignal>
#include <cstdlib>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "rtdata/loop/timer.hpp"
#include "sinks/killed.hpp"
#include "sinks/power_cut.hpp"
#include "sinks/recordings.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using recordings::number;
using sinks::fork_without_threads;

namespace {

struct Number {
  std::int64_t count = 0;
  friend constexpr auto describe(type_tag<Number>) { return record("number", field("count", &Number::count)); }
};

constexpr std::array<const char*, 3> topics = {"sensor", "feed", "late"};

/// What the killed program leaves beside its recording, in memory that it shares.
struct Told {
  std::atomic<bool> has_begun;
  std::array<std::atomic<std::int64_t>, topics.size()> begun;      // publishing
  std::array<std::atomic<std::int64_t>, topics.size()> published;  // it has returned
};

class Shared {
 public:
  Shared() : told_(::mmap(nullptr, sizeof(Told), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0)) {
    REQUIRE(told_ != MAP_FAILED);
  }
  Shared(const Shared&) = delete;
  ~Shared() { ::munmap(told_, sizeof(Told)); }
  Told* operator->() const { return static_cast<Told*>(told_); }  // all zeros at first

 private:
  void* told_;
};

/// By the kernel, when so much time has passed on this clock: wherever this process is then.
void kill_after(std::chrono::microseconds time, clockid_t clock) {
  sigevent event{};
  event.sigev_notify = SIGEV_SIGNAL;
  event.sigev_signo = SIGKILL;
  timer_t timer{};
  if (::timer_create(clock, &event, &timer) != 0) ::_exit(1);
  itimerspec when{};
  when.it_value.tv_nsec = static_cast<long>(time.count() * 1000);
  if (::timer_settime(timer, 0, &when, nullptr) != 0) ::_exit(1);
}

/// Records until it is killed.
[[noreturn]] void record_in(const std::string& path, unsigned seed, bool is_manual, const Shared& told) {
  std::mt19937 random(seed);
  std::optional<Loop> made;
  if (is_manual) {
    made.emplace(Loop::Manual{});
  } else {
    made.emplace();
  }
  Loop& loop = *made;
  loop.on_error([](const ErrorReport&) {});
  loop.runtime().on_log([](const LogRecord&) {});
  constexpr std::array profiles = {SqliteProfile::normal, SqliteProfile::safe, SqliteProfile::fast};
  SqliteSink sink(loop, {.path = path,
                         .profile = profiles[random() % profiles.size()],
                         .sink = {.batch_time = random() % 2 == 0 ? 2ms : 50ms}});
  told->has_begun = true;
  const auto next = [&](std::size_t topic) { return Number{++told->begun[topic]}; };
  const unsigned often = 3 + static_cast<unsigned>(random() % 40);
  // A sensor's read is published after it has returned.
  Sensor<Number> sensor(loop, {.name = "sensor", .topic = topics[0], .rate = 1_kHz, .retry_first = 1ms},
                        [&]() -> Reading<Number> {
                          told->published[0] = told->begun[0].load();
                          const auto dice = random() % often;
                          if (dice == 0) return Error{Errc::io_failed, "no answer", "", "", ""};
                          if (dice == 1) return nothing_new;
                          return next(0);
                        });
  Feed<Number> feed(loop, {.name = "feed", .topic = topics[1]});
  Feed<Number> late;
  const auto publish = [&](Feed<Number>& to, std::size_t topic) {
    to.publish(next(topic));
    ++told->published[topic];
  };
  Ticker ticker(loop, 1ms, [&](const Tick&) {
    for (auto n = random() % 20; n > 0; --n) publish(feed, 1);
    if (random() % 100 == 0 && !late) late = Feed<Number>(loop, {.name = "late", .topic = topics[2]});
    if (late) publish(late, 2);
  });
  for (;;) {
    if (is_manual) {
      loop.advance(1ms);
    } else {
      loop.run_for(1s);
    }
  }
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-26 killed at random moments: the start after it says exactly what was lost") {
    const char* const wanted = std::getenv("RTDATA_TEST_SEEDS");  // "FIRST COUNT", to look for more
    char* rest = nullptr;
    const unsigned long first = wanted != nullptr ? std::strtoul(wanted, &rest, 10) : 1;
    const unsigned long count = wanted != nullptr ? std::strtoul(rest, nullptr, 10) : 24;
    int before_it_began = 0;
    int of_unknown_names = 0;
    std::int64_t lost = 0;
    for (unsigned long seed = first; seed < first + count; ++seed) {
      CAPTURE(seed);
      std::mt19937 random(static_cast<unsigned>(seed));
      const sinks::Directory live, folder;
      ::setenv("RUNTIME_DIRECTORY", live.path.c_str(), 1);
      const std::string path = folder / "run.db";
      const Shared told;
      const bool is_manual = seed % 3 != 0;
      const bool is_by_change = seed % 3 == 1;  // of the files; otherwise anywhere
      const auto when = random();
      const pid_t child = fork_without_threads();
      if (child == 0) {
        power_cut::Disk disk;
        if (is_by_change) {
          disk.kill_at(when % 600);
        } else {
          // A loop in real time sleeps: counted in time of the processor, it would live for seconds.
          kill_after(std::chrono::microseconds{1000 + when % (is_manual ? 60000 : 400000)},
                     is_manual ? CLOCK_PROCESS_CPUTIME_ID : CLOCK_MONOTONIC);
        }
        record_in(path, static_cast<unsigned>(seed), is_manual, told);
      }
      int status = 0;
      REQUIRE(::waitpid(child, &status, 0) == child);
      REQUIRE(WIFSIGNALED(status));
      REQUIRE(WTERMSIG(status) == SIGKILL);
      recordings::start_again(path);
      ::unsetenv("RUNTIME_DIRECTORY");
      const VerifyReport report = recordings::verified(path);
      INFO(recordings::problems_of(report));
      CHECK(report.exit_code() == 0);
      if (report.runs.size() == 1) {
        ++before_it_began;
        CHECK_FALSE(told->has_begun);
        continue;
      }
      const RunReport& run = report.runs[0];
      CAPTURE(run.info.remark);
      CHECK(run.verdict == Verdict::sealed);
      CHECK(number(path, "SELECT count(*) FROM pragma_integrity_check WHERE integrity_check <> 'ok'") == 0);
      REQUIRE(run.info.lost);
      // A kill before the first transaction with the name of an origin.
      const bool has_unknown = run.info.remark.find("whose names are unknown") != std::string::npos;
      if (has_unknown) ++of_unknown_names;
      std::int64_t unsaved = 0, published_of_unknown = 0, begun_of_unknown = 0;
      for (std::size_t i = 0; i < topics.size(); ++i) {
        CAPTURE(topics[i]);
        const std::string of = std::string(" FROM rtdata_ledger WHERE run = 1 AND topic = '") + topics[i] + "'";
        if (number(path, "SELECT count(*)" + of) == 0) {
          published_of_unknown += told->published[i];
          begun_of_unknown += told->begun[i];
          continue;
        }
        const std::int64_t offered = number(path, "SELECT offered" + of);
        const std::int64_t stored = number(path, "SELECT stored" + of);
        CHECK(offered >= told->published[i]);
        CHECK(offered <= told->begun[i]);
        CHECK(number(path, "SELECT dropped_unsaved" + of) == offered - stored);
        unsaved += offered - stored;
        if (stored == 0) continue;
        const std::string rows = std::string(" FROM \"") + topics[i] + "\" WHERE run = 1";
        CHECK(number(path, "SELECT count(*)" + rows) == stored);
        CHECK(number(path, "SELECT sum(count = sequence)" + rows) == stored);
        CHECK(number(path, "SELECT max(sequence)" + rows) == stored);
      }
      const std::int64_t of_unknown = static_cast<std::int64_t>(*run.info.lost) - unsaved;
      CHECK((of_unknown > 0) == has_unknown);
      CHECK(of_unknown >= published_of_unknown);
      CHECK(of_unknown <= begun_of_unknown);
      lost += unsaved + of_unknown;
    }
    CHECK(lost > 0);
    if (wanted != nullptr) {
      MESSAGE(count << " seeds from " << first << ": " << before_it_began << " before it began, " << of_unknown_names
                    << " with unknown names, " << lost << " events lost");
    }
  }
}
