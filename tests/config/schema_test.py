#!/usr/bin/env python3
"""The JSON Schema and `rtdata check` hold each other: every example is changed in many ways, and what the one refuses the
other refuses too, as far as a schema can say it.

schema_test.py RTDATA SOURCE [MUTATIONS [SEED]]
"""
import copy
import json
import os
import random
import re
import subprocess
import sys
import tempfile

SKIPPED = 77
try:
    import warnings

    warnings.simplefilter("ignore")
    import jsonschema
except ImportError:
    print("skipped: python3-jsonschema is not installed (script/bootstrap --all installs it)")
    sys.exit(SKIPPED)

# What a schema cannot say, by the words of `check`: relations between values, what is out there, exact sizes.
BEYOND_A_SCHEMA = [
    "already, at", "writes .* already", "this is the configuration", "would write one file",  # between two items
    "carries .* of sensor", "differs in case only", "cannot record", "there is no tier",
    "every value would", "could not distinguish them",  # texts of outputs
    "is out of range",  # of durations and rates, which are texts
    "is finer than a nanosecond", "longer than 292 years", "18 digits", "rate of zero", "period of zero", "faster than 1 GHz",
    "more digits than the type", "for a duration", "3.4e38",
    "there is no folder", "is a folder", "is not a regular file", "cannot be written", "names no file",  # of the file system
    "no variable", "cannot read the secret", "is empty",
    "a name has 1 to 200", "is not a topic name", "topics that begin with",  # lengths, and names that stand for topics
    "`device` is missing", "has the width 0", "no field has a name", "among the fields", "is there twice", "is listed twice", "exists twice",
    "every event has a", "SQLite has that name", "only a float or double", "a field of JSON has no name", "need more than 4 KiB",
    "or 0 for no limit",  # a least value, or none
    "there is no format", "`keep` needs `rotate`", "needs a `priority`", "have a priority", "give `cpu` or `cpus`",
    "already at",  # a key that is there twice
    "`password` needs a `user`", "it has no effect without", "begins with -----BEGIN", "there is no sslmode", "there is no port",
    "in the manual of libpq", "a text in MQTT has at most",  # of other libraries and protocols
    "another SQLite database", "its content is not a valid", "by zero",  # what is in a file, or in an expression
    "shares the topic", "sets the output", "of settings; the guard",
    "topic: there is no topic", "host: there is no host", "a URL contains only ASCII letters", "it has no scheme",  # what a text holds
    "give the bus a longer `timeout`", "it has both `file` and `device`",  # between two values
    r"at character \d+: ",  # in a regular expression
    "there is no bus", "there is no sink", "cannot go through another", "is not among those of the recording", "this needs sqlite", r"\.(address|identity|line): ",  # names of other parts; numbers that may be texts
]


def without_comments(text):
    return re.sub(r'("(?:\\.|[^"\\])*")|//[^\n]*|/\*.*?\*/', lambda m: m.group(1) or "", text, flags=re.S)


def places(value, path=()):
    yield path
    if isinstance(value, dict):
        for key in value:
            yield from places(value[key], path + (key,))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from places(item, path + (index,))


def properties(schema, path=()):
    """Of a schema, what has a default."""
    if isinstance(schema, dict):
        if "default" in schema and path and path[-1] != "properties":
            yield path, schema
        for key in schema:
            yield from properties(schema[key], path + (key,))
    elif isinstance(schema, list):
        for index, item in enumerate(schema):
            yield from properties(item, path + (index,))


VALUES = [None, True, 0, 1, -1, 3.0, 3.7, 1e300, 12345678901, "", "x", "a b", "#", "a/#/b", "+/x", "$x", "10 ms", "10ms", "-5 ms",
          "1.5 h", "10", "100 Hz", "every 2 s", "6 /min", "fast", "nul\u0000", "line\nend", [], [1], ["#"], [["#"]], {}, {"x": 1},
          {"env": "PATH"}, {"env": "RTDATA_TEST_NO_SUCH_VARIABLE"}, {"file": "/no/such/file"}, {"env": ""}, {"env": 1},
          {"env": "PATH", "x": 1}, "\u00e9", "\t"]


def mutated(original, rng):
    """A changed copy, and what was changed."""
    document = copy.deepcopy(original)
    path = rng.choice([place for place in places(document) if place])
    parent = document
    for step in path[:-1]:
        parent = parent[step]
    kind = rng.choice(["value", "value", "value", "remove", "unknown", "again"])
    if kind == "value":
        value = rng.choice(VALUES)
        parent[path[-1]] = value
        return document, f"{path} = {value!r}"
    if kind == "remove":
        del parent[path[-1]]
        return document, f"without {path}"
    if kind == "unknown" and isinstance(parent, dict):
        parent["unknown_key"] = 1
        return document, f"unknown key beside {path}"
    if isinstance(parent, list):
        parent.append(copy.deepcopy(parent[path[-1]]))
        return document, f"{path} twice"
    parent["type"] = "x"
    return document, f"type x beside {path}"


