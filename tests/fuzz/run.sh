#!/bin/sh
# Builds each fuzzer with clang and runs it for so many seconds: tests/fuzz/run.sh SECONDS
set -eu
cd "$(dirname "$0")/../.."
seconds=${1:-20}
out=build/fuzz
mkdir -p "$out"
# What they try is the library of build/asan, which is compiled with what a fuzzer needs to see where it gets.
build=build/asan
cmake --preset asan >"$out/configure.log" && cmake --build --preset asan -j "$(nproc)" --target rtdata_program
libraries="-Wl,--start-group $(echo $build/librtdata*.a) -Wl,--end-group"
needs=$(for one in libuv sqlite3 spdlog libgpiod; do pkg-config --libs $one 2>/dev/null || true; done)
cache=$(command -v ccache || true)
export CCACHE_BASEDIR="$PWD" CCACHE_NOHASHDIR=1 # what another clone has compiled serves here, as with CMake
flags="-std=c++20 -O1 -g1 -fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=undefined -Iinclude -Isrc -Itests"
printf '%s\n' tests/fuzz/*_fuzz.cpp |
    xargs -P "$(nproc)" -I{} sh -c "$cache clang++ $flags -c {} -o $out/\$(basename {}).o"
for source in tests/fuzz/*_fuzz.cpp; do
    name=$(basename "$source" .cpp)
    # shellcheck disable=SC2086
    clang++ -fsanitize=fuzzer,address,undefined "$out/$name.cpp.o" $libraries $needs -o "$out/$name"
    mkdir -p "$out/corpus-$name"
    "$out/$name" -max_total_time="$seconds" -max_len=4096 -print_final_stats=1 -artifact_prefix="$out/" "$out/corpus-$name"
done
