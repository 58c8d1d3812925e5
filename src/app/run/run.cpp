#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <future>
#include <set>
#include <utility>

#include "app/control/account.hpp"
#include "app/control/commands.hpp"
#include "app/control/control_socket.hpp"
#include "app/control/readers.hpp"
#include "app/control/request.hpp"
#include "app/control/status_source.hpp"
#include "app/core/configuration_commands.hpp"
#include "app/page/page_setup.hpp"
#ifdef RTDATA_WITH_PAGE
#include "app/page/live_page.hpp"
#endif
#include "app/run/console.hpp"
#include "app/run/data_at_risk.hpp"
#include "app/run/growth.hpp"
#include "app/run/left_backlogs.hpp"
#include "app/run/reload.hpp"
#include "app/run/service.hpp"
#include "app/run/stop_signals.hpp"
#include "data/listed.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/config/change.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/outputs/guard.hpp"
#include "rtdata/outputs/output.hpp"

namespace rtdata::app {
namespace {

constexpr Duration redraw_period = std::chrono::milliseconds{500};
constexpr Duration longest_to_be_safe = std::chrono::seconds{12};  // for a slow device
constexpr Duration answer_patience = std::chrono::seconds{4};      // less than the limit of the control socket
constexpr Duration line_period = std::chrono::seconds{10};         // in a pipe, and for the service manager

/// One run, from the file to the exit status. The order of the members is their order of construction and destruction.
class Run {
 public:
  Run(const Registry& registry, const RunOptions& options)
      : registry_(registry),
        options_(options),
        document_(load_config(options.file)),
        tares_(std::filesystem::path(options.file).stem().string() + ".tare", options.file),
        guard_(start_guard(registry, document_)),
        console_(options) {}

  int execute() {
    Problems warnings;
    const std::string tares = tares_.put_into(document_.root, warnings);
    SystemPlan plan = plan_system(registry_, std::move(document_));
    plan.warnings.append(warnings);
    check_page(plan);
    console_.add_secrets(plan.secrets);
    warn_of_growth(plan, options_.duration.value_or(growth_span));
    warn_of_losses(plan);
    if (plan.good()) warn_of_left_backlogs(plan);
    console_.open_log(plan);
    const FatalSignals fatal(log_);
    log_.write(LogLevel::info, "program", "started with " + options_.file);
    if (!tares.empty())
      console_.say(LogLevel::info, "configuration", "tares as before, from " + tares_.file() + ": " + tares);
    int status = exit_other;
    try {
      status = plan.good() ? run(plan) : refuse(plan);
    } catch (const SetupError& error) {
      console_.say(LogLevel::error, "program", error.error().text(), error.error().id());
    } catch (const std::exception& error) {
      console_.say(LogLevel::error, "program", error.what(), "system");
    }
    log_.write(LogLevel::info, "program", "ended with status " + std::to_string(status));
    console_.wait_until_written();
    return status;
  }

 private:
  int refuse(const SystemPlan& plan) {
    for (const Problem& problem : plan.problems)
      log_.write(LogLevel::error, "configuration", problem.text(), problem.id);
    console_.tell(plan.report() + "rtdata: nothing was started: " + std::to_string(plan.problems.size()) +
                  (plan.problems.size() == 1 ? " mistake in " : " mistakes in ") + options_.file + "\n");
    return exit_configuration;
  }

