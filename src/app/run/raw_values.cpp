#include "app/run/raw_values.hpp"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <utility>
#include <variant>

#include "app/control/instances.hpp"
#include "app/core/terminal_text.hpp"
#include "app/inspect/stream_line.hpp"
#include "rtdata/loop/runtime.hpp"
#include "rtdata/loop/topic.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr Duration answer_limit = std::chrono::seconds{3};
constexpr const char* step = "50 ms";

/// For "accel[0]": "accel.raw[0]" if the array has a calibration, otherwise "accel[0].raw".
std::vector<std::string> raw_names(const std::string& field) {
  std::vector<std::string> names{field + ".raw"};
  if (const std::size_t bracket = field.rfind('['); bracket != std::string::npos)
    names.push_back(field.substr(0, bracket) + ".raw" + field.substr(bracket));
  names.push_back(field);
  return names;
}

class ValuesOfInstance final : public RawValues {
 public:
  ValuesOfInstance(ControlClient client, const Status::Instance& instance, const Status::Sensor& sensor,
                   const std::string& field)
      : client_(std::move(client)),
        where_("the running instance " + instance.name + ", pid " + std::to_string(instance.pid)),
        topic_(sensor.topic),
        sensor_(sensor.name),
        field_(field) {
    const Json request{{"request", "subscribe"}, {"version", Status::newest}, {"topics", {topic_}}, {"step", step}};
    client_.send(request.dump(-1, ' ', false, Json::error_handler_t::replace));
  }
  std::string where() const override { return where_; }
  Result<TakenValues> take(Duration time) override {
    TakenValues taken;
    const auto end = std::chrono::steady_clock::now() + time;
    while (true) {
      const Duration left = end - std::chrono::steady_clock::now();
      auto line = client_.receive(std::max(left, Duration{0}));
      if (!line) return line.error();
      if (!*line) {
        if (left <= Duration{0}) return taken;
        continue;
      }
      const Json came = Json::parse(**line, nullptr, false);
      if (!came.is_object()) continue;
      for (const char* const last : {"error", "ended"})
        if (came.contains(last)) return Error{Errc::closed, "no more values come", where_, text_in(came, last), ""};
      if (const Result<void> added = add(came, taken); !added) return added.error();
    }
  }

 private:
  Result<void> add(const Json& came, TakenValues& taken) const {
    const auto data = came.find("data");
    if (data == came.end() || !data->is_object() || !came.contains("count") || text_in(came, "topic") != topic_ ||
        text_in(came, "origin") != sensor_)
      return {};
    for (const std::string& name : raw_names(field_)) {
      const auto numbers = data->find(name);
      if (numbers == data->end()) continue;
      const auto number = [&](const char* key) {
        const auto found = numbers->find(key);
        return found != numbers->end() && found->is_number() ? found->get<double>() : std::nan("");
      };
      const double mean = number("mean");
      if (std::isfinite(mean))
        taken.add(static_cast<std::size_t>(whole_in(*numbers, "count")), mean, number("least"), number("most"));
      return {};
    }
    return Error{Errc::not_found, "no values", where_, "its sensor " + sensor_ + " has no number " + field_,
                 "if the file has changed, reload it first: rtdata ctl reload"};
  }

  ControlClient client_;
  const std::string where_, topic_, sensor_, field_;
};

class ValuesOfSensor final : public RawValues {
 public:
  ValuesOfSensor(const Registry& registry, const SystemPlan& alone, const std::string& sensor, const std::string& field)
      : runtime_(alone.runtime_config()), loop_(runtime_, alone.loop_config()) {
    runtime_.on_log([](const LogRecord& record) {
      if (record.level < LogLevel::warning) return;
      print_error(std::cerr, printable(std::string(record.object) + ": " + std::string(record.text)), record.error_id);
    });
    system_.emplace(loop_, registry, alone);
    const auto part = std::find_if(alone.parts.begin(), alone.parts.end(),
                                   [&](const PartPlan& one) { return one.kind == "sensor" && one.name == sensor; });
    values_ = loop_.subscribe(part->publishes->topic, [this, sensor, field](const EventView& event) {
      const Leaf* const leaf = event.origin() == sensor ? event.description().find(field) : nullptr;
      if (leaf == nullptr) return;
      const Value value = event.value(*leaf);
      double number = std::nan("");
      if (const auto* const whole = std::get_if<std::int64_t>(&value)) number = static_cast<double>(*whole);
      if (const auto* const natural = std::get_if<std::uint64_t>(&value)) number = static_cast<double>(*natural);
      if (const auto* const real = std::get_if<double>(&value)) number = *real;
      if (std::isfinite(number)) taken_.add(1, number, number, number);
    });
  }
  std::string where() const override { return "the sensor itself, which runs for this alone, without recording"; }
  Result<TakenValues> take(Duration time) override {
    taken_ = {};
    loop_.run_for(time);
    return taken_;
  }

