// Checks the parts of a configuration against each other. Private to src/config.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "config/plan/written_file.hpp"
#include "rtdata/config/registry.hpp"
#include "rtdata/config/system.hpp"

namespace rtdata::config_detail {

/// The maximum number of wrong names with a suggestion. A suggestion needs a search over all names, so this limit keeps
/// the time linear in the number of mistakes.
inline constexpr std::size_t most_suggestions = 100;

/// Knows the names, topics with their payloads, and files of the parts. Adding a part compares it with the earlier
/// ones; the time does not depend on their number, except for files. It includes parts with mistakes, as far as they
/// are known.
class Neighbours {
 public:
  /// `configuration`: the file, which no part may write; empty: none. `registry` must outlive it.
  Neighbours(const Registry& registry, const std::string& configuration);

  /// Adds a part and reports taken names, different payloads on one topic, and files that another part writes. The part
  /// must not move while this object is used.
  void add(const PartPlan& part, Problems& problems);
  /// After the last part: checks files of single topics that were not checked yet.
  void check_files_of_topics(Problems& problems);
  /// After the last part: checks that parts can store their topics, as far as not checked yet. May read files.
  void check_stored_topics(Problems& problems);
  /// Marks all topics added so far as checked, for all sinks added so far: `check_stored_topics` skips them.
  void assume_stored();
  /// Reports each part that `part` uses and that does not exist or has a wrong type.
  void check_uses(const PartPlan& part, Problems& problems);
  /// Checks that the recording of a sink with `through` has all topics of the sink.
  void check_through(const PartPlan& part, Problems& problems) const;
  /// Checks that the `stored_by` sink of a part takes its events, directly and on the same loop.
  void check_stored_by(const PartPlan& part, Problems& problems) const;
  /// Adds the log file, which no part may write. `at`: its item.
  void add_log(const LogSettings& log, const ConfigItem& at, Problems& problems);

  /// Null when there is none.
  const PartPlan* find(std::string_view kind, std::string_view name) const;
  /// Each topic, with the first part that publishes on it with a known payload.
  const std::map<std::string, const PartPlan*, std::less<>>& topics() const noexcept { return topics_; }
  /// All parts that publish on this topic.
  const std::vector<const PartPlan*>& publishers(const std::string& topic) const;

 private:
  /// Two sensors on one place of a bus.
  void check_place(const PartPlan& part, const PartPlan::Place& taken, Problems& problems);
  struct KnownFile {
    WrittenFile file;
    const PartPlan* part;  ///< null: the log
  };
  struct Storing {
    const PartPlan* part;
    std::size_t files = 0;   ///< the number of topic_names_ whose files have been checked
    std::size_t stored = 0;  ///< the number of topic_names_ for which `check_stored_topics` is done
    std::size_t named = 0;   ///< the number of publishing_ whose names have been checked
  };

  void check_name(const PartPlan& part, Problems& problems);
  /// Checks the values that the states of a machine set on outputs.
  void check_values(const PartPlan& machine, Problems& problems) const;
  void check_written_names(Problems& problems);
  void check_topic(const PartPlan& part, Problems& problems);
  void check_path(const PartPlan& part, Problems& problems);
  void check_file_of(const PartPlan& part, const std::string& topic, Problems& problems);
  std::string conflict_with_configuration(const WrittenFile& written) const;
  std::string conflict_with_files(const KnownFile& written) const;
  std::string suggestion(const PartUse& use);
  const PartPlan* namesake_of(const PartUse& use) const;

  const Registry& registry_;
  std::optional<FileIdentity> configuration_;
  std::map<std::pair<std::string, std::string>, const PartPlan*> names_;
  std::map<std::string, const PartPlan*> origins_;                         // what publishes, by its name
  std::map<std::pair<std::string, std::string>, const PartPlan*> places_;  // on buses, by bus and place
  std::map<std::string, const PartPlan*, std::less<>> topics_;
  std::map<std::string, const PartPlan*> topic_by_lower_case_;
  std::map<std::string, std::vector<const PartPlan*>> publishers_;
  std::vector<const PartPlan*> publishing_;  // in order of adding
  std::vector<std::string> topic_names_;     // in order of adding
  std::vector<Storing> storing_;
  std::set<const PartPlan*> refused_paths_;
  std::vector<KnownFile> files_;
  std::size_t suggestions_ = 0;
  std::size_t outputs_ = 0;
};

}  // namespace rtdata::config_detail
