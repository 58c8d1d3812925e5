#!/usr/bin/env python3
"""Includes point one way (docs/architecture.md), public headers include nothing of other libraries, and each of them
compiles alone: layers.py [COMPILER]. Without a compiler, only the includes are looked at."""
import pathlib
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from os import cpu_count

root = pathlib.Path(__file__).resolve().parents[2]
# What a component declares of its parameters lies below the components; the rest of config lies above them.
declarations = {"problem", "item", "convert", "parameter"}
below = {
    "data": set(),
    "parameters": {"data"},
    "loop": {"data"},
    "io": {"data", "loop", "parameters"},
    "sensors": {"data", "loop", "parameters", "io"},
    "sinks": {"data", "loop", "parameters", "io"},
    "config": {"data", "loop", "parameters", "bases"},
}
bases = {"sensors/sensor", "sensors/sensor_parameters", "sensors/feed", "sinks/sink"}
problems = []


def layer_of(name):
    """Of "sensors/sensor.hpp"."""
    folder, _, file = name.partition("/")
    return "parameters" if folder == "config" and file.removesuffix(".hpp") in declarations else folder


def look_at(path, folder):
    name = path.relative_to(folder).as_posix()
    layer = layer_of(name)
    public = folder.name == "rtdata"
    for number, line in enumerate(path.read_text().split("\n"), 1):
        found = re.match(r'\s*#\s*include\s*([<"])([^>"]+)[>"]', line)
        if not found:
            continue
        where = f"{path.relative_to(root)}:{number}"
        included = found.group(2)
        if found.group(1) == "<":
            if public and ("/" in included or "." in included):
                problems.append(f"{where}: a public header includes <{included}>, which is not the standard library's")
            continue
        if public and not included.startswith("rtdata/"):
            problems.append(f"{where}: a public header includes \"{included}\", which is not installed")
            continue
        included = included.removeprefix("rtdata/")
        if layer == "app" or layer not in below:
            continue
        other = layer_of(included)
        is_base = "bases" in below[layer] and included.removesuffix(".hpp") in bases
        if other != layer and other not in below[layer] and not is_base:
            problems.append(f"{where}: {layer} includes {other} ({included})")


for folder in (root / "include" / "rtdata", root / "src"):
    for path in sorted(folder.glob("**/*.hpp")) + sorted(folder.glob("**/*.cpp")):
        look_at(path, folder)


def compile_alone(path):
    name = path.relative_to(root / "include").as_posix()
    done = subprocess.run([sys.argv[1], "-std=c++20", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-I", root / "include",
                           "-x", "c++", "-"], input=f'#include "{name}"\n', capture_output=True, text=True)
    if done.returncode != 0:
        problems.append(f"{name} does not compile alone:\n{done.stderr}")


headers = sorted((root / "include").glob("**/*.hpp")) if len(sys.argv) > 1 else []
with ThreadPoolExecutor(cpu_count()) as workers:
    list(workers.map(compile_alone, headers))
for problem in problems:
    print(problem)
print(f"{len(headers)} headers compiled alone, {len(problems)} problems")
sys.exit(1 if problems else 0)
