/// run_program: the program `rtdata` as a function, so that a program of your own can run configurations with types of
/// its own:
///
///     int main(int argc, char** argv) {
///       rtdata::Registry registry = rtdata::standard_registry();
///       registry.add_sensor<MyConfig>("mine", "my own sensor", ...);
///       return rtdata::run_program(registry, argc, argv);
///     }
///
/// Without the command line, a program runs the parts of a file itself:
///
///     rtdata::System system(loop, registry, rtdata::load_config("bench.json"));
///
/// Target: rtdata::program. Thread of `run_program`: the main one, before others are started: it takes over SIGINT,
/// SIGTERM and SIGHUP while it runs.
#pragma once

#include "rtdata/config/registry.hpp"

namespace rtdata {

/// The sensor, sink, output and bus types that come with the library.
Registry standard_registry();

/// Runs the command line; returns the exit status: 0 good, 2 mistakes in a configuration, 3 something was lost and
/// --fail-on-loss was given, 1 anything else. Throws nothing.
int run_program(const Registry& registry, int argc, char** argv);

}  // namespace rtdata
