#include "rtdata/loop/watch.hpp"

#include <uv.h>

#include "data/no_memory.hpp"
#include "loop/core/loop_core.hpp"
#include "loop/runtime/runtime_core.hpp"

namespace rtdata {
namespace detail {
namespace {

/// A libuv handle on the heap, freed when libuv has closed it; its node may be destroyed earlier.
template <class UvHandle, class Owner>
struct UvBox {
  UvHandle handle{};
  Owner* owner = nullptr;

  static void close(UvBox* box) {
    box->owner = nullptr;
    box->handle.data = box;
    uv_close(reinterpret_cast<uv_handle_t*>(&box->handle),
             [](uv_handle_t* closed) { delete static_cast<UvBox*>(closed->data); });
  }
};

}  // namespace

class FdWatchNode final : public Node {
 public:
  FdWatchNode(LoopCore& loop, int fd, std::string name, Callback<void(const FdEvent&)> callback)
      : Node(loop), name_(std::move(name)), callback_(std::move(callback)) {
    if (!callback_) refuse_empty("cannot watch", name_);
    auto box = std::make_unique<Box>();
    if (const int status = uv_poll_init(loop.uv.lend(), &box->handle, fd); status != 0) {
      if (status == UV_ENOMEM) no_memory();
      failed_ = status;
      return;
    }
    box_ = box.release();
    box_->owner = this;
    box_->handle.data = box_;
  }
  int failed() const noexcept { return failed_; }
  bool report_times(CallbackStatus& status) const override {
    status.name = name_;
    status.times = times_;
    return true;
  }
  std::string callback_name() const override { return name_; }
  void set_events(unsigned events) {
    if (box_ == nullptr) return;
    int wanted = UV_DISCONNECT;
    if (events & FdWatch::readable) wanted |= UV_READABLE;
    if (events & FdWatch::writable) wanted |= UV_WRITABLE;
    uv_poll_start(&box_->handle, wanted, [](uv_poll_t* handle, int status, int got) {
      if (auto* owner = static_cast<Box*>(handle->data)->owner) owner->call(status, got);
    });
  }

 private:
  using Box = UvBox<uv_poll_t, FdWatchNode>;
  void call(int status, int got) {
    LoopCore& on = *loop();
    const MonotonicTime from = on.now();
    Call call(*this);
    on.nodes.begins(this);
    const FdEvent event{status < 0 || (got & UV_READABLE) != 0, (got & UV_WRITABLE) != 0,
                        status < 0 || (got & UV_DISCONNECT) != 0};
    on.call_user(name_, [&] { callback_(event); });
    on.blame.time_callback(times_, from, on.now(), [&] { return name_; });
  }
  void on_close() noexcept override {
    if (box_ == nullptr) return;
    uv_poll_stop(&box_->handle);
    Box::close(std::exchange(box_, nullptr));
  }
  void drop_callbacks() noexcept override { callback_.reset(); }

  std::string name_;
  Callback<void(const FdEvent&)> callback_;
  Box* box_ = nullptr;
  int failed_ = 0;
  CallbackTimes times_;
};

class SignalWatchNode final : public Node {
 public:
  SignalWatchNode(LoopCore& loop, int number, Callback<void()> callback)
      : Node(loop), name_("signal " + std::to_string(number)), callback_(std::move(callback)) {
    if (!callback_) refuse_empty("cannot watch signal", std::to_string(number));
    box_ = new Box;
    uv_signal_init(loop.uv.lend(), &box_->handle);
    box_->owner = this;
    box_->handle.data = box_;
    failed_ = uv_signal_start(
        &box_->handle,
        [](uv_signal_t* handle, int) {
          if (auto* owner = static_cast<Box*>(handle->data)->owner) owner->call();
        },
        number);
    uv_unref(reinterpret_cast<uv_handle_t*>(&box_->handle));  // waiting for a signal must not keep the loop running
  }
  int failed() const noexcept { return failed_; }
  bool report_times(CallbackStatus& status) const override {
    status.name = name_;
    status.times = times_;
    return true;
  }
  std::string callback_name() const override { return name_; }

 private:
  using Box = UvBox<uv_signal_t, SignalWatchNode>;
  void call() {
    LoopCore& on = *loop();
    const MonotonicTime from = on.now();
    Call call(*this);
    on.nodes.begins(this);
    on.call_user(name_, [&] { callback_(); });
    on.blame.time_callback(times_, from, on.now(), [&] { return name_; });
  }
  void on_close() noexcept override { Box::close(std::exchange(box_, nullptr)); }
  void drop_callbacks() noexcept override { callback_.reset(); }

  std::string name_;
  Callback<void()> callback_;
  Box* box_ = nullptr;
  int failed_ = 0;
  CallbackTimes times_;
};

}  // namespace detail

FdWatch::FdWatch(Loop& loop, int fd, Events events, Callback<void(const FdEvent&)> callback)
    : FdWatch(loop, fd, events, "watch of descriptor " + std::to_string(fd), std::move(callback)) {}

FdWatch::FdWatch(Loop& loop, int fd, Events events, std::string name, Callback<void(const FdEvent&)> callback)
    : Handle(new detail::FdWatchNode(loop.core(), fd, name, std::move(callback))) {
  auto* made = static_cast<detail::FdWatchNode*>(node());
  if (made->failed() != 0) {
    const std::string why = uv_strerror(made->failed());
    close();
    throw SetupError(
        {Errc::bad_argument, "cannot watch", name, why, "only open sockets, pipes, ttys and devices can be watched"});
  }
  made->set_events(events);
}

void FdWatch::set_events(Events events) {
  if (!is_open()) return;
  auto& watch = *static_cast<detail::FdWatchNode*>(node());
  watch.loop()->check_thread("cannot change", watch.callback_name());
  watch.set_events(events);
}

SignalWatch::SignalWatch(Loop& loop, int signal_number, Callback<void()> callback)
    : Handle(new detail::SignalWatchNode(loop.core(), signal_number, std::move(callback))) {
  auto* made = static_cast<detail::SignalWatchNode*>(node());
  if (made->failed() != 0) {
    const std::string why = uv_strerror(made->failed());
    close();
    throw SetupError({Errc::bad_argument, "cannot watch signal", std::to_string(signal_number), why,
                      "SIGKILL and SIGSTOP cannot be caught"});
  }
}

}  // namespace rtdata
