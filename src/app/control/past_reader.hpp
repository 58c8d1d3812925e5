// What a recording has, for a stream that begins before now.
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
    std::vector<std::byte> events;  ///< PackedEvents; of the run that goes on their `run` is 0
    std::vector<std::pair<std::uint32_t, std::string>> runs;  ///< that are new in it: number and uuid
    bool has_more = false;                                    ///< by now
    std::string failed;                                       ///< why it ends here; empty: it does not
  };
  virtual ~PastReader() = default;
  /// The next 256 KiB at most, in a transaction of about 100 ms. Blocks on the disk.
  virtual Slice read() noexcept = 0;
};

/// `run`: the uuid of the run that goes on.
std::unique_ptr<PastReader> make_past_reader(std::string path, std::vector<std::string> topics, Time from,
                                             std::string run);

}  // namespace rtdata::app
