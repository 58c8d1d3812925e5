#include "loop/runtime/reports.hpp"

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <new>
#include <string>
#include <utility>

#include "data/fitting.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

namespace {

/// Writes, without allocating, that there is no memory for a report.
void write_out_of_memory() noexcept {
  static constexpr char line[] = "rtdata: error: out of memory: a report is lost\n";
  [[maybe_unused]] const auto written = ::write(STDERR_FILENO, line, sizeof line - 1);
}

}  // namespace

void Reports::post_to_main(Callback<void()> function) {
  constexpr std::uint32_t most_under_way = 1000;
  Reports& main = runtime_.main().reports;
  if (main.under_way_.fetch_add(1, std::memory_order_relaxed) >= most_under_way) {
    main.under_way_.fetch_sub(1, std::memory_order_relaxed);
    main.dropped_.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  main.runtime_.own_loop->post([&main, function = std::move(function)]() mutable {
    main.under_way_.fetch_sub(1, std::memory_order_relaxed);
    if (const auto dropped = main.dropped_.exchange(0, std::memory_order_relaxed)) {
      main.log(
          LogLevel::warning, "log",
          std::to_string(dropped) + " lines, errors and changes of health of tiers were dropped: too many at once");
    }
    function();
  });
}

void Reports::log(LogLevel level, std::string_view object, std::string_view whole, std::string_view error_id) noexcept
    try {
  const std::string without = secrets.empty() ? std::string() : hide(std::string(whole));
  const std::string_view text = secrets.empty() ? whole : std::string_view(without);
  if (runtime_.hub != nullptr && !on_log) {
    return post_to_main([hub = runtime_.hub, level, object = std::string(object), text = std::string(text),
                         id = std::string(error_id)] { hub->log(level, object, text, id); });
  }
  const std::string key = std::string(object) + '\n' + std::string(text);
  LogLine line{level, std::string(object), std::string(text), std::string(error_id)};
  if (auto joined = lines_.take(key, std::move(line), runtime_.clock().monotonic())) return write(*joined);
  flush_at(lines_.held_until());
} catch (...) {
  write_out_of_memory();
}

void Reports::write(const Joined<LogLine>& joined) noexcept try {
  const auto& [level, object, said, error_id] = joined.what;
  const std::string text = joined.count == 1 ? said : said + " (" + std::to_string(joined.count) + " times)";
  const char* note = "";
  if (on_log) {
    const LoopCore::Calling user_code(runtime_);
    try {
      return on_log({level, runtime_.event_time(runtime_.clock().monotonic()), object, text, error_id});
    } catch (...) {  // it would be reported to the log itself
      note = " (and the handler of log records threw)";
    }
  } else if (level < LogLevel::warning) {
    return;
  }
  std::fprintf(stderr, "rtdata: %s: %s: %s\n", level == LogLevel::error ? "error" : "warning", object.c_str(),
               with_id(text + note, error_id).c_str());
} catch (...) {
  write_out_of_memory();
}

void Reports::report_all_kept() {
  while (!kept_.empty()) {  // a report may cause further ones
    const Kept kept = std::move(kept_.front());
    kept_.erase(kept_.begin());
    if (kept.listener == nullptr) {
      report(kept.loop, kept.object, kept.error);
    } else if (std::count(runtime_.listeners.begin(), runtime_.listeners.end(), kept.listener) != 0) {
      kept.listener->on_refusal(kept.error);
    }
  }
}

void Reports::attach(LoopCore& loop) { loop.deadlines.reserve_one(); }

void Reports::detach(LoopCore& loop) noexcept {
  loop.deadlines.remove(flusher_);
  for (Kept& kept : kept_) kept.loop = nullptr;
  try {
    report_kept();
  } catch (...) {
    write_out_of_memory();
  }
}

void Reports::report(LoopCore* loop, std::string_view object, const Error& error) {
  const std::string key = std::string(object) + '\n' + std::string(error.id());
  if (auto joined = errors_.take(key, {std::string(object), error}, runtime_.clock().monotonic()))
    return write(loop, *joined);
  flush_at(errors_.held_until());
}

void Reports::flush_at(MonotonicTime due) noexcept {
  LoopCore* loop = runtime_.own_loop;
  if (loop == nullptr || (flusher_.is_listed() && flusher_.due <= due)) return;
  loop->deadlines.remove(flusher_);
  flusher_.due = due;
  loop->deadlines.insert(flusher_);
}

void Reports::Flusher::fire(MonotonicTime) {
  reports.runtime_.own_loop->deadlines.remove(*this);
  reports.flush(Repeated::due);
}

void Reports::health_changed(std::string_view kind, std::string_view name, Health health,
                             std::string_view reason) noexcept try {
  const HealthChange change{fitting<16>(kind), fitting<200>(name), health, fitting<96>(hide(std::string(reason)))};
  const std::string key = std::string(kind) + '\n' + std::string(name);
  if (auto joined = changes_.take(key, change, runtime_.clock().monotonic())) {
    write(*joined);
  } else {
    flush_at(changes_.held_until());
  }
  publish_from_program(runtime_.topic(health_topic, payload_type<HealthChange>()), &change);
} catch (const std::bad_alloc&) {
  write_out_of_memory();
} catch (...) {  // the program uses the name for another topic; health() of the object still has the change
}

void Reports::flush(Repeated which) noexcept try {
  const MonotonicTime now = runtime_.clock().monotonic();
  const bool is_all = which == Repeated::all;
  const auto errors = is_all ? errors_.take_all() : errors_.take_due(now);
  const auto lines = is_all ? lines_.take_all() : lines_.take_due(now);
  for (const auto& change : is_all ? changes_.take_all() : changes_.take_due(now)) write(change);
  // Before user code runs, which may close the loop. Later, because there may be thousands.
  for (const auto next : {errors_.next_due(), lines_.next_due(), changes_.next_due()}) {
    if (next) flush_at(std::max(*next, later(now, std::chrono::milliseconds{250})));
  }
  for (const auto& error : errors) write(nullptr, error);
  for (const auto& line : lines) write(line);
} catch (...) {
  write_out_of_memory();
}

void Reports::write(const Joined<HealthChange>& joined) noexcept {
  for (Listener* listener : runtime_.listeners)
    listener->on_health(runtime_.event_time(joined.first), runtime_.event_time(joined.last), joined.what, joined.count);
}

void Reports::write(LoopCore* loop, const Joined<ObjectError>& joined) noexcept try {
  const auto& [object, met] = joined.what;
  const auto shown = [&, &met = met] {
    return Error{met.code, hide(met.what), hide(met.where), hide(met.why), hide(met.advice)};
  };
  const Error error = secrets.empty() ? met : shown();
  for (Listener* listener : runtime_.listeners)
    listener->on_error(runtime_.event_time(joined.first), runtime_.event_time(joined.last), object, error,
                       joined.count);
  if (loop == nullptr) loop = runtime_.own_loop;
  if (loop != nullptr && loop->on_error) {
    const LoopCore::Calling user_code(runtime_);
    try {  // an error in the handler goes to the log, to avoid a circle
      loop->on_error({object, error, joined.count});
    } catch (...) {
      log(LogLevel::error, object, error.text() + " (and the handler of errors threw)", error.id());
    }
    return;
  }
  if (runtime_.hub != nullptr && !on_log) {
    return post_to_main([&main = runtime_.hub->reports, object = object, error, count = joined.count] {
      main.write(Joined<LogLine>{
          {LogLevel::error, main.hide(object), main.hide(error.text()), std::string(error.id())}, {}, {}, count});
    });
  }
  write(Joined<LogLine>{{LogLevel::error, hide(object), error.text(), std::string(error.id())}, {}, {}, joined.count});
} catch (...) {
  write_out_of_memory();
}

}  // namespace rtdata::detail
