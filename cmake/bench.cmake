# The benchmarks: `script/bench`.
add_executable(rtdata_bench tests/bench/disk_bench.cpp tests/bench/encode_bench.cpp tests/bench/export_bench.cpp
  tests/bench/filter_bench.cpp tests/bench/harness.cpp tests/bench/iio_bench.cpp tests/bench/lane_bench.cpp tests/bench/loop_bench.cpp tests/bench/program_bench.cpp tests/bench/publish_bench.cpp
  tests/bench/rt_bench.cpp tests/bench/sink_bench.cpp tests/bench/verify_bench.cpp)
target_link_libraries(rtdata_bench PRIVATE rtdata_options rtdata::rtdata PkgConfig::libuv)
target_include_directories(rtdata_bench PRIVATE tests/bench src)
pkg_check_modules(libgps IMPORTED_TARGET libgps)
if(libgps_FOUND)
  target_link_libraries(rtdata_bench PRIVATE PkgConfig::libgps)
  target_compile_definitions(rtdata_bench PRIVATE RTDATA_BENCH_LIBGPS)
else()
  target_link_libraries(rtdata_bench PRIVATE nlohmann_json::nlohmann_json)
endif()
if(TARGET rtdata_sqlite)
  target_link_libraries(rtdata_bench PRIVATE rtdata::sqlite PkgConfig::sqlite3)
  target_compile_definitions(rtdata_bench PRIVATE RTDATA_BENCH_SQLITE)

  # Loads what the program loads.
  add_executable(rtdata_bench_bare tests/bench/bare_program.cpp)
  target_link_libraries(rtdata_bench_bare PRIVATE rtdata_options PkgConfig::libuv PkgConfig::sqlite3)
  if(TARGET rtdata_program)
    target_link_options(rtdata_bench_bare PRIVATE LINKER:--no-as-needed)
    target_link_libraries(rtdata_bench_bare PRIVATE spdlog::spdlog)
  endif()
  add_dependencies(rtdata_bench rtdata_bench_bare)
endif()
