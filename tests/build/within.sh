#!/bin/sh
# tests/build/within.sh SECONDS COMMAND...: ends it, and what it has started, when these are over; then it is skipped (exit 77).
# They end with this script, too, when that is interrupted.
began=$(date +%s)
status=0
timeout --kill-after=10 "$@" &
trap 'kill $! 2>/dev/null; exit 143' INT TERM
wait $! || status=$?
if [ $status -ge 124 ] && [ $(($(date +%s) - began)) -ge "$1" ]; then
    echo "skipped: its time was over; run it again, which goes on with what is compiled"
    exit 77
fi
exit $status
