// What a recording may be instead of a good one: each command that reads it says so, with the same status. And what
// files and texts from outside may be long: it is refused before memory is asked for.
#include <doctest/doctest.h>
#include <sys/stat.h>

#include <array>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>

#include "app/core/recording_commands.hpp"
#include "app/process.hpp"
#include "has.hpp"
#include "paths.hpp"
#include "recording/database.hpp"
#include "rtdata/data/text.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sensors/sensor.hpp"
#include "sanitized.hpp"
#include "sensors/fake_gpsd.hpp"

using namespace rtdata;
using namespace rtdata::literals;
using namespace std::chrono_literals;
using rtdata::test::Folder;
using rtdata::test::has;
using rtdata::test::Process;
using rtdata::test::program;

namespace {

using Words = std::vector<std::string>;

struct Measured {
  double value = 0;
  std::array<float, 3> parts{};
  text<32> remark;
  RTDATA_FIELDS(Measured, (value), (parts), (remark))
};

/// Two runs, the second with a gap.
std::string record(const Folder& folder, const std::string& name) {
  const std::string path = folder.path() + "/" + name;
  for (const bool has_gap : {false, true}) {
    Loop loop{Loop::Manual{}};
    loop.runtime().on_log([](const LogRecord&) {});
    SqliteSink sink(loop, {.path = path});
    int count = 0;
    Sensor<Measured> room(loop, {.name = "room", .rate = 100_Hz}, [&]() -> Result<Measured> {
      if (has_gap && ++count % 50 == 0) return Error{Errc::bad_data, "cannot read", "room", "a gap", ""};
      Measured now{0.1 * count, {1, 2, 3}, {}};
      (void)now.remark.assign(count % 2 == 0 ? "even" : "odd");
      return now;
    });
    loop.advance(2s);
    room.close();
    CHECK(loop.close() == 0);
  }
  return path;
}

void scribble(const std::string& path, std::uintmax_t at, const std::string& text) {
  std::fstream file(path, std::ios::binary | std::ios::in | std::ios::out);
  file.seekp(static_cast<std::streamoff>(at));
  file << text;
}

/// The program with these words, in 2 GiB of addresses: a length that is believed ends it.
class Bounded {
 public:
  Bounded(const Folder& folder, const Words& words) : process_(folder, "/bin/sh", command(words)) {
    status = process_.end();
    said = process_.out + process_.err;
  }
  int status = -1;
  std::string said;

 private:
  static Words command(const Words& words) {
    // A sanitizer takes all addresses there are.
    Words all{"-c", std::string(rtdata::test::sanitized ? "" : "ulimit -v 2097152; ") + "exec \"$0\" \"$@\"", program};
    all.insert(all.end(), words.begin(), words.end());
    return all;
  }
  Process process_;
};

void sparse(const Folder& folder, const std::string& name, std::uintmax_t size = 1u << 30) {
  if (!folder.has(name)) folder.write(name, "");
  std::filesystem::resize_file(folder.path() + "/" + name, size);
}

/// Each command that reads a recording, of the one of this name.
std::vector<Words> readers(const std::string& name) {
  return {{"verify", name},
          {"verify", name, "--json"},
          {"info", name},
          {"info", name, "--json", "--gaps"},
          {"export", name, "--topic", "room"},
          {"export", name, "--format", "jsonl"},
          {"export", name, "--folder", "out", "--overwrite"},
          {"export", name, "--step", "1500ms"},  // of rows: those of seconds are recorded
          {"replay", name, "--speed", "max"},
          {"replay", name, "discard.json", "--speed", "max"},
          {"forward", name, "node.json"}};
}

void write_configurations(const Folder& folder) {
  folder.write("discard.json", R"({"sinks": [{"type": "file", "path": "replayed.jsonl"}]})");
  folder.write("node.json", R"({"sinks": [{"type": "sqlite", "name": "db", "path": "node.db"},
    {"type": "tcp", "name": "far", "host": "127.0.0.1", "port": 1, "through": "db"}]})");
}

}  // namespace

TEST_SUITE_BEGIN("app");

