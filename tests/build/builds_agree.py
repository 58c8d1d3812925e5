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

for package, least in re.findall(r"\b([a-z][\w-]+)>=(\d[\d.]*)", cmake):
    if not re.search(rf"dependency\('{package}', version: '>= ?{re.escape(least)}'", meson):
        problems.append(f"CMake needs {package} >= {least}, meson does not say so")

# CMake tells the parts that are in to the sources that ask for them, and sees nothing of what these include.
for path in sorted(p for folder in ("include", "src", "tests", "examples") for p in (root / folder).glob("**/*.hpp")):
    if "RTDATA_WITH_" in path.read_text():
        problems.append(f"{path.relative_to(root)} asks which parts are in: only what is in a list of sources may")
for path in sorted(p for folder in ("src", "tests", "examples") for p in (root / folder).glob("**/*.cpp")):
    if "RTDATA_WITH_" in path.read_text() and path.relative_to(root).as_posix() not in listed:
        problems.append(f"{path.relative_to(root)} asks which parts are in, and is in no list of sources")
parts = sorted(re.findall(r'"([A-Z]+) [a-z][\w-]+>=', cmake))
told = re.search(r"foreach name, library : \{([^}]*)\}\n  if [^\n]*\n    add_project_arguments\('-DRTDATA_WITH_", meson)
if not told or sorted(re.findall(r"'([A-Z]+)':", told.group(1))) != parts:
    problems.append(f"meson tells the sources of other parts than CMake does: {', '.join(parts)}")

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
