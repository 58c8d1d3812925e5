#!/bin/sh
# Builds each fuzzer with clang and runs it for so many seconds: tests/fuzz/run.sh SECONDS
set -eu
cd "$(dirname "$0")/../.."
seconds=${1:-20}
out=build/fuzz
mkdir -p "$out"
for source in tests/fuzz/*_fuzz.cpp; do
    name=$(basename "$source" .cpp)
    # shellcheck disable=SC2046
    clang++ -std=c++20 -O1 -g1 -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=undefined -Iinclude -Isrc -Itests \
        "$source" $(ls src/data/*.cpp src/config/*.cpp 2>/dev/null | grep -v system.cpp) -o "$out/$name"
    mkdir -p "$out/corpus-$name"
    "$out/$name" -max_total_time="$seconds" -max_len=4096 -verbosity=0 -print_final_stats=1 -artifact_prefix="$out/" "$out/corpus-$name"
done
