// rtdata import: somebody's tables become recordings that verify, and say what they could not take.
#include <doctest/doctest.h>
#include <sqlite3.h>
#include <sys/mount.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <thread>

#include "app/process.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "rtdata/recording/recording.hpp"

using namespace rtdata;
using test::Folder;
using test::Process;

namespace {

using rtdata::test::program;

using rtdata::test::has;

void check_verifies(const Folder& folder, const std::string& recording) {
  Process verify(folder, program, {"verify", recording});
  CHECK(verify.end() == 0);
  CHECK(has(verify.out, "balanced"));
  CHECK_MESSAGE(!has(verify.out, "outside"), verify.out);
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("FW-5 import: a table becomes a recording, whose export has the same values") {
    const Folder folder;
    folder.write("bench.csv",
                 "t,imu.ax [m/s2],imu.note,count,never,baro.ax\r\n"
                 "10,1.5,\"a, \"\"b\"\"\nc\",9007199254740993,,1\r\n"
                 "12.5,,x,-3,,2\r\n"
                 "\r\n"
                 "20,nan,,0,,1e300\r\n");
    Process import(folder, program,
                   {"import", "bench.csv", "--time", "t", "--scale", "1ms", "--start", "2026-03-01T12:00:00Z",
                    "--topic", "bench/imu", "--origin", "imu"});
    CHECK(import.end() == 0);
    CHECK(has(import.out, "bench.db: 3 rows of bench.csv on topic bench/imu, from 2026-03-01T12:00:00.010000000Z to "));
    CHECK(has(import.out, "  t: the time"));
    CHECK(has(import.out, "  imu.ax [m/s2]: imu_ax, number, may be absent"));
    CHECK(has(import.out, "  count: count, integer"));
    CHECK(has(import.out, "  never: never, no values: left out"));
    CHECK_MESSAGE(import.err.empty(), import.err);
    check_verifies(folder, "bench.db");
    Process rows(folder, program, {"export", "bench.db", "--utc", "--units"});
    CHECK(rows.end() == 0);
    CHECK(rows.out ==
          "utc,origin,sequence,imu_ax [m/s2],imu_note,count,baro_ax\n"
          "2026-03-01T12:00:00.010000000Z,imu,1,1.5,\"a, \"\"b\"\"\nc\",9007199254740993,1\n"
          "2026-03-01T12:00:00.012500000Z,imu,2,,x,-3,2\n"
          "2026-03-01T12:00:00.020000000Z,imu,3,nan,,0,1e+300\n");
  }

  TEST_CASE("FW-5 import: a heading that each event has, or SQLite, gets another name") {
    const Folder folder;
    folder.write("names.csv", "t,Run,TIME,RowId,_RowId_\n0,1,2,3,4\n1,5,6,2,7\n");
    Process import(folder, program, {"import", "names.csv", "--time", "t"});
    CHECK_MESSAGE(import.end() == 0, import.err);
    check_verifies(folder, "names.db");
    Process rows(folder, program, {"export", "names.db"});
    CHECK(rows.end() == 0);
    CHECK(rows.out ==
          "time,origin,sequence,Run_,TIME_,RowId,_RowId__\n0,names,1,1,2,3,4\n1000000000,names,2,5,6,2,7\n");
  }

  TEST_CASE("FW-5 import: times are kept to the nanosecond, arrays are arrays, and names that clash are numbered") {
    const Folder folder;
    folder.write("x.csv",
                 "t,accel[0],accel[1],b[1],A b,A_b\n"
                 "1795665132.554291437,1,2,3,4,5\n"
                 "1795665132.554291537,1.5,2,3,4,5\n"
                 "1795665132.5542915375,1.5,2,3,4,5\n");
    Process import(folder, program, {"import", "x.csv", "--time", "t", "--scale", "1s"});
    CHECK(import.end() == 0);
    CHECK_MESSAGE(import.err.empty(), import.err);
    Process rows(folder, program, {"export", "x.db"});
    CHECK(rows.end() == 0);
    CHECK(rows.out ==
          "time,origin,sequence,accel[0],accel[1],b_1,A_b,A_b_2\n"
          "1795665132554291437,x,1,1,2,3,4,5\n"
          "1795665132554291537,x,2,1.5,2,3,4,5\n"
          "1795665132554291538,x,3,1.5,2,3,4,5\n");
    folder.write("again.csv", rows.out);
    Process second(folder, program, {"import", "again.csv", "--time", "time", "--scale", "1ns"});
    CHECK(second.end() == 0);
    Process again(folder, program, {"export", "again.db"});
    CHECK(again.end() == 0);
    CHECK(has(again.out, "1795665132554291538,again,3,x,3,1.5,2,3,4,5\n"));
    folder.write("ms.csv", "t,a\n-1e3,1\n-0.5,2\n1795665132554.2914375,3\n");
    Process other(folder, program, {"import", "ms.csv", "--time", "t", "--scale", "1ms"});
    CHECK(other.end() == 0);
    Process first(folder, program, {"export", "ms.db"});
    CHECK(first.end() == 0);
    CHECK(has(first.out, "1795665132554291438,ms,3,3\n"));
  }

  TEST_CASE("import: a column of numbers that no type holds exactly is text, which is said") {
    const Folder folder;
    folder.write("t.csv", "t,v,w\n0,0.5,1\n1,9007199254740993,2\n");
    Process mixed(folder, program, {"import", "t.csv", "--time", "t", "--scale", "1s"});
    CHECK(mixed.end() == 0);
    CHECK_MESSAGE(has(mixed.err,
                      "rtdata: warning: column v is text: no type of number holds all of its values exactly, such as "
                      "9007199254740993 in line 3\n"),
                  mixed.err);
    CHECK_FALSE(has(mixed.err, "column w"));
  }

  TEST_CASE("import: units of headings have brackets of their own") {
    const Folder folder;
    folder.write("x.csv",
                 "time [ms],a [[g]],b [m[H2O]],c [[degF]/min],d[0] [V],d[1] [V],e]\n1,2,3,4,5,6,7\n2,3,4,5,6,7,8\n");
    Process import(folder, program, {"import", "x.csv", "--time", "time [ms]", "--scale", "1ms"});
    CHECK_MESSAGE(import.end() == 0, import.err);
    Process rows(folder, program, {"export", "x.db", "--units"});
    CHECK(rows.end() == 0);
    CHECK(has(rows.out, ",a [[g]],b [m[H2O]],c [[degF]/min],d[0] [V],d[1] [V],e_\n"));
  }

  TEST_CASE("import: an array whose name a column or another array has is numbered") {
    const Folder folder;
    folder.write("x.csv", "t,accel,accel[0],accel[1],a b[0],a b[1],a_b[0],a_b[1]\n0,1,2,3,4,5,6,7\n");
    Process import(folder, program, {"import", "x.csv", "--time", "t"});
    CHECK(import.end() == 0);
    CHECK_MESSAGE(import.err.empty(), import.err);
    Process rows(folder, program, {"export", "x.db"});
    CHECK(rows.end() == 0);
    CHECK(rows.out ==
          "time,origin,sequence,accel,accel_2[0],accel_2[1],a_b[0],a_b[1],a_b_2[0],a_b_2[1]\n"
          "0,x,1,1,2,3,4,5,6,7\n");
  }

  TEST_CASE("import: headings that differ by case are numbered as those that are the same") {
    const Folder folder;
    folder.write("x.csv", "t,v,V,B[0],B[1],b,c[0],c[1],C[0],C[1],m.d,n.D\n0,1,2,3,4,5,6,7,8,9,10,11\n");
    Process import(folder, program, {"import", "x.csv", "--time", "t"});
    CHECK_MESSAGE(import.end() == 0, import.err);
    Process rows(folder, program, {"export", "x.db"});
    CHECK(rows.end() == 0);
    CHECK(rows.out ==
          "time,origin,sequence,v,V_2,B_2[0],B_2[1],b,c[0],c[1],C_2[0],C_2[1],m_d,n_D\n"
          "0,x,1,1,2,3,4,5,6,7,8,9,10,11\n");
    check_verifies(folder, "x.db");
  }

  TEST_CASE("import: times beyond what can be recorded are refused, also those that --start puts there") {
    const Folder folder;
    folder.write("x.csv", "t,v\n0,1\n8000000000000000000,2\n");
    folder.write("y.csv", "t,v\n-9000000000000000000,1\n9000000000000000000,2\n");
    folder.write("z.csv", "t,v\n-1e30,1\n");
    const auto refuses = [&](const char* file, const char* start, const std::string& why) {
      Process import(folder, program, {"import", file, "--time", "t", "--scale", "1ns", "--start", start});
      CAPTURE(start);
      CHECK(import.end() == 1);
      CHECK_MESSAGE(has(import.err, why), import.err);
    };
    refuses("x.csv", "2026-03-01T12:00:00Z",
            "x.csv:3: \"8000000000000000000\" in column t is not a time that can be recorded");
    refuses("y.csv", "1960-01-01T00:00:00Z",
            "y.csv:2: \"-9000000000000000000\" in column t is not a time that can be recorded");
    refuses("y.csv", "1970-01-01T00:00:00Z", "y.csv: its times span more than 292 years: check --scale");
    refuses("z.csv", "2200-01-01T00:00:00Z", "z.csv:2: \"-1e30\" in column t is not a time that can be recorded");
    for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
      CHECK(entry.path().extension() == ".csv");
  }

  TEST_CASE("FW-5 import: rows that go back in time are refused, with the place; no time is invented") {
    const Folder folder;
    folder.write("newest.csv", "time,v\n2026-11-28T12:03:00Z,4\n2026-11-28T12:02:00Z,3\n2026-11-28T12:01:00Z,2\n");
    Process import(folder, program, {"import", "newest.csv", "--time", "time"});
    CHECK(import.end() == 1);
    CHECK_MESSAGE(has(import.err,
                      "newest.csv:3: \"2026-11-28T12:02:00Z\" in column time is before the time of the row "
                      "above it: sort the rows by time"),
                  import.err);
    CHECK_FALSE(folder.has("newest.db"));
  }

  TEST_CASE("FW-5 import: commas before three digits may be thousands: nothing is guessed") {
    const Folder folder;
    folder.write("a.csv", "time [s];energy [W.h]\n0;987\n1;1,234\n2;12,500\n");
    folder.write("b.csv", "time [s],energy [W.h]\n0,987\n1,\"1,234\"\n2,\"12,500\"\n");
    folder.write("c.csv", "time [s];energy [W.h]\n0;0,250\n1;1,234\n2;12,500\n");
    folder.write("d.csv", "time [s];energy [W.h]\n0;1,234\n1;12,500\n");
    const auto import = [&](std::vector<std::string> arguments, int status) {
      arguments.insert(arguments.begin(), "import");
      Process run(folder, program, arguments);
      CHECK(run.end() == status);
      return run.out + run.err;
    };
    const std::string advice = "if they are thousands, write --thousands , and if they are decimals, --decimal ,";
    CHECK(has(import({"a.csv", "--time", "time", "--separator", ";"}, 1), advice));
    CHECK(has(import({"b.csv", "--time", "time"}, 1), advice));
    const std::string decimals = import({"c.csv", "--time", "time", "--separator", ";"}, 1);
    CHECK(has(decimals, "seem to have decimal commas"));
    CHECK_FALSE(has(import({"d.csv", "--time", "time"}, 1), "--decimal ,"));
    CHECK(has(import({"a.csv", "--time", "time", "--separator", ";", "--decimal", "."}, 0), "text of up to 6 bytes"));
    CHECK(has(import({"c.csv", "--time", "time", "--separator", ";", "--decimal", ","}, 0), "energy, number"));
  }

  TEST_CASE("FW-5 import: blanks around a cell do not count, neither do those of a heading") {
    const Folder folder;
    folder.write("a.csv", "time, temp, hum\n2026-11-28T12:00:00Z, 21.5, 45\n2026-11-28T12:00:01Z, 21.6, 46\n");
    folder.write("b.csv", "time;Temp ;Degree Days\n2026-08-02 15:30;12,5;0,250   \n2026-08-02 15:40;12,4;0,125   \n");
    Process first(folder, program, {"import", "a.csv", "--time", "time"});
    CHECK_MESSAGE(first.end() == 0, first.err);
    CHECK(has(first.out, "temp: temp, number"));
    CHECK(has(first.out, "hum: hum, integer"));
    Process second(folder, program,
                   {"import", "b.csv", "--time", "time", "--separator", ";", "--decimal", ",", "--zone", "Z"});
    CHECK_MESSAGE(second.end() == 0, second.err);
    CHECK(has(second.out, "Temp: Temp, number"));
    CHECK(has(second.out, "Degree Days: Degree_Days, number"));
  }

  TEST_CASE("FW-5 import: 24:00 is the end of its day; a second 60 is said to be none") {
    const Folder folder;
    folder.write("day.csv", "time,temp\n2026-11-27 23:00,3.1\n2026-11-27 24:00,3.0\n2026-11-28 01:00,2.9\n");
    Process import(folder, program, {"import", "day.csv", "--time", "time", "--zone", "Z"});
    CHECK_MESSAGE(import.end() == 0, import.err);
    Process rows(folder, program, {"export", "day.db", "--utc"});
    CHECK(rows.end() == 0);
    CHECK(has(rows.out, "2026-11-28T00:00:00.000000000Z,day,2,3\n"));
    folder.write("sixty.csv", "time,v\n2026-11-28T12:00:00,1\n2026-11-28T12:00:60,2\n");
    folder.write("late.csv", "time,v\n2026-11-28T24:01:00Z,1\n");
    Process sixty(folder, program, {"import", "sixty.csv", "--time", "time", "--zone", "Z"});
    CHECK(sixty.end() == 1);
    CHECK_MESSAGE(
        has(sixty.err, "sixty.csv:3: \"2026-11-28T12:00:60\" in column time is not a time: seconds go up to 59"),
        sixty.err);
    Process late(folder, program, {"import", "late.csv", "--time", "time"});
    CHECK(late.end() == 1);
    CHECK_MESSAGE(has(late.err, "there is no such time of day"), late.err);
  }

  TEST_CASE("FW-5 import: rows of one time are moved, which is said; absolute times; a second table") {
    const Folder folder;
    folder.write(
        "a.csv",
        "when,v\n2026-03-01T12:00:00Z,1\n2026-03-01T12:00:00Z,2\n2026-03-01T12:00:00Z,3\n2026-03-02T12:00:00Z,4\n");
    Process import(folder, program, {"import", "a.csv", "--time", "when", "--into", "all.db"});
    CHECK(import.end() == 0);
    CHECK(has(import.err, "2 rows were not later than the row before"));
    check_verifies(folder, "all.db");
    folder.write("b.csv", "when,v\n5,1\n");
    Process second(folder, program, {"import", "b.csv", "--time", "when", "--into", "all.db"});
    CHECK(second.end() == 0);
    check_verifies(folder, "all.db");
    Process rows(folder, program, {"export", "all.db", "--topic", "a"});
    CHECK(rows.end() == 0);
    CHECK(has(rows.out, "a,4,4,1\n"));
  }

  TEST_CASE("FW-5 import: each row that got another time than its own is counted") {
    const Folder folder;
    folder.write("ns.csv", "t,Events,events_,b\n0,1,1,1\n0,2,2,2\n0,3,3,3\n1,4,4,4\n2,5,5,5\n9,6,6,6\n");
    Process import(folder, program, {"import", "ns.csv", "--time", "t", "--scale", "1ns"});
    CHECK(import.end() == 0);
    CHECK(has(import.err, "warning: 4 rows were not later than the row before"));
    // And steps have a name for the number of events whatever the names of the columns are.
    Process steps(folder, program, {"export", "ns.db", "--step", "1s", "--format", "csv"});
    CHECK(steps.end() == 0);
    CHECK(has(steps.out, "events__"));
    CHECK(has(steps.out, "Events.max"));
    CHECK(has(steps.out, "events_.max"));
  }

  TEST_CASE("FW-5 import: what cannot be taken is said with its row, and nothing is made") {
    const Folder folder;
    folder.write("good.csv", "time_s,v\n1,2\n");
    folder.write("short.csv", "t,v\n1,2\n2\n");
    folder.write("text.csv", "t,v\n1,2\nsoon,3\n");
    folder.write("far.csv", "t,v\n1e30,2\n");
    folder.write("quote.csv", "t,v\n1,\"2\n");
    folder.write("empty.csv", "");
    folder.write("head.csv", "t,v\n");
    folder.write("long.csv", "t,v\n1," + std::string(2000, 'x') + "\n");
    folder.write("lines.csv", "t,v\n1,\"" + std::string(1'000'000, '\n') + "\"\n");
    std::ofstream(folder.path() + "/garbage.csv", std::ios::binary) << std::string(2'000'000, '\x01');
    const auto refuses = [&](std::vector<std::string> arguments, const std::string& why) {
      arguments.insert(arguments.begin(), "import");
      Process import(folder, program, arguments);
      CAPTURE(why);
      CHECK(import.end() == 1);
      CHECK_MESSAGE(has(import.err, why), import.err);
    };
    refuses({"good.csv", "--time", "time"}, "did you mean time_s?");
    folder.write("unit.csv", "t [ms],v\n1,2\n");
    refuses({"unit.csv", "--time", "t"}, "says ms");
    refuses({"good.csv", "--time", "time_s", "--scale", "0s"}, "not above 0");
    refuses({"good.csv", "--time", "time_s", "--scale", "fast"}, "fast");
    refuses({"good.csv", "--time", "time_s", "--start", "noon"}, "noon");
    refuses({"good.csv", "--time", "time_s", "--topic", "a b"}, "a b");
    refuses({"short.csv", "--time", "t"}, "short.csv:3");
    refuses({"text.csv", "--time", "t"}, "text.csv:3");
    refuses({"far.csv", "--time", "t"}, "far.csv:2");
    refuses({"far.csv", "--time", "t"}, "check --scale");
    folder.write("ns.csv", "t,v\n1767225600000000000,1\n");
    refuses({"ns.csv", "--time", "t"}, "check --scale; with --scale 1ns it is 2026-01-01");
    folder.write("us.csv", "t,v\n1767225600000000,1\n");
    refuses({"us.csv", "--time", "t"}, "check --scale; with --scale 1us it is 2026-01-01");
    folder.write("both.csv", "t,v,t\n1,2,3\n");
    refuses({"both.csv", "--time", "t"},
            "it has 2 columns t: name the columns yourself: --columns, and --skip for the heading");
    folder.write("units.csv", "t [ms],v,t [s]\n1,2,3\n");
    refuses({"units.csv", "--time", "t"}, "it has 2 columns t: write it with the unit");
    refuses({"quote.csv", "--time", "t"}, "quote.csv:2");
    refuses({"empty.csv", "--time", "t"}, "it is empty");
    refuses({"head.csv", "--time", "t"}, "it has no rows");
    folder.write("nan.csv", "t,v\n0,1\nnan,2\n");
    refuses({"nan.csv", "--time", "t"},
            "nan.csv:3: \"nan\" in column t is not a time: write a number, or a time such as");
    folder.write("late.csv", "t,v\n0,1\n40000000,2\n");
    refuses({"late.csv", "--time", "t", "--start", "2261-01-01T00:00:00Z"}, "late.csv:3: \"40000000\"");
    refuses({"late.csv", "--time", "t", "--start", "2261-01-01T00:00:00Z"}, "to 2261: check --start [bad-argument]\n");
    for (const std::string& mark : {std::string("\xff\xfe"), std::string("\xfe\xff")}) {
      std::ofstream(folder.path() + "/wide.csv", std::ios::binary) << mark << std::string("t\0,\0v\0\n\0", 8);
      refuses({"wide.csv", "--time", "t"},
              "wide.csv: it is UTF-16: convert the file: iconv -f UTF-16 -t UTF-8 wide.csv");
    }
    refuses({"long.csv", "--time", "t"}, "2000 bytes");
    refuses({"lines.csv", "--time", "t"}, "a text in column v has 1000000 bytes");
    refuses({"garbage.csv", "--time", "t"}, "longer than 1 MiB");
    refuses({"absent.csv", "--time", "t"}, "absent.csv");
    refuses({".", "--time", "t"}, "");
    for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
      CHECK(entry.path().extension() == ".csv");
  }

  TEST_CASE("FW-5 import: a table that is changed while it is read leaves no run, and the runs before it stay") {
    const Folder folder;
    std::string rows = "t,v\n";
    for (int i = 0; i < 20'000; ++i) rows += std::to_string(i) + "," + std::to_string(i) + "\n";
    folder.write("a.csv", rows);
    Process first(folder, program, {"import", "a.csv", "--time", "t"});
    CHECK(first.end() == 0);
    const std::string path = folder.path() + "/a.db";
    // The import has read the table once when it has locked the recording, and waits for the transaction to read again.
    sqlite3* database = nullptr;
    REQUIRE(sqlite3_open(path.c_str(), &database) == SQLITE_OK);
    REQUIRE(sqlite3_exec(database, "BEGIN IMMEDIATE", nullptr, nullptr, nullptr) == SQLITE_OK);
    Process second(folder, program, {"import", "a.csv", "--time", "t"});
    const auto give_up = std::chrono::steady_clock::now() + std::chrono::minutes{1};
    while (!folder.has("a.db-lock") && std::chrono::steady_clock::now() < give_up) std::this_thread::yield();
    std::filesystem::resize_file(folder.path() + "/a.csv", rows.size() / 2);
    CHECK(sqlite3_exec(database, "ROLLBACK", nullptr, nullptr, nullptr) == SQLITE_OK);
    sqlite3_close(database);
    CHECK(second.end() == 1);
    CHECK_MESSAGE(has(second.err, "the file has changed while it was read: try again; nothing was imported ["),
                  second.err);
    CHECK(Recording::open(path).or_throw().runs().or_throw().size() == 1);
    check_verifies(folder, "a.db");
  }

  TEST_CASE("FW-5 import: on a disk that is small or full, a table is there as a whole or not at all") {
    const Folder folder;
    const std::string disk = folder.path() + "/disk";
    std::filesystem::create_directory(disk);
    if (::mount("none", disk.c_str(), "tmpfs", 0, "size=4m") != 0) {
      MESSAGE("skipped: mounting a small disk is not permitted here");
      return;
    }
    std::string rows = "t,v\n";
    for (int i = 0; i < 12'000; ++i) rows += std::to_string(i) + "," + std::to_string(i * 1.1) + "\n";
    folder.write("a.csv", rows);
    const std::vector<std::string> arguments{"import", "a.csv", "--time", "t", "--into", "disk/a.db"};
    {
      Process import(folder, program, arguments);
      CHECK_MESSAGE(import.end() == 0, import.err);
      CHECK_MESSAGE(has(import.err, "rtdata: warning: space runs out: disk/a.db: "), import.err);
      check_verifies(folder, "disk/a.db");
    }
    const auto fill = [&](std::uint64_t left) {
      std::ofstream ballast(disk + "/ballast");
      const std::string block(4096, 'x');
      while (ballast && std::filesystem::space(disk).available > left) ballast << block << std::flush;
    };
    std::filesystem::remove(disk + "/a.db");
    fill(300'000);
    {
      Process import(folder, program, arguments);
      CHECK(import.end() == 1);
      CHECK_MESSAGE(has(import.err, "; nothing was imported ["), import.err);
      CHECK_FALSE(folder.has("disk/a.db"));
    }
    std::filesystem::remove(disk + "/ballast");
    {  // beside a run that stays
      folder.write("b.csv", "t,v\n0,1\n");
      Process small(folder, program, {"import", "b.csv", "--time", "t", "--topic", "a", "--into", "disk/a.db"});
      CHECK(small.end() == 0);
      fill(300'000);
      Process import(folder, program, arguments);
      CHECK(import.end() == 1);
      Process verify(folder, program, {"verify", "disk/a.db", "--json"});
      (void)verify.end();
      const auto runs = nlohmann::json::parse(verify.out)["runs"];
      const bool is_gone = has(import.err, "; nothing was imported [");
      CHECK_MESSAGE(is_gone != has(import.err, "a part of its rows is left as run 2 ("), import.err);
      CHECK(runs.size() == (is_gone ? 1 : 2));
      if (!is_gone) CHECK_MESSAGE(!has(runs[1].dump(), "nothing lost"), verify.out);
    }
    CHECK(::umount(disk.c_str()) == 0);
  }

  TEST_CASE("FW-5 import: other separators, decimal commas and times with a blank; who does not say them is told how") {
    const Folder folder;
    const std::string rows = "\"2026-03-01 12:00:00,5\";1,5;-2;\"a;b\"\n2026-03-01 12:00:01;2;3,25e1;c\n";
    folder.write("lab.csv", "Zeit;Druck [bar];x;note\n" + rows);
    std::string tabs = "Zeit\tv\n1,5\t2\n2\t3\n";
    folder.write("tab.csv", tabs);
    const auto import = [&](std::vector<std::string> arguments, int status) {
      arguments.insert(arguments.begin(), "import");
      Process run(folder, program, arguments);
      CHECK(run.end() == status);
      return run.out + run.err;
    };
    CHECK(has(import({"lab.csv", "--time", "Zeit"}, 1), "write --separator \";\" --decimal ,"));
    CHECK(has(import({"lab.csv", "--time", "Zeit", "--separator", ";"}, 1), "write --zone Z if it is UTC"));
    CHECK(has(import({"lab.csv", "--time", "Zeit", "--separator", ";", "--zone", "Z"}, 1), "write --decimal ,"));
    CHECK(has(import({"tab.csv", "--time", "Zeit"}, 1), "write --separator tab --decimal ,"));
    CHECK(has(import({"tab.csv", "--time", "Zeit", "--separator", "tab"}, 1), "write --decimal ,"));
    CHECK(
        has(import({"lab.csv", "--time", "Zeit", "--separator", ",", "--decimal", ","}, 1), "write --separator \";\""));
    CHECK(has(import({"lab.csv", "--time", "Zeit", "--separator", ";;"}, 1),
              "it must be one character, which separates cells"));
    CHECK(has(import({"lab.csv", "--time", "Zeit", "--zone", "CET"}, 1), "not a time zone"));
    CHECK_FALSE(folder.has("lab.db"));
    CHECK_FALSE(folder.has("tab.db"));
    import({"lab.csv", "--time", "Zeit", "--separator", ";", "--decimal", ",", "--zone", "+01:00"}, 0);
    check_verifies(folder, "lab.db");
    Process out(folder, program, {"export", "lab.db", "--utc", "--units"});
    CHECK(out.end() == 0);
    CHECK(out.out ==
          "utc,origin,sequence,Druck [bar],x,note\n"
          "2026-03-01T11:00:00.500000000Z,lab,1,1.5,-2,a;b\n"
          "2026-03-01T11:00:01.000000000Z,lab,2,2,32.5,c\n");
    import({"tab.csv", "--time", "Zeit", "--separator", "tab", "--decimal", ","}, 0);
    check_verifies(folder, "tab.db");
    // Texts of which all look so stay what they are when it is said.
    folder.write("text.csv", "t,v\n1,\"1,5\"\n2,\"2,5\"\n");
    CHECK(has(import({"text.csv", "--time", "t"}, 1), "seem to have decimal commas"));
    CHECK(has(import({"text.csv", "--time", "t", "--decimal", "."}, 0), "v, text of up to 3 bytes"));
  }

  TEST_CASE(
      "FW-5 import: a text that is no UTF-8, and more columns than a recording has, are refused before there is a "
      "file") {
    const Folder folder;
    std::ofstream(folder.path() + "/latin.csv", std::ios::binary) << "t,v\n1,good\n2,K\xf6ln\n";
    std::ofstream(folder.path() + "/head.csv", std::ios::binary) << "t,v [\xb0\x43]\n1,2\n";
    std::string head = "t", row = "1";
    for (int i = 0; i < 3000; ++i) {
      head += ",c" + std::to_string(i);
      row += "," + std::to_string(i);
    }
    folder.write("wide.csv", head + "\n" + row + "\n");
    const auto refuses = [&](const char* file, const std::string& why) {
      Process import(folder, program, {"import", file, "--time", "t"});
      CHECK(import.end() == 1);
      CHECK_MESSAGE(has(import.err, why), import.err);
      CHECK_MESSAGE(!has(import.err, "baud_rate"), import.err);
    };
    refuses("latin.csv", "latin.csv:3: the text \"K\\xf6ln\" in column v is not UTF-8: convert the file: iconv");
    refuses("head.csv", "head.csv:1: the heading");
    refuses("wide.csv", "it has 3000 values an event");
    for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
      CHECK(entry.path().extension() == ".csv");
    // As many as there may be.
    folder.write("most.csv", head.substr(0, head.find(",c1990")) + "\n" + row.substr(0, row.find(",1990")) + "\n");
    Process most(folder, program, {"import", "most.csv", "--time", "t"});
    CHECK(most.end() == 0);
    check_verifies(folder, "most.db");
  }

  TEST_CASE("FW-5 import: a real flight, every row of each of its tables") {
    const std::string flight = test::in_source("../shared/data/flight");
    if (!std::filesystem::exists(flight)) {
      MESSAGE("skipped: there is no flight in ../shared/data/flight");
      return;
    }
    const Folder folder;
    const std::pair<const char*, const char*> tables[] = {{"barometer", "barometer_data.timeStamp_barometer"},
                                                          {"fsm", "rocketState_data.timeStamp_RS"},
                                                          {"gnc", "state_data.timeStamp_state"},
                                                          {"gps", "gps_data.timeStamp_GPS"},
                                                          {"highg_imu", "highG_data.timeStamp_highG"},
                                                          {"lowg_imu", "lowG_data.timeStamp_lowG"}};
    for (const auto& [name, time] : tables) {
      const std::string path = flight + "/tars_" + name + ".csv";
      std::ifstream file(path);
      const auto lines = static_cast<std::size_t>(std::count(std::istreambuf_iterator<char>(file), {}, '\n'));
      Process import(folder, program,
                     {"import", path, "--time", time, "--scale", "10us", "--topic", name, "--into", "flight.db"});
      CHECK_MESSAGE(import.end() == 0, import.err);
      CHECK_MESSAGE(has(import.out, "flight.db: " + std::to_string(lines - 1) + " rows of "), import.out);
    }
    check_verifies(folder, "flight.db");
    const auto recording = Recording::open(folder.path() + "/flight.db").or_throw();
    auto rows = recording.rows({.topic = "barometer"}).or_throw();
    const auto* first = rows.next().or_throw();
    REQUIRE(first != nullptr);
    CHECK(to_nanoseconds(first->header().time) == 194853870 * std::int64_t{10'000});
    CHECK(first->event().value("barometer_data_altitude").or_throw() == Value(-112.56299999999999));
  }
}
