#!/bin/sh
# build.sh NAME MODULE: compiles NAME.cpp of the working directory against the MODULE that pkg-config finds.
set -eu
# With --static, too, it asks for nothing that is not installed.
for static in "--static" ""; do
    # shellcheck disable=SC2046,SC2086
    ${CXX:-g++} -std=c++20 "$1.cpp" $(pkg-config --cflags --libs $static "$2") -o "$1"
done
