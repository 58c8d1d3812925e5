/// Watches: a file descriptor, a signal.
///
///     rtdata::FdWatch readable(loop, fd, rtdata::FdWatch::readable, [&](const rtdata::FdEvent&) { ... });
///     rtdata::SignalWatch ctrl_c(loop, SIGINT, [&] { loop.stop(); });
///
/// Owner: the holder of the handle (rules: handle.hpp). Thread: the loop's.
#pragma once

#include <string>

#include "rtdata/loop/callback.hpp"
#include "rtdata/loop/handle.hpp"
#include "rtdata/loop/loop.hpp"

namespace rtdata {

struct FdEvent {
  bool readable = false;
  bool writable = false;
  bool hung_up = false;  ///< the other side closed, or the device went away
};

/// Calls back while the descriptor is ready (level-triggered). The user keeps owning the descriptor: it becomes
/// non-blocking and is not closed by the watch; close the watch before the descriptor. Only one watch for each
/// descriptor. After an error of the descriptor (the last call had `hung_up`) there are no more calls until
/// `set_events`.
class FdWatch : public Handle {
 public:
  enum Events : unsigned { readable = 1, writable = 2, readable_and_writable = 3 };
  FdWatch() noexcept = default;
  /// Errors: SetupError (bad-argument) for a descriptor that cannot be watched (a regular file, a closed one).
  FdWatch(Loop& loop, int fd, Events events, Callback<void(const FdEvent&)> callback);
  FdWatch(Loop& loop, int fd, Events events, std::string name, Callback<void(const FdEvent&)> callback);
  void set_events(Events events);
};

/// Calls back on the loop when the process gets the signal. A loop never handles signals by itself.
class SignalWatch : public Handle {
 public:
  SignalWatch() noexcept = default;
  /// Errors: SetupError (bad-argument) for a signal that cannot be caught.
  SignalWatch(Loop& loop, int signal_number, Callback<void()> callback);
};

}  // namespace rtdata
