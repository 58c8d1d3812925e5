#!/bin/sh
# install_test.sh BUILD_DIR SOURCE_DIR: installs into a temporary prefix; then strangers' projects find the library in
# each of the ways that the README names, compile the README's program, run it and read its recording.
set -eu
build=$(cd "$1" && pwd)
source=$(cd "$2" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT INT TERM

cmake --install "$build" --prefix "$work/prefix" >"$work/install.log"
config=$(find "$work/prefix" -name rtdata-config.cmake)
pkgconfig=$(find "$work/prefix" -name pkgconfig -type d)
if grep -rq "$source\|$build" "$(dirname "$config")" "$pkgconfig"; then
    echo "what was installed names the tree it was built in:" >&2
    grep -r "$source\|$build" "$(dirname "$config")" "$pkgconfig" >&2
    exit 1
fi
if [ -x "$work/prefix/bin/rtdata" ]; then
    "$work/prefix/bin/rtdata" --version
fi

# A project of the way $1, with the README's program made shorter.
project() {
    cp -r "$source/tests/install/$1" "$work/$1"
    sed 's/run_for(1s)/run_for(200ms)/' "$source/examples/01_record.cpp" >"$work/$1/record.cpp"
    cp "$source/tests/install/"*.c "$source/tests/install/"*.cpp "$work/$1"
    cd "$work/$1"
}
# Runs the program $1 and looks whether its rows are there.
check() {
    timeout 30 "$1" >output
    [ -s output ]
    python3 - run.db <<'PYTHON'
import sqlite3, sys
db = sqlite3.connect(sys.argv[1])
rows, = db.execute('SELECT count(*) FROM "load"').fetchone()
stored, state = db.execute("SELECT stored, state FROM rtdata_ledger JOIN rtdata_run USING (run)").fetchone()
sys.exit(0 if rows == stored > 0 and state == "closed" else f"{rows} rows, {stored} stored, {state}")
PYTHON
    echo "$(basename "$PWD"): good"
}

# The service's own command lines, with its folders elsewhere; systemd makes the runtime directory and names it.
unit=$work/prefix/lib/systemd/system/rtdata@.service
if [ -x "$work/prefix/bin/rtdata" ]; then
    if command -v systemd-analyze >/dev/null; then
        cp "$unit" "$work/rtdata@bench.service"
        systemd-analyze verify --man=no "$work/rtdata@bench.service" 2>&1 | grep -F rtdata && exit 1
    fi
    setting() { sed -n "s/^$1=//p" "$unit" | sed "s|%i|bench|g; s|/etc/rtdata|$work/etc|g; s|/var/log/rtdata|$work/log|g"; }
    runtime=$work/run/$(setting RuntimeDirectory)
    mkdir -p "$work/etc" "$work/log" "$work/state" "$runtime"
    chmod "$(setting RuntimeDirectoryMode)" "$runtime"
    cp "$source/examples/host.json" "$work/etc/bench.json"
    cd "$work/state"
    # A mistake in the configuration ends the main process with a status that systemd does not restart it after; what would
    # run before it, is restarted whatever its status.
    for kind in Condition Assert ExecStartPre ExecCondition; do
        case "$kind $(grep "^$kind.*=" "$unit")" in
        "Assert AssertPathExists=/etc/rtdata/%i.json" | "Condition " | "ExecStartPre " | "ExecCondition ") ;;
        *) echo "the unit has another $kind" >&2; exit 1 ;;
        esac
    done
    echo '{"sensors": [{"nme": "a"}]}' >"$work/etc/wrong.json"
    status=0
    $(setting ExecStart | sed 's|bench\.json|wrong.json|') >wrong.log 2>&1 || status=$?
    grep -q '"type" is missing' wrong.log
    setting RestartPreventExitStatus | grep -qx "$status"
    env -u RTDATA_RUNTIME_DIR RUNTIME_DIRECTORY="$runtime" $(setting ExecStart) >run.log 2>&1 &
    service=$!
    tries=0
    until RTDATA_RUNTIME_DIR="$work/run/rtdata" "$work/prefix/bin/rtdata" top --once >top.log 2>&1; do
        tries=$((tries + 1))
        if [ $tries -ge 100 ] || ! kill -0 $service; then
            cat run.log top.log >&2
            kill $service
            exit 1
        fi
        sleep 0.1
    done
    ls "$runtime/$service.sock"
    kill $service
    wait $service
    echo "service: good"
