#include "app/run/reload.hpp"

#include <algorithm>
#include <chrono>
#include <exception>
#include <filesystem>
#include <future>
#include <system_error>
#include <utility>
#include <vector>

#include "app/core/amounts.hpp"
#include "app/run/data_at_risk.hpp"
#include "app/run/growth.hpp"
#include "app/run/left_backlogs.hpp"
#include "app/run/log_file.hpp"
#include "app/run/new_files.hpp"
#include "data/listed.hpp"

namespace rtdata::app {
namespace {

constexpr Duration device_look = std::chrono::milliseconds{5};
constexpr Duration storing_patience = std::chrono::milliseconds{2500};  // less than the client waits
constexpr std::size_t most_reported = 100;                              // reporting takes the loop's time
constexpr Duration step_time = std::chrono::milliseconds{2};            // of a turn

}  // namespace

void Reload::read(NextPlan& next) const try {
  ConfigDocument document;
  std::error_code none;
  if (std::filesystem::exists(options_.file, none) && !std::filesystem::is_regular_file(options_.file, none)) {
    document.file = options_.file;  // a FIFO would be waited for
    document.problems.add("cannot-read", {.file = options_.file}, "",
                          "cannot read the configuration: it is not a regular file");
  } else {
    document = load_config(options_.file);
  }
  Problems warnings;
  run_.tares.put_into(document.root, warnings);
  next.plan = plan_system(registry_, std::move(document));
  next.plan.warnings.append(warnings);
  check_log_file(log_file_of(next.plan, options_.log_file), next.plan);
  if (next.plan.good()) {
    warn_of_growth(next.plan, growth_span);
    warn_of_losses(next.plan);
  }
} catch (const std::exception& error) {
  next.failed = detail::reason_of(error);
}

struct Reload::Reading final : detail::LaneJob {
  Reading(Reload& reload, const std::string& why, Told told) : reload_(reload), why_(why), told_(std::move(told)) {
    ++reload_.readings_;
    reload_.reads_.push_back(has_read_.get_future());
  }
  void run() noexcept override {
    reload_.read(*next_);
    has_read_.set_value();
  }
  void done(Outcome outcome) override {
    --reload_.readings_;
    if (outcome == Outcome::cancelled) return;
    if (outcome == Outcome::given_up) {  // its thread may still write the plan
      next_ = std::make_shared<NextPlan>();
      next_->failed = "reading " + reload_.options_.file + " takes longer than " + to_string(reading_limit);
    }
    reload_.apply(next_, why_, told_);
  }

