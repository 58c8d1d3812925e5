// `rtdata bench`: that it measures what it says, not how fast this machine is.
#include <doctest/doctest.h>
#include <sys/mount.h>

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
      "NFR-5 bench prints jitter beside that of cyclictest and the disk, and leaves nothing but what was asked for") {
    const Folder folder;
    Process bench(folder, program, {"bench", "--for", "2s", "--json", "figures.json"});
    CHECK(bench.end() == 0);
    for (const char* part :
         {"machine   ", "sampling on a tier, ", "1 kHz   rtdata", "10 kHz  rtdata", "\n1 kHz   cyclictest",
          "\n10 kHz  cyclictest", "\n  a small write is on the disk after p50 "})
      CHECK_MESSAGE(has(bench.out, part), part);
    CHECK(bench.err == "");
    std::size_t files = 0;
    for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder.path())) ++files;
    CHECK(files == 1);

    const auto figures = nlohmann::json::parse(folder.read("figures.json"));
    REQUIRE(figures["sampling"]["rates"].size() == 2);
    const auto ascend = [](const nlohmann::json& times) {
      CHECK(times["p50_ns"] <= times["p99_ns"]);
      CHECK(times["p99_ns"] <= times["p99_9_ns"]);
      CHECK(times["p99_9_ns"] <= times["max_ns"]);
    };
    for (const auto& rate : figures["sampling"]["rates"]) {
      const auto& ticks = rate["rtdata"];
      CHECK(ticks["ticks"] > 0);
      CHECK(ticks["missed"] < ticks["ticks"]);
      ascend(ticks);
      CHECK(ticks["max_ns"] < rate["period_ns"]);  // what is later is missed
      const bool has_cyclictest = !rate["cyclictest"].empty();
      CHECK(has_cyclictest != has(bench.out, "cyclictest: cannot be run here: apt install rt-tests"));
      if (has_cyclictest) ascend(rate["cyclictest"]);
    }
    ascend(figures["disk"]);
    CHECK(figures["disk"]["p50_ns"] > 0);
  }

  TEST_CASE("NFR-5 bench says that nothing can be written onto a full disk, and leaves nothing behind") {
    const Folder folder;
    if (::mount("tmpfs", folder.path().c_str(), "tmpfs", 0, "size=300k") != 0) {
      MESSAGE("skipped: mounting a small file system needs root");
      return;
    }
    struct Unmount {
      const Folder& folder;
      ~Unmount() { ::umount2(folder.path().c_str(), MNT_DETACH); }
    } const unmount{folder};
    Process bench(folder, program, {"bench", "--for", "1s", "--json", "figures.json"});
    CHECK(bench.end() == 0);
    CHECK(has(bench.out,
              "disk of " + folder.path() + "\n  nothing can be written: " + folder.path() + ": No space left"));
    const auto figures = nlohmann::json::parse(folder.read("figures.json"));
    CHECK(figures["disk"].contains("error"));
    CHECK_FALSE(figures["disk"].contains("max_ns"));
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
      if (arguments[1] == "--cpu") CHECK(has(wrong.err, "this program may not use this processor; available: "));
    }
  }
}
