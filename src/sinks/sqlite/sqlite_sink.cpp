#include <algorithm>

#include "loop/runtime_core.hpp"
#include "rtdata/sinks/sqlite.hpp"
#include "sinks/sqlite/sqlite_writer.hpp"
#include "sinks/sqlite/topic_table.hpp"

namespace rtdata {
namespace {

constexpr Duration card_batch_time = std::chrono::seconds{10};

SinkConfig named(const SqliteConfig& config) {
  SinkConfig sink = config.sink;
  if (sink.name.empty()) sink.name = config.path;
  if (config.profile == SqliteProfile::card) sink.batch_time = std::max<Duration>(sink.batch_time, card_batch_time);
  return sink;
}

std::unique_ptr<Writer> make_writer(Loop& loop, const SqliteConfig& config) {
  detail::RuntimeCore& runtime = loop.runtime().core();
  const sqlite::RunInfo run{runtime.config.name,
                            runtime.config.notes,
                            runtime.config.configuration,
                            runtime.clock().boot_id(),
                            loop.time(),
                            runtime.start().realtime.time_since_epoch() - runtime.start().monotonic.time_since_epoch()};
  std::vector<std::string> remarks;
  auto writer = std::make_unique<sqlite::SqliteWriter>(config, run, remarks);
  for (const std::string& remark : remarks) runtime.log(LogLevel::warning, "sink " + named(config).name, remark);
  return writer;
}

}  // namespace

std::vector<Error> refused_topics(const SqliteConfig&, std::span<const TopicToRecord> topics) {
  std::vector<Error> refused;
  for (const TopicToRecord& topic : topics) {
    if (topic.description == nullptr) continue;
    if (auto fits = sqlite::check_columns(topic.name, *topic.description); !fits)
      refused.push_back(std::move(fits).error());
  }
  return refused;
}

SqliteSink::SqliteSink(Loop& loop, SqliteConfig config) : Sink(loop, named(config), make_writer(loop, config)) {}

}  // namespace rtdata
