#!/bin/sh
# Builds program and tests without any of the optional libraries, sees that it records, and that it names what it lacks.
set -eu
cd "$(dirname "$0")/../.."
cmake -G Ninja -B build/least -DCMAKE_BUILD_TYPE=Debug -DCMAKE_CXX_FLAGS_DEBUG=-O0 -DRTDATA_WERROR=ON \
    -DRTDATA_SQLITE=OFF -DRTDATA_GPIO=OFF -DRTDATA_MODBUS=OFF -DRTDATA_POSTGRESQL=OFF -DRTDATA_HTTP=OFF -DRTDATA_MQTT=OFF \
    -DRTDATA_MUPARSER=OFF -DRTDATA_OPENSSL=OFF -DRTDATA_TESTS=ON
cmake --build build/least -j "$(nproc)" --target rtdata_main rtdata_tests
program=$PWD/build/least/rtdata

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
refused() { echo "least.sh: $1" >&2; exit 1; }

cat >least.json <<'END'
{"sensors": [{"name": "cpu", "type": "host", "quantity": "cpu", "rate": "100 Hz"}],
 "sinks": [{"type": "file", "path": "cpu.jsonl"}]}
END
"$program" check least.json
"$program" run least.json --for 500ms
[ "$(grep -c '"topic": *"cpu"' cpu.jsonl)" -ge 1 ] || refused "nothing was recorded: $(head -c 300 cpu.jsonl)"

for type in sqlite edge counter gpio modbus derived; do
    ! "$program" types $type 2>said || refused "it says that it has the type $type"
    grep -q "no type \"$type\": this program was built without " said || refused "of the type $type it says $(cat said)"
done
echo '{"sinks": [{"type": "sqlite", "path": "a.db"}]}' >lacks.json
status=0
"$program" check lacks.json >said 2>&1 || status=$?
[ $status -eq 2 ] || refused "check gives $status: $(cat said)"
grep -q 'no sink type "sqlite": this program was built without SQLite' said || refused "check says $(cat said)"
