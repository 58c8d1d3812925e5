#include "rtdata/sinks/export.hpp"

#include <charconv>
#include <ostream>

#include "app/commands.hpp"

namespace rtdata::app {
namespace {

/// ISO 8601 or ns since the epoch.
Result<std::optional<Time>> parse_time(const std::string& text) {
  if (text.empty()) return std::optional<Time>{};
  std::int64_t ns = 0;
  const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), ns);
  if (failed == std::errc{} && end == text.data() + text.size()) return std::optional{from_nanoseconds(ns)};
  auto time = parse_iso8601(text);
  if (!time) return std::move(time).error();
  return std::optional{*time};
}

int fail(std::ostream& err, const Error& error, int code) {
  err << "rtdata: " << error.text() << "\n";
  return code;
}

}  // namespace

int export_recording(const ExportOptions& options, std::ostream& out, std::ostream& err) {
  auto recording = Recording::open(options.database);
  if (!recording) return fail(err, recording.error(), 2);
  auto from = parse_time(options.from);
  if (!from) return fail(err, from.error(), 1);
  auto until = parse_time(options.until);
  if (!until) return fail(err, until.error(), 1);
  const bool is_utc = options.times == ExportOptions::Times::utc;
  ExportConfig config;
  config.format = options.format;
  config.filter = {options.topic, options.run, options.origin, *from, *until, options.limit, options.every};
  config.time = is_utc ? ExportTime::utc : ExportTime::recorded;
  config.time_text = is_utc ? ExportConfig::TimeText::iso8601 : ExportConfig::TimeText::nanoseconds;
  config.header = options.header == ExportOptions::Header::names ? ExportConfig::Header::names
                                                                 : ExportConfig::Header::names_and_units;
  const auto code_of = [](const Error& error) { return error.code == make_error_code(Errc::damaged) ? 2 : 1; };
  if (options.folder.empty()) {
    auto count = export_rows(*recording, config, out);
    if (!count) return fail(err, count.error(), code_of(count.error()));
    return 0;
  }
  auto counts = export_files(*recording, config, options.folder);
  if (!counts) return fail(err, counts.error(), code_of(counts.error()));
  for (const ExportCount& count : *counts)
    out << count.path << ": " << count.rows << (count.rows == 1 ? " row\n" : " rows\n");
  return 0;
}

}  // namespace rtdata::app
