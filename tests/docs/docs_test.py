"""Holds the documentation to the product:  docs_test.py SOURCE_DIR BUILD_DIR CXX

A comment on the line before a code block says what is done with it:
  <!-- test: configuration [TYPE...] -->   `rtdata check` finds no mistake in it; skipped where the program has no such type
  <!-- test: compile -->         it compiles
  <!-- test: run -->             its commands run, in one folder a page, with `rtdata` as the program and EXAMPLES
  <!-- test: python [MODULE...] -->  it runs in that folder, and prints something; skipped where a module is not installed
  <!-- test: file PATH -->       the file has it, word for word
  <!-- test: fresh machine -->   tests/bare/run.sh runs it, in the source tree, on a machine with nothing installed
The examples at the heads of public headers compile, with the names of example_names.hpp, but for those with "..." in them.
Parts that need the program are skipped, and that is said, when it is not built. `--write-types` puts what the program says of
its drivers into docs/chips.md. The tests of each requirement are listed in BUILD_DIR/requirements.txt.
"""
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

problems = []
BLOCK = re.compile(r"<!-- test: (?P<test>.+?) -->\n+```(?P<language>\w*)\n(?P<text>.*?)^```$", re.S | re.M)


def problem(where, what):
    problems.append(f"{where}: {what}")


def run(command, **options):
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, **options)


def python_with(modules):
    """This Python, or the system's, for which packages of the distribution are; None when neither has them."""
    for python in (sys.executable, "/usr/bin/python3"):
        if not modules or (Path(python).exists() and run([python, "-c", f"import {', '.join(modules)}"]).returncode == 0):
            return python
    return None


def pages(source):
    folders = (source, source / "docs", source / "docs/recipes")
    return [page for folder in folders for page in sorted(folder.glob("*.md"))] + [source / "examples/README.md"]


def has_type(program, name):
    return run([program, "types", name, "--schema"]).returncode == 0


def check_blocks(source, build, compiler, program):
    skipped = 0
    for page in pages(source):
        text = page.read_text()
        with tempfile.TemporaryDirectory() as folder:
            for block in BLOCK.finditer(text):
                where = f"{page.relative_to(source)}:{text.count(chr(10), 0, block.start()) + 1}"
                kind, _, argument = block["test"].partition(" ")
                if kind == "file":
                    if block["text"] not in (source / argument).read_text():
                        problem(where, f"{argument} does not have this text")
                elif kind == "compile":
                    file = Path(folder) / "block.cpp"
                    file.write_text(block["text"])
                    flags = ["-std=c++20", "-fsyntax-only", "-Wall", "-Wextra", f"-I{source}/include"]
                    done = run([compiler, *flags, file])
                    if done.returncode != 0 or done.stderr:
                        problem(where, "does not compile:\n" + done.stderr)
                elif kind == "fresh" and page == source / "README.md":
                    pass
                elif kind not in ("configuration", "run", "python"):
                    problem(where, f"unknown mark: {block['test']}")
                elif program is None:
                    skipped += 1
                elif kind == "configuration" and not all(has_type(program, one) for one in argument.split()):
                    print(f"skipped: {where}, since this program has no type {argument}")
                elif kind == "configuration":
                    file = Path(folder) / "block.json"
                    file.write_text(block["text"])
                    done = run([program, "check", file])
                    if done.returncode != 0:
                        problem(where, "is no good configuration:\n" + done.stdout + done.stderr)
                elif kind == "python" and (python := python_with(argument.split())) is None:
                    print(f"skipped: {where}, since not all of {argument} is installed (script/bootstrap --all)")
                elif kind == "python":
                    done = run([python, "-c", block["text"]], cwd=folder)
                    if done.returncode != 0 or not done.stdout:
                        problem(where, f"ends with {done.returncode}:\n" + done.stdout + done.stderr)
                else:
                    environment = dict(os.environ, PATH=f"{build}:{os.environ['PATH']}", EXAMPLES=str(source / "examples"))
                    done = run(["sh", "-euc", block["text"]], cwd=folder, env=environment)
                    if done.returncode != 0:
                        problem(where, f"ends with {done.returncode}:\n" + done.stdout + done.stderr)
    if skipped:
        print(f"skipped: {skipped} blocks that need the program, which is not built")