  int run(const SystemPlan& plan) {
    for (const Problem& warning : plan.warnings) {
      if (warning.id == "cannot-write") continue;  // from the log: already reported when it was opened
      console_.say(LogLevel::warning, "configuration", warning.text(), warning.id);
    }
    Runtime::Config runtime_config = plan.runtime_config();
    runtime_config.guard = guard_.get();
    Runtime runtime(std::move(runtime_config));
    runtime.on_log(
        [this](const LogRecord& record) { console_.say(record.level, record.object, record.text, record.error_id); });
    Loop loop(runtime, plan.loop_config());
    note_sinks(plan);
    const auto where = [&loop] {
      const std::string doing = loop.core().nodes.doing();
      return doing.empty() ? "a callback" : doing;
    };
    StopSignals::Actions actions{
        [&](const char* signal) { stop(loop, signal); },
        [&] { return status_of(runtime).queued; },
        [this](const char* signal, std::optional<std::uint64_t> queued) { console_.end_at_once(signal, queued); },
        {},
        [this] {
          if (guard_ != nullptr) guard_->make_all_safe();
        },
        [this, where](const char* signal) { console_.end_hanging(signal, where()); },
        [this, where] { console_.starts_slowly(where()); }};
    struct Detach {
      StopSignals& signals;
      ~Detach() { signals.detach(); }
    };
    signals_.attach(loop, actions);
    const Detach detach_loop{signals_};
    System system(loop, registry_, plan);
    StatusSource status(loop, status_info(plan, system));
    status_ = &status;
    Readers readers(loop, loop.core().runtime.run_uuid());
    readers.set(reader_settings(plan));
    Reload reload(loop, system, registry_, options_, console_,
                  {[this] { return is_closing_; },
                   [&](const SystemPlan& next) {
                     readers.set(reader_settings(next));
                     tell_page(next);
                     note_sinks(next);
                     if (console_.leaves_stdout()) console_.close_view();
                     status.set(status_info(next, system));
                   },
                   tares_, guard_ != nullptr});
    actions.reload = [&] { loop.post([&reload] { reload.read_and_apply("SIGHUP", [](const CommandOutcome&) {}); }); };
    signals_.attach(loop, std::move(actions));
    const Detach detach_reload{signals_};
    CommandDesk desk(loop, system, tares_, [this](const std::string& text, bool done) {
      console_.say(done ? LogLevel::info : LogLevel::warning, "command", text);
    });
    std::optional<ControlSocket> control;
    open_control(control, loop, reload, status, readers, desk);
    open_page(loop, plan, status, readers, desk, control ? control->path() : "");
    const ClosePage close_page{*this};
    report_start(plan);

    console_.open_view();
    {
      Service service(loop);
      loop.post([&] { report_ready(service); });
      // Without the table nothing is shown between two lines, so the program need not wake up.
      Ticker ticker(loop,
                    Ticker::Config{.period = console_.has_view() ? redraw_period : line_period, .name = "display"},
                    [&](const Tick& tick) { show(runtime, service, tick.due); });
      if (options_.duration) {
        loop.run_for(*options_.duration);
      } else {
        loop.run();
      }
      (void)service.tell("STOPPING=1\nSTATUS=storing the queued events");
      is_closing_ = true;
      desk.end();
      reload.give_up_reading();
      set_safe(loop, system);
      ticker.set_period(redraw_period);
      not_stored_ += reload.not_stored();  // closing counts what its sinks still send
      not_stored_ += loop.close(close_deadline_);
    }
    report_holds(loop.callbacks());
    std::string hanging = stop_tiers(plan, system);
    if (const std::string reading = reload.hanging(); !reading.empty())
      hanging += (hanging.empty() ? "" : ", ") + reading;
    report_buses(system);
    console_.close_view();
    const int exit_status = report(runtime, loop.core().runtime.unknown_end,
                                   unsafe_outputs(system, runtime.config().guard), reload.end());
    if (!hanging.empty()) {
      control.reset();
      exit_while_hanging(hanging);
    }
    return exit_status;
  }

  /// Notes the paths of the sinks for the summary, and how long closing them may take.
  void note_sinks(const SystemPlan& plan) {
    close_deadline_ = plan.settings.tiers.empty() ? Duration{0} : Duration{std::chrono::seconds{2}};
    for (const PartPlan& part : plan.parts) {
      if (!part.stores) continue;
      paths_[part.name] = console_.without_secrets(part.stores->path);
      if (part.stores->path == "-") console_.leave_stdout();
      if (part.stores->is_recording) recordings_.insert(part.name);
      if (!part.stores->through.empty()) followers_.insert(part.name);
      close_deadline_ = std::max(close_deadline_, part.stores->close_deadline);
    }
  }

