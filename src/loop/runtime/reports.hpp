// The reports of a runtime: log lines, run-time errors and changes of health, with repeats joined.
#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "data/hidden.hpp"
#include "loop/core/deadline.hpp"
#include "loop/core/handler.hpp"
#include "loop/runtime/repeats.hpp"
#include "rtdata/data/error.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata::detail {

class Listener;
class LoopCore;
class RuntimeCore;

/// Thread: the loop's.
class Reports {
 public:
  Reports(RuntimeCore& runtime, std::vector<std::string> secrets_) : secrets(std::move(secrets_)), runtime_(runtime) {}

  Handler<LogRecord> on_log;
  std::vector<std::string> secrets;                     ///< texts that no report shows
  std::unordered_map<std::string, std::string> places;  ///< in the configuration, by the object's name in reports

  /// The text without the secrets.
  std::string hide(std::string text) const { return hidden(std::move(text), secrets); }
  std::string place_of(const std::string& object) const {
    const auto found = places.find(object);
    return found != places.end() ? found->second : std::string();
  }

  /// Never throws, even if the program's handler does. Many equal lines of one object are joined.
  void log(LogLevel level, std::string_view object, std::string_view text, std::string_view error_id = {}) noexcept;
  /// Reports a run-time error to the loop's `on_error` or the log, and to the recordings. Repeats of the same error of
  /// the same object within a second are joined; after 16 of them, within a minute.
  void report(LoopCore* loop, std::string_view object, const Error& error);
  /// Reports a change of health to the recordings and the topic `$rtdata/health`.
  void health_changed(std::string_view kind, std::string_view name, Health health, std::string_view reason) noexcept;

  /// A report may run user code, which may close or destroy anything. Code that iterates uses `keep`, and its caller
  /// then calls `report_kept`.
  void keep(LoopCore* loop, std::string object, Error error) {
    kept_.push_back({nullptr, loop, std::move(object), std::move(error)});
  }
  /// The same for a call of the listener's `on_refusal`, if it still listens then.
  void keep_refusal(Listener& listener, Error error) { kept_.push_back({&listener, nullptr, {}, std::move(error)}); }
  void report_kept() {
    if (!kept_.empty()) [[unlikely]]
      report_all_kept();
  }

  enum class Repeated { due, all };
  /// Reports held-back repeats that are due, or all of them.
  void flush(Repeated which) noexcept;
  /// `flush` of those due is called at this instant, or earlier.
  void flush_at(MonotonicTime due) noexcept;

  /// On a tier: the main loop will call the function. If more than 1000 wait, further ones are dropped, counted and
  /// logged.
  void post_to_main(Callback<void()> function);

  // The runtime's loop begins and ends
  void attach(LoopCore& loop);
  void detach(LoopCore& loop) noexcept;

 private:
  struct Kept {
    Listener* listener;  // listener of a refusal; null: a report
    LoopCore* loop;
    std::string object;
    Error error;
  };
  struct ObjectError {
    std::string object;
    Error error;
  };
  struct LogLine {
    LogLevel level{};
    std::string object, text, error_id;
  };
  struct Flusher final : Deadline {
    explicit Flusher(Reports& reports_) : reports(reports_) {}
    void fire(MonotonicTime now) override;
    Reports& reports;
  };
  void report_all_kept();
  void write(LoopCore* loop, const Joined<ObjectError>& joined) noexcept;
  void write(const Joined<HealthChange>& joined) noexcept;
  void write(const Joined<LogLine>& joined) noexcept;

  RuntimeCore& runtime_;
  Repeats<ObjectError> errors_{std::chrono::seconds{1}};
  Repeats<LogLine> lines_{Duration{0}};
  Repeats<HealthChange> changes_{Duration{0}};
  Flusher flusher_{*this};
  std::vector<Kept> kept_;
  // The main loop's, counted by tiers
  std::atomic<std::uint32_t> under_way_{0};  // sent by `post_to_main` and not taken
  std::atomic<std::uint64_t> dropped_{0};
};

}  // namespace rtdata::detail
