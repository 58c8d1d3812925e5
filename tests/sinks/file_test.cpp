#include "rtdata/sinks/file.hpp"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <sys/file.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <filesystem>
#include <fstream>

#include "data/payloads.hpp"
#include "rtdata/config/read.hpp"
#include "sinks/killed.hpp"
#include "sinks/sink_kinds.hpp"

using namespace rtdata;
using namespace sinks;
using namespace std::chrono_literals;

namespace {

struct Bench {
  Directory directory;
  std::vector<std::string> errors;

  /// Publishes on topic "a" from `first` on, and closes.
  void record(const FileConfig& config, int first, int count) {
    Loop loop{Loop::Manual{}};
    loop.on_error([this](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.text());
    });
    FileSink sink(loop, config);
    const auto topic = loop.topic<Number>("a");
    for (int i = 0; i < count; ++i) topic.publish({static_cast<double>(first + i)});
  }
  std::string refusal(const FileConfig& config) {
    Loop loop{Loop::Manual{}};
    loop.topic<Number>("a");
    loop.topic<Number>("b/c");
    try {
      FileSink sink(loop, config);
    } catch (const SetupError& error) {
      return error.what();
    }
    return "";
  }
};

template <class T>
std::vector<T> read_back(const std::string& path, Codec& codec) {
  const std::string text = content(path);
  std::span<const std::byte> left = std::as_bytes(std::span(text));
  if (!codec.header(*description_of<T>()).empty()) left = left.subspan(codec.first_event(left));
  std::vector<T> all;
  while (!left.empty()) {
    const std::size_t size = codec.first_event(left);
    REQUIRE(size > 0);
    all.push_back(decode<T>(codec, left.first(size)).or_throw().data);
    left = left.subspan(size);
  }
  return all;
}

std::vector<double> values(const std::string& path, std::string_view format) {
  std::vector<double> all;
  const auto codec = CodecRegistry::standard().make(format).or_throw();
  for (const Number& number : read_back<Number>(path, *codec)) all.push_back(number.value);
  return all;
}

}  // namespace

