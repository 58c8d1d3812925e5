#include "loop/core/blame.hpp"

#include <chrono>

#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration recovered_after = std::chrono::seconds{10};

}  // namespace

Blame::Blame(LoopCore& loop, Duration limit) : loop_(loop), limit_(limit) { loop_.deadlines.reserve_one(); }

Blame::~Blame() { loop_.deadlines.remove(recovery_); }

void Blame::report(const std::string& name, Duration took) {
  const std::string lasted = "held the loop for " + to_string(took / 1000 * 1000);
  const std::string place = loop_.runtime.reports.place_of(name);
  held_last_ = loop_.now();
  if (!recovery_.is_listed()) {
    loop_.runtime.health_changed("loop", loop_.config.name, Health::degraded, name + " " + lasted);
    recovery_.due = later(held_last_, recovered_after);
    loop_.deadlines.insert(recovery_);
  }
  loop_.runtime.report(&loop_, name,
                       {Errc::held_too_long, lasted, (place.empty() ? "" : place + ": ") + "loop " + loop_.config.name,
                        "its limit is " + to_string(limit_),
                        "make it shorter, or do the slow part elsewhere; the ticks it cost are counted as missed"});
}

void Blame::Recovery::fire(MonotonicTime now) {
  LoopCore& loop = blame.loop_;
  if (const MonotonicTime at = later(blame.held_last_, recovered_after); at > now) {
    due = at;
    loop.deadlines.moved(*this);
    return;
  }
  loop.deadlines.remove(*this);
  loop.runtime.health_changed("loop", loop.config.name, Health::ok, "");
}

}  // namespace rtdata::detail
