// Blame: what a callback took, which one runs, who held the loop; and reports that wait to be joined.
#include <algorithm>
#include <chrono>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "loop/callback_survey.hpp"
#include "loop/loop_core.hpp"
#include "loop/runtime_core.hpp"

namespace rtdata::detail {
namespace {

constexpr Duration calm_after = std::chrono::seconds{10};

}  // namespace

void LoopCore::Flusher::fire(MonotonicTime) {
  core.remove(*this);
  core.runtime.flush_repeats(RuntimeCore::Repeated::due);
}

void LoopCore::flush_repeats_at(MonotonicTime due) noexcept {
  if (flusher_.is_listed()) {
    if (flusher_.due <= due) return;
    remove(flusher_);
  }
  flusher_.due = due;
  insert(flusher_);
}

void LoopCore::report_hold(const std::string& name, Duration took) noexcept try {
  const std::string lasted = "held the loop for " + to_string(took / 1000 * 1000);
  const std::string place = runtime.place_of(name);
  held_last_ = now();
  if (!calm_.is_listed()) {
    runtime.health_changed("loop", config.name, Health::degraded, name + " " + lasted);
    calm_.due = later(held_last_, calm_after);
    insert(calm_);
  }
  runtime.report(this, name,
                 {Errc::held_too_long, lasted, (place.empty() ? "" : place + ": ") + "loop " + config.name,
                  "its limit is " + to_string(config.hold_limit),
                  "make it shorter, or do the slow part elsewhere; the ticks it cost are counted as missed"});
} catch (...) {  // out of memory: it is counted all the same
}

void LoopCore::Calm::fire(MonotonicTime now) {
  if (const MonotonicTime calm_at = later(core.held_last_, calm_after); calm_at > now) {
    due = calm_at;
    core.moved(*this);
    return;
  }
  core.remove(*this);
  core.runtime.health_changed("loop", core.config.name, Health::ok, "");
}

std::vector<CallbackStatus> LoopCore::callbacks() const {
  std::vector<CallbackStatus> all;
  for (const Node* node = nodes_; node != nullptr; node = node->next_) {
    CallbackStatus status;
    if (!node->tell_times(status)) continue;
    status.place = runtime.place_of(status.name);
    all.push_back(std::move(status));
  }
  std::reverse(all.begin(), all.end());
  return all;
}

std::string LoopCore::doing() const {
  const std::lock_guard lock(doing_mutex_);
  const Node* node = doing_.load(std::memory_order_acquire);
  return node != nullptr ? node->callback_name() : std::string();
}

std::shared_ptr<CallbackSurvey> CallbackSurvey::begin(LoopCore& loop) {
  auto survey = std::make_shared<CallbackSurvey>();
  loop.post([&loop, survey] {
    loop.surveys_.push_back(survey);
    survey->next_ = loop.nodes_;
    loop.go_on(survey);
  });
  return survey;
}

void LoopCore::go_on(const std::shared_ptr<CallbackSurvey>& survey) {
  for (std::size_t i = 0; i < CallbackSurvey::most_in_turn && survey->next_ != nullptr; ++i) {
    const Node* node = std::exchange(survey->next_, survey->next_->next_);
    CallbackStatus status;
    if (!node->tell_times(status) || status.times.count == 0) continue;
    status.place = runtime.place_of(status.name);
    survey->callbacks_.push_back(std::move(status));
  }
  if (survey->next_ != nullptr) return post([this, survey] { go_on(survey); });
  std::erase(surveys_, survey);
  std::reverse(survey->callbacks_.begin(), survey->callbacks_.end());
  survey->done_.set();
}

void LoopCore::report_exception(std::string_view name, const char* what) noexcept {
  try {
    runtime.report(this, name, {Errc::handler_threw, "a callback threw", "", what, "it goes on being called"});
  } catch (...) {  // the report itself ran out of memory, or its handler threw: nothing is left to tell it to
  }
}

}  // namespace rtdata::detail
