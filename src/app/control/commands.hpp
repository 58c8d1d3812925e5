// What a running instance can be commanded to do (`rtdata ctl`), and the record of it.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "app/control/arm_keeper.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata::app {

/// The topic of the record. `#` matches it.
inline constexpr const char* command_topic = "rtdata/commands";

/// One command, as it is recorded: what, by whom, and what came of it. Texts that are too long end with "...".
struct CommandRecord {
  text<240> command;
  text<60> by;  ///< "uid 1000, pid 4711"
  bool done = false;
  text<240> outcome;
  friend constexpr auto describe(type_tag<CommandRecord>) {
    return record("command", field("command", &CommandRecord::command), field("by", &CommandRecord::by),
                  field("done", &CommandRecord::done), field("outcome", &CommandRecord::outcome));
  }
};

struct CommandOutcome {
  bool done = false;
  std::string text;  ///< what has been done, or why not
};

/// The line that answers a command, without its end.
std::string command_answer(const CommandOutcome& outcome);

/// Gives the system a command of a recording again that machines and limits decide by: a named event, or that an alarm
/// was seen. Thread: the loop's.
void repeat_command(System& system, const CommandRecord& recorded);

/// Whether a tier of this main loop is worth asking: it runs, and is not known to hang. That one refuses at once.
bool may_answer(Loop& loop, const Tier& tier);

/// Calls `function` on this main loop once the tier has turned, however late that is: who asks may be gone then.
void when_it_turns(Loop& loop, Tier& tier, std::function<void()> function);

/// Commands the parts of a system. Thread: the loop's.
class CommandDesk {
 public:
  using Log = std::function<void(const std::string& text, bool done)>;
  using Told = std::function<void(const CommandOutcome&)>;
  CommandDesk(Loop& loop, System& system, Log log)
      : loop_(loop), system_(system), log_(std::move(log)), keeper_(loop, system) {}

  /// Does what the words say, of all commands but `reload`, records it, and tells what came of it: at once, but of
  /// arming and disarming when that is on the card, or after 3 s, and of a part of a tier when that turns. One that
  /// does not for 2 s is refused; the loop goes on meanwhile.
  void run(const std::vector<std::string>& words, std::string_view by, Told told);
  /// The run ends: who still waits is told.
  void end();
  /// Records a command and what came of it: its event is the topic's, and a line of the log.
  void keep(const std::vector<std::string>& words, std::string_view by, const CommandOutcome& outcome);

 private:
  struct Asked;  // a tier, before what is to be done there
  Tier* tier_of(const std::vector<std::string>& words) const;
  void run_here(const std::vector<std::string>& words, std::string_view by, Told told);
  void refuse(const std::shared_ptr<Asked>& asked, const std::string& why);

  Loop& loop_;
  System& system_;
  Log log_;
  std::vector<std::shared_ptr<Asked>> asked_;
  ArmKeeper keeper_;
  Feed<CommandRecord> record_;  // made with the first command
};

/// The verbs and what follows each, for people: "rate SENSOR RATE".
struct CommandHelp {
  const char* words;
  const char* meaning;
};
const std::vector<CommandHelp>& command_help();

}  // namespace rtdata::app