  StatusSource::Info status_info(const SystemPlan& plan, const System& system) const {
    StatusSource::Info info{plan.settings.name, options_.file, paths_};
    std::map<std::pair<std::string_view, std::string_view>, std::vector<std::string>> users;
    for (const PartPlan& part : plan.parts)
      for (const PartUse& use : part.uses) users[{use.kind, use.name}].push_back(part.object());
    for (const PartPlan& part : plan.parts) {
      if (part.kind == "machine") info.made = &system.parts();
      if (part.publishes && (part.kind == "output" || part.type == "limit"))
        info.changes.push_back(part.publishes->topic);
      if (part.publishes || part.stores || part.type.empty()) continue;  // these have their own status
      info.parts.push_back({{part.kind, part.name, part.type, users[{part.kind, part.name}], {}},
                            system.parts().find<Bus>(part.kind, part.name)});
    }
    return info;
  }

  /// Outputs that may not have their safe value, also those closed by a reload: "output heater, output fan".
  static std::string unsafe_outputs(const System& system, const OutputGuard* guard) {
    std::set<std::string> all;
    if (guard != nullptr)
      for (const std::string& name : guard->ended_unsafe()) all.insert(name);
    for (const std::string& name : system.parts().names("output")) {
      const Output* const output = system.parts().find<Output>("output", name);
      if (output != nullptr && output->has_ended_unsafe()) all.insert("output " + name);
    }
    return detail::listed(all);
  }
  /// Stops all tiers; reports what delayed them. Returns the tiers that do not stop: "tier fast in sensor chamber".
  std::string stop_tiers(const SystemPlan& plan, System& system) {
    std::string hanging;
    for (const auto& entry : plan.settings.tiers) {
      Tier& tier = system.tier(entry.first);
      if (tier.stop_within(std::chrono::milliseconds{100})) {
        report_holds(tier.loop().callbacks());
        continue;
      }
      const std::string where = tier.doing();
      hanging += (hanging.empty() ? "tier " : ", tier ") + entry.first + " in " +
                 (where.empty() ? "a callback" : where);
    }
    return hanging;
  }

  /// Sets all outputs safe at once, while the loop turns, so that none waits for another's device.
  static void set_safe(Loop& loop, System& system) {
    if (system.parts().names("output").empty()) return;
    system.finish_outputs([&loop] { loop.stop(); });
    loop.run_for(longest_to_be_safe);
  }

  /// Ends the program although a thread does not end, without destroying what the thread uses.
  [[noreturn]] void exit_while_hanging(const std::string& hanging) {
    console_.say(LogLevel::error, "program",
                 "ended though it hangs: " + hanging + "; the recordings have the rest of the account", "not-turning");
    log_.write(LogLevel::info, "program", "ended with status " + std::to_string(exit_other));
    log_.wait_until_written(std::chrono::seconds{1});
    console_.wait_until_written();
    ::_exit(exit_other);
  }

  static Readers::Settings reader_settings(const SystemPlan& plan) {
    Readers::Settings settings{plan.settings.control.readers};
    for (const PartPlan& part : plan.parts)
      if (part.stores && part.stores->is_recording)
        settings.recordings.push_back({part.name, part.stores->path, part.stores->topics});
    return settings;
  }

  /// Passes a reader's connection to the readers; otherwise returns the reason.
  static ControlSocket::Work serve_reader(ControlSocket& control, Readers& readers, std::uint64_t client,
                                          std::string_view line) {
    Result<StreamRequest> request = stream_request(line);
    std::string why = request ? readers.refusal(*request) : request.error().why;
    if (why.empty()) {
      const int fd = control.take_over(client);
      if (fd >= 0) {
        readers.add(fd, *std::move(request));
        return {};
      }
      why = "the program has no descriptor left";
    }
    return [why = std::move(why)] { return answer_line("error", why); };
  }

