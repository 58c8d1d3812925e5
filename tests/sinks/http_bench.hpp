// A sink of HTTP at a server of the test's own, tests/sinks/http_server.py, in virtual time.
#pragma once

#include <doctest/doctest.h>
#include <poll.h>
#include <uv.h>

#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "app/process.hpp"
#include "paths.hpp"
#include "rtdata/sensors/feed.hpp"
#include "rtdata/sinks/http.hpp"
#include "sinks/sink_kinds.hpp"

namespace sinks {

inline bool is_program(const std::string& path) { return ::access(path.c_str(), X_OK) == 0; }
inline const std::string python = "/usr/bin/python3";

/// Lets the loop take what comes from outside, until this is so. Hardly any virtual time passes.
template <class Until>
bool wait_for(rtdata::Loop& loop, Until&& until) {
  const auto limit = std::chrono::steady_clock::now() + std::chrono::seconds{30};
  while (!until()) {
    if (std::chrono::steady_clock::now() > limit) return false;
    pollfd ready{uv_backend_fd(loop.uv()), POLLIN, 0};
    ::poll(&ready, 1, 5);
    loop.advance(std::chrono::milliseconds{1});
  }
  return true;
}

class HttpServer {
 public:
  using Json = nlohmann::json;

  explicit HttpServer(std::vector<std::string> certificate = {}) : certificate_(std::move(certificate)) {
    become("ok");
    start();
  }
  /// What it does with each request from now on: http_server.py.
  void become(const std::string& mode) {
    folder_.write("mode.new", mode);
    std::filesystem::rename(folder_.path() + "/mode.new", folder_.path() + "/mode");
  }
  /// On the port that it had.
  void start() {
    std::vector<std::string> words{rtdata::test::in_source("tests/sinks/http_server.py"), folder_.path()};
    words.insert(words.end(), certificate_.begin(), certificate_.end());
    process_.emplace(folder_, python, words);
    REQUIRE_MESSAGE(process_->wait_for("listening"), process_->err);
  }
  void kill() { process_.reset(); }

  std::string port() const { return folder_.read("port"); }
  std::string url(const std::string& path = "/ingest") const { return "http://127.0.0.1:" + port() + path; }
  const rtdata::test::Folder& folder() const { return folder_; }

  /// Those that it has read.
  std::vector<Json> requests() const {
    std::vector<Json> all;
    std::istringstream lines(folder_.read("requests"));
    for (std::string line; std::getline(lines, line);) {
      if (!lines.eof()) all.push_back(Json::parse(line));  // else it is being written
    }
    return all;
  }
  std::size_t request_count() const {
    const std::string text = folder_.read("requests");
    return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
  }
  void forget() { folder_.write("requests", ""); }
  /// The events of the requests that were answered with 200, in JSON.
  std::vector<Json> events() const {
    std::vector<Json> all;
    for (const Json& request : requests()) {
      if (request["status"] != 200) continue;
      const std::string body = request["body"];
      if (body.starts_with('[')) {
        for (const Json& event : Json::parse(body)) all.push_back(event);
        continue;
      }
      std::istringstream lines(body);
      for (std::string line; std::getline(lines, line);) all.push_back(Json::parse(line));
    }
    return all;
  }
  /// The sequence numbers of the events, each once.
  std::set<std::uint64_t> sequences() const {
    std::set<std::uint64_t> all;
    for (const Json& event : events()) all.insert(event["sequence"].get<std::uint64_t>());
    return all;
  }

 private:
  rtdata::test::Folder folder_;
  std::vector<std::string> certificate_;
  std::optional<rtdata::test::Process> process_;
};

struct HttpBench {
  explicit HttpBench(rtdata::HttpConfig config,
                     const rtdata::CodecRegistry& formats = rtdata::CodecRegistry::standard()) {
    loop.on_error([this](const rtdata::ErrorReport& report) {
      if (report.error.code != rtdata::Errc::held_too_long) errors.push_back(report.error);
    });
    loop.runtime().on_log([this](const rtdata::LogRecord& record) {
      log += std::string(record.object) + ": " + std::string(record.text) + "\n";
    });
    config.sink.batch_time = std::chrono::milliseconds{10};
    sink = rtdata::HttpSink(loop, config, formats);
    feed = rtdata::Feed<Number>(loop, {.name = "chamber", .topic = "test/number"});
    loop.advance(std::chrono::milliseconds{1});
  }
  /// Events with the values 1, 2, 3 and so on.
  void publish(int count) {
    for (int i = 0; i < count; ++i) feed.publish(Number{static_cast<double>(++published)});
    loop.advance(std::chrono::milliseconds{20});
  }
  bool is_all_sent() {
    return wait_for(loop, [&] { return sink.counts().stored + sink.counts().all_dropped() == published; });
  }
  bool is_faulted() {
    return wait_for(loop, [&] { return sink.health() == rtdata::Health::faulted; });
  }
  std::string reason() const { return sink.status().reason; }
  /// Everything that was said.
  std::string said() const {
    std::string all = log + reason();
    for (const rtdata::Error& error : errors) all += error.text() + "\n";
    return all;
  }
  std::set<std::uint64_t> all() const {
    std::set<std::uint64_t> numbers;
    for (std::uint64_t i = 1; i <= published; ++i) numbers.insert(i);
    return numbers;
  }

  rtdata::Loop loop{rtdata::Loop::Manual{}};
  std::vector<rtdata::Error> errors;
  std::string log;
  rtdata::HttpSink sink;
  rtdata::Feed<Number> feed;
  std::uint64_t published = 0;
};

}  // namespace sinks
