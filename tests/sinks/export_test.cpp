#include "rtdata/recording/export.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "sinks/recordings.hpp"

using namespace rtdata;
using namespace recordings;

TEST_SUITE_BEGIN("sinks");

namespace {

struct Other {
  std::int64_t temperature = 7;
  RTDATA_FIELDS(Other, (temperature, "K"))
};

std::vector<std::string> lines_of(const std::string& text) {
  std::istringstream stream(text);
  std::vector<std::string> lines;
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

std::string content_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

}  // namespace

TEST_CASE("FW-5 one topic as CSV, with a header") {
  const Folder folder;
  const auto recording = Recording::open(make(folder)).or_throw();
  std::ostringstream out;
  const auto count = export_rows(recording, {.filter = {.topic = "room/climate"}}, out).or_throw();
  CHECK(count.rows == 999);
  const auto lines = lines_of(out.str());
  REQUIRE(lines.size() == 1000);
  CHECK(lines[0] == "time,origin,sequence,temperature,humidity");
  const std::string start = std::to_string(to_nanoseconds(recording.runs().or_throw()[0].started));
  CHECK(lines[1] == start + ",room,1,1,40");
  CHECK(lines[999].find(",room,999,1001,40") != std::string::npos);
}

TEST_CASE("FW-5 several topics do not fit one CSV text; JSON lines take them, and read back equal") {
  const Folder folder;
  const auto recording = Recording::open(make(folder)).or_throw();
  std::ostringstream out;
  const auto refused = export_rows(recording, {}, out);
  REQUIRE_FALSE(refused);
  CHECK(refused.error().id() == "bad-argument");
  CHECK(refused.error().why.find("every/thing, room/climate") != std::string::npos);
  CHECK(out.str() == "");
  CHECK(export_rows(recording, {.format = "jsonl"}, out).or_throw().rows == 1001);
  const auto lines = lines_of(out.str());
  REQUIRE(lines.size() == 1001);
  const auto line = std::find_if(lines.begin(), lines.end(),
                                 [](const std::string& l) { return l.find("every/thing") != std::string::npos; });
  REQUIRE(line != lines.end());
  const auto codec = make_json_codec();
  const auto same = decode<Everything>(*codec, std::as_bytes(std::span(*line))).or_throw();
  CHECK(same.data == full());
  CHECK(same.origin == "program feed");
  CHECK(export_rows(recording, {.format = "jsom"}, out).error().id() == "not-found");
}

TEST_CASE("FW-5 a folder gets a file a topic") {
  const Folder folder;
  const std::string path = make(folder);
  std::ostringstream out, err;
  CHECK(app::export_recording({.database = path, .folder = folder / "out"}, out, err) == 0);
  CHECK(err.str() == "");
  CHECK(lines_of(content_of(folder / "out/room/climate.csv")).size() == 1000);
  CHECK(lines_of(content_of(folder / "out/every/thing.csv")).size() == 4);  // one text has a line end
  CHECK(out.str().find("climate.csv: 999 rows") != std::string::npos);
}

TEST_CASE("FW-5 a folder's files are replaced only when that is asked for, and none is written otherwise") {
  const Folder folder;
  const std::string path = make(folder);
  std::filesystem::create_directories(folder / "out/room");
  std::ofstream(folder / "out/room/climate.jsonl") << "my own configuration";
  for (const char* format : {"json", "jsonl"}) {
    std::ostringstream out, err;
    CHECK(app::export_recording({.database = path, .format = format, .folder = folder / "out"}, out, err) == 1);
    CHECK(out.str() == "");
    CHECK(err.str() ==
          "rtdata: cannot export into the folder: " + (folder / "out/room/climate.jsonl") +
              ": the file exists: choose another folder, or have them replaced (--overwrite) [bad-argument]\n");
    CHECK(content_of(folder / "out/room/climate.jsonl") == "my own configuration");
    CHECK_FALSE(std::filesystem::exists(folder / "out/every"));
  }
  using Existing = app::ExportOptions::Existing;
  for (int again = 0; again < 2; ++again) {
    std::ostringstream out, err;
    CHECK(app::export_recording(
              {.database = path, .format = "json", .folder = folder / "out", .existing = Existing::replace}, out,
              err) == 0);
    CHECK(lines_of(content_of(folder / "out/room/climate.jsonl")).size() == 999);
  }
  // Many are counted.
  std::ostringstream out, err;
  CHECK(app::export_recording({.database = path, .format = "json", .folder = folder / "out"}, out, err) == 1);
  CHECK(err.str().find("every/thing.jsonl: the file exists, and so does 1 more") != std::string::npos);
}

TEST_CASE("FW-5 a topic whose fields changed has a file for each description") {
  const Folder folder;
  const std::string path = make(folder);
  Loop loop{Loop::Manual{}};
  SqliteSink sink(loop, {.path = path});
  Feed<Other> feed(loop, {.name = "room", .topic = "room/climate"});
  feed.publish(Other{});
  feed.close();
  loop.close();
  const auto recording = Recording::open(path).or_throw();
  std::ostringstream out;
  CHECK_FALSE(export_rows(recording, {.filter = {.topic = "room/climate"}}, out));
  CHECK(export_rows(recording, {.filter = {.topic = "room/climate", .run = 2}}, out).or_throw().rows == 1);
  const auto files = export_files(recording, {.filter = {.topic = "room/climate"}}, folder / "out").or_throw();
  REQUIRE(files.size() == 2);
  CHECK(files[0].rows == 999);
  CHECK(files[1].rows == 1);
  CHECK(lines_of(content_of(folder / "out/room/climate~2.csv"))[0] == "time,origin,sequence,temperature,run");
}

TEST_CASE("FW-5 an export of several runs says of each row which it is of, and says so") {
  const Folder folder;
  const std::string path = make(folder);
  make(folder);
  const auto recording = Recording::open(path).or_throw();
  REQUIRE(recording.runs().or_throw().size() == 2);
  for (const Duration step : {Duration{0}, Duration{1h}}) {
    CAPTURE(step.count());
    std::ostringstream all, one;
    const std::uint64_t
        rows = export_rows(recording, {.filter = {.topic = "room/climate"}, .step = step}, all).or_throw().rows;
    const auto lines = lines_of(all.str());
    REQUIRE(lines.size() == rows + 1);
    CHECK(lines.front().ends_with(",run"));
    CHECK(lines[1].ends_with(",1"));
    CHECK(lines.back().ends_with(",2"));
    (void)export_rows(recording, {.filter = {.topic = "room/climate", .run = 2}, .step = step}, one).or_throw();
    CHECK_FALSE(lines_of(one.str()).front().ends_with(",run"));
    CHECK(lines_of(one.str()).back() + ",2" == lines.back());
  }
  std::ostringstream json;
  (void)export_rows(recording, {.format = "jsonl", .filter = {.topic = "room/climate"}}, json).or_throw();
  CHECK(lines_of(json.str()).back().find("\"run\":\"" + recording.runs().or_throw()[1].uuid + "\"") !=
        std::string::npos);
  std::ostringstream out, err;
  CHECK(app::export_recording({.database = path, .topic = "room/climate"}, out, err) == 0);
  CHECK(err.str() == "rtdata: rows of 2 runs: `run` says to which one a row belongs; --run takes one\n");
  err.str("");
  CHECK(app::export_recording({.database = path, .topic = "room/climate", .run = "1"}, out, err) == 0);
  CHECK(err.str() == "");
}

TEST_CASE("FW-5 --utc gives rows from before the clock was set the right time") {
  const Folder folder;
  const std::string path = folder / "run.db";
  Loop loop{Loop::Manual{}};
  loop.manual_clock().set_realtime(Time{5s});
  {
    SqliteSink sink(loop, {.path = path});
    Sensor<Climate> room(loop, {.name = "room", .rate = 1_Hz}, [] { return Climate{1, 2}; });
    loop.advance(3500ms);
    loop.manual_clock().set_realtime(Time{1'800'000'000s} + loop.now().time_since_epoch());
    loop.advance(3500ms);
    room.close();
    loop.close();
  }
  std::ostringstream out, err;
  CHECK(app::export_recording({.database = path,
                               .times = app::ExportOptions::Times::utc,
                               .header = app::ExportOptions::Header::names_and_units},
                              out, err) == 0);
  const auto lines = lines_of(out.str());
  REQUIRE(lines.size() == 9);
  CHECK(lines[0] == "utc,origin,sequence,temperature [Cel],humidity [%RH]");
  CHECK(lines[1].starts_with("2027-01-15T08:00:00.000000000Z,room,1,"));
  CHECK(lines[8].starts_with("2027-01-15T08:00:07.000000000Z,room,8,"));
}

TEST_CASE("FW-5 the subcommand export takes filters and says what is wrong with them") {
  const Folder folder;
  const std::string path = make(folder);
  std::ostringstream out, err;
  CHECK(app::export_recording({.database = path, .topic = "room/climate", .limit = 2, .every = 10}, out, err) == 0);
  CHECK(lines_of(out.str()).size() == 3);
  CHECK(app::export_recording({.database = path, .from = "yesterday"}, out, err) == 1);
  CHECK(app::export_recording({.database = path, .topic = "room/#/x"}, out, err) == 1);
  CHECK(app::export_recording({.database = folder / "none"}, out, err) == 2);
}

TEST_CASE("the head of a CSV says what its times are, also when no rows follow") {
  const Folder folder;
  const auto recording = Recording::open(make(folder)).or_throw();
  const auto head = [&](ExportConfig config) {
    config.filter = {.topic = "room/climate", .until = Time{1ns}};
    std::ostringstream out;
    CHECK(export_rows(recording, config, out).or_throw().rows == 0);
    return out.str();
  };
  using Header = ExportConfig::Header;
  using TimeText = ExportConfig::TimeText;
  CHECK(head({}) == "time,origin,sequence,temperature,humidity\n");
  CHECK(head({.header = Header::names_and_units}) == "time [ns],origin,sequence,temperature [Cel],humidity [%RH]\n");
  CHECK(head({.time = ExportTime::utc, .time_text = TimeText::iso8601}) ==
        "utc,origin,sequence,temperature,humidity\n");
  CHECK(head({.time = ExportTime::utc, .header = Header::names_and_units}) ==
        "utc [ns],origin,sequence,temperature [Cel],humidity [%RH]\n");
  CHECK(head({.time_text = TimeText::iso8601, .header = Header::names_and_units}) ==
        "time,origin,sequence,temperature [Cel],humidity [%RH]\n");
  // A run without rows, and a topic that never had any.
  std::ostringstream out;
  CHECK(export_rows(recording, {.filter = {.topic = "room/climate", .run = 7}}, out).or_throw().rows == 0);
  CHECK(out.str() == "time,origin,sequence,temperature,humidity\n");
  out.str("");
  CHECK(export_rows(recording, {.filter = {.topic = "nothing"}}, out).or_throw().rows == 0);
  CHECK(out.str() == "time,origin,sequence\n");
  const auto files = export_files(recording, {.filter = {.topic = "room/#", .run = 7}}, folder / "out").or_throw();
  REQUIRE(files.size() == 1);
  CHECK(lines_of(content_of(folder / "out/room/climate.csv")).size() == 1);
}

TEST_CASE("CSV straight from the columns is that of the codec") {
  const Folder folder;
  const std::string path = make(folder, [](Feed<Everything>& feed) {
    std::uint32_t seed = 1;
    const auto random = [&] { return seed = seed * 1664525 + 1013904223, seed >> 8; };
    for (int i = 0; i < 500; ++i) {
      Everything e = random() % 3 == 0 ? full() : Everything{};
      e.letter = static_cast<char>(random());
      e.f64 = random() % 2 == 0 ? static_cast<double>(random() % 100000) / 1000 : static_cast<double>(random()) * 1e-30;
      e.f32 = random() % 5 == 0 ? std::numeric_limits<float>::quiet_NaN() : static_cast<float>(random()) / 7;
      e.u64 = std::uint64_t{random()} << 40 | random();
      const char* const names[] = {"", "plain", " a", "b\t", "x,y", "\"", "\xc3\xa4", "\xff", "\\x5c", "a\nb", "\\"};
      e.name = names[random() % std::size(names)];
      e.maybe_name = rtdata::text<5>(names[random() % std::size(names)]);
      if (random() % 2 == 0) e.maybe = std::numeric_limits<double>::quiet_NaN();
      e.state = random() % 4 == 0 ? static_cast<payloads::State>(100) : e.state;
      feed.publish(e);
    }
  });
  sql(path, "UPDATE \"every/thing\" SET i32 = NULL WHERE sequence % 7 = 0");  // as fields of a later run are
  const auto recording = Recording::open(path).or_throw();
  for (const auto time : {ExportTime::recorded, ExportTime::utc}) {
    const ExportConfig config{
        .filter = {.topic = "every/thing"}, .time = time, .time_text = ExportConfig::TimeText::iso8601};
    std::ostringstream out;
    CHECK(export_rows(recording, config, out).or_throw().rows == 500);
    const auto codec = make_csv_codec({CsvConfig::TimeFormat::iso8601});
    std::vector<std::byte> bytes;
    auto rows = recording.rows(config.filter).or_throw();
    while (const RecordedRow* row = rows.next().or_throw()) {
      EventHeader header = row->header();
      if (time == ExportTime::utc) header.time = recording.utc_line(row->run()).or_throw().utc(header.time);
      codec->encode(EventView("every/thing", header, row->event().description(), row->event().payload()), bytes)
          .or_throw();
    }
    const std::string text = out.str();
    CHECK(text.substr(text.find('\n') + 1) == std::string(reinterpret_cast<const char*>(bytes.data()), bytes.size()));
  }
}

TEST_CASE("a blob in a number's column is damage in every format, and the rows before it come") {
  const Folder folder;
  const std::string path = make(folder);
  sql(path, "UPDATE \"room/climate\" SET temperature = x'0102' WHERE sequence = 20");
  const auto recording = Recording::open(path).or_throw();
  for (const char* format : {"csv", "jsonl"}) {
    CAPTURE(format);
    std::ostringstream out;
    const auto count = export_rows(recording, {.format = format, .filter = {.topic = "room/climate"}}, out);
    REQUIRE_FALSE(count);
    CHECK(count.error().id() == "damaged");
    CHECK(count.error().where.find("sequence 20") != std::string::npos);
    const auto lines = lines_of(out.str());
    REQUIRE(lines.size() == (std::string_view(format) == "csv" ? 20 : 19));
    CHECK(lines.back().find("19") != std::string::npos);
  }
}

TEST_CASE("raw bytes of rows that do not fit the format are left out one by one, and told") {
  const Folder folder;
  const std::string path = make(folder);
  std::ostringstream out, err;
  CHECK(app::export_recording({.database = path, .topic = "every/thing", .format = "raw"}, out, err) == 1);
  CHECK(err.str().find("rtdata: 2 rows were left out, the first: ") == 0);
  CHECK(err.str().find("sequence 1") != std::string::npos);
  std::ostringstream all, told;
  CHECK(app::export_recording({.database = path, .format = "raw"}, all, told) == 1);
  const auto codec = make_raw_codec();
  const std::string text = all.str();
  std::size_t events = 0;
  for (auto left = std::as_bytes(std::span(text)); !left.empty(); ++events)
    left = left.subspan(codec->first_event(left));
  CHECK(events == 999);
}

TEST_CASE("export of what there is not says what there is, and makes nothing") {
  const Folder folder;
  const std::string path = make(folder);
  const auto refusal = [&](const app::ExportOptions& options) {
    std::ostringstream out, err;
    CHECK(app::export_recording(options, out, err) == 1);
    CHECK(out.str() == "");
    CHECK(err.str().starts_with(options.run ? "rtdata: cannot find the run: " : "rtdata: cannot export: "));
    return err.str();
  };
  const auto has = [](const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
  };
  CHECK(has(refusal({.database = path, .topic = "nothere"}),
            "it has no topic nothere; available: every/thing, room/climate"));
  CHECK(
      has(refusal({.database = path, .topic = "nothere", .folder = folder / "out"}), "see `rtdata info " + path + "`"));
  CHECK_FALSE(std::filesystem::exists(folder / "out"));
  CHECK(has(refusal({.database = path, .topic = "room/climate", .run = "99"}), "there is no run 99; its runs are 1"));
  CHECK(has(refusal({.database = path, .topic = "room/climate", .origin = "nope"}),
            "it has nothing of origin nope on topic room/climate; available: room"));
  CHECK(has(refusal({.database = path, .topic = "room/climate", .from = "2", .until = "1"}),
            "--from 2 --until 1: it ends before"));
  // What is there, without rows in that time.
  std::ostringstream out, err;
  CHECK(app::export_recording({.database = path, .topic = "room/climate", .until = "1"}, out, err) == 0);
  CHECK(out.str() == "time,origin,sequence,temperature,humidity\n");
  CHECK(err.str() == "rtdata: no rows: " + path + " has none of what was asked for\n");
  out.str("");
  // Rows that no account tells of yet.
  sql(path, "DELETE FROM rtdata_ledger");
  CHECK(app::export_recording({.database = path, .topic = "room/climate", .origin = "room", .limit = 1}, out, err) ==
        0);
  CHECK(lines_of(out.str()).size() == 2);
}

TEST_CASE("FW-5 in steps: every format, one text or a file a topic") {
  const Folder folder;
  const std::string path = make(folder);
  std::ostringstream out, err;
  CHECK(app::export_recording({.database = path, .topic = "room/climate", .step = "1s"}, out, err) == 0);
  auto lines = lines_of(out.str());
  REQUIRE(lines.size() >= 11);
  CHECK(lines[0] ==
        "time,origin,sequence,events,temperature.count,temperature.min,temperature.max,temperature.mean,humidity.count,"
        "humidity.min,humidity.max,humidity.mean");
  CHECK(lines[1].find("000000000,room,1,") != std::string::npos);
  CHECK(lines[1].ends_with(",40,40,40"));
  std::uint64_t events = 0;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    std::istringstream cells(lines[i]);
    std::string cell;
    for (int column = 0; column < 4; ++column) std::getline(cells, cell, ',');
    events += std::stoull(cell);
  }
  CHECK(events == 999);

  out.str("");
  CHECK(app::export_recording({.database = path,
                               .topic = "room/climate",
                               .step = "1h",
                               .times = app::ExportOptions::Times::utc,
                               .header = app::ExportOptions::Header::names_and_units},
                              out, err) == 0);
  lines = lines_of(out.str());
  REQUIRE(lines.size() == 2);
  CHECK(lines[0].starts_with("utc,origin,sequence,events,temperature.count,temperature.min [Cel],"));
  CHECK(lines[1].find(":00:00.000000000Z,room,1,999,999,1,1001,") != std::string::npos);

  out.str("");
  CHECK(app::export_recording({.database = path, .format = "jsonl", .step = "1h"}, out, err) == 0);
  CHECK(lines_of(out.str()).size() == 2);
  CHECK(out.str().find("\"temperature\":{\"count\":999,\"min\":1,\"max\":1001,\"mean\":") != std::string::npos);
  CHECK(app::export_recording({.database = path, .folder = folder / "out", .step = "1s"}, out, err) == 0);
  CHECK(lines_of(content_of(folder / "out/room/climate.csv"))[0].starts_with("time,origin,sequence,events,"));
  CHECK(err.str().empty());
  out.str("");
  CHECK(app::export_recording({.database = path, .topic = "room/climate", .until = "1", .step = "1s"}, out, err) == 0);
  CHECK(out.str().starts_with("time,origin,sequence"));
  for (const char* wrong : {"0s", "-1s", "1", "often"})
    CHECK(app::export_recording({.database = path, .topic = "room/climate", .step = wrong}, out, err) == 1);
}

TEST_CASE("FW-5 an export tells how far it is") {
  const Folder folder;
  const auto recording = Recording::open(make(folder, [](Feed<Everything>& feed) {
                           for (int i = 0; i < 3000; ++i) feed.publish(full());
                         })).or_throw();
  for (const char* format : {"csv", "jsonl"}) {
    std::vector<std::uint64_t> rows;
    Time last{};
    const auto counts = export_files(recording,
                                     {.format = format,
                                      .on_progress =
                                          [&](const ExportProgress& progress) {
                                            CHECK(progress.at > last - 10s);
                                            last = progress.at;
                                            rows.push_back(progress.rows);
                                          }},
                                     folder / format)
                            .or_throw();
    REQUIRE(rows.size() > 1);
    CHECK(std::is_sorted(rows.begin(), rows.end()));
    CHECK(rows.front() > 0);
    CHECK(rows.back() <= counts[0].rows + counts[1].rows);
  }
}

TEST_SUITE_END();
