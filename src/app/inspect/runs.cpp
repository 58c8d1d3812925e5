// rtdata runs: the runs of a recording, one line each.
#include "rtdata/recording/runs.hpp"
#include "app/core/terminal_text.hpp"

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <ostream>

#include "app/core/amounts.hpp"
#include "app/core/recording_commands.hpp"
#include "app/core/table.hpp"
#include "rtdata/recording/verify.hpp"

namespace rtdata::app {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t columns = 80;

/// The end of a running or unsealed run is not in the file yet.
std::optional<Time> end_of(const RunReport& run) {
  if (!run.info.ended || run.info.state == RunState::recording) return std::nullopt;
  return run.line.utc(*run.info.ended);
}

std::optional<Duration> length_of(const RunReport& run) {
  const auto end = end_of(run);
  if (!end) return std::nullopt;
  return *end - run.line.utc(run.info.started);
}

std::string one_line(std::string text) {
  std::replace_if(
      text.begin(), text.end(), [](char c) { return c == '\n' || c == '\t'; }, ' ');
  return text;
}

std::string verdict_of(const RunReport& run) {
  return std::string(name_of(run.verdict)) + (run.losses.empty() ? "" : ", LOST");
}

void print(const VerifyReport& report, std::ostream& out) {
  std::vector<std::vector<std::string>> lines;
  std::size_t names = 4, notes = 0, others = 0;  // the widest
  std::vector<std::size_t> widest(7);
  for (const RunReport& run : report.runs) {
    const auto length = length_of(run);
    lines.push_back({std::to_string(run.info.run), one_line(run.info.name),
                     to_iso8601(run.line.utc(run.info.started)).substr(0, 19) + "Z", length ? span_text(*length) : "-",
                     std::to_string(run.rows), verdict_of(run), one_line(run.info.notes)});
    for (std::size_t i = 0; i < widest.size(); ++i) widest[i] = std::max(widest[i], width_of(lines.back()[i]));
  }
  const std::vector<std::string> heading{">run", "name", "started (UTC)", ">length", ">rows", "verdict", "notes"};
  for (std::size_t i : {0u, 2u, 3u, 4u, 5u})
    others += std::max(widest[i], heading[i].size() - (heading[i].front() == '>' ? 1 : 0)) + 2;
  // Names and notes share the remaining width.
  constexpr std::size_t least = 8;
  const std::size_t left = columns - std::min(columns, others);
  notes = widest[6] == 0 ? 0 : std::max(widest[6], heading[6].size());
  names = std::max(widest[1], heading[1].size());
  if (names + 2 + notes > left)
    names = std::min(names, std::max(least, left - std::min(left, std::min<std::size_t>(notes, 24) + 2)));
  notes = std::min(notes, left - std::min(left, names + 2));
  Table table(notes < least ? std::vector(heading.begin(), heading.end() - 1) : heading);
  for (std::vector<std::string>& line : lines) {
    line[1] = fitted(line[1], names);
    line[6] = fitted(line[6], notes);
    if (notes < least) line.pop_back();
    table.add(std::move(line));
  }
  if (!report.runs.empty()) out << table.text();
  if (report.deleted)
    out << (report.runs.empty() ? "" : "\n") << report.deleted->runs.runs << " of the runs "
        << report.deleted->runs.first_run << " to " << report.deleted->runs.last_run
        << (report.deleted->runs.runs == 1 ? " was" : " were") << " deleted: see `rtdata verify`\n";
  if (report.runs.empty() && !report.deleted) out << "No run was recorded yet.\n";
}

std::string hash_text(std::uint64_t hash) {
  char text[17];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(hash));
  return text;
}

void print_json(const VerifyReport& report, const std::map<std::int64_t, std::uint64_t>& hashes, std::ostream& out) {
  Json json{{"path", report.path},
            {"deleted_runs", report.deleted ? report.deleted->runs.runs : 0},
            {"problems", report.problems},
            {"runs", Json::array()}};
  for (const RunReport& run : report.runs) {
    const auto length = length_of(run);
    Json one{{"run", run.info.run},   {"uuid", run.info.uuid},
             {"name", run.info.name}, {"notes", run.info.notes},
             {"host", run.info.host}, {"started_utc", to_iso8601(run.line.utc(run.info.started))}};
    const auto end = end_of(run);
    one["ended_utc"] = end ? Json(to_iso8601(*end)) : Json();
    one["length_s"] = length ? Json(std::chrono::duration<double>(*length).count()) : Json();
    one["rows"] = run.rows;
    one["verdict"] = name_of(run.verdict);
    one["lines"] = run.lines;
    one["remark"] = run.info.remark;
    one["hash"] = hash_text(hashes.at(run.info.run));
    json["runs"].push_back(std::move(one));
  }
  out << json.dump(2, ' ', false, Json::error_handler_t::replace) << "\n";
}

}  // namespace

int runs(const RunsOptions& options, std::ostream& out, std::ostream& err) try {
  const Recording recording = Recording::open(options.database).or_throw();
  const VerifyReport report = rtdata::verify(recording).or_throw();
  if (options.show_as == ShowAs::json) {
    print_json(report, hashes_of_runs(recording).or_throw(), out);
  } else {
    print(report, out);
  }
  for (const std::string& problem : report.problems)
    print_error(err, options.database + ": not balanced: " + problem, "damaged");
  return 0;
} catch (const SetupError& error) {
  print_error(err, error.error());
  return status_after(error.error());
}

}  // namespace rtdata::app
