#include "rtdata/sensors/gps.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <fstream>
#include <random>

#include "loop/runtime/runtime_core.hpp"
#include "paths.hpp"
#include "rtdata/config/format.hpp"
#include "rtdata/config/read.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/recording/recording.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/recording/verify.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sensors/fixture.hpp"
#include "sensors/gps/gps_report.hpp"
#include "sensors/gps/gps_time.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using detail::GpsReport;

TEST_SUITE_BEGIN("sensors");

namespace {

// Lines of gpsd 3.22 and 3.25.
constexpr std::string_view
    whole_fix = R"({"class":"TPV","device":"/dev/ttyS1","status":2,"mode":3,"time":"2017-01-10T00:09:41.005Z","leapseconds":18,"ept":0.005,)"
                R"("lat":44.068897833,"lon":-121.314271333,"altHAE":1123.4,"altMSL":1144.8,"alt":1144.8,"epx":4.1,"epy":5.2,"epv":31.74,)"
                R"("track":120.5,"magtrack":106.1,"magvar":14.4,"speed":0.015,"climb":-0.25,"epd":12.5,"eps":8.4,"epc":0.5,)"
                R"("geoidSep":-21.4,"eph":19.19,"sep":32.49,"velN":0.1,"velE":-0.2,"velD":0.3})";
constexpr std::string_view
    satellites = R"({"class":"SKY","device":"/dev/ttyS1","time":"2017-01-10T00:09:41.005Z","xdop":0.91,"satellites":[)"
                 R"({"PRN":2,"el":5.0,"az":307.0,"ss":0.0,"used":false,"gnssid":0,"svid":2},)"
                 R"({"PRN":3,"el":21.0,"az":174.0,"ss":29.0,"used":true,"gnssid":0,"svid":3},)"
                 R"({"PRN":6,"el":7.0,"az":270.0,"ss":22.0,"used":true,"gnssid":0,"svid":6}]})";

GpsReport read(std::string_view line) {
  GpsReport report;
  detail::read_report(line, report).or_throw();
  return report;
}
std::string id_of(std::string_view line) {
  GpsReport report;
  const auto done = detail::read_report(line, report);
  return done ? "ok" : std::string(done.error().id());
}
std::string fix_line(std::string_view device, std::string_view time, double lat) {
  return R"({"class":"TPV","device":")" + std::string(device) + R"(","mode":2,"time":")" + std::string(time) +
         R"(","lat":)" + std::to_string(lat) + ",\"lon\":0.5}\n";
}

struct Seen {
  Time time{};
  GpsFix fix;
};

/// A GPS sensor of a scripted server, in virtual time.
struct GpsBench {
  explicit GpsBench(GpsConfig config = {}, FakeGpsd::Family family = FakeGpsd::Family::ipv4, const char* host = nullptr)
      : gpsd(family) {
    be_quiet(loop);
    loop.on_error([](const ErrorReport&) {});
    loop.runtime().on_log([this](const LogRecord& record) {
      if (record.level >= LogLevel::warning && record.text.starts_with("its time")) log.emplace_back(record.text);
    });
    heard = loop.subscribe<GpsFix>("gps", [this](const Event<GpsFix>& fix) { seen.push_back({fix.time, *fix}); });
    config.port = gpsd.port();
    config.host = host != nullptr ? host : family == FakeGpsd::Family::ipv4 ? "127.0.0.1" : "::1";
    config.start = false;
    sensor = GpsSensor(loop, {.name = "gps"}, config);
    sensor.on_error([this](const ErrorReport& report) { errors.push_back(report.error); });
    sensor.start();
  }
  /// Whether the sensor has connected by now, and asked for reports.
  bool accept() {
    loop.poll();
    if (!gpsd.accept()) return false;
    loop.poll();
    return gpsd.received() == "?WATCH={\"enable\":true,\"json\":true};\n";
  }
  void say(std::string_view text) {
    REQUIRE(gpsd.send(text));
    for (std::size_t read = 0; read <= text.size(); read += 4096) loop.poll();
  }
  std::string last_error() const { return errors.empty() ? "" : std::string(errors.back().id()); }

  FakeGpsd gpsd;
  Loop loop{Loop::Manual{}};
  Subscription heard;
  GpsSensor sensor;
  std::vector<Seen> seen;
  std::vector<Error> errors;
  std::vector<std::string> log;  // what it says of its time of day
};

std::vector<std::string> error_texts(const GpsBench& bench) {
  std::vector<std::string> texts;
  for (const Error& error : bench.errors) texts.push_back(error.text());
  return texts;
}

}  // namespace

