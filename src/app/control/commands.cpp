#include "app/control/commands.hpp"

#include <algorithm>
#include <memory>
#include <sstream>
#include <stdexcept>

#include "app/control/request.hpp"
#include "app/control/status.hpp"
#include "app/core/machines.hpp"
#include "data/fitting.hpp"
#include "data/listed.hpp"
#include "data/number_text.hpp"
#include "fsm/configured.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "loop/tier/tier_core.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/outputs/output.hpp"
#include "rtdata/sensors/limit.hpp"

namespace rtdata::app {
namespace {

using Words = std::vector<std::string>;

struct Verb {
  const char* word;
  std::size_t least, most;  // number of further words
  CommandHelp help;
  std::string (*act)(System&, const Words&, std::string_view by);
};

std::string start(System& system, const Words& words, std::string_view) {
  return "sensor " + words[1] + (system.sensor(words[1]).start() ? " is started" : " runs already");
}

std::string stop(System& system, const Words& words, std::string_view) {
  return "sensor " + words[1] + (system.sensor(words[1]).stop() ? " is stopped" : " has stopped already");
}

std::string set_rate(System& system, const Words& words, std::string_view) {
  AnySensor& sensor = system.sensor(words[1]);
  const Rate rate = parse_rate(words[2]).or_throw();
  sensor.set_rate(rate);
  return "sensor " + words[1] + " is read at " + to_string(rate);
}

std::string acknowledge(System& system, const Words& words, std::string_view) {
  (void)system.sensor(words[1]);  // throws with the nearest name if there is none
  auto* const limit = system.parts().find<LimitSensor>("sensor", words[1]);
  if (limit == nullptr) throw std::invalid_argument("sensor " + words[1] + " is not a limit");
  return limit->acknowledge() ? "the alarm of " + words[1] + " is acknowledged"
                              : "there is no alarm of " + words[1] + " to acknowledge";
}

double number_of(const std::string& word, const char* expected) {
  double number = 0;
  if (detail::read_number(word, number) != std::errc{})
    throw std::invalid_argument("\"" + word + "\" is not a " + expected);
  return number;
}
/// "on", "off", or a number.
double output_value_of(const std::string& word) {
  if (word == "on" || word == "off") return word == "on" ? 1 : 0;
  return number_of(word, "number, on or off");
}

std::string set(System& system, const Words& words, std::string_view by) {
  Output& output = system.parts().get<Output>("output", words[1]);
  output.set(output_value_of(words[2]), by).or_throw();
  return "output " + words[1] + " is being set to " + words[2];
}

std::string control(System& system, const Words& words, std::string_view) {
  Output& output = system.parts().get<Output>("output", words[1]);
  if (words[2] != "setpoint")
    throw std::invalid_argument("\"" + words[2] + "\" of a controller cannot be commanded; write `" +
                                "pid OUTPUT setpoint VALUE`, and its gains are changed by a reload");
  output.change_setpoint(number_of(words[3], "number")).or_throw();
  return "the set point of output " + words[1] + " is " + words[3] + " until the next reload";
}

std::string arm(System& system, const Words& words, std::string_view by) {
  Output& output = system.parts().get<Output>("output", words[1]);
  if (output.is_armed()) return "output " + words[1] + " is armed already";
  if (const auto refused = refuses_arming(system.parts(), words[1]))
    throw std::invalid_argument("machine " + refused->machine + " is in " + refused->state + ": output " + words[1] +
                                " can be armed in " + refused->states + " only");
  output.arm(by).or_throw();
  return "output " + words[1] + " is armed";
}

std::string disarm(System& system, const Words& words, std::string_view by) {
  Output& output = system.parts().get<Output>("output", words[1]);
  output.disarm(by).or_throw();
  return "output " + words[1] + " is disarmed" +
         (output.is_safe() ? ": it has its safe value"
                           : ", and is being set to its safe value; `rtdata top` shows what it has");
}

std::string raise(System& system, const Words& words, std::string_view) {
  auto& machine = system.parts().get<fsm::ConfiguredMachine>("machine", words[1]);
  machine.raise(words[2]).or_throw();
  const std::string state(machine.now().state);
  const auto& all = machine.settings().transitions;
  const bool is_awaited = std::any_of(all.begin(), all.end(), [&](const fsm::TransitionSettings& one) {
    return one.from == state && one.event == words[2];
  });
  return "machine " + words[1] + " has got the event " + words[2] +
         (is_awaited ? "" : "; in the state " + state + " nothing waits for it");
}

std::string note(System&, const Words&, std::string_view) { return "noted"; }

const std::vector<Verb>& verbs() {
  static const std::vector<Verb> all{
      {"start", 1, 1, {"start SENSOR", "start a sensor"}, start},
      {"stop", 1, 1, {"stop SENSOR", "stop a sensor, until it is started again"}, stop},
      {"rate", 2, 2, {"rate SENSOR RATE", "read a sensor at another rate, such as \"200 Hz\" or \"10 ms\""}, set_rate},
      {"event", 2, 2, {"event MACHINE NAME", "give a state machine an event"}, raise},
      {"set", 2, 2, {"set OUTPUT VALUE", "set an output that follows no topic: a number, on or off"}, set},
      {"arm", 1, 1, {"arm OUTPUT", "let an output be set"}, arm},
      {"disarm", 1, 1, {"disarm OUTPUT", "set the safe value of an output, which it keeps until it is armed"}, disarm},
      {"pid",
       3,
       3,
       {"pid OUTPUT setpoint VALUE", "change the set point of a controller, until the next reload"},
       control},
      {"ack", 1, 1, {"ack LIMIT", "acknowledge the alarm of a limit"}, acknowledge},
      {"note", 1, 1000, {"note TEXT", "write a remark into the recordings"}, note},
      {"tare",
       1,
       2,
       {"tare SENSOR[.FIELD] [--clear]", "make its value read 0, now and after each start; --clear: no longer"},
       nullptr},
      {"reload", 0, 0, {"reload", "read the configuration again, and apply what has changed"}, nullptr},
  };
  return all;
}

constexpr std::size_t longest_command = 240;
/// For a tier; less than the client waits.
constexpr Duration turn_patience = std::chrono::seconds{2};

/// Its verb; null: it is refused, `why` says for what.
const Verb* verb_of(const Words& words, std::string& why) {
  const auto verb = std::find_if(verbs().begin(), verbs().end(), [&](const Verb& one) { return words[0] == one.word; });
  if (verb == verbs().end()) {
    std::vector<std::string> names;
    for (const Verb& one : verbs()) names.emplace_back(one.word);
    const std::string nearest = nearest_name(words[0], names);
    why = "there is no command \"" + words[0] + "\"" +
          (nearest.empty() ? "; `rtdata ctl --help` lists them" : "; did you mean \"" + nearest + "\"?");
    return nullptr;
  }
  if (words.size() - 1 < verb->least || words.size() - 1 > verb->most)
    why = std::string("write it as `") + verb->help.words + "`";
  // The text for the recording.
  const std::string all = detail::listed(words, " ");
  if (why.empty() && all.size() > longest_command)
    why = "it has " + std::to_string(all.size()) + " bytes, more than " + std::to_string(longest_command);
  if (why.empty() && std::any_of(all.begin(), all.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; }))
    why = "it has a control character, such as the end of a line";
  return why.empty() ? &*verb : nullptr;
}

CommandOutcome act(System& system, const Words& words, std::string_view by) {
  std::string why;
  const Verb* const verb = verb_of(words, why);
  if (verb == nullptr) return {false, why};
  try {
    return {true, verb->act(system, words, by)};
  } catch (const std::exception& error) {
    return {false, std::string(detail::reason_of(error))};
  }
}

}  // namespace

