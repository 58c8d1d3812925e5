// What a runtime tells of: log lines, errors met at run time with their repeats joined, changes of health.
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <new>
#include <string>
#include <utility>

#include "loop/fitting.hpp"
#include "loop/loop_core.hpp"
#include "loop/runtime_core.hpp"
#include "rtdata/loop/health.hpp"

namespace rtdata::detail {

namespace {

/// What cannot be told for want of memory is told without any.
void tell_of_no_memory() noexcept {
  static constexpr char line[] = "rtdata: error: out of memory: something that is to be told cannot be told\n";
  [[maybe_unused]] const auto written = ::write(STDERR_FILENO, line, sizeof line - 1);
}

}  // namespace

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
  const std::string without = secrets.empty() ? std::string() : hide(std::string(told));
  const std::string_view text = secrets.empty() ? told : std::string_view(without);
  if (hub != nullptr && !on_log) {
    return tell_hub([hub = hub, level, object = std::string(object), text = std::string(text),
                     id = std::string(error_id)] { hub->log(level, object, text, id); });
  }
  const std::string key = std::string(object) + '\n' + std::string(text);
  LogLine line{level, std::string(object), std::string(text), std::string(error_id)};
  if (auto joined = lines_.take(key, std::move(line), clock_->monotonic())) return log_line(*joined);
  flush_repeats_at(lines_.held_until());
} catch (...) {
  tell_of_no_memory();
}

void RuntimeCore::log_line(const Joined<LogLine>& joined) noexcept try {
  const auto& [level, object, said, error_id] = joined.what;
  const std::string text = joined.count == 1 ? said : said + " (" + std::to_string(joined.count) + " times)";
  const char* note = "";
  if (on_log) {
    const LoopCore::Calling user_code(*this);
    try {
      return on_log({level, event_time(clock_->monotonic()), object, text, error_id});
    } catch (...) {  // whoever is told of it would tell the log
      note = " (and the handler of log records threw)";
    }
  } else if (level < LogLevel::warning) {
    return;
  }
  std::fprintf(stderr, "rtdata: %s: %s: %s%s\n", level == LogLevel::error ? "error" : "warning", object.c_str(),
               text.c_str(), note);
} catch (...) {
  tell_of_no_memory();
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

void RuntimeCore::attach(LoopCore& loop) {
  loop.deadlines.reserve_one();
  own_loop = &loop;
}

void RuntimeCore::forget(LoopCore& loop) noexcept {
  for (const auto& topic : topics_) topic->abandon();
  loop.deadlines.remove(flusher_);
  for (Kept& kept : kept_) {
    if (kept.loop == &loop) kept.loop = nullptr;
  }
  own_loop = nullptr;
  try {
    report_kept();
  } catch (...) {
    tell_of_no_memory();
  }
}

void RuntimeCore::report(LoopCore* loop, std::string_view object, const Error& error) {
  const std::string key = std::string(object) + '\n' + std::string(error.id());
  if (auto joined = errors_.take(key, {std::string(object), error}, clock_->monotonic())) return write(loop, *joined);
  flush_repeats_at(errors_.held_until());
}

void RuntimeCore::flush_repeats_at(MonotonicTime due) noexcept {
  if (own_loop == nullptr || (flusher_.is_listed() && flusher_.due <= due)) return;
  own_loop->deadlines.remove(flusher_);
  flusher_.due = due;
  own_loop->deadlines.insert(flusher_);
}

void RuntimeCore::Flusher::fire(MonotonicTime) {
  runtime.own_loop->deadlines.remove(*this);
  runtime.flush_repeats(Repeated::due);
}

namespace {

template <std::size_t N>
text<N> fitting(std::string_view content) {
  std::array<char, N> bytes{};
  return text<N>(std::string_view(bytes.data(), put_fitting(bytes.data(), N, content)));
}

}  // namespace

void RuntimeCore::health_changed(std::string_view kind, std::string_view name, Health health,
                                 std::string_view reason) noexcept try {
  const HealthChange change{fitting<16>(kind), fitting<200>(name), health, fitting<96>(hide(std::string(reason)))};
  const std::string key = std::string(kind) + '\n' + std::string(name);
  if (auto joined = changes_.take(key, change, clock_->monotonic())) {
    write(*joined);
  } else {
    flush_repeats_at(changes_.held_until());
  }
  publish_from_program(topic(health_topic, payload_type<HealthChange>()), &change);
} catch (const std::bad_alloc&) {
  tell_of_no_memory();
} catch (...) {  // the program has taken the name for another topic: health() of the object tells it
}

void RuntimeCore::flush_repeats(Repeated which) noexcept try {
  const MonotonicTime now = clock_->monotonic();
  const bool is_all = which == Repeated::all;
  const auto errors = is_all ? errors_.take_all() : errors_.take_due(now);
  const auto lines = is_all ? lines_.take_all() : lines_.take_due(now);
  for (const auto& change : is_all ? changes_.take_all() : changes_.take_due(now)) write(change);
  // Before user code runs, which may close the loop. Not at once, since there may be thousands.
  for (const auto next : {errors_.next_due(), lines_.next_due(), changes_.next_due()}) {
    if (next) flush_repeats_at(std::max(*next, later(now, std::chrono::milliseconds{250})));
  }
  for (const auto& error : errors) write(nullptr, error);
  for (const auto& line : lines) log_line(line);
} catch (...) {
  tell_of_no_memory();
}

void RuntimeCore::write(const Joined<HealthChange>& joined) noexcept {
  for (Listener* listener : listeners)
    listener->on_health(event_time(joined.first), event_time(joined.last), joined.what, joined.count);
}

void RuntimeCore::write(LoopCore* loop, const Joined<ObjectError>& joined) noexcept try {
  const auto& [object, met] = joined.what;
  const auto shown = [&, &met = met] {
    return Error{met.code, hide(met.what), hide(met.where), hide(met.why), hide(met.advice)};
  };
  const Error error = secrets.empty() ? met : shown();
  for (Listener* listener : listeners)
    listener->on_error(event_time(joined.first), event_time(joined.last), object, error, joined.count);
  if (loop == nullptr) loop = own_loop;
  if (loop != nullptr && loop->on_error) {
    const LoopCore::Calling user_code(*this);
    try {  // an error met in it goes to the log, rather than round in a circle
      loop->on_error({object, error, joined.count});
    } catch (...) {
      log(LogLevel::error, object, error.text() + " (and the handler of errors threw)", error.id());
    }
    return;
  }
  if (hub != nullptr && !on_log) {
    return tell_hub([hub = hub, object = object, error, count = joined.count] {
      hub->log_line(
          {{LogLevel::error, hub->hide(object), hub->hide(error.text()), std::string(error.id())}, {}, {}, count});
    });
  }
  log_line({{LogLevel::error, hide(object), error.text(), std::string(error.id())}, {}, {}, joined.count});
} catch (...) {
  tell_of_no_memory();
}

}  // namespace rtdata::detail
