// The GPS sensor beside gpspipe, both at a real gpsd that gpsfake feeds with logs of real receivers.
#include <doctest/doctest.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/wait.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>

#include "listening.hpp"
#include "paths.hpp"
#include "rtdata/loop/timer.hpp"
#include "rtdata/sensors/gps.hpp"
#include "sensors/fake_gpsd.hpp"
#include "sensors/fixture.hpp"

using namespace rtdata;
using namespace rtdata::literals;

TEST_SUITE_BEGIN("sensors");

namespace {

/// A program in a process group of its own, which ends with this object.
class Program {
 public:
  Program(std::vector<std::string> words, const std::string& output) {
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    id_ = ::fork();
    if (id_ != 0) return;
    ::setpgid(0, 0);
    const int to = ::open(output.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    const int none = ::open("/dev/null", O_RDWR);
    ::dup2(none, 0);
    ::dup2(to, 1);
    ::dup2(none, 2);
    ::execvp(arguments[0], arguments.data());
    ::_exit(127);
  }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;
  ~Program() {
    ::kill(-id_, SIGKILL);
    ::waitpid(id_, nullptr, 0);
  }

 private:
  pid_t id_ = -1;
};

bool is_installed(const std::string& program) {
  return std::system(("command -v " + program + " >/dev/null 2>&1 || test -x /usr/sbin/" + program).c_str()) == 0;
}

using Tpv = nlohmann::json;

/// What differs, or is on one side only; empty: nothing.
std::string difference(const GpsFix& fix, const Tpv& tpv) {
  std::string all;
  const auto compare = [&](const char* key, const std::optional<double>& ours) {
    const std::optional<double> theirs = tpv.contains(key) ? std::optional(tpv[key].get<double>()) : std::nullopt;
    if (ours != theirs) all += std::string(key) + " ";
  };
  compare("lat", fix.lat);
  compare("lon", fix.lon);
  compare("altHAE", fix.alt_hae);
  compare("altMSL", fix.alt_msl);
  compare("speed", fix.speed);
  compare("track", fix.track);
  compare("climb", fix.climb);
  compare("velN", fix.vel_n);
  compare("velE", fix.vel_e);
  compare("velD", fix.vel_d);
  compare("eph", fix.eph);
  compare("epx", fix.epx);
  compare("epy", fix.epy);
  compare("epv", fix.epv);
  compare("sep", fix.sep);
  compare("ept", fix.ept);
  compare("eps", fix.eps);
  compare("epd", fix.epd);
  compare("epc", fix.epc);
  compare("geoidSep", fix.geoid_sep);
  compare("magvar", fix.mag_var);
  if (fix.mode != tpv.value("mode", 0)) all += "mode ";
  if (fix.device.view() != tpv.value("device", "")) all += "device ";
  std::optional<std::int64_t> time;
  if (tpv.contains("time")) time = to_nanoseconds(parse_iso8601(tpv["time"].get<std::string>()).or_throw());
  if (fix.gps_time != time) all += "time ";
  return all;
}

std::size_t count_reports(const std::string& path) {
  std::ifstream file(path);
  std::size_t count = 0;
  for (std::string line; std::getline(file, line);) count += line.find("\"TPV\"") != std::string::npos ? 1 : 0;
  return count;
}

struct Comparison {
  bool is_whole = false;  // from the first of theirs on all are equal, until one side ends
  std::size_t equal = 0;
  std::string differs;
};

/// The beginning of theirs is somewhere in ours; from there on each is the other's.
Comparison compare(const std::vector<GpsFix>& ours, const std::vector<Tpv>& theirs) {
  Comparison best;
  for (std::size_t at = 0; at < ours.size() && !best.is_whole; ++at) {
    Comparison here;
    while (at + here.equal < ours.size() && here.equal < theirs.size()) {
      here.differs = difference(ours[at + here.equal], theirs[here.equal]);
      if (!here.differs.empty()) break;
      ++here.equal;
    }
    here.is_whole = here.differs.empty();
    if (here.is_whole || here.equal >= best.equal) best = here;
  }
  return best;
}

void compare_with_gpspipe(const std::vector<std::string>& names, std::size_t most) {
  const std::string folder = test::in_source("../shared/data/gps");
  if (!std::filesystem::exists(folder)) {
    MESSAGE("skipped: there are no logs in ../shared/data/gps");
    return;
  }
  for (const char* program : {"gpsd", "gpsfake", "gpspipe"}) {
    if (is_installed(program)) continue;
    MESSAGE("skipped: there is no " << program << " (script/bootstrap --all)");
    return;
  }
  ScratchDirectory scratch;
  std::uint16_t port = 0;
  std::optional<Program> gpsfake;
  const auto feed = [&] {
    std::vector<std::string> feeder{"gpsfake", "-q", "-n", "-c", "0.005", "-P", std::to_string(port)};
    for (const std::string& name : names) feeder.push_back(folder + "/" + name + ".log");
    gpsfake.emplace(feeder, scratch.file("gpsfake.out"));  // ends the one before it
  };
  for (int i = 0; i < 3 && !(gpsfake && test::comes_to_listen(port)); ++i) {  // somebody may take the port before it
    port = FakeGpsd().port();
    feed();
  }
  Loop loop;
  be_quiet(loop);
  loop.on_error([](const ErrorReport&) {});
  std::vector<GpsFix> seen;
  std::unique_ptr<Program> gpspipe;
  const std::string piped = scratch.file("gpspipe.out");
  const auto heard = loop.subscribe<GpsFix>("gps", [&](const Event<GpsFix>& fix) {
    if (gpspipe == nullptr) {
      // The server is there. What comes from now on is compared.
      gpspipe = std::make_unique<Program>(
          std::vector<std::string>{"stdbuf", "-oL", "gpspipe", "-w", "127.0.0.1:" + std::to_string(port)}, piped);
    }
    seen.push_back(*fix);
    // However long gpspipe took to begin, half of them are to be compared.
    if (seen.size() >= most && count_reports(piped) > most / 2) loop.stop();
  });
  Timer limit(loop, 2min, [&] { loop.stop(); });
  GpsSensor sensor(loop, {.name = "gps"}, {.host = "127.0.0.1", .port = port, .retry_longest = 200ms});
  // gpsfake leaves its receivers out, and says nothing, when it comes between the two calls with which gpsd opens the
  // socket for them: then it begins anew.
  Ticker again(loop, {.period = 30s, .phase = 30s}, [&](const Tick&) {
    if (seen.empty()) feed();
  });
  loop.run();
  CAPTURE(names[0]);
  REQUIRE(seen.size() >= most);
  CHECK(sensor.counts().unreadable == 0);
  CHECK(sensor.counts().balances());
  // Of each receiver, since nobody knows whether the first that gpspipe heard of one repeats what was before: that is
  // no event.
  std::map<std::string, std::vector<Tpv>> theirs;
  std::ifstream file(piped);
  std::map<std::string, std::string> last;
  for (std::string line; std::getline(file, line);) {
    const Tpv one = Tpv::parse(line, nullptr, false);
    if (one.is_discarded() || one.value("class", "") != "TPV") continue;
    const std::string device = one.value("device", "");
    std::string& before = last[device];
    if (!before.empty() && (line != before || !one.contains("time"))) theirs[device].push_back(one);
    before = line;
  }
  std::size_t compared = 0;
  for (const auto& [device, reports] : theirs) {
    std::vector<GpsFix> ours;
    for (const GpsFix& fix : seen)
      if (fix.device.view() == device) ours.push_back(fix);
    const Comparison result = compare(ours, reports);
    CAPTURE(result.differs);
    CHECK(result.is_whole);
    compared += result.equal;
  }
  CHECK(compared > most / 4);
}

}  // namespace

TEST_CASE("US-14 real gpsd: every report of a receiver equals what gpspipe says, field by field") {
  compare_with_gpspipe({"ublox-8"}, 40);
  compare_with_gpspipe({"bu303-moving"}, 30);
}
TEST_CASE("US-14 real gpsd: a receiver without a fix") { compare_with_gpspipe({"bu303-nofix"}, 20); }
TEST_CASE("US-14 real gpsd: a binary protocol, and two receivers at once") {
  compare_with_gpspipe({"neo-m8n"}, 20);
  compare_with_gpspipe({"ublox-8", "hab-gpspi"}, 20);
}

TEST_SUITE_END();