# How paragraphs begin that stand at the head of a header as examples do, and are no C++.
NOT_CODE = {
    "bench.json:7:43": "a problem, as it is printed",
    "12:00:00.123": "an event on a console",
    '{"timestamp"': "a datagram",
    '"tls": {': "of a configuration",
    "zero  = 2^bits": "a formula",
    "span  = 2^bits": "a formula",
}


def examples(header):
    """The indented blocks of the first comment: (line number, text) of each."""
    comment = re.match(r"(?:///.*\n)*", header.read_text())[0]
    for block in re.finditer(r"(?<=^///\n)(?:///     .*\n(?:///\n(?=///     ))?)+", comment, re.M):
        text = re.sub(r"^///(?:     )?", "", block[0], flags=re.M)
        for begin in NOT_CODE:
            text = re.sub(rf"(?:^|(?<=\n\n)){re.escape(begin)}.*?(?:\n\n|\Z)", "", text, flags=re.S)
        if text:
            yield comment.count("\n", 0, block.start()) + 1, text


def check_examples(source, compiler):
    """Each in a function, or in a namespace if it defines what only these can have. Two runs of the compiler, since one
    takes more memory."""
    headers = sorted((source / "include").rglob("*.hpp"))
    count = left_out = 0
    names = ["example_names.hpp", *(header.relative_to(source / "include") for header in headers)]
    includes = [f'#include "{name}"' for name in names]
    for part in range(2):
        blocks = []
        for header in headers[part::2]:
            name = header.relative_to(source)
            for line, text in examples(header):
                if "..." in text:
                    left_out += 1
                    continue
                count += 1
                if text.startswith("template <> struct rtdata::"):
                    begin, end = "", ""
                elif re.match(r"(?:class|struct|enum|int main)\b", text) and text.endswith(("\n}\n", "\n};\n")):
                    begin, end = f"namespace example::of{count} {{", "}"
                else:
                    begin, end = f"namespace example {{ Answer of{count}() {{", "return {}; } }"
                blocks.append(f'{begin}\n#line {line} "{name}"\n{text}\n{end}')
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "examples.cpp"
            file.write_text("\n".join(includes + blocks))
            done = run([compiler, "-std=c++20", "-fsyntax-only", "-Werror=unused-result", f"-I{source}/include",
                        f"-I{source}/tests/docs", file])
        if done.returncode != 0:
            problem("examples at the heads of headers", "do not compile:\n" + done.stderr)
    print(f"{count} examples of headers compile, or are told below; {left_out} with ... are left out")


def check_links(source):
    for page in pages(source):
        text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.S | re.M)
        for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", text):
            if not (page.parent / target).exists():
                problem(page.relative_to(source), f"a link to {target}, which is not there")


def check_paths(source):
    """What architecture.md has in backticks and looks like a file or a folder is there; a bare name, anywhere."""
    page = "docs/architecture.md"
    names = {path.name for folder in ("src", "include", "tests", "docs", "script", "examples")
             for path in (source / folder).rglob("*")}
    text = (source / page).read_text()
    for number, line in enumerate(text.splitlines(), 1):
        for word in " ".join(re.findall(r"`([^`]+)`", line)).split():
            if re.fullmatch(r"[\w-]+\.(?:cpp|hpp|py|md|sh|sources|json|c)", word):
                is_there = word in names
            elif re.fullmatch(r"(?:src|include|tests|docs|script|examples)/[\w./-]*", word):
                is_there = (source / word).exists()
            else:
                continue
            if not is_there:
                problem(f"{page}:{number}", f"there is no {word}")