TEST_CASE("US-14 a report of gpsd is read: position, velocity, height, uncertainties, and the time to the nanosecond") {
  const GpsReport report = read(whole_fix);
  CHECK(report.kind == GpsReport::Kind::fix);
  const GpsFix& fix = report.fix;
  CHECK(fix.device == "/dev/ttyS1");
  CHECK(fix.mode == 3);
  CHECK(fix.status == 2);
  CHECK(fix.gps_time == 1'484'006'981'005'000'000);
  CHECK(fix.lat == 44.068897833);
  CHECK(fix.lon == -121.314271333);
  CHECK(fix.alt_hae == 1123.4);
  CHECK(fix.alt_msl == 1144.8);
  CHECK(fix.speed == 0.015);
  CHECK(fix.track == 120.5);
  CHECK(fix.climb == -0.25);
  CHECK(fix.vel_n == 0.1);
  CHECK(fix.vel_e == -0.2);
  CHECK(fix.vel_d == 0.3);
  CHECK(fix.eph == 19.19);
  CHECK(fix.epx == 4.1);
  CHECK(fix.epy == 5.2);
  CHECK(fix.epv == 31.74);
  CHECK(fix.sep == 32.49);
  CHECK(fix.ept == 0.005);
  CHECK(fix.eps == 8.4);
  CHECK(fix.epd == 12.5);
  CHECK(fix.epc == 0.5);
  CHECK(fix.geoid_sep == -21.4);
  CHECK(fix.mag_var == 14.4);
}

TEST_CASE("US-14 what gpsd does not say is no value, never 0") {
  const GpsFix fix = read(R"({"class":"TPV","device":"/dev/ttyS1","mode":1})").fix;
  CHECK(fix.mode == 1);
  const auto& description = *description_of<GpsFix>();
  std::size_t absent = 0;
  for (const Leaf& leaf : description.leaves()) {
    if (leaf.optional == nullptr) continue;
    ++absent;
    CHECK(reinterpret_cast<const std::byte*>(&fix)[leaf.offset + leaf.optional->value_size] == std::byte{0});
  }
  CHECK(absent == 25);
  CHECK(read(R"({"class":"TPV"})").fix.mode == 0);
  CHECK(read(R"({"class":"TPV","mode":3,"lat":null,"lon":0})").fix.lat == std::nullopt);
  CHECK(read(R"({"class":"TPV","mode":3,"lat":null,"lon":0})").fix.lon == 0);
  GpsReport reused = read(whole_fix);
  detail::read_report(R"({"class":"TPV","mode":1})", reused).or_throw();
  CHECK(!reused.fix.lat);
  CHECK(reused.fix.device.empty());
}

TEST_CASE("US-14 what is no time, no number or no whole line is no value, though libgps makes one of it") {
  const auto tpv = [](const std::string& rest) { return R"({"class":"TPV","mode":3,)" + rest; };
  for (const char* rest : {R"("time":"garbage"})", R"("time":"2026-13-45T99:00:00Z"})", R"("lat":1.2.3})",
                           R"("lat":95.5})", R"("mode":300})", R"("lat":4)"}) {
    CAPTURE(rest);
    CHECK(id_of(tpv(rest)) != "ok");
  }
  const GpsFix leap = read(tpv(R"("time":"2016-12-31T23:59:60.000Z","velN":0.09})")).fix;
  CHECK(!leap.gps_time);
  CHECK(leap.vel_n == 0.09);
}

TEST_CASE("US-14 satellites are counted, or taken as gpsd counts them") {
  CHECK(read(satellites).used == 2);
  CHECK(read(satellites).visible == 3);
  const GpsReport counted = read(R"({"class":"SKY","device":"/dev/a","nSat":13,"uSat":8,"satellites":[]})");
  CHECK(counted.visible == 13);
  CHECK(counted.used == 8);
  const GpsReport dops = read(R"({"class":"SKY","device":"/dev/a","hdop":1.01})");
  CHECK(!dops.visible);
  CHECK(!dops.used);
}

TEST_CASE("US-14 other reports are told apart, and nothing of theirs is taken for a mistake") {
  using Kind = GpsReport::Kind;
  const GpsReport devices = read(
      R"({"class":"DEVICES","devices":[{"class":"DEVICE","path":"/dev/a","activated":"2026-01-01T00:00:00.000Z"},)"
      R"({"class":"DEVICE","path":"/dev/b"}]})");
  CHECK(devices.kind == Kind::devices);
  CHECK(devices.devices == std::vector<std::string>{"/dev/a", "/dev/b"});
  const GpsReport gone = read(R"({"class":"DEVICE","path":"/dev/a","activated":0})");
  CHECK(gone.kind == Kind::device);
  CHECK(gone.is_deactivated);
  CHECK(gone.fix.device == "/dev/a");
  CHECK(read(R"({"class":"ERROR","message":"Unrecognized request '?'"})").message == "Unrecognized request '?'");
  CHECK(read(R"({"class":"VERSION","release":"3.22","proto_major":3})").kind == Kind::other);
  CHECK(read(R"({"class":"AIS","lat":"north","mode":[1,{"lat":5}],"status":77000})").kind == Kind::other);
}

