#!/usr/bin/env python3
"""Compiles each file in compile_fail/, which must fail with the one sentence in its `// expect:` line.

Usage: compile_fail.py COMPILER INCLUDE_DIRECTORY
A file whose first line has no `// expect: ` must compile. Exactly one error may be reported, so that a user reads
the sentence and not what follows from it; and 12 lines in all, or as many as a second line `// lines:` says.
"""
import concurrent.futures
import os
import pathlib
import re
import subprocess
import sys


def check(compiler, include, path):
    first, second = path.read_text().splitlines()[:2]
    expected = re.match(r"// expect: (.+)", first)
    lines = re.match(r"// lines: (\d+)", second)
    longest = int(lines[1]) if lines else 12
    # The language of the messages must not depend on the user's.
    run = subprocess.run(
        [compiler, "-std=c++20", "-fsyntax-only", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I", include, str(path)],
        capture_output=True, text=True, env={**os.environ, "LC_ALL": "C"})
    errors = [line for line in run.stderr.splitlines() if re.search(r"\b(fatal )?error: ", line)]
    if expected is None:
        return "" if run.returncode == 0 else "must compile, but: " + "\n".join(errors)
    if run.returncode == 0:
        return "compiles, but must fail with: " + expected[1]
    if len(errors) != 1:
        return f"{len(errors)} errors, not one:\n" + "\n".join(errors)
    if expected[1] not in errors[0]:
        return f"expected: {expected[1]}\n     got: {errors[0]}"
    if run.stderr.count("\n") > longest:
        return f"{run.stderr.count(chr(10))} lines, more than {longest}:\n{run.stderr}"
    return ""


def main():
    compiler, include = sys.argv[1:]
    files = sorted((pathlib.Path(__file__).parent / "compile_fail").glob("*.cpp"))
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        results = list(pool.map(lambda path: check(compiler, include, path), files))
    failed = 0
    for path, problem in zip(files, results):
        print(f"{'FAIL' if problem else 'ok  '} {path.name}")
        if problem:
            failed += 1
            print(problem)
    print(f"{len(files)} files, {failed} failed")
    return 1 if failed or not files else 0


if __name__ == "__main__":
    sys.exit(main())