def check_errors(source, program):
    """Each id has a section, which says what to do and ends with a message; what people meet ends with an id."""
    table = re.search(r"\bids\[\] = \{(.*?)\};", (source / "src/data/error.cpp").read_text(), re.DOTALL)[1]
    ids = re.findall(r'"([a-z-]+)"', table)
    enumerators = "|".join(name.replace("-", "_") for name in ids if "-" in name)
    for path in (source / "include").rglob("*.hpp"):
        for word in re.findall(rf"^ *//.*?(?<!::)\b({enumerators})\b", path.read_text(), re.M):
            problem(path.relative_to(source), f"calls an error {word}, whose id is {word.replace('_', '-')}")
    for path in [*(source / "src").rglob("*.[ch]pp"), *(source / "include").rglob("*.hpp")]:
        text = path.read_text()
        ids += ["unknown-" + kind for kind in re.findall(r'\bnames_part\("(\w+)"', text)]
        ids += re.findall(r'\.problem\(\s*"([a-z]+)", ', text)
        for call in re.findall(r"\b(?:problem\w*|warn\w*|add|report|mistake|told|fail|print_error)\(([^;]*?);", text):
            ids += re.findall(r'"([a-z]+(?:-[a-z]+)+)"', call)
    page = (source / "docs/errors.md").read_text()
    sections = dict(re.findall(r"^### `([a-z-]+)`\n(.*?)(?=^##|\Z)", page, re.M | re.S))
    for name in sorted(set(ids) - {"ok"} - set(sections)):
        problem("docs/errors.md", f"no heading for {name}")
    for name, text in sections.items():
        if "**Do:**" not in text:
            problem("docs/errors.md", f"{name} does not say what to do")
        if not re.search(rf"^    \S.* \[{name}\]\n*\Z", text, re.M):
            problem("docs/errors.md", f"{name} does not end with a message as it looks")
    if program is None:
        print("skipped: the ids of what the program prints, since it is not built")
        return
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "wrong.json").write_text(
            '{"sensors": [{"name": "a", "type": "host", "quantity": "load", "rate": "1 Hz", "rtae": "1 Hz"}]}')
        for command, wanted in (("check wrong.json", "unknown-key"), ("verify none.db", "not-found"),
                                ("info none.db", "not-found"), ("verify wrong.json", "not-a-recording"),
                                ("types hots", "unknown-type"), ("run --fro", "bad-argument"), ("vrify", "bad-argument")):
            done = run([program, *command.split()], cwd=folder)
            line = ((done.stdout + done.stderr).splitlines() or [""])[0]
            if wanted not in sections or not line.endswith(f" [{wanted}]"):
                problem("docs/errors.md", f"does not explain the error of `rtdata {command}`: {line}")


GENERATED = re.compile(r"(<!-- begin of what `rtdata types` says -->\n).*(<!-- end of it -->\n)", re.S)


def drivers_page(program):
    """What `rtdata types` says of the sensors on buses, with an overview in front."""
    done = run([program, "types", "--markdown"])
    if done.returncode != 0:
        raise RuntimeError(done.stderr)
    groups = [part for part in re.split(r"^(?=# )", done.stdout, flags=re.M) if re.match(r"# Sensors on `", part)]
    overview = "| type | on | gives |\n|---|---|---|\n"
    for group in groups:
        bus = re.match(r"# Sensors on (`[^`]+`)", group)[1]
        for name, phrase in re.findall(r"^## `([^`]+)`\n\n(.*)\.$", group, re.M):
            overview += f"| [`{name}`](#{name}) | {bus} | {phrase} |\n"
    return overview + "\n" + "\n".join(group.strip() + "\n" for group in groups)


