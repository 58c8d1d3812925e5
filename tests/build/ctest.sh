#!/bin/sh
# tests/build/ctest.sh PRESET ARGUMENT...: ctest with these arguments in the build of this preset, several tests at a time, since many wait most of
# their time. What fails runs once more, alone: a test that passes then was disturbed by the others or by the machine, is told as
# "unstable", and is to be mended; the output has why it failed at first.
# What a sanitizer finds is a failure however seldom it is seen.
set -u
TSAN_OPTIONS="suppressions=$(cd "$(dirname "$0")" && pwd)/tsan.suppressions${TSAN_OPTIONS:+:$TSAN_OPTIONS}"
export TSAN_OPTIONS
cd "$(dirname "$0")/../../build/$1" || exit
shift
ctest -j "$(($(nproc) + 1))" --output-on-failure "$@" && exit 0
failed=$(sed 's/^[0-9]*://' Testing/Temporary/LastTestsFailed.log | tr '\n' ' ')
if grep -q 'Sanitizer' Testing/Temporary/LastTest.log; then exit 1; fi
echo "== once more: $failed"
ctest --output-on-failure --rerun-failed "$@" || exit 1
echo "unstable: $failed"
