// Tares that commands set (`rtdata ctl tare`): measured, and kept in a file for the next start.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/config/system.hpp"
#include "rtdata/detail/loop/lane.hpp"
#include "rtdata/process/processing.hpp"

namespace rtdata::app {

/// The tares of one configuration. Thread: any.
class Tares {
 public:
  /// Reads the file; a missing file has no tares. `configuration`: its path; tares of another one are not used.
  Tares(std::string file, const std::string& configuration);
  const std::string& file() const noexcept { return file_; }
  /// Puts them into a configuration that was read, and returns which: "scale.value 12.5". A tare whose
  /// calibration has changed since is skipped, with a warning.
  std::string put_into(ConfigItem& root, Problems& warnings) const;
  std::string put_into_sensor(ConfigItem& sensor, Problems& warnings) const;
  /// Without a value: forgets it. Returns the new text of the file.
  std::string set(const std::string& sensor, const std::string& field, const Calibration& of,
                  std::optional<double> tare);

 private:
  struct Tare {
    std::string of;                    // the calibration that it was taken with
    std::optional<double> value = {};  // none: removed in this run
  };
  const std::string file_;
  std::string configuration_;
  std::string unreadable_;  // the reason; empty: it was read
  mutable std::mutex mutex_;
  std::map<std::pair<std::string, std::string>, Tare> all_;  // by sensor and field
};

/// Takes tares. Thread: the main loop's. Destroy it before the system.
class TareDesk {
 public:
  using Told = std::function<void(bool done, const std::string& text)>;
  TareDesk(Loop& loop, System& system, Tares& tares);
  ~TareDesk();

  /// `words`: "tare", SENSOR[.FIELD], perhaps "--clear". Calls back when the tare is applied and on the disk, within
  /// 4 s. SetupError: it is refused.
  void run(const std::vector<std::string>& words, Told told);
  /// The run ends: answers all that wait.
  void end();

 private:
  struct Taking;
  struct Writing;
  void look(const std::shared_ptr<Taking>& taking);
  void finish(const std::shared_ptr<Taking>& taking);
  /// Applies a tare (without a value: removes it) and writes the file; then answers with `text`.
  void apply(Taking& taking, std::optional<double> tare, const std::string& text);

  Loop& loop_;
  System& system_;
  Tares& tares_;
  detail::Lane lane_;
  std::vector<std::shared_ptr<Taking>> taking_;
  std::vector<std::shared_ptr<Told>> writing_;  // called when the file is written
};

}  // namespace rtdata::app
