#!/bin/sh
# Builds each fuzzer with clang and runs it for so many seconds: tests/fuzz/run.sh SECONDS
set -eu
cd "$(dirname "$0")/../.."
seconds=${1:-20}
out=build/fuzz
mkdir -p "$out"
# The whole library, that of recordings, and what else reads what others have written. libcurl is needed, and loaded.
library="$(cat src/rtdata.sources src/rtdata_sqlite.sources) src/app/control/arm_keeper.cpp src/app/control/commands.cpp src/app/core/machine_resume.cpp src/app/core/machines.cpp src/app/inspect/import.cpp src/app/inspect/import_columns.cpp src/app/inspect/import_rows.cpp src/app/inspect/import_time.cpp src/io/http_answer.cpp src/io/http_url.cpp src/io/mqtt_packet.cpp"
# Without muParser, expressions are read and not evaluated.
muparser=$(pkg-config --exists muparser && echo -lmuparser || true)
cache=$(command -v ccache || true)
export CCACHE_BASEDIR="$PWD" CCACHE_NOHASHDIR=1 # what another clone has compiled serves here, as with CMake
flags="-std=c++20 -O1 -g1 -DRTDATA_VERSION='\"fuzz\"' -fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=undefined -Iinclude -Isrc -Itests${muparser:+ -DRTDATA_WITH_MUPARSER}"
printf '%s\n' $library tests/fuzz/*_fuzz.cpp | sort -u |
    xargs -P "$(nproc)" -I{} sh -c "$cache clang++ $flags -c {} -o $out/\$(echo {} | tr / _).o"
for source in tests/fuzz/*_fuzz.cpp; do
    name=$(basename "$source" .cpp)
    objects=$(for one in $library "$source"; do echo "$out/$(echo "$one" | tr / _).o"; done)
    # shellcheck disable=SC2086
    clang++ -fsanitize=fuzzer,address,undefined $objects -o "$out/$name" -luv -lsqlite3 $muparser
    mkdir -p "$out/corpus-$name"
    "$out/$name" -max_total_time="$seconds" -max_len=4096 -print_final_stats=1 -artifact_prefix="$out/" "$out/corpus-$name"
done