TEST_CASE("US-14 a line that cannot be used says what is wrong with it") {
  CHECK(id_of(whole_fix.substr(0, whole_fix.size() - 1)) == "bad-data");
  CHECK(id_of("") == "bad-data");
  CHECK(id_of("$GPGGA,092835.00") == "bad-data");
  CHECK(id_of("[1]") == "bad-data");
  CHECK(id_of("5") == "bad-data");
  CHECK(id_of("true") == "bad-data");
  CHECK(id_of("\"TPV\"") == "bad-data");
  CHECK(id_of("null") == "bad-data");
  CHECK(id_of("{}") == "bad-data");
  CHECK(id_of(R"({"class":5})") == "bad-data");
  CHECK(id_of(R"({"class":"TPV","lat":"44"})") == "not-a-number");
  CHECK(id_of(R"({"class":"TPV","lat":true})") == "not-a-number");
  CHECK(id_of(R"({"class":"TPV","lat":90.5})") == "out-of-range");
  CHECK(id_of(R"({"lon":-181,"class":"TPV"})") == "out-of-range");
  CHECK(id_of(R"({"class":"TPV","lat":1e999})") == "bad-data");
  CHECK(id_of(R"({"class":"TPV","lat":nan})") == "bad-data");
  CHECK(id_of(R"({"class":"TPV","mode":-1})") == "out-of-range");
  CHECK(id_of(R"({"class":"TPV","mode":1.5})") == "out-of-range");
  CHECK(id_of(R"({"class":"TPV","time":"yesterday"})") == "bad-data");
  CHECK(id_of(R"({"class":"TPV","time":1484006981.0})") == "bad-data");
  CHECK(id_of(R"({"class":"TPV","device":")" + std::string(129, 'x') + "\"}") == "does-not-fit");
  CHECK(id_of("{\"class\":\"TPV\",\"device\":\"\xff\"}") == "bad-data");
}

TEST_CASE("US-14 lines that are changed at random crash nothing, and give no position out of range") {
  std::mt19937 random(14);
  const auto below = [&](std::size_t most) { return std::uniform_int_distribution<std::size_t>(0, most - 1)(random); };
  GpsReport report;
  std::size_t good = 0;
  for (int round = 0; round < 20'000; ++round) {
    std::string line(round % 2 == 0 ? whole_fix : satellites);
    for (std::size_t changes = 1 + below(3); changes > 0 && !line.empty(); --changes) {
      const std::size_t at = below(line.size());
      if (below(3) == 0) {
        line.erase(at, 1 + below(20));
      } else if (below(2) == 0) {
        line[at] = static_cast<char>(below(256));
      } else {
        line.insert(at, line.substr(below(line.size()), below(20)));
      }
    }
    if (!detail::read_report(line, report)) continue;
    ++good;
    if (report.kind != GpsReport::Kind::fix) continue;
    REQUIRE(std::abs(report.fix.lat.value_or(0)) <= 90);
    REQUIRE(std::abs(report.fix.lon.value_or(0)) <= 180);
  }
  CHECK(good > 1000);  // or all were thrown away
}

