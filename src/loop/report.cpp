// What a runtime tells of: log lines, errors met at run time with their repeats joined, changes of health.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <string>
#include <utility>

#include "loop/loop_core.hpp"
#include "loop/runtime_core.hpp"
#include "rtdata/loop/health.hpp"

namespace rtdata::detail {

void RuntimeCore::tell_hub(Callback<void()> what) {
  constexpr std::uint32_t most_under_way = 1000;  // to a main loop that does not take them
  if (hub->reports_under_way_.fetch_add(1, std::memory_order_relaxed) >= most_under_way) {
    hub->reports_under_way_.fetch_sub(1, std::memory_order_relaxed);
    hub->reports_dropped_.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  hub->own_loop->post([hub = hub, what = std::move(what)]() mutable {
    hub->reports_under_way_.fetch_sub(1, std::memory_order_relaxed);
    if (const auto dropped = hub->reports_dropped_.exchange(0, std::memory_order_relaxed)) {
      hub->log(
          LogLevel::warning, "log",
          std::to_string(dropped) + " lines, errors and changes of health of tiers were dropped: too many at once");
    }
    what();
  });
}

void RuntimeCore::log(LogLevel level, std::string_view object, std::string_view told,
                      std::string_view error_id) noexcept try {
  const std::string without = config.secrets.empty() ? std::string() : hide(std::string(told));
  const std::string_view text = config.secrets.empty() ? told : std::string_view(without);
  if (hub != nullptr && !on_log) {
    return tell_hub([hub = hub, level, object = std::string(object), text = std::string(text),
                     id = std::string(error_id)] { hub->log(level, object, text, id); });
  }
  const char* note = "";
  if (on_log) {
    try {
      return on_log({level, event_time(clock_->monotonic()), object, text, error_id});
    } catch (...) {  // whoever is told of it would tell the log
      note = " (and the handler of log records threw)";
    }
  } else if (level < LogLevel::warning) {
    return;
  }
  std::fprintf(stderr, "rtdata: %s: %.*s: %.*s%s\n", level == LogLevel::error ? "error" : "warning",
               static_cast<int>(object.size()), object.data(), static_cast<int>(text.size()), text.data(), note);
} catch (...) {  // out of memory: nothing is left to tell it to
}

void RuntimeCore::report_all_kept() {
  while (!kept_.empty()) {  // a report may bring others
    const Kept kept = std::move(kept_.front());
    kept_.erase(kept_.begin());
    if (kept.listener == nullptr) {
      report(kept.loop, kept.object, kept.error);
    } else if (std::find(listeners.begin(), listeners.end(), kept.listener) != listeners.end()) {
      kept.listener->on_refusal(kept.error);
    }
  }
}

void RuntimeCore::report(LoopCore* loop, std::string_view object, const Error& error) {
  constexpr std::size_t most_remembered = 256;
  const MonotonicTime now = clock_->monotonic();
  for (Repeat& repeat : repeats_) {
    if (repeat.object != object || repeat.error.code != error.code) continue;
    if (now - repeat.last_written < std::chrono::seconds{1}) {
      repeat.error = error;  // the latest is written
      if (repeat.held_back++ == 0 && loop != nullptr)
        loop->flush_repeats_at(repeat.last_written + std::chrono::seconds{1});
      return;
    }
    const std::uint64_t count = repeat.held_back + 1;
    repeat.held_back = 0;
    repeat.last_written = now;
    write(loop, object, error, count);
    return;
  }
  if (repeats_.size() >= most_remembered) {
    flush_repeats(Repeats::all);
    repeats_.clear();
  }
  repeats_.push_back({std::string(object), error, now, 0});
  write(loop, object, error, 1);
}

namespace {

/// What of it fits, whole characters only.
template <std::size_t N>
text<N> fitting(std::string_view content) {
  std::size_t size = std::min(content.size(), N);
  while (size < content.size() && size > 0 && (static_cast<unsigned char>(content[size]) & 0xc0U) == 0x80U) --size;
  return text<N>(content.substr(0, size));
}

}  // namespace

void RuntimeCore::health_changed(std::string_view kind, std::string_view name, Health health,
                                 std::string_view reason) noexcept try {
  const HealthChange change{fitting<16>(kind), fitting<200>(name), health, fitting<96>(hide(std::string(reason)))};
  const Time time = event_time(clock_->monotonic());
  for (Listener* listener : listeners) listener->on_health(time, change);
  publish_from_program(topic(health_topic, payload_type<HealthChange>()), &change);
} catch (...) {  // out of memory, or the program has taken the name for another topic: health() of the object tells it
}

void RuntimeCore::flush_repeats(Repeats which) {
  const MonotonicTime now = clock_->monotonic();
  for (std::size_t i = 0; i < repeats_.size(); ++i) {
    if (repeats_[i].held_back == 0 ||
        (which == Repeats::old && now - repeats_[i].last_written < std::chrono::seconds{1})) {
      continue;
    }
    const Repeat repeat = repeats_[i];
    repeats_[i].held_back = 0;
    repeats_[i].last_written = now;
    write(nullptr, repeat.object, repeat.error, repeat.held_back);
  }
}

void RuntimeCore::write(LoopCore* loop, std::string_view object, const Error& met, std::uint64_t count) noexcept try {
  const auto shown = [&] { return Error{met.code, hide(met.what), hide(met.where), hide(met.why), hide(met.advice)}; };
  const Error error = config.secrets.empty() ? met : shown();
  const Time time = event_time(clock_->monotonic());
  for (Listener* listener : listeners) listener->on_error(time, object, error, count);
  if (loop == nullptr) loop = own_loop;
  if (loop != nullptr && loop->on_error) {
    try {  // an error met in it goes to the log, rather than round in a circle
      loop->on_error({object, error, count});
    } catch (...) {
      log(LogLevel::error, object, error.text() + " (and the handler of errors threw)", error.id());
    }
    return;
  }
  std::string text = error.text();
  if (count > 1) text += " (" + std::to_string(count) + " times)";
  log(LogLevel::error, object, text, error.id());
} catch (...) {  // out of memory: nothing is left to tell it to
}

}  // namespace rtdata::detail
