// The program with the types of the tests beside its own: what a user's program with types of its own looks like.
#include "config/test_types.hpp"
#include "rtdata/app/program.hpp"

int main(int argc, char** argv) {
  rtdata::Registry registry = rtdata::standard_registry();
  rtdata::test::add_test_types(registry);
  return rtdata::run_program(registry, argc, argv);
}
