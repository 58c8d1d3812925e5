// The table rtdata_utc: the UTC conversion of each boot, used by the views. It can be computed from rtdata_clock.
#pragma once

#include <string>
#include <vector>

#include "recording/database.hpp"
#include "rtdata/recording/recording.hpp"

namespace rtdata::sqlite {

/// The pairs of the runs (called r) for which an SQL condition holds. Errors: those of the database.
std::vector<RecordedClock> clock_pairs(const Database& database, const std::string& condition);
/// The pairs that the runs of one boot recorded.
std::vector<RecordedClock> clock_pairs_of_boot(const Database& database, std::string_view boot_id);

/// Within a transaction: updates the boot's stretches from its pairs; does not write unchanged ones.
void write_utc_line(Database& database, std::string_view boot_id);
/// True if the stretches agree with the pairs.
bool utc_line_agrees(const Database& database, std::string_view boot_id);
/// Writes them for all boots of the file.
void write_utc_lines(Database& database);

struct View {
  std::string name;
  std::string sql;  ///< that makes it, as the file's schema has it then
};
/// The view with UTC of a topic's table: "room/climate~utc" for "room/climate".
View utc_view(const std::string& table, const Description& description);
void replace_view(const Database& database, const View& view);

/// Views of new tables, made together at the end of a transaction. A CREATE VIEW reads the whole schema, which would
/// take most of the time for thousands of new topics.
class NewUtcViews {
 public:
  /// Before the table is made. Errors: bad-description, when somebody has made a table of the view's name.
  static void look_for_room(const Database& database, const std::string& table);
  void add(const std::string& table, const Description& description);
  void make(Database& database);
  /// The transaction was given up.
  void clear() noexcept { views_.clear(); }

 private:
  /// False: this connection does not permit it, and nothing was changed.
  bool enter(Database& database);
  std::vector<View> views_;
};

/// SQL for the UTC in ns of a time column of run `run`; without a conversion the time is unchanged. The arguments must
/// not use the names `r` and `u`.
std::string utc_of(const std::string& time, const std::string& run);

/// The views rtdata_run_utc, "rtdata_gap~utc", "rtdata_health~utc" and "rtdata_error~utc" (the table and UTC), and
/// rtdata_field (every field of every topic with its unit).
std::vector<View> account_views();

}  // namespace rtdata::sqlite
