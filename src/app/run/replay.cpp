// rtdata replay: publishes the events of a recording to the sinks of a configuration or the terminal, run by run.
#include "rtdata/recording/replay.hpp"
#include "app/core/terminal_text.hpp"

#include <sys/stat.h>

#include <algorithm>
#include <atomic>
#include <iostream>
#include <optional>
#include <set>
#include <vector>

#include "app/control/commands.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/core/recording_commands.hpp"
#include "app/run/log.hpp"
#include "app/run/passing_time.hpp"
#include "app/run/stop_signals.hpp"
#include "data/saturating.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "recording/replay_choice.hpp"
#include "rtdata/config/read.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/loop/topic.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/runs.hpp"
#include "rtdata/sinks/console.hpp"

namespace rtdata::app {
namespace {

bool is_same_file(const std::string& a, const std::string& b) {
  struct stat of_a {
  }, of_b{};
  return ::stat(a.c_str(), &of_a) == 0 && ::stat(b.c_str(), &of_b) == 0 && of_a.st_dev == of_b.st_dev &&
         of_a.st_ino == of_b.st_ino;
}

/// True if the part derives its events from other parts.
bool follows_others(const PartPlan& part) {
  return part.kind == "machine" ||
         (part.kind == "sensor" && (part.type == "derived" || part.type == "limit" || part.type == "vertical"));
}

/// Makes machines begin in their start state, without regard to recordings.
void forget_pauses(ConfigItem& root) {
  ConfigItem* machines = root.is_object() ? root.find("machines") : nullptr;
  if (machines == nullptr || !machines->is_array()) return;
  for (std::size_t i = 0; i < machines->size(); ++i)
    if (ConfigItem* one = machines->find(i); one->is_object()) one->remove("resume");
}

/// The parts of a configuration that take events, without parts that read devices and the parts that these need.
SystemPlan takers_of(const Registry& registry, const ReplayOptions& options) {
  ConfigDocument document = load_config(options.configuration);
  forget_pauses(document.root);
  SystemPlan plan = plan_system(registry, std::move(document));
  if (!plan.good()) return plan;
  std::size_t sensors = 0;
  std::string outputs;
  std::erase_if(plan.parts, [&](const PartPlan& part) {
    if (follows_others(part)) return false;
    if (part.kind == "sensor") ++sensors;
    if (part.kind == "output") outputs += (outputs.empty() ? "output " : ", ") + part.name;
    return part.kind == "sensor" || part.kind == "bus" || part.kind == "tier" || part.kind == "output";
  });
  for (PartPlan& part : plan.parts)
    std::erase_if(part.uses, [](const PartUse& use) { return use.kind == "tier" || use.kind == "output"; });
  plan.settings.tiers.clear();
  if (!outputs.empty() && !options.is_quiet)
    std::cerr << "rtdata: not made: " << outputs << " of " << options.configuration << ": a replay sets no device\n";
  if (sensors > 0 && !options.is_quiet) {
    std::cerr << "rtdata: " << sensors << (sensors == 1 ? " sensor" : " sensors") << " of " << options.configuration
              << (sensors == 1 ? " is" : " are") << " not made: events come from " << options.config.file << "\n";
  }
  for (const PartPlan& part : plan.parts) {
    if (part.stores && is_same_file(part.stores->path, options.config.file)) {
      throw SetupError({Errc::bad_argument, "cannot replay", options.config.file,
                        "sink " + part.name + " records into it: the replayed events would be recorded again",
                        "record into another file"});
    }
  }
  return plan;
}

/// Removes the parts whose events the replay publishes.
void leave_out_recorded(SystemPlan& plan, const Recording& recording, const RunInfo& run, const ReplayConfig& config,
                        bool is_quiet) {
  std::set<std::string> given, recorded;
  for (const RecordedTopic& topic : recording.topics().or_throw()) recorded.insert(topic.topic);
  for (const LedgerEntry& entry : recording.ledger(run.run).or_throw()) {
    const bool is_wanted = std::any_of(config.topics.begin(), config.topics.end(),
                                       [&](const std::string& pattern) { return topic_matches(pattern, entry.topic); });
    if (is_wanted && recorded.contains(entry.topic)) given.insert(config.prefix + entry.origin);
  }
  std::erase_if(plan.parts, [&](const PartPlan& part) {
    if (!follows_others(part) || !given.contains(part.name)) return false;
    if (!is_quiet)
      std::cerr << "rtdata: " << part.object() << " is not made: " << config.file << " has events under that name\n";
    return true;
  });
}

/// Adds the clock pairs of a run's boot, so that a new recording has the same UTC.
void give_clock(const Recording& recording, const RunInfo& run, Loop& loop) {
  detail::RuntimeCore& runtime = loop.runtime().core();
  for (const RunInfo& other : recording.runs().or_throw()) {
    if (other.boot_id != run.boot_id) continue;
    for (const RecordedClock& pair : recording.clock(other.run).or_throw()) {
      const Time at{pair.monotonic.time_since_epoch() + run.clock_offset};
      for (detail::Recorder* recorder : runtime.recorders)
        recorder->on_clock(
            {runtime.clock_log.monotonic_of(at), pair.realtime, pair.source, pair.accuracy, "regular", pair.suspended});
    }
  }
}

/// The machine's monotonic clock with the time of day of the recorded run. The run has its own boot id, because its
/// clock pairs are not valid for other recordings of this machine.
class RunClock final : public SystemClock {
 public:
  explicit RunClock(Time realtime) { set_realtime(realtime); }
  Time realtime() noexcept override { return Time{monotonic().time_since_epoch() + offset_}; }
  std::string boot_id() override { return boot_.boot_id(); }
  std::optional<Duration> accuracy() noexcept override { return std::nullopt; }
  void set_realtime(Time time) noexcept { offset_ = time.time_since_epoch() - monotonic().time_since_epoch(); }

