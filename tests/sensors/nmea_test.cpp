// Receivers that send NMEA over a serial line.
#include "sensors/lines/nmea.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "paths.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/serial_line.hpp"
#include "sensors/fixture.hpp"
#include "sensors/pty.hpp"
#include "sensors/termios2.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using detail::NmeaFixes;

namespace {

/// "GPGGA,..." with what belongs around it.
std::string sentence(const std::string& body) {
  char sum[8];
  std::snprintf(sum, sizeof sum, "*%02X", static_cast<unsigned>(NmeaFixes::checksum(body)));
  return "$" + body + sum;
}

struct Reader {
  NmeaFixes fixes{"/dev/gps"};
  std::vector<GpsFix> got;
  std::vector<Time> times;
  std::vector<Error> errors;
  std::int64_t now = 0;
  void line(const std::string& text) {
    const auto done = fixes.take(text, Time(Duration(++now)), publish);
    if (!done) errors.push_back(done.error());
  }
  void body(const std::string& text) { line(sentence(text)); }
  void finish() { fixes.finish(publish); }
  const NmeaFixes::Publish publish = [this](const GpsFix& fix, Time time) {
    got.push_back(fix);
    times.push_back(time);
  };
};

const std::string gga = "GPGGA,092835.00,4804.14539,N,01621.54005,E,1,10,0.96,205.3,M,42.0,M,,";
const std::string rmc = "GPRMC,092835.00,A,4804.14539,N,01621.54005,E,10.0,84.4,210615,3.1,W";

std::string at(std::string body, const std::string& time) { return body.replace(6, 6, time); }

}  // namespace

