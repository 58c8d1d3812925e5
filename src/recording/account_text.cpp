#include "recording/account_text.hpp"

#include <algorithm>
#include <utility>

#include "data/wrap.hpp"

namespace rtdata::detail {
namespace {

/// "missed 2, failed 1": the parts that are not 0.
std::string parts_of(std::initializer_list<std::pair<const char*, std::uint64_t>> parts) {
  std::string text;
  for (const auto& [what, count] : parts)
    if (count != 0) text += (text.empty() ? "" : ", ") + std::string(what) + " " + std::to_string(count);
  return text;
}

std::string counted(std::uint64_t count, const char* one) {
  return std::to_string(count) + " " + one + (count == 1 ? "" : "s");
}

std::string first_names(const std::vector<std::string>& names, std::size_t most) {
  std::string text;
  for (std::size_t i = 0; i < names.size() && i < most; ++i) text += (i == 0 ? "" : ", ") + names[i];
  return text + (names.size() > most ? " and " + std::to_string(names.size() - most) + " more" : "");
}

}  // namespace

std::uint64_t failed_unreadable(const SensorCounts& of) noexcept {
  return of.has_schedule && of.is_one_a_read ? std::min(of.failed, of.unreadable) : 0;
}

std::string unreadable_text(std::uint64_t failed_unreadable) {
  return std::to_string(failed_unreadable) + " of them unreadable";
}

std::string loss_text(const TopicLoss& loss) {
  std::vector<std::string> parts;
  if (loss.samples() != 0) {
    parts.push_back(counted(loss.samples(), "sample"));
    parts.back() += " (" +
                    parts_of({{"lost by the source", loss.by_source},
                              {"unreadable", loss.unreadable - loss.failed_unreadable},
                              {"dropped by the queue", loss.dropped_newest + loss.dropped_oldest},
                              {"refused on storing", loss.refused},
                              {"not saved", loss.not_saved}}) +
                    ")";
  }
  if (loss.ticks() != 0)
    parts.push_back(counted(loss.ticks(), "tick") + " (" +
                    parts_of({{"missed", loss.missed}, {"failed", loss.failed}}) +
                    (loss.failed_unreadable != 0 ? ", " + unreadable_text(loss.failed_unreadable) : "") + ")");
  if (loss.outages.number != 0)
    parts.push_back(to_string(loss.outages) + " (the number of missing samples is not known)");
  std::string text;
  for (std::size_t i = 0; i < parts.size(); ++i)
    text += (i == 0 ? "" : i + 1 < parts.size() ? ", " : " and ") + parts[i];
  const std::string of = loss.topic.empty() ? "sensors that had only begun" : loss.topic;
  text.insert(text.find(" ("), " of " + of);
  if (!loss.made_of_it.empty())
    text += ", of which " + first_names(loss.made_of_it, 5) + (loss.made_of_it.size() == 1 ? " is made" : " are made");
  return text;
}

std::vector<std::string> loss_lines(const std::vector<TopicLoss>& losses, const std::vector<std::string>& not_known,
                                    const std::vector<std::string>& not_detectable) {
  constexpr std::size_t most = 8;
  std::vector<std::string> lines;
  for (std::size_t i = 0; i < losses.size() && i < most; ++i) lines.push_back("LOST: " + loss_text(losses[i]));
  if (losses.size() > most)
    lines.push_back("LOST: and of " + counted(losses.size() - most, "more topic") + " (verify --json has them all)");
  for (std::size_t i = 0; i < not_known.size() && i < most; ++i) lines.push_back("NOT KNOWN: " + not_known[i]);
  if (not_known.size() > most)
    lines.push_back("NOT KNOWN: and " + std::to_string(not_known.size() - most) + " more (verify --json has them all)");
  if (!not_detectable.empty())
    lines.push_back("not detectable: losses in the sources of " + first_names(not_detectable, most) +
                    ", which do not number their samples");
  return lines;
}

std::vector<std::string> account_lines(const RunReport& run) {
  std::vector<std::string> lines = loss_lines(run.losses, run.not_known, run.not_detectable);
  if (run.losses.empty())
    lines.insert(lines.begin(), std::string(run.not_known.empty() ? "nothing lost: " : "nothing lost that is known: ") +
                                    counted(run.rows, "row"));
  if (!run.mute.empty()) lines.push_back("NO EVENT ever came from " + first_names(run.mute, 8));
  return lines;
}

void add_lines(std::string& out, const std::vector<std::string>& lines) {
  std::string before;
  for (const std::string& line : lines) {
    const std::size_t colon = line.find(": ");
    const std::size_t begin = colon == std::string::npos ? 0 : colon + 2;
    const std::string bullet = "  " + line.substr(0, begin);
    wrap(out, bullet == before ? std::string(bullet.size(), ' ') : bullet, line.substr(begin));
    before = bullet;
  }
}

}  // namespace rtdata::detail
