#!/bin/sh
# Builds the program without each of the optional libraries, then without any of them; sees that it records, and that it names what
# it lacks. Tests need SQLite: they are built without any of the others.
set -eu
cd "$(dirname "$0")/../.."
refused() { echo "least.sh: $1" >&2; exit 1; }

# build FOLDER OPTION... -- TARGET...
build() {
    folder=build/$1 options=""
    shift
    while [ "$1" != -- ]; do options="$options $1"; shift; done
    shift
    # shellcheck disable=SC2086
    cmake -S . -G Ninja -B "$folder" -DCMAKE_BUILD_TYPE=Debug -DCMAKE_CXX_FLAGS_DEBUG=-O0 -DRTDATA_WERROR=ON -DRTDATA_TESTS=ON $options >/dev/null
    cmake --build "$folder" -j "$(nproc)" --target "$@"
}

none=""
for part in SQLITE GPIO MODBUS POSTGRESQL HTTP MQTT OPENSSL; do
    none="$none -DRTDATA_$part=OFF"
    build without -DRTDATA_$part=OFF -- rtdata_main
    left_out=$(build/without/rtdata --version | grep -c 'left out')
    [ "$left_out" -eq 1 ] || refused "without $part, --version says that $left_out parts are left out"
    cmake -B build/without -DRTDATA_$part=ON >/dev/null
done
# shellcheck disable=SC2086
build least $none -- rtdata_main
# shellcheck disable=SC2086
build least_tests ${none#*SQLITE=OFF} -- rtdata_tests
program=$PWD/build/least/rtdata

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat >least.json <<'END'
{"sensors": [{"name": "cpu", "type": "host", "quantity": "cpu", "rate": "100 Hz"}],
 "sinks": [{"type": "file", "path": "cpu.jsonl"}]}
END
"$program" check least.json
"$program" run least.json --for 500ms
[ "$(grep -c '"topic": *"cpu"' cpu.jsonl)" -ge 1 ] || refused "nothing was recorded: $(head -c 300 cpu.jsonl)"

for type in sqlite edge counter gpio modbus; do
    ! "$program" types $type 2>said || refused "it says that it has the type $type"
    grep -q "no type \"$type\": this program was built without " said || refused "of the type $type it says $(cat said)"
done
echo '{"sinks": [{"type": "sqlite", "path": "a.db"}]}' >lacks.json
status=0
"$program" check lacks.json >said 2>&1 || status=$?
[ $status -eq 2 ] || refused "check gives $status: $(cat said)"
grep -q 'no sink type "sqlite": this program was built without SQLite' said || refused "check says $(cat said)"
