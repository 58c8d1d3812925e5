#!/usr/bin/env python3
"""measured.py COMMAND...: runs a compiler, and writes what it took as a line of the file RTDATA_MEASURED: KiB at its peak, CPU
seconds, output. As ccache's prefix_command it sees what is compiled and not what the cache has.
measured.py --check FILE KIB PERCENT: each of them took at most so much memory, and none more than so much of the CPU time."""
import os
import pathlib
import resource
import sys


def run(command):
    status = os.spawnvp(os.P_WAIT, command[0], command)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    output = command[command.index("-o") + 1] if "-o" in command else "-"
    with open(os.environ["RTDATA_MEASURED"], "a") as log:
        log.write(f"{used.ru_maxrss} {used.ru_utime + used.ru_stime:.2f} {output}\n")
    return status if status >= 0 else 128 - status


def check(path, most_memory, most_share):
    lines = [line.split(" ", 2) for line in pathlib.Path(path).read_text().splitlines()] if pathlib.Path(path).exists() else []
    built = [(int(peak), float(cpu), name) for peak, cpu, name in lines if "tests" not in name and "tmp." not in name]
    if not built:
        print("skipped: nothing was compiled that the compiler cache did not have, or there is no ccache to tell")
        return 77
    total = sum(cpu for _, cpu, _ in built)
    print(f"{len(built)} compilers of library and program: {total:.0f} CPU s; the tests' took {sum(float(c) for _, c, n in lines if 'tests' in n):.0f} CPU s")
    problems = 0
    for peak, cpu, name in sorted(built, reverse=True)[:10]:
        print(f"{peak // 1000} MB, {cpu:.1f} CPU s: {name}")
    for peak, cpu, name in built:
        if peak > most_memory:
            problems += 1
            print(f"too much memory: {peak} KiB for {name}")
        if len(built) > 40 and cpu > total * most_share / 100:
            problems += 1
            print(f"too much of the time: {cpu:.1f} of {total:.0f} CPU s for {name}")
    return 1 if problems else 0


if sys.argv[1] == "--check":
    sys.exit(check(sys.argv[2], int(sys.argv[3]), float(sys.argv[4])))
sys.exit(run(sys.argv[1:]))
