// The limit beside the program rtdata: opens the same database, fires one timer, prints when. Linked with what it takes
// to record into SQLite and to write a log: libuv, SQLite, spdlog.
#include <sqlite3.h>
#include <uv.h>

#include <cstdio>
#include <ctime>

int main(int count, char** arguments) {
  sqlite3* database = nullptr;
  if (count != 2 || sqlite3_open(arguments[1], &database) != SQLITE_OK ||
      sqlite3_exec(database, "SELECT count(*) FROM sqlite_schema", nullptr, nullptr, nullptr) != SQLITE_OK) {
    return 1;
  }
  uv_loop_t loop;
  uv_timer_t first;
  uv_timer_t last;
  uv_loop_init(&loop);
  uv_timer_init(&loop, &first);
  uv_timer_init(&loop, &last);
  uv_timer_start(
      &first,
      [](uv_timer_t*) {
        timespec now{};
        ::clock_gettime(CLOCK_REALTIME, &now);
        std::printf("first %lld%09ld\n", static_cast<long long>(now.tv_sec), now.tv_nsec);
        std::fflush(stdout);
      },
      0, 0);
  uv_timer_start(
      &last, [](uv_timer_t*) {}, 1200, 0);
  uv_run(&loop, UV_RUN_DEFAULT);
  sqlite3_close(database);
}
