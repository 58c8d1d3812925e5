#!/usr/bin/env python3
"""Whether comments of C++ files end at column 120, which clang-format leaves to us; `--write` wraps those on lines of their own.

Code is wrapped by clang-format, but for raw strings, which hold data. Lines with a URL may be longer.
"""
import pathlib
import re
import subprocess
import sys

MOST = 120
COMMENT = re.compile(r"( *///?)( *)(.*)")
ITEM = re.compile(r"- |\d+\. +")
BEGINS = re.compile(r"- |\d+\. |Thread:|Owner:|Errors?:|---")  # a line that none is joined to


def is_too_long(line):
    if len(line) <= MOST or "://" in line:
        return False
    return COMMENT.fullmatch(line) is not None or re.search(r"[;,{}] +// ?", line) or " ///< " in line


def wrapped(lines):
    """Prose alone: what is left of a line goes to the next one of its paragraph, or to one of its own."""
    lines, at = list(lines), 0
    while at < len(lines):
        parts = COMMENT.fullmatch(lines[at])
        if parts and is_too_long(lines[at]) and not (len(parts[2]) > 4 and ";" in parts[3]):
            item = ITEM.match(parts[3])
            start = parts[1] + parts[2] + " " * (len(item[0]) if item else 0)
            cut = lines[at].rfind(" ", 0, MOST + 1)
            rest, lines[at] = lines[at][cut + 1:], lines[at][:cut].rstrip()
            follows = COMMENT.fullmatch(lines[at + 1]) if at + 1 < len(lines) else None
            if follows and follows[3] and follows[1] + follows[2] == start and not BEGINS.match(follows[3]):
                lines[at + 1] = f"{start}{rest} {follows[3]}"
            else:
                lines.insert(at + 1, start + rest)
        at += 1
    return lines


root = pathlib.Path(__file__).resolve().parents[2]
listed = subprocess.run(["git", "ls-files", "*.hpp", "*.cpp"], cwd=root, capture_output=True, text=True, check=True)
problems = 0
for name in listed.stdout.split():
    lines = (root / name).read_text().split("\n")
    if "--write" in sys.argv and any(map(is_too_long, lines)):
        lines = wrapped(lines)
        (root / name).write_text("\n".join(lines))
    for number, line in enumerate(lines, 1):
        if is_too_long(line):
            problems += 1
            print(f"{name}:{number}: {len(line)} columns, more than {MOST}")
sys.exit(problems > 0)