TEST_CASE("a device that does not answer at the end of a run costs seconds, and the recording is closed") {
  const Folder folder;
  const FakeGpsd silent;
  folder.write("hang.json", R"({"buses": {"b": {"type": "serial", "host": "127.0.0.1", "port": )" +
                                std::to_string(silent.port()) + R"(, "answer_timeout": "30 s", "timeout": "90 s"}},
    "sensors": [{"name": "meter", "type": "query", "bus": "b", "rate": "10 Hz", "request": "?", "fields": [{"name": "v"}]},
                {"name": "load", "type": "host", "quantity": "load", "rate": "10 Hz"}],
    "sinks": [{"type": "sqlite", "path": "hang.db"}]})");
  Process run(folder, program, {"run", "hang.json", "--for", "1s"});
  CHECK(run.end() == 0);
  CHECK_MESSAGE(!has(run.out + run.err, "not closed"), run.out, run.err);
  Process verify(folder, program, {"verify", "hang.db"});
  verify.end();
  CHECK_MESSAGE(!has(verify.out + verify.err, "sealed"), verify.out, verify.err);
}

TEST_CASE("US-26 a recording that cannot be read: each command says why, with status 2") {
  const Folder folder;
  write_configurations(folder);
  const std::string good = record(folder, "good.db");
  const auto size = std::filesystem::file_size(good);
  const auto copy = [&](const std::string& name) {
    const std::string path = folder.path() + "/" + name;
    std::filesystem::copy_file(good, path);
    return path;
  };
  std::filesystem::create_directory(folder.path() + "/folder.db");
  folder.write("empty.db", "");
  folder.write("text.db", "no recording, though it is long enough to be one: " + std::string(8192, 'x'));
  sqlite::Database::open(folder.path() + "/other.db", sqlite::Database::Mode::write).execute("CREATE TABLE t(x)");
  std::filesystem::resize_file(copy("half.db"), size / 2);
  scribble(copy("magic.db"), 3, "*");
  scribble(copy("page_size.db"), 16, std::string("\x03\x01", 2));
  const std::string pages = copy("pages.db");
  for (std::uintmax_t at = 8192; at + 4096 <= size; at += 4096) scribble(pages, at, "scribbled over");
  // The last page of rows: the others can be read.
  const std::string rows = copy("rows.db");
  const auto root = sqlite::Database::open(rows, sqlite::Database::Mode::read)
                        .integer("SELECT rootpage FROM sqlite_schema WHERE name = 'room'");
  std::ifstream file(rows, std::ios::binary);
  std::array<unsigned char, 12> head{};
  file.seekg((root - 1) * 4096);
  file.read(reinterpret_cast<char*>(head.data()), head.size());
  REQUIRE(head[0] == 5);  // of a table, with pages below it
  scribble(rows, ((head[9] << 16U | head[10] << 8U | head[11]) - 1) * 4096U, "scribbled over");
  sqlite::Database::open(copy("table.db"), sqlite::Database::Mode::write).execute("DROP TABLE rtdata_gap");
  sqlite::Database::open(copy("newer.db"), sqlite::Database::Mode::write).execute("PRAGMA user_version = 99");
  // Lengths that nothing has: of an array, of a text, of a record within a record.
  for (const auto& [name, field] :
       {std::pair{"array.db", R"({"name": "value", "type": "double", "array": 4294967295})"},
        std::pair{"long.db", R"({"name": "value", "type": "text", "capacity": 4294967295})"},
        std::pair{"nested.db", R"({"name": "value", "type": "record", "array": 65536,
      "fields": [{"name": "x", "type": "double", "array": 65536}]})"}}) {
    auto database = sqlite::Database::open(copy(name), sqlite::Database::Mode::write);
    auto update = database.prepare("UPDATE rtdata_topic SET description = ? WHERE topic = 'room'");
    update.bind(1, R"({"name": "measured", "fields": [)" + std::string(field) + "]}").run();
  }
  for (const std::string name :
       {"missing.db", "folder.db", "empty.db", "text.db", "other.db", "half.db", "magic.db", "page_size.db", "pages.db",
        "rows.db", "table.db", "newer.db", "array.db", "long.db", "nested.db"}) {
    for (const Words& words : readers(name)) {
      // It sends what waits, whatever the rows are.
      const bool is_of_rows = name == "rows.db" || name == "array.db" || name == "long.db" || name == "nested.db";
      if (words[0] == "forward" && is_of_rows) continue;
      const Bounded command(folder, words);
      CHECK_MESSAGE(command.status == 2, name << ": " << words[0] << " " << words.back() << ": " << command.said);
      CHECK_MESSAGE(has(command.said, name), name << ": " << words[0] << ": " << command.said);
    }
  }
  for (const Words& words : readers("good.db")) {
    if (words[0] == "forward") continue;
    const Bounded command(folder, words);
    CHECK_MESSAGE(command.status == 0, words[0] << ": " << command.said);
    if (words[0] == "verify") continue;
    Words other = words;  // of what it does not have
    other.insert(other.end(), {"--run", "9"});
    CHECK_MESSAGE(Bounded(folder, other).status == 1, words[0]);
  }
}

