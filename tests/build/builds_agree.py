#!/usr/bin/env python3
"""The CMake and the meson build are made from the same lists of sources, targets, version and needed libraries."""
import json
import pathlib
import re
import sys

root = pathlib.Path(__file__).resolve().parents[2]
cmake = (root / "CMakeLists.txt").read_text() + "".join(p.read_text() for p in sorted((root / "cmake").glob("*.cmake")))
meson = (root / "meson.build").read_text()
problems = []

version = re.search(r"project\(rtdata VERSION ([\d.]+)", cmake).group(1)
if f"version: '{version}'" not in meson:
    problems.append(f"CMake builds version {version}, meson another")

description = re.search(r'DESCRIPTION "([^"]+)"', cmake).group(1)
if f"description = '{description}'" not in meson:
    problems.append(f"CMake describes it as {description!r}, meson otherwise")

lists = sorted(p.relative_to(root).as_posix() for folder in ("src", "tests") for p in root.glob(f"{folder}/**/*.sources"))
for name in lists:
    for build, text in (("CMake", cmake), ("meson", meson)):
        if name not in text:
            problems.append(f"{build} does not use {name}")

listed = []
for name in lists:
    for line in (root / name).read_text().split("\n"):
        if line and not line.startswith("#"):
            listed.append(line)
            if not (root / line).is_file():
                problems.append(f"{name} lists {line}, which is not there")
for path in sorted(root.glob("src/**/*.cpp")):
    name = path.relative_to(root).as_posix()
    if listed.count(name) != 1 and name != "src/app/main.cpp":
        problems.append(f"{name} is in {listed.count(name)} lists of sources")

for package, least in re.findall(r"\b([a-z]\w+)>=(\d[\d.]*)", cmake):
    if not re.search(rf"dependency\('{package}', version: '>= ?{re.escape(least)}'", meson):
        problems.append(f"CMake needs {package} >= {least}, meson does not say so")

# What is installed beside libraries and headers.
for name in sorted(p.relative_to(root).as_posix() for p in (root / "packaging").iterdir()):
    for build, text in (("CMake", cmake), ("meson", meson)):
        if name not in text:
            problems.append(f"{build} does not install {name}")

# A user's build has no tests in it.
if not re.search(r'option\(RTDATA_TESTS "[^"]*" OFF\)', cmake):
    problems.append("CMake builds the tests unless told otherwise")
for call in re.findall(r"^ *executable\((?:[^()]|\([^()]*\))*\)", meson, re.M):
    if "doctest" in call and "build_by_default: false" not in call:
        problems.append("meson builds tests unless told otherwise: " + call.split("'")[1])
presets = json.loads((root / "CMakePresets.json").read_text())["configurePresets"]
if presets[0]["name"] != "base" or presets[0]["cacheVariables"].get("RTDATA_TESTS") != "ON":
    problems.append("the presets do not build the tests")

for problem in problems:
    print(problem)
print(f"{len(listed)} sources in {len(lists)} lists, {len(problems)} problems")
sys.exit(1 if problems else 0)