def check_drivers_page(source, program, rewrite):
    if program is None:
        print("skipped: docs/chips.md, since the program is not built")
        return set()
    page, wanted = source / "docs/chips.md", drivers_page(program)
    text = page.read_text()
    fresh = GENERATED.sub(lambda match: match[1] + wanted + match[2], text)
    if rewrite:
        page.write_text(fresh)
    elif not has_type(program, "modbus"):
        print("skipped: docs/chips.md, since this program has no type modbus")
    elif fresh != text or not GENERATED.search(text):
        problem("docs/chips.md", "is not what `rtdata types` says: write it with docs_test.py ... --write-types")
    return set(re.findall(r"^## `([^`]+)`$", wanted, re.M))


def documented(source):
    """Of each section of configuration.md: the defaults of each parameter in its tables. A bus, a sensor and a sink may
    have the same name."""
    sections, rows = {}, {}
    for line in (source / "docs/configuration.md").read_text().splitlines():
        if line.startswith("#"):
            rows = sections.setdefault(line.strip("# `"), {})
        elif line.startswith("| `"):
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            rows.setdefault(cells[0].strip("`"), []).append(cells[3].strip("`"))
    return sections


# Types whose common parameters have a section of their own.
OF_LINES = ("serial", "tcp", "udp", "command", "mqtt", "http")


def check_types(source, program, elsewhere):
    """`elsewhere`: types whose parameters another page has."""
    if program is None:
        print("skipped: the parameters of `rtdata types`, since the program is not built")
        return
    sections, group, name, parent, columns = documented(source), "", "", "", {}
    for line in run([program, "types", "--all"]).stdout.splitlines():
        if match := re.match(r"(\w+) types$", line):
            group = f"Every {match[1]}"
        elif line.startswith("formats"):
            break
        elif match := re.match(r"([a-z][\w-]*)  \S", line):
            name = match[1]
            if name not in sections and name not in elsewhere:
                problem("docs/configuration.md", f"no section for the type {name}")
        elif line.startswith("  parameter "):
            columns = {word: line.index(word, line.index("type")) for word in ("default", "meaning")}
        elif name not in elsewhere and (match := re.match(r"( +)([a-z]\w*)  ", line)):
            key, default = match[2], line[columns["default"]:columns["meaning"]].strip()
            is_member = len(match[1]) > 2  # of the parameter before it
            parent = parent if is_member else key
            groups = [name, group] + (["Lines of text"] if name in OF_LINES else [])
            places = [f"{one}`: `{parent}" for one in groups] if is_member else groups
            wanted = [one for s in places for one in sections.get(s, {}).get(key, [])]
            if not wanted:
                problem("docs/configuration.md", f"nothing of the parameter {key} of {name}")
            elif default not in wanted:
                problem("docs/configuration.md", f"the default of {key} of {name} is {default!r}, not {' or '.join(wanted)!r}")


LITERAL = r'"(?:[^"\\\n]|\\.)*"'


def test_names(source):
    """Of all test cases; a name may be several literals, one after the other."""
    names = []
    for file in sorted((source / "tests").rglob("*.cpp")):
        for literals in re.findall(rf"TEST_CASE(?:_TEMPLATE)?\(\s*((?:{LITERAL}\s*)+)", file.read_text()):
            names.append("".join(literal[1:-1] for literal in re.findall(LITERAL, literals)).replace('\\"', '"'))
    return names


def tests_of(identifier, names):
    """US-13/42 is US-13 or US-42."""
    first, *others = identifier.split("/")
    ids = {first} | {first.split("-")[0] + "-" + other for other in others}
    return [name for name in names if ids & set(re.findall(r"\b(?:US|NFR|FW)-\d+", name))]


# Types of handles that handle_contract_test.cpp need not try, and why.
NOT_TRIED = {
    "AnySensor": "the base of sensors",
    "AnyFeed": "the base of feeds",
}


