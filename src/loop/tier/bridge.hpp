// A bridge: copies events from one loop to another through a ring. There is one for each ordered pair of loops.
//
//   1. The sending side announces each topic of its loop, and each origin of whose name its loop is (a short
//      lock; no event is on its way yet).
//   2. The receiving side makes topic and origin of the same names, the mirrors. Whether anybody there wants the
//      topic's events is a flag of its channel, which the sending side looks at for each event.
//   3. Events, gaps, ended segments and accounts go through the ring in the order in which they happened. A full ring
//      drops the event and counts it with its sensor; before the sensor's next event, or with its next account, goes
//      how many there were.
//   4. After the sending loop's callbacks, or earlier when much waits, all that waits can be seen by the receiving
//      loop, which is woken once for it: through the kernel only when it sleeps (wake.hpp).
#pragma once

#include "loop/tier/bridge_receiver.hpp"
#include "loop/tier/bridge_sender.hpp"
#include "loop/tier/byte_ring.hpp"

namespace rtdata::detail {

class Bridge {
 public:
  /// Called at set-up, while neither loop runs, or while one waits for the other.
  Bridge(LoopCore& from, LoopCore& to, std::size_t ring_bytes);
  /// As above.
  ~Bridge();
  Bridge(const Bridge&) = delete;
  Bridge& operator=(const Bridge&) = delete;

  LoopCore& from() const noexcept { return from_; }
  LoopCore& to() const noexcept { return to_; }

  // On either thread, while none of the loops turns
  /// The receiving side takes all records in the ring.
  void hand_over();
  /// Sends the accounts that the sending loop has not sent yet, and lets the receiving side take all of it.
  void finish();

 private:
  LoopCore& from_;
  LoopCore& to_;
  ByteRing ring_;

 public:
  BridgeSender sending;
  BridgeReceiver receiving;
};

}  // namespace rtdata::detail
