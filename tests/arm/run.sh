#!/bin/sh
# Builds for ARM what is run there, and runs tests in an emulator: tests/arm/run.sh arm64|armhf
# Nothing is installed: Debian's packages for that architecture are unpacked into build/ARCHITECTURE-root.
# Exit 77: the compiler, the emulator or the packages are not to be had here.
set -eu
cd "$(dirname "$0")/../.."

arch=${1:-}
case $arch in
arm64) triplet=aarch64-linux-gnu qemu=qemu-aarch64 ;;
armhf) triplet=arm-linux-gnueabihf qemu=qemu-arm ;;
*) echo "usage: tests/arm/run.sh arm64|armhf" >&2; exit 2 ;;
esac

for tool in $triplet-g++ $qemu apt-get dpkg-deb; do
    command -v "$tool" >/dev/null || {
        echo "skipped: there is no $tool (script/bootstrap --all installs it on Debian)"
        exit 77
    }
done

root=$PWD/build/$arch-root
if [ ! -e "$root/complete" ]; then
    rm -rf "$root"
    apt=$root/apt
    mkdir -p "$apt/state/lists/partial" "$apt/cache/archives/partial"
    : >"$apt/status"
    # Of this system's release, from where its own packages come; updates and security fixes of it are not needed.
    release=$(sed -n 's/^VERSION_CODENAME=//p' /etc/os-release)
    keys=/usr/share/keyrings/debian-archive-keyring.gpg
    [ -e "$keys" ] && signed="[signed-by=$keys]" || signed=""
    # shellcheck disable=SC2016 # apt's variables
    apt-get indextargets --format '$(CODENAME) $(ORIGIN) $(REPO_URI) $(COMPONENT)' 'Created-By: Packages' |
        sort -u | while read -r codename origin uri component; do
        [ "$codename $origin" != "$release Debian" ] || echo "deb $signed $uri $codename $component"
    done >"$apt/sources.list"
    foreign_apt() {
        apt-get -qq -o APT::Architecture="$arch" -o APT::Architectures="$arch" -o Dir::State="$apt/state" \
            -o Dir::Etc::SourceList="$apt/sources.list" -o Dir::Etc::SourceParts=- \
            -o Dir::State::status="$apt/status" -o Dir::Cache="$apt/cache" -o APT::Sandbox::User="$(id -un)" \
            -o Debug::NoLocking=1 "$@"
    }
    if ! { foreign_apt update && foreign_apt install -y --download-only --no-install-recommends \
        libuv1-dev libsqlite3-dev libxxhash-dev libgpiod-dev libspdlog-dev libfmt-dev nlohmann-json3-dev libcli11-dev doctest-dev; }; then
        echo "skipped: the packages for $arch are not to be had here"
        exit 77
    fi
    # What they depend on, the C library above all, comes with the compiler.
    for name in libuv1 libsqlite3 libxxhash libgpiod libspdlog libfmt nlohmann-json3 libcli11 doctest; do
        for package in "$apt"/cache/archives/"$name"*.deb; do dpkg-deb -x "$package" "$root"; done
    done
    rm -rf "$apt"
    : >"$root/complete"
fi

cmake --preset "$arch"
cmake --build --preset "$arch" -j "$(nproc)" --target rtdata_tests
cd "build/$arch"
export RTDATA_TEST_EMULATOR="$(command -v $qemu) -L /usr/$triplet -E LD_LIBRARY_PATH=$root/usr/lib/$triplet"
# What is not about real time, which an emulator does not have, and starts no other program.
../../tests/build/ctest.sh "$arch" --timeout 900 -R '^(data|loop|sensors|config|contract)$'

# What the program records there, it and this machine's read alike.
emulated() { $RTDATA_TEST_EMULATOR ../rtdata "$@"; }
rm -rf recording
mkdir recording
cd recording
emulated run ../../../examples/host.json --for 1s --quiet
emulated verify host.db
here=../../release/rtdata
[ -x "$here" ] || { echo "skipped: there is no build/release/rtdata to read its recording with"; exit 0; }
"$here" verify host.db
for format in csv json; do
    emulated export host.db --topic host/process --format $format >there.txt
    "$here" export host.db --topic host/process --format $format >here.txt
    [ -s here.txt ]
    cmp here.txt there.txt
done
