// The subcommands that work on configurations. Each returns the exit status.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "app/core/show_as.hpp"
#include "rtdata/config/registry.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::app {

inline constexpr int exit_good = 0;
inline constexpr int exit_other = 1;
inline constexpr int exit_configuration = 2;
inline constexpr int exit_loss = 3;

/// "2 sensors, 1 sink": the number of parts of each kind that publishes or stores.
std::string counts_text(const Registry& registry, const SystemPlan& plan);

enum class OnLoss { ignore, fail };
enum class Talk { normal, quiet };

struct RunOptions {
  std::string file;
  std::optional<Duration> duration;  ///< none: until a signal
  std::string log_file;              ///< empty: as the configuration says
  OnLoss on_loss = OnLoss::ignore;
  Talk talk = Talk::normal;  ///< quiet: warnings and errors only
  /// A page where the configuration has none: its address, or the next free port; none: as the configuration says.
  std::optional<std::string> page = {};
};

int run(const Registry& registry, const RunOptions& options);
struct CheckOptions {
  std::string file;
  std::string against;  ///< the running configuration to compare with; empty: none
};
int check(const Registry& registry, const CheckOptions& options);
struct CalibrateOptions {
  std::string file;
  std::string sensor;  ///< or SENSOR.FIELD
};
/// Asks on standard input for the true values of what the sensor reads, and writes `points` into the file.
int calibrate(const Registry& registry, const CalibrateOptions& options);
int init(const Registry& registry, const std::string& file);
enum class DrawAs { mermaid, dot };
struct GraphOptions {
  std::string file;
  std::string machine;  ///< only this one; empty: all
  DrawAs draw_as = DrawAs::mermaid;
};
/// exit_other: there is no such machine; exit_configuration: the file has mistakes.
int graph(const Registry& registry, const GraphOptions& options);
struct ForwardOptions {
  std::string database;
  std::string file;  ///< the configuration whose sinks send
};
/// Sends all waiting events of the recording. exit_good: all sent; exit_other: ended earlier.
int forward(const Registry& registry, const ForwardOptions& options);
enum class TypesAs { text, all, schema, markdown };
/// `name`: a type, or a chip or search word; empty: all types, one line each (`all`: with parameters).
int types(const Registry& registry, const std::string& name, TypesAs format);

/// Prints the section of docs/errors.md about an error id; empty: lists the ids. exit_other: there is no such id.
int explain(std::string id);

enum class HowOften { live, once };
struct TopOptions {
  std::string instance;  ///< name or pid; empty: the only one
  HowOften how_often = HowOften::live;
  ShowAs show_as = ShowAs::text;
  std::string topic;  ///< only this one, a field a line; empty: all sensors
};
int top(const TopOptions& options);
int top_topic(const TopOptions& options);

struct LivePlotOptions {
  /// The first may be an instance, by name or pid; the others are TOPIC.FIELD, or TOPIC: all its numbers.
  std::vector<std::string> words;
  Duration window = std::chrono::minutes{1};
};
/// Draws the last time of an instance, each second anew on a terminal, else once.
int plot_instance(const LivePlotOptions& options);

/// Commands a running instance. `words`: at least one; the first may be the instance, by name or pid.
int ctl(const std::vector<std::string>& words);
/// The commands, a line each.
std::string ctl_help();

struct TailOptions {
  std::vector<std::string> words;  ///< the first may be an instance, by name or pid; the others are topics or patterns
  std::string step;                ///< a duration; empty: each event
  std::string from;                ///< an instant; empty: now
  ShowAs show_as = ShowAs::text;
};
/// Prints events as they come, a line each.
int tail(const TailOptions& options);

struct ScanOptions {
  std::string root;    ///< a copy of another machine's /proc, /sys, /etc, /dev; empty: this machine
  bool probe = false;  ///< reads from the free addresses of I2C adapters
  ShowAs show_as = ShowAs::text;
};
int scan(const Registry& registry, const ScanOptions& options);

struct DoctorOptions {
  std::string file;  ///< the configuration to check on this machine; empty: none
  std::string root;  ///< as in ScanOptions
  ShowAs show_as = ShowAs::text;
};
/// exit_good: nothing worse than notes; exit_loss: something costs timing or data; exit_configuration: the
/// configuration has mistakes, or needs something that cannot work.
int doctor(const Registry& registry, const DoctorOptions& options);

struct BenchOptions {
  Duration duration = std::chrono::seconds{60};  ///< approximate total of all parts
  std::string json_file;                         ///< empty: none
  std::optional<int> cpu;                        ///< the processor to sample on
};
int bench(const BenchOptions& options);

}  // namespace rtdata::app
