// Each sender whose peer answers, at such a peer.
#pragma once

#include <doctest/doctest.h>

#include <functional>
#include <string>
#include <vector>

#include "rtdata/loop/timer.hpp"
#include "rtdata/sinks/tcp.hpp"
#include "sinks/answering_peer.hpp"
#include "sinks/sink_kinds.hpp"

namespace sinks {

using namespace rtdata;
using namespace std::chrono_literals;

inline constexpr Duration answer_timeout = std::chrono::seconds{2};
inline const SinkConfig sink_config{.name = "peer", .batch_time = 10ms, .retry_longest = 1s};

struct AnsweredSender {
  const char* name;
  Answering answering;
  std::function<Sink(Loop&, const std::string& host, std::uint16_t port)> make;
};

std::vector<AnsweredSender> answered_senders();

/// One of them at a peer that answers, in virtual time, beside a ticker.
struct AnsweredBench {
  explicit AnsweredBench(const AnsweredSender& kind, const std::string& host = "127.0.0.1") : peer(kind.answering) {
    loop.on_error([this](const ErrorReport& report) { errors.push_back(report.error.text()); });
    sink = kind.make(loop, host, peer.port());
  }
  void publish(int count) {
    for (int i = 0; i < count; ++i) loop.topic<Number>("a").publish({++published});
  }
  template <class Done>
  bool wait_for(Done&& done, int turns = 3000) {
    for (int i = 0; i < turns && !done(); ++i) {
      loop.advance(10ms);
      loop.poll();
      peer.look();
    }
    return done();
  }
  bool has_all() const {
    for (int i = 1; i <= static_cast<int>(published); ++i) {
      if (peer.got().find("\"value\":" + std::to_string(i)) == std::string::npos) return false;
    }
    return true;
  }

  std::vector<std::string> errors;
  Loop loop{Loop::Manual{}};
  Peer peer;
  Sink sink;
  double published = 0;
  std::uint64_t missed = 0;
  Ticker ticker{loop, 10ms, [this](const Tick& tick) { missed += tick.missed; }};
};

}  // namespace sinks
