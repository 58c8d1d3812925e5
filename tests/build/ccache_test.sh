#!/bin/sh
# What one clone has compiled serves another at any path, in both builds. Exit 77: there is no ccache.
set -eu
cd "$(dirname "$0")/../.."
for tool in ccache meson; do
    command -v $tool >/dev/null || { echo "skipped: there is no $tool"; exit 77; }
done
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT INT TERM
export CCACHE_DIR="$work/cache"

# in_clone PATH: compiles a unit with CMake, a source with meson, and one that uses a precompiled header with CMake's, and counts what ccache had of it.
in_clone() {
    mkdir -p "$work/$1"
    git ls-files -z | xargs -0 cp --parents -t "$work/$1"
    cd "$work/$1"
    cmake -S . -B build/cmake -G Ninja -DCMAKE_BUILD_TYPE=Debug -DCMAKE_CXX_COMPILER=g++ -DRTDATA_PROGRAM=OFF -DRTDATA_TESTS=ON >configure.log
    meson setup build/meson >>configure.log
    ccache -z >/dev/null # what compilers are tried with does not count
    cmake --build build/cmake --target CMakeFiles/rtdata.dir/units/rtdata_5.cpp.o CMakeFiles/rtdata_tests.dir/tests/sensors/tty_test.cpp.o >build.log
    ls build/cmake/CMakeFiles/rtdata_tests.dir/cmake_pch.hxx.gch >>build.log
    ninja -C build/meson librtdata.a.p/src_io_tty.cpp.o >>build.log
    cd "$OLDPWD"
    ccache --print-stats | awk '/^(direct|preprocessed)_cache_hit\t/ { hits += $2 } /^cache_miss\t/ { missed = $2 }
                                END { print hits + 0, missed + 0 }'
}
first=$(in_clone one)
second=$(in_clone another/place)
echo "first clone: hits and misses $first; second: $second"
[ "$first" = "0 4" ] && [ "$second" = "4 0" ]
