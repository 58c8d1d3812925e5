// `rtdata forward DB FILE`: sends the waiting events of a recording with the sinks of a configuration that have
// `through`.
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <iostream>
#include <optional>

#include "app/core/amounts.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/core/recording_commands.hpp"
#include "app/core/terminal_text.hpp"
#include "app/run/left_backlogs.hpp"
#include "app/run/stop_signals.hpp"
#include "config/read/mistakes.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::app {
namespace {

using config_detail::text_or_empty;

constexpr Duration look_period = std::chrono::milliseconds{200};
constexpr Duration line_period = std::chrono::seconds{10};

/// The recording of the configuration that corresponds to `database`: the only one used by `through`, else the one with
/// the same senders or the same file name. Several: ambiguous.
std::vector<std::string> recordings_of(const ConfigItem& sinks, const Recording& database) {
  std::vector<std::string> all, known, namesakes;
  const auto add = [](std::vector<std::string>& to, const std::string& name) {
    if (!name.empty() && std::find(to.begin(), to.end(), name) == to.end()) to.push_back(name);
  };
  const std::vector<RecordedBacklog> backlogs = database.backlogs().or_throw();
  for (const ConfigChild& sink : sinks.children()) {
    const std::string through = text_or_empty(sink.item, "through"), name = sink_name(sink.item);
    add(all, through);
    const auto is_it = [&](const RecordedBacklog& one) { return one.sink == name; };
    if (std::any_of(backlogs.begin(), backlogs.end(), is_it)) add(known, through);
  }
  if (all.size() <= 1) return all;
  if (known.size() == 1) return known;
  for (const ConfigChild& sink : sinks.children()) {
    const std::string path = text_or_empty(sink.item, "path"), name = text_or_empty(sink.item, "name");
    const std::string& called = name.empty() ? path : name;
    const bool is_namesake = std::filesystem::path(path).filename() ==
                             std::filesystem::path(database.path()).filename();
    if (is_namesake && std::find(all.begin(), all.end(), called) != all.end()) add(namesakes, called);
  }
  return namesakes.size() == 1 ? namesakes : all;
}

/// The configuration reduced to its recording, now at `database`, and the sinks with `through` to it. Items keep their
/// places in the file.
ConfigItem forwarding_configuration(const ConfigItem& root, const std::vector<std::string>& recordings,
                                    const std::string& database, std::vector<std::string>& senders) {
  const ConfigItem* sinks = root.find("sinks");
  ConfigItem kept = ConfigItem::array();
  for (const ConfigChild& sink : sinks->children()) {
    const std::string name = sink_name(sink.item);
    if (std::find(recordings.begin(), recordings.end(), name) != recordings.end()) {
      ConfigItem recording = sink.item;
      recording.set("name", name);
      recording.set("path", database);
      // All its events must be sent, whatever their age.
      recording.set("max_age", "0 s");
      recording.set("max_bytes", 0);
      kept.push_back(recording);
    } else if (std::find(recordings.begin(), recordings.end(), text_or_empty(sink.item, "through")) !=
               recordings.end()) {
      senders.push_back(name);
      kept.push_back(sink.item);
    }
  }
  ConfigItem result = ConfigItem::object();
  if (const ConfigItem* name = root.find("name")) result.set("name", *name);
  result.set("notes", "sent the backlog of this recording");
  result.set("sinks", kept);
  return result;
}

class Forward {
 public:
  explicit Forward(const ForwardOptions& options) : options_(options) {}

  int run(const Registry& registry) {
    std::optional<Recording> database(Recording::open(options_.database).or_throw());
    // Other parts, such as devices and folders, need not exist on this machine.
    const ConfigDocument whole = load_config(options_.file);
    std::vector<std::string> senders;
    const ConfigItem* sinks = whole.root.find("sinks");
    const auto recordings = sinks != nullptr ? recordings_of(*sinks, *database) : std::vector<std::string>();
    database.reset();
    if (recordings.size() > 1) {
      std::string text = "sinks of " + options_.file + " go through " + std::to_string(recordings.size()) +
                         " recordings,";
      for (const std::string& name : recordings) text += " \"" + name + "\"";
      print_error(std::cerr,
                  text + "; it is not known which of these " + options_.database +
                      " is: none of them has its file name, and its positions fit none or several of them; "
                      "make a copy of the configuration without the other recordings",
                  "bad-configuration");
      return exit_configuration;
    }
    ConfigItem root;
    if (!recordings.empty()) root = forwarding_configuration(whole.root, recordings, options_.database, senders);
    if (senders.empty()) {
      if (const SystemPlan plan = plan_system(registry, whole); !plan.good()) return refuse(plan);
      print_error(std::cerr,
                  "nothing to do: no sink of " + options_.file +
                      " goes through a recording; give one `through`, the name of its recording",
                  "bad-configuration");
      return exit_configuration;
    }
    ConfigDocument document = parse_config(root.to_json(), options_.file);
    document.root = std::move(root);
    SystemPlan plan = plan_system(registry, std::move(document));
    if (!plan.good()) {
      plan.document.text = whole.text;
      return refuse(plan);
    }
    return send(registry, plan, senders);
  }

