#include "app/core/standard_drivers.hpp"
#ifdef RTDATA_WITH_SQLITE
#include "config/read/mistakes.hpp"
#include "rtdata/recording/replay.hpp"
#include "rtdata/recording/sqlite.hpp"

namespace rtdata {

static constexpr auto parameters(type_tag<SqliteConfig>) {
  return parameter_list(
      parameter("path", &SqliteConfig::path, "the file; one that exists is added to", required, TextIs::output_file),
      parameter("profile", &SqliteConfig::profile,
                "what a power failure may cost: normal: 30 s, safe: what was not committed, fast: the file; card: for "
                "SD cards, "
                "10 s at risk",
                choices(value("normal", SqliteProfile::normal), value("safe", SqliteProfile::safe),
                        value("fast", SqliteProfile::fast), value("card", SqliteProfile::card))),
      parameter("max_bytes", &SqliteConfig::max_bytes,
                "the oldest rows are deleted when the recording takes more; 0: no limit, else at least 4 MiB",
                unit("By")),
      parameter("max_age", &SqliteConfig::max_age, "rows older than this are deleted; 0 s: no limit",
                range(std::chrono::seconds{0}, std::chrono::hours{24 * 36500})),
      parameter("steps", &SqliteConfig::steps,
                "also store a summary of each second and minute of a topic, for fast pictures"),
      parameter("permissions", &SqliteConfig::permissions,
                "permissions of a new file, in octal digits, minus the umask", TextIs::permissions),
      include_member(&SqliteConfig::sink));
}

static void check_config(const SqliteConfig& config, const ConfigItem& item, Problems& problems) {
  if (const auto is_recordable = check_recordable(config.path); !is_recordable) {
    const Error& error = is_recordable.error();
    problems.add(config_detail::child_or_self(item, "path").problem("cannot-record", error.why + "; " + error.advice));
  }
  if (config.max_bytes == 0 || config.max_bytes >= SqliteConfig::least_max_bytes) return;
  problems.add(config_detail::child_or_self(item, "max_bytes")
                   .problem("out-of-range", "max_bytes is " + std::to_string(config.max_bytes) +
                                                ": give at least 4194304 (4 MiB), or 0 for no limit"));
}

void app::add_recordings(Registry& registry) {
  registry.add_part<ReplayConfig>("sensor", "replay", "the events of a recording, as they came or faster",
                                  [](PartPlan& plan, const ReplayConfig& config) {
                                    plan.name = config.name.empty() ? ReplayConfig{}.name : config.name;
                                    plan.make = [config](Loop& loop, const Parts&) {
                                      return PartObject::made_by<Handle>([&] { return Replay(loop, config); });
                                    };
                                  });
  registry.add_sink<SqliteConfig>(
      "sqlite", "a SQLite file that describes itself and can be verified",
      [](const SqliteConfig& config) { return config.path; }, makes<SqliteSink>);
}

}  // namespace rtdata
#else
void rtdata::app::add_recordings(Registry& registry) {
  registry.leave_out("sink", "sqlite", "this program was built without SQLite");
}
#endif
