#include "rtdata/app/program.hpp"

int main(int argc, char** argv) { return rtdata::run_program(rtdata::standard_registry(), argc, argv); }