TEST_SUITE("sinks") {
  TEST_CASE("US-30 every format reads back equal") {
    for (const char* format : {"jsonl", "csv", "raw"}) {
      CAPTURE(format);
      Bench bench;
      payloads::Everything first;
      first.name.assign("a\"b,\n").or_throw();
      first.maybe = 2.5;
      first.maybe_name.emplace().assign("x").or_throw();
      first.maybe_state = payloads::State::broken;
      first.maybe_flag = true;
      first.maybes = {7U, 8U};
      payloads::Everything second = first;
      second.i64 = -5;
      second.f64 = 0.1;
      {
        Loop loop{Loop::Manual{}};
        FileSink sink(loop, {.path = bench.directory / "run", .format = format});
        loop.topic<payloads::Everything>("a").publish(first);
        loop.topic<payloads::Everything>("a").publish(second);
        loop.advance(2s);
        CHECK(sink.counts().stored == 2);
      }
      const auto
          codec = CodecRegistry::standard().make(std::string_view(format) == "jsonl" ? "json" : format).or_throw();
      const auto events = read_back<payloads::Everything>(bench.directory / "run", *codec);
      CHECK(events == std::vector<payloads::Everything>{first, second});
    }
  }

  TEST_CASE("US-30 a second start begins a new file, and the earlier ones are kept under their numbers") {
    for (const char* format : {"json", "csv", "raw"}) {
      CAPTURE(format);
      Bench bench;
      const FileConfig config{.path = bench.directory / "run.txt", .format = format};
      bench.record(config, 1, 2);
      bench.record(config, 3, 0);  // it has no event: the next start goes on in it
      bench.record(config, 4, 1);
      bench.record(config, 5, 1);
      CHECK(values(bench.directory / "run-00000001.txt", format) == std::vector<double>{1, 2});
      const bool has_header = std::string_view(format) == "csv";
      CHECK(values(bench.directory / "run-00000002.txt", format) == std::vector<double>{4});
      CHECK(values(config.path, format) == std::vector<double>{5});
      CHECK(std::filesystem::exists(bench.directory / "run-00000003.txt") == false);
      CHECK(content(bench.directory / "run-00000002.txt").starts_with("time,") == has_header);
      CHECK(bench.errors.empty());
    }
  }

  TEST_CASE("US-30 a new run may have other columns, and a file that is a link stays one") {
    Bench bench;
    std::filesystem::create_directory(bench.directory / "disk");
    std::ofstream(bench.directory / "disk/run.csv") << "time,origin,sequence,speed\n1,a,1,2\n";
    std::filesystem::create_symlink("disk/run.csv", bench.directory / "run.csv");
    bench.record({.path = bench.directory / "run.csv", .format = "csv"}, 1, 2);
    CHECK(std::filesystem::is_symlink(bench.directory / "run.csv"));
    CHECK(values(bench.directory / "disk/run.csv", "csv") == std::vector<double>{1, 2});
    CHECK(content(bench.directory / "disk/run-00000001.csv") == "time,origin,sequence,speed\n1,a,1,2\n");
    CHECK(bench.errors.empty());
  }

  TEST_CASE("US-30 a file is named by the day and by the number of its run") {
    Bench bench;
    const std::string today = to_iso8601(wall_clock_now()).substr(0, 10);
    std::ofstream(bench.directory / ("test-" + today + "-9x.csv")) << "a note\n";
    const FileConfig config{.path = bench.directory / "test-{date}-{run}.csv"};
    bench.record(config, 1, 1);
    bench.record(config, 2, 1);
    if (to_iso8601(wall_clock_now()).substr(0, 10) != today) return;  // midnight came in between
    CHECK(values(bench.directory / ("test-" + today + "-10.csv"), "csv") == std::vector<double>{1});
    CHECK(values(bench.directory / ("test-" + today + "-11.csv"), "csv") == std::vector<double>{2});
    CHECK(content(bench.directory / ("test-" + today + "-9x.csv")) == "a note\n");
    const FileConfig a_topic{.path = bench.directory / "x-{topic}-{run}.csv"};
    bench.record(a_topic, 1, 1);
    bench.record(a_topic, 2, 1);
    CHECK(values(bench.directory / "x-a-1.csv", "csv") == std::vector<double>{1});
    CHECK(values(bench.directory / "x-a-2.csv", "csv") == std::vector<double>{2});
    CHECK(bench.refusal({.path = bench.directory / "{run}/x.csv"}).find("{run} is in the name of a directory") !=
          std::string::npos);
  }

  TEST_CASE("US-30 a second start appends where files rotate; a CSV keeps its one header") {
    for (const char* format : {"json", "csv", "raw"}) {
      CAPTURE(format);
      Bench bench;
      const FileConfig config{.path = bench.directory / "run", .format = format, .rotate = {.time = 24h * 360}};
      bench.record(config, 1, 2);
      bench.record(config, 3, 0);
      bench.record(config, 3, 2);
      CHECK(values(config.path, format) == std::vector<double>{1, 2, 3, 4});
      CHECK(bench.errors.empty());
    }
  }

  TEST_CASE("US-30 a file a topic") {
    Bench bench;
    Loop loop{Loop::Manual{}};
    FileSink sink(loop, {.path = bench.directory / "run-{topic}.csv", .format = "csv"});
    loop.topic<Number>("a").publish({1});
    loop.topic<Number>("b/c").publish({2});
    loop.topic<payloads::Climate>("d").publish({20, 40});
    std::vector<std::string> errors;
    loop.on_error([&](const ErrorReport& report) {
      if (report.error.code != Errc::held_too_long) errors.push_back(report.error.text());
    });
    loop.topic<Number>("b-c").publish({3});
    sink.close();
    CHECK(values(bench.directory / "run-a.csv", "csv") == std::vector<double>{1});
    CHECK(values(bench.directory / "run-b-c.csv", "csv") == std::vector<double>{2});
    CHECK(content(bench.directory / "run-d.csv").starts_with("time,origin,sequence,temperature,humidity\n"));
    REQUIRE(errors.size() == 1);
    CHECK(errors[0] == "cannot record topic b-c: " + bench.directory.path +
                           "/run-b-c.csv: the file holds topic b/c: give one of them a sink of its own");
  }

  TEST_CASE("US-30 without a format a file is written as its name ends") {
    CHECK(format_of({.path = "a/run.csv"}) == "csv");
    CHECK(format_of({.path = "run-{topic}.cbor"}) == "cbor");
    CHECK(format_of({.path = "run.jsonl"}) == "jsonl");
    CHECK(format_of({.path = "csv"}) == "jsonl");
    CHECK(format_of({.path = "run.csv", .format = "jsonl"}) == "jsonl");
    Bench bench;
    Loop loop{Loop::Manual{}};
    FileSink sink(loop, {.path = bench.directory / "run.csv"});
    loop.topic<Number>("a").publish({1});
    sink.close();
    CHECK(values(bench.directory / "run.csv", "csv") == std::vector<double>{1});
  }

  TEST_CASE("US-30 mistakes are told by the constructor") {
    Bench bench;
    const std::string& directory = bench.directory.path;
    const auto starts = [&](const FileConfig& config, const std::string& text) {
      const std::string message = bench.refusal(config);
      CAPTURE(message);
      CHECK(message.starts_with(text));
    };
    starts({.path = ""}, "cannot make file sink: `path` is empty");
    starts({.path = directory}, "cannot open the file: " + directory + ": it is a directory");
    starts({.path = directory + "/no/run.jsonl"},
           "cannot open the file: " + directory + "/no/run.jsonl: No such file or directory");
    starts({.path = directory + "/no/{topic}"},
           "cannot make file sink: " + directory + "/no/{topic}: there is no directory");
    starts({.path = directory + "/{topic}/run"},
           "cannot make file sink: " + directory + "/{topic}/run: {topic} is in the name of a directory");
    starts({.path = "/dev/null"}, "cannot record into: /dev/null: it is not a regular file");
    starts({.path = directory + "/run", .format = "cvs"}, CodecRegistry::standard().make("cvs").error().text());
    starts({.path = directory + "/run.csv", .format = "csv"},
           "cannot record topic b/c: " + directory +
               "/run.csv: a file has the columns of one topic, here a: write {topic}");
    std::ofstream(directory + "/other.csv") << "time,origin,sequence,speed\n1,a,1,2\n";
    starts(
        {.path = directory + "/other.csv", .format = "csv", .rotate = {.time = 24h * 360}, .sink = {.topics = {"a"}}},
        "cannot append to: " + directory + "/other.csv: its header is \"time,origin,sequence,speed\"");
    std::ofstream(directory + "/text") << "this is a text and not raw bytes\n";
    starts({.path = directory + "/text", .format = "raw"},
           "cannot append to: " + directory + "/text: its content is not a valid raw");
    CHECK(content(directory + "/text") == "this is a text and not raw bytes\n");
    if (::geteuid() == 0) {
      MESSAGE("skipped: a directory without permission, since root may write everywhere");
    } else {
      ::chmod(directory.c_str(), 0500);
      starts({.path = directory + "/new"}, "cannot open the file: " + directory + "/new: Permission denied");
      ::chmod(directory.c_str(), 0700);
    }
  }

  TEST_CASE("US-30 a second process on a file is refused, with the first one's number") {
    Bench bench;
    const std::string path = bench.directory / "run.jsonl";
    int ready[2];
    int release[2];
    REQUIRE(::pipe2(ready, O_CLOEXEC) == 0);
    REQUIRE(::pipe2(release, O_CLOEXEC) == 0);
    const pid_t holder = ::fork();
    if (holder == 0) {
      ::close(release[1]);
      const int fd = ::open(path.c_str(), O_RDWR | O_CREAT, 0644);
      char byte = ::flock(fd, LOCK_EX) == 0 ? 'y' : 'n';
      if (::write(ready[1], &byte, 1) == 1) [[maybe_unused]]
        const auto got = ::read(release[0], &byte, 1);
      ::_exit(0);
    }
    char byte = 0;
    REQUIRE(::read(ready[0], &byte, 1) == 1);
    CHECK(byte == 'y');
    const std::string message = bench.refusal({.path = path});
    CAPTURE(message);
    CHECK(message.starts_with("cannot record into: " + path + ": "));
    CHECK(message.find("writes it: stop that one, or choose another path") != std::string::npos);
    for (const int fd : {ready[0], ready[1], release[0], release[1]}) ::close(fd);
    CHECK(::waitpid(holder, nullptr, 0) == holder);
    bench.record({.path = path}, 1, 1);
    CHECK(values(path, "json") == std::vector<double>{1});
  }

  TEST_CASE("US-30 half an event left by a kill does not spoil the next") {
    Bench bench;
    for (const char* format : {"json", "csv", "raw"}) {
      SUBCASE(format) {
        const FileConfig config{.path = bench.directory / "run", .format = format, .rotate = {.time = 24h * 360}};
        bench.record(config, 1, 2);
        const auto size = std::filesystem::file_size(config.path);
        std::filesystem::resize_file(config.path, size - 1);
        bench.record(config, 3, 2);
        CHECK(values(config.path, format) == std::vector<double>{1, 3, 4});
        CHECK(!content(config.path + ".half").empty());
        // Within the header, or the first event.
        bench.errors.clear();
        std::filesystem::resize_file(config.path, 3);
        bench.record(config, 5, 2);
        CHECK(values(config.path, format) == std::vector<double>{5, 6});
      }
    }
    REQUIRE(bench.errors.size() == 1);
    CHECK(bench.errors[0].starts_with("an event was cut off: "));
  }

  TEST_CASE("US-30 killed in the middle, then started again: all that was stored is there") {
    for (const char* format : {"json", "csv", "raw"}) {
      CAPTURE(format);
      Bench bench;
      const FileConfig config{
          .path = bench.directory / "run", .format = format, .rotate = {.time = 24h * 360}, .sink = {.batch_rows = 10}};
      const pid_t child = fork_without_threads();
      if (child == 0) {
        Loop loop{Loop::Manual{}};
        FileSink sink(loop, config);
        const auto topic = loop.topic<Number>("a");
        for (int i = 1; i <= 100; ++i) {
          topic.publish({static_cast<double>(i)});
          if (i % 10 == 0) loop.advance(1ms);
          if (i == 55) ::raise(SIGKILL);
        }
        ::_exit(0);
      }
      int status = 0;
      REQUIRE(::waitpid(child, &status, 0) == child);
      CHECK(WIFSIGNALED(status));
      bench.record(config, 101, 1);
      std::vector<double> expected;
      for (int i = 1; i <= 50; ++i) expected.push_back(i);
      expected.push_back(101);
      CHECK(values(config.path, format) == expected);
      CHECK(bench.errors.empty());
    }
  }

  TEST_CASE("US-30 events that do not fit the format are refused, counted and reported; the others are stored") {
    Bench bench;
    Loop loop{Loop::Manual{}};
    FileSink sink(loop, {.path = bench.directory / "run.raw", .format = "raw"});
    std::vector<std::string> errors;
    sink.on_error([&](const ErrorReport& report) { errors.push_back(report.error.text()); });
    payloads::Everything absent;
    payloads::Everything whole;
    whole.maybe = 1;
    whole.maybe_name.emplace();
    whole.maybe_state = payloads::State::idle;
    whole.maybe_flag = false;
    whole.maybes = {7U, 8U};
    for (int i = 0; i < 6; ++i) loop.topic<payloads::Everything>("a").publish(i % 2 == 0 ? absent : whole);
    loop.advance(2s);
    CHECK(sink.counts().stored == 3);
    CHECK(sink.counts().dropped[static_cast<std::size_t>(DropReason::refused)] == 3);
    CHECK(sink.counts().balances());
    REQUIRE(errors.size() == 1);
    CHECK(errors[0].find("(the first of 3)") != std::string::npos);
    const auto codec = make_raw_codec();
    CHECK(read_back<payloads::Everything>(bench.directory / "run.raw", *codec).size() == 3);
  }

  TEST_CASE("NFR-1 a full disk: the events wait, and each is there once when there is room") {
    Bench bench;
    const std::string disk = bench.directory / "disk";
    std::filesystem::create_directory(disk);
    if (::mount("none", disk.c_str(), "tmpfs", 0, "size=64k") != 0) {
      MESSAGE("skipped: mounting a small disk is not permitted here");
      return;
    }
    for (const char* format : {"json", "csv", "raw"}) {
      CAPTURE(format);
      const std::string path = disk + "/run";
      {
        std::ofstream(disk + "/ballast") << std::string(50'000, 'x');
        Loop loop{Loop::Manual{}};
        std::vector<std::string> errors;
        loop.on_error([&](const ErrorReport& report) {
          if (report.error.code != Errc::held_too_long) errors.push_back(std::string(report.error.id()));
        });
        FileSink sink(
            loop,
            {.path = path, .format = format, .sync = FileSync::batch, .sink = {.name = "run", .batch_rows = 300}});
        const auto topic = loop.topic<Number>("a");
        for (int i = 1; i <= 600; ++i) {
          topic.publish({static_cast<double>(i)});
          if (i % 100 == 0) loop.advance(10ms);
        }
        loop.advance(5s);
        CHECK(sink.health() == Health::faulted);
        CHECK(sink.counts().queued > 0);
        CHECK(sink.counts().balances());
        REQUIRE(!errors.empty());
        CHECK(errors[0] == "storage-full");
        std::filesystem::remove(disk + "/ballast");
        loop.advance(20s);
        CHECK(sink.health() == Health::ok);
        CHECK(sink.counts().stored == 600);
      }
      std::vector<double> expected;
      for (int i = 1; i <= 600; ++i) expected.push_back(i);
      CHECK(values(path, format) == expected);
      std::filesystem::remove(path);
    }
    CHECK(::umount(disk.c_str()) == 0);
  }

  TEST_CASE("NFR-1 a disk that is full to the end: what counts as lost is not in the file, and all else is") {
    Bench bench;
    const std::string disk = bench.directory / "disk";
    std::filesystem::create_directory(disk);
    if (::mount("none", disk.c_str(), "tmpfs", 0, "size=64k") != 0) {
      MESSAGE("skipped: mounting a small disk is not permitted here");
      return;
    }
    for (const char* format : {"json", "csv", "raw"}) {
      CAPTURE(format);
      const std::string path = disk + "/run";
      std::ofstream(disk + "/ballast") << std::string(50'000, 'x');
      SinkCounts counts;
      {
        Loop loop{Loop::Manual{}};
        loop.on_error([](const ErrorReport&) {});
        FileSink sink(loop, {.path = path, .format = format, .sink = {.name = "run", .batch_rows = 50}});
        const auto topic = loop.topic<Number>("a");
        for (int i = 1; i <= 2000; ++i) {
          topic.publish({static_cast<double>(i)});
          if (i % 50 == 0) loop.advance(10ms);
        }
        loop.advance(5s);
        CHECK(sink.health() == Health::faulted);
        CHECK(loop.close(1s) > 0);
        counts = loop.runtime().sinks().front().counts;
      }
      CHECK(counts.balances());
      CHECK(counts.stored > 0);
      CHECK(counts.stored < 2000);
      std::vector<double> stored;
      for (std::uint64_t i = 1; i <= counts.stored; ++i) stored.push_back(static_cast<double>(i));
      CHECK(values(path, format) == stored);
      std::filesystem::remove(path);
    }
    CHECK(::umount(disk.c_str()) == 0);
  }

  TEST_CASE("a file that somebody deletes is made anew, and that is reported") {
    Bench bench;
    const FileConfig config{.path = bench.directory / "run.csv", .format = "csv"};
    {
      Loop loop{Loop::Manual{}};
      std::vector<std::string> errors;
      loop.on_error([&](const ErrorReport& report) {
        if (report.error.code != Errc::held_too_long) errors.push_back(report.error.what);
      });
      FileSink sink(loop, config);
      loop.topic<Number>("a").publish({1});
      loop.advance(2s);
      std::filesystem::remove(config.path);
      loop.topic<Number>("a").publish({2});
      loop.advance(3s);
      CHECK(errors == std::vector<std::string>{"the file was deleted"});
      CHECK(sink.counts().balances());
    }
    CHECK(values(config.path, "csv") == std::vector<double>{2});
  }

  TEST_CASE("a file that somebody moves is made anew, and that is reported; nothing is lost") {
    Bench bench;
    const FileConfig config{.path = bench.directory / "run.csv", .format = "csv"};
    const std::string moved = bench.directory / "moved.csv";
    {
      Loop loop{Loop::Manual{}};
      std::vector<std::string> errors, health;
      loop.on_error([&](const ErrorReport& report) {
        if (report.error.code != Errc::held_too_long) errors.push_back(report.error.what);
      });
      const Subscription changes = loop.subscribe<HealthChange>(
          "$rtdata/health", [&](const Event<HealthChange>& event) { health.emplace_back(name_of(event->state)); });
      FileSink sink(loop, config);
      loop.topic<Number>("a").publish({1});
      loop.advance(2s);
      std::filesystem::rename(config.path, moved);
      loop.topic<Number>("a").publish({2});
      loop.advance(3s);
      CHECK(errors == std::vector<std::string>{"the file was moved"});
      CHECK(health == std::vector<std::string>{"faulted", "ok"});
      CHECK(sink.counts().stored == 2);
      CHECK(sink.counts().balances());
    }
    CHECK(values(moved, "csv") == std::vector<double>{1});
    CHECK(values(config.path, "csv") == std::vector<double>{2});
  }

  TEST_CASE("US-30 a file that somebody cuts off is told, and what comes after that is whole") {
    for (const std::string format : {"csv", "json", "raw"}) {
      for (const std::uintmax_t left : {std::uintmax_t{0}, std::uintmax_t{45}}) {
        CAPTURE(format);
        CAPTURE(left);
        Bench bench;
        const FileConfig config{.path = bench.directory / "run.log", .format = format};
        Loop loop{Loop::Manual{}};
        std::vector<std::string> errors;
        loop.on_error([&](const ErrorReport& report) {
          if (report.error.code != Errc::held_too_long) errors.push_back(report.error.what);
        });
        FileSink sink(loop, config);
        for (int i = 1; i <= 3; ++i) loop.topic<Number>("a").publish({1.0 * i});
        loop.advance(2s);
        CHECK(values(config.path, format) == std::vector<double>{1, 2, 3});
        REQUIRE(std::filesystem::file_size(config.path) > left);
        std::filesystem::resize_file(config.path, left);
        for (int i = 4; i <= 6; ++i) loop.topic<Number>("a").publish({1.0 * i});
        loop.advance(5s);
        loop.topic<Number>("a").publish({7});
        loop.advance(5s);
        REQUIRE(!errors.empty());
        CHECK(errors.front() == "the file was cut off");
        CHECK(std::count(errors.begin(), errors.end(), "the file was cut off") == 1);
        CHECK(sink.counts().stored == 7);
        CHECK(sink.counts().balances());
        std::vector<double> there = values(config.path, format);
        REQUIRE(there.size() >= 4);
        there.erase(there.begin(), there.end() - 4);
        CHECK(there == std::vector<double>{4, 5, 6, 7});
        loop.close();
        // What is left of an event that was cut through is beside the file, as after a kill.
        CHECK(std::filesystem::exists(config.path + ".half") == (errors.size() > 1));
      }
    }
  }

  TEST_CASE("US-30 formats of the program's own") {
    class Bare final : public Codec {
      std::string_view name() const noexcept override { return "bare"; }
      Result<void> encode(const EventView& event, std::vector<std::byte>& out) override {
        for (const char c : to_string(event.value(event.description().leaves().front())) + "\n")
          out.push_back(static_cast<std::byte>(c));
        return {};
      }
      Result<DecodedEvent> decode(std::span<const std::byte>, const Description&) override {
        return Error{Errc::bad_data, "not read here", "", "", ""};
      }
    };
    Bench bench;
    CodecRegistry formats = CodecRegistry::standard();
    formats.add("bare", [] { return std::make_unique<Bare>(); }).or_throw();
    {
      Loop loop{Loop::Manual{}};
      FileSink sink(loop, {.path = bench.directory / "run", .format = "bare"}, formats);
      loop.topic<Number>("a").publish({1.5});
      loop.topic<Number>("b").publish({2.5});
    }
    CHECK(content(bench.directory / "run") == "1.5\n2.5\n");
  }

  TEST_CASE("US-17 a file sink's parameters come from a configuration") {
    ConfigItem item = ConfigItem::object();
    item.set("path", "x.csv");
    item.set("format", "csv");
    item.set("sync", "batch");
    item.set("topics", std::vector<std::string>{"a", "b/#"});
    item.set("batch_rows", 7);
    item.set("batch_time", "250 ms");
    item.set("queue_bytes", 1 << 20);
    item.set("when_full", "drop_oldest");
    const auto config = read_config<FileConfig>(item);
    CHECK(config.path == "x.csv");
    CHECK(config.sync == FileSync::batch);
    CHECK(config.sink.topics == std::vector<std::string>{"a", "b/#"});
    CHECK(config.sink.batch_rows == 7);
    CHECK(config.sink.batch_time == 250ms);
    CHECK(config.sink.when_full == WhenFull::drop_oldest);
    CHECK(parameters_of<FileConfig>().size() == 17);
  }

  TEST_CASE("a file sink leaves a database alone, which it would cut off as half an event") {
    Bench bench;
    const std::string path = bench.directory / "run.db";
    std::string database("SQLite format 3\0", 16);
    database.append(4096, 'x');
    std::ofstream(path, std::ios::binary) << database;
    for (const char* format : {"jsonl", "raw"}) {
      CAPTURE(format);
      Loop loop{Loop::Manual{}};
      loop.on_error([](const ErrorReport&) {});
      loop.runtime().on_log([](const LogRecord&) {});
      try {
        FileSink sink(loop, {.path = path, .format = format});
        loop.topic<Number>("a").publish({1});
        CHECK(loop.close() == 1);
        CHECK(loop.runtime().has_loss());
      } catch (const SetupError& e) {
        CHECK(std::string(e.what()).find("SQLite") != std::string::npos);
      }
      CHECK(content(path) == database);
      CHECK(!std::filesystem::exists(path + ".half"));
    }
  }

  TEST_CASE("a topic whose file would have too long a name is refused without a look at the disk") {
    const FileConfig config{.path = "/no/such/folder/{topic}.jsonl"};
    const std::string longest(255 - 6, 't'), too_long(256 - 6, 't');
    const TopicToRecord topics[] = {{longest, nullptr}, {too_long, nullptr}};
    const std::vector<Error> refused = refused_topics(config, topics);
    REQUIRE(refused.size() == 1);
    CHECK(refused[0].what.find(too_long) != std::string::npos);
    CHECK(refused[0].why == "the name of its file is too long");
    CHECK(refused_topics({.path = std::string(2048, '/') + "{topic}" + std::string(2048, '/')}, topics).size() == 2);
  }
}