TEST_SUITE("sensors") {
  TEST_CASE("US-14 NMEA: position, altitude, velocity, fix, satellites and time of the sentences of one instant") {
    Reader reader;
    reader.body("GPGSV,3,1,11,01,04,021,,06,03,117,,12,41,246,09,13,20,164,");
    reader.body("GLGSV,1,1,04,65,17,335,35");
    reader.body(rmc);
    reader.body("GPVTG,99.9,T,,M,77.0,N,88.0,K,A");
    reader.body(gga);
    reader.body("GPGSA,A,3,22,17,28,15,18,,,,,,,,1.75,0.96,1.47");
    CHECK(reader.got.empty());  // what the last one is, is not known yet
    reader.body(at(rmc, "092836"));
    REQUIRE(reader.got.size() == 1);
    const GpsFix fix = reader.got[0];
    CHECK(reader.times[0] == Time(Duration(6)));  // of its last sentence
    CHECK(fix.device == "/dev/gps");
    CHECK(fix.mode == 3);
    CHECK(fix.status == 1);
    CHECK(*fix.lat == doctest::Approx(48 + 4.14539 / 60).epsilon(1e-12));
    CHECK(*fix.lon == doctest::Approx(16 + 21.54005 / 60).epsilon(1e-12));
    CHECK(*fix.alt_msl == 205.3);
    CHECK(*fix.alt_hae == doctest::Approx(247.3));
    CHECK(*fix.geoid_sep == 42);
    CHECK(*fix.speed == doctest::Approx(5.144444));
    CHECK(*fix.track == 84.4);
    CHECK(*fix.mag_var == -3.1);
    CHECK(fix.satellites_used == 10);
    CHECK(fix.satellites_visible == 15);
    CHECK(*fix.gps_time == 1434878915'000'000'000);  // 2015-06-21T09:28:35Z
    // From the second on, a fix is published with its last sentence.
    reader.body("GPVTG,99.9,T,,M,77.0,N,88.0,K,A");
    reader.body(at(gga, "092836"));
    CHECK(reader.got.size() == 1);
    reader.body("GPGSA,A,2,22,17,28,15,18,,,,,,,,1.75,0.96,1.47");
    REQUIRE(reader.got.size() == 2);
    CHECK(reader.got[1].mode == 2);
    CHECK(*reader.got[1].gps_time - *fix.gps_time == 1'000'000'000);
    CHECK(reader.errors.empty());
  }

  TEST_CASE("US-14 NMEA: without a fix there is no position and no velocity; what is not said is absent, never 0") {
    Reader reader;
    reader.body("GPGGA,,,,,,0,,,,,,,,");
    reader.body("GPRMC,,V,,,,,,,,,,N");
    reader.body("GPGGA,092836.00,4804.1,N,01621.5,E,0,03,,,,,,,");  // the last position that it knew
    reader.body("GPRMC,092836.00,V,4804.1,N,01621.5,E,5.0,1.0,210615,,,N");
    reader.body("GPGGA,092837.00,4804.1,N,01621.5,E,1,,,,,,,,");
    reader.finish();
    CHECK(reader.errors.empty());
    REQUIRE(reader.got.size() == 3);
    CHECK(reader.got[0].mode == 1);
    CHECK_FALSE(reader.got[0].gps_time);
    CHECK_FALSE(reader.got[0].satellites_used);
    CHECK(reader.got[1].mode == 1);
    for (const GpsFix& fix : {reader.got[0], reader.got[1]}) {
      CHECK_FALSE(fix.lat);
      CHECK_FALSE(fix.lon);
      CHECK_FALSE(fix.speed);
      CHECK_FALSE(fix.track);
      CHECK_FALSE(fix.alt_msl);
      CHECK_FALSE(fix.alt_hae);
    }
    CHECK(reader.got[1].gps_time);
    CHECK(reader.got[2].mode == 2);
    CHECK(reader.got[2].lat);
    CHECK_FALSE(reader.got[2].alt_msl);
    CHECK_FALSE(reader.got[2].speed);
  }

  TEST_CASE("US-14 NMEA: each broken bit of a sentence is found, and so is what has no sense") {
    const std::string good = sentence(gga);
    for (std::size_t byte = 0; byte < good.size(); ++byte) {
      for (int bit = 0; bit < 8; ++bit) {
        if (byte + 2 >= good.size() && bit == 5) continue;  // a letter of the checksum in lower case is the same
        Reader reader;
        std::string broken = good;
        broken[byte] = static_cast<char>(static_cast<unsigned char>(broken[byte]) ^ 1u << bit);
        if (broken[0] == '!') continue;  // begins sentences too
        reader.line(broken);
        reader.finish();
        CHECK_MESSAGE(reader.errors.size() == 1, broken);
        CHECK(reader.got.empty());
      }
    }
    for (const char* body :
         {"GPGGA,250000.00,4804.1,N,01621.5,E,1,,,,,,,,", "GPGGA,092835.00,4804.1,N,01621.5,E,x,,,,,,,,",
          "GPRMC,0928x5.00,A,4804.1,N,01621.5,E,,,210615,,"}) {
      Reader reader;
      reader.body(body);
      reader.finish();
      CHECK_MESSAGE(reader.errors.size() == 1, body);
      CHECK_MESSAGE(reader.got.empty(), body);
    }
    // Another field that cannot be read is told, and costs itself only.
    for (const char* body :
         {"GPGGA,092835.00,9104.1,N,01621.5,E,1,07,,5.5,M,,,,", "GPGGA,092835.00,4864.1,N,01621.5,E,1,07,,5.5,M,,,,",
          "GPGGA,092835.00,4804.1,X,01621.5,E,1,07,,5.5,M,,,,", "GPGGA,092835.00,4804.1,N,18100.0,E,1,07,,5.5,M,,,,",
          "GPGGA,092835.00,nan,N,01621.5,E,1,07,,5.5,M,,,,", "GPGGA,092835.00,-4804.1,N,01621.5,E,1,07,,5.5,M,,,,"}) {
      Reader reader;
      reader.body(body);
      reader.finish();
      CHECK_MESSAGE(reader.errors.size() == 1, body);
      REQUIRE_MESSAGE(reader.got.size() == 1, body);
      CHECK_FALSE(reader.got[0].lat);
      CHECK_FALSE(reader.got[0].lon);
      CHECK(reader.got[0].satellites_used == 7);
      CHECK(reader.got[0].alt_msl == 5.5);
    }
    for (const char* body :
         {"GPRMC,092835.00,A,4804.1,N,01621.5,E,1e999,,210615,,", "GPRMC,092835.00,A,4804.1,N,01621.5,E,,,310215,,"}) {
      Reader reader;
      reader.body(body);
      reader.finish();
      CHECK_MESSAGE(reader.errors.size() == 1, body);
      REQUIRE_MESSAGE(reader.got.size() == 1, body);
      CHECK(reader.got[0].lat);
      CHECK_FALSE(reader.got[0].speed);
    }
    Reader reader;
    for (const char* text : {"", "$", "GPGGA", "$GPGGA,1,2", "$*00", "$GPGGA*", "\xb5\x62\x01"}) reader.line(text);
    CHECK(reader.errors.size() == 6);  // "$*00" is an empty sentence, and right
    CHECK(reader.got.empty());
  }

  TEST_CASE("US-14 NMEA: without a fix no position is looked at; a variation without a direction costs itself only") {
    Reader reader;
    reader.body("GPGGA,235946.005,8960.000000,N,00000.000000,E,0,0,,137.000,M,13.000,M,,");
    reader.body("GPRMC,235946.005,V,8960.000000,N,00000.000000,E,0.000,0.00,050180,,,N");
    reader.body("GPRMC,235947.005,A,4804.1,N,01621.5,E,1.0,2.0,050180,3,N");
    reader.finish();
    CHECK(reader.errors.empty());
    REQUIRE(reader.got.size() == 2);
    CHECK(reader.got[0].mode == 1);
    CHECK(reader.got[0].gps_time);
    CHECK_FALSE(reader.got[0].lat);
    CHECK(reader.got[1].speed);
    CHECK_FALSE(reader.got[1].mag_var);
  }

  TEST_CASE("US-14 NMEA: two talkers of one instant are one fix") {
    Reader reader;
    for (const char* const time : {"020935", "020936", "020937"}) {
      const std::string t = time;
      reader.body("GPGGA," + t + ".000,4404.1351,N,12118.8556,W,1,08,0.9,1123.9,M,-19.6,M,,0000");
      reader.body("GLGGA," + t + ".000,4404.1351,N,12118.8556,W,1,02,0.9,1123.9,M,-19.6,M,,0000");
      reader.body("GNRMC," + t + ".000,A,4404.1351,N,12118.8556,W,0.04,359.11,050219,,,A");
    }
    reader.finish();
    CHECK(reader.errors.empty());
    REQUIRE(reader.got.size() == 3);
    for (const GpsFix& fix : reader.got) {
      CHECK(fix.satellites_used == 10);
      CHECK(fix.mode == 3);
      CHECK(fix.gps_time);
    }
    Reader half;  // one of both has no fix
    half.body("GLGGA,020935.000,,,,,0,00,,,M,0.0,M,,");
    half.body("GPGGA,020935.000,4404.1351,N,12118.8556,W,1,08,0.9,1123.9,M,-19.6,M,,0000");
    half.finish();
    REQUIRE(half.got.size() == 1);
    CHECK(half.got[0].lat);
    CHECK(half.got[0].satellites_used == 8);
  }

  TEST_CASE("US-14 NMEA: satellites of several signals count once each") {
    Reader reader;
    for (int second = 0; second < 3; ++second) {
      const std::string time = "12000" + std::to_string(second);
      reader.body("GNRMC," + time + ".00,A,5200.0,N,00500.0,E,0.10,,281126,,,A,V");
      reader.body("GNGGA," + time + ".00,5200.0,N,00500.0,E,1,12,0.80,10.0,M,45.0,M,,");
      reader.body("GPGSV,2,1,05,02,10,010,30,05,20,020,31,07,30,030,32,09,40,040,33,1");
      reader.body("GPGSV,2,2,05,13,50,050,34,1");
      reader.body("GPGSV,1,1,02,05,20,020,25,09,40,040,26,8");
      reader.body("GAGSV,1,1,02,03,21,021,30,08,22,022,30,7");
      reader.body("GAGSV,1,1,02,01,03,200,,26,04,210,,0");
    }
    reader.finish();
    CHECK(reader.errors.empty());
    REQUIRE(reader.got.size() == 3);
    for (const GpsFix& fix : reader.got) CHECK(fix.satellites_visible == 5 + 4);
  }

  TEST_CASE("US-14 NMEA: a leap second is an instant of its own, without a number") {
    Reader reader;
    const std::pair<const char*, const char*> instants[] = {
        {"235959.00", "311216"}, {"235960.00", "311216"}, {"000000.00", "010117"}, {"000001.00", "010117"}};
    for (const auto& [time, date] : instants) {
      reader.body(std::string("GPGGA,") + time + ",5200.0,N,00500.0,E,1,08,1.0,10.0,M,45.0,M,,");
      reader.body(std::string("GPRMC,") + time + ",A,5200.0,N,00500.0,E,0.0,," + date + ",,,A");
    }
    reader.finish();
    CHECK(reader.errors.empty());
    REQUIRE(reader.got.size() == 4);
    CHECK(*reader.got[0].gps_time == 1'483'228'799'000'000'000);
    CHECK_FALSE(reader.got[1].gps_time);
    CHECK(reader.got[1].lat);
    CHECK(*reader.got[2].gps_time == 1'483'228'800'000'000'000);
  }

  TEST_CASE("US-14 NMEA: a sentence that is lost costs its own values, and delays no other fix for good") {
    Reader reader;
    for (int second = 10; second < 30; ++second) {
      const std::string time = "0928" + std::to_string(second);
      reader.body(at(gga, time));
      if (second != 20) reader.body(at(rmc, time));
    }
    reader.finish();
    REQUIRE(reader.got.size() == 20);
    for (std::size_t i = 0; i < 20; ++i) {
      CHECK(reader.got[i].speed.has_value() == (i != 10));
      CHECK(reader.got[i].gps_time.has_value() == (i != 10));
      CHECK(reader.got[i].alt_msl.has_value());
    }
    // The receiver is set to send less: it waits for the next instant until that is sure.
    for (int second = 30; second < 36; ++second) reader.body(at(gga, "0928" + std::to_string(second)));
    CHECK(reader.got.size() == 26);
  }

  TEST_CASE("US-14 NMEA: no sentence that is right is left out when the order changes or the first ones are broken") {
    const auto speeds = [](const Reader& reader) {
      std::size_t count = 0;
      for (const GpsFix& fix : reader.got) count += fix.speed ? 1 : 0;
      return count;
    };
    Reader reader;
    for (int second = 10; second < 20; ++second) {
      const std::string time = "0928" + std::to_string(second);
      const bool is_turned = second >= 15;
      reader.body(at(is_turned ? gga : rmc, time));
      reader.body(at(is_turned ? rmc : gga, time));
    }
    reader.finish();
    CHECK(speeds(reader) == 10);
    REQUIRE(reader.got.size() == 11);  // the first one in the other order comes twice: as it was known, then whole
    CHECK_FALSE(reader.got[5].speed);
    CHECK(reader.got[6].speed);
    CHECK(reader.got[6].alt_msl == reader.got[5].alt_msl);
    CHECK(*reader.got[7].gps_time - *reader.got[6].gps_time == 1'000'000'000);

    Reader broken;  // the first RMC of all
    for (int second = 10; second < 20; ++second) {
      const std::string time = "0928" + std::to_string(second);
      broken.body(at(gga, time));
      std::string last = sentence(at(rmc, time));
      if (second == 10) last[20] ^= 1;
      broken.line(last);
    }
    broken.finish();
    CHECK(broken.errors.size() == 1);
    CHECK(speeds(broken) == 9);

    Reader rest;  // its beginning was not heard: what has no time is not given one
    rest.body("GPVTG,99.9,T,,M,77.0,N,88.0,K,A");
    rest.body("GPGSA,A,3,22,17,28,15,18,,,,,,,,1.75,0.96,1.47");
    rest.body(rmc);
    rest.body(gga);
    rest.body(at(rmc, "092836"));
    rest.body(at(gga, "092836"));
    REQUIRE(rest.got.size() == 3);
    CHECK(rest.got[0].track == 99.9);
    CHECK(rest.got[0].mode == 3);
    CHECK_FALSE(rest.got[0].gps_time);
    CHECK_FALSE(rest.got[0].lat);
    CHECK(rest.got[1].track == 84.4);
    CHECK(rest.got[2].gps_time);
    CHECK(rest.errors.empty());
  }

  TEST_CASE("US-14 NMEA: a sentence without a word on the fix does not say that there is none") {
    for (const char* body :
         {"GPGGA,,,,,,,,,,,,,,", "GPRMC,,,,,,,,,,,,", "GPGGA", "GPRMC", "GPGGA,092835.00,,,,,,,,,,,,,"}) {
      Reader reader;
      reader.body(body);
      reader.finish();
      REQUIRE_MESSAGE(reader.got.size() == 1, body);
      CHECK_MESSAGE(reader.got[0].mode == 0, body);
      CHECK(reader.errors.empty());
    }
    for (const char* body : {"GPGGA,092835.00,4804.1,N,01621.5,E,,,,,,,,,",
                             "GPRMC,092835.00,,4804.1,N,01621.5,E,,,210615,,", "GPRMC,092835.00,X,,,,,,,210615,,"}) {
      Reader reader;
      reader.body(body);
      reader.finish();
      CHECK_MESSAGE(reader.errors.size() == 1, body);
      CHECK_MESSAGE(reader.got.empty(), body);
    }
    Reader reader;  // the other sentence of the instant says it
    reader.body("GPGGA,092835.00,,,,,,,,,,,,,");
    reader.body(rmc);
    reader.finish();
    REQUIRE(reader.got.size() == 1);
    CHECK(reader.got[0].mode == 2);
    CHECK(reader.got[0].lat);
  }

  TEST_CASE("US-14 NMEA: the logs of real receivers, against what gpsd made of them") {
    const char* const from_outside = std::getenv("RTDATA_TEST_DATA");
    const std::filesystem::path folder = std::filesystem::path(from_outside != nullptr
                                                                   ? from_outside
                                                                   : test::in_source("../shared/data")) /
                                         "gps";
    std::size_t logs = 0;
    std::error_code none;
    for (const auto& entry : std::filesystem::directory_iterator(folder, none)) {
      if (entry.path().extension() != ".log") continue;
      const std::string name = entry.path().filename().string();
      CAPTURE(name);
      std::ifstream file(entry.path(), std::ios::binary);
      std::string text;
      Reader reader;
      std::size_t wrong = 0, right = 0;
      while (std::getline(file, text)) {
        if (!text.empty() && text.back() == '\r') text.pop_back();
        const auto begin = text.rfind('$');
        if (begin == std::string::npos || text[0] == '#') continue;
        text.erase(0, begin);
        const auto star = text.rfind('*');
        // By another way than ours: whether the sentence is right.
        bool is_right = star != std::string::npos && star + 3 == text.size();
        if (is_right) {
          int sum = 0;
          for (std::size_t i = 1; i < star; ++i) sum ^= static_cast<unsigned char>(text[i]);
          is_right = std::strtol(text.c_str() + star + 1, nullptr, 16) == sum;
        }
        ++(is_right ? right : wrong);
        const std::size_t before = reader.errors.size();
        reader.line(text);
        CHECK_MESSAGE(reader.errors.size() == before + (is_right ? 0 : 1), text);
      }
      reader.finish();
      if (right < 10) continue;  // a receiver that speaks another language
      ++logs;
      // Of each instant, what gpsd says at last; its days are not those of the log (it corrects the weeks).
      std::ifstream reports(entry.path().string() + ".chk");
      std::map<std::string, nlohmann::json> by_time;
      while (std::getline(reports, text)) {
        const auto report = nlohmann::json::parse(text, nullptr, false);
        if (report.is_object() && report.value("class", "") == "TPV" && report.contains("time"))
          by_time[report["time"].get<std::string>().substr(11, 8)].update(report);
      }
      std::size_t compared = 0;
      for (const GpsFix& fix : reader.got) {
        if (!fix.gps_time) continue;
        const auto seconds = *fix.gps_time / 1'000'000'000 % 86400;
        char clock[16];
        std::snprintf(clock, sizeof clock, "%02d:%02d:%02d", static_cast<int>(seconds / 3600),
                      static_cast<int>(seconds / 60 % 60), static_cast<int>(seconds % 60));
        const auto found = by_time.find(clock);
        if (found == by_time.end()) continue;
        const nlohmann::json& report = found->second;
        CHECK(fix.mode == report["mode"]);
        const auto same = [&](const std::optional<double>& ours, const char* key, double within) {
          CHECK_MESSAGE(ours.has_value() == report.contains(key), key);
          if (ours && report.contains(key)) {
            CHECK_MESSAGE(std::abs(*ours - report[key].get<double>()) <= within, key);
            ++compared;
          }
        };
        same(fix.lat, "lat", 1e-9);
        same(fix.lon, "lon", 1e-9);
        same(fix.alt_msl, "altMSL", 1e-3);
        same(fix.alt_hae, "altHAE", 1e-3);
        same(fix.speed, "speed", 1e-3);
      }
      MESSAGE((name + ": ") << right << " sentences, " << wrong << " wrong, " << reader.got.size() << " fixes, "
                            << compared << " values as gpsd's");
      CHECK(compared > reader.got.size());
    }
    if (logs == 0)
      MESSAGE("skipped: no logs of receivers in " << folder.string() << " (RTDATA_TEST_DATA names another folder)");
  }
}

TEST_SUITE_BEGIN("sensors" * doctest::skip(!terminals_can_be_set_up()));

TEST_CASE("US-13 US-14 a serial line with format nmea publishes fixes, counts what is broken, and comes back") {
  ScratchDirectory directory;
  Pty pty(directory.file("tty"));
  pty.plug_in();
  Loop loop;
  be_quiet(loop);
  std::vector<GpsFix> got;
  std::vector<std::string> errors;
  const auto heard = loop.subscribe<GpsFix>("gps", [&](const Event<GpsFix>& fix) { got.push_back(*fix); });
  SerialLineSensor gps(
      loop, {.name = "gps"},
      {.device = pty.path(),
       .lines = {.format = LineFormat::nmea, .first_line = FirstLine::keep, .retry_first = 2ms, .retry_longest = 4ms}});
  gps.on_error([&](const ErrorReport& report) { errors.emplace_back(report.error.id()); });
  const auto until = [&](const std::function<bool()>& is_so) {
    bool done = false;
    Timer limit(loop, 60s, [&] { loop.stop(); });
    Ticker look(loop, 1ms, [&](const Tick&) {
      done = is_so();
      if (done) loop.stop();
    });
    loop.run();
    CHECK(done);
  };
  std::string text;
  for (int second = 10; second < 20; ++second) {
    const std::string time = "0928" + std::to_string(second);
    text += sentence(at(rmc, time)) + "\r\n";
    std::string broken = sentence(at(gga, time));
    if (second == 15) broken[20] ^= 1;
    text += "\\s:mast,c:1796040000*00\\\\n:1*6e\\" + broken + "\r\n";
  }
  pty.send(text);
  until([&] { return got.size() == 10 && gps.counts().unreadable == 1; });  // the sixth waits for the seventh
  CHECK(gps.health() == Health::ok);
  // A maker's own bytes before a sentence are told; the sentence is used.
  pty.send("\xb5\x62garbage" + sentence(at(rmc, "092820")) + "\r\n" + sentence(at(gga, "092820")) + "\r\n");
  until([&] { return got.size() == 11; });
  CHECK(gps.counts().unreadable == 2);
  CHECK(errors == std::vector<std::string>{"bad-data", "bad-data"});
  CHECK(gps.counts().received == 13);
  CHECK(gps.counts().published == 11);
  pty.send(sentence(at(rmc, "092821")) + "\r\n");  // half a fix
  until([&] {
    pty.unplug();
    return gps.health() == Health::faulted;
  });
  pty.plug_in();
  got.clear();
  until([&] {
    if (got.empty()) pty.send(sentence(at(rmc, "092830")) + "\r\n" + sentence(at(rmc, "092831")) + "\r\n");
    return !got.empty();
  });
  gps.stop();
  CHECK(gps.counts().balances());
  CHECK(loop.runtime().balances());
}

TEST_SUITE_END();
