// `rtdata bench`: that it measures what it says, not how fast this machine is.
#include <doctest/doctest.h>
#include <sys/mount.h>

#include <memory>
#include <nlohmann/json.hpp>

#include "app/process.hpp"
#include "has.hpp"
#include "paths.hpp"

using rtdata::test::Folder;
using rtdata::test::Process;

namespace {

using rtdata::test::program;

using rtdata::test::has;

}  // namespace

TEST_SUITE("app") {
  TEST_CASE(
      "NFR-5 bench prints figures beside their limits with a verdict, and leaves nothing but what was asked for") {
    const Folder folder;
    Process bench(folder, program, {"bench", "--for", "2s", "--json", "figures.json"});
    CHECK(bench.end() == 0);
    for (const char* part :
         {"noise     other programs used ", "sampling on a tier, ", "1 kHz   rtdata", "10 kHz  rtdata", "        limit",
          "events through a topic", "\nverdict\n  1 kHz: ", "\n  10 kHz: "})
      CHECK_MESSAGE(has(bench.out, part), part);
    CHECK(bench.err == "");
    std::size_t files = 0;
    for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder.path())) ++files;
    CHECK(files == 1);

    const auto figures = nlohmann::json::parse(folder.read("figures.json"));
    REQUIRE(figures["sampling"]["rates"].size() == 2);
    for (const auto& rate : figures["sampling"]["rates"]) {
      for (const char* who : {"rtdata", "limit"}) {
        const auto& ticks = rate[who];
        CHECK(ticks["ticks"] > 0);
        CHECK(ticks["missed"] < ticks["ticks"]);
        CHECK(ticks["p50_ns"] <= ticks["p99_ns"]);
        CHECK(ticks["p99_ns"] <= ticks["p99_9_ns"]);
        CHECK(ticks["p99_9_ns"] <= ticks["max_ns"]);
        CHECK(ticks["max_ns"] < rate["period_ns"]);  // what is later is missed
      }
    }
    CHECK(figures["events"]["rtdata_per_s"] > 0);
    CHECK(figures["verdict"].size() == 2 + figures["storage"].size());
    CHECK(figures["machine"]["others_percent"] >= 0);
    for (const auto& storage : figures["storage"]) {
      CHECK(storage["rtdata"]["rows_per_s"] > 0);
      CHECK(storage["rtdata"]["commits"] > 0);
      CHECK(storage["rtdata"]["dropped"] == 0);
      CHECK(storage["limit"]["rows_per_s"] > 0);
    }
  }

  TEST_CASE("NFR-5 bench says that nothing could be recorded into a full disk, and leaves nothing behind") {
    const Folder folder;
    if (::mount("tmpfs", folder.path().c_str(), "tmpfs", 0, "size=300k") != 0) {
      MESSAGE("skipped: mounting a small file system needs root");
      return;
    }
    struct Unmount {
      const Folder& folder;
      ~Unmount() { ::umount2(folder.path().c_str(), MNT_DETACH); }
    } const unmount{folder};
    // Of its own, so that other programs keep nothing there.
    const Folder runtime;
    struct RuntimeDirectory {
      explicit RuntimeDirectory(const std::string& path) { ::setenv("RUNTIME_DIRECTORY", path.c_str(), 1); }
      ~RuntimeDirectory() { ::unsetenv("RUNTIME_DIRECTORY"); }
    };
    const auto runtime_directory = std::make_unique<RuntimeDirectory>(runtime.path());
    const auto live_files = [&] {
      std::size_t count = 0;
      for (const auto& entry : std::filesystem::recursive_directory_iterator(runtime.path()))
        count += entry.path().extension() == ".live" ? 1 : 0;
      return count;
    };
    Process bench(folder, program, {"bench", "--for", "1s", "--json", "figures.json"});
    CHECK(bench.end() == 0);
    CHECK(has(bench.out, "    rtdata: cannot use the recording: "));
    CHECK(has(bench.out, "disk is full: make room"));
    CHECK(has(bench.out, "recording into " + folder.path() + ": failed, see above\n"));
    CHECK(live_files() == 0);
    const auto figures = nlohmann::json::parse(folder.read("figures.json"));
    CHECK(figures["storage"][0]["rtdata"]["dropped"] > 0);
    CHECK_FALSE(figures["storage"][0]["rtdata"].contains("rows_per_s"));
  }

  TEST_CASE("NFR-5 bench says what is wrong with its options") {
    const Folder folder;
    for (const auto& arguments : std::vector<std::vector<std::string>>{{"bench", "--for", "0s"},
                                                                       {"bench", "--for", "soon"},
                                                                       {"bench", "--cpu", "-1"},
                                                                       {"bench", "--cpu", "1023"},
                                                                       {"bench", "--json", "/nonexistent/x.json"}}) {
      Process wrong(folder, program, arguments);
      CHECK(wrong.end() == 1);
      CHECK(has(wrong.err, arguments[2]));
      if (arguments[1] == "--cpu") CHECK(has(wrong.err, "this program may use no such processor: there are "));
    }
  }
}
