#include "data/setting_mistake.hpp"
#include "postgresql/libpq.hpp"
#include "postgresql/postgresql_writer.hpp"
#include "rtdata/data/config_item.hpp"
#include "rtdata/postgresql/sink.hpp"

namespace rtdata {
namespace {

SinkConfig named(const PostgresqlConfig& config) {
  SinkConfig sink = config.sink;
  if (sink.name.empty()) sink.name = "postgresql";
  return sink;
}

std::unique_ptr<Writer> make_writer(const PostgresqlConfig& config) {
  PostgresqlConfig whole = config;
  whole.sink = named(config);
  return std::make_unique<postgresql::PostgresqlWriter>(whole);
}

}  // namespace

void check_config(const PostgresqlConfig& config, const ConfigItem& item, Problems& problems) {
  if (!detail::add_not_installed(detail::libpq.load(), item, problems)) return;
  const auto tell = [&](std::string why) { detail::add_mistake({"url", std::move(why)}, item, problems); };
  if (config.schema.starts_with("pg_"))
    detail::add_mistake({"schema", "names that begin with pg_ are reserved for the server", "choose another"}, item,
                        problems);
  try {
    if (!postgresql::password_in(config.url).empty())
      tell(
          "it has a password in it, which recordings would hold; give it as `password`: {\"env\": ...} or {\"file\": "
          "...}");
  } catch (const SetupError& error) {
    tell(error.error().why + "; " + error.error().advice);
  }
}

std::vector<Error> refused_topics(const PostgresqlConfig&, std::span<const TopicToRecord> topics) {
  std::vector<Error> refused;
  for (const TopicToRecord& topic : topics) {
    if (topic.description == nullptr) continue;
    if (auto fits = postgresql::check_columns(topic.name, *topic.description); !fits)
      refused.push_back(std::move(fits).error());
  }
  return refused;
}

PostgresqlSink::PostgresqlSink(Loop& loop, PostgresqlConfig config) : Sink(loop, named(config), make_writer(config)) {}

}  // namespace rtdata
