// Curves of a running instance.
#pragma once

#include <cstdint>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <tuple>
#include <vector>

#include "app/control/status.hpp"
#include "app/inspect/curve.hpp"

namespace rtdata::app {

/// Fields of an instance over the last time, made of the steps that docs/subscribe.md describes. A value; its owner's
/// thread.
class LiveCurves {
 public:
  /// `fields`: TOPIC.FIELD, or TOPIC for all its numbers; none: all there are. `topics`: of the instance. `window`:
  /// the time that is kept. Throws SetupError: there is no such topic, with the nearest name.
  LiveCurves(const std::vector<std::string>& fields, const std::vector<std::string>& topics, Duration window);

  /// The line that asks for the steps. `with_past`: from the recording too.
  std::string request(Duration step, bool with_past) const;
  /// A line of the answer. Throws SetupError (not_found): the topic has no such number, with the nearest name.
  void take(std::string_view line);
  /// The requested earlier values have come.
  bool is_live() const noexcept { return is_live_; }
  bool is_empty() const noexcept { return curves_.empty(); }

  struct Field {
    Curve curve;
    double last = 0;  ///< the newest number
    Time last_at{};   ///< end of its step
    bool has_last = false;
  };
  /// In the order of the fields.
  std::vector<const Field*> fields() const;
  /// The last window, in steps that are not shorter than `step`, up to the newest line. `status`: for the losses.
  Plot plot(Duration step, const Status& status) const;
  Time now() const noexcept { return now_; }

 private:
  struct Wanted {
    std::string topic, path;  ///< path empty: all
    bool is_found = false;
  };
  using Json = nlohmann::ordered_json;
  void take_step(const Json& line);
  void take_gap(const Json& data);
  void prune();

  std::vector<Wanted> wanted_;
  bool wants_all_;
  Duration window_;
  Time now_{};
  bool is_live_ = true;
  std::map<std::string, std::map<std::string, std::string>> units_;  // by topic and path
  // By the place of the field in `wanted_`, topic, origin and the place of the number among those of its topic.
  using Key = std::tuple<std::size_t, std::string, std::size_t>;
  std::map<Key, Field> curves_;
};

}  // namespace rtdata::app
