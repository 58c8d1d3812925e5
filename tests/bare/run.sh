#!/bin/sh
# A Debian with nothing installed, as a fresh machine: the README's commands there, with what script/bootstrap installs and
# nothing else, then script/demo and script/test.
#
#   tests/bare/run.sh bookworm|trixie [COMMAND...]     Debian 12 or 13; with a command, that one there, in the source tree
#
# The system is made by debootstrap, once (some minutes, 1 GB), and kept in ~/.cache/rt-data/NAME. The source tree is seen there
# as /rt-data, and its build/ is build/NAME here. Mounts are in a namespace of this script's processes: they are gone with them,
# however these end. It needs to be root. Exit 77: this machine cannot have it.
set -eu
cd "$(dirname "$0")/../.."
tree=$PWD
suite=${1:-}
case $suite in
bookworm | trixie) shift ;;
*) echo "usage: tests/bare/run.sh bookworm|trixie [COMMAND...]" >&2; exit 2 ;;
esac
cache=${XDG_CACHE_HOME:-$HOME/.cache}/rt-data/$suite
root=$cache/root

cannot() {
    echo "skipped: $*"
    exit 77
}

# ------------------------------------------------------------------ outside --
if [ "${RTDATA_BARE_INSIDE:-}" != "$tree" ]; then
    [ "$(id -u)" -eq 0 ] || cannot "a Debian to test in is made by root only"
    for tool in debootstrap unshare chroot; do
        command -v "$tool" >/dev/null || cannot "there is no $tool (script/bootstrap --all installs it on Debian)"
    done
    unshare --mount true 2>/dev/null || cannot "nothing can be mounted here"
    mkdir -p "$cache"
    exec 9>"$cache/lock"
    flock 9 # one at a time; released when the last process of this script ends
    if [ ! -e "$root/.made" ]; then
        # From where this machine has its own packages.
        # shellcheck disable=SC2016 # apt's variables
        from=$(apt-get indextargets --format '$(ORIGIN) $(LABEL) $(REPO_URI)' 'Created-By: Packages' 2>/dev/null |
            sed -n 's/^Debian Debian //p' | head -n 1)
        [ -n "$from" ] || cannot "apt here has no archive of Debian's to make $suite from"
        rm -rf "$root"
        unshare --mount --propagation private debootstrap --variant=minbase "$suite" "$root" "$from" >"$cache/debootstrap.log" 2>&1 ||
            cannot "debootstrap cannot make $suite: $(tail -n 1 "$cache/debootstrap.log")"
        # The archive is reached as here.
        apt-config dump | grep -E '^Acquire::(http|https|Check|Retries)' >"$root/etc/apt/apt.conf.d/90here" || true
        : >"$root/.made"
    fi
    mkdir -p build/$suite
    export RTDATA_BARE_INSIDE="$tree"
    exec unshare --mount --propagation private "$0" "$suite" "$@"
fi

# --------------------------------------- within a mount namespace of its own --
mkdir -p "$root/rt-data" "$root/ccache"
rm -rf "$root"/tmp/*
mount -t tmpfs tmpfs "$root/usr/local" # nothing is installed yet
mount --bind "$tree" "$root/rt-data"
mount -o remount,bind,ro "$root/rt-data"
mount --bind "$tree/build/$suite" "$root/rt-data/build"
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev" # terminals and shared memory
ccache_size=5G
if command -v ccache >/dev/null; then
    ccache_size=$(ccache --get-config max_size)
    ccache=$(ccache --get-config cache_dir)
    mkdir -p "$ccache"
    mount --bind "$ccache" "$root/ccache"
fi
# Names are resolved as here.
[ ! -e /etc/resolv.conf ] || cat /etc/resolv.conf >"$root/etc/resolv.conf"
[ ! -e /etc/hosts ] || cat /etc/hosts >"$root/etc/hosts"

# inside COMMAND...: a command there, in the source tree, with the environment of a fresh log-in.
inside() {
    chroot "$root" env -i HOME=/root PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 \
        CCACHE_DIR=/ccache CCACHE_MAXSIZE="$ccache_size" \
        sh -c 'cd /rt-data && exec "$@"' sh "$@"
}

if [ $# -gt 0 ]; then
    inside "$@"
    exit
fi

if [ "$(cat "$root/.bootstrapped" 2>/dev/null)" != "$(cksum <script/bootstrap)" ]; then
    inside script/bootstrap >build/$suite/bootstrap.log 2>&1 || {
        cat build/$suite/bootstrap.log
        cannot "script/bootstrap could not install what is needed there"
    }
    cat build/$suite/bootstrap.log
    [ "$(wc -l <build/$suite/bootstrap.log)" -le 10 ] # what apt says is nobody's to read
    # Not for users: ccache, since this is done again and again.
    inside apt-get install -y -qq --no-install-recommends ccache >/dev/null 2>&1 || true
    cksum <script/bootstrap >"$root/.bootstrapped"
fi

# The README's blocks marked "fresh machine", one after the other, in one shell; what they built serves the two scripts.
sed -n '/^<!-- test: fresh machine -->$/,/^```$/p' README.md | sed '/^<!--/d; /^```/d' >"build/$suite/readme.sh"
[ -s "build/$suite/readme.sh" ]
echo "== the README's commands"
inside sh -euxc '. build/readme.sh'
echo "== script/demo"
inside script/demo
echo "== script/test"
inside script/test

# Its libgpiod is another one than this machine's: with a kernel that has GPIO lines, the program runs in the bench by chroot.
[ "$suite" = trixie ] || exit 0
bench=tests/kernel/kernel-bench
status=0
$bench --setup || status=$?
if [ $status -eq 77 ]; then
    echo "skipped: GPIO with libgpiod 2"
    exit 0
fi
[ $status -eq 0 ]
echo "== GPIO with libgpiod 2, in the kernel bench"
# shellcheck disable=SC2016 # of the shell in there
$bench -t 300 -- sh -euc 'for one in dev proc sys; do mount --rbind /$one "$0/$one"; done
    exec chroot "$0" env RTDATA_TEST_LIBGPIOD=2 /rt-data/build/release/rtdata_kernel_gpio_tests --no-skipped-summary' "$root"