def main():
    program, source = os.path.abspath(sys.argv[1]), sys.argv[2]
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 400
    rng = random.Random(int(sys.argv[4]) if len(sys.argv) > 4 else 1)
    schema = json.loads(subprocess.run([program, "types", "--schema"], capture_output=True, check=True, text=True).stdout)
    jsonschema.Draft7Validator.check_schema(schema)
    validator = jsonschema.Draft7Validator(schema)
    outside = [f"{'.'.join(map(str, path))}: its default {value['default']!r} is refused by its own schema: {error.message[:120]}"
               for path, value in properties(schema) for error in jsonschema.Draft7Validator(value).iter_errors(value["default"])]
    known_types = {name for part in ("sensors", "sinks")
                   for name in schema["properties"][part]["items"]["properties"]["type"]["enum"]}
    originals = []
    examples = os.path.join(source, "examples")
    os.environ["COLLECTOR"] = "http://127.0.0.1:9/x"  # which http_node.json asks for
    for name in sorted(os.listdir(examples)):
        if not name.endswith(".json"):
            continue
        with open(os.path.join(examples, name), encoding="utf-8") as file:
            document = json.loads(without_comments(file.read()))
        items = document.get("sensors", []) + document.get("sinks", [])
        if all(item["type"] in known_types for item in items):  # else it is for a program with types of its own
            originals.append((name, document))
    # Every parameter of every type at its default, so that none is left out.
    with tempfile.TemporaryDirectory() as folder:
        needed = {"console": {}, "file": {"path": "file.out"}, "http": {"url": "http://localhost/x"},
                  "mqtt": {"host": "localhost"}, "postgresql": {"host": "localhost"}, "sqlite": {"path": "sqlite.out"},
                  "tcp": {"host": "localhost", "port": 9}, "udp": {"host": "localhost", "port": 9}}
        full = {"tiers": {"t": {"policy": "fifo", "priority": 5, "cpus": [0], "spin": "10 us"}}, "loop": {"hold_limit": "10 ms"},
                "log": {"level": "debug", "file": "x.log"}, "$schema": "rtdata.schema.json", "notes": "n",
                "sensors": [{"type": "analog", "name": "a", "file": "adc", "rate": "10 Hz", "tier": "t"},
                            {"type": "serial", "name": "s", "device": "/dev/x", "fields": [{"name": "x"}]}],
                "sinks": [{"type": kind, **needed[kind]} for kind in schema["properties"]["sinks"]["items"]["properties"]["type"]["enum"]]}
        for part in ("sensors", "sinks"):
            for case in schema["properties"][part]["items"]["allOf"]:
                for item in full[part]:
                    if item["type"] != case["if"]["properties"]["type"]["const"]:
                        continue
                    for key, value in case["then"]["properties"].items():
                        if key not in item and "default" in value:
                            item[key] = value["default"]
        originals.append(("every parameter", full))
        path = os.path.join(folder, "mutated.json")

        def check(document):
            with open(path, "w", encoding="utf-8") as file:
                json.dump(document, file)
            run = subprocess.run([program, "check", path], capture_output=True, cwd=folder)
            return run.returncode, run.stdout.decode("utf-8", "replace")

        failures, refused = outside, 0
        for name, document in originals:
            status, words = check(document)
            errors = [error.message for error in validator.iter_errors(document)]
            if status != 0 or errors:
                failures.append(f"{name}: check {status}: {words}{errors}")
        for number in range(count):
            name, original = originals[number % len(originals)]
            document, change = mutated(original, rng)
            status, words = check(document)
            errors = [error.message for error in validator.iter_errors(document)]
            refused += status == 2
            if status not in (0, 2):
                failures.append(f"{name}, {change}: check ended with {status}")
            elif errors and status == 0:
                failures.append(f"{name}, {change}: the schema refuses what check takes: {errors[0][:200]}")
            elif status == 2 and not errors and not any(re.search(words_, words) for words_ in BEYOND_A_SCHEMA):
                failures.append(f"{name}, {change}: check refuses what the schema takes: {words}")
        print(f"{count} mutations of {len(originals)} configurations, {refused} refused, {len(failures)} disagreements")
        for failure in failures[:20]:
            print(failure)
        if refused < count / 4 or refused == count:
            failures.append("the mutations are no test")
        return 1 if failures else 0


sys.exit(main())