 private:
  Reload& reload_;
  const std::string why_;
  const Told told_;
  std::shared_ptr<NextPlan> next_ = std::make_shared<NextPlan>();
  std::promise<void> has_read_;
};

void Reload::read_and_apply(const std::string& why, Told told) {
  if (run_.is_ending()) return told({false, "it ends already"});
  std::erase_if(reads_, [](const auto& one) { return one.wait_for(Duration{0}) == std::future_status::ready; });
  const auto reading = std::make_shared<Reading>(*this, why, std::move(told));
  if (!reading_lane_.submit(reading)) reading->done(detail::LaneJob::Outcome::given_up);  // others hang
}

void Reload::give_up_reading() {
  while (readings_ > 0) reading_lane_.give_up();
}

std::string Reload::hanging() const {
  const auto until = std::chrono::steady_clock::now() + std::chrono::milliseconds{500};
  const auto hangs = [&](const auto& one) { return one.wait_until(until) != std::future_status::ready; };
  return std::any_of(reads_.begin(), reads_.end(), hangs) ? "reading " + options_.file : "";
}

const std::set<std::string>& Reload::end() {
  if (const auto change = under_way_) conclude(*change, LogLevel::error, "not finished: the program ends");
  return system_.not_made();
}

void Reload::conclude(Change& change, LogLevel level, const std::string& text, std::string_view id) {
  console_.say(level, "program", change.why + ": " + text, id);
  change.told({level == LogLevel::info, console_.without_secrets(text) + change.details});
  if (under_way_.get() == &change) {
    under_way_ = nullptr;
    begin_next();
  }
  loop_.post([read = std::move(change.read)] {});  // destroying many parts needs a separate turn
}

void Reload::refuse(Change& change, const std::string& text) {
  conclude(change, LogLevel::error, "nothing was changed: " + text, "refused");
}

void Reload::add(Change& change, LogLevel level, const std::string& text, std::string_view id) {
  console_.say(level, "configuration", text, id);
  change.details += "\n" + console_.without_secrets(text);
}

bool Reload::may_be_applied(Change& change) {
  const auto refused = [&](const std::string& text) {
    refuse(change, text);
    return false;
  };
  if (run_.is_ending()) return refused("it ends already");
  if (!change.read->failed.empty()) return refused(change.read->failed);
  const SystemPlan& next = change.read->plan;
  console_.add_secrets(next.secrets);
  for (std::size_t i = 0; i < std::min(next.problems.size(), most_reported); ++i)
    add(change, LogLevel::error, next.problems[i].text(), next.problems[i].id);
  if (!next.good()) {
    return refused(
        std::to_string(next.problems.size()) + (next.problems.size() == 1 ? " mistake in " : " mistakes in ") +
        options_.file +
        (next.problems.size() > most_reported ? ", the first of which are shown; `rtdata check` shows all" : ""));
  }
  for (const Problem& warning : next.warnings) add(change, LogLevel::warning, warning.text(), warning.id);
  if (!run_.has_guard && !next.of_kind("output").empty()) return refused(std::string(no_guard));
  change.steps = std::make_unique<StepwiseChange>(system_, next);
  const PlanChange& parts = change.steps->changes();
  if (parts.refused() == 0) return true;
  for (const PartChange& part : parts.all)
    if (part.fate == Fate::refused) add(change, LogLevel::error, part.text(), "refused");
  return refused("a restart of the program applies the refused changes");
}

/// Checks that new files can be written.
struct Reload::NewFilesLook final : detail::LaneJob {
  NewFilesLook(Reload& reload, const std::shared_ptr<Change>& change, std::vector<NewFile> files)
      : reload_(reload), change_(change), files_(std::move(files)) {}
  void run() noexcept override try {
    for (const NewFile& file : files_)
      if (std::string why = obstacle_to_write(file); !why.empty()) obstacles_.push_back(file.object + ": " + why);
  } catch (...) {  // no memory: treated like a job that did not return
    has_failed_ = true;
  }
  void done(Outcome outcome) override {
    const auto change = change_.lock();
    if (change == nullptr || outcome == Outcome::cancelled) return;
    change->obstacles = outcome == Outcome::finished && !has_failed_ ? std::move(obstacles_) : not_known(files_);
    change->is_looking = false;
    if (!change->obstacles.empty() || change->waits_for.empty()) reload_.then(change_, &Reload::stop_waiting);
  }
  static std::vector<std::string> not_known(const std::vector<NewFile>& files) {
    std::vector<std::string> lines;
    for (const NewFile& file : files)
      lines.push_back(file.object + ": checking whether " + file.path + " can be written took longer than " +
                      to_string(storing_patience));
    return lines;
  }