 private:
  ManualClock boot_;
  Duration offset_{0};
};

/// For a run in virtual time: both clocks start as in the recorded run at `begin`.
ManualClock clock_of(const RunInfo& run, Time begin) {
  const Duration since_boot = detail::difference(run.clock_offset, begin.time_since_epoch());
  if (since_boot <= Duration{0} || since_boot == Duration::max()) return ManualClock(begin);
  ManualClock clock(Time{run.clock_offset});
  clock.pass(since_boot);
  return clock;
}

/// As Loop::close, but senders get real time to finish.
std::uint64_t close_in_virtual_time(Loop& loop) {
  constexpr Duration deadline = std::chrono::seconds{10};
  std::uint64_t lost = 0;
  bool is_closed = false;
  loop.drain(deadline, [&](std::uint64_t count) {
    lost = count;
    is_closed = true;
    loop.stop();
  });
  pass_time(loop, [&] { return is_closed; });
  return lost;
}

/// Reports events that sinks dropped or did not store, except those already dropped in the recording. False: none.
bool report_drops(const Runtime& runtime, std::uint64_t dropped_before) {
  bool is_any = false;
  for (const SinkStatus& sink : runtime.sinks()) {
    const std::uint64_t refused = sink.counts.dropped[static_cast<std::size_t>(DropReason::refused)];
    const std::uint64_t others = sink.counts.all_dropped() - refused;
    const std::uint64_t dropped = refused + (others > dropped_before ? others - dropped_before : 0);
    is_any = is_any || dropped > 0 || (sink.health == Health::faulted && !sink.backlog);
    if (dropped == 0) continue;
    std::cerr << "rtdata: error: sink " << sink.name << " dropped " << dropped << (dropped == 1 ? " event" : " events")
              << std::endl;
  }
  return is_any;
}

class ReplayRun {
 public:
  ReplayRun(const Registry& registry, const ReplayOptions& options) : registry_(registry), options_(options) {}

  int execute() {
    const Recording recording = Recording::open(options_.config.file).or_throw();
    std::vector<RunInfo> runs = recording.runs().or_throw();
    if (options_.run) runs = {find_run(runs, *options_.run, recording.path()).or_throw()};
    if (runs.empty()) {
      throw SetupError({Errc::not_found, "cannot replay", options_.config.file, "it has no run",
                        "nothing was recorded into it, or it is damaged: see `rtdata verify`"});
    }
    std::optional<SystemPlan> plan;
    if (!options_.configuration.empty()) {
      plan = takers_of(registry_, options_);
      if (!plan->good()) {
        std::cerr << plan->report() << std::flush;
        return exit_configuration;
      }
    }
    for (const RunInfo& run : runs) {
      if (is_stopped_) break;
      try {
        give(recording, run, plan ? &*plan : nullptr);
      } catch (const SetupError& error) {
        // Some of several runs may have no matching events.
        if (runs.size() == 1 || error.error().code != make_error_code(Errc::not_found)) throw;
        last_missing_ = error.error();
      }
    }
    if (replayed_ == 0 && last_missing_) throw SetupError(*last_missing_);
    return status_;
  }

