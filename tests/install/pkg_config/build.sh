#!/bin/sh
# Compiles record.cpp of the working directory against the library that pkg-config finds.
set -eu
# With --static, too, it asks for nothing that is not installed.
for static in "--static" ""; do
    # shellcheck disable=SC2046,SC2086
    ${CXX:-g++} -std=c++20 record.cpp $(pkg-config --cflags --libs $static rtdata-sqlite) -o record
done
