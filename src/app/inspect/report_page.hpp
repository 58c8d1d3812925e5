// The page of `rtdata report`.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "app/inspect/course.hpp"
#include "app/inspect/curve.hpp"
#include "app/inspect/recorded_range.hpp"
#include "app/inspect/report_chart.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::app {

struct ReportContent {
  std::string file;     ///< of the recording, without its folder
  VerifyReport report;  ///< of one run
  RecordedRange range;  ///< all of it
  Plot plot;
  std::vector<std::string> not_drawn;                      ///< fields that are not numbers, with their types
  std::map<std::string, std::vector<TimedLimits>> limits;  ///< by "TOPIC.FIELD", also those of reloads
  Course course;
  std::vector<LedgerEntry> ledger;
  std::vector<RecordedSegment> schedule;
  std::vector<RecordedGap> gaps;
  std::vector<RecordedClock> clock;
  std::vector<RecordedError> errors;
  std::vector<RecordedHealth> health;
  std::vector<RecordedConfiguration> changes;
  Time made{};  ///< when the page is made
};

/// One file of HTML that needs no other file, for screens and A4. Texts of the recording are always escaped; lists have
/// limits, and say how much they omit.
std::string page_of(const ReportContent& content);

}  // namespace rtdata::app