 private:
  void give(const Recording& recording, const RunInfo& run, const SystemPlan* plan) {
    ReplayConfig config = options_.config;
    config.run = run.run;
    // The loop has the run's clock, so that it shows recorded times.
    const Time asked = detail::beginning_of(recording, run, config);
    const Time begin = std::clamp(asked, run.started, std::max(run.started, run.ended.value_or(asked)));
    ManualClock clock = clock_of(run, begin);
    RunClock real_clock(begin - std::chrono::seconds{1});  // time passes while sinks are opened
    Runtime::Config runtime_config = plan != nullptr ? plan->runtime_config() : Runtime::Config{};
    runtime_config.clock = options_.is_virtual ? static_cast<Clock*>(&clock) : &real_clock;
    if (runtime_config.name.empty() || plan == nullptr) runtime_config.name = run.name;
    Runtime runtime(std::move(runtime_config));
    runtime.on_log([&](const LogRecord& record) {
      if (record.level < (options_.is_quiet ? LogLevel::warning : LogLevel::info)) return;
      print_error(std::cerr,
                  (record.level >= LogLevel::warning ? std::string(name_of(record.level)) + ": " : "") +
                      std::string(record.object) + ": " + std::string(record.text),
                  record.error_id);
    });
    runtime.core().clock_log.repeat_run();
    Loop loop(runtime, {.name = "replay"});
    std::optional<System> system;
    std::optional<ConsoleSink> console;
    Subscription commands;
    if (plan != nullptr) {
      SystemPlan parts = *plan;
      leave_out_recorded(parts, recording, run, options_.config, options_.is_quiet);
      system.emplace(loop, registry_, parts);
      commands = loop.subscribe<CommandRecord>(
          command_topic, [&](const Event<CommandRecord>& event) { repeat_command(*system, *event); });
    } else {
      console.emplace(loop, ConsoleConfig{});
    }
    give_clock(recording, run, loop);
    const Time utc = recording.utc_line(run.run).or_throw().utc(begin);
    if (const Duration moved = utc - begin; std::chrono::abs(moved) > std::chrono::milliseconds{1}) {
      clock.set_realtime(clock.realtime() + moved);
      real_clock.set_realtime(real_clock.realtime() + moved);
    }
    std::optional<Error> failed;
    Replay replay(loop, config);
    bool is_done = false;
    replay.on_done([&](const Result<void>& how) {
      is_done = true;
      if (!how) failed = how.error();
      loop.stop();
    });
    signals_.attach(loop, {[&](const char*) {
                             is_stopped_ = true;
                             loop.stop();
                           },
                           [] { return std::uint64_t{0}; },
                           [](const char*, std::optional<std::uint64_t>) { ::_exit(exit_other); }, [] {}});
    if (options_.is_virtual) {
      pass_time(loop, [&] { return is_done || is_stopped_; });
    } else {
      while (!is_done && !is_stopped_) loop.run();
    }
    signals_.detach();
    const ReplayCounts counts = replay.counts();
    const std::uint64_t lost = options_.is_virtual ? close_in_virtual_time(loop) : loop.close();
    replayed_ += counts.events;
    const bool has_dropped = report_drops(runtime, counts.dropped);
    if (counts.refused > 0 || is_stopped_ || lost > 0 || has_dropped) status_ = std::max(status_, exit_other);
    if (failed) status_ = std::max(status_, status_after(*failed));
  }

  const Registry& registry_;
  const ReplayOptions& options_;
  StopSignals signals_;
  std::atomic<bool> is_stopped_{false};
  std::optional<Error> last_missing_;
  std::uint64_t replayed_ = 0;
  int status_ = exit_good;
};

}  // namespace

int replay(const Registry& registry, const ReplayOptions& options) {
  try {
    return ReplayRun(registry, options).execute();
  } catch (const SetupError& error) {
    print_error(std::cerr, error.error());
    return status_after(error.error());
  }
}

}  // namespace rtdata::app
