#!/bin/sh
# Builds for 64-bit ARM, and runs tests there in an emulator: tests/arm/run.sh
# Nothing is installed: Debian's packages for that architecture are unpacked into build/arm64-root.
# Exit 77: the compiler, the emulator or the packages are not to be had here.
set -eu
cd "$(dirname "$0")/../.."

for tool in aarch64-linux-gnu-g++ qemu-aarch64 apt-get dpkg-deb; do
    command -v "$tool" >/dev/null || {
        echo "skipped: there is no $tool (script/bootstrap --all installs it on Debian)"
        exit 77
    }
done

root=$PWD/build/arm64-root
if [ ! -e "$root/complete" ]; then
    rm -rf "$root"
    apt=$root/apt
    mkdir -p "$apt/state/lists/partial" "$apt/cache/archives/partial"
    : >"$apt/status"
    foreign_apt() {
        apt-get -qq -o APT::Architecture=arm64 -o APT::Architectures=arm64 -o Dir::State="$apt/state" \
            -o Dir::State::status="$apt/status" -o Dir::Cache="$apt/cache" -o APT::Sandbox::User="$(id -un)" \
            -o Debug::NoLocking=1 "$@"
    }
    if ! { foreign_apt update && foreign_apt install -y --download-only --no-install-recommends \
        libuv1-dev libsqlite3-dev libxxhash-dev libspdlog-dev libfmt-dev nlohmann-json3-dev libcli11-dev doctest-dev; }; then
        echo "skipped: the packages for 64-bit ARM are not to be had here"
        exit 77
    fi
    # What they depend on, the C library above all, comes with the compiler.
    for name in libuv1 libsqlite3 libxxhash libspdlog libfmt nlohmann-json3 libcli11 doctest; do
        for package in "$apt"/cache/archives/"$name"*.deb; do dpkg-deb -x "$package" "$root"; done
    done
    rm -rf "$apt"
    : >"$root/complete"
fi

cmake --preset arm64
cmake --build --preset arm64 -j "$(nproc)" --target rtdata_tests
cd build/arm64
# What is not about real time, which an emulator does not have, and starts no other program.
ctest --output-on-failure --timeout 600 -R '^(data|config|contract)$'