TEST_CASE("US-26 a recording that this user may not read: each command says so, with status 2") {
  if (std::getenv("RTDATA_TEST_EMULATOR") != nullptr) {
    MESSAGE("skipped: an emulator runs the program, not setpriv");
    return;
  }
  const Folder folder;
  write_configurations(folder);
  const std::string path = record(folder, "mine.db");
  ::chmod(path.c_str(), 0);
  const bool is_root = ::geteuid() == 0;
  if (is_root) {  // who may read everything: somebody else asks, who can reach nothing but this folder
    ::chmod(folder.path().c_str(), 0755);
    std::filesystem::copy_file(program, folder.path() + "/rtdata");
    Process can(folder, "/usr/bin/env", {"setpriv", "--reuid=65534", "--clear-groups", "./rtdata", "--version"});
    if (can.end() != 0) {
      MESSAGE("skipped: root may read everything, and setpriv cannot make us somebody else");
      return;
    }
  }
  for (Words words : readers("mine.db")) {
    if (is_root) words.insert(words.begin(), {"setpriv", "--reuid=65534", "--clear-groups", "./rtdata"});
    Process command(folder, is_root ? "/usr/bin/env" : program, words);
    const int status = command.end();
    CHECK_MESSAGE(status == 2, words.back() << ": " << command.out << command.err);
    CHECK_MESSAGE(has(command.err, "mine.db: Permission denied"), command.err);
  }
}

// In this process, where a wild access ends the tests.
TEST_CASE("US-26 whatever bytes of a recording are changed, it is read or refused") {
  const Folder folder;
  const std::string good = record(folder, "good.db"), changed = folder.path() + "/changed.db";
  std::ifstream file(good, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(file)), {});
  const std::size_t pages = bytes.size() / 4096;
  REQUIRE(pages > 20);
  const char* const seeds = std::getenv("RTDATA_TEST_SEEDS");
  unsigned count = rtdata::test::sanitized ? 100 : 500, first = 1;
  if (seeds != nullptr) std::istringstream(seeds) >> first >> count;
  std::array<unsigned, 3> met{};  // statuses
  for (unsigned seed = first; seed < first + count; ++seed) {
    CAPTURE(seed);
    std::mt19937_64 random(seed);
    const auto below = [&](std::size_t limit) { return static_cast<std::size_t>(random() % limit); };
    std::string now = bytes;
    for (std::size_t left = 1 + below(4); left > 0; --left) {
      // The header of the file; that of a page, with its list of cells; or where rows and their lengths are.
      const std::size_t page = below(pages) * 4096;
      const std::size_t at = std::array{below(100), page + below(64), page + below(4096)}[below(3)];
      const std::size_t size = 1 + below(4);
      for (std::size_t i = at; i < std::min(at + size, now.size()); ++i)
        now[i] = below(2) == 0 ? '\xff' : static_cast<char>(random());
    }
    std::ofstream(changed, std::ios::binary | std::ios::trunc) << now;
    // `error` is read after the command has run.
    const auto check = [&](const std::string& command, int status, const std::ostringstream& error) {
      CHECK_MESSAGE((status >= 0 && status <= 2), command);
      if (status == 2) CHECK_MESSAGE(error.str().starts_with("rtdata: "), command << ": " << error.str());
      ++met[static_cast<std::size_t>(std::clamp(status, 0, 2))];
    };
    for (const auto show_as : {app::ShowAs::text, app::ShowAs::json}) {
      std::ostringstream out, err;
      check("verify", app::verify({.database = changed, .show_as = show_as}, out, err), err);
    }
    std::ostringstream out, err;
    check("info", app::info({.database = changed, .gaps = app::InfoOptions::Gaps::listed}, out, err), err);
    for (const char* step : {"", "1 s"}) {
      std::ostringstream rows, wrong;
      app::ExportOptions options{.database = changed, .format = "jsonl", .step = step};
      check("export", app::export_recording(options, rows, wrong), wrong);
    }
  }
  for (const unsigned of_status : met) CHECK(of_status > 0);
}

