// rtdata export: tables for people, with marks, digits and seconds of their own, and columns of other topics.
#include <doctest/doctest.h>

#include <chrono>
#include <cstdint>
#include <limits>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "app/core/recording_commands.hpp"
#include "app/process.hpp"
#include "has.hpp"
#include "rtdata/data/describe.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/feed.hpp"

using namespace rtdata;
using namespace std::chrono_literals;
using test::Folder;
using test::has;

namespace {

struct Air {
  double pressure = 0;
  float height = 0;
  std::int64_t count = 0;
  std::optional<double> humidity = {};
  text<8> note = {};
  RTDATA_FIELDS(Air, (pressure, "hPa"), (height, "m"), (count), (humidity, "%RH"), (note))
};

struct OtherAir {
  double pressure = 0;
  RTDATA_FIELDS(OtherAir, (pressure, "bar"))
};

struct Place {
  double latitude = 0;
  std::optional<std::int64_t> satellites = {};
  RTDATA_FIELDS(Place, (latitude, "deg"), (satellites))
};

/// `runs` times: air each 100 ms from 1000 s on, a place at +50 ms and at +200 ms.
std::string make(const Folder& folder, int runs = 1) {
  const std::string path = folder.path() + "/flight.db";
  for (int run = 1; run <= runs; ++run) {
    Loop loop{Loop::Manual{}};
    Feed<Air> air(loop, {.name = "baro", .topic = "air"});
    Feed<Place> place(loop, {.name = "gps", .topic = "gps/fix"});
    SqliteSink sink(loop, {.path = path});
    const Time start{1000s};
    if (run == 2) place.publish({.latitude = 2}, start + 50ms);
    air.publish({.pressure = 1013.256, .height = 0.1f, .count = run, .humidity = 45.5, .note = "a;b"}, start);
    if (run == 1) place.publish({.latitude = -0.0001, .satellites = 7}, start + 50ms);
    air.publish({.pressure = -0.004, .height = 1.5f, .count = 1234567}, start + 100ms);
    place.publish({.latitude = 52.5}, start + 200ms);
    air.publish({.pressure = 1e300, .height = 2, .count = 3, .note = "c"}, start + 200ms);
    air.publish({.pressure = std::numeric_limits<double>::infinity()}, start + 300'000'001ns);
    CHECK(loop.close() == 0);
  }
  return path;
}

std::string table(const app::ExportOptions& options, int status = 0) {
  std::ostringstream out, err;
  CHECK_MESSAGE(app::export_recording(options, out, err) == status, err.str());
  return status == 0 ? out.str() : err.str();
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("export: decimal commas, another separator, digits and seconds") {
    const Folder folder;
    const std::string path = make(folder);
    CHECK(table({.database = path, .topic = "air", .decimal = ",", .time = "seconds"}) ==
          "seconds;origin;sequence;pressure;height;count;humidity;note\n"
          "0;baro;1;1013,256;0,1;1;45,5;\"a;b\"\n"
          "0,1;baro;2;-0,004;1,5;1234567;;\"\"\n"
          "0,2;baro;3;1e+300;2;3;;c\n"
          "0,300000001;baro;4;inf;0;0;;\"\"\n");
    const std::string rounded = table({.database = path,
                                       .topic = "air",
                                       .limit = 2,
                                       .header = app::ExportOptions::Header::names_and_units,
                                       .separator = "tab",
                                       .digits = 2});
    CHECK(rounded ==
          "time [ns]\torigin\tsequence\tpressure [hPa]\theight [m]\tcount\thumidity [%RH]\tnote\n"
          "1000000000000\tbaro\t1\t1013.26\t0.10\t1\t45.50\ta;b\n"
          "1000100000000\tbaro\t2\t0.00\t1.50\t1234567\t\t\"\"\n");
    CHECK(has(table({.database = path, .topic = "air", .limit = 1, .digits = 0}), ",baro,1,1013,0,1,46,a;b\n"));
    CHECK(has(table({.database = path, .topic = "air", .time = "seconds", .start = "1970-01-01T00:16:41Z"}),
              "\n-0.699999999,baro,4,inf,"));
  }

  TEST_CASE("export: a joined topic stands in each row with its last event at or before it, and never another one") {
    const Folder folder;
    const std::string path = make(folder, 2);
    const std::string joined = table({.database = path,
                                      .topic = "air",
                                      .run = "1",
                                      .until = "1000250000000",
                                      .join = {"gps/fix"},
                                      .time = "seconds"});
    CHECK(joined ==
          "seconds,origin,sequence,pressure,height,count,humidity,note,gps/fix.latitude,gps/fix.satellites\n"
          "0,baro,1,1013.256,0.1,1,45.5,a;b,,\n"
          "0.1,baro,2,-0.004,1.5,1234567,,\"\",-1e-04,7\n"
          "0.2,baro,3,1e+300,2,3,,c,52.5,\n");
    // Another run has none of it, and one that is too old is none.
    const std::string both = table({.database = path,
                                    .topic = "air",
                                    .header = app::ExportOptions::Header::names_and_units,
                                    .join = {"gps/fix"},
                                    .within = "50ms",
                                    .time = "seconds"});
    CHECK(has(both, "seconds [s],origin,sequence,run,pressure [hPa],"));
    CHECK(has(both, ",gps/fix.latitude [deg],gps/fix.satellites\n"));
    CHECK(has(both, "\n0,baro,1,1,1013.256,0.1,1,45.5,a;b,,\n"));
    CHECK(has(both, "\n0.1,baro,2,1,-0.004,1.5,1234567,,\"\",-1e-04,7\n"));
    CHECK(has(both, "\n0.300000001,baro,4,1,inf,0,0,,\"\",,\n"));
    CHECK(has(both, "\n0,baro,1,2,1013.256,0.1,2,45.5,a;b,,\n"));
    CHECK(has(both, "\n0.1,baro,2,2,-0.004,1.5,1234567,,\"\",2,\n"));
    // Places are put beside air as well.
    CHECK(has(table({.database = path, .topic = "gps/fix", .run = "1", .join = {"air"}}),
              "\n1000200000000,gps,2,52.5,,1e+300,2,3,,c\n"));
  }

  TEST_CASE("export: a table has the topics, fields and units of the chosen run, whatever other runs have") {
    const Folder folder;
    const std::string path = make(folder);
    {
      Loop loop{Loop::Manual{}};
      Feed<OtherAir> air(loop, {.name = "baro", .topic = "air"});
      Feed<Place> place(loop, {.name = "gps", .topic = "gps/fix"});
      SqliteSink sink(loop, {.path = path});
      air.publish({1.25}, Time{1000s});
      place.publish({.latitude = 1}, Time{1001s});
      CHECK(loop.close() == 0);
    }
    {
      Loop loop{Loop::Manual{}};
      Feed<OtherAir> air(loop, {.name = "baro", .topic = "air"});
      SqliteSink sink(loop, {.path = path});
      air.publish({1.25}, Time{1000s});
      CHECK(loop.close() == 0);
    }
    constexpr auto units = app::ExportOptions::Header::names_and_units;
    CHECK(table({.database = path, .topic = "air", .run = "2", .header = units, .digits = 1, .time = "seconds"}) ==
          "seconds [s],origin,sequence,pressure [bar]\n0,baro,1,1.2\n");
    CHECK(table({.database = path, .topic = "gps/fix", .run = "2", .header = units, .join = {"air"}}) ==
          "time [ns],origin,sequence,latitude [deg],satellites,air.pressure [bar]\n1001000000000,gps,1,1,,1.25\n");
    CHECK(has(table({.database = path, .run = "3", .digits = 2}), "\n1000000000000,baro,1,1.25\n"));
    CHECK(has(table({.database = path, .topic = "air", .digits = 1}, 1),
              "the unit of air.pressure changed: choose a run in which it has one unit by --run"));
  }

  TEST_CASE("export: options of tables that do not go together are refused, before anything is written") {
    const Folder folder;
    const std::string path = make(folder);
    const auto refuses = [&](const app::ExportOptions& options, const std::string& why) {
      std::ostringstream out, err;
      CHECK(app::export_recording(options, out, err) == 1);
      CHECK_MESSAGE(has(err.str(), why), err.str());
      CHECK(out.str().empty());
    };
    refuses({.database = path, .separator = ";"},
            "a table can have the rows of only one topic, but there are air and gps/fix");
    refuses({.database = path, .topic = "air", .join = {"gps"}}, "--join gps: it has no such topic");
    refuses({.database = path, .topic = "air", .join = {"air"}}, "--join air: the topic is in the table already");
    refuses({.database = path, .topic = "air", .join = {"gps/fix", "gps/fix"}}, "the topic is in the table already");
    refuses({.database = path, .topic = "air", .format = "jsonl", .separator = ";"},
            "--separator: it needs --format csv, not jsonl");
    refuses({.database = path, .topic = "air", .folder = folder.path() + "/out", .digits = 2},
            "--digits: this option needs one topic");
    refuses({.database = path, .topic = "air", .step = "1s", .decimal = ","},
            "--decimal: it does not work together with --step");
    refuses({.database = path, .topic = "air", .start = "1970-01-01T00:00:00Z"},
            "--start 1970-01-01T00:00:00Z: it works only with --time seconds");
    refuses({.database = path, .topic = "air", .within = "1s"}, "--within 1s: it works only with --join");
    refuses({.database = path, .topic = "air", .join = {"gps/fix"}, .within = "soon"}, "soon");
    refuses({.database = path, .topic = "air", .separator = ",", .decimal = ","},
            "--separator ,: it is the decimal mark, too");
    refuses({.database = path, .topic = "air", .separator = "ab"}, "it must be one character");
    refuses({.database = path, .topic = "air", .time = "seconds", .start = "noon"}, "noon");
    CHECK_FALSE(folder.has("out"));
  }
}
