// `rtdata calibrate`: points are measured, by the sensor alone or by the running instance, and written into the file.
#include <doctest/doctest.h>
#include <sys/stat.h>

#include <filesystem>

#include "app/runtime_folder.hpp"
#include "has.hpp"
#include "paths.hpp"

using rtdata::test::Folder;
using rtdata::test::has;
using rtdata::test::Process;
using rtdata::test::program;
using rtdata::test::RuntimeFolder;

namespace {

/// A converter whose code is a file of the test.
std::string scale(const Folder& folder, const std::string& process) {
  return R"({
  // the scale in the hall
  "name": "hall",
  "sensors": [
    {
      "name": "scale", "type": "analog", "rate": "50 Hz",
      "file": ")" +
         folder.path() + R"(/code", "span_voltage": 1, "quantization_bits": 10,  // of a 10 bit converter
)" + process +
         R"(    }
  ],
  "sinks": [{"type": "sqlite", "path": "hall.db"}]
}
)";
}

/// `rtdata calibrate` with the answers of a person, who is a shell script: `heard TEXT` waits until that is printed.
struct Calibrating {
  Calibrating(const Folder& folder, const std::string& sensor, const std::string& script,
              const std::string& limits = "") {
    folder.write("answers.sh", R"(
heard() { for i in $(seq 600); do if grep -q "$1" out.txt err.txt; then return; fi; sleep 0.05; done; }
)" + script + "\n");
    folder.write("out.txt", "");
    folder.write("err.txt", "");
    Process both(
        folder, "/bin/sh",
        {"-c", limits + "sh answers.sh | " + program + " calibrate hall.json " + sensor + " >out.txt 2>err.txt"});
    status = both.end();
    out = folder.read("out.txt");
    err = folder.read("err.txt");
  }
  int status = -1;
  std::string out, err;
};

}  // namespace