def check_handles(source):
    contract = "tests/contract/handle_contract_test.cpp"
    text = (source / contract).read_text()
    listed = re.findall(r"\bOf\w+", " ".join(re.findall(r"#define \w*HANDLES((?:.*\\\n)*.*)", text)))
    tried = set()
    for entry in listed:
        found = re.search(rf"struct {entry}\b[^{{]*{{\n(?:.*\n)*?  using Type = (?:\w+::)*(\w+)", text)
        tried.add(found[1] if found else entry)
    types = set()
    for header in sorted((source / "include").rglob("*.hpp")):
        types |= set(re.findall(r"^class (\w+)(?: final)? : public (?:Handle|AnySensor|AnyFeed|Sink)\b",
                                header.read_text(), re.M))
    for name in sorted(types - tried - set(NOT_TRIED)):
        problem(contract, f"HANDLES lacks {name}")
    for name in sorted(set(NOT_TRIED) & tried | set(NOT_TRIED) - types):
        problem("tests/docs/docs_test.py", f"NOT_TRIED need not have {name}")
    names = test_names(source)
    for test in re.findall(r"`(handle rule [^`]+)`", (source / "docs/handles.md").read_text()):
        if test not in names:
            problem("docs/handles.md", f"there is no test {test!r}")


def plain(text):
    """Without marks, links and line ends."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return " ".join(re.sub(r"[`*]|\.(?:md|hpp)\b", "", text).split())


def items(text):
    """Of the first numbered list, also of one in a header's comment."""
    found = re.search(r"^ *1\. .*\n(?:(?: *\d+\. | {2,}\S).*\n)+", re.sub(r"^/// ?", "", text, flags=re.M), re.M)
    return [plain(one) for one in re.split(r"^ *\d+\. ", found[0], flags=re.M)[1:]]


def check_sentences(source):
    """What a header and a page both list, they list in the same words; the page may go on."""
    rules = items((source / "include/rtdata/loop/handle.hpp").read_text())
    rows = re.findall(r"^\| \d \| (.*?) \| `", (source / "docs/handles.md").read_text(), re.M)
    if rules != [plain(row) for row in rows]:
        problem("docs/handles.md", "its rules are not those of include/rtdata/loop/handle.hpp, word for word")
    life = items((source / "include/rtdata/sensors/sensor.hpp").read_text())
    page = items((source / "docs/sensors.md").read_text().split("## Its life")[1])
    if len(life) != len(page) or not all(there.startswith(here) for here, there in zip(life, page)):
        problem("docs/sensors.md", "its life is not that of include/rtdata/sensors/sensor.hpp, word for word")


def check_requirements(source, build):
    """Each row names a test or two; all of them are listed in the build's folder."""
    page, names = source / "docs/requirements.md", test_names(source)
    full = []
    for line in page.read_text().splitlines():
        match = re.match(r"\| ((?:US|NFR|FW)-[\d/]+) \| ([^|]*) \|(.*)\|$", line)
        if not match:
            continue
        tests, shown = tests_of(match[1], names), re.findall(r"`([^`]+)`", match[3])
        for test in shown:
            if test not in tests and not (source / test).exists():
                problem(f"docs/requirements.md, {match[1]}", f"there is no test {test!r} of it")
        if not 1 <= len(shown) <= 2:
            problem(f"docs/requirements.md, {match[1]}", "names no test, or more than two")
        full.append("\n".join([f"{match[1]} {match[2].strip()}"] + [f"  {test}" for test in tests]))
    (build / "requirements.txt").write_text("\n".join(full) + "\n")


def main():
    source, build, compiler = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve(), sys.argv[3]
    program = build / "rtdata" if (build / "rtdata").exists() else None
    if "--write-types" in sys.argv:
        check_drivers_page(source, program, rewrite=True)
        return 0 if program else 1
    check_blocks(source, build, compiler, program)
    check_examples(source, compiler)
    check_links(source)
    check_paths(source)
    check_errors(source, program)
    check_types(source, program, check_drivers_page(source, program, rewrite=False))
    check_handles(source)
    check_sentences(source)
    check_requirements(source, build)
    print("\n".join(problems))
    print(f"{len(problems)} problems" if problems else "the documentation agrees with the product")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