  void open_control(std::optional<ControlSocket>& control, Loop& loop, Reload& reload, StatusSource& status,
                    Readers& readers, CommandDesk& desk) {
    const auto answer = [&, this](std::uint64_t client, std::string_view line) -> ControlSocket::Work {
      if (asks_for_events(line)) return serve_reader(*control, readers, client, line);
      const std::vector<std::string> words = command_words(line);
      if (words.empty()) return status.answer(client, line);
      const std::string by = control->peer_of(client);
      if (is_closing_) return [] { return command_answer({false, "it ends already"}); };
      auto outcome = std::make_shared<std::promise<CommandOutcome>>();
      const auto tell = [outcome](const CommandOutcome& came) { outcome->set_value(came); };
      const char* late =
          "there is no result yet, such as whether it is on the disk: the loop is busy; the log will have the result";
      if (words[0] == "reload" && words.size() == 1) {
        reload.read_and_apply("reload", [&desk, words, by, tell](const CommandOutcome& came) {
          desk.keep(words, by, came);
          tell(came);
        });
        late =
            "the configuration is not applied yet: its disk does not answer, or the loop is busy, such as storing the "
            "queue of a closed sink; the log will have the result";
      } else {
        desk.run(words, by, tell);
      }
      return [outcome, late] {
        auto told = outcome->get_future();
        if (told.wait_for(answer_patience) == std::future_status::ready) return command_answer(told.get());
        return command_answer({false, late});
      };
    };
    try {
      control.emplace(loop, answer, [&status](std::uint64_t client) { status.forget(client); });
      log_.write(LogLevel::debug, "program", "control socket " + control->path());
    } catch (const SetupError& error) {
      console_.say(LogLevel::warning, "program", error.error().text(), error.error().id());
    }
  }

#ifdef RTDATA_WITH_PAGE
  void open_page(Loop& loop, const SystemPlan& plan, StatusSource& status, Readers& readers, CommandDesk& desk,
                 const std::string& socket_path) {
    if (!plan.settings.page && !options_.page) return;
    PageSettings settings = plan.settings.page.value_or(PageSettings{.listen = PageAddress{}.text()});
    if (options_.page && !options_.page->empty()) settings.listen = *options_.page;
    const bool is_any_port = options_.page && options_.page->empty() && !plan.settings.page;
    const PageAddress address = parse_page_address(settings.listen).or_throw();
    auto listener = PageListener::open(address,
                                       is_any_port ? PageListener::TakenPort::next : PageListener::TakenPort::refuse);
    const std::string token = settings.token.empty() ? make_page_token() : settings.token;
    const auto command = [this, &desk](std::vector<std::string> words, std::string by,
                                       std::function<void(std::string)> told) {
      if (is_closing_) return told(command_answer({false, "it ends already"}));
      desk.run(words, by, [told = std::move(told)](const CommandOutcome& came) { told(command_answer(came)); });
    };
    page_ = std::make_unique<LivePage>(loop,
                                       LivePage::Config{std::move(listener).or_throw(), settings, token, socket_path},
                                       plan, LivePage::Asks{&status, &readers, command});
    log_.write(LogLevel::info, "page",
               page_->address() + (page_->file().empty() ? "" : "; with its token in " + page_->file()));
    if (options_.talk == Talk::normal) console_.tell("rtdata: page: " + page_->address() + "#token=" + token + "\n");
    if (!address.is_loopback() && !settings.tls && !settings.behind_tls_proxy)
      console_.say(LogLevel::warning, "page",
                   "others on the network can reach the page, and read what it sends, because it is not encrypted: see "
                   "docs/page.md");
  }
  void tell_page(const SystemPlan& next) {
    if (page_ != nullptr) page_->set(next);
  }
  void end_page() { page_.reset(); }
#else
  void open_page(Loop&, const SystemPlan&, StatusSource&, Readers&, CommandDesk&, const std::string&) {}
  void tell_page(const SystemPlan&) {}
  void end_page() {}
#endif
  struct ClosePage {
    Run& of;
    ~ClosePage() { of.end_page(); }
  };

