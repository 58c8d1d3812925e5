// The recorded events, for a stream that begins before now.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "rtdata/data/time.hpp"

namespace rtdata::app {

/// Owner: the stream's, which keeps it as long as it uses the events. Thread: one at a time.
class PastReader {
 public:
  struct Slice {
    std::vector<std::byte> events;                            ///< PackedEvents, with the number of their run
    std::vector<std::pair<std::uint32_t, std::string>> runs;  ///< new ones: number and uuid; the last is still recorded
    bool has_more = false;                                    ///< more is stored by now
    std::string failed;                                       ///< the reason why reading ends here; empty: it continues
  };
  virtual ~PastReader() = default;
  /// The next 256 KiB at most, in a transaction of about 100 ms. Blocks on the disk.
  virtual Slice read() noexcept = 0;
};

/// A reader of the recording in this file, which a sink of this program writes.
std::unique_ptr<PastReader> make_past_reader(std::string path, std::vector<std::string> topics, Time from);

}  // namespace rtdata::app
