#define DOCTEST_CONFIG_IMPLEMENT
#include <doctest/doctest.h>

#include <cstdio>
#include <cstdlib>

int main(int argc, char** argv) {
  doctest::Context context(argc, argv);
  // They would set this machine's clock.
  if (std::getenv("RTDATA_BENCH") == nullptr && !context.shouldExit()) {
    std::fputs("these tests run in the kernel bench only: tests/kernel/kernel-bench -- COMMAND\n", stderr);
    return 2;
  }
  return context.run();
}
