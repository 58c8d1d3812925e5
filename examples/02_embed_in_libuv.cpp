// A program with a libuv loop of its own, and rtdata as a guest on it: sensors and a recording beside the program's own
// timer and poll handles, and an orderly end.
#include <sys/eventfd.h>
#include <unistd.h>
#include <uv.h>

#include <cstdint>
#include <cstdio>

#include "rtdata/loop/loop.hpp"
#include "rtdata/recording/sqlite.hpp"
#include "rtdata/sensors/host.hpp"

using namespace rtdata::literals;

struct Program {  // what was there before
  uv_loop_t loop{};
  uv_timer_t timer{};  // writes to the descriptor
  uv_poll_t poll{};    // reads it
  int fd = ::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
  int wakes = 0;
  rtdata::Loop* guest = nullptr;
};

void on_poll(uv_poll_t* handle, int, int) {
  auto& program = *static_cast<Program*>(handle->data);
  std::uint64_t value = 0;
  if (::read(program.fd, &value, sizeof value) != sizeof value || ++program.wakes != 10) return;
  uv_close(reinterpret_cast<uv_handle_t*>(&program.timer), nullptr);  // the program ends its own handles, and
  uv_close(reinterpret_cast<uv_handle_t*>(&program.poll), nullptr);   // the guest stores what it holds
  program.guest->drain(5s, [](std::uint64_t lost) { std::printf("%d events lost\n", static_cast<int>(lost)); });
}

int main() {
  Program program;
  uv_loop_init(&program.loop);
  uv_timer_init(&program.loop, &program.timer);
  uv_poll_init(&program.loop, &program.poll, program.fd);
  program.timer.data = program.poll.data = &program;
  uv_timer_start(
      &program.timer, [](uv_timer_t* t) { eventfd_write(static_cast<Program*>(t->data)->fd, 1); }, 50, 50);
  uv_poll_start(&program.poll, UV_READABLE, on_poll);
  bool balances = false;
  {
    rtdata::Loop guest(&program.loop);
    program.guest = &guest;
    rtdata::SqliteSink recording(guest, {.path = "embedded.db"});
    rtdata::HostSensor memory(guest, {.name = "memory", .topic = "host/memory", .rate = 20_Hz},
                              {.quantity = rtdata::HostQuantity::memory});
    uv_run(&program.loop, UV_RUN_DEFAULT);
    balances = guest.runtime().balances();
  }
  uv_run(&program.loop, UV_RUN_DEFAULT);  // libuv finishes closing the guest's handles
  ::close(program.fd);
  return uv_loop_close(&program.loop) == 0 && program.wakes == 10 && balances ? 0 : 1;
}
