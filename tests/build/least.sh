#!/bin/sh
# Builds the program without each of the optional libraries, then without any of them; sees that it records, and that it names what
# it lacks. Tests need SQLite: they are built without any of the others, and those run that ask which parts are in.
# All is one folder with the flags of the preset `release`: what asks for no part is compiled once, or is in ccache already.
set -eu
cd "$(dirname "$0")/../.."
refused() { echo "least.sh: $1" >&2; exit 1; }
parts="SQLITE GPIO MODBUS POSTGRESQL HTTP MQTT OPENSSL PAGE PATTERN"
program=$PWD/build/least/rtdata
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat >"$folder/least.json" <<'END'
{"sensors": [{"name": "cpu", "type": "host", "quantity": "cpu", "rate": "100 Hz"}],
 "sinks": [{"type": "file", "path": "cpu.jsonl"}]}
END

# build PARTS TARGET: without these.
build() {
    options=""
    for part in $parts; do
        case " $1 " in *" $part "*) options="$options -DRTDATA_$part=OFF" ;; *) options="$options -DRTDATA_$part=ON" ;; esac
    done
    # shellcheck disable=SC2086
    cmake -S . -G Ninja -B build/least -DCMAKE_BUILD_TYPE=Release -DRTDATA_TESTS=ON $options >"$folder/configured"
    cmake --build build/least -j "$(nproc)" --target "$2" >"$folder/built" || { cat "$folder/built"; refused "it cannot be built without $1"; }
    ! grep 'warning:' "$folder/built" || refused "there are warnings without $1"
}

# records PARTS: the program was built without these, says so, and records.
records() {
    "$program" --version >"$folder/said"
    [ "$(grep -c 'left out' "$folder/said")" -eq "$(echo "$1" | wc -w)" ] || refused "without $1, --version says $(cat "$folder/said")"
    (cd "$folder" && rm -f cpu.jsonl && "$program" check least.json && "$program" run least.json --for 300ms)
    [ "$(grep -c '"topic": *"cpu"' "$folder/cpu.jsonl")" -ge 1 ] || refused "without $1, this was recorded: $(head -c 300 "$folder/cpu.jsonl")"
}

build "${parts#SQLITE }" rtdata_tests
records "${parts#SQLITE }"
asking=$(grep -l RTDATA_WITH_ $(find tests -name '*_test.cpp') | sed 's/^tests/*/' | paste -sd,)
build/least/rtdata_tests --no-skipped-summary --source-file="$asking"

for part in $parts; do
    build $part rtdata_main
    records $part
done

build "$parts" rtdata_main
records "$parts"
cd "$folder"
for type in sqlite edge counter gpio modbus postgresql http mqtt; do
    ! "$program" types $type 2>said || refused "it says that it has the type $type"
    grep -q "no type \"$type\": this program was built without " said || refused "of the type $type it says $(cat said)"
done
echo '{"sinks": [{"type": "sqlite", "path": "a.db"}]}' >lacks.json
status=0
"$program" check lacks.json >said 2>&1 || status=$?
[ $status -eq 2 ] || refused "check gives $status: $(cat said)"
grep -q 'no sink type "sqlite": this program was built without SQLite' said || refused "check says $(cat said)"
