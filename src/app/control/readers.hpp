// Those who read events of a running instance through its control socket (docs/subscribe.md), and the thread that serves
// them.
#pragma once

#include <cstddef>
#include <future>
#include <memory>
#include <string>
#include <thread>

#include "app/control/event_stream.hpp"
#include "app/control/live_feed.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::app {

/// Serves readers on a thread of its own, made for the first of them, with the least priority that shares the processor
/// (nice 19). It makes the text and sends it; what it does not come to is dropped, counted and told to the reader. The
/// loop pays for a copy of each event, whether one reads it or all; it never waits for the thread, nor that for it.
///
/// Memory: a ring of 4 MiB, and about 256 KiB a reader.
///
/// Owner: the program; gone before the loop's runtime is. Thread: the loop's.
class Readers {
 public:
  /// `run`: what names the run to readers, a uuid. `most`: readers at a time.
  Readers(Loop& loop, std::string run, std::size_t most);
  Readers(const Readers&) = delete;
  Readers& operator=(const Readers&) = delete;
  /// Tells them that the run has ended.
  ~Readers();

  /// From the next one on.
  void set_most(std::size_t most) noexcept { most_ = most; }
  /// Why one more is refused; empty: it is not.
  std::string refusal() const;
  /// From now on the connection, a descriptor that never blocks, is this object's.
  void add(int fd, StreamRequest request);

 private:
  struct Shared;
  void look();

  Loop& loop_;
  std::size_t most_;
  LiveFeed feed_;
  std::shared_ptr<Shared> shared_;
  Ticker looking_;  // while there are readers
  std::thread thread_;
  std::future<void> ended_;
};

}  // namespace rtdata::app
