// rtdata import: tables as programs and devices write them, with lines, marks and texts of their own.
#include <doctest/doctest.h>

#include <filesystem>
#include <string>
#include <vector>

#include "app/process.hpp"
#include "has.hpp"
#include "paths.hpp"

using namespace rtdata;
using test::Folder;
using test::has;
using test::Process;
using test::program;

namespace {

/// What the import says, on both outputs.
std::string import(const Folder& folder, std::vector<std::string> arguments, int status = 0) {
  arguments.insert(arguments.begin(), "import");
  Process run(folder, program, arguments);
  CHECK_MESSAGE(run.end() == status, (run.out + run.err));
  return run.out + run.err;
}

std::string rows_of(const Folder& folder, const std::string& recording) {
  Process verify(folder, program, {"verify", recording});
  CHECK_MESSAGE(verify.end() == 0, verify.out);
  Process rows(folder, program, {"export", recording, "--utc", "--units"});
  CHECK_MESSAGE(rows.end() == 0, rows.err);
  return rows.out;
}

void check_nothing_made(const Folder& folder) {
  for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
    CHECK_MESSAGE(entry.path().extension() != ".db", entry.path().string());
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("import: a table of AltOS, with blanks before its numbers and a heading that begins with #") {
    const Folder folder;
    folder.write("altos.csv",
                 "#version,serial,flight,time,state,state_name,acceleration,pressure,altitude,latitude,altitude\n"
                 "6, 5581, 1,    -0.30, 3,   boost,   -0.98,  99130.00,  184.34,  41.4877,  184\n"
                 "6, 5581, 1,    -0.29, 3,   boost,   12.50,  99128.00,  184.51,  41.4877,  184\n");
    const std::string said = import(folder, {"altos.csv", "--time", "time", "--start", "2026-03-01T12:00:00Z"});
    CHECK(has(said, "  #version: version, integer\n"));
    CHECK(has(said, "  state_name: state_name, text of up to 5 bytes\n"));
    CHECK(rows_of(folder, "altos.db") ==
          "utc,origin,sequence,version,serial,flight,state,state_name,acceleration,pressure,altitude,latitude,altitude_"
          "2\n"
          "2026-03-01T11:59:59.700000000Z,altos,1,6,5581,1,3,boost,-0.98,99130,184.34,41.4877,184\n"
          "2026-03-01T11:59:59.710000000Z,altos,2,6,5581,1,3,boost,12.5,99128,184.51,41.4877,184\n");
  }

  TEST_CASE("import: lines before the heading are skipped, and who does not say so is told how many") {
    const Folder folder;
    folder.write("strato.csv",
                 "PerfectFlite SL100\r\nFirmware: 1.1\r\nApogee: 1281' AGL\r\nComments: \"windy\" day\r\n\r\n"
                 "Time, Altitude, Temperature (F), Voltage\r\n0.00, 0, 70.25, 9.10\r\n0.05, 3, 70.25, 9.10\r\n");
    CHECK(has(import(folder, {"strato.csv", "--time", "Time"}, 1),
              "it has no column Time: line 6 has it: write --skip 5"));
    CHECK(
        has(import(folder, {"strato.csv", "--time", "Zeit"}, 1), "line 1 has 1 column, line 6 has 4: write --skip 5"));
    CHECK(has(import(folder, {"strato.csv", "--time", "Time", "--skip", "40"}, 1), "it has no more than 40 lines"));
    CHECK(has(import(folder, {"strato.csv", "--time", "Time", "--skip", "-1"}, 1), "whole number from 0 on"));
    check_nothing_made(folder);
    import(folder, {"strato.csv", "--time", "Time", "--skip", "5"});
    CHECK(rows_of(folder, "strato.db") ==
          "utc,origin,sequence,Altitude,Temperature [F],Voltage\n"
          "1970-01-01T00:00:00.000000000Z,strato,1,0,70.25,9.1\n"
          "1970-01-01T00:00:00.050000000Z,strato,2,3,70.25,9.1\n");
  }

  TEST_CASE("import: units in round brackets; what tells two columns apart is no unit") {
    const Folder folder;
    folder.write("raven.csv",
                 "Flight_Time_(s),Baro_Altitude_AGL_(feet),Accel (m/s2),alt (baro),alt (GPS),V (at pad),cell (2),(x)\n"
                 "-0.02,1,2,3,4,5,6,7\n0,2,3,4,5,6,7,8\n");
    import(folder, {"raven.csv", "--time", "Flight_Time"});
    CHECK(has(rows_of(folder, "raven.db"),
              "utc,origin,sequence,Baro_Altitude_AGL [feet],Accel [m/s2],alt_baro,alt_GPS,V__at_pad_,cell__2_,_x_\n"));
    folder.write("cats.csv", "ts (ms),T (degC),P (Pa)\n0,21.5,101325\n10,21.5,101320\n");
    CHECK(has(import(folder, {"cats.csv", "--time", "ts"}, 1), "write --scale \"1 ms\""));
    import(folder, {"cats.csv", "--time", "ts (ms)", "--scale", "1 ms"});
    CHECK(has(rows_of(folder, "cats.db"), "1970-01-01T00:00:00.010000000Z,cats,2,21.5,101320\n"));
  }

  TEST_CASE("import: headings of two rows, and rows of units") {
    const Folder folder;
    folder.write("two.csv", "time,accel,,baro,\n,x,y,alt [m],\n0,1,2,3,4\n1,5,6,7,8\n");
    import(folder, {"two.csv", "--time", "time", "--head", "2"});
    CHECK(has(rows_of(folder, "two.db"), "utc,origin,sequence,accel_x,accel_y,baro_alt [m],baro\n"));
    folder.write("units.csv", "time,speed,mass,count,note\ns,[m/s],(kg),-,\n0,1,2,3,a\n1,5,6,7,b\n");
    CHECK(has(import(folder, {"units.csv", "--time", "time"}, 1), "write --units row"));
    import(folder, {"units.csv", "--time", "time", "--units", "row"});
    CHECK(has(rows_of(folder, "units.db"), "utc,origin,sequence,speed [m/s],mass [kg],count,note\n"));
    CHECK(has(import(folder, {"units.csv", "--time", "time", "--units", "column"}, 1), "column"));
    CHECK(has(import(folder, {"units.csv", "--time", "time", "--head", "3"}, 1), "--head"));
    folder.write("one.csv", "time,v\n");
    CHECK(has(import(folder, {"one.csv", "--time", "time", "--head", "2"}, 1), "it has one row"));
    CHECK(has(import(folder, {"one.csv", "--time", "time", "--units", "row"}, 1), "it has no row of units"));
    CHECK_FALSE(folder.has("one.db"));
  }

  TEST_CASE("import: comments, also within the table and before its heading") {
    const Folder folder;
    folder.write("log.csv", "# logger 3\ntime,v,note\n0,1,\"a\n# b\"\n # restart, again\n1,2,#c\n");
    CHECK(has(import(folder, {"log.csv", "--time", "time"}, 1), "line 2 has it: write --skip 1"));
    CHECK(has(import(folder, {"log.csv", "--time", "time", "--skip", "1"}, 1),
              "log.csv:5: 2 cells, where the first row has 3: if it is a comment, write --comment \"#\""));
    import(folder, {"log.csv", "--time", "time", "--comment", "#"});
    CHECK(rows_of(folder, "log.db") ==
          "utc,origin,sequence,v,note\n1970-01-01T00:00:00.000000000Z,log,1,1,\"a\n# b\"\n"
          "1970-01-01T00:00:01.000000000Z,log,2,2,#c\n");
  }

  TEST_CASE("import: the line sep= that Excel writes is no heading, and says the separator") {
    const Folder folder;
    folder.write("excel.csv", "\xef\xbb\xbfsep=;\r\ntime;a\r\n0;1,5\r\n1;2,5\r\n");
    import(folder, {"excel.csv", "--time", "time", "--decimal", ","});
    CHECK(has(rows_of(folder, "excel.db"), "1970-01-01T00:00:01.000000000Z,excel,2,2.5\n"));
    folder.write("tab.csv", "sep=\t\ntime\ta\n0\t1\n");
    import(folder, {"tab.csv", "--time", "time"});
    folder.write("other.csv", "sep=;\ntime|a\n0|1\n");
    import(folder, {"other.csv", "--time", "time", "--separator", "|"});
    folder.write("bad.csv", "sep=,\ntime,a\n0,1\n");
    CHECK(has(import(folder, {"bad.csv", "--time", "time", "--decimal", ","}, 1),
              "--separator \",\": it is the decimal"));
  }

  TEST_CASE("import: thousands are taken off where they are in their places, and only there") {
    const Folder folder;
    folder.write("a.csv", "time [s];energy [W.h];n\n0;987,5;1.000\n1;1.234,25;-12.345.678\n2;12.500;7\n");
    CHECK(has(import(folder, {"a.csv", "--time", "time", "--separator", ";", "--thousands", "."}, 1),
              "--thousands .: it is the decimal mark, too: set --decimal"));
    import(folder, {"a.csv", "--time", "time", "--separator", ";", "--thousands", ".", "--decimal", ","});
    CHECK(rows_of(folder, "a.db") ==
          "utc,origin,sequence,energy [W.h],n\n1970-01-01T00:00:00.000000000Z,a,1,987.5,1000\n"
          "1970-01-01T00:00:01.000000000Z,a,2,1234.25,-12345678\n1970-01-01T00:00:02.000000000Z,a,3,12500,7\n");
    folder.write("b.csv",
                 "time,a,b,c\n0,\"1,234\",\"12,34\",1\xc2\xa0"
                 "000\n\"1,000\",\"1,234.5\",7,2\n");
    const std::string said = import(folder, {"b.csv", "--time", "time", "--thousands", ","});
    CHECK(has(said, "a: a, number"));
    CHECK(has(said, "b: b, text"));
    CHECK(has(rows_of(folder, "b.db"), "1970-01-01T00:16:40.000000000Z,b,2,1234.5,7,2\n"));
    import(folder, {"b.csv", "--time", "a", "--thousands", "\xc2\xa0"}, 1);
    CHECK(has(import(folder, {"b.csv", "--time", "time", "--thousands", "0"}, 1), "it may be part of a number"));
  }

  TEST_CASE("import: texts and numbers that stand for no value are none, however the number is written") {
    const Folder folder;
    folder.write("n.csv", "time,a,b,c\n0,-9999.00,---,1\n1,2.5,N/A,\"\"\n2,3,4,5\n");
    import(folder, {"--time", "time", "--none", "-9999", "---", "N/A", "", "n.csv"});
    CHECK(rows_of(folder, "n.db") ==
          "utc,origin,sequence,a,b,c\n1970-01-01T00:00:00.000000000Z,n,1,,,1\n"
          "1970-01-01T00:00:01.000000000Z,n,2,2.5,,\n1970-01-01T00:00:02.000000000Z,n,3,3,4,5\n");
  }

  TEST_CASE("import: a separator at the end of a row or of the heading makes no column") {
    const Folder folder;
    folder.write("rows.csv", "t,a\n0,1,\n1,2,\n");
    import(folder, {"rows.csv", "--time", "t"});
    CHECK(has(rows_of(folder, "rows.db"), "utc,origin,sequence,a\n"));
    folder.write("head.csv", "t,a,\n0,1\n \t\n1,2,\n");
    import(folder, {"head.csv", "--time", "t"});
    CHECK(has(rows_of(folder, "head.db"), "utc,origin,sequence,a\n"));
    folder.write("more.csv", "t,a\n0,1,2\n");
    CHECK(has(import(folder, {"more.csv", "--time", "t"}, 1), "more.csv:2: 3 cells, where the first row has 2"));
  }

  TEST_CASE("import: a time of two columns, and times in other notations") {
    const Folder folder;
    folder.write("two.csv", "date,time,v\n2026-03-01,12:00:00,1\n2026-03-01,12:00:01.5,2\n");
    CHECK(has(import(folder, {"--time", "date", "time", "--zone", "Z", "two.csv"}),
              "  date: the time\n  time: the time\n"));
    CHECK(rows_of(folder, "two.db") ==
          "utc,origin,sequence,v\n2026-03-01T12:00:00.000000000Z,two,1,1\n2026-03-01T12:00:01.500000000Z,two,2,2\n");
    const auto is_read = [&](const std::string& text, const std::string& format, const std::string& as) {
      CAPTURE(text);
      folder.write("t.csv", "t;v\n" + text + ";1\n");
      std::filesystem::remove(folder.path() + "/t.db");
      std::vector<std::string> all{"t.csv",         "--time", "t",       "--separator",         ";",
                                   "--time-format", format,   "--start", "2026-01-01T00:00:00Z"};
      if (format != "%H:%M:%S") all.insert(all.end(), {"--zone", "+01:00"});
      import(folder, all);
      const std::string rows = rows_of(folder, "t.db");
      CHECK_MESSAGE(has(rows, "\n" + as + "Z,t,1,1\n"), rows);
    };
    is_read("1.3.26 7:05:09,25", "%d.%m.%y %H:%M:%S", "2026-03-01T06:05:09.250000000");
    is_read("Sun Mar  1 12:00:00 2026", "%a %b %d %T %Y", "2026-03-01T11:00:00.000000000");
    is_read("03/01/2026 12:30 am", "%m/%d/%Y %I:%M %p", "2026-02-28T23:30:00.000000000");
    is_read("2022-5-7--11-24-56-7", "%Y-%m-%d--%H-%M-%S-%L", "2022-05-07T10:24:56.007000000");
    is_read("2022-5-7--11-24-56-7", "%Y-%m-%d--%H-%M-%S-%f", "2022-05-07T10:24:56.700000000");
    is_read("2024-366 24:00:00", "%Y-%j %T", "2024-12-31T23:00:00.000000000");
    is_read("2026-03-01T12:00:00 -0330", "%FT%T %z", "2026-03-01T15:30:00.000000000");
    is_read("1767225600.5", "%s.%f", "2026-01-01T00:00:00.500000000");
    is_read("1:02:03.4", "%H:%M:%S", "2026-01-01T01:02:03.400000000");
    const auto is_refused = [&](const std::string& text, const std::string& format, const std::string& why) {
      folder.write("bad.csv", "t;v\n" + text + ";1\n");
      CHECK(has(import(folder, {"bad.csv", "--time", "t", "--separator", ";", "--time-format", format}, 1), why));
    };
    is_refused("30.2.2026", "%d.%m.%Y", "bad.csv:2: \"30.2.2026\" in column t is not a time: there is no such day");
    is_refused("366 2026", "%j %Y", "there is no such day");
    is_refused("1.3.2026 12:00:60", "%d.%m.%Y %H:%M:%S", "seconds go up to 59");
    is_refused("1.3.2026 25:00", "%d.%m.%Y %H:%M", "there is no such time of day");
    is_refused("13:00 pm", "%I:%M %p", "hours before noon or after it are 1 to 12");
    is_refused("1.3.1500", "%d.%m.%Y", "from 1678 to 2261");
    is_refused("1.3.2026 x", "%d.%m.%Y", "it is not written as --time-format has it");
    is_refused("1", "%d", "its date is not whole");
    is_refused("1", "%Q", "it has %Q; available: %Y");
    is_refused("1", "%I", "%I and %p go together");
    is_refused("2026-03-01 12:07:30", "%Y-%m-%d %H:%m:%S", "it has two parts for the month (%M is the minute)");
    is_refused("12:07:30", "%H:%M:%H", "it has two parts for the hour");
    is_refused("1.3.2026 12:07:30", "%d.%m.%Y %H:%M:%s", "it has %s, the seconds since 1970, beside a date");
    is_refused("2026-03-01 60", "%F %j", "it has %j, the day of the year, beside a month or a day");
    is_refused("2026-03-01 07:07:30 PM", "%F %H:%M:%S %a", "it is not written as --time-format has it");
    is_refused("1", "t%", "it ends with %");
    is_refused("1", "t", "it has neither a day nor a time of day");
    CHECK_FALSE(folder.has("bad.db"));
    folder.write("german.csv", "t,v\n1.3.2026 12:00,1\n");
    CHECK(has(import(folder, {"german.csv", "--time", "t"}, 1), "for another notation write --time-format"));
    CHECK(has(import(folder, {"german.csv", "--time", "t", "--time-format", "%d.%m.%Y %H:%M"}, 1),
              "write --zone Z if it is UTC"));
  }

  TEST_CASE("import: a time of any number of columns, as buoys and loggers write it") {
    const Folder folder;
    folder.write("buoy.txt",
                 "#YY  MM DD hh mm WDIR WSPD  WVHT   PRES\n#yr  mo dy hr mn degT m/s      m    hPa\n"
                 "2026 03 01 12 20 140  5.0    MM 1011.2\n2026 03 01 12 10  MM   MM   1.2     MM\n");
    const auto buoy = [&](std::vector<std::string> more, int status) {
      more.insert(more.begin(), {"buoy.txt", "--separator", "blanks", "--zone", "Z"});
      return import(folder, more, status);
    };
    const std::string format = "%Y %m %d %H %M";
    CHECK(has(buoy({"--time", "#YY", "MM", "DD", "hh", "mm", "--time-format", format}, 1),
              "buoy.txt:2: \"#yr mo dy hr mn\" in columns #YY, MM, DD, hh and mm is not a time"));
    CHECK(has(buoy({"--time", "#YY", "MM", "DD", "hh", "mm", "--time-format", format, "--units", "row"}, 1),
              "is before the time of the row above it: sort the rows by time: write --sort"));
    CHECK(has(buoy({"--time", "#YY,MM,DD,hh,mm", "--time-format", format}, 1), "blanks between the names"));
    CHECK(has(buoy({"--time", "#YY", "MM", "DD", "hh", "mm", "--units", "row"}, 1), "write --time-format"));
    check_nothing_made(folder);
    CHECK(has(buoy({"--time", "#YY", "MM", "DD", "hh", "mm", "--time-format", format, "--units", "row", "--none", "MM",
                    "--sort"},
                   0),
              "  hh: the time\n  mm: the time\n"));
    CHECK(rows_of(folder, "buoy.db") ==
          "utc,origin,sequence,WDIR [degT],WSPD [m/s],WVHT [m],PRES [hPa]\n"
          "2026-03-01T12:10:00.000000000Z,buoy,1,,,1.2,\n2026-03-01T12:20:00.000000000Z,buoy,2,140,5,,1011.2\n");
    // A number in a table has no zeros before it: 115 is a quarter past one, not five past eleven.
    folder.write("campus.csv",
                 "Year,DOY,HHMM,v\n2026,59,2345,1\n2026,59,2400,2\n2026,60,15,3\n2026,60,115,4\n2026,60,905,5\n");
    import(folder, {"--time", "Year", "DOY", "HHMM", "--time-format", "%Y %j %H%M", "--zone", "Z", "campus.csv"});
    const std::string campus = rows_of(folder, "campus.db");
    for (const char* const row : {"02-28T23:45:00.000000000Z,campus,1", "03-01T00:00:00.000000000Z,campus,2",
                                  "03-01T00:15:00.000000000Z,campus,3", "03-01T01:15:00.000000000Z,campus,4",
                                  "03-01T09:05:00.000000000Z,campus,5"})
      CHECK_MESSAGE(has(campus, row), campus);
    CHECK(has(
        import(folder,
               {"campus.csv", "--time", "Year", "DOY", "HHMM", "--time-format", "%Y %m %d %H %M", "--zone", "Z"}, 1),
        "it is not written as --time-format has it"));
    folder.write("parts.csv", "y,m,d,h,min,s,v\n2026,3,1,24,0,0,1\n2026,3,2,1,2,3.25,2\n");
    import(folder, {"parts.csv", "--time", "y", "m", "d", "h", "min", "s", "--time-format", "%Y %m %d %H %M %S",
                    "--zone", "Z"});
    CHECK(has(rows_of(folder, "parts.db"),
              "2026-03-02T00:00:00.000000000Z,parts,1,1\n2026-03-02T01:02:03.250000000Z,parts,2,2\n"));
    folder.write("old.csv", "y,d,v\n98,1,1\n");
    CHECK(has(import(folder, {"old.csv", "--time", "y", "d", "--time-format", "%Y %j", "--zone", "Z"}, 1), "write %y"));
    folder.write("blank.csv", "a;b;v\n12;345;1\n");
    CHECK(has(import(folder, {"blank.csv", "--time", "a", "b", "--separator", ";", "--thousands", " "}, 1),
              "a time of several columns is not a number"));
  }

  TEST_CASE("import: parts of a second that are counted are not taken for decimals") {
    const Folder folder;
    folder.write("ros.csv", "secs,nsecs,v\n1772366400,5000000,1\n1772366400,105000000,2\n");
    CHECK(
        has(import(folder, {"ros.csv", "--time", "secs", "nsecs", "--time-format", "%s %f"}, 1),
            "its %f has 9 digits, that of the row above 7: it seems to be a number of parts, not decimals: write %L"));
    import(folder, {"ros.csv", "--time", "secs", "nsecs", "--time-format", "%s %N"});
    CHECK(has(rows_of(folder, "ros.db"),
              "2026-03-01T12:00:00.005000000Z,ros,1,1\n2026-03-01T12:00:00.105000000Z,ros,2,2\n"));
    folder.write("tv.csv", "tv_sec,tv_usec,v\n1772366400,5000,1\n1772366400,105000,2\n");
    import(folder, {"tv.csv", "--time", "tv_sec", "tv_usec", "--time-format", "%s %u"});
    CHECK(has(rows_of(folder, "tv.db"), "2026-03-01T12:00:00.105000000Z,tv,2,2\n"));
    folder.write("dot.csv", "t,v\n12:00:00.5,1\n12:00:00.75,2\n");
    import(folder, {"dot.csv", "--time", "t", "--time-format", "%H:%M:%S.%f"});
    CHECK(has(rows_of(folder, "dot.db"), "12:00:00.750000000Z,dot,2,2\n"));
  }

  TEST_CASE("import: of rows of several kinds only those that are chosen, whatever stands in the others") {
    const Folder folder;
    folder.write("flight.log",
                 "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
                 "FMT, 129, 31, IMU, QBff, TimeUS,I,GyrX,AccX\n"
                 "FMT, 130, 19, BARO, Qff, TimeUS,Alt,Press\n"
                 "FMT, 131, 75, MSG, QZ, TimeUS,Message\n"
                 "MSG, 1000000, props of 5\" and more, all new\n"
                 "IMU, 1000000, 0, 0.01, 9.8\nIMU, 1000000, 1, 0.02, 9.7\nBARO, 1000500, 0.25, 101325\n"
                 "IMU, 1002500, 0, 0.03, 9.6\nMSG, 1003000, EKF \"ready\"\nIMU, 1002500, 1, 0.04, 9.5\n");
    CHECK(has(import(folder, {"flight.log", "--time", "TimeUS"}, 1), "take one, such as --only IMU"));
    CHECK(has(import(folder, {"flight.log", "--time", "TimeUS", "--only", "IMU"}, 1), "write --scale \"1 us\""));
    CHECK(has(import(folder, {"flight.log", "--time", "TimeUS", "--only", "IMX"}, 1), "did you mean IMU?"));
    CHECK(has(import(folder, {"flight.log", "--time", "TimeUS", "--scale", "1us", "--only", "IMU", "I=2"}, 1),
              "no row has 2 in column I, where there are 0, 1: check --only"));
    CHECK(has(import(folder, {"flight.log", "--time", "TimeUS", "--only", "IMU", "i=0"}, 1), "did you mean I?"));
    // A mark for inches is no quote; nothing after it is lost.
    for (const std::vector<std::string>& more : {std::vector<std::string>{}, {"--partial"}}) {
      std::vector<std::string> all{"flight.log", "--time", "TimeUS", "--scale", "1us", "--only", "MSG"};
      all.insert(all.end(), more.begin(), more.end());
      CHECK(has(import(folder, all, 1), "flight.log:5: a quoted cell does not end: if its \" is part of the text"));
    }
    check_nothing_made(folder);
    CHECK(has(import(folder, {"flight.log", "--time", "TimeUS", "--scale", "1us", "--only", "IMU", "I=0"}),
              "warning: 9 rows of other kinds: left out\n"));
    CHECK(rows_of(folder, "flight.db") ==
          "utc,origin,sequence,kind,I,GyrX,AccX\n1970-01-01T00:00:01.000000000Z,flight,1,IMU,0,0.01,9.8\n"
          "1970-01-01T00:00:01.002500000Z,flight,2,IMU,0,0.03,9.6\n");
    folder.write("rover.log", "$IMU,0.01,1,2\n$GPS,0.02,51.0\n$IMU,0.03,2,4\n");
    CHECK(has(import(folder, {"rover.log", "--time", "t"}, 1), "its first row seems not to be a heading"));
    CHECK(has(import(folder, {"rover.log", "--time", "t", "--columns", "kind,t,a,b"}, 1), "3 cells, where --columns"));
    CHECK(has(import(folder, {"rover.log", "--time", "t", "--columns", "kind,t,a,b", "--only", "IMU"}, 1),
              "no row begins with IMU, where there are $IMU, $GPS"));
    folder.write("arrays.dat", "101,900,1.5\n102,900,7,8\n101,915,1.6\n");
    CHECK(has(import(folder, {"arrays.dat", "--time", "t", "--columns", "id,t,v"}, 1),
              "arrays.dat:2: 4 cells, where --columns names 3: if it has rows of several kinds, take one: --only"));
    import(folder, {"rover.log", "--time", "t", "--columns", "kind,t,a,b", "--only", "$IMU", "--sort"});
    CHECK(has(rows_of(folder, "rover.db"), "00.010000000Z,rover,1,$IMU,1,2\n1970-01-01T00:00:00.030000000Z,rover,2,"));
  }

  TEST_CASE("import: of tables with a row for each value, those with a text in a column") {
    const Folder folder;
    const std::string influx =
        "#group,false,false,false,false,true,true\n#default,_result,,,,,\n,result,table,_time,_value,_field,host\n"
        ",,0,2026-03-01T00:10:00Z,1.5,temp,a\n,,0,2026-03-01T00:20:00Z,1.75,temp,a\n\n"
        ",,1,2026-03-01T00:10:00Z,40,hum,a\n,,2,2026-03-01T00:10:00Z,9,temp,b\n";
    folder.write("influx.csv", influx + "\n#group,false,false,false,false\n,result,table,_time,n\n");
    CHECK(has(import(folder, {"influx.csv", "--time", "_time", "--comment", "#"}, 1),
              "write --sort; or, if it has rows of several kinds, take one: --only"));
    // A row of another number of cells, which has the column, may be of any kind; one that lacks it is refused.
    CHECK(has(import(folder, {"influx.csv", "--time", "_time", "--comment", "#", "--only", "_field=temp", "host=a"}, 1),
              "influx.csv:11: 5 cells"));
    folder.write("influx.csv", influx);
    const std::string said = import(
        folder, {"influx.csv", "--time", "_time", "--comment", "#", "--only", "_field=temp", "host=a"});
    CHECK(has(said, "2 rows of other kinds: left out"));
    CHECK(has(rows_of(folder, "influx.db"), "2026-03-01T00:20:00.000000000Z,influx,2,0,1.75,temp,a\n"));
    CHECK(has(import(folder, {"influx.csv", "--time", "_time", "--comment", "#", "--only", "temp"}, 1),
              "for the text of a column write COLUMN=TEXT"));
  }

  TEST_CASE("import: times without a date whose day cannot be known are refused or told") {
    const Folder folder;
    folder.write("night.csv", "T,v\n23:50:00,1\n00:10:00,2\n");
    CHECK(
        has(import(folder, {"night.csv", "--time", "T", "--time-format", "%T", "--sort"}, 1),
            "night.csv:3: \"00:10:00\" in column T is not a time: it has no date, and is more than half a day from the "
            "row above"));
    folder.write("newest.csv", "T,v\n00:05,3\n23:55,2\n23:50,1\n");
    CHECK(has(import(folder, {"newest.csv", "--time", "T", "--time-format", "%H:%M", "--sort"}, 1), "it has no date"));
    CHECK(has(
        import(folder, {"newest.csv", "--time", "T", "--time-format", "%H:%M"}, 1),
        "if all of its rows are of one day, write --sort; if they are not, the table needs a column with the date"));
    CHECK(has(import(folder, {"night.csv", "--time", "T", "--time-format", "%T", "--zone", "+01:00"}, 1),
              "have no date, and count from --start: remove --zone"));
    check_nothing_made(folder);
    folder.write("day.csv", "T,v\n12:10,2\n12:00,1\n");
    CHECK(has(import(folder, {"day.csv", "--time", "T", "--time-format", "%H:%M", "--sort"}),
              "1 row had a time before the row above; the rows were sorted, as times of one day"));
    CHECK(has(import(folder, {"night.csv", "--time", "T", "--time-format", "%T", "--start", "2026-03-01T12:00:00Z"}),
              "the first is 2026-03-02T11:50:00.000000000Z: if they are times of day, write --start with 00:00"));
    // As spreadsheets show times, and testers of batteries write them.
    folder.write("hour.csv", "T,v\n58:00.0,1\n59:30.0,2\n00:10.0,3\n");
    CHECK(has(import(folder, {"hour.csv", "--time", "T", "--time-format", "%M:%S", "--sort"}, 1), "half an hour"));
    CHECK(has(import(folder, {"hour.csv", "--time", "T", "--time-format", "%M:%S"}), "each time an hour was added"));
    CHECK(has(rows_of(folder, "hour.db"), "1970-01-01T01:00:10.000000000Z,hour,3,3\n"));
    folder.write("long.csv", "T,v\n0:00:01,1\n23:59:59,2\n24:00:01,3\n125:00:00.5,4\n");
    import(folder, {"long.csv", "--time", "T", "--time-format", "%H:%M:%S"});
    CHECK(has(rows_of(folder, "long.db"), "1970-01-02T00:00:01.000000000Z,long,3,3\n1970-01-06T05:00:00.500000000Z,"));
    folder.write("excel.csv", "t,v\n46082.5,1\n");
    CHECK(has(
        import(folder,
               {"excel.csv", "--time", "t", "--scale", "24h", "--start", "1899-12-30T00:00:00Z", "--zone", "+01:00"},
               1),
        "--zone +01:00: its times are numbers"));
  }

  TEST_CASE("import: tables of programs that nobody asked for are refused with what helps") {
    const Folder folder;
    folder.write("race.csv",
                 "\"Utc\"|\"ms\"|0|0|1,\"AccelX\"|\"G\"|-3.0|3.0|25\n1772366400000,0.01\n1772366400040,0.02\n");
    CHECK(has(import(folder, {"race.csv", "--time", "Utc"}, 1), "name the columns yourself: --skip 1 --columns t,..."));
    import(folder, {"race.csv", "--time", "t", "--skip", "1", "--columns", "t,AccelX [g]", "--scale", "1ms"});
    CHECK(has(rows_of(folder, "race.db"), "2026-03-01T12:00:00.040000000Z,race,2,0.02\n"));
    folder.write(
        "toa5.dat",
        "\"TOA5\",\"Roof\",\"CR1000\"\n\"TIMESTAMP\",\"RECORD\",\"T_Avg\"\n\"TS\",\"RN\",\"degC\"\n\"\",\"\",\"Avg\"\n"
        "\"2026-03-01 12:00:00\",0,1.5\n\"2026-03-01 12:15:00\",1,\"NAN\"\n");
    CHECK(has(import(folder, {"toa5.dat", "--time", "TIMESTAMP", "--skip", "1", "--zone", "Z", "--units", "row"}, 1),
              "toa5.dat:4: \"\" in column TIMESTAMP is not a time: to skip rows without a time, write "
              "--partial"));
    import(folder, {"toa5.dat", "--time", "TIMESTAMP", "--skip", "1", "--zone", "Z", "--units", "row", "--partial",
                    "--none", "NAN"});
    CHECK(has(rows_of(folder, "toa5.db"), "RECORD [RN],T_Avg [degC]\n2026-03-01T12:00:00.000000000Z,toa5,1,0,1.5\n"));
    folder.write("lab.lvm", "X_Value\tVolts\n0.0\t1.5\n0.1\t1.6\nChannels\t1\nX_Value\tVolts\n0.0\t1.7\n");
    CHECK(has(import(folder, {"lab.lvm", "--time", "X_Value", "--separator", "tab"}, 1),
              "lab.lvm:4: \"Channels\" in column X_Value is not a time: write a number, or a time such as "
              "2026-03-01T12:00:00Z; if "
              "the table ends above it, take that part: head -n 3 lab.lvm >table.csv"));
    folder.write("bare.txt", "2026-03-01 12:00:00    1.5  on\n2026-03-01 12:00:10    1.6  off\n");
    CHECK(has(import(folder, {"bare.txt", "--time", "t", "--separator", "blanks"}, 1),
              "its first row seems not to be a heading: name its 4 columns by --columns t,..."));
    folder.write("days.csv", "day,v\n2026-03-01,1\n");
    CHECK(has(import(folder, {"days.csv", "--time", "day"}, 1), "if its rows are days, write --time-format %F"));
    folder.write("thing.csv", "t,v\n2026-03-01 12:00:00 UTC,1\n");
    CHECK(has(import(folder, {"thing.csv", "--time", "t"}, 1), "write --time-format, such as \"%F %T %z\""));
    folder.write("keys.txt", "0 T=21.5 H=40\n1 T=-1 H=41\n");
    import(folder, {"keys.txt", "--time", "t", "--separator", "blanks", "--columns", "t,T,H", "--strip", "T=", "H="});
    CHECK(has(rows_of(folder, "keys.db"), "01.000000000Z,keys,2,-1,41\n"));
    folder.write("pipes.tsv", "t\tnote\n0\t5\" by 3\" pipe\n");
    CHECK(has(import(folder, {"pipes.tsv", "--time", "t", "--separator", "tab"}, 1), "remove them all: tr -d '\"'"));
    folder.write("millis.csv", "timeMs,v\n0,1\n1000,2\n0,3\n");
    CHECK(has(import(folder, {"millis.csv", "--time", "timeMs"}, 1), "write --scale \"1 ms\""));
    CHECK(has(
        import(folder, {"millis.csv", "--time", "timeMs", "--scale", "1ms"}, 1),
        "its clock seems to begin again in line 4: import the part above it (head -n 3 millis.csv >table.csv) and"));
    folder.write("wide.csv", std::string("t\0,\0v\0\n\0001\0,\0002\0\n\0", 16));
    CHECK(has(import(folder, {"wide.csv", "--time", "t"}, 1), "it is UTF-16: convert the file: iconv -f UTF-16LE"));
    for (const char* const name : {"lab.db", "millis.db", "wide.db"}) CHECK_FALSE(folder.has(name));
  }

  TEST_CASE("import: zones by name, their hour that comes twice and the one that never comes") {
    if (!std::filesystem::exists("/usr/share/zoneinfo/Europe/Berlin")) {
      MESSAGE("skipped: there is no /usr/share/zoneinfo/Europe/Berlin (package tzdata)");
      return;
    }
    const Folder folder;
    folder.write("autumn.csv",
                 "t,v\n2026-10-25 01:59,1\n2026-10-25 02:30,2\n2026-10-25 02:59,3\n2026-10-25 02:00,4\n"
                 "2026-10-25 02:30,5\n2026-10-25 03:00,6\n");
    const std::string said = import(folder, {"autumn.csv", "--time", "t", "--zone", "Europe/Berlin"});
    CHECK(has(said, "4 rows are in an hour that comes twice in Europe/Berlin"));
    const std::string rows = rows_of(folder, "autumn.db");
    for (const char* const row : {"2026-10-24T23:59:00.000000000Z,autumn,1", "2026-10-25T00:30:00.000000000Z,autumn,2",
                                  "2026-10-25T00:59:00.000000000Z,autumn,3", "2026-10-25T01:00:00.000000000Z,autumn,4",
                                  "2026-10-25T01:30:00.000000000Z,autumn,5", "2026-10-25T02:00:00.000000000Z,autumn,6"})
      CHECK_MESSAGE(has(rows, row), rows);
    CHECK(has(import(folder, {"autumn.csv", "--time", "t", "--zone", "Europe/Berlin", "--sort", "--into", "s.db"}, 1),
              "autumn.csv:3: 2026-10-25 02:30 comes twice in Europe/Berlin"));
    folder.write("spring.csv", "t,v\n2026-03-29 01:59,1\n2026-03-29 02:30,2\n");
    CHECK(has(import(folder, {"spring.csv", "--time", "t", "--zone", "Europe/Berlin"}, 1),
              "spring.csv:3: \"2026-03-29 02:30\" in column t is not a time: there is no such time in Europe/Berlin"));
    for (const char* const none : {"Europe/Paradise", "CEST", "../etc/passwd", "/etc/passwd", "Europe"})
      CHECK(has(import(folder, {"spring.csv", "--time", "t", "--zone", none}, 1), "it is not a time zone"));
    CHECK_FALSE(folder.has("s.db"));
    CHECK_FALSE(folder.has("spring.db"));
  }

  TEST_CASE("import: numbers whose unit or kind of time the heading or they themselves say are not taken for seconds") {
    const Folder folder;
    for (const char* const heading : {"time(millisecond)", "t [msec]", "time_ms", "t in ms", "t / ms", "millis (ms)"}) {
      CAPTURE(heading);
      folder.write("u.csv", std::string(heading) + ",v\n0,1\n100,2\n");
      CHECK(has(import(folder, {"u.csv", "--time", heading}, 1), "write --scale \"1 ms\""));
      CHECK(has(import(folder, {"u.csv", "--time", heading, "--scale", "1ms"}),
                "from 1970-01-01T00:00:00.000000000Z to 1970-01-01T00:00:00.100000000Z"));
      std::filesystem::remove(folder.path() + "/u.db");
    }
    folder.write("u.csv", "t (ticks),v\n0,1\n100,2\n");
    CHECK(has(import(folder, {"u.csv", "--time", "t"}, 1), "says ticks, which is not a known unit of time"));
    folder.write("u.csv", "time_ms,v\n0,1\n100,2\n");
    CHECK(has(import(folder, {"u.csv", "--time", "time_ms", "--scale", "1 s"}), "to 1970-01-01T00:01:40"));
    folder.write("unix.csv", "time (UTC),v\n1795665132,1\n1795665133,2\n");
    CHECK(has(import(folder, {"unix.csv", "--time", "time"}), "from 2026-"));
    folder.write("day.csv", "d,v\n20250329,1\n20250330,2\n");
    CHECK(
        has(import(folder, {"day.csv", "--time", "d"}, 1), "seems to be a day: write --time-format, such as %Y%m%d;"));
    CHECK(
        has(import(folder, {"day.csv", "--time", "d", "--time-format", "%Y%m%d", "--zone", "Z"}), "from 2025-03-29T"));
    folder.write("hour.csv", "d,v\n2025032922,1\n2025032923,2\n");
    CHECK(has(import(folder, {"hour.csv", "--time", "d"}, 1), "such as %Y%m%d%H;"));
    CHECK(has(import(folder, {"hour.csv", "--time", "d", "--scale", "1 s"}), "from 2034-03-03T"));
  }

  TEST_CASE(
      "import: times without a date go on over midnight; a table of hours has the second of an hour that comes twice") {
    const Folder folder;
    folder.write("m.csv", "T,v\n23:59:55,1\n00:00:00,2\n00:00:05,3\n23:00:00,4\n00:30:00,5\n");
    const std::string said = import(
        folder, {"m.csv", "--time", "T", "--time-format", "%H:%M:%S", "--start", "2026-03-01T00:00:00Z"});
    CHECK(has(said, "from 2026-03-01T23:59:55.000000000Z to 2026-03-03T00:30:00.000000000Z"));
    CHECK(has(said, "go back 2 times, as at midnight"));
    folder.write("back.csv", "T,v\n12:00:00,1\n11:59:59,2\n");
    CHECK(has(import(folder, {"back.csv", "--time", "T", "--time-format", "%T"}, 1), "write --sort"));
    folder.write("s.csv", "t,v\n2025-10-26 01:00,1\n2025-10-26 02:00,2\n2025-10-26 02:00,3\n2025-10-26 03:00,4\n");
    import(folder, {"s.csv", "--time", "t", "--zone", "Europe/Berlin"});
    CHECK(has(rows_of(folder, "s.db"), "2025-10-26T01:00:00.000000000Z,s,3,3\n2025-10-26T02:00:00"));
    folder.write("davis.csv", "d,t,v\n3/1/26,11:55p,1\n3/2/26,12:00a,2\n3/2/26,12:05 a.m.,3\n");
    CHECK(has(import(folder, {"davis.csv", "--time", "d", "t", "--time-format", "%m/%d/%y %I:%M %p", "--zone", "Z"}),
              "from 2026-03-01T23:55:00.000000000Z to 2026-03-02T00:05:00.000000000Z"));
    folder.write("utc.csv", "t,v\n2021-02-18 21:46:00 UTC,1\n2021-02-18 21:46:01 UTC,2\n");
    CHECK(has(import(folder, {"utc.csv", "--time", "t", "--time-format", "%F %T %z"}), "from 2021-02-18T21:46:00"));
  }

  TEST_CASE("import: what stands in or behind numbers is told, and taken off when it is said") {
    const Folder folder;
    folder.write("de.csv", "t;v\n0;1.234,50\n1;12,5\n");
    const std::string said = import(folder, {"de.csv", "--time", "t", "--separator", ";", "--decimal", ","});
    CHECK(has(said, "if \".\" is between thousands, write --thousands \".\""));
    CHECK_FALSE(has(said, "--none"));
    folder.write("us.csv", "t,temp,volts\n0,71.2F,0.1 VDC\n1,72F,12 VDC\n");
    CHECK(has(import(folder, {"us.csv", "--time", "t"}), "to have the numbers, write --strip \"F\""));
    std::filesystem::remove(folder.path() + "/us.db");
    import(folder, {"us.csv", "--time", "t", "--strip", "F", "VDC"});
    CHECK(has(rows_of(folder, "us.db"), ",us,1,71.2,0.1\n"));
    folder.write("mixed.csv", "t,v\n0,500mV\n1,1.2V\n");
    CHECK_FALSE(has(import(folder, {"mixed.csv", "--time", "t"}), "--strip"));
    folder.write("quoted.csv", "t,v\n0,\"20,5\"\n1,\"21,5\"\n");
    import(folder, {"quoted.csv", "--time", "t", "--decimal", ","});
    CHECK(has(rows_of(folder, "quoted.db"), ",quoted,2,21.5\n"));
    folder.write("aligned.txt", "  t    value  name\n  0     1.5   a\n 10\t 2.5   \"b  c\"\n");
    import(folder, {"aligned.txt", "--time", "t", "--separator", "blanks"});
    CHECK(has(rows_of(folder, "aligned.db"), ",aligned,2,2.5,b  c\n"));
  }

  TEST_CASE("import: a heading that comes again, rows without a time, and what stands for no value only among values") {
    const Folder folder;
    folder.write("torque.csv", "t,v\n0,1\nt,v\n1,2\n,3\n2,-\n");
    const std::string said = import(folder, {"torque.csv", "--time", "t", "--none", "-", "0", "--partial"});
    CHECK(has(said, "1 row is the heading again: left out"));
    CHECK(has(said, "1 row without a time: left out"));
    CHECK(has(rows_of(folder, "torque.db"), "1970-01-01T00:00:00.000000000Z,torque,1,1\n"));
    folder.write("pipe.csv", "t,v\n0,1\n");
    Process piped(folder, "/bin/sh", {"-c", "cat pipe.csv | " + program + " import /dev/stdin --time t"});
    CHECK(piped.end() == 1);
    CHECK_MESSAGE(has(piped.err, "it cannot be read twice"), piped.err);
  }

  TEST_CASE("import: rows out of order are sorted when it is said, and counted") {
    const Folder folder;
    folder.write("newest.csv", "t,v\n3,\"a\nb\"\n1,b\n2,c\n1,d\n");
    CHECK(has(import(folder, {"newest.csv", "--time", "t"}, 1), "sort the rows by time: write --sort"));
    CHECK_FALSE(folder.has("newest.db"));
    CHECK(has(import(folder, {"newest.csv", "--time", "t", "--sort"}), "2 rows had a time before the row above"));
    CHECK(
        rows_of(folder, "newest.db") ==
        "utc,origin,sequence,v\n1970-01-01T00:00:01.000000000Z,newest,1,b\n1970-01-01T00:00:01.000000001Z,newest,2,d\n"
        "1970-01-01T00:00:02.000000000Z,newest,3,c\n1970-01-01T00:00:03.000000000Z,newest,4,\"a\nb\"\n");
  }

  TEST_CASE("import: rows are sorted also where nothing but them stands in the file") {
    const Folder folder;
    folder.write("a.csv",
                 "\xef\xbb\xbf"
                 "2,b\n1,a\n");
    import(folder, {"a.csv", "--time", "t", "--columns", "t,v", "--sort"});
    CHECK(has(rows_of(folder, "a.db"), "01.000000000Z,a,1,a\n1970-01-01T00:00:02.000000000Z,a,2,b\n"));
    folder.write("b.csv", "of July\n2,b\n1,a\n");
    import(folder, {"b.csv", "--time", "t", "--columns", "t,v", "--sort", "--skip", "1"});
    CHECK(has(rows_of(folder, "b.db"), "01.000000000Z,b,1,a\n1970-01-01T00:00:02.000000000Z,b,2,b\n"));
  }

  TEST_CASE("import: a table without heading has its columns named by hand") {
    const Folder folder;
    folder.write("bare.csv", "0.00\t3\t9.1\t\r\n0.05\t5\t9.1\t\r\n");
    CHECK(has(import(folder, {"bare.csv", "--time", "t"}, 1), "write --separator tab"));
    CHECK(has(import(folder, {"bare.csv", "--time", "t", "--separator", "tab"}, 1),
              "name its 4 columns by --columns t,..."));
    CHECK(has(import(folder, {"bare.csv", "--time", "t", "--separator", "tab", "--columns", "t,alt"}, 1),
              "bare.csv:1: 4 cells, where --columns names 2"));
    CHECK(has(import(folder, {"bare.csv", "--time", "T", "--separator", "tab", "--columns", "t,alt,V"}, 1),
              "there is no column T: did you mean t?"));
    CHECK(
        has(import(folder, {"bare.csv", "--time", "t", "--columns", "t", "--head", "2"}, 1), "--head needs a heading"));
    check_nothing_made(folder);
    import(folder,
           {"bare.csv", "--time", "t", "--separator", "tab", "--columns", "t [s],\"alt, AGL [ft]\",battery (V)"});
    CHECK(has(rows_of(folder, "bare.db"),
              "utc,origin,sequence,alt__AGL [ft],battery [V]\n"
              "1970-01-01T00:00:00.000000000Z,bare,1,3,9.1\n"));
  }

  TEST_CASE("import: rows that end early and a file that is cut off are taken when it is said, and told") {
    const Folder folder;
    const auto is_cut = [&](const std::string& rows, const std::string& line, const std::string& last) {
      CAPTURE(rows);
      folder.write("cut.csv", "t,a,b\n" + rows);
      std::filesystem::remove(folder.path() + "/cut.db");
      const std::string refused = import(folder, {"cut.csv", "--time", "t"}, 1);
      CHECK_MESSAGE(has(refused, "write --partial"), refused);
      CHECK_FALSE(folder.has("cut.db"));
      CHECK(
          has(import(folder, {"cut.csv", "--time", "t", "--partial"}), "line " + line + ", the last row, is cut off"));
      const std::string all = rows_of(folder, "cut.db");
      CHECK_MESSAGE(all.ends_with(last), all);
    };
    is_cut("0,1,2\n1,2", "3", "00Z,cut,1,1,2\n");
    is_cut("0,1,2\n1,2\n", "3", "00Z,cut,1,1,2\n");
    is_cut("0,1,2\n1,2,\"x", "3", "00Z,cut,1,1,2\n");
    is_cut(std::string("0,1,2\n1,2,3\n\0\0\0\0", 16), "4", "00Z,cut,2,2,3\n");
    // Of a last number without a line end it cannot be known whether it is whole.
    folder.write("end.csv", "t,a\n0,1\n1,2");
    import(folder, {"end.csv", "--time", "t", "--into", "whole.db"});
    CHECK(has(rows_of(folder, "whole.db"), "01.000000000Z,end,2,2\n"));
    CHECK(has(import(folder, {"end.csv", "--time", "t", "--partial"}), "line 3, the last row, is cut off"));
    folder.write("short.csv", "t,a,b\n0,1,2\n1,2\n2\n3,4,5\n4,5\n");
    CHECK(has(import(folder, {"short.csv", "--time", "t"}, 1),
              "short.csv:3: 2 cells, where the first row has 3: if rows"));
    CHECK(has(import(folder, {"short.csv", "--time", "t", "--partial"}), "3 rows ended early, the first in line 3"));
    CHECK(rows_of(folder, "short.db") ==
          "utc,origin,sequence,a,b\n1970-01-01T00:00:00.000000000Z,short,1,1,2\n"
          "1970-01-01T00:00:01.000000000Z,short,2,2,\n1970-01-01T00:00:02.000000000Z,short,3,,\n"
          "1970-01-01T00:00:03.000000000Z,short,4,4,5\n1970-01-01T00:00:04.000000000Z,short,5,5,\n");
  }

  TEST_CASE("import: a column that is text because of a few cells is a warning, with the first of them") {
    const Folder folder;
    folder.write("few.csv", "t,temp,name,id\n0,1,a,1\n1,2,b,x\n2,ERR,c,y\n3,4,d,2\n4,OL,e,z\n5,6,f,3\n");
    const std::string said = import(folder, {"few.csv", "--time", "t"});
    CHECK(has(said,
              "warning: column temp is text because of 2 of its 6 values, the first \"ERR\" in line 4: "
              "if it stands for no value, write --none \"ERR\"\n"));
    CHECK_FALSE(has(said, "column name is"));
    CHECK_FALSE(has(said, "column id is"));
    CHECK_FALSE(has(import(folder, {"few.csv", "--time", "t", "--none", "ERR", "OL", "--into", "n.db"}), "warning"));
  }

  TEST_CASE("import: what is no table is refused, whatever the options say") {
    const Folder folder;
    folder.write("empty.csv", "");
    folder.write("head.csv", "t,v\r\n");
    folder.write("nul.csv", std::string("t,v\n0,a\0b\n", 10));
    folder.write("long.csv", "t,v\n0," + std::string(std::size_t{1} << 20, '1') + "\n");
    folder.write("quote.csv", "t,v\n0,a\"b\"\n");
    folder.write("mac.csv", "t,v\r0,1\r1,2\r");
    for (const std::vector<std::string>& more :
         std::vector<std::vector<std::string>>{{}, {"--partial", "--sort"}, {"--comment", "#", "--none", "x"}}) {
      const auto is_refused = [&](const std::string& file, const std::string& why) {
        std::vector<std::string> arguments{file, "--time", "t"};
        arguments.insert(arguments.end(), more.begin(), more.end());
        const std::string said = import(folder, arguments, 1);
        CHECK_MESSAGE(has(said, why), said);
      };
      is_refused("empty.csv", "it is empty");
      is_refused("head.csv", "it has no rows");
      is_refused("nul.csv", "nul.csv:2: the text \"a\\x00b\" in column v is not UTF-8");
      is_refused("long.csv", "long.csv:2: the row is longer than 1 MiB");
      is_refused("quote.csv", "quote.csv:2");
      is_refused("mac.csv", more.empty() ? "if its lines end with CR alone: tr" : "mac.csv");
    }
    check_nothing_made(folder);
  }

  TEST_CASE("import: numbers whose heading is a unit, or has it in any place, are not taken for seconds") {
    const Folder folder;
    const auto is_refused = [&](const std::string& heading, const std::string& scale) {
      CAPTURE(heading);
      folder.write("u.csv", "\"" + heading + "\",v\n0,1\n100,2\n");
      const std::string said = import(folder, {"u.csv", "--time", heading}, 1);
      CHECK_MESSAGE(has(said, "write --scale \"" + scale + "\""), said);
    };
    for (const char* const heading : {"ms", "msec", "millis", "Milliseconds", "t,ms", "time.ms", "time:ms", "timeMs",
                                      "ms since boot", "uptimeMillis", "time_ms_utc"})
      is_refused(heading, "1 ms");
    for (const char* const heading : {"us", "usec", "\u00b5s", "\u03bcs", "TimeUS"}) is_refused(heading, "1 us");
    for (const char* const heading : {"minutes", "Time, min", "min", "Minutes since start"})
      is_refused(heading, "1 min");
    for (const char* const heading : {"hours", "Time, h", "t_h"}) is_refused(heading, "1 h");
    folder.write("u.csv", "0,1\n100,2\n");
    CHECK(has(import(folder, {"u.csv", "--time", "ms", "--columns", "ms,v"}, 1), "write --scale \"1 ms\""));
    CHECK_FALSE(folder.has("u.db"));
    for (const char* const heading : {"t", "s", "sec", "Time", "elapsed", "timestamp", "minimum", "day_t"}) {
      CAPTURE(heading);
      folder.write("u.csv", std::string(heading) + ",v\n0,1\n100,2\n");
      CHECK(has(import(folder, {"u.csv", "--time", heading}), "to 1970-01-01T00:01:40.000000000Z"));
      std::filesystem::remove(folder.path() + "/u.db");
    }
  }

  TEST_CASE("import: numbers that are times of day are not taken for seconds") {
    const Folder folder;
    const auto is_refused = [&](const std::string& times, const std::string& why, const std::string& heading = "t") {
      CAPTURE(times);
      folder.write("c.csv", heading + "\n" + times);
      const std::string said = import(folder, {"c.csv", "--time", heading}, 1);
      CHECK_MESSAGE(has(said, why), said);
    };
    is_refused("085958\n085959\n090000\n",
               "seems to have times of day: 085958 is 08:59:58: write --time-format %H%M%S,");
    is_refused("160957.4\n160958.4\n160959.4\n161000.4\n", "160957 is 16:09:57");
    is_refused("85958\n85959\n90000\n", "85958 is 08:59:58");
    is_refused("125800\n125900\n130000\n130100\n", "125800 is 12:58:00");
    is_refused("120001\n120002\n", "120001 is 12:00:01", "UTC");
    is_refused("235958\n235959\n000000\n", "235958 is 23:59:58");
    is_refused("20263100\n20263100\n20265850\n20331600\n", "write --time-format %H%M%S%f,");
    CHECK_FALSE(folder.has("c.db"));
    for (const char* const times : {"100057\n100058\n100059\n100060\n", "100000\n100100\n100200\n100300\n",
                                    "0\n10\n20\n30\n40\n50\n60\n", "120001.5\n120002.5\n"}) {
      CAPTURE(times);
      std::string rows = "t,v\n";
      for (const char c : std::string(times)) rows += c == '\n' ? std::string(",1\n") : std::string(1, c);
      folder.write("c.csv", rows);
      import(folder, {"c.csv", "--time", "t"});
      std::filesystem::remove(folder.path() + "/c.db");
    }
    folder.write("c.csv", "t,v\n085958,1\n085959,2\n090000,3\n");
    CHECK(has(import(folder, {"c.csv", "--time", "t", "--scale", "1s"}), "to 1970-01-02T01:00:00"));
  }

  TEST_CASE("import: what tells numbers apart is not stripped") {
    const Folder folder;
    folder.write("amps.csv", "t,cpu,load\n0,5 B,990 mA\n1,6 B,1.005 A\n");
    CHECK(has(import(folder, {"amps.csv", "--time", "t", "--strip", "B", "mA", "A"}, 1),
              "amps.csv:3: \"1.005 A\" in column load has A, and rows above have mA: --strip would remove the unit"));
    CHECK_FALSE(folder.has("amps.db"));
    folder.write("amps.csv", "t,load,volts\n0,990 mA,3 V\n1,995 mA,4 V\n");
    import(folder, {"amps.csv", "--time", "t", "--strip", "mA", "A", "V"});
    CHECK(has(rows_of(folder, "amps.db"), "amps,2,995,4\n"));
    folder.write("south.csv", "t,lat,power\n0,33.85S,450W\n1,33.86S,451W\n");
    const std::string said = import(folder, {"south.csv", "--time", "t"});
    CHECK(has(said, "column lat is text, with numbers such as \"33.85S\": if these are places, make numbers of"));
    CHECK_FALSE(has(said, "--strip \"S\""));
    CHECK_FALSE(has(said, "--strip \"W\""));
    CHECK(has(said, "if W is a unit, --strip removes it"));
    std::filesystem::remove(folder.path() + "/south.db");
    CHECK(has(import(folder, {"south.csv", "--time", "t", "--strip", "S", "W"}, 1),
              "south.csv:2: \"33.85S\" in column lat is south, which --strip S would remove: make negative numbers"));
    CHECK_FALSE(folder.has("south.db"));
    import(folder, {"south.csv", "--time", "t", "--strip", "W"});
    CHECK(has(rows_of(folder, "south.db"), "south,2,33.86S,451\n"));
  }

  TEST_CASE("import: the zone, and the order of day and month, that the heading says") {
    const Folder folder;
    const auto said_with = [&](const std::string& heading, const std::string& zone, int status = 0) {
      folder.write("z.csv", "\"" + heading + "\",v\n2026-03-04 10:30:00,1\n");
      std::filesystem::remove(folder.path() + "/z.db");
      std::vector<std::string> all{"z.csv", "--time", heading};
      if (!zone.empty()) all.insert(all.end(), {"--zone", zone});
      return import(folder, all, status);
    };
    CHECK(has(said_with("Date Time, GMT-04:00", "+01:00"), "seems to say the zone -04:00, and --zone +01:00 is"));
    CHECK(has(said_with("Time (UTC)", "+01:00"), "if the heading is right, write --zone Z"));
    CHECK(has(said_with("Local (+02:00)", "Z"), "write --zone +02:00"));
    CHECK(has(said_with("Date Time, GMT-04:00", "", 1), "seems to say one: write --zone -04:00; or --zone Z if"));
    CHECK_FALSE(has(said_with("Date Time, GMT-04:00", "-04:00"), "warning"));
    CHECK_FALSE(has(said_with("Time UTC+1", "+01:00"), "warning"));
    CHECK_FALSE(has(said_with("utcd 2026-03", "+01:00"), "warning"));
    if (std::filesystem::exists("/usr/share/zoneinfo/Europe/Berlin")) {
      CHECK_FALSE(has(said_with("Time (GMT+01:00)", "Europe/Berlin"), "warning"));
      CHECK(has(said_with("Time (GMT+02:00)", "Europe/Berlin"), "write --zone +02:00"));
    }
    folder.write("d.csv", "Time(dd/mm/yyyy),v\n04/03/2026 11:50:00,1\n");
    CHECK(has(import(folder, {"d.csv", "--time", "Time"}, 1), "such as \"%d/%m/%Y %H:%M:%S\""));
    CHECK(has(import(folder, {"d.csv", "--time", "Time", "--zone", "Z", "--time-format", "%m/%d/%Y %T"}, 1),
              "the heading \"Time(dd/mm/yyyy)\" has day, month and year in another order: write --time-format"));
    CHECK_FALSE(folder.has("d.db"));
    CHECK(has(import(folder, {"d.csv", "--time", "Time", "--zone", "Z", "--time-format", "%d/%m/%Y %T"}),
              "from 2026-03-04T11:50:00"));
    folder.write("e.csv", "Datum;v\n[dd.MM.yyyy HH:mm];[Wh]\n04.03.2026 11:50;1\n");
    CHECK(has(import(folder,
                     {"e.csv", "--time", "Datum", "--zone", "Z", "--separator", ";", "--units", "row", "--time-format",
                      "%m.%d.%Y %H:%M"},
                     1),
              "write --time-format \"%d.%m.%Y %H:%M\""));
    folder.write("f.csv", "My Day,v\n04.03.2026,1\n");
    import(folder, {"f.csv", "--time", "My Day", "--zone", "Z", "--time-format", "%m.%d.%Y"});
  }

  TEST_CASE("import: a second column of times, and zeros that are lost, are told") {
    const Folder folder;
    folder.write("imc.csv", "Time 1,F,Time 2,T\n0,1,0,20\n0.001,2,0.01,21\n0.002,3,0.02,22\n");
    CHECK(has(import(folder, {"imc.csv", "--time", "Time 1"}),
              "column Time 2 seems to be a time, too: all values are stored at the times of column Time 1"));
    folder.write("same.csv", "t,t2,T 3,T1\n0,0,5,20\n1,1,4,21\n2,2,9,22\n");
    CHECK_FALSE(has(import(folder, {"same.csv", "--time", "t"}), "warning"));
    folder.write("ids.csv", "t,site,n,v,b\n0,02395120,10,0.5,0\n1,02395121,20,0.25,1\n");
    CHECK(has(
        import(folder, {"ids.csv", "--time", "t"}),
        "zeros before whole numbers, such as 02395120, are not kept: to keep them as texts, write --text \"site\"\n"));
    std::filesystem::remove(folder.path() + "/ids.db");
    CHECK_FALSE(has(import(folder, {"ids.csv", "--time", "t", "--text", "site", "n"}), "warning"));
    CHECK(has(rows_of(folder, "ids.db"), "ids,1,02395120,10,0.5,0\n"));
    CHECK(has(import(folder, {"ids.csv", "--time", "t", "--text", "sit"}, 1), "did you mean site?"));
  }

  TEST_CASE("import: a point in a heading is part of the name, but in a table that rtdata exported") {
    const Folder folder;
    folder.write("dots.csv", "t,Dew Pt.,PM2.5_ATM,VE.Bus state\n0,1,2,Bulk\n");
    import(folder, {"dots.csv", "--time", "t"});
    CHECK(has(rows_of(folder, "dots.db"), "utc,origin,sequence,Dew_Pt_,PM2_5_ATM,VE_Bus_state\n"));
    folder.write("own.csv", "utc,origin,sequence,imu.ax [m/s2],baro.p\n2026-03-01T12:00:00Z,a,1,2,3\n");
    import(folder, {"own.csv", "--time", "utc"});
    CHECK(has(rows_of(folder, "own.db"), ",ax [m/s2],p\n"));
  }

  TEST_CASE("import: a blank behind a sign, and the minus that is no hyphen, are of a number") {
    const Folder folder;
    folder.write("g.csv", "t,a,b,c,d\n0,+  24.1,-   0.512,\u22121.5,- 3\n1,+   4.1,+ 1,\u22122,-14\n");
    CHECK(has(import(folder, {"g.csv", "--time", "t"}), "d: d, integer"));
    CHECK(has(rows_of(folder, "g.db"), "g,1,24.1,-0.512,-1.5,-3\n"));
    folder.write("h.csv", "t;a;b\n0;- 0,5;-\n\u22121;\u22121.200,5;- x\n");
    import(folder, {"h.csv", "--time", "t", "--separator", ";", "--decimal", ",", "--thousands", ".", "--sort"});
    CHECK(has(rows_of(folder, "h.db"), "59.000000000Z,h,1,-1200.5,- x\n1970-01-01T00:00:00.000000000Z,h,2,-0.5,-\n"));
  }

  TEST_CASE("import: days and years are not taken for seconds") {
    const Folder folder;
    const auto is_refused = [&](const std::string& heading, const std::string& first, const std::string& why) {
      folder.write("d.csv", heading + ",v\n" + first + ",1\n");
      const std::string said = import(folder, {"d.csv", "--time", heading}, 1);
      CHECK_MESSAGE(has(said, why), said);
    };
    is_refused("Date", "46085.5", "is a day, as of a spreadsheet: write --scale 24h --start 1899-12-30T00:00:00Z");
    is_refused("Date Time", "46085.5", "as of a spreadsheet");
    is_refused("JD", "2461104.5001", "is a Julian day: subtract 2440587.5 first");
    is_refused("Julian_Date", "2461104.5001", "is a Julian day");
    is_refused("MJD", "61103.5", "write --scale 24h --start 1858-11-17T00:00:00Z");
    is_refused("datenum", "739680.5", "subtract 719529 first");
    is_refused("Decimal Year", "2025.1083", "is a year");
    CHECK_FALSE(folder.has("d.db"));
    CHECK(has(import(folder, {"d.csv", "--time", "Decimal Year", "--scale", "1s"}), "from 1970-01-01T00:33:45"));
    std::filesystem::remove(folder.path() + "/d.db");
    folder.write("d.csv", "MJD,v\n61103.5,1\n");
    CHECK(has(import(folder, {"d.csv", "--time", "MJD", "--scale", "24h", "--start", "1858-11-17T00:00:00Z"}),
              "from 2026-03-04T12:00:00"));
    std::filesystem::remove(folder.path() + "/d.db");
    folder.write("d.csv", "date,v\n1772622000,1\n");
    CHECK(has(import(folder, {"d.csv", "--time", "date"}), "from 2026-03-04T11:00:00"));
  }

  TEST_CASE("import: rows without times are at even steps") {
    const Folder folder;
    folder.write("daq.csv", "# 32 Hz\na,b\n1,2\n3,4\n5,6\n");
    import(folder, {"daq.csv", "--rate", "32", "--start", "2026-03-01T12:00:00Z", "--comment", "#", "--partial"});
    CHECK(rows_of(folder, "daq.db") ==
          "utc,origin,sequence,a,b\n2026-03-01T12:00:00.000000000Z,daq,1,1,2\n"
          "2026-03-01T12:00:00.031250000Z,daq,2,3,4\n2026-03-01T12:00:00.062500000Z,daq,3,5,6\n");
    std::filesystem::remove(folder.path() + "/daq.db");
    import(folder, {"daq.csv", "--step", "31.25ms", "--skip", "1"});
    CHECK(has(rows_of(folder, "daq.db"), "1970-01-01T00:00:00.062500000Z,daq,3,5,6\n"));
    std::filesystem::remove(folder.path() + "/daq.db");
    std::string rows = "a\n";
    for (int i = 0; i <= 3000; ++i) rows += std::to_string(i) + "\n";
    folder.write("three.csv", rows + "\n\n");
    CHECK(has(import(folder, {"three.csv", "--rate", "3"}), "to 1970-01-01T00:16:40.000000000Z"));
    folder.write("gap.csv", "a\n1\n\n3\n");
    CHECK(has(import(folder, {"gap.csv", "--rate", "3"}, 1), "gap.csv:3: the line is empty; with --rate or --step"));
    CHECK(has(import(folder, {"gap.csv"}, 1), "--time is not given: write --time"));
    CHECK(has(import(folder, {"gap.csv", "--rate", "3", "--time", "a"}, 1), "more than one of --time, --rate and"));
    CHECK(has(import(folder, {"gap.csv", "--rate", "3", "--step", "1s"}, 1), "more than one of --time, --rate and"));
    CHECK(has(import(folder, {"gap.csv", "--rate", "3", "--zone", "Z"}, 1), "have no times of their own"));
    CHECK(has(import(folder, {"gap.csv", "--rate", "1e12"}, 1), "less than 1 ns apart"));
    CHECK(has(import(folder, {"gap.csv", "--rate", "0"}, 1), "\"0\" is not a number above 0"));
    CHECK_FALSE(folder.has("gap.db"));
  }

  TEST_CASE("import: several texts of comments, and a heading that is one of them") {
    const Folder folder;
    folder.write("rocket.csv",
                 "# Simulation 1 (Up to date)\n# 54 points, of 3 values\n# Time (s),Altitude (m),Mach\n"
                 "# Event LAUNCH, at t=0 seconds,\n! by hand\n0,0,0.1\n# Event APOGEE\n0.5,2,0.2\n");
    import(folder, {"rocket.csv", "--time", "Time", "--comment", "#", "--comment", "!"});
    CHECK(rows_of(folder, "rocket.db") ==
          "utc,origin,sequence,Altitude [m],Mach\n1970-01-01T00:00:00.000000000Z,rocket,1,0,0.1\n"
          "1970-01-01T00:00:00.500000000Z,rocket,2,2,0.2\n");
    folder.write("numpy.txt", "# bench 3\n# t v\n0 1\n1 2\n");
    import(folder, {"--comment", "#", "numpy.txt", "--time", "t", "--separator", "blanks", "--sort"});
    CHECK(has(rows_of(folder, "numpy.db"), "sequence,v\n1970-01-01T00:00:00.000000000Z,numpy,1,1\n"));
    // The first row that is no comment is the heading, if it names the time.
    folder.write("two.csv", "# t,b\nt,v\n0,1\n");
    import(folder, {"two.csv", "--time", "t", "--comment", "#"});
    CHECK(has(rows_of(folder, "two.db"), "sequence,v\n"));
    folder.write("none.csv", "# t,v\n0,1,2\n");
    import(folder, {"none.csv", "--time", "t", "--comment", "#"}, 1);
    CHECK_FALSE(folder.has("none.db"));
  }

  TEST_CASE("import: advice is about the table, not about lines before it") {
    const Folder folder;
    folder.write("pico.csv", "Time\nof 2026\nTime,A\n0,1\n1,2\n");
    CHECK(has(import(folder, {"pico.csv", "--time", "Time (s)"}, 1), "write --skip 2"));
    folder.write("lost.csv", "Rate\nTime,Start\nx\nTime,A,B\n0,1,2\n1,2,3\n");
    CHECK(has(import(folder, {"lost.csv", "--time", "Time"}, 1), "line 4 has it: write --skip 3"));
    folder.write("semi.csv", "# made by: a, b, c, d\n\nt;v\n0;1\n");
    CHECK(has(import(folder, {"semi.csv", "--time", "t", "--comment", "#"}, 1), "write --separator \";\""));
    folder.write("vrm.csv", "timestamp,Grid\nBerlin (+02:00),L1\n2026-10-25 01:45:00,1\n");
    CHECK(has(import(folder, {"vrm.csv", "--time", "timestamp", "--head", "2"}, 1),
              "with --head 2 write --time \"timestamp Berlin (+02:00)\""));
    folder.write("desc.csv", "t,v\n1772622000,1\n1772621880,2\n");
    CHECK(has(import(folder, {"desc.csv", "--time", "t"}, 1), "sort the rows by time: write --sort"));
    CHECK_FALSE(folder.has("desc.db"));
  }

  TEST_CASE("import: real tables of a rocket club") {
    const std::string flights = test::in_source("../shared/data/flight-fast");
    if (!std::filesystem::exists(flights)) {
      MESSAGE("skipped: there is no ../shared/data/flight-fast");
      return;
    }
    const Folder folder;
    for (const char* const name : {"irec_2023", "barometer_only_2023"}) {
      const std::string recording = std::string(name) + ".db";
      import(folder, {flights + "/" + name + ".csv", "--time", "t", "--into", recording});
      CHECK(has(rows_of(folder, recording), "altitude [m]"));
    }
  }
}
