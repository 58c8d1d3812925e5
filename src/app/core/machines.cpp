#include "app/core/machines.hpp"

#include "rtdata/data/description.hpp"
#include "rtdata/process/expression.hpp"
#include "rtdata/sinks/sink.hpp"

namespace rtdata::app {
namespace {

/// With the tier that it runs on.
struct PlacedMachine {
  fsm::MachineSettings own;
  config_detail::Placement placement;
  friend constexpr auto parameters(type_tag<PlacedMachine>) {
    return parameter_list(include_member(&PlacedMachine::own), include_member(&PlacedMachine::placement));
  }
  friend void check_config(const PlacedMachine& machine, const ConfigItem& item, Problems& problems) {
    check_config(machine.own, item, problems);
  }
};

/// A change, and each state as a name that is true in it. Null: a state is called as a name cannot be.
std::shared_ptr<const Description> with_states(const fsm::MachineSettings& settings) {
  DescriptionBuilder builder("state_change");
  builder.field("lasted", Kind::f64, "s");
  for (const fsm::StateSettings& state : settings.states) builder.field(state.name, Kind::boolean);
  const auto described = builder.build();
  return described ? *described : nullptr;
}

PartObject make(Loop& loop, const Parts& parts, const fsm::MachineSettings& settings) {
  std::optional<fsm::ConfiguredMachine::Beginning> beginning;
  fsm::ConfiguredMachine::Sync sync;
#ifdef RTDATA_WITH_SQLITE
  if (settings.resume) {
    for (const PartPlan* plan : parts.plans())
      if (plan->kind == "sink" && plan->name == settings.resume->recording)
        beginning = resumed(loop, settings, plan->stores->path);
    Sink& sink = parts.get<Sink>("sink", settings.resume->recording);
    sync = [&sink](Callback<void()> done) { sink.sync(std::move(done)); };
  }
#else
  (void)parts;
#endif
  return PartObject::made_by<fsm::ConfiguredMachine>(
      [&] { return fsm::ConfiguredMachine(loop, settings, beginning, std::move(sync)); });
}

}  // namespace

void add_machines(Registry& registry) {
  if (!Expression::available()) {
    registry.leave_out("machine", "machine", "this program was built without muParser");
    return;
  }
  registry.add_part<PlacedMachine>(
      "machine", "machine", "a state machine, with expressions as conditions",
      [](PartPlan& plan, const PlacedMachine& config) {
        const fsm::MachineSettings& settings = config.own;
        plan.name = settings.name;
        plan.publishes = PublishedTopic{settings.topic.empty() ? settings.name : settings.topic,
                                        description_of<fsm::StateChange>(),
                                        std::nullopt,
                                        {},
                                        with_states(settings)};
        if (settings.resume) plan.stored_by = settings.resume->recording;
        plan.check_topics = [settings](const PartPlan& part, const PartPlan::PayloadOf& payload_of,
                                       Problems& problems) {
          check_machine_names(settings, payload_of, part.item, problems);
        };
        plan.make = [settings](Loop& loop, const Parts& parts) { return make(loop, parts, settings); };
      });
}

}  // namespace rtdata::app
