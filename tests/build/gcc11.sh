#!/bin/sh
# With the oldest g++ that will do, char without a sign, as on ARM, no precompiled headers and each file by itself, so that it
# includes what it uses: the library, the program, and the tests that need no real time.
set -eu
cd "$(dirname "$0")/../.."
command -v g++-11 >/dev/null || { echo "skipped: there is no g++-11 (script/bootstrap --all installs it on Debian 12)"; exit 77; }
cmake --preset g++-11
cmake --build --preset g++-11 -j "$(nproc)" --target rtdata_tests
exec tests/build/ctest.sh g++-11 --timeout 600 -R '^(data|sensors|config|contract)$'