TEST_CASE("a file of a gigabyte, where a small one belongs, is an error that says so") {
  const Folder folder;
  write_configurations(folder);
  record(folder, "good.db");
  sparse(folder, "big");
  sparse(folder, "big.db");
  std::filesystem::copy_file(folder.path() + "/good.db", folder.path() + "/longer.db");
  sparse(folder, "longer.db");
  const auto says = [&](const Words& words, int status, const std::string& text) {
    const Bounded command(folder, words);
    CHECK_MESSAGE(command.status == status, words[0] << ": " << command.said);
    CHECK_MESSAGE(has(command.said, text), words[0] << ": " << command.said);
  };
  // Configurations, and what stands beside them.
  says({"check", "big"}, 2, "the file is larger than 64 MiB");
  says({"run", "big"}, 2, "the file is larger than 64 MiB");
  folder.write("secret.json", R"({"sinks": [{"type": "mqtt", "host": "127.0.0.1", "user": "me",
    "password": {"file": "big"}}]})");
  says({"check", "secret.json"}, 2, "it is larger than 64 KiB");
  folder.write("tls.json",
               R"({"sinks": [{"type": "tcp", "host": "127.0.0.1", "port": 1, "tls": {"ca_file": "big"}}]})");
  says({"check", "tls.json"}, 2, "big");
  // Tables and recordings.
  says({"import", "big", "--time", "t", "--into", "made.db"}, 1, "the row is longer than 1 MiB");
  CHECK_FALSE(folder.has("made.db"));
  for (const Words& words : readers("big.db"))
    if (words[0] != "forward") says(words, 2, "big.db");
  for (const Words& words : readers("longer.db"))
    if (words[0] != "forward") CHECK_MESSAGE(Bounded(folder, words).status <= 2, words[0]);
  // What sinks are to go on with.
  for (const auto& [format, why] :
       {std::pair{"jsonl", "its last megabytes have no line end"}, std::pair{"csv", "cannot append to"},
        std::pair{"cbor", "its content is not a valid cbor"}}) {
    sparse(folder, std::string("out.") + format);
    folder.write("out.json", R"({"sensors": [{"name": "l", "type": "host", "quantity": "load", "rate": "50 Hz"}],
      "sinks": [{"type": "file", "topics": ["l"], "close_deadline": "100 ms", "format": ")" +
                                 std::string(format) + R"(", "path": "out.)" + format + R"("}]})");
    const Bounded run(folder, {"run", "out.json", "--for", "300ms"});
    CHECK_MESSAGE(run.status != 0, run.said);
    CHECK_MESSAGE(has(run.said, why), run.said);
    CHECK(std::filesystem::file_size(folder.path() + "/out." + format) == 1u << 30);
    std::filesystem::remove(folder.path() + "/out." + format);
  }
  // Texts within them.
  folder.write("deep.json", std::string(1'000'000, '['));
  says({"check", "deep.json"}, 2, "more than 64 levels of nesting");
  folder.write("long.json", R"({"name": ")" + std::string(10'000'000, 'x') + "\"}");
  says({"check", "long.json"}, 2, "long.json:1");
}

TEST_SUITE_END();
