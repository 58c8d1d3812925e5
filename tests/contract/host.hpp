// A libuv program on whose loop ours is a guest.
#pragma once

#include <doctest/doctest.h>
#include <unistd.h>
#include <uv.h>

#include <csignal>
#include <map>

namespace rtdata::test {

/// A host with a handle of each common kind, its data pointers set.
struct Host {
  uv_loop_t loop;
  uv_timer_t timer;
  uv_idle_t idle;
  uv_poll_t poll;
  uv_signal_t signal;
  uv_async_t async;
  int pipe_fds[2];
  int marks[6] = {};
  int timer_calls = 0;
  int poll_calls = 0;

  Host() {
    REQUIRE(uv_loop_init(&loop) == 0);
    loop.data = &marks[0];
    uv_timer_init(&loop, &timer);
    uv_idle_init(&loop, &idle);
    REQUIRE(::pipe(pipe_fds) == 0);
    uv_poll_init(&loop, &poll, pipe_fds[0]);
    uv_signal_init(&loop, &signal);
    uv_async_init(&loop, &async, [](uv_async_t*) {});
    timer.data = this;
    idle.data = &marks[2];
    poll.data = this;
    signal.data = &marks[4];
    async.data = &marks[5];
    uv_poll_start(&poll, UV_READABLE,
                  [](uv_poll_t* handle, int, int) { ++static_cast<Host*>(handle->data)->poll_calls; });
    uv_signal_start(
        &signal, [](uv_signal_t*, int) {}, SIGUSR2);
    for (auto* handle : {reinterpret_cast<uv_handle_t*>(&poll), reinterpret_cast<uv_handle_t*>(&signal),
                         reinterpret_cast<uv_handle_t*>(&async)}) {
      uv_unref(handle);
    }
  }
  ~Host() {
    uv_timer_stop(&timer);
    uv_run(&loop, UV_RUN_DEFAULT);  // once more after our objects are gone, as Loop asks for
    uv_walk(
        &loop, [](uv_handle_t* handle, void*) { uv_close(handle, nullptr); }, nullptr);
    uv_run(&loop, UV_RUN_DEFAULT);
    CHECK(uv_loop_close(&loop) == 0);
    ::close(pipe_fds[0]);
    ::close(pipe_fds[1]);
  }
  struct Seen {
    void* data;
    bool active;
    bool closing;
    bool has_ref;
    bool operator==(const Seen&) const = default;
  };
  std::map<uv_handle_t*, Seen> walk() {
    std::map<uv_handle_t*, Seen> seen;
    uv_walk(
        &loop,
        [](uv_handle_t* handle, void* to) {
          static_cast<std::map<uv_handle_t*, Seen>*>(to)->insert(
              {handle, {handle->data, uv_is_active(handle) != 0, uv_is_closing(handle) != 0, uv_has_ref(handle) != 0}});
        },
        &seen);
    return seen;
  }
  void work_for(unsigned milliseconds) {
    uv_timer_start(
        &timer, [](uv_timer_t* handle) { ++static_cast<Host*>(handle->data)->timer_calls; }, milliseconds, 0);
  }
};

}  // namespace rtdata::test
