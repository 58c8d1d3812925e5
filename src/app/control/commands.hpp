// The commands of a running instance (`rtdata ctl`), and their record.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "app/control/arm_keeper.hpp"
#include "app/control/tares.hpp"
#include "rtdata/config/system.hpp"
#include "rtdata/loop/tier.hpp"
#include "rtdata/sensors/feed.hpp"

namespace rtdata::app {

/// The topic of the records. `#` matches it.
inline constexpr const char* command_topic = "rtdata/commands";

/// The record of one command: the command, who gave it, and the result. Long texts are cut and end with "...".
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
  std::string text;  ///< the result, or why it was refused
};

/// The line that answers a command, without its end.
std::string command_answer(const CommandOutcome& outcome);

/// Repeats a recorded command that affects machines or limits: a named event, or the acknowledgement of an alarm.
/// Thread: the loop's.
void repeat_command(System& system, const CommandRecord& recorded);

/// True if a tier of this main loop runs and is not known to hang.
bool may_answer(Loop& loop, const Tier& tier);

/// Calls `function` on this main loop once the tier has turned, however late: the caller may be destroyed by then.
void when_it_turns(Loop& loop, Tier& tier, std::function<void()> function);

/// Commands the parts of a system. Thread: the loop's.
class CommandDesk {
 public:
  using Log = std::function<void(const std::string& text, bool done)>;
  using Told = std::function<void(const CommandOutcome&)>;
  CommandDesk(Loop& loop, System& system, Tares& tares, Log log)
      : loop_(loop), system_(system), log_(std::move(log)), keeper_(loop, system), tares_(loop, system, tares) {}

  /// Executes any command except `reload`, records it and calls back with the result: at once for most commands; for
  /// arming and disarming when it is on disk, or after 3 s; for a tare when it was measured; for a part on a tier when
  /// the tier turns. If the tier does not turn for 2 s, the command is refused; the loop continues meanwhile.
  void run(const std::vector<std::string>& words, std::string_view by, Told told);
  /// The run ends: answers all waiting clients.
  void end();
  /// Records a command and its result: an event on the topic, and a line in the log.
  void keep(const std::vector<std::string>& words, std::string_view by, const CommandOutcome& outcome);

 private:
  struct Asked;  // a question to a tier before its command is executed
  Tier* tier_of(const std::vector<std::string>& words) const;
  void run_here(const std::vector<std::string>& words, std::string_view by, Told told);
  void refuse(const std::shared_ptr<Asked>& asked, const std::string& why);

  Loop& loop_;
  System& system_;
  Log log_;
  std::vector<std::shared_ptr<Asked>> asked_;
  ArmKeeper keeper_;
  TareDesk tares_;
  Feed<CommandRecord> record_;  // made at the first command
};

/// The commands with their arguments, for help texts: "rate SENSOR RATE".
struct CommandHelp {
  const char* words;
  const char* meaning;
};
const std::vector<CommandHelp>& command_help();

}  // namespace rtdata::app
