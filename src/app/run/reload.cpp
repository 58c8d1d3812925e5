#include "app/run/reload.hpp"

#include <algorithm>
#include <exception>
#include <utility>
#include <vector>

#include "app/run/data_at_risk.hpp"
#include "app/run/growth.hpp"
#include "app/run/log_file.hpp"

namespace rtdata::app {
namespace {

constexpr Duration storing_patience = std::chrono::milliseconds{2500};  // less than whoever asked for it waits
constexpr std::size_t most_told = 100;                                  // mistakes: telling them takes the loop's time

std::uint64_t refused_by_sinks(const Runtime& runtime) {
  std::uint64_t refused = 0;
  for (const SinkStatus& sink : runtime.sinks())
    refused += sink.counts.dropped[static_cast<std::size_t>(DropReason::refused)];
  return refused;
}

}  // namespace

std::shared_ptr<const Reload::NextPlan> Reload::read_again() const {
  auto next = std::make_shared<NextPlan>();
  try {
    next->plan = plan_system(registry_, load_config(options_.file));
    check_log_file(log_file_of(next->plan, options_.log_file), next->plan);
    if (next->plan.good()) {
      warn_of_growth(next->plan, growth_span);
      warn_of_losses(next->plan);
    }
  } catch (const std::exception& error) {
    next->failed = error.what();
  }
  return next;
}

void Reload::conclude(Change& change, LogLevel level, const std::string& text, std::string_view id) {
  console_.say(level, "program", change.why + ": " + text, id);
  change.told({level == LogLevel::info, console_.without_secrets(text) + change.details});
}

void Reload::add(Change& change, LogLevel level, const std::string& text, std::string_view id) {
  console_.say(level, "configuration", text, id);
  change.details += "\n" + console_.without_secrets(text);
}

bool Reload::may_be_applied(Change& change) {
  const auto refuse = [&](const std::string& text) {
    conclude(change, LogLevel::error, "nothing was changed: " + text);
    return false;
  };
  if (run_.is_ending()) return refuse("it ends already");
  if (waiting_ != nullptr) return refuse("another change is being applied");
  if (!change.read->failed.empty()) return refuse(change.read->failed);
  const SystemPlan& next = change.read->plan;
  console_.add_secrets(next.secrets);
  for (std::size_t i = 0; i < std::min(next.problems.size(), most_told); ++i)
    add(change, LogLevel::error, next.problems[i].text(), next.problems[i].id);
  if (!next.good()) {
    return refuse(std::to_string(next.problems.size()) +
                  (next.problems.size() == 1 ? " mistake in " : " mistakes in ") + options_.file +
                  (next.problems.size() > most_told ? ", the first of which are told; `rtdata check` tells all" : ""));
  }
  for (const Problem& warning : next.warnings) add(change, LogLevel::warning, warning.text(), warning.id);
  if (!run_.has_guard && !next.of_kind("output").empty())
    return refuse("the guard of outputs is started with the program: start it again");
  const PlanChange parts = system_.change_to(next);
  if (parts.refused() == 0) return true;
  for (const PartChange& part : parts.all)
    if (part.fate == Fate::refused) add(change, LogLevel::error, part.text());
  return refuse("what is refused can be done by starting the program again");
}

std::set<std::string> Reload::closing_sinks(const SystemPlan& next, bool recordings_alone) const {
  std::set<std::string> names;
  std::set<std::string> ending;
  for (const PartChange& part : system_.change_to(next).all)
    if (part.fate == Fate::restarted || part.fate == Fate::removed) ending.insert(part.object);
  for (const PartPlan* plan : system_.parts().plans())
    if (plan->stores && ending.contains(plan->object()) && (!recordings_alone || !plan->stores->is_sender))
      names.insert(plan->name);
  return names;
}

void Reload::apply(std::shared_ptr<const NextPlan> read, const std::string& why, Told told) {
  const auto change = std::make_shared<Change>(Change{std::move(read), why, std::move(told)});
  if (!may_be_applied(*change)) return;
  const std::set<std::string> sinks = closing_sinks(change->read->plan, false);
  if (sinks.empty()) return apply_now(*change);
  const auto waiting = waiting_ = std::make_shared<Waiting>();
  waiting->sinks = sinks;
  const auto end = [this, change, waiting = std::weak_ptr(waiting)] {
    const auto ended = waiting.lock();
    if (ended == nullptr || ended != waiting_) return;
    waiting_ = nullptr;
    std::string stuck;
    for (const std::string& name : closing_sinks(change->read->plan, true))
      if (ended->sinks.contains(name)) stuck += (stuck.empty() ? "" : ", ") + name;
    if (stuck.empty()) return apply_now(*change);
    conclude(*change, LogLevel::error,
             "nothing was changed: it would close " + stuck +
                 ", which cannot store what it has now, and would lose it; mend what keeps it from that, or start the "
                 "program "
                 "again");
  };
  waiting->patience = Timer(loop_, storing_patience, [this, end] { loop_.post(end); });
  for (const std::string& name : sinks) {
    system_.sink(name).sync([this, name, end, waiting = std::weak_ptr(waiting)] {
      const auto still = waiting.lock();
      if (still == nullptr) return;
      still->sinks.erase(name);
      if (still->sinks.empty()) loop_.post(end);  // not from within the sink
    });
  }
}

void Reload::apply_now(Change& change) {
  if (run_.is_ending()) return conclude(change, LogLevel::error, "nothing was changed: it ends already");
  const SystemPlan& next = change.read->plan;
  const PlanChange parts = system_.change_to(next);
  const std::uint64_t refused_before = refused_by_sinks(loop_.runtime());
  std::string failed, id;
  try {
    (void)system_.apply(next);
  } catch (const SetupError& error) {
    failed = error.what();
    id = error.error().id();
  } catch (const std::exception& error) {
    failed = error.what();
  }
  // Of a sink that was closed before it could store what it had: they are lost, as at the end of the program.
  not_stored_ += refused_by_sinks(loop_.runtime()) - refused_before;
  if (!failed.empty()) return conclude(change, LogLevel::error, "not applied: " + failed, id);
  for (const PartChange& part : parts.all)
    if (part.fate != Fate::unchanged) add(change, LogLevel::info, part.text());
  run_.applied(next);
  conclude(change, LogLevel::info,
           options_.file + " is applied" + (parts.is_empty() ? "; nothing has changed in it" : "") + ": " +
               counts_text(registry_, next));
}

}  // namespace rtdata::app
