// The losses of a run as text, for the end of `rtdata run` and for `rtdata verify`.
#pragma once

#include <string>
#include <vector>

#include "rtdata/recording/verify.hpp"

namespace rtdata::detail {

/// The part of failed whose sample is in unreadable, too. 0 where a read may bring several samples.
std::uint64_t failed_unreadable(const SensorCounts& of) noexcept;
/// "3 of them unreadable", behind the number of failed ticks.
std::string unreadable_text(std::uint64_t failed_unreadable);

/// "12 samples of room/climate (lost by the source 10, dropped by the queue 2) and 3 ticks (missed 3)".
std::string loss_text(const TopicLoss& loss);

/// "nothing lost: 12 rows"; or "LOST: ..." for each topic, "NOT KNOWN: ...", "not detectable: ...". From rows, losses
/// and what follows them in the report.
std::vector<std::string> account_lines(const RunReport& run);
/// All lines except the first.
std::vector<std::string> loss_lines(const std::vector<TopicLoss>& losses, const std::vector<std::string>& not_known,
                                    const std::vector<std::string>& not_detectable);

/// Appends them, wrapped and two columns to the right.
void add_lines(std::string& out, const std::vector<std::string>& lines);

}  // namespace rtdata::detail