  void report_start(const SystemPlan& plan) {
    std::string text = "running " + plan.settings.name + ": " + counts_text(registry_, plan);
    if (options_.duration) text += ", for " + to_string(*options_.duration);
    text += log_.file().empty() ? "" : "; log " + log_.file();
    if (!options_.duration) text += "; Ctrl-C ends it";
    console_.say(LogLevel::info, "", text);
    for (const LoopLoad& load : plan.loads()) {
      const std::string told = "readings may hold " + load.text();
      if (load.is_overloaded()) {
        console_.say(LogLevel::info, "", told);
      } else {
        log_.write(LogLevel::info, "program", told);
      }
    }
  }

  /// Called when the loop and its tiers turn.
  void report_ready(Service& service) {
    const auto told = service.tell("READY=1\nSTATUS=running");
    if (!told) console_.say(LogLevel::warning, "program", told.error().text(), told.error().id());
  }

  /// Logs the callbacks that held the loop, with their times.
  void report_holds(const std::vector<CallbackStatus>& callbacks) {
    for (const CallbackStatus& callback : callbacks) {
      const CallbackTimes& times = callback.times;
      if (times.held == 0) continue;
      log_.write(LogLevel::info, callback.name,
                 "held the loop " + std::to_string(times.held) + " times in " + std::to_string(times.count) +
                     " calls of " + to_string(times.total) + " together; 99 of 100 took at most " +
                     to_string(times.p99()) + ", the longest " + to_string(times.max) +
                     (callback.place.empty() ? "" : "; made at " + callback.place));
    }
  }

  /// Logs the transfer counts of each place on each bus.
  void report_buses(const System& system) {
    for (const std::string& name : system.parts().names("bus")) {
      const Bus* bus = system.parts().find<Bus>("bus", name);
      if (bus == nullptr) continue;
      for (const auto& [place, counts] : bus->place_counts()) {
        if (counts.transfers == 0) continue;
        log_.write(counts.failed > 0 ? LogLevel::warning : LogLevel::info, "bus " + name,
                   place + ": " + std::to_string(counts.transfers) + " transfers, " + std::to_string(counts.failed) +
                       " failed, " + std::to_string(counts.retried) + " retries; they held it for " +
                       to_string(counts.busy) + ", the longest for " + to_string(counts.longest) +
                       (counts.skipped_bytes > 0 ? "; " + std::to_string(counts.skipped_bytes) +
                                                       " bytes of noise or late answers were skipped"
                                                 : ""));
      }
    }
  }

  void stop(Loop& loop, const char* signal) {
    is_storing_reported_ = true;
    if (is_closing_) {  // stopping the loop would end the closing
      console_.say(LogLevel::info, "program",
                   std::string(signal) +
                       ": the queued events are already being stored (a second one ends the program at once; they are "
                       "then lost)");
      draw();
      return;
    }
    console_.say(LogLevel::info, "program",
                 std::string("stopping on ") + signal +
                     ": storing the queued events (a second one ends the program at once; they are then lost)");
    draw();
    loop.stop();
  }

  /// The view is its own client of the status.
  void draw() {
    constexpr std::uint64_t view = 0;
    if (console_.has_view() && status_ != nullptr) console_.draw(status_->take(view));
  }

  /// Shows a message if storing the queue at the end takes more than half a second.
  void report_storing(std::uint64_t queued) {
    if (is_storing_reported_ || ++shows_while_closing_ < 2 || queued == 0) return;
    is_storing_reported_ = true;
    console_.say(LogLevel::info, "program",
                 "storing the queued events: " + std::to_string(queued) +
                     (queued == 1 ? " event, for at most " : " events, for at most ") + to_string(close_deadline_) +
                     " (Ctrl-C twice ends at once)");
  }

