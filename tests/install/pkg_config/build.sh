#!/bin/sh
# Compiles record.cpp of the working directory against the library that pkg-config finds.
set -eu
# shellcheck disable=SC2046
${CXX:-g++} -std=c++20 record.cpp $(pkg-config --cflags --libs --static rtdata-sqlite) -o record
