/* A program in C with a uv_loop_t of its own; what rtdata does on it is behind the functions of guest.cpp. */
#include <stdio.h>
#include <uv.h>

int guest_begin(uv_loop_t* loop);
void guest_drain(void);
int guest_end(void);

static int ticks = 0;

static void on_tick(uv_timer_t* timer) {
  if (++ticks < 10) return;
  uv_close((uv_handle_t*)timer, NULL);
  guest_drain();
}

int main(void) {
  uv_loop_t loop;
  uv_timer_t timer;
  int events;
  if (uv_loop_init(&loop) != 0 || guest_begin(&loop) != 0) return 1;
  uv_timer_init(&loop, &timer);
  uv_timer_start(&timer, on_tick, 20, 20);
  uv_run(&loop, UV_RUN_DEFAULT);
  events = guest_end();
  uv_run(&loop, UV_RUN_DEFAULT); /* libuv finishes closing the guest's handles */
  printf("%d ticks of the host, %d events of the guest\n", ticks, events);
  return uv_loop_close(&loop) == 0 && ticks == 10 && events > 0 ? 0 : 1;
}
