#include <filesystem>
#include <utility>

#include "config/plan/making_order.hpp"
#include "config/plan/neighbours.hpp"
#include "config/plan/part_reader.hpp"
#include "config/plan/part_warnings.hpp"
#include "config/plan/warnings.hpp"
#include "config/read/mistakes.hpp"
#include "data/name.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata {
namespace {

using namespace config_detail;

std::string stem_of(const std::string& file) { return std::filesystem::path(file).stem().string(); }

/// Makes the plan of a document, one step after the other.
class Planner {
 public:
  Planner(const Registry& registry, SystemPlan& plan) : registry_(registry), plan_(plan) {}

  void read() {
    read_settings();
    if (!root().is_object()) return;
    plan_tiers();
    for (const PartKind& kind : registry_.kinds()) plan_kind(kind);
    compare();
    warn();
  }

 private:
  const ConfigItem& root() const { return plan_.document.root; }

  void read_settings() {
    const std::size_t before = plan_.problems.size();
    std::vector<std::string> keys;
    for (const PartKind& kind : registry_.kinds()) keys.push_back(kind.key);
    read_config(root(), plan_.settings, plan_.problems, UnknownKeys::report, keys);
    has_good_settings_ = plan_.problems.size() == before;
    if (plan_.settings.name.empty()) plan_.settings.name = stem_of(plan_.document.file);
  }

  void plan_tiers() {
    const ConfigItem* tiers = child_of(root(), "tiers");
    if (tiers == nullptr || !tiers->is_object()) return;
    const std::string& main = plan_.settings.loop.name;
    for (const ConfigChild& child : tiers->children()) {
      if (!detail::is_name(child.key) || child.key == main) {
        plan_.problems.add(problem_at_key(
            child.item, "bad-name",
            child.key == main ? "the main loop has that name; give the tier another" : detail::name_rule));
      }
      const auto settings = plan_.settings.tiers.find(child.key);
      if (settings == plan_.settings.tiers.end()) continue;
      PartPlan tier;
      tier.kind = "tier";
      tier.name = child.key;
      tier.item = child.item;
      tier.make = [config = settings->second.tier_config(child.key)](Loop& loop, const Parts&) {
        return PartObject::made_by<Tier>([&] { return Tier(loop, config); });
      };
      plan_.parts.push_back(std::move(tier));
    }
  }

  void plan_kind(const PartKind& kind) {
    const ConfigItem* list = child_of(root(), kind.key);
    if (list == nullptr) return;
    if (kind.written == PartKind::Written::list) {
      if (!check_is_array(*list, plan_.problems)) return;
    } else if (list->is_array() && list->size() == 0) {
      return;  // an empty list counts as missing, for both ways of writing parts
    } else if (!check_is_object(*list, plan_.problems)) {
      return;
    }
    for (const ConfigChild& child : list->children()) {
      plan_.parts.push_back(reader_.read(kind, child.key, child.item, plan_.problems));
      const PartPlan& part = plan_.parts.back();
      warn_of(reader_.parameters_of_item(kind, child.item), child.item, plan_.warnings);
      plan_.secrets.insert(plan_.secrets.end(), part.secrets.begin(), part.secrets.end());
      if (kind.does == PartKind::Does::stores) ++storing_;
      if (kind.does != PartKind::Does::publishes) continue;
      ++publishing_;
      if (part.make) ++good_publishing_;
    }
  }

  /// Checks the parts against each other, including parts with mistakes as far as they are known.
  void compare() {
    Neighbours neighbours(registry_, plan_.document.file);
    for (const PartPlan& part : plan_.parts) neighbours.add(part, plan_.problems);
    neighbours.check_files_of_topics(plan_.problems);
    neighbours.check_stored_topics(plan_.problems);
    neighbours.add_log(plan_.settings.log, child_or_self(child_or_self(root(), "log"), "file"), plan_.problems);
    for (const PartPlan& part : plan_.parts) neighbours.check_uses(part, plan_.problems);
    if (publishing_ != 0 && publishing_ == good_publishing_) {
      warn_of_patterns(plan_.parts, neighbours, plan_.warnings);
      warn_of_units(plan_.parts, plan_.warnings);
      warn_of_recordings(plan_.parts, plan_.warnings);
      warn_of_senders(plan_.parts, neighbours, plan_.warnings);
      warn_of_tiers(plan_.parts, plan_.warnings);
    }
    put_in_making_order(plan_.parts, neighbours, plan_.problems);
    std::erase_if(plan_.parts, [](const PartPlan& part) { return !part.make; });
  }

  void warn() {
    const std::vector<ParameterInfo> settings = parameters_of<SystemSettings>();
    warn_of(settings, root(), plan_.warnings);
    collect_secrets(settings, root(), plan_.secrets);
    warn_of_plain_secrets(root(), plan_.warnings);
    const auto at = [&](const char* key) -> const ConfigItem& { return child_or_self(root(), key); };
    if (storing_ == 0 && publishing_ != 0 && plan_.problems.empty()) {
      plan_.warnings.add(
          at("sinks").problem("no-sinks", "there are no sinks: the readings of the sensors are not stored"));
    }
    if (publishing_ == 0 && (plan_.problems.empty() || (has_good_settings_ && at("sensors").is_array()))) {
      plan_.warnings.add(at("sensors").problem("no-sensors", "there are no sensors: nothing will be recorded"));
    }
    warn_of_load(plan_.parts, plan_.settings.loop.name, plan_.warnings);
  }

  const Registry& registry_;
  SystemPlan& plan_;
  PartReader reader_;
  bool has_good_settings_ = false;
  std::size_t storing_ = 0;
  std::size_t publishing_ = 0;
  std::size_t good_publishing_ = 0;
};

}  // namespace

SystemPlan plan_system(const Registry& registry, ConfigDocument document) {
  SystemPlan plan;
  plan.document = std::move(document);
  plan.problems = plan.document.problems;
  if (plan.document.root.is_null() && !plan.problems.empty()) return plan;  // nothing was read
  Planner(registry, plan).read();
  plan.problems.sort();
  plan.warnings.sort();
  plan.hide_secrets();
  return plan;
}

std::vector<const PartPlan*> SystemPlan::of_kind(std::string_view kind) const {
  std::vector<const PartPlan*> found;
  for (const PartPlan& part : parts)
    if (part.kind == kind) found.push_back(&part);
  return found;
}

void SystemPlan::hide_secrets() {
  hide_secrets_in(problems, secrets);
  hide_secrets_in(warnings, secrets);
}

std::string SystemPlan::report() const { return document.report(problems); }

std::vector<LoopLoad> SystemPlan::loads() const { return loads_of(parts, settings.loop.name); }

Runtime::Config SystemPlan::runtime_config() const {
  Runtime::Config config;
  config.name = settings.name;
  config.notes = settings.notes;
  config.configuration = document.text;
  config.secrets = secrets;
  return config;
}

}  // namespace rtdata
