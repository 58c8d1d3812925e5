// Estimates of how files grow, and the starter file.
#include "app/run/growth.hpp"

#include <doctest/doctest.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include <filesystem>

#include "app/process.hpp"
#include "app/run/data_at_risk.hpp"
#include "app/run/starter.hpp"
#include "rtdata/app/program.hpp"

using namespace rtdata;
using namespace rtdata::app;
using namespace std::chrono_literals;
using rtdata::test::Folder;

namespace {

/// Paths of sinks are looked at: they lie in a folder that can be written, which the one of the sources need not be.
struct InFolder {
  InFolder() { std::filesystem::current_path(folder.path()); }
  InFolder(const InFolder&) = delete;
  ~InFolder() { std::filesystem::current_path(before); }
  const std::filesystem::path before = std::filesystem::current_path();
  const Folder folder;
};

SystemPlan planned(const std::string& rate, const std::string& sinks) {
  return plan_system(standard_registry(),
                     parse_config(R"({"sensors": [{"name": "m", "type": "host", "quantity": "memory",
    "rate": ")" + rate + R"(", "topic": "host/memory"},
    {"name": "board", "type": "serial", "device": "/dev/null", "fields": [{"name": "x"}]}],
    "sinks": [)" + sinks + "]}"));
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("growth of files is estimated from rates and fields, 9 bytes each") {
    const InFolder here;
    const SystemPlan plan = planned("1 kHz", R"({"type": "sqlite", "path": "a.db"}, {"type": "file", "path": "a.jsonl"},
      {"type": "file", "path": "a.csv", "format": "csv", "topics": ["host/+"]}, {"type": "console"},
      {"type": "file", "path": "none.jsonl", "topics": ["board"]})");
    REQUIRE(plan.good());
    const std::vector<Growth> growths = growth_of(plan);
    REQUIRE(growths.size() == 3);  // neither the console, nor what has no rate
    // What 18681 such events took in a recording when it was measured.
    const double of_one = growths[0].bytes_per_day / 86400 / 1000, measured = 1191936;
    CHECK(of_one > measured / 18681 / 2);
    CHECK(of_one < measured / 18681 * 2);
    for (const Growth& growth : growths) {
      CHECK(growth.bytes_per_day == growths[0].bytes_per_day);
      CHECK_FALSE(growth.is_limited);
    }
    CHECK(growths[1].text() == "a.jsonl: about 5.4 GB a day, without limit");
  }

  TEST_CASE("what a chip takes by itself counts for the growth of files, and what it cannot keep is a warning") {
    const InFolder here;
    const auto with = [](const std::string& sensor) {
      SystemPlan plan = plan_system(standard_registry(),
                                    parse_config(R"({"buses": {"i": {"type": "i2c", "device": "/dev/i2c-1"}},
        "sensors": [{"name": "x", "bus": "i", )" +
                                                 sensor + R"(}], "sinks": [{"type": "sqlite", "path": "a.db"}]})"));
      REQUIRE_MESSAGE(plan.good(), plan.report());
      return plan;
    };
    const auto warned = [](SystemPlan plan) {
      warn_of_losses(plan);
      return plan.warnings.empty() ? std::string()
                                   : plan.warnings[0].id + " " + plan.warnings[0].path + " " + plan.warnings[0].message;
    };
    const SystemPlan slow = with(R"("type": "accelerometer", "sample_rate": 100, "rate": "10 Hz")");
    const SystemPlan fast = with(R"("type": "accelerometer", "sample_rate": 800, "rate": "50 Hz")");
    CHECK(growth_of(fast)[0].bytes_per_day == doctest::Approx(8 * growth_of(slow)[0].bytes_per_day));
    CHECK(warned(slow) == "");
    CHECK(warned(fast) == "");  // 16 of 33
    CHECK(warned(with(R"("type": "accelerometer", "sample_rate": 800, "rate": "10 Hz")")) ==
          "loses-data sensors[0].rate the chip takes 80 samples between two reads and keeps 33: the others are lost; "
          "give it a `rate` of 48.5 Hz or more, or a lower `sample_rate`");
    CHECK(warned(with(R"("type": "imu", "model": "mpu6050", "sample_rate": 1000, "rate": "5 Hz")"))
              .starts_with("loses-data"));
    CHECK(warned(with(R"("type": "imu", "model": "mpu6050", "sample_rate": 1000, "rate": "50 Hz")")) == "");
    CHECK(warned(with(R"("type": "sht", "rate": "100 Hz")")) ==
          "loses-data sensors[0].rate a reading takes 16 ms or more, and its period is 10 ms: ticks are missed; lower "
          "its `rate`");
    CHECK(warned(with(R"("type": "sht", "rate": "10 Hz")")) == "");
    CHECK(warned(with(R"("type": "barometer", "model": "bme280", "rate": "1 Hz")")) == "");
    CHECK(warned(with(R"("type": "ads1x15", "model": "ads1115", "data_rate": 128, "rate": "50 Hz")")) != "");
  }

  TEST_CASE("a recording that is closed at once loses what came last, which is a warning") {
    const InFolder here;
    const auto warned = [](const std::string& sink) {
      SystemPlan plan = plan_system(standard_registry(), parse_config(R"({"sensors": [
        {"name": "m", "type": "host", "quantity": "memory", "rate": "1 Hz"}], "sinks": [)" +
                                                                      sink + "]}"));
      REQUIRE_MESSAGE(plan.good(), plan.report());
      warn_of_losses(plan);
      return plan.warnings.empty() ? std::string() : plan.warnings[0].path + " " + plan.warnings[0].message;
    };
    CHECK(warned(R"({"type": "sqlite", "path": "a.db", "batch_time": "2 s", "close_deadline": "0 s"})") ==
          "sinks[0].close_deadline the end of the run does not wait until the last events are stored: those that came "
          "within its `batch_time`, 2 s, are lost; give it some seconds, or remove `close_deadline`");
    CHECK(warned(R"({"type": "sqlite", "path": "a.db", "close_deadline": "1 ms"})") == "");
    CHECK(warned(R"({"type": "sqlite", "path": "a.db"})") == "");
  }

  TEST_CASE("a sensor without a schedule and without silence is noted, since nobody notices when it goes quiet") {
    const InFolder here;
    const Registry registry = standard_registry();
    const auto noted = [&](const std::string& silence) {
      return unnoticed_silence(registry, plan_system(registry, parse_config(R"({"sensors": [
        {"name": "m", "type": "host", "quantity": "memory", "rate": "1 Hz"},
        {"name": "board", "type": "serial", "device": "/dev/null", "fields": [{"name": "x"}])" +
                                                                            silence + "}]}")));
    };
    const std::string
        note = "without `silence`, such as \"10 s\", no report is made when this device goes quiet: board";
    CHECK(noted("") == note);
    CHECK(noted(R"(, "silence": "0 s")") == note);
    CHECK(noted(R"(, "silence": "3 s")") == "");
  }

  TEST_CASE("a sink without limit that fills the disk is a warning, one with a limit is none") {
    const InFolder here;
    const auto disk = [](const std::string&) { return Disk{1, 30'000'000'000}; };
    const std::string unlimited = R"({"type": "sqlite", "path": "a.db"}, {"type": "file", "path": "a.jsonl"})";
    SystemPlan fast = planned("1 kHz", unlimited);
    warn_of_growth(fast, growth_span, disk);
    REQUIRE(fast.warnings.size() == 2);
    CHECK(fast.warnings[0].id == "fills-disk");
    CHECK(fast.warnings[0].path == "sinks[0].path");
    CHECK(fast.warnings[0].message ==
          "this file grows by about 5.4 GB a day, without limit, and the disk, with 30 GB free, is full after 3 days; "
          "lower the "
          "rates, or set `max_bytes` or `max_age`");
    CHECK(fast.warnings[1].message.ends_with("or set `rotate` and `keep`"));
    // Not in a run that ends before, nor when it lasts long enough, nor where the disk is not known.
    SystemPlan brief = planned("1 kHz", unlimited);
    warn_of_growth(brief, 10min, disk);
    CHECK(brief.warnings.empty());
    SystemPlan slow = planned("1 Hz", unlimited);
    warn_of_growth(slow, growth_span, disk);
    CHECK(slow.warnings.empty());
    SystemPlan unknown = planned("1 kHz", unlimited);
    warn_of_growth(unknown, growth_span, [](const std::string&) { return std::optional<Disk>{}; });
    CHECK(unknown.warnings.empty());
    SystemPlan limited = planned("1 kHz", R"({"type": "sqlite", "path": "a.db", "max_bytes": 1e9},
      {"type": "sqlite", "path": "b.db", "max_age": "2 d"},
      {"type": "file", "path": "a.jsonl", "rotate": {"bytes": 1000000}, "keep": 3})");
    REQUIRE(limited.good());
    warn_of_growth(limited, growth_span, disk);
    CHECK(limited.warnings.empty());
    // Files that are kept all, or ages without an end, are no limit.
    SystemPlan kept = planned("1 kHz", R"({"type": "sqlite", "path": "a.db", "max_bytes": 0, "max_age": "0 s"},
      {"type": "file", "path": "a.jsonl", "rotate": {"bytes": 1000000}})");
    warn_of_growth(kept, growth_span, disk);
    CHECK(kept.warnings.size() == 2);
  }

  TEST_CASE("NFR-5 the starter file may run for months: gentle rates, and limits") {
    const InFolder here;
    const Registry registry = standard_registry();
    SystemPlan plan = plan_system(registry, parse_config(starter_file(registry, "first.json")));
    REQUIRE(plan.good());
    double per_day = 0;
    for (const Growth& growth : growth_of(plan)) {
      CHECK(growth.is_limited);
      per_day += growth.bytes_per_day;
    }
    CHECK(per_day > 0);
    CHECK(per_day < 1e9);
    for (const PartPlan* sensor : plan.of_kind("sensor")) CHECK(sensor->publishes->load->period >= 100ms);
  }

  TEST_CASE("NFR-5 the starter file spares SD cards") {
    const InFolder here;
    const Folder folder;
    struct stat status {};
    REQUIRE(::stat(folder.path().c_str(), &status) == 0);
    const std::string devices = folder.path() + "/sys/dev/block/";
    std::filesystem::create_directories(devices);
    const std::string link = devices + std::to_string(major(status.st_dev)) + ":" +
                             std::to_string(minor(status.st_dev));
    const Registry registry = standard_registry();
    const std::string file = folder.path() + "/first.json";
    CHECK_FALSE(is_on_card(folder.path(), folder.path()));
    REQUIRE(::symlink("../../devices/pci0000:00/nvme0n1/nvme0n1p2", link.c_str()) == 0);
    CHECK_FALSE(is_on_card(folder.path(), folder.path()));
    CHECK(starter_file(registry, file, folder.path()).find("\"card\"") == std::string::npos);
    REQUIRE(::unlink(link.c_str()) == 0);
    REQUIRE(::symlink("../../devices/platform/soc/mmc0/block/mmcblk0/mmcblk0p2", link.c_str()) == 0);
    CHECK(is_on_card(folder.path(), folder.path()));
    const std::string text = starter_file(registry, file, folder.path());
    CHECK(text.find("\"profile\": \"card\"") != std::string::npos);
    CHECK(plan_system(registry, parse_config(text)).good());
  }
}
