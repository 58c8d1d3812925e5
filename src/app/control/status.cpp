#include "app/control/status.hpp"

#include <algorithm>
#include <array>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <type_traits>

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

// The keys, for both directions. Times whose key ends with "_s" are seconds, all others nanoseconds.

template <class Visit>
void fields(Visit& visit, Status::Instance& of) {
  visit("name", of.name), visit("pid", of.pid), visit("started", of.started), visit("running_for_s", of.running_for);
  visit("configuration", of.configuration);
}

template <class Visit>
void health_fields(Visit& visit, Health& health, std::string& reason) {
  visit.object("health", [&](auto& in) { in("state", health), in("reason", reason); });
}

template <class Visit>
void count_fields(Visit& visit, Status::Account& of) {
  visit("published", of.published), visit("late", of.late), visit("missed", of.missed), visit("failed", of.failed);
  visit("unreadable", of.unreadable), visit("failed_unreadable", of.failed_unreadable);
  visit("repeated", of.repeated), visit("outages", of.outages.number);
  visit("outage_time_s", of.outages.time), visit("first_lines", of.first_lines);
  std::optional<std::uint64_t> lost = of.lost_is_known ? std::optional(of.lost) : std::nullopt;
  visit("lost", lost), of.lost_is_known = lost.has_value(), of.lost = lost.value_or(0);
}

template <class Visit>
void fields(Visit& visit, Status::Account& of) {
  visit("name", of.name), count_fields(visit, of), visit("dropped", of.dropped);
  visit("handlers_dropped", of.handlers_dropped), health_fields(visit, of.health, of.reason);
}

template <class Visit>
void fields(Visit& visit, Status::Lateness& of) {
  visit("p50", of.p50), visit("p99", of.p99), visit("max", of.max);
}

template <class Visit>
void fields(Visit& visit, Status::Alarm& of) {
  visit("alarm", of.name), visit("active", of.is_active), visit("acknowledged", of.is_acknowledged);
}

template <class Visit>
void fields(Visit& visit, Status::Sensor& of) {
  visit("name", of.name), visit("topic", of.topic), visit("loop", of.loop), visit("running", of.is_running);
  visit("wanted_hz", of.wanted_hz), visit("reached_hz", of.reached_hz), count_fields(visit, of);
  visit("lateness_ns", of.lateness), health_fields(visit, of.health, of.reason);
  of.value = of.shown();
  visit("value", of.value), visit("alarm", of.alarm), visit("state", of.state), visit("in_state_s", of.in_state);
}

template <class Visit>
void fields(Visit& visit, Status::Loop& of) {
  visit("name", of.name), visit("tier", of.is_tier), visit("running", of.is_running), visit("policy", of.policy);
  visit("priority", of.priority), visit("load_percent", of.load_percent), visit("lateness_ns", of.lateness);
  visit("warnings", of.warnings), visit("hangs_in", of.hangs_in);
}

template <class Visit>
void fields(Visit& visit, Backlog& of) {
  std::optional<std::int64_t> oldest;
  if (of.oldest != Time{}) oldest = to_nanoseconds(of.oldest);
  visit("bytes", of.bytes), visit("age_s", of.age), visit("catch_up_s", of.catch_up), visit("oldest", oldest);
  of.oldest = Time{Duration{oldest.value_or(0)}};
}

template <class Visit>
void fields(Visit& visit, Status::Sink& of) {
  visit("name", of.name), visit("path", of.path), visit("offered", of.offered), visit("queued", of.queued);
  std::uint64_t dropped = of.all_dropped();
  visit("stored", of.stored), visit("dropped", dropped);
  visit.object("dropped_by_reason", [&](auto& in) {
    for (std::size_t i = 0; i < drop_reasons; ++i) in(name_of(static_cast<DropReason>(i)).data(), of.dropped[i]);
  });
  health_fields(visit, of.health, of.reason), visit("backlog", of.backlog);
}

template <class Visit>
void fields(Visit& visit, Status::Place& of) {
  visit("place", of.place), visit("transfers", of.transfers), visit("failed", of.failed), visit("retried", of.retried);
  visit("busy_ns", of.busy), visit("longest_ns", of.longest), visit("skipped_bytes", of.skipped_bytes);
}

template <class Visit>
void fields(Visit& visit, Status::Part& of) {
  visit("kind", of.kind), visit("name", of.name), visit("type", of.type), visit("users", of.users);
  visit("places", of.places);
}

template <class Visit>
void fields(Visit& visit, Status::Callback& of) {
  visit("name", of.name), visit("loop", of.loop), visit("count", of.count), visit("total_ns", of.total);
  visit("max_ns", of.max);
}

template <class Visit>
void fields(Visit& visit, Status& of) {
  visit("version", of.version), visit("instance", of.instance), visit("total", of.total), visit("queued", of.queued);
  visit("waiting", of.waiting), visit("loops", of.loops), visit("sensors", of.sensors), visit("topics", of.topics);
  visit("sinks", of.sinks), visit("parts", of.parts), visit("callbacks", of.callbacks), visit("mute", of.mute);
  visit("not_detectable", of.not_detectable);
}