 private:
  TakenValues taken_;
  Runtime runtime_;
  Loop loop_;
  std::optional<System> system_;
  Subscription values_;
};

/// Its file, if this user may know it; otherwise empty.
std::filesystem::path file_of(const Status::Instance& instance) {
  std::filesystem::path path = instance.configuration;
  if (path.is_absolute()) return path;
  std::error_code failed;
  const auto folder = std::filesystem::read_symlink("/proc/" + std::to_string(instance.pid) + "/cwd", failed);
  return failed ? std::filesystem::path() : folder / path;
}

/// The parts that this one needs, including itself: kind and name.
using PartNames = std::set<std::pair<std::string, std::string>>;
void collect(const SystemPlan& plan, const PartPlan& part, PartNames& needed) {
  if (part.kind == "output" || part.kind == "machine")
    throw SetupError({Errc::bad_argument, "cannot run the sensor alone", part.object(),
                      "the sensor needs it, and it may move something",
                      "start the whole configuration with `rtdata run`, then calibrate again"});
  if (!needed.emplace(part.kind, part.name).second) return;
  for (const PartUse& use : part.uses) {
    for (const PartPlan& other : plan.parts) {
      const bool is_meant = use.kind == "topic" ? other.publishes && other.publishes->topic == use.name
                                                : other.kind == use.kind && other.name == use.name;
      if (is_meant && other.kind != "tier") collect(plan, other, needed);
    }
  }
}

}  // namespace

void TakenValues::add(std::size_t values, double their_mean, double their_least, double their_most) {
  if (values == 0) return;
  least = count == 0 ? their_least : std::min(least, their_least);
  most = count == 0 ? their_most : std::max(most, their_most);
  sum += their_mean * static_cast<double>(values);
  count += values;
}

std::unique_ptr<RawValues> values_of_instance(const std::string& file, const std::string& sensor,
                                              const std::string& field) {
  for (const Instance& one : running_instances()) {
    auto client = ControlClient::connect(one.path);
    if (!client) continue;
    const auto line = client->ask(status_request, answer_limit);
    const Result<Status> status = line ? status_from(*line) : Result<Status>(line.error());
    if (!status) {
      print_error(std::cerr, "pid " + std::to_string(one.pid) + ": " + status.error().text(), status.error().id());
      continue;
    }
    std::error_code failed;
    if (!std::filesystem::equivalent(file_of(status->instance), file, failed)) continue;
    for (const Status::Sensor& known : status->sensors)
      if (known.name == sensor)
        return std::make_unique<ValuesOfInstance>(*std::move(client), status->instance, known, field);
  }
  return nullptr;
}

SystemPlan plan_alone(const Registry& registry, const SystemPlan& plan, const PartPlan& sensor) {
  PartNames needed;
  collect(plan, sensor, needed);
  ConfigItem root = plan.document.root;
  for (const PartKind& kind : registry.kinds()) {
    ConfigItem* const all = root.find(kind.key);
    if (all == nullptr) continue;
    for (std::size_t i = all->size(); i-- > 0;) {
      ConfigItem& item = *all->find(i);
      const auto part = std::find_if(plan.parts.begin(), plan.parts.end(), [&](const PartPlan& one) {
        return one.kind == kind.name && (kind.written == PartKind::Written::by_name ? one.name == all->children()[i].key
                                                                                    : one.item.place() == item.place());
      });
      if (part == plan.parts.end() || !needed.contains({part->kind, part->name})) {
        all->remove(i);
        continue;
      }
      item.remove("tier");
      if (&*part != &sensor) continue;
      item.remove("process");
      item.remove("start");
    }
  }
  for (const char* const key : {"tiers", "page", "control", "log"}) root.remove(key);
  ConfigDocument document;
  document.file = plan.document.file;
  document.root = std::move(root);
  return plan_system(registry, std::move(document));
}

std::unique_ptr<RawValues> values_of_sensor(const Registry& registry, const SystemPlan& alone,
                                            const std::string& sensor, const std::string& field) {
  return std::make_unique<ValuesOfSensor>(registry, alone, sensor, field);
}

}  // namespace rtdata::app