TEST_SUITE("app") {
  TEST_CASE("calibrate measures with the sensor alone, and writes points into the file, comments kept") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("hall.json", scale(folder, R"(      // its calibration
      "process": {"value": {
        "calibration": {
          "version": "old",  // of last year
          "scale": 2,
          "least": -5
        }, "unit": "kg"
      }}
)"));
    ::chmod((folder.path() + "/hall.json").c_str(), 0640);
    folder.write("code", "100\n");
    const Calibrating one(
        folder, "scale",
        "echo 0; heard ' 1: raw'; echo 300 1<>code; echo 7; heard ' 2: raw'; echo undo; echo x; echo 10;"
        "heard 'is 10$'; echo 500 1<>code; echo 21; heard ' 3: raw'; echo done; sleep 0.1");
    CHECK(one.status == 0);
    CHECK_MESSAGE(has(one.out, "scale.value of the sensor itself, which runs for this alone"), one.out, one.err);
    CHECK(has(one.out, "  2: raw "));
    CHECK(has(one.out, "point 2 is removed"));
    CHECK(has(one.out, "\"x\" is not a number such as 98.1"));
    CHECK(has(one.out, "largest residual "));
    CHECK(has(one.out, "wrote hall.json: 3 points for scale.value"));
    CHECK(has(one.out, "removed from this calibration: scale, version"));
    CHECK_MESSAGE(one.err.empty(), one.err);
    std::istringstream lines(one.out);
    for (std::string line; std::getline(lines, line);) CHECK_MESSAGE(line.size() <= 80, line);
    CHECK_FALSE(folder.has("hall.db"));
    const std::string text = folder.read("hall.json");
    for (const char* kept : {"// the scale in the hall", "// of a 10 bit converter", "// its calibration",
                             "// of last year", "\"least\": -5,\n          \"points\": [[", "}, \"unit\": \"kg\""})
      CHECK_MESSAGE(has(text, kept), text);
    CHECK_FALSE(has(text, "\"scale\": 2"));
    CHECK_FALSE(has(text, "\"old\""));
    struct stat about {};
    REQUIRE(::stat((folder.path() + "/hall.json").c_str(), &about) == 0);
    CHECK((about.st_mode & 07777) == 0640);
    Process check(folder, program, {"check", "hall.json"});
    CHECK(check.end() == 0);
    CHECK_MESSAGE(has(check.out, "sensor scale, value: "), check.out);
    CHECK(has(check.out, " through 3 points; largest residual "));
  }

  TEST_CASE("calibrate asks the running instance for raw values, and the reload takes what was written") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("hall.json", scale(folder, R"(      "process": {"value": {"calibration": {"scale": 3}}}
)"));
    folder.write("code", "100\n");
    Process run(folder, program, {"run", "hall.json"});
    REQUIRE(run.wait_for("running hall"));
    const Calibrating one(folder, "scale.value",
                          "echo 0; heard ' 1: raw'; echo 300 1<>code; echo 10; heard ' 2: raw'; echo");
    CHECK(one.status == 0);
    CHECK_MESSAGE(has(one.out, "scale.value of the running instance hall, pid "), one.out, one.err);
    CHECK(has(one.out, "wrote hall.json: 2 points for scale.value\n"));
    CHECK(has(one.out, "next: rtdata ctl reload"));
    Process reload(folder, program, {"ctl", "reload"});
    CHECK(reload.end() == 0);
    CHECK(has(reload.out, "sensor scale: changed while it runs (process)"));
    run.signal(SIGTERM);
    CHECK(run.end() == 0);
    CHECK(has(run.out, "nothing lost"));
    // The raw values are those before the calibration of the instance.
    const std::string text = folder.read("hall.json");
    const std::size_t at = text.find("\"points\": [[") + 12;
    CHECK(std::stod(text.substr(at)) == doctest::Approx(100.0 / 1023).epsilon(0.01));
  }

  TEST_CASE("ctl tare lets a value read 0, over a reload and the next start, and is recorded") {
    const RuntimeFolder runtime;
    const Folder folder;
    const auto configuration = [&](const char* calibration) {
      return scale(folder, R"(      "process": {"value": {"calibration": )" + std::string(calibration) +
                               R"(, "filters": [{"type": "clamp", "least": 0}, {"type": "delta", "by": 0.5}]}}
)");
    };
    folder.write("hall.json", configuration(R"({"scale": 1024})"));
    folder.write("code", "100\n");
    const auto ctl = [&](std::vector<std::string> words, int status) {
      words.insert(words.begin(), "ctl");
      Process one(folder, program, words);
      CHECK(one.end() == status);
      return one.out + one.err;
    };
    const auto value = [&] {
      Process top(folder, program, {"top", "--once", "--topic", "scale"});
      CHECK(top.end() == 0);
      return top.out;
    };
    {
      Process run(folder, program, {"run", "hall.json"});
      REQUIRE(run.wait_for("running hall"));
      CHECK(has(ctl({"tare", "scael"}, 1), "did you mean"));
      CHECK(has(ctl({"tare", "scale.raw"}, 1), "raw has no calibration"));
      CHECK(has(ctl({"tare", "scale", "now"}, 1), "--clear"));
      CHECK(has(ctl({"tare"}, 1), "write it as `tare SENSOR[.FIELD] [--clear]`"));
      const std::string taken = ctl({"tare", "scale"}, 0);
      CHECK_MESSAGE(has(taken, "scale.value reads 0 now: its tare is 100, the mean of "), taken);
      CHECK(has(value(), "value"));
      CHECK(has(folder.read("hall.tare"), "\"tare\": 100"));
      folder.write("code", "130\n");
      // Another tare is not added to the first, and a clamp hides nothing from it.
      CHECK(has(ctl({"tare", "scale.value"}, 0), "its tare is 130, the mean of "));
      CHECK(ctl({"reload"}, 0).find("no-effect") == std::string::npos);
      CHECK(ctl({"stop", "scale"}, 0) == "sensor scale is stopped\n");
      CHECK(has(ctl({"tare", "scale"}, 1), "it is stopped"));
      run.signal(SIGTERM);
      CHECK(run.end() == 0);
    }
    folder.write("code", "150\n");
    const auto rows = [&](const char* from) {
      Process exported(folder, program, {"export", "hall.db", "--topic", "scale", "--run", from});
      CHECK(exported.end() == 0);
      return exported.out;
    };
    {
      Process run(folder, program, {"run", "hall.json", "--for", "1s"});
      CHECK(run.end() == 0);
      CHECK_MESSAGE(has(run.out + run.err, "tares as before, from hall.tare: scale.value 130"), run.out, run.err);
      CHECK_MESSAGE(has(rows("-1"), ",scale,1,20,"), rows("-1"));  // from the first row on
    }
    {
      Process run(folder, program, {"run", "hall.json"});
      REQUIRE(run.wait_for("running hall"));
      CHECK(ctl({"tare", "scale", "--clear"}, 0) == "the tare of scale.value is removed\n");
      run.signal(SIGTERM);
      CHECK(run.end() == 0);
    }
    Process commands(folder, program, {"export", "hall.db", "--topic", "rtdata/commands"});
    CHECK(commands.end() == 0);
    CHECK(has(commands.out, "tare scale.value"));
    CHECK(has(commands.out, "tare scale --clear"));
    CHECK(has(commands.out, "uid " + std::to_string(::geteuid())));
    CHECK(has(folder.read("hall.tare"), "\"tares\": {}"));
    // A tare of another calibration is not taken; nor is one of a file that cannot be read.
    folder.write("hall.tare", "{");
    {
      Process run(folder, program, {"run", "hall.json"});
      REQUIRE(run.wait_for("the tares in hall.tare are not used"));
      REQUIRE(run.wait_for("running hall"));
      CHECK(has(ctl({"tare", "scale"}, 0), "its tare is 150"));
      folder.write("hall.json", configuration(R"({"scale": 2048})"));
      CHECK(has(ctl({"reload"}, 0), "its tare, 150 of value, is not used, because that calibration has changed"));
      run.signal(SIGTERM);
      CHECK(run.end() == 0);
    }
    Process verify(folder, program, {"verify", "hall.db"});
    CHECK(verify.end() == 0);
    // Nor is one of another configuration of this name, whatever folder it is run from.
    std::string of_another = folder.read("hall.tare");
    of_another.insert(of_another.find("hall.json"), "other/");
    folder.write("hall.tare", of_another);
    {
      Process run(folder, program, {"run", "hall.json", "--for", "300ms"});
      CHECK(run.end() == 0);
      CHECK_MESSAGE(has(run.out + run.err, "are not used: they are those of "), run.out, run.err);
    }
    std::filesystem::remove(folder.path() + "/hall.tare");
    REQUIRE(::mkfifo((folder.path() + "/hall.tare").c_str(), 0600) == 0);
    Process run(folder, program, {"run", "hall.json", "--for", "300ms"});
    CHECK(run.end() == 0);
    CHECK_MESSAGE(has(run.out + run.err, "it is not a regular file"), run.out, run.err);
  }

  TEST_CASE("a tare that waits for a value holds no other command up") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("hall.json", scale(folder, R"(      "process": {"value": {"calibration": {}}}, "topic": "scale"
)"));
    Process run(folder, program, {"run", "hall.json"});  // there is no `code`: no value comes
    REQUIRE(run.wait_for("running hall"));
    Process tare(folder, program, {"ctl", "tare", "scale"});
    Process note(folder, program, {"ctl", "note", "still here"});
    CHECK(note.end() == 0);
    CHECK(tare.end() == 1);
    CHECK_MESSAGE(has(tare.out + tare.err, "gave no value"), tare.out, tare.err);
    run.signal(SIGTERM);
    run.end();
    Process commands(folder, program, {"export", "hall.db", "--topic", "rtdata/commands"});
    CHECK(commands.end() == 0);
    CHECK_MESSAGE(commands.out.find("note still here") < commands.out.find("tare scale"), commands.out);
  }

  TEST_CASE("calibrate says what it cannot do, writes nothing then, and shows the points") {
    const RuntimeFolder runtime;
    const Folder folder;
    folder.write("hall.json", scale(folder, "      \"topic\": \"scale\"\n"));
    folder.write("code", "100\n");
    const std::string before = folder.read("hall.json");
    const auto end = [&](const std::string& sensor, const std::string& script, int status) {
      const Calibrating one(folder, sensor, script);
      CHECK(one.status == status);
      return one.out + one.err;
    };
    CHECK(has(end("scael", "true", 1), "did you mean scale?"));
    CHECK(has(end("scale.valeu", "true", 1), "it has no number valeu; available: value"));
    CHECK(has(end("scale", "true", 1), "nothing was written: a line needs two points, there is none"));
    CHECK(has(end("scale", "echo 1; heard ' 1: raw'", 1), "a line needs two points, there is one"));
    // The same raw value twice gives no line.
    CHECK(has(end("scale", "echo 1; echo 2; heard 'not used'", 1), "as at point 1: not used"));
    // Changed meanwhile.
    const std::string changed = end(
        "scale", "echo 1; heard ' 1: raw'; echo 300 1<>code; echo >>hall.json; echo 2; heard ' 2: raw'", 1);
    CHECK_MESSAGE(has(changed, "it has been changed meanwhile"), changed);
    CHECK(has(changed, "the points, to copy:\n  \"points\": [["));
    CHECK(folder.read("hall.json") == before + "\n");
    // A disk that is full: here a file of more than 4 KiB cannot be written.
    const std::string large = "// " + std::string(10000, 'x') + "\n" + before;
    folder.write("hall.json", large);
    const Calibrating full(folder, "scale", "echo 1; heard ' 1: raw'; echo 200 1<>code; echo 2; heard ' 2: raw'",
                           "trap '' XFSZ; ulimit -f 8; ");
    CHECK(full.status == 1);
    CHECK_MESSAGE(has(full.err, "cannot write"), full.err);
    CHECK(has(full.err, "nothing was written\nthe points, to copy:\n  \"points\": [["));
    CHECK(folder.read("hall.json") == large);
    std::size_t files = 0;
    for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
      files += entry.path().filename().string().starts_with("hall.json") ? 1 : 0;
    CHECK(files == 1);
    // No value comes.
    folder.write("code", "no number\n");
    CHECK(has(end("scale", "echo 1; heard 'no value came'", 1), "no value came"));
    // A configuration with mistakes.
    folder.write("hall.json", "{\"sensors\": [{}]}");
    CHECK(has(end("scale", "true", 2), "missing"));
    CHECK(folder.read("hall.json") == "{\"sensors\": [{}]}");
  }
}