template <class T>
concept List = requires(T list) {
  list.emplace_back();
};
template <class T>
concept Optional = requires(T value) {
  value.has_value();
};

class Writer {
 public:
  template <class T>
  void operator()(const char* key, T& value) {
    json_[key] = made(key, value);
  }
  template <class Inner>
  void object(const char* key, const Inner& inner) {
    Writer in;
    inner(in);
    json_[key] = std::move(in.json_);
  }
  Json& json() noexcept { return json_; }

 private:
  template <class T>
  static Json made(std::string_view key, T& value) {
    if constexpr (Optional<T>) {
      return value ? made(key, *value) : Json();
    } else if constexpr (List<T>) {
      Json list = Json::array();
      for (auto& one : value) list.push_back(made(key, one));
      return list;
    } else if constexpr (std::is_same_v<T, Duration>) {
      return key.ends_with("_s") ? Json(std::chrono::duration<double>(value).count()) : Json(value.count());
    } else if constexpr (std::is_same_v<T, Health>) {
      return std::string(name_of(value));
    } else if constexpr (std::is_arithmetic_v<T> || std::is_same_v<T, std::string>) {
      return value;
    } else {
      Writer in;
      fields(in, value);
      return std::move(in.json_);
    }
  }
  Json json_ = Json::object();
};

/// A missing key leaves the value unchanged, because an older instance does not know it. Throws the exceptions of
/// nlohmann.
class Reader {
 public:
  explicit Reader(const Json& json) : json_(json) { (void)json.get_ref<const Json::object_t&>(); }
  template <class T>
  void operator()(const char* key, T& value) {
    if (const auto found = json_.find(key); found != json_.end()) take(key, *found, value);
  }
  template <class Inner>
  void object(const char* key, const Inner& inner) {
    if (const auto found = json_.find(key); found != json_.end()) {
      Reader in(*found);
      inner(in);
    }
  }

 private:
  template <class T>
  static void take(std::string_view key, const Json& json, T& value) {
    if constexpr (Optional<T>) {
      if (json.is_null()) return value.reset();
      take(key, json, value.emplace(typename T::value_type{}));
    } else if constexpr (List<T>) {
      for (const Json& one : json.get_ref<const Json::array_t&>()) take(key, one, value.emplace_back());
    } else if constexpr (std::is_same_v<T, Duration>) {
      const std::chrono::duration<double, std::nano> time(json.get<double>() * (key.ends_with("_s") ? 1e9 : 1));
      value = Duration{static_cast<Duration::rep>(std::min(std::max(time.count(), -9e18), 9e18))};
    } else if constexpr (std::is_same_v<T, Health>) {
      const auto name = json.get<std::string>();
      value = name == "ok" ? Health::ok : name == "degraded" ? Health::degraded : Health::faulted;
    } else if constexpr (std::is_arithmetic_v<T> || std::is_same_v<T, std::string>) {
      value = json.get<T>();
    } else {
      Reader in(json);
      fields(in, value);
    }
  }
  const Json& json_;
};

Error no_status(Errc code, const std::string& why, const char* advice) {
  return {code, "no status", "instance", why, advice};
}

}  // namespace

std::string shown_value(const Value& value) {
  const double* const number = std::get_if<double>(&value);
  if (number == nullptr) return to_string(value);
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.6g", *number);
  return text.data();
}

std::optional<std::string> Status::Sensor::shown() const {
  constexpr std::size_t longest = 200;
  if (value || description == nullptr || payload.empty()) return value;
  std::string text;
  for (const Leaf& leaf : description->leaves()) {
    if (text.size() > longest) return text + " ...";
    text += (text.empty() ? "" : " ") + shown_value(read(leaf, payload.data()));
    if (!leaf.unit.empty() && leaf.unit != "1") text += " " + leaf.unit;
  }
  return text;
}

std::string json_of(Status& status) {
  Writer writer;
  fields(writer, status);
  return writer.json().dump(-1, ' ', false, Json::error_handler_t::replace);
}

Result<Status> status_from(std::string_view line) try {
  const Json json = Json::parse(line);
  if (json.contains("ended")) return no_status(Errc::closed, "the instance has ended", "start it again");
  if (json.contains("error")) return no_status(Errc::io_failed, json["error"].get<std::string>(), "");
  const auto version = json.at("version").get<std::int64_t>();
  if (version > Status::newest)
    return no_status(Errc::newer_version,
                     "it speaks version " + std::to_string(version) + " of the protocol, and this program up to " +
                         std::to_string(Status::newest),
                     "use the version of the program that runs there, or a newer one");
  Status status;
  Reader reader(json);
  fields(reader, status);
  return status;
} catch (const Json::exception&) {
  return no_status(Errc::bad_data, "the answer of the instance does not fit the request",
                   "use the same version of the program on both sides");
}

}  // namespace rtdata::app
