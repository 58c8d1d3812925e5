#include "app/control/arm_keeper.hpp"

#include <algorithm>
#include <set>
#include <utility>

#include "app/core/machines.hpp"
#include "rtdata/outputs/output.hpp"

namespace rtdata::app {
namespace {

constexpr Duration arm_patience = std::chrono::seconds{3};  // less than the time that the commander waits

}  // namespace

struct ArmKeeper::Waiting {
  std::string output, topic;
  std::string machines;  // "machine a and machine b"
  bool is_armed = false;
  std::set<std::string> recordings = {};  // recordings that have not stored it yet
  std::set<std::string> all = {};
  std::uint64_t dropped = 0;  // events of the output's topic that they had dropped before
  Timer timer = {};
  Told told = {};
};

void ArmKeeper::keep(const std::string& output, const std::function<bool()>& act, Told told) {
  const auto waiting = std::make_shared<Waiting>();
  waiting->output = output;
  for (const ArmsAgain& one : who_arms_again(system_.parts(), output)) {
    waiting->topic = one.topic;
    waiting->machines += (waiting->machines.empty() ? "machine " : " and machine ") + one.machine;
    waiting->recordings.insert(one.recording->name);
  }
  waiting->all = waiting->recordings;
  waiting->dropped = dropped(*waiting);
  if (!act()) return;
  if (waiting->all.empty()) return told("");
  waiting->told = std::move(told);
  waiting->is_armed = system_.parts().get<Output>("output", output).is_armed();
  waiting_.push_back(waiting);
  waiting->timer = Timer(loop_, arm_patience, [this, waiting = waiting.get()] {
    const auto found = std::find_if(waiting_.begin(), waiting_.end(),
                                    [&](const auto& one) { return one.get() == waiting; });
    if (found != waiting_.end()) conclude(std::shared_ptr(*found), "after " + to_string(arm_patience));
  });
  look_at_event(waiting);
}

/// Waits for the event first: when disarmed, an output publishes it after its device has answered.
void ArmKeeper::look_at_event(const std::shared_ptr<Waiting>& waiting) {
  system_.parts()
      .get<Output>("output", waiting->output)
      .when_published([this, &loop = loop_, weak = std::weak_ptr(waiting)] {
        loop.post([this, weak] {
          if (const auto still = weak.lock()) look_at_card(still);
        });
      });
}

void ArmKeeper::look_at_card(const std::shared_ptr<Waiting>& waiting) {
  for (const std::string& name : waiting->all) {
    const std::vector<const PartPlan*> plans = system_.parts().plans();
    const auto plan = std::find_if(plans.begin(), plans.end(),
                                   [&](const PartPlan* one) { return one->kind == "sink" && one->name == name; });
    if (plan == plans.end()) return conclude(waiting, "since a reload has removed it");
    system_.sink(name).sync([this, name, weak = std::weak_ptr(waiting)] {
      loop_.post([this, name, weak] {  // not from within the sink
        const auto still = weak.lock();
        if (still == nullptr) return;
        still->recordings.erase(name);
        if (!still->recordings.empty()) return;
        conclude(still, dropped(*still) == still->dropped ? "" : "since it has dropped events of " + still->topic);
      });
    });
  }
}

void ArmKeeper::conclude(const std::shared_ptr<Waiting>& waiting, const std::string& why) {
  std::erase(waiting_, waiting);
  std::string missing;
  for (const std::string& name : waiting->recordings.empty() ? waiting->all : waiting->recordings)
    missing += (missing.empty() ? "" : " and ") + name;
  waiting->told(why.empty() ? ""
                            : "but that is not on the disk in " + missing + ", " + why +
                                  ": after a kill or a power failure now, " + waiting->machines + " would " +
                                  (waiting->is_armed ? "not " : "") + "arm it again");
}

void ArmKeeper::end() {
  while (!waiting_.empty()) conclude(std::shared_ptr(waiting_.back()), "since the program ends");
}

std::uint64_t ArmKeeper::dropped(const Waiting& waiting) const {
  std::uint64_t dropped = 0;
  for (const SinkStatus& sink : loop_.runtime().sinks())
    for (const TopicDrops& one : sink.dropped)
      if (waiting.all.contains(sink.name) && one.topic == waiting.topic) dropped += one.count;
  return dropped;
}

}  // namespace rtdata::app