  void show(Runtime& runtime, Service& service, MonotonicTime due) {
    if (last_line_ == MonotonicTime{}) last_line_ = due;
    const bool is_line_due = due - last_line_ >= line_period;
    if (is_line_due) last_line_ = due;
    if (is_line_due) (void)service.tell("STATUS=" + progress(status_of(runtime)));
    console_.report_log_failure();
    if (is_closing_) report_storing(status_of(runtime).queued);
    draw();
    if (is_line_due && !console_.has_view()) console_.say(LogLevel::info, "", progress(status_of(runtime)));
  }

  /// `unknown`: what the account does not contain; empty: it is complete.
  int report(Runtime& runtime, const std::string& unknown, const std::string& unsafe,
             const std::set<std::string>& not_made) {
    console_.report_log_failure();
    const Status status = status_of(runtime, paths_);
    Ending ending{unknown.empty() && runtime.balances(), runtime.has_loss(), unknown, not_stored_};
    ending.not_made = detail::listed(not_made);
    bool is_all_stored = not_stored_ == 0 && not_made.empty();
    for (const Status::Sink& sink : status.sinks) {
      if (followers_.contains(sink.name) && !sink.backlog)
        ending.unknown_backlogs.push_back("sink " + sink.name + (sink.reason.empty() ? "" : ": " + sink.reason));
      constexpr auto refused = static_cast<std::size_t>(DropReason::refused);
      if (recordings_.contains(sink.name) && sink.dropped[refused] != 0) is_all_stored = false;  // by the disk
      if (sink.is_recording && sink.recorded == nullptr) ending.not_closed.push_back(sink.path);
    }
    is_all_stored = is_all_stored && ending.unknown_backlogs.empty() && ending.not_closed.empty();
    std::string said = verdict(status, ending);
    if (!unsafe.empty()) said += "; NOT known to be safe: " + unsafe;
    const LogLevel level = !ending.balances || !is_all_stored || !unsafe.empty() ? LogLevel::error
                           : ending.has_loss || !status.mute.empty()             ? LogLevel::warning
                                                                                 : LogLevel::info;
    console_.report(level, status, said);
    if (ending.balances && ending.has_loss && options_.on_loss == OnLoss::fail) return exit_loss;
    return ending.balances && is_all_stored && unsafe.empty() ? exit_good : exit_other;
  }

  /// Starts the guard for a file with outputs, before there are threads and so before the file is checked. A file with
  /// mistakes gets no guard.
  static std::unique_ptr<OutputGuard> start_guard(const Registry& registry, const ConfigDocument& document) {
    const ConfigItem* const outputs = document.root.find("outputs");
    if (outputs == nullptr || outputs->size() == 0) return nullptr;
    return std::make_unique<OutputGuard>([&registry](const std::string& what) { return registry.make_actuator(what); });
  }

  const Registry& registry_;
  const RunOptions& options_;
  ConfigDocument document_;                   // until it is checked
  Tares tares_;                               // in the working directory, as the log
  const std::unique_ptr<OutputGuard> guard_;  // null: the file has no outputs
  StopSignals signals_;                       // before the others, so that their threads do not get the signals
  RunConsole console_;
  Log& log_ = console_.log();
  StatusSource* status_ = nullptr;  // null: none now
#ifdef RTDATA_WITH_PAGE
  std::unique_ptr<LivePage> page_;
#endif
  MonotonicTime last_line_{};
  bool is_closing_ = false;
  Duration close_deadline_{0};
  std::map<std::string, std::string> paths_;  // of the sinks, also of closed ones
  std::set<std::string> recordings_;          // of the sinks
  std::set<std::string> followers_;           // sinks with `through`
  bool is_storing_reported_ = false;
  unsigned shows_while_closing_ = 0;
  std::uint64_t not_stored_ = 0;  // lost when sinks ended
};

}  // namespace

int run(const Registry& registry, const RunOptions& options) { return Run(registry, options).execute(); }

}  // namespace rtdata::app
