#!/bin/sh
# Runs the tests of tests/kernel in the kernel bench, building its kernel first where there is none:
# tests/kernel/run.sh BUILD_DIR [doctest's options]. Exit 77: this machine cannot have the bench.
set -eu
build=$(cd "$1" && pwd)
shift
bench=$(dirname "$0")/kernel-bench
"$bench" --setup
echo "== in real time"
"$bench" -t 600 -- "$build/rtdata_kernel_tests" --no-skipped-summary "$@"
if [ -x "$build/rtdata_kernel_gpio_tests" ]; then
    echo "== GPIO, by this system's libgpiod"
    "$bench" -t 300 -- "$build/rtdata_kernel_gpio_tests" --no-skipped-summary "$@"
else
    echo "skipped: GPIO, since there is no libgpiod (script/bootstrap)"
fi
echo "== in simulated time"
# What comes from outside of the kernel (the serial ports' wires) does not keep simulated time.
RTDATA_BENCH_APPEND="time-travel=inf-cpu ${RTDATA_BENCH_APPEND-}" \
    "$bench" -t 600 -- "$build/rtdata_kernel_tests" --no-skipped-summary --test-suite='clock,iio,long run' "$@"
