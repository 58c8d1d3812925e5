#include "rtdata/config/system.hpp"

#include <algorithm>
#include <utility>

#include "config/plan/change.hpp"
#include "config/plan/neighbours.hpp"
#include "config/plan/part_reader.hpp"
#include "config/plan/plan_application.hpp"
#include "config/read/mistakes.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata {
namespace {

/// Adds the place of the item to an error of making a part.
template <class Make>
PartObject made_at(const PartPlan& plan, const Make& make) {
  try {
    return make();
  } catch (const SetupError& error) {
    throw SetupError(config_detail::error_at(plan, error.error()));
  }
}

/// Makes the part on this loop. Its later errors show the place of the item and no secrets.
PartObject made_on(Loop& loop, const PartPlan& plan, const Parts& parts) {
  if (std::string place = plan.item.place().text(); !place.empty() && plan.kind != "tier")
    loop.runtime().note_place(plan.object(), std::move(place));
  std::vector<std::string>& secrets = loop.runtime().core().reports.secrets;
  for (const std::string& secret : plan.secrets)
    if (std::find(secrets.begin(), secrets.end(), secret) == secrets.end()) secrets.push_back(secret);
  return plan.make(loop, parts);
}

}  // namespace

System::System(Loop& loop, const Registry& registry, const SystemPlan& plan)
    : loop_(loop),
      registry_(registry),
      configuration_(plan.document.file),
      root_(plan.document.root),
      log_(plan.settings.log) {
  if (!plan.good()) throw ConfigError(plan.problems);
  for (const PartPlan& part : plan.parts) make(std::make_unique<Parts::Part>(Parts::Part{part, {}}));
}

System::System(Loop& loop, const Registry& registry, const ConfigDocument& document)
    : System(loop, registry, plan_system(registry, document)) {}

System::~System() = default;

void System::make(std::unique_ptr<Parts::Part> part) {
  const PartPlan& plan = part->plan;
  const detail::Nodes::Doing doing(loop_.core().nodes, "the making of " + plan.object());
  part->object = made_at(plan, [&] {
    Loop& on = plan.tier().empty() ? loop_ : tier(plan.tier()).loop();
    return on.core().runs_elsewhere() ? make_on_tier(on, plan) : made_on(on, plan, parts_);
  });
  parts_.add(std::move(part));
}

PartObject System::make_on_tier(Loop& loop, const PartPlan& plan) {
  struct Making {
    std::shared_ptr<int> is_under_way = std::make_shared<int>();
    PartPlan plan;
    PartObject object = {};  // goes first
  };
  loop_.core().check_thread("cannot make", plan.object());
  const auto making = std::make_shared<Making>(Making{.plan = plan});
  try {
    loop.core().ask_there([&loop, &parts = parts_, making] {
      const detail::Nodes::Doing doing(loop.core().nodes, "the making of " + making->plan.object());
      making->object = made_on(loop, making->plan, parts);
      return true;
    });
  } catch (...) {
    given_up_.push_back({making->is_under_way, plan.uses, {}});
    throw;
  }
  return std::move(making->object);
}

void System::close(std::unique_ptr<Parts::Part> part) {
  std::erase_if(given_up_, [](const GivenUp& one) { return one.making.expired(); });
  for (GivenUp& one : given_up_)
    for (const PartUse& use : one.uses)
      if (use.kind == part->plan.kind && use.name == part->plan.name) return one.used.push_back(std::move(part));
}

config_detail::Neighbours& System::neighbours() {
  if (neighbours_ == nullptr) {
    neighbours_ = std::make_unique<config_detail::Neighbours>(registry_, configuration_);
    Problems ignored;  // the parts were checked when they were made
    for (const auto& part : parts_.made_) neighbours_->add(part->plan, ignored);
    neighbours_->check_files_of_topics(ignored);
    neighbours_->assume_stored();
    neighbours_->add_log(log_, ConfigItem(), ignored);
  }
  return *neighbours_;
}