fi

project find_package
cp "$source/examples/06_own_types_in_json.cpp" own_types.cpp
cmake -S . -B out -DCMAKE_PREFIX_PATH="$work/prefix" -DCMAKE_BUILD_TYPE=Release >cmake.log
cmake --build out -j "$(nproc)" >>cmake.log || { cat cmake.log >&2; exit 1; }
check out/record
rm run.db
check out/host
echo "C with a loop of its own: good"
if [ -e "$pkgconfig/rtdata-gpio.pc" ]; then
    out/lines
    echo "GPIO, CMake: good"
fi
if [ -e "$pkgconfig/rtdata-modbus.pc" ]; then
    out/registers
    echo "Modbus, CMake: good"
fi
# The program with types of its own, made in the way $1: it knows them, and records with them.
check_own_types() {
    "$2" check "$source/examples/06_own_types.json"
    "$2" types wave
    "$2" run "$source/examples/06_own_types.json" --for 200ms >own.log 2>&1 || { cat own.log >&2; exit 1; }
    echo "own types, $1: good"
}
if [ -x "$work/prefix/bin/rtdata" ]; then
    check_own_types CMake out/own_types
fi

project pkg_config
cp "$source/examples/06_own_types_in_json.cpp" own_types.cpp
PKG_CONFIG_PATH="$pkgconfig" sh build.sh record rtdata-sqlite
LD_LIBRARY_PATH="$(dirname "$pkgconfig")" check ./record
for own in 10_own_driver 11_own_bus 14_own_output; do
    cp "$source/examples/$own.cpp" .
    PKG_CONFIG_PATH="$pkgconfig" sh build.sh "$own" rtdata
    LD_LIBRARY_PATH="$(dirname "$pkgconfig")" "./$own"
    echo "$own: good"
done
cp "$source/examples/12_own_sender.cpp" .
PKG_CONFIG_PATH="$pkgconfig" sh build.sh 12_own_sender rtdata-sqlite
LD_LIBRARY_PATH="$(dirname "$pkgconfig")" ./12_own_sender
echo "12_own_sender: good"
if [ -e "$pkgconfig/rtdata-gpio.pc" ]; then
    PKG_CONFIG_PATH="$pkgconfig" sh build.sh lines rtdata-gpio
    LD_LIBRARY_PATH="$(dirname "$pkgconfig")" ./lines
    echo "GPIO, pkg-config: good"
fi
if [ -e "$pkgconfig/rtdata-modbus.pc" ]; then
    PKG_CONFIG_PATH="$pkgconfig" sh build.sh registers rtdata-modbus
    LD_LIBRARY_PATH="$(dirname "$pkgconfig")" ./registers
    echo "Modbus, pkg-config: good"
fi
if [ -x "$work/prefix/bin/rtdata" ]; then
    PKG_CONFIG_PATH="$pkgconfig" sh build.sh own_types rtdata-program
    LD_LIBRARY_PATH="$(dirname "$pkgconfig")" check_own_types pkg-config ./own_types
fi

# In the tree, so that what another clone has compiled serves here: ccache sees paths relative to it.
project add_subdirectory
out=$build/add_subdirectory
rm -rf "$out"
cmake -S . -B "$out" -DRTDATA_TREE="$source" -DCMAKE_BUILD_TYPE=Debug >cmake.log
cmake --build "$out" -j "$(nproc)" --target record >>cmake.log || { tail -n 50 cmake.log >&2; exit 1; }
check "$out/record"
