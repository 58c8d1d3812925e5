// What `rtdata run` says of a recording at its end is what `verify` says of it, of all examples that record here.
#include <doctest/doctest.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "app/process.hpp"
#include "app/runtime_folder.hpp"
#include "has.hpp"
#include "paths.hpp"

using rtdata::test::Folder;
using rtdata::test::has;
using rtdata::test::Process;
using rtdata::test::RuntimeFolder;

namespace {

/// The lines after this one that lie two columns or more to the right, up to what verify says besides.
std::string block_after(const std::string& text, const std::string& heading) {
  std::size_t at = text.find(heading);
  if (at == std::string::npos) return "no \"" + heading + "\" in: " + text;
  std::string block;
  for (at = text.find('\n', at + 1) + 1; text.compare(at, 2, "  ") == 0;) {
    const std::size_t end = text.find('\n', at) + 1;
    const std::string line = text.substr(at, end - at);
    if (has(line, " offered = ") || has(line, " rows of ")) break;
    block += line;
    at = end;
  }
  return block;
}

std::size_t compared(const std::string& file) {
  CAPTURE(file);
  const RuntimeFolder runtime;
  const Folder folder;
  const std::string program = rtdata::test::built("rtdata");
  std::size_t recordings = 0;
  for (int number = 1; number <= 2; ++number) {
    CAPTURE(number);
    Process run(folder, program, {"run", file, "--for", number == 1 ? "1s" : "300ms"});
    if (run.end() == 2) return 0;  // it needs another program, or a server
    for (const auto& entry : std::filesystem::directory_iterator(folder.path())) {
      const std::string name = entry.path().filename();
      if (entry.path().extension() != ".db") continue;
      ++recordings;
      const std::string of_run = ", run " + std::to_string(number) + "\n";
      Process verify(folder, program, {"verify", name, "--run", std::to_string(number)});
      CHECK(verify.end() == 0);
      const std::string said = block_after(run.out + run.err, name + of_run);  // a console has standard output
      CHECK(said == block_after(verify.out, "\nrun " + std::to_string(number) + " "));
      CHECK_MESSAGE((has(said, "  LOST: ") || has(said, "  nothing lost")), said);
      CHECK(has(folder.read(std::filesystem::path(file).stem().string() + ".log"), name + ", run "));
      Process all(folder, program, {"verify", name});
      CHECK(all.end() == 0);
      CHECK(said == block_after(all.out, "\nrun " + std::to_string(number) + " "));
      if (number == 2) CHECK(all.out.find("\nrun 1 ") < all.out.find("\nrun 2 "));
    }
  }
  return recordings;
}

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("US-26 what run says of a recording at its end is what verify says of it, of all examples") {
    std::size_t recordings = 0;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(rtdata::test::in_source("examples"))) {
      if (entry.path().extension() == ".json") recordings += compared(entry.path());
    }
    CHECK(recordings >= 8);
  }

  TEST_CASE("US-26 what no recording holds is named at the end of run, and verify has each run by itself") {
    const RuntimeFolder runtime;
    const Folder folder;
    const std::string program = rtdata::test::built("rtdata_test_program");
    folder.write("rig.json", R"({
      "sensors": [ {"name": "a", "type": "tallied", "rate": "100 Hz", "fail_every": 3},
                   {"name": "b", "type": "tallied", "rate": "100 Hz", "fail_every": 5} ],
      "sinks": [ {"type": "sqlite", "path": "run.db", "topics": ["a"]}, {"type": "discard"} ] })");
    Process run(folder, program, {"run", "rig.json", "--for", "500ms"});
    CHECK(run.end() == 0);
    CHECK(has(block_after(run.out, "run.db, run 1\n"), "  LOST: "));
    CHECK(has(block_after(run.out, "run.db, run 1\n"), " ticks of a ("));
    CHECK_FALSE(has(block_after(run.out, "run.db, run 1\n"), " ticks of b ("));
    CHECK(has(block_after(run.out, "\nin no recording\n"), " ticks of b ("));
    CHECK_FALSE(has(block_after(run.out, "\nin no recording\n"), " ticks of a ("));

    folder.write("rig.json", R"({
      "sensors": [ {"name": "a", "type": "tallied", "rate": "10 Hz"} ],
      "sinks": [ {"type": "sqlite", "path": "run.db", "topics": ["a"]} ] })");
    Process good(folder, program, {"run", "rig.json", "--for", "500ms"});
    CHECK(good.end() == 0);
    CHECK_FALSE(has(good.out, "in no recording"));
    Process info(folder, program, {"info", "run.db", "--json"});
    CHECK(info.end() == 0);
    const auto topic = nlohmann::json::parse(info.out)["topics"][0];
    CHECK(topic["published"] == topic["rows"]);
    CHECK(has(good.out, "nothing lost: " + topic["published"].dump() + " events"));
    Process verify(folder, program, {"verify", "run.db"});
    CHECK(verify.end() == 0);
    CHECK(has(block_after(verify.out, "\nrun 1 "), "  LOST: "));  // and this is no loss of the other
    CHECK(has(block_after(verify.out, "\nrun 2 "), "  nothing lost: "));
    CHECK(has(verify.out, "\nrun 2: balanced: "));
    Process one(folder, program, {"verify", "run.db", "--run", "2"});
    CHECK(one.end() == 0);
    CHECK_FALSE(has(one.out, "LOST"));
    Process none(folder, program, {"verify", "run.db", "--run", "3"});
    CHECK(none.end() == 1);
    CHECK(has(none.err, "there is no run 3"));
  }
}
