// A program whose events go through a recording to a peer that a test scripts.
#pragma once

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sinks/sender.hpp"
#include "sinks/recordings.hpp"
#include "sinks/scripted_peer.hpp"
#include "sinks/sink_kinds.hpp"

namespace sinks {

using namespace rtdata;
using namespace std::chrono_literals;

/// What the peer of all runs has.
using Peer = std::shared_ptr<ScriptedPeer::Script>;

/// It takes everything but while it is away.
inline Peer peer_away_while(const bool& is_away) {
  auto peer = std::make_shared<ScriptedPeer::Script>();
  peer->take_unless(is_away);
  return peer;
}

/// A recording, and a sink that goes through it to that peer, in virtual time.
struct Run {
  Loop loop{Loop::Manual{}};
  std::vector<std::string> errors, log;
  SqliteSink recording;
  Sink sink;

  Run(const std::string& path, const Peer& peer, SinkConfig config = {.name = "peer"}, SqliteConfig file = {}) {
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    loop.runtime().on_log([this](const LogRecord& entry) { log.push_back(std::string(entry.text)); });
    file.path = path;
    file.sink.name = "recording";
    if (file.sink.topics == std::vector<std::string>{"#"}) file.sink.batch_time = 1s;
    recording = SqliteSink(loop, file);
    config.through = "recording";
    config.retry_first = 100ms;
    config.retry_longest = 1s;
    sink = Sink(loop, config, std::make_unique<ScriptedPeer>(peer));
  }
  void publish(int count, const std::string& topic = "a") {
    for (int i = 0; i < count; ++i) loop.topic<Number>(topic).publish({++published});
  }
  double published = 0;
};

/// Each event once, in order of its origin, without a hole; how many there are.
inline std::size_t count_all_once(const ScriptedPeer::Script& peer) {
  std::map<std::string, std::uint64_t> last;
  std::size_t holes = 0;
  for (const auto& event : peer.events) {
    std::uint64_t& before = last[event.run + " " + event.topic + " " + event.origin];
    holes += event.sequence != before + 1;
    before = event.sequence;
  }
  CHECK(holes == 0);
  return peer.events.size();
}

inline bool has(const std::vector<std::string>& texts, const std::string& part) {
  return std::any_of(texts.begin(), texts.end(), [&](const std::string& text) { return text.find(part) != text.npos; });
}

}  // namespace sinks
