// The clients that read events of a running instance through its control socket (docs/subscribe.md), and the thread
// that serves them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <future>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "app/control/event_stream.hpp"
#include "app/control/live_feed.hpp"
#include "rtdata/loop/loop.hpp"
#include "rtdata/loop/timer.hpp"

namespace rtdata::app {

/// Serves readers on a thread of its own, made for the first of them, with the least priority that shares the processor
/// (nice 19). It makes the text and sends it; events for which it has no time are dropped, counted and reported to the
/// reader. The loop makes one copy of each event, for any number of readers. Neither waits for the other.
///
/// A reader that begins before now gets recorded events, then live ones, each once, by origin and sequence. For the
/// change, the thread requests a mark between the live events. Events published before the mark had been offered to the
/// recording by then; when it has stored them, all events before the mark can be read.
/// Events after the mark are kept meanwhile; those that have been read already are skipped.
///
/// Memory: a ring of 4 MiB, and about 256 KiB per reader; 5 MiB while it reads recorded events.
///
/// Owner: the program; gone before the loop's runtime is. Thread: the loop's.
class Readers {
 public:
  /// `run`: what names the run to readers, a uuid. `most`: readers at a time.
  Readers(Loop& loop, std::string run);
  Readers(const Readers&) = delete;
  Readers& operator=(const Readers&) = delete;
  /// Tells them that the run has ended.
  ~Readers();

  /// A sink whose file has the earlier events.
  struct Recording {
    std::string sink, path;
    std::vector<std::string> topics;  ///< patterns that it takes
  };
  struct Settings {
    std::size_t most = 0;  ///< readers at a time
    std::vector<Recording> recordings = {};
  };
  /// Sets the limit for later readers.
  void set(Settings settings) { settings_ = std::move(settings); }
  /// The reason why this reader is refused; empty: it is not.
  std::string refusal(const StreamRequest& request) const;
  /// From now on the connection, a descriptor that never blocks, is this object's.
  void add(int fd, StreamRequest request);

 private:
  struct Shared;
  /// The number of events offered to the recordings when a mark was put, by name.
  struct Mark {
    std::uint64_t number = 0;
    std::map<std::string, std::uint64_t> offered;
  };
  const Recording* recording_for(const StreamRequest& request) const;
  void look();
  void put_marks();

  Loop& loop_;
  Settings settings_;
  LiveFeed feed_;
  std::deque<Mark> marks_;  // whose events are not all stored
  std::uint64_t marked_ = 0;
  std::shared_ptr<Shared> shared_;
  Ticker looking_;  // while there are readers
  std::thread thread_;
  std::future<void> ended_;
};

}  // namespace rtdata::app