 private:
  static int refuse(const SystemPlan& plan) {
    std::cerr << plan.report() << "rtdata: nothing was sent\n";
    return exit_configuration;
  }

  int send(const Registry& registry, const SystemPlan& plan, const std::vector<std::string>& senders) {
    StopSignals signals;
    Runtime runtime(plan.runtime_config());
    runtime.on_log([](const LogRecord& record) {
      if (record.level >= LogLevel::warning)
        print_error(std::cerr, std::string(record.object) + ": " + std::string(record.text), record.error_id);
    });
    Loop loop(runtime, plan.loop_config());
    System system(loop, registry, plan);
    signals.attach(loop, {[&](const char*) { loop.stop(); },
                          [&] { return waiting(system, senders); },
                          [](const char*, std::optional<std::uint64_t>) { ::_exit(exit_other); },
                          [] {},
                          {},
                          [](const char*) { ::_exit(exit_other); }});
    struct Detach {
      StopSignals& signals;
      ~Detach() { signals.detach(); }
    } const detach{signals};
    MonotonicTime told = loop.now();
    int quiet = 0;  // consecutive checks without waiting events, with all sinks ok
    Ticker look(loop, {.period = look_period, .name = "look"}, [&](const Tick& tick) {
      if (tick.now - told >= line_period) {
        told = tick.now;
        std::cout << progress(system, senders) << std::endl;
      }
      const bool is_done = waiting(system, senders) == 0 && are_well(system, senders);
      quiet = is_done ? quiet + 1 : 0;
      if (quiet == 3) loop.stop();
    });
    loop.run();
    look.close();
    loop.close(std::chrono::seconds{10});
    std::uint64_t left = 0, sent = 0, refused = 0;
    bool is_known = true;
    for (const SinkStatus& sink : runtime.sinks()) {
      if (std::find(senders.begin(), senders.end(), sink.name) == senders.end()) continue;
      std::cout << line(sink) << "\n";
      left += sink.counts.queued;
      sent += sink.counts.stored;
      refused += sink.counts.all_dropped();
      is_known = is_known && sink.backlog.has_value();
    }
    left += report_others(senders);
    const bool is_all = left == 0 && refused == 0 && is_known;
    std::cout << (is_all     ? "all is sent: "
                  : is_known ? "not all is sent: "
                             : "it is not known which events were to be sent: ")
              << sent << " events, " << refused << " dropped, " << left << " wait" << std::endl;
    return is_all ? exit_good : exit_other;
  }

  /// Reports events that wait for sinks missing in the configuration, and returns their number.
  std::uint64_t report_others(const std::vector<std::string>& senders) const {
    const auto recording = Recording::open(options_.database).or_throw();
    std::uint64_t sum = 0;
    for (const RecordedBacklog& other : backlogs_of_others(recording, senders).or_throw()) {
      std::cout << other.sink << ": " << waiting_text({other.events, other.bytes, {}, {}}) << ", but " << options_.file
                << " has no sink of that name that goes through a recording\n";
      sum += other.events;
    }
    return sum;
  }

  static std::uint64_t waiting(System& system, const std::vector<std::string>& senders) {
    std::uint64_t sum = 0;
    for (const std::string& name : senders) sum += system.sink(name).counts().queued;
    return sum;
  }
  static bool are_well(System& system, const std::vector<std::string>& senders) {
    return std::all_of(senders.begin(), senders.end(), [&](const std::string& name) {
      const SinkStatus status = system.sink(name).status();
      return status.health == Health::ok && status.backlog;
    });
  }
  static std::string line(const SinkStatus& sink) {
    return sink.name + ": " + std::to_string(sink.counts.stored) + " sent, " +
           std::to_string(sink.counts.all_dropped()) + " dropped, " + std::to_string(sink.counts.queued) + " wait" +
           (sink.reason.empty() ? "" : " (" + sink.reason + ")");
  }
  static std::string progress(System& system, const std::vector<std::string>& senders) {
    std::string text;
    for (const std::string& name : senders) text += (text.empty() ? "" : "; ") + line(system.sink(name).status());
    return text;
  }

  const ForwardOptions& options_;
};

}  // namespace

int forward(const Registry& registry, const ForwardOptions& options) try {
  return Forward(options).run(registry);
} catch (const SetupError& error) {
  print_error(std::cerr, error.error());
  return status_after(error.error());
}

}  // namespace rtdata::app