std::string System::add(std::string_view kind, const ConfigItem& item, const std::string& name) {
  const PartKind* found = config_detail::find_kind(registry_, kind);
  if (found == nullptr) {
    throw SetupError({Errc::not_found, "cannot add a part", item.place().text(),
                      "there is no kind \"" + std::string(kind) + "\"", "see Registry::kinds"});
  }
  const PartKind& known = *found;
  Problems problems;
  auto part = std::make_unique<Parts::Part>();
  part->plan = config_detail::PartReader().read(known, name, item, problems);
  const std::string made = part->plan.name;
  try {
    neighbours().check_uses(part->plan, problems);
    neighbours().add(part->plan, problems);
    neighbours().check_files_of_topics(problems);
    neighbours().check_stored_topics(problems);
    if (!problems.empty()) {
      std::vector<std::string> secrets = loop_.runtime().core().reports.secrets;
      secrets.insert(secrets.end(), part->plan.secrets.begin(), part->plan.secrets.end());
      config_detail::hide_secrets_in(problems, secrets);
      problems.sort();
      throw ConfigError(std::move(problems));
    }
    std::string object = part->plan.object();
    make(std::move(part));
    loop_.runtime().core().configurations.add(std::move(object), item.to_json());
  } catch (...) {
    neighbours_.reset();  // it refers to a part that was not made
    throw;
  }
  return made;
}

void System::remove(std::string_view kind, std::string_view name) {
  const Parts::Part& part = parts_.part_named(kind, name);
  for (const auto& other : parts_.made_) {
    for (const PartUse& use : other->plan.uses) {
      if (use.kind != kind || use.name != name || other.get() == &part) continue;
      throw SetupError({Errc::busy, "cannot remove the " + part.plan.object(), config_detail::place_of(use.item),
                        other->plan.object() + " uses it", "remove that first"});
    }
  }
  if (part.plan.on_removal) part.plan.on_removal(part.object);
  neighbours_.reset();
  std::string object = part.plan.object();
  close(parts_.take(kind, name));
  loop_.runtime().core().configurations.remove(std::move(object));
}

config_detail::ComparedPlans System::compared_to(const SystemPlan& next) const {
  std::vector<const PartPlan*> parts;
  for (const PartPlan& part : next.parts) parts.push_back(&part);
  return config_detail::compare(
      {parts_.plans(), root_}, {std::move(parts), next.document.root},
      {[&](const std::string& topic) -> const Description* {
         const detail::TopicCore* known = loop_.runtime().core().find_topic(topic);
         return known != nullptr ? known->type.description.get() : nullptr;
       },
       [&](const std::string& origin) {
         auto [topic, tier] = loop_.runtime().core().names.published(origin);
         return config_detail::RunSoFar::Published{std::move(topic), std::move(tier)};
       },
       [&](const PartPlan& part) { return part.hold->is_so(parts_.part_named(part.kind, part.name).object); }});
}

PlanChange System::change_to(const SystemPlan& next) const { return compared_to(next).all(); }

PlanChange System::apply(const SystemPlan& next) {
  StepwiseChange change(*this, next);
  while (change.step(Duration::max())) {
  }
  return change.changes();
}

void System::finish_outputs(Callback<void()> done) {
  struct All {
    std::size_t left = 1;
    Callback<void()> done;
    void one_done() {
      if (--left == 0) done();
    }
  };
  const auto all = std::make_shared<All>();
  all->done = std::move(done);
  const auto one_done = [&loop = loop_, all] { loop.post([all] { all->one_done(); }); };
  const auto begin = [&](bool of_tiers) {
    for (const auto& part : parts_.made_) {
      if (!part->plan.ending || part->plan.tier().empty() == of_tiers) continue;
      ++all->left;
      try {
        part->plan.ending(part->object, one_done);
      } catch (const SetupError&) {  // its loop does not turn: the guard sets it safe
        one_done();
      }
    }
  };
  begin(false);
  begin(true);  // a tier may not turn, which takes time
  one_done();
}

StepwiseChange::StepwiseChange(System& system, const SystemPlan& next)
    : application_(std::make_unique<config_detail::PlanApplication>(system, next)) {}
StepwiseChange::~StepwiseChange() = default;

const PlanChange& StepwiseChange::changes() const noexcept { return application_->changes(); }

std::set<std::string> StepwiseChange::tiers() const { return application_->tiers(); }

bool StepwiseChange::step(Duration budget) { return application_->step(budget); }

bool StepwiseChange::is_waiting() const noexcept { return application_->is_waiting(); }

bool StepwiseChange::is_applied() const noexcept { return application_->is_applied(); }

}  // namespace rtdata
