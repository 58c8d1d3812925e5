#include "app/page/page_setup.hpp"

#include <nlohmann/json.hpp>

#include "app/control/commands.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

bool has_changes(const PartPlan& part) {
  return part.publishes && (part.kind == "machine" || part.kind == "output" || part.type == "limit");
}

}  // namespace

std::vector<std::string> topics_of_changes(const SystemPlan& plan) {
  std::vector<std::string> topics{command_topic};
  for (const PartPlan& part : plan.parts)
    if (has_changes(part)) topics.push_back(part.publishes->topic);
  return topics;
}

std::string page_setup(const SystemPlan& plan) {
  Json setup{{"name", plan.settings.name}, {"notes", plan.settings.notes}, {"parts", Json::array()}};
  for (const PartPlan& part : plan.parts) {
    if (!part.publishes) continue;
    Json one{{"kind", part.type == "limit" ? "limit" : part.kind},
             {"name", part.name},
             {"type", part.type},
             {"topic", part.publishes->topic}};
    // The item still has references to secrets, not the secrets.
    if (has_changes(part)) one["item"] = Json::parse(part.item.to_json(), nullptr, false);
    setup["parts"].push_back(std::move(one));
  }
  return setup.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace rtdata::app