 private:
  Reload& reload_;
  const Weak change_;
  const std::vector<NewFile> files_;  // their functions come from the plan and own what they use
  std::vector<std::string> obstacles_;
  bool has_failed_ = false;
};

void Reload::look_at_new_files(const std::shared_ptr<Change>& change) {
  std::vector<NewFile> files = new_files(system_.parts().plans(), change->read->plan, change->steps->changes());
  if (files.empty()) return;
  std::vector<std::string> not_known = NewFilesLook::not_known(files);
  change->is_looking = lane_.submit(std::make_shared<NewFilesLook>(*this, change, std::move(files)), storing_patience);
  if (!change->is_looking) change->obstacles = std::move(not_known);
}

std::vector<const PartPlan*> Reload::closing_sinks(const Change& change) const {
  std::vector<const PartPlan*> sinks;
  std::set<std::string> ending;
  for (const PartChange& part : change.steps->changes().all)
    if (part.fate == Fate::restarted || part.fate == Fate::removed) ending.insert(part.object);
  if (ending.empty()) return sinks;
  for (const PartPlan* plan : system_.parts().plans())
    if (plan->stores && ending.contains(plan->object())) sinks.push_back(plan);
  return sinks;
}

std::vector<Reload::RemovedSender> Reload::removed_senders(const Change& change) const {
  std::vector<RemovedSender> senders;
  for (const PartChange& part : change.steps->changes().all) {
    if (part.fate != Fate::removed) continue;
    for (const PartPlan* plan : system_.parts().plans())
      if (plan->stores && !plan->stores->through.empty() && plan->object() == part.object)
        senders.push_back({plan->name, plan->stores->through});
  }
  return senders;
}

void Reload::report_removed_senders(Change& change) {
  // Closed sinks are listed in the order in which they were closed.
  const std::vector<SinkStatus> sinks = loop_.runtime().sinks();
  for (const RemovedSender& sender : change.removed_senders) {
    const auto last = std::find_if(sinks.rbegin(), sinks.rend(),
                                   [&](const SinkStatus& sink) { return sink.name == sender.name; });
    if (last == sinks.rend() || !last->backlog || last->counts.queued == 0) continue;
    add(change, LogLevel::warning,
        waiting_text({last->counts.queued, last->backlog->bytes, {}, {}}) + " in the recording " + sender.through +
            " for the sink \"" + sender.name + "\", which is removed: they are not sent",
        "left-backlog");
  }
}

bool Reload::may_be_left(const Change& change, const PartPlan& sink) const {
  const std::error_code obstacle = system_.sink(sink.name).obstacle();
  if (obstacle == Errc::storage_full || obstacle == Errc::busy) return false;
  return std::none_of(change.read->plan.parts.begin(), change.read->plan.parts.end(), [&](const PartPlan& next) {
    return next.stores && !next.stores->path.empty() && next.stores->path == sink.stores->path;
  });
}

void Reload::then(const Weak& change, void (Reload::*step)(const std::shared_ptr<Change>&)) {
  loop_.post([this, change, step] {
    if (const auto still = change.lock(); still != nullptr && still == under_way_) (this->*step)(still);
  });
}

void Reload::apply(std::shared_ptr<const NextPlan> read, const std::string& why, Told told) {
  const auto change = std::make_shared<Change>(Change{std::move(read), why, std::move(told)});
  if (under_way_ == nullptr && next_ == nullptr) return begin(change);
  if (next_ != nullptr) refuse(*next_, "a later one takes its place");
  next_ = change;
  if (under_way_ == nullptr) begin_next();
}

void Reload::begin_next() {
  loop_.post([this, weak = Weak(next_)] {
    const auto next = weak.lock();
    if (next == nullptr || next != next_ || under_way_ != nullptr) return;
    next_ = nullptr;
    begin(next);
  });
}

void Reload::begin(const std::shared_ptr<Change>& change) {
  if (!may_be_applied(*change)) return;
  under_way_ = change;
  change->left = recordings_left(system_.parts().plans(), change->read->plan);
  change->removed_senders = removed_senders(*change);
  std::set<std::string> sinks;
  for (const PartPlan* sink : closing_sinks(*change)) sinks.insert(sink->name);
  change->waits_for = sinks;
  const Weak weak = change;
  change->is_waiting = true;
  look_at_new_files(change);
  ask_tiers(change);
  if (!change->is_looking && (!change->obstacles.empty() || change->waits_for.empty()))
    return then(weak, &Reload::stop_waiting);
  change->patience = Timer(loop_, storing_patience, [this, weak] { then(weak, &Reload::stop_waiting); });
  for (const std::string& name : sinks) {
    system_.sink(name).sync([this, name, weak] {
      const auto still = weak.lock();
      if (still == nullptr || still->waits_for.erase(name) == 0) return;
      // Not from within the sink.
      if (still->waits_for.empty() && !still->is_looking) then(weak, &Reload::stop_waiting);
    });
  }
}

void Reload::ask_tiers(const std::shared_ptr<Change>& change) {
  for (const std::string& name : change->steps->tiers()) {
    Tier* const tier = system_.parts().find<Tier>("tier", name);
    if (tier == nullptr || !may_answer(loop_, *tier)) continue;
    const std::string awaited = "tier " + name;
    change->waits_for.insert(awaited);
    when_it_turns(loop_, *tier, [this, awaited, weak = Weak(change)] {
      const auto still = weak.lock();
      if (still == nullptr || still->waits_for.erase(awaited) == 0) return;
      if (still->waits_for.empty() && !still->is_looking) then(weak, &Reload::stop_waiting);
    });
  }
}

void Reload::stop_waiting(const std::shared_ptr<Change>& change) {
  if (!std::exchange(change->is_waiting, false)) return;  // both may happen in one turn
  change->patience = {};
  if (change->is_looking) {  // the lane gives up the check at the same time
    for (const NewFile& file : new_files(system_.parts().plans(), change->read->plan, change->steps->changes()))
      change->obstacles.push_back(NewFilesLook::not_known({file}).front());
  }
  if (!change->obstacles.empty()) {
    for (std::size_t i = 0; i + 1 < change->obstacles.size(); ++i) add(*change, LogLevel::error, change->obstacles[i]);
    return refuse(*change, change->obstacles.back());
  }
  std::set<std::string> stuck;
  std::vector<const PartPlan*> left;
  for (const PartPlan* sink : closing_sinks(*change)) {
    if (sink->stores->is_sender || !change->waits_for.contains(sink->name)) continue;
    if (may_be_left(*change, *sink))
      left.push_back(sink);
    else
      stuck.insert(sink->name);
  }
  if (!stuck.empty())
    return refuse(*change, "the reload would close " + detail::listed(stuck) +
                               ", which cannot store its queue now and would lose it; fix the cause, or, if the disk "
                               "does not answer, give the sink a file on another disk");
  for (const PartPlan* sink : left)
    add(*change, LogLevel::warning,
        sink->object() + " is left alone, because its disk does not answer: what the sink has not stored in " +
            to_string(sink->stores->close_deadline) + ", its `close_deadline`, is lost, and counted");
  go_on(change);
}

void Reload::go_on(const std::shared_ptr<Change>& change) {
  if (run_.is_ending()) return conclude(*change, LogLevel::error, "not finished: the program ends");
  std::string failed, id;
  bool is_more = false;
  try {
    is_more = change->steps->step(step_time);
  } catch (const SetupError& error) {
    failed = error.error().text();
    id = error.error().id();
  } catch (const std::exception& error) {
    failed = error.what();
  }
  if (!failed.empty() && !change->steps->is_applied())
    return conclude(*change, LogLevel::error, "not applied: " + failed, id);
  change->missing = failed;
  if (change->steps->is_waiting()) {
    change->patience = Timer(loop_, device_look, [this, weak = Weak(change)] { then(weak, &Reload::go_on); });
    return;
  }
  then(change, is_more ? &Reload::go_on : &Reload::finish_change);
}

void Reload::finish_change(const std::shared_ptr<Change>& change) {
  run_.applied(change->read->plan);
  std::set<std::string> made;
  for (const PartChange& part : change->steps->changes().all)
    if (part.fate == Fate::restarted || part.fate == Fate::added) made.insert(part.object);
  change->waits_for.clear();
  for (const PartPlan* plan : system_.parts().plans())
    if (plan->stores && plan->stores->check_openable && made.contains(plan->object()))
      change->waits_for.insert(plan->name);
  const Weak weak = change;
  if (change->waits_for.empty()) return then(weak, &Reload::report_parts);
  change->is_waiting = true;
  change->patience = Timer(loop_, opening_patience, [this, weak] { then(weak, &Reload::report_unopened); });
  for (const std::string& name : std::set<std::string>(change->waits_for)) {
    system_.sink(name).sync([this, name, weak] {
      const auto still = weak.lock();
      if (still == nullptr || still->waits_for.erase(name) == 0) return;
      if (still->waits_for.empty()) then(weak, &Reload::report_unopened);  // not from within the sink
    });
  }
}

void Reload::report_unopened(const std::shared_ptr<Change>& change) {
  if (!std::exchange(change->is_waiting, false)) return;  // both may happen in one turn
  change->patience = {};
  for (const std::string& name : change->waits_for) {
    const SinkStatus sink = system_.sink(name).status();
    add(*change, LogLevel::warning,
        "sink " + name + " stores nothing yet" +
            (sink.reason.empty() ? ", " + to_string(opening_patience) + " after it was made" : ": " + sink.reason));
  }
  report_parts(change);
}

void Reload::report_parts(const std::shared_ptr<Change>& change) {
  const PlanChange& parts = change->steps->changes();
  for (const MonotonicTime begin = loop_.now(); change->reported_parts < parts.all.size();) {
    const PartChange& part = parts.all[change->reported_parts++];
    if (part.fate != Fate::unchanged) add(*change, LogLevel::info, part.text());
    if (loop_.now() - begin >= step_time) return then(change, &Reload::report_parts);
  }
  for (const std::string& line : change->left) add(*change, LogLevel::warning, line, "left-backlog");
  report_removed_senders(*change);
  if (!change->missing.empty())
    return conclude(*change, LogLevel::error, options_.file + " is applied, except for this: " + change->missing);
  conclude(*change, LogLevel::info,
           options_.file + " is applied" + (parts.is_empty() ? "; nothing has changed in it" : "") + ": " +
               counts_text(registry_, change->read->plan));
}

}  // namespace rtdata::app
