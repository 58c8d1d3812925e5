#!/bin/sh
# Builds each fuzzer with clang and runs it for so many seconds: tests/fuzz/run.sh SECONDS
set -eu
cd "$(dirname "$0")/../.."
seconds=${1:-20}
out=build/fuzz
mkdir -p "$out"
# What parses, without the loop: the data layer, reports of gpsd, sentences of NMEA, and the configuration layer up to the
# making of parts.
sources="$(ls src/data/*.cpp src/config/read/*.cpp src/config/schema/*.cpp) src/config/plan/load.cpp src/config/plan/secret.cpp
  src/loop/events/topic_name.cpp src/sensors/gps/gps_report.cpp src/sensors/serial/nmea.cpp src/sensors/serial/line_decoder.cpp src/sensors/core/sysfs_file.cpp
  src/io/iio.cpp src/io/iio_layout.cpp src/io/kernel_file.cpp src/sensors/kernel/pps_time.cpp src/sensors/kernel/w1_text.cpp
  src/process/expression.cpp src/process/expression_tree.cpp"
# What a replay needs beside: the whole library, and that of recordings.
library=$(cat src/rtdata.sources src/rtdata_sqlite.sources)
# Without muParser, expressions are read and not evaluated.
muparser=$(pkg-config --exists muparser && echo -lmuparser || true)
cache=$(command -v ccache || true)
flags="-std=c++20 -O1 -g1 -DRTDATA_VERSION='\"fuzz\"' -fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=undefined -Iinclude -Isrc -Itests${muparser:+ -DRTDATA_WITH_MUPARSER}"
printf '%s\n' $sources $library tests/fuzz/*_fuzz.cpp | sort -u |
    xargs -P "$(nproc)" -I{} sh -c "$cache clang++ $flags -c {} -o $out/\$(echo {} | tr / _).o"
for source in tests/fuzz/*_fuzz.cpp; do
    name=$(basename "$source" .cpp)
    parts=$sources
    libraries=$muparser
    if [ "$name" = replay_fuzz ]; then
        parts=$library
        libraries="-luv -lsqlite3 $muparser"
    fi
    objects=$(for one in $parts "$source"; do echo "$out/$(echo "$one" | tr / _).o"; done)
    # shellcheck disable=SC2086
    clang++ -fsanitize=fuzzer,address,undefined $objects -o "$out/$name" $libraries
    mkdir -p "$out/corpus-$name"
    "$out/$name" -max_total_time="$seconds" -max_len=4096 -print_final_stats=1 -artifact_prefix="$out/" "$out/corpus-$name"
done