TEST_CASE("US-14 a receiver's time is a source of the time of day once it is plausible, and not before") {
  using System = detail::GpsTimeCheck::SystemTime;
  using Verdict = detail::GpsTimeCheck::Verdict;
  const Time right{1'800'000'000s};
  /// How many of `count` reports, one a second, get this verdict; the others are open.
  const auto judged = [](detail::GpsTimeCheck& check, Verdict verdict, Time from, int count, const System& system) {
    static MonotonicTime at{1h};
    int all = 0;
    for (int i = 0; i < count; ++i) {
      at += 1s;
      const Verdict now = check.look_at(at, from + i * 1s, 1s, 1s, {system.time + i * 1s, system.accuracy});
      CHECK((now == verdict || now == Verdict::open));
      all += now == verdict ? 1 : 0;
    }
    return all;
  };
  const System unset{Time{0s}};
  detail::GpsTimeCheck check;
  CHECK(judged(check, Verdict::good, right, 4, unset) == 0);
  CHECK(judged(check, Verdict::good, right + 4s, 5, unset) == 5);
  CHECK(judged(check, Verdict::good, right + 60s, 4, unset) == 0);  // it jumped: a leap second, or another satellite
  CHECK(judged(check, Verdict::good, right, 4, unset) == 0);        // and back
  // Nobody keeps the clock: whatever it shows, the receiver is right within the ten years from the release on.
  constexpr Duration rollover = 24h * 7 * 1024;
  const Time made{std::chrono::sys_days{detail::this_release.date}};
  const Time later{std::chrono::sys_days{detail::this_release.date + std::chrono::years{10}}};
  for (const System system : {unset, System{right}, System{right + rollover}}) {
    CHECK(judged(check, Verdict::other_age, right - rollover, 100, system) == 96);
    CHECK(judged(check, Verdict::other_age, right + rollover, 100, system) == 96);
    CHECK(judged(check, Verdict::other_age, Time{0s}, 100, system) == 96);
    CHECK(judged(check, Verdict::other_age, made - 100s, 100, system) == 96);
    CHECK(judged(check, Verdict::good, made, 100, system) == 100);  // the same line goes on
    CHECK(judged(check, Verdict::good, later - 100s, 100, system) == 96);
    CHECK(judged(check, Verdict::other_age, later, 100, system) == 100);
  }
  // Somebody does: it is believed before a receiver beyond both accuracies, of any date.
  check.reset();
  CHECK(judged(check, Verdict::other_clock, right + 18s, 100, System{right, 10ms}) == 96);
  CHECK(judged(check, Verdict::other_clock, right - 1020ms, 100, System{right, 10ms}) == 96);
  CHECK(judged(check, Verdict::good, right + 1s, 100, System{right, 10ms}) == 96);
  CHECK(judged(check, Verdict::good, right + 18s, 100, System{right, 17s}) == 96);
  CHECK(judged(check, Verdict::good, right - rollover, 100, System{right - rollover, 10ms}) == 96);
  CHECK(judged(check, Verdict::other_clock, Time::max() - 200s, 100, System{Time::min(), 10ms}) == 96);
}

TEST_CASE("US-14 reports of a receiver agree when they are as far apart in arrival as in time, not when held back") {
  const Time right{1'800'000'000s};
  struct Arrival {
    Duration at, fix;
  };
  /// At which of the reports the time of day is taken, and how far it is off then, at most.
  const auto worst = [&](const std::vector<Arrival>& reports, int* good = nullptr) {
    detail::GpsTimeCheck check;
    Duration most{0};
    for (const Arrival& report : reports) {
      if (check.look_at(MonotonicTime{1h} + report.at, right + report.fix, 1s, 1s, {}) !=
          detail::GpsTimeCheck::Verdict::good)
        continue;
      if (good != nullptr) ++*good;
      most = std::max(most, report.at - report.fix);
    }
    return most;
  };
  for (const Duration period : {Duration{1s}, Duration{200ms}, Duration{100ms}}) {
    CAPTURE(to_string(period));
    // Held back for 20 s, come in one read, and then go on as they are made.
    std::vector<Arrival> reports;
    for (Duration fix{0}; fix < 60s; fix += period) reports.push_back({fix < 20s ? 20s : fix, fix});
    int good = 0;
    CHECK(worst(reports, &good) <= 1s);
    CHECK(good > (40s - 6s) / period);
    reports.resize(static_cast<std::size_t>(20s / period));
    CHECK(worst(reports, &(good = 0)) == 0s);
    CHECK(good == 0);
    // Made as they come, but for 20 s in between.
    reports.clear();
    for (Duration fix{0}; fix < 60s; fix += period) reports.push_back({fix >= 20s && fix < 40s ? 40s : fix, fix});
    CHECK(worst(reports) <= 1s);
  }
  // The same time again and again is one report, before and after it is taken.
  std::vector<Arrival> still;
  for (int i = 0; i < 20; ++i) still.push_back({i * 1s, 0s});
  for (int i = 20; i < 30; ++i) still.push_back({i * 1s, i * 1s});
  for (int i = 30; i < 50; ++i) still.push_back({i * 1s, 29s});
  int good = 0;
  CHECK(worst(still, &good) == 0s);
  CHECK(good > 0);
}

TEST_CASE("US-14 the date of the release stands beside its version, as in the list of changes") {
  std::ifstream file(test::in_source("CHANGELOG.md"));
  std::string line;
  while (std::getline(file, line) && !line.starts_with("## ")) {
  }
  const std::string date = to_iso8601(Time{std::chrono::sys_days{detail::this_release.date}}).substr(0, 10);
  const std::string heading = "## " + std::string(detail::this_release.version);
  CHECK((line == heading + " (unreleased)" || line == heading + " (" + date + ")"));
}

TEST_CASE("US-14 a fix becomes an event, with the satellites that its receiver told of") {
  GpsBench bench;
  REQUIRE(bench.accept());
  bench.say(R"({"class":"VERSION","release":"3.22","rev":"3.22","proto_major":3,"proto_minor":14})"
            "\r\n");
  bench.say(std::string(whole_fix) + "\r\n" + std::string(satellites) + "\r\n");
  bench.loop.advance(1s);
  const std::string next = fix_line("/dev/ttyS1", "2017-01-10T00:09:42.000Z", 5);
  for (const char c : next) bench.say({&c, 1});
  REQUIRE(bench.seen.size() == 2);
  CHECK(bench.seen[0].fix.lat == 44.068897833);
  CHECK(!bench.seen[0].fix.satellites_used);
  CHECK(bench.seen[1].fix.satellites_used == 2);
  CHECK(bench.seen[1].fix.satellites_visible == 3);
  CHECK(bench.seen[1].time - bench.seen[0].time == 1s);  // by the program's line, whatever the receiver says
  CHECK(bench.sensor.counts().received == 2);
  CHECK(bench.sensor.counts().published == 2);
  CHECK(bench.sensor.health() == Health::ok);
  CHECK(bench.errors.empty());
  // The same report again is no news; one without a time may well be the same.
  bench.say(next);
  bench.say(
      "{\"class\":\"TPV\",\"device\":\"/dev/ttyS1\",\"mode\":1}\n{\"class\":\"TPV\",\"device\":\"/dev/"
      "ttyS1\",\"mode\":1}\n");
  CHECK(bench.seen.size() == 4);
  CHECK(bench.sensor.counts().repeated == 1);
  CHECK(bench.sensor.counts().balances());
}

TEST_CASE(
    "US-14 gpsd that is absent, killed or restarted is connected to again, with growing waits, and its time away is a "
    "gap") {
  GpsBench bench;
  REQUIRE(bench.accept());
  bench.say(fix_line("/dev/a", "2026-01-01T00:00:00.000Z", 1));
  bench.say(R"({"class":"TPV","device":"/dev/a","mo)");  // and it is killed within a line
  bench.gpsd.vanish();
  bench.loop.poll();
  CHECK(bench.sensor.health() == Health::faulted);
  CHECK(bench.last_error() == "disconnected");
  std::size_t attempts = 0;
  for (int i = 0; i < 300; ++i) {
    bench.loop.advance(100ms);
    bench.loop.poll();
  }
  attempts = bench.errors.size() - 1;
  CHECK(attempts >= 7);  // after 0.1, 0.2, 0.4 ... s, less the jitter
  CHECK(attempts <= 12);
  CHECK(bench.sensor.is_running());
  bench.gpsd.listen();
  REQUIRE(bench.gpsd.listens());
  for (int i = 0; i < 100 && !bench.gpsd.has_peer(); ++i) {
    bench.loop.advance(100ms);
    bench.accept();
  }
  REQUIRE(bench.gpsd.has_peer());
  bench.say(fix_line("/dev/a", "2026-01-01T00:01:00.000Z", 2));
  REQUIRE(bench.seen.size() == 2);  // nothing of the half line
  CHECK(bench.seen[1].fix.lat == 2);
  CHECK(bench.sensor.health() == Health::ok);
  CHECK(bench.sensor.counts().unreadable == 0);
  const Outages outages = bench.sensor.status().outages;
  CHECK(outages.number == 1);
  CHECK(outages.time >= 30s);
  CHECK(outages.time <= 41s);
  CHECK(bench.sensor.counts().balances());
  CHECK(bench.loop.runtime().has_loss());
}

TEST_CASE("US-14 gpsd that dies again and again: all of the time without a report is in gaps") {
  for (const bool has_reports : {false, true}) {
    CAPTURE(has_reports);
    GpsBench bench;
    REQUIRE(bench.accept());
    bench.say(fix_line("/dev/a", "2027-01-01T00:00:00.000Z", 1));
    MonotonicTime since = bench.loop.now();  // the last report before the first death
    for (int round = 1; round <= 5; ++round) {
      bench.say(R"({"class":"VERSION","release":"3.22","rev":"3.22","proto_major":3,"proto_minor":14})"
                "\n");
      bench.loop.advance(2s);
      if (has_reports) bench.say(fix_line("/dev/a", "2027-01-01T00:00:0" + std::to_string(round) + ".000Z", 1));
      if (has_reports && round == 1) since = bench.loop.now();
      bench.say(R"({"class":"TPV","device":"/dev/a","mo)");
      bench.loop.advance(2s);
      bench.gpsd.hang_up();
      bench.loop.poll();
      CHECK(bench.sensor.health() == Health::faulted);
      for (int i = 0; i < 100 && !bench.gpsd.has_peer(); ++i) {
        bench.loop.advance(100ms);
        bench.accept();
      }
      REQUIRE(bench.gpsd.has_peer());
    }
    bench.loop.advance(300ms);
    bench.say(fix_line("/dev/a", "2027-01-01T00:01:00.000Z", 2));
    const Outages outages = bench.sensor.status().outages;
    CHECK(outages.time == bench.loop.now() - since);
    CHECK(outages.number == (has_reports ? 5 : 1));
    CHECK(bench.sensor.counts().balances());
  }
}

TEST_CASE("US-14 garbage and lines without end cost no other line anything") {
  GpsBench bench;
  REQUIRE(bench.accept());
  bench.say("\x16\x03\x01 garbage\n\n\r\n");
  CHECK(bench.sensor.health() == Health::degraded);
  CHECK(bench.last_error() == "bad-data");
  bench.say(fix_line("/dev/a", "2026-01-01T00:00:00.000Z", 1));
  CHECK(bench.sensor.health() == Health::ok);
  // 8 KiB, as of many satellites, are none too many.
  std::string many = R"({"class":"SKY","device":"/dev/a","satellites":[)";
  for (int i = 0; i < 110; ++i) {
    many += (i == 0 ? "" : ",");
    many += R"({"PRN":2,"el":5.0,"az":307.0,"ss":0.0,"used":true,"gnssid":0,"svid":2,"health":1})";
  }
  many += "]}\n";
  REQUIRE(many.size() > 8192);
  bench.say(many);
  bench.say(fix_line("/dev/a", "2026-01-01T00:00:01.000Z", 2));
  REQUIRE(bench.seen.size() == 2);
  CHECK(bench.seen[1].fix.satellites_visible == 110);
  CHECK(bench.sensor.counts().unreadable == 1);
  // A line beyond the bound is one, however long it is.
  for (int i = 0; i < 50; ++i) bench.say(std::string(4000, 'x'));
  CHECK(bench.last_error() == "does-not-fit");
  bench.say("\n" + fix_line("/dev/a", "2026-01-01T00:00:02.000Z", 3));
  REQUIRE(bench.seen.size() == 3);
  CHECK(bench.sensor.counts().received == 5);
  CHECK(bench.sensor.counts().unreadable == 2);
  CHECK(bench.sensor.counts().balances());
}

TEST_CASE("US-14 a receiver that is silent has a gap; gpsd that is silent too is taken for lost") {
  GpsBench bench({.silence = 5s});
  REQUIRE(bench.accept());
  bench.say(R"({"class":"DEVICES","devices":[{"class":"DEVICE","path":"/dev/a"}]})"
            "\n");
  bench.say(fix_line("/dev/a", "2026-01-01T00:00:00.000Z", 1));
  bench.loop.advance(4s);
  CHECK(bench.sensor.health() == Health::ok);
  bench.loop.advance(2s);
  CHECK(bench.sensor.health() == Health::degraded);
  CHECK(bench.last_error() == "timed-out");
  CHECK(bench.gpsd.received() == "?DEVICES;\n");
  CHECK(bench.sensor.status().reason.find("/dev/a") != std::string::npos);
  bench.say(R"({"class":"DEVICES","devices":[]})"
            "\n");  // unplugged, but gpsd is there
  CHECK(bench.last_error() == "not-found");
  bench.loop.advance(4s);
  CHECK(bench.sensor.health() == Health::degraded);
  bench.loop.advance(2s);
  CHECK(bench.gpsd.received() == "?DEVICES;\n");
  bench.say(fix_line("/dev/a", "2026-01-01T00:00:20.000Z", 2));
  CHECK(bench.sensor.health() == Health::ok);
  CHECK(bench.sensor.status().outages.number == 1);
  CHECK(bench.sensor.status().outages.time == 12s);
  // A connection whose other end is gone without a word.
  bench.loop.advance(11s);
  CHECK(bench.sensor.health() == Health::faulted);
  CHECK(bench.errors.back().why == "it does not answer");
  bench.loop.advance(1s);
  CHECK(bench.accept());
  bench.say(fix_line("/dev/a", "2026-01-01T00:00:40.000Z", 3));
  CHECK(bench.seen.size() == 3);
  CHECK(bench.sensor.health() == Health::ok);
  CHECK(bench.sensor.counts().balances());
}

TEST_CASE("US-14 several receivers behind one gpsd are kept apart by device, or it is told that there are several") {
  const auto talk = [](GpsBench& bench) {
    REQUIRE(bench.accept());
    bench.say(R"({"class":"DEVICES","devices":[{"class":"DEVICE","path":"/dev/a"},{"class":"DEVICE","path":"/dev/b"}]})"
              "\n");
    bench.say(R"({"class":"SKY","device":"/dev/a","nSat":5,"uSat":4})"
              "\n");
    bench.say(R"({"class":"SKY","device":"/dev/b","nSat":7,"uSat":6})"
              "\n");
    for (int i = 0; i < 3; ++i) {
      const std::string time = "2026-01-01T00:00:0" + std::to_string(i) + ".000Z";
      bench.say(fix_line("/dev/a", time, 1) + fix_line("/dev/b", time, 2));
    }
  };
  GpsBench one({.device = "/dev/b"});
  talk(one);
  REQUIRE(one.seen.size() == 3);
  for (const Seen& seen : one.seen) {
    CHECK(seen.fix.device == "/dev/b");
    CHECK(seen.fix.lat == 2);
    CHECK(seen.fix.satellites_used == 6);
  }
  CHECK(one.sensor.counts().received == 3);
  CHECK(one.errors.empty());
  CHECK(one.sensor.health() == Health::ok);

  GpsBench both;
  talk(both);
  REQUIRE(both.seen.size() == 6);
  CHECK(both.seen[4].fix.device == "/dev/a");
  CHECK(both.seen[4].fix.satellites_used == 4);
  CHECK(both.seen[5].fix.satellites_used == 6);
  REQUIRE(both.errors.size() == 1);  // once
  CHECK(both.errors[0].text() == "several receivers: 127.0.0.1 port " + std::to_string(both.gpsd.port()) +
                                     ": gpsd has /dev/a, /dev/b: make a sensor for each, with its `device`: now the "
                                     "reports of all of them come mixed");
  CHECK(both.sensor.health() == Health::degraded);

  GpsBench none({.device = "/dev/c"});
  talk(none);
  CHECK(none.seen.empty());
  CHECK(none.sensor.health() == Health::degraded);
  CHECK(none.sensor.status().reason.find("gpsd has /dev/a, /dev/b") != std::string::npos);
}

TEST_CASE("US-14 what gpsd reports as an error is told") {
  GpsBench bench;
  REQUIRE(bench.accept());
  bench.say(R"({"class":"ERROR","message":"Can't activate it"})"
            "\n");
  REQUIRE(bench.errors.size() == 1);
  CHECK(bench.errors[0].why == "Can't activate it");
  CHECK(bench.sensor.health() == Health::degraded);
  CHECK(bench.sensor.counts().received == 0);
}

TEST_CASE("US-14 localhost is found by either of its addresses, and names by looking them up") {
  for (const auto family : {FakeGpsd::Family::ipv4, FakeGpsd::Family::ipv6}) {
    if (!FakeGpsd(family).listens()) {
      MESSAGE("skipped: this machine has no ::1");
      continue;
    }
    GpsBench bench({}, family, "localhost");
    REQUIRE(bench.accept());
    bench.say(fix_line("/dev/a", "2026-01-01T00:00:00.000Z", 1));
    CHECK(bench.seen.size() == 1);
    CHECK(bench.errors.empty());
  }
  GpsBench unknown({.retry_first = 1s}, FakeGpsd::Family::ipv4, "no-such-host.invalid");
  unknown.loop.advance(100ms);
  CHECK(unknown.sensor.health() == Health::faulted);
  CHECK(unknown.last_error() == "not-found");
}

TEST_CASE("US-14 the time of fixes is noted as a source of the time of day, that of old logs is not") {
  for (const bool is_recent : {true, false}) {
    GpsBench bench;
    REQUIRE(bench.accept());
    MonotonicTime last{};
    for (int i = 10; i < 30; ++i) {
      last = bench.loop.now();
      bench.say(R"({"class":"TPV","device":"/dev/a","mode":3,"ept":0.005,"time":")" +
                std::string(is_recent ? "2027" : "2015") + "-03-01T12:00:" + std::to_string(i) + ".000Z\"}\n");
      bench.loop.advance(1s);
    }
    CHECK(bench.seen.size() == 20);
    const auto known = bench.loop.runtime().core().clock_log.pairs();
    const auto gps = std::find_if(known.begin(), known.end(), [](const ClockPair& p) { return p.source == "gps"; });
    REQUIRE((gps != known.end()) == is_recent);
    // Once, with both times.
    const std::vector<std::string> told = is_recent ? bench.log : error_texts(bench);
    CHECK((is_recent ? bench.errors.size() : bench.log.size()) == 0);
    REQUIRE(told.size() == 1);
    CHECK(told[0].find(is_recent ? "the receiver says 2027-03-01T12:00:14" : "the receiver says 2015-03-01T12:00:14") !=
          std::string::npos);
    CHECK(told[0].find("the computer's clock, which nothing synchronises, says 2023-11-14T22:13:2") !=
          std::string::npos);
    if (is_recent) {
      CHECK(gps->monotonic == last);
      CHECK(to_iso8601(gps->realtime) == "2027-03-01T12:00:29.000000000Z");
      CHECK(gps->accuracy == 1005ms);
    }
    // The events' times go on as the loop's.
    for (std::size_t i = 1; i < bench.seen.size(); ++i) CHECK(bench.seen[i].time - bench.seen[i - 1].time == 1s);
  }
}

TEST_CASE(
    "US-14 a receiver whose time steps by more than leap seconds gives no time of day from then on, and is told") {
  for (const auto& [step, told] : {std::pair(3600s, "it stepped by 1 h"), std::pair(25s, "it stepped by 25 s")}) {
    GpsBench bench;
    REQUIRE(bench.accept());
    const Time begin{std::chrono::sys_days{std::chrono::year{2027} / 3 / 1} + 12h};
    int second = 0;
    const auto report = [&](Duration off) {
      for (int i = 0; i < 20; ++i) {
        bench.say(R"({"class":"TPV","device":"/dev/a","mode":3,"ept":0.005,"time":")" +
                  to_iso8601(begin + off + second++ * 1s) + "\"}\n");
        bench.loop.advance(1s);
      }
    };
    report(0s);
    CHECK(bench.errors.empty());
    report(step);
    report(15s);  // back again, nearly
    report(0s);
    CHECK(bench.seen.size() == 80);
    REQUIRE(bench.errors.size() == 1);
    CHECK(bench.last_error() == "bad-data");
    CHECK(bench.errors[0].why == told);
    for (const ClockPair& pair : bench.loop.runtime().core().clock_log.pairs())
      if (pair.source == "gps") CHECK(pair.realtime < begin + 20s);
  }
}