const std::vector<CommandHelp>& command_help() {
  static const std::vector<CommandHelp> all = [] {
    std::vector<CommandHelp> help;
    for (const Verb& verb : verbs()) help.push_back(verb.help);
    return help;
  }();
  return all;
}

std::string command_answer(const CommandOutcome& outcome) {
  return answer_line(outcome.done ? "done" : "refused", outcome.text);
}

void repeat_command(System& system, const CommandRecord& recorded) {
  if (!recorded.done) return;
  std::istringstream text{std::string(recorded.command)};
  Words words;
  for (std::string word; text >> word;) words.push_back(word);
  if (words.size() == 3 && words[0] == "event") {
    if (auto* const machine = system.parts().find<fsm::ConfiguredMachine>("machine", words[1]))
      (void)machine->raise(words[2]);  // an event that no transition uses any more
  } else if (words.size() == 2 && words[0] == "ack") {
    if (auto* const limit = system.parts().find<LimitSensor>("sensor", words[1])) (void)limit->acknowledge();
  }
}

bool may_answer(Loop& loop, const Tier& tier) {
  const auto& tiers = loop.core().runtime.tiers;
  return tier.is_running() && std::none_of(tiers.begin(), tiers.end(), [&](const detail::TierCore* one) {
           return one->config.name == tier.config().name && one->is_stuck();
         });
}

