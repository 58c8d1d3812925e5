#include "rtdata/io/bus.hpp"

#include <mutex>
#include <set>

#include "loop/core/lane_thread.hpp"
#include "rtdata/loop/lane.hpp"

namespace rtdata {

struct Bus::Claims {
  std::mutex mutex;
  std::set<std::string> places;
};

Bus::Bus(std::string name, Duration give_up_after)
    : name_(std::move(name)),
      give_up_after_(give_up_after),
      lane_thread_(std::make_shared<detail::LaneThread>()),
      claims_(std::make_shared<Claims>()) {}

Bus::~Bus() = default;

std::shared_ptr<void> Bus::claim(const std::string& place) {
  const std::lock_guard lock(claims_->mutex);
  if (!claims_->places.insert(place).second) {
    throw SetupError({Errc::busy, "cannot use this place of a bus", "bus " + name_ + ", " + place,
                      "another sensor has it", "two sensors cannot be one chip; give each a place of its own"});
  }
  return {nullptr, [claims = claims_, place](void*) {
            const std::lock_guard lock_(claims->mutex);
            claims->places.erase(place);
          }};
}

void BusDevice::wait(Duration duration) const noexcept { detail::lane_sleep(duration); }

}  // namespace rtdata