TEST_CASE("US-14 a receiver beyond the accuracy of a clock that is kept right is told once, and not used") {
  for (const Duration off : {Duration{0s}, Duration{2s}, Duration{24h * 1200}}) {
    GpsBench bench;
    REQUIRE(bench.accept());
    bench.loop.manual_clock().set_accuracy(10ms);
    for (int i = 0; i < 20; ++i) {
      bench.say(R"({"class":"TPV","device":"/dev/a","mode":3,"ept":0.005,"time":")" +
                to_iso8601(bench.loop.manual_clock().realtime() + off) + "\"}\n");
      bench.loop.advance(1s);
    }
    const auto known = bench.loop.runtime().core().clock_log.pairs();
    const bool is_used = std::any_of(known.begin(), known.end(), [](const auto& pair) { return pair.source == "gps"; });
    CHECK(is_used == (off == 0s));
    CHECK(bench.errors.size() == (is_used ? 0 : 1));
    CHECK(bench.log.empty());
    if (is_used) continue;
    CHECK(bench.errors[0].what == "the receiver's time of day is not used");
    CHECK(bench.errors[0].why.find("synchronised to 10 ms, says 2023-11-14T22:13:24") != std::string::npos);
    CHECK(bench.errors[0].why.find("the receiver says " + to_iso8601(Time{1'700'000'004s} + off)) == 0);
    CHECK(bench.sensor.health() == Health::ok);
  }
}

TEST_CASE("US-14 every parameter of a GPS sensor can be set from a file") {
  const auto item = parse_config(
                        R"({"host": "::1", "port": 3000, "device": "/dev/a", "silence": "3 s", "report_delay": "300 ms",
                                     "retry_first": "1 s", "retry_longest": "2 s", "required": true, "start": false})")
                        .or_throw();
  GpsConfig config;
  Problems problems;
  REQUIRE(read_config(item, config, problems));
  CHECK(config.host == "::1");
  CHECK(config.port == 3000);
  CHECK(config.device == "/dev/a");
  CHECK(config.silence == 3s);
  CHECK(config.report_delay == 300ms);
  CHECK(config.retry_first == 1s);
  CHECK(config.retry_longest == 2s);
  CHECK(config.required);
  CHECK(!config.start);
  CHECK(GpsConfig{}.host == "localhost");
  CHECK(GpsConfig{}.port == 2947);
  Loop loop{Loop::Manual{}};
  CHECK_THROWS_AS(GpsSensor(loop, {.name = "gps"}, {.host = ""}), SetupError);
  CHECK_THROWS_AS(GpsSensor(loop, {.name = "gps"}, {.port = 0}), SetupError);
  CHECK_THROWS_AS(GpsSensor(loop, {.name = "gps"}, {.retry_first = 0s}), SetupError);
}

TEST_SUITE_END();