void when_it_turns(Loop& loop, Tier& tier, std::function<void()> function) {
  tier.loop().post([&loop, function = std::move(function)]() mutable { loop.post(std::move(function)); });
}

namespace {

std::string hanging_text(const Tier& tier, const std::string& time = {}) {
  const std::string at = tier.doing();
  return "tier " + tier.config().name + " has not returned from " + (at.empty() ? "a callback" : at) + time +
         ": nothing was done; find what blocks there";
}

}  // namespace

struct CommandDesk::Asked {
  Words words;
  std::string by;
  Told told;
  std::string tier;
  Timer patience = {};
};

Tier* CommandDesk::tier_of(const Words& words) const {
  if (words.size() < 2) return nullptr;
  for (const PartPlan* plan : system_.parts().plans()) {
    const bool is_commanded = plan->kind == "sensor" || plan->kind == "output" || plan->kind == "machine";
    const bool is_named = plan->name == words[1] || (words[0] == "tare" && words[1].starts_with(plan->name + "."));
    if (!is_commanded || !is_named || plan->tier().empty()) continue;
    Tier& tier = system_.tier(plan->tier());
    return tier.is_running() ? &tier : nullptr;
  }
  return nullptr;
}

void CommandDesk::run(const Words& words, std::string_view by, Told told) {
  Tier* const tier = tier_of(words);
  if (tier == nullptr) return run_here(words, by, std::move(told));
  if (!may_answer(loop_, *tier)) {  // refuse at once: a hanging tier would execute the command much later
    const CommandOutcome outcome{false, hanging_text(*tier)};
    keep(words, by, outcome);
    return told(outcome);
  }
  const auto asked = std::make_shared<Asked>(Asked{words, std::string(by), std::move(told), tier->config().name});
  asked_.push_back(asked);
  asked->patience = Timer(loop_, turn_patience, [this, weak = std::weak_ptr(asked)] {
    const auto still = weak.lock();
    if (still == nullptr) return;
    refuse(still, hanging_text(system_.tier(still->tier), " for " + to_string(turn_patience)));
  });
  when_it_turns(loop_, *tier, [this, weak = std::weak_ptr(asked)] {
    const auto still = weak.lock();
    if (still == nullptr || std::erase(asked_, still) == 0) return;
    run_here(still->words, still->by, std::move(still->told));
  });
}

void CommandDesk::refuse(const std::shared_ptr<Asked>& asked, const std::string& why) {
  if (std::erase(asked_, asked) == 0) return;
  const CommandOutcome outcome{false, why};
  keep(asked->words, asked->by, outcome);
  asked->told(outcome);
}

void CommandDesk::end() {
  keeper_.end();
  tares_.end();
  for (const auto& asked : std::vector(asked_)) refuse(asked, "the program ends already");
}

void CommandDesk::run_here(const Words& words, std::string_view by, Told told) {
  const auto outcome = std::make_shared<CommandOutcome>();
  const auto tell = [this, words, by = std::string(by), told = std::move(told), outcome] {
    keep(words, by, *outcome);
    told(*outcome);
  };
  const auto done = [&] {
    *outcome = act(system_, words, by);
    return outcome->done;
  };
  if (words[0] == "tare" && verb_of(words, outcome->text) != nullptr) {
    try {
      return tares_.run(words, [outcome, tell](bool is_done, const std::string& text) {
        *outcome = {is_done, text};
        tell();
      });
    } catch (const std::exception& error) {
      outcome->text = detail::reason_of(error);
    }
  }
  if (words[0] == "tare") return tell();
  if (words.size() != 2 || (words[0] != "arm" && words[0] != "disarm")) {
    done();
    return tell();
  }
  keeper_.keep(words[1], done, [outcome, tell](const std::string& failed) {
    if (!failed.empty()) *outcome = {false, outcome->text + "; " + failed};
    tell();
  });
  if (!outcome->done) tell();
}

void CommandDesk::keep(const Words& words, std::string_view by, const CommandOutcome& outcome) {
  const std::string command = detail::listed(words, " ");
  log_("`" + command + "` by " + std::string(by) + ": " + outcome.text, outcome.done);
  try {
    if (!record_) {
      record_ = Feed<CommandRecord>(loop_, {.name = "rtdata-commands", .topic = command_topic});
      record_.set_numbered();  // it numbers its own events
    }
    record_.publish({detail::fitting<longest_command>(command), detail::fitting<60>(by), outcome.done,
                     detail::fitting<240>(outcome.text)});
  } catch (const std::exception& error) {
    log_("a command is not recorded: " + std::string(detail::reason_of(error)), false);
  }
}

}  // namespace rtdata::app
