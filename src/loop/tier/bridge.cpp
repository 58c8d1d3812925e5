#include "loop/tier/bridge.hpp"

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {

Bridge::Bridge(LoopCore& from, LoopCore& to, std::size_t ring_bytes)
    : from_(from), to_(to), ring_(ring_bytes), sending(*this, from, to, ring_), receiving(from, to, ring_) {
  from_.runtime.outbound.push_back(this);
  to_.runtime.inbound.push_back(this);
}

Bridge::~Bridge() {
  to_.runtime.exchange.forget(*this);
  std::erase(from_.runtime.outbound, this);
  std::erase(to_.runtime.inbound, this);
}

void Bridge::hand_over() {
  sending.wake();
  receiving.receive();
}

void Bridge::finish() {
  hand_over();
  std::size_t before = SIZE_MAX;
  for (std::size_t left = sending.send_accounts(); left > 0 && left < before; left = sending.send_accounts()) {
    receiving.receive();
    before = left;
  }
  receiving.receive();
  sending.report_lost_entries(to_);
}

}  // namespace rtdata::detail
