#include "rtdata/loop/loop.hpp"

#include "loop/core/loop_core.hpp"
#include "loop/core/virtual_threads.hpp"
#include "loop/runtime/runtime_core.hpp"
#include "rtdata/loop/runtime.hpp"

namespace rtdata {

Loop::Loop() : Loop(Config{}) {}
Loop::Loop(Config config)
    : own_runtime_(std::make_unique<Runtime>()),
      core_(std::make_unique<detail::LoopCore>(*this, own_runtime_->core(), std::move(config), nullptr,
                                               detail::LoopCore::Time::real)) {}
Loop::Loop(uv_loop_t* host) : Loop(host, Config{}) {}
Loop::Loop(uv_loop_t* host, Config config) : own_runtime_(std::make_unique<Runtime>()) {
  if (host == nullptr)
    throw SetupError({Errc::bad_argument, "cannot attach", "loop", "the uv_loop_t is null", "pass the loop"});
  core_ = std::make_unique<detail::LoopCore>(*this, own_runtime_->core(), std::move(config), host,
                                             detail::LoopCore::Time::real);
}
Loop::Loop(Manual manual) : Loop(manual, Config{}) {}
Loop::Loop(Manual manual, Config config) : own_runtime_(std::make_unique<Runtime>()) {
  own_runtime_->core().clock_log.use_manual_clock();
  core_ = std::make_unique<detail::LoopCore>(*this, own_runtime_->core(), std::move(config), nullptr,
                                             detail::LoopCore::Time::manual);
  core_->virtual_threads()->choose_by(manual);
}
Loop::Loop(Runtime& runtime, Config config)
    : core_(std::make_unique<detail::LoopCore>(*this, runtime.core(), std::move(config), nullptr,
                                               dynamic_cast<ManualClock*>(&runtime.core().clock()) != nullptr
                                                   ? detail::LoopCore::Time::manual
                                                   : detail::LoopCore::Time::real)) {}
Loop::~Loop() {
  core_->check_may_end();
  core_->begin_ending();
  if (own_runtime_ != nullptr) own_runtime_->core().reports.on_log.reset();  // like on_error
}

void Loop::run() { core_->run(); }
void Loop::run_for(Duration duration) { core_->run_for(duration); }
void Loop::poll() { core_->poll(); }
void Loop::stop() noexcept { core_->request_stop(); }
void Loop::advance(Duration duration) { core_->advance(duration); }
void Loop::post(Callback<void()> function) { core_->post(std::move(function)); }
MonotonicTime Loop::now() noexcept { return core_->now(); }
Time Loop::time() noexcept { return core_->runtime.event_time(core_->now()); }
Runtime& Loop::runtime() noexcept { return core_->runtime.face; }
const Loop::Config& Loop::config() const noexcept { return core_->config; }
uv_loop_t* Loop::uv() noexcept { return core_->uv.lend(); }
void Loop::on_error(Callback<void(const ErrorReport&)> handler) {
  core_->check_thread("cannot set on_error", "loop " + config().name);
  core_->check_not_ending("cannot set on_error");
  core_->on_error.set(std::move(handler));
}
std::vector<CallbackStatus> Loop::callbacks() const { return core_->nodes.callbacks(); }
void Loop::script_lane_duration(Duration duration) {
  core_->check_thread("cannot script lanes", "loop " + config().name);
  core_->lanes.scripted_duration = duration;
}

ManualClock& Loop::manual_clock() {
  if (core_->manual_clock() == nullptr) {
    throw SetupError({Errc::bad_argument, "no manual clock", "loop " + config().name, "it runs in real time",
                      "make it with rtdata::Loop::Manual{}"});
  }
  return *core_->manual_clock();
}

}  // namespace rtdata
