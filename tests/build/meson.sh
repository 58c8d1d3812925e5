#!/bin/sh
# Builds with meson what users get, and tries it.
set -eu
cd "$(dirname "$0")/../.."
command -v meson >/dev/null || { echo "skipped: there is no meson (script/bootstrap --all installs it)"; exit 77; }
meson setup --reconfigure build/meson >/dev/null 2>&1 || meson setup -Doptimization=0 -Dwerror=true build/meson
meson compile -C build/meson
grep -q '^ExecStart=/usr/local/bin/rtdata run ' build/meson/rtdata@.service
# It records, and what it recorded is whole.
program=$PWD/build/meson/rtdata
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"$program" init bench.json
"$program" run bench.json --for 1s --quiet
"$program" verify bench.db
