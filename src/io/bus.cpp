#include "rtdata/io/bus.hpp"

#include <map>
#include <mutex>

#include "loop/core/lane_thread.hpp"
#include "rtdata/detail/loop/lane.hpp"

namespace rtdata {

void TransferCounter::add(Duration took, bool is_good, std::uint64_t retries) noexcept {
  constexpr auto relaxed = std::memory_order_relaxed;
  transfers_.fetch_add(1, relaxed);
  if (!is_good) failed_.fetch_add(1, relaxed);
  retried_.fetch_add(retries, relaxed);
  busy_.fetch_add(took.count(), relaxed);
  std::int64_t longest = longest_.load(relaxed);
  while (longest < took.count() && !longest_.compare_exchange_weak(longest, took.count(), relaxed)) {
  }
}

TransferCounts TransferCounter::counts() const noexcept {
  constexpr auto relaxed = std::memory_order_relaxed;
  return {transfers_.load(relaxed),         failed_.load(relaxed),
          retried_.load(relaxed),           Duration{busy_.load(relaxed)},
          Duration{longest_.load(relaxed)}, skipped_.load(relaxed)};
}

struct Bus::Places {
  struct Place {
    bool is_claimed = false;
    std::shared_ptr<TransferCounter> counter = std::make_shared<TransferCounter>();
  };
  std::mutex mutex;
  std::map<std::string, Place> all;
};

Bus::Bus(std::string name, Duration give_up_after)
    : name_(std::move(name)),
      give_up_after_(give_up_after),
      lane_thread_(std::make_shared<detail::LaneThread>()),
      places_(std::make_shared<Places>()) {}

Bus::~Bus() = default;

std::shared_ptr<void> Bus::claim(const std::string& place) {
  if (place.empty()) return nullptr;
  const std::lock_guard lock(places_->mutex);
  if (std::exchange(places_->all[place].is_claimed, true)) {
    throw SetupError({Errc::busy, "cannot use this place of a bus", "bus " + name_ + ", " + place,
                      "another sensor has it", "give each sensor its own chip"});
  }
  return {nullptr, [places = places_, place](void*) {
            const std::lock_guard lock_(places->mutex);
            places->all[place].is_claimed = false;
          }};
}

std::shared_ptr<TransferCounter> Bus::counter_of(const std::string& place) const {
  const std::lock_guard lock(places_->mutex);
  return places_->all[place].counter;
}

std::vector<PlaceCounts> Bus::place_counts() const {
  std::vector<PlaceCounts> all;
  const std::lock_guard lock(places_->mutex);
  for (const auto& [name, place] : places_->all) all.push_back({name, place.counter->counts()});
  return all;
}

TransferCounts Bus::counts_of(const std::string& place) const {
  const std::lock_guard lock(places_->mutex);
  const auto found = places_->all.find(place);
  return found != places_->all.end() ? found->second.counter->counts() : TransferCounts{};
}

void BusDevice::wait(Duration duration) const noexcept { detail::lane_sleep(duration); }

void BusDevice::note_request() noexcept {
  if (!asked_) asked_ = detail::lane_now();
}

}  // namespace rtdata
