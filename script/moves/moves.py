#!/usr/bin/env python3
"""Rooms: moves headers and sources to the folders that their layers have, joins small headers with those that they belong to.

    python3 moves.py TREE      on a tree that is clean under git, or was moved before: what is done already is left alone

Ends with 1, and says why, where a source no longer has what is looked for; all else is done all the same.
"""
import pathlib
import re
import subprocess
import sys

tree = pathlib.Path(sys.argv[1]).resolve()
parts = pathlib.Path(__file__).resolve().parent / "moves.d"
problems = []

# --- What moves ------------------------------------------------------------------------------------------------------------
CHIPS = """accelerometer ads1x15 barometer bno055 imu ina inertial lm75 magnetometer max31855 max31856 max31865 mcp3x08 mhz19
nau7802 sht""".split()
# Below include/rtdata.
PUBLIC = {f"sensors/{name}.hpp": f"chips/{name}.hpp" for name in CHIPS} | {
    f"io/{name}.hpp": f"testing/{name}.hpp" for name in ("fake_gpio", "fake_i2c", "fake_serial", "fake_spi")} | {
    f"io/{name}.hpp": f"net/{name}.hpp" for name in ("http", "mqtt", "tls")} | {
    f"sinks/{name}.hpp": f"recording/{name}.hpp" for name in ("export", "recording", "replay", "sqlite", "verify")} | {
    "sinks/postgresql.hpp": "postgresql/sink.hpp",
    "sinks/postgresql_recording.hpp": "postgresql/recording.hpp",
    "control/pid.hpp": "control/controllers.hpp",
    "loop/lane.hpp": "detail/loop/lane.hpp",
    "loop/subscription_node.hpp": "detail/loop/subscription_node.hpp",
    "sensors/transaction.hpp": "detail/sensors/transaction.hpp",
    "sensors/adc_channels.hpp": "detail/chips/adc_channels.hpp",
    "sensors/choice.hpp": "detail/chips/choice.hpp",
    "config/parameter_info.hpp": "detail/config/parameter_info.hpp",
    "config/type_registry.hpp": "detail/config/type_registry.hpp",
}
# Below src: files, and folders with all that they hold.
SUPPORT = {
    "data": "first_line fitting name no_memory",
    "loop/core": "cycle_clock deadline fatal handler latch no_thread placed_list priority_mutex signals_blocked wake",
    "loop/events": "allowance", "loop/runtime": "repeats", "loop/tier": "processors", "io": "no_sigpipe",
}
NET = "host_lookup http_answer http_request http_url mqtt_connection mqtt_inlet mqtt_packet tcp_stream tls tls_session tls_stream"
SOURCES = {f"loop/support/{name}": f"{room}/{name}" for room, names in SUPPORT.items() for name in names.split()} | {
    f"io/{name}": f"net/{name}" for name in NET.split() + "libcurl libmosquitto libssl libz".split()} | {
    f"io/{name}": f"testing/{name}" for name in ("fake_gpio", "fake_i2c", "fake_serial", "fake_spi")} | {
    "loop/support/retry": "data/backoff",
    "io/libpq": "postgresql/libpq",
    "sinks/core/account_text": "recording/account_text",
    "config/plan/secret": "config/read/secret",
}
FOLDERS = {"sinks/sqlite": "recording", "sinks/postgresql": "postgresql", "sinks/net": "sinks/tcp"}
# Public headers that only the library and its program use.
INTO_SOURCES = {"include/rtdata/fsm/configured.hpp": "src/fsm/configured.hpp"}


def git(*arguments):
    done = subprocess.run(["git", "-C", tree, *arguments], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"git {' '.join(map(str, arguments))}: {done.stderr}")
    return done.stdout


def tracked():
    return [name for name in git("ls-files").splitlines() if (tree / name).is_file()]


def read(name):
    return (tree / name).read_text(encoding="utf-8")


def write(name, text):
    if not (tree / name).is_file() or read(name) != text:
        (tree / name).write_text(text, encoding="utf-8")


def replace(name, old, new):
    """Of the file under its old name; once."""
    text = read(name)
    if new in text:
        return
    if text.count(old) != 1:
        problems.append(f"{name}: there is {'no' if old not in text else 'more than one'} {old!r}")
        return
    write(name, text.replace(old, new))


def sorted_includes(text, before):
    """Each block of includes that was sorted is so again, without one that is there twice."""
    lines, out, at = text.split("\n"), [], 0
    old_lines = before.split("\n")
    is_include = re.compile(r'#include ["<]')
    seen = set()
    while at < len(lines):
        if not is_include.match(lines[at]):
            out.append(lines[at])
            at += 1
            continue
        end = at
        while end < len(lines) and is_include.match(lines[end]):
            end += 1
        block = lines[at:end]
        old_block = old_lines[at:end]
        if block != old_block and len(old_block) == len(block):
            kept = []
            for line in block:
                if line not in seen:
                    kept.append(line)
                seen.add(line)
            # The header of a file stands before the others of its block; one with another name does so no more.
            renamed = old_block[0].rpartition("/")[2] != block[0].rpartition("/")[2]
            if old_block == sorted(old_block) or renamed and old_block[1:] == sorted(old_block[1:]):
                kept.sort()
            block = kept
            if not block and end < len(lines) and lines[end] == "":
                end += 1
        else:
            seen.update(block)
        out.extend(block)
        at = end
    return "\n".join(out)


# --- Small headers join others ------------------------------------------------------------------------------------------------
def public(name):
    return f"include/rtdata/{name}.hpp"


def parse(name):
    """(comment at the head, includes in <>, includes in "", what its namespace holds)"""
    text = read(name)
    head, rest = text.split("#pragma once\n", 1)
    angled = re.findall(r"^#include (<[^>]+>)$", rest, re.M)
    quoted = re.findall(r'^#include ("[^"]+")$', rest, re.M)
    body = re.search(r"^namespace rtdata[\w:]* \{\n\n(.*?)\n*^\}  // namespace rtdata[\w:]*\n*\Z", rest, re.M | re.S)
    return head, angled, quoted, body.group(1) + "\n"


def add_includes(name, angled, quoted):
    text = read(name)
    for form, found in (("<", angled), ('"', quoted)):
        old = re.findall(rf"^#include ({form}[^>\"]+[>\"])$", text, re.M)
        own = '"' + name.removeprefix("include/") + '"'
        new = [one for one in found if one not in old and one != own]
        if not new:
            continue
        lines = "".join(f"#include {one}\n" for one in sorted(set(old + new)))
        blocks = list(re.finditer(rf"(?:^#include {form}[^>\"]+[>\"]\n)+", text, re.M))
        if blocks:  # the first: loop.hpp has another one at its end
            first = blocks[0]
            lines = "".join(f"#include {one}\n" for one in sorted(set(re.findall(r"#include (.+)", first.group())) | set(new)))
            text = text[:first.start()] + lines + text[first.end():]
        elif form == "<":
            text = text.replace("#pragma once\n\n", "#pragma once\n\n" + lines + "\n", 1)
        else:
            text = text.replace("\nnamespace rtdata", "\n" + lines + "\nnamespace rtdata", 1)
    write(name, text)


merged = {}  # of the file that is gone: where its text is now


def join(crumb, into, before, comment="", at="", head="", skip=()):
    """`before`: the text of `into` before which the crumb is put; "": at the end of the namespace. `comment`: takes the place
    of the crumb's; before `at`, or before all of it. `head`: what the crumb's comment must begin with, so that a comment
    that somebody has rewritten is not thrown away."""
    merged[public(crumb)] = public(into)
    if not (tree / public(crumb)).is_file():
        return
    comment_of, angled, quoted, body = parse(public(crumb))
    if not comment_of.startswith(head):
        problems.append(f"{public(crumb)}: its comment begins with {comment_of[:90]!r}; look at the one in moves.py")
    target = read(public(into))
    if before and target.count(before) != 1:
        problems.append(f"{public(into)}: {target.count(before)} times {before!r}; {crumb} is not joined")
        del merged[public(crumb)]
        return
    if at and body.count(at) != 1:
        problems.append(f"{public(crumb)}: {body.count(at)} times {at!r}; it is not joined")
        del merged[public(crumb)]
        return
    body = body.replace(at, comment + at) if at else comment + body
    put(public(into), body, before)
    add_includes(public(into), angled, [one for one in quoted if one not in skip])
    git("rm", "-q", "-f", public(crumb))


def put(name, body, before):
    text = read(name)
    if before:
        text = text.replace(before, body + "\n" + before)
    else:
        end = text.index("\n}  // namespace rtdata\n", text.rindex("\n}  // namespace rtdata\n") - 1)
        text = text[:end] + "\n" + body + text[end:]
    write(name, text)


join("data/text_or_number", "data/config_value", "namespace config_detail {\n\nbool read_boolean", head="/// TextOrNumber: what a value", comment="""\
/// What a value of a configuration may be that is a text or a whole number; the schema says it:
///
///     template <>
///     struct rtdata::ConfigValue<Address> {
///       static constexpr TextOrNumber accepts{8, 119, "^0x[0-7][0-9a-f]$"};  // "0x76", or 118
///       static bool read(const ConfigItem&, Address&, Problems&);
///       static void write(const Address&, ConfigItem&);
///     };
""")
join("data/instant", "data/time", '/// "10 ms", "1.5s", "250us", "2 min", "1 h", "3 d"; units', head="/// What counts as one instant.")
join("io/i2c_address", "io/registers", "/// Where a chip with registers is: on SPI if it has a chip select",
     head="/// I2cAddress: the place of a chip on an I2C bus.")
join("io/serial_settings", "io/serial", "/// What carries the bytes: the kernel's serial line", head="/// SerialSettings: how the bits go",
     at="struct SerialSettings {", comment="""\
/// How the bits go over a serial line. Default: 9600 8N1.
///
///     rtdata::SerialSettings settings{.baud_rate = 115200, .parity = rtdata::Parity::even};
""")
join("loop/callback_times", "loop/callback", "", head="/// CallbackTimes: how long the callbacks of one object took",
     at="struct CallbackStatus {", comment="""\
///
///     for (const rtdata::CallbackStatus& one : loop.callbacks())
///       std::cout << one.name << ": " << rtdata::to_string(one.times.max) << '\\n';
""")
join("loop/load", "loop/loop", "/// Where an error came from and how it reads, as `on_error` gets it.", head="/// Load: how long the sensors of a loop may hold it",
     at="struct LoopLoad {", comment="""\
/// How long the sensors of a loop may hold it, estimated before it runs from what their drivers declare.
///
///     rtdata::Tier fast(loop, {.name = "fast"});
///     rtdata::Sensor<Pressure> chamber(fast.loop(), {.name = "chamber", .rate = 1_kHz, .read_time = 200us}, read_adc);
///     const rtdata::LoopLoad load = fast.loop().load();
///     if (load.is_overloaded()) complain(load.text());  // "fast: 1 sensor, worst 200 us of 1 ms, 20 %"
///
/// `worst` is the sum of the reads that come due within the loop's shortest period: each sensor once, but of sensors
/// that share a longer period only those whose phases lie within one shortest period of each other. Sensors of
/// different periods, without a schedule or not running are assumed to coincide. A read on a lane counts for the lane;
/// it holds the loop only while it is decoded, at another time for each sensor, and so counts there with its share of
/// the shortest period. Handlers are not counted.
""")
join("loop/scheduling", "loop/runtime", "/// A loop or tier, and the thread that it runs on.", head="/// Scheduling: the policy and priority of threads",
     at="struct Scheduling {", comment="""\
/// The policy and priority of a thread, as the kernel keeps them (sched(7)). The functions act on the calling thread.
///
///     rtdata::PriorityRange range = rtdata::priority_range(rtdata::SchedulingPolicy::fifo);   // 1 to 99
///     if (auto set = rtdata::set_scheduling({rtdata::SchedulingPolicy::fifo, 80}); !set)
///       std::cerr << set.error().text();
///
/// Real-time policies need permission: run as root, or with CAP_SYS_NICE (`setcap cap_sys_nice,cap_ipc_lock+ep
/// PROGRAM`), or with `rtprio` in /etc/security/limits.conf, or `LimitRTPRIO=` in a systemd unit.
""")
join("loop/health", "loop/runtime", "struct SensorStatus {\n", head="/// Changes of health of the parts of a system, as events.",
     at="struct HealthChange {", comment="""\
/// A change of health of a part of a system, as an event:
///
///     auto s = loop.subscribe<rtdata::HealthChange>("$rtdata/health", [](const rtdata::Event<rtdata::HealthChange>& e)
///     {
///       if (e->state == rtdata::Health::faulted) alarm(e->kind, e->name, e->reason);
///     });
///
/// One event for each change between ok, degraded and faulted, of whatever tier; its time is that of the change. `#`
/// does not match the topic; a sink records it when it names it. Recordings in SQLite keep the changes in any case, in
/// the table rtdata_health.
///
/// By kind: the name in the event, and what the states mean:
///   sensor   its name.            degraded: reads fail. faulted: closed, and tried again now and then; or stopped by
///                                 `on_overrun`.
///   sink     its name.            faulted: it cannot store.
///   lane     the device or bus.   degraded: a job was given up, its thread left behind. faulted: no thread is left to
///                                 run jobs.
///   loop     its or the tier's.   degraded: held longer than its limit in the last 10 s.
///   tier     its name.            faulted: it does not turn (see TierWatch).
""")
join("loop/configuration_change", "loop/runtime", "class Runtime {\n", head="/// ConfigurationChange: what the configuration of a run",
     comment="/// What the configuration of a run says from a time on, as recordings keep it (rtdata_configuration).\n")
join("loop/account", "loop/ledger", "", head="/// The final account: an event for each sensor and feed", at="struct FinalCounts {", comment="""\
/// The final account: an event for each sensor and feed with what became of its data, published on `$rtdata/account`
/// when a loop closes, after the last event of all others and before sinks close.
///
///     "sinks": [{"type": "http", "url": "https://collector.example/in", "topics": ["#", "$rtdata/account"]}]
///
/// So the receiver of what a sink sends can tell whether it has everything: of each origin, the events with sequences
/// up to `published`; and what the machine itself knows to be missing. `#` does not match the topic. With `through`,
/// the recording has to name it, too; then it waits there as all else does, when the peer is away at the end. It is
/// published only where a sink or a subscription names the topic, and a program that is killed publishes none.
""")
join("fsm/graph", "fsm/machine", "inline constexpr std::size_t max_name = 48;", head="/// Graph: the states and transitions of a machine as data",
     at="struct Graph {", comment="""\
/// The states and transitions of a machine as data: to look for mistakes, and to draw.
///
///     const fsm::Graph graph = machine.graph();
///     for (const fsm::GraphFault& fault : fsm::find_faults(graph)) print(fault.text);
///     print(fsm::mermaid(graph));
""")
join("config/settings", "config/system", "struct PlanChange;  // config/change.hpp", head="/// Settings: the keys of a configuration file that are no parts")
join("config/secret", "config/read", "", head="/// Secrets: texts of a configuration that are taken from elsewhere",
     at="/// An object with one key, \"env\" or \"file\".\n", comment="""\
/// Whether the item is a reference to a secret: a text that is taken from elsewhere and never shown.
///
///     {"type": "...", "password": {"env": "BROKER_PASSWORD"}}
///     {"type": "...", "token": {"file": "/run/credentials/token"}}
///
/// Any text parameter may be written so, but for those that recordings hold. It is resolved when the configuration is
/// read, which blocks as the file system does; the line end at the end of a file does not count. What was resolved is
/// not in the recorded configuration, whose text keeps the reference, and is replaced by "(secret)" in errors, the log
/// and the status (Runtime::Config::secrets). A text of less than 4 bytes is not hidden: it would be found everywhere.
///
/// Errors: cannot-resolve (no such variable, file, or nothing in it), not-a-secret (a parameter that recordings hold).
///
""")
join("process/processing_parameters", "process/processing", "/// By the path of the field.\nusing Processing",
     head="/// What calibrations and filters are called in a configuration file", skip=('"rtdata/process/processing.hpp"',), comment="""\
/// What calibrations and filters are called in a configuration file: the key `process` of every sensor.
///
///     {"name": "tank", "type": "analog", ..., "process": {"value": {
///         "calibration": {"version": "2026-03", "table": [[0.5, 0], [4.5, 10]]},
///         "filters": [{"type": "median", "of": 5}, {"type": "throttle", "time": "1 s"}], "unit": "bar"}}}
""")
join("outputs/checked_actuator", "outputs/output", "using MakeActuator = ", head="/// CheckedActuator: an Actuator whose device may go away",
     skip=('"rtdata/outputs/output.hpp"',), comment="""\
/// An Actuator whose device may go away between two values, and come back without the last one.
///
/// A guard (guard.hpp) asks each second. After an error the output has failed: the guard makes another Actuator, which
/// is set to the safe value as soon as it takes that. Without a guard nobody asks.
""")
join("sensors/thermocouple", "sensors/max31856", "/// In the order of the chip's codes.\n", head="/// What thermometers for thermocouples publish",
     comment="/// What thermometers for thermocouples publish.\n")
join("control/hysteresis", "control/pid", "struct PidConfig {", head="/// Hysteresis: on-off control (bang-bang) with two thresholds", at="class Hysteresis {", comment="""\
/// On-off control (bang-bang) with two thresholds, so that noise around one does not switch back and forth.
///
///     rtdata::Hysteresis fan({.on = 28, .off = 26});   // cools: on from 28 up, off from 26 down
///     rtdata::Hysteresis heater({.on = 18, .off = 20});  // heats: on from 18 down, off from 20 up
///     output.set(fan.update(temperature));
///
/// Between the thresholds it stays as it is; at first off. What is not finite changes nothing.
""")
name = public("control/pid")
if (tree / name).is_file():  # the comment at its head becomes that of the class
    text = read(name)
    head, rest = text.split("#pragma once\n", 1)
    if not head.startswith("/// Pid: a proportional-integral-derivative controller") or "A value; one thread at a time. Takes no memory" not in head:
        problems.append(f"{name}: its comment is another one")
    elif rest.count("class Pid {\n") != 1:
        problems.append(f"{name}: no class Pid")
    else:
        head = head.replace("/// Pid: a proportional-", "/// A proportional-").replace(
            "/// A value; one thread at a time. Takes no memory, throws nothing. Form and anti-windup", "/// Form and anti-windup")
        write(name, "/// Hysteresis, Pid: controllers, which an output uses by `hysteresis` and `pid`.\n///\n"
                    "/// Values without a loop; one thread at a time. They take no memory and throw nothing.\n#pragma once\n"
                    + rest.replace("class Pid {\n", head + "class Pid {\n"))

# What sensors and feeds have in common in a file stands beside each of them.
crumb = public("sensors/sensor_parameters")
merged[crumb] = public("sensors/feed")
if (tree / crumb).is_file():
    head, _, _, body = parse(crumb)
    mark = "constexpr auto parameters(type_tag<FeedConfig>)"
    anchors = {public("sensors/sensor"): "namespace detail {\n\nclass SensorNode;", public("sensors/feed"): "namespace detail {\n\nclass FeedNode;"}
    if body.count(mark) != 1 or any(read(name).count(anchor) != 1 for name, anchor in anchors.items()):
        problems.append(f"{crumb}: it is not what it was, or those that it joins are not; it is not joined")
        del merged[crumb]
    else:
        own, feed = body.split(mark)
        comment = """\
/// What the parts that all sensors have in common are called in a configuration file.
///
///     {"name": "chamber", "topic": "pressure/chamber", "rate": "100 Hz", "retry_first": "100 ms", ...}
///
/// Read them with `read_config(item, config, problems, UnknownKeys::ignore)`; the rest is the sensor's own Config.
"""
        put(public("sensors/sensor"), comment + own.rstrip() + "\n", anchors[public("sensors/sensor")])
        put(public("sensors/feed"), mark + feed, anchors[public("sensors/feed")])
        add_includes(public("sensors/sensor"), ["<chrono>"], ['"rtdata/data/parameter.hpp"'])
        add_includes(public("sensors/feed"), [], ['"rtdata/data/parameter.hpp"'])
        git("rm", "-q", "-f", crumb)

# Sums of instants are data; the heap of deadlines is the loop's.
old = "src/loop/support/deadline.hpp"
if (tree / old).is_file():
    text = read(old)
    pieces = re.fullmatch(r"(// Deadlines: .*?)#pragma once\n\n.*?namespace rtdata::detail \{\n\n(.*?)(class Deadline \{\n.*)", text, re.S)
    if not pieces:
        problems.append(f"{old}: it is not what it was; it is not divided")
    else:
        write("src/data/saturating.hpp", "// Sums and differences of instants and spans: what would not fit is the first or the last that does.\n#pragma once\n\n"
              "#include <chrono>\n#include <cstdint>\n\n#include \"rtdata/data/time.hpp\"\n\nnamespace rtdata::detail {\n\n"
              + pieces.group(2).rstrip() + "\n\n}  // namespace rtdata::detail\n")
        write(old, pieces.group(1) + "#pragma once\n\n#include <algorithm>\n#include <cstddef>\n#include <cstdint>\n#include <vector>\n\n"
              "#include \"data/saturating.hpp\"\n\nnamespace rtdata::detail {\n\n" + pieces.group(3))
        git("add", "src/data/saturating.hpp")
        for name in tracked():
            if re.match(r"(src|tests)/.*\.[ch]pp$", name) and name != old:
                text = read(name)
                if '#include "loop/support/deadline.hpp"' in text and not re.search(r"\bDeadline(Heap)?\b", re.sub(r"//.*", "", text)):
                    new = text.replace('#include "loop/support/deadline.hpp"', '#include "data/saturating.hpp"')
                    write(name, sorted_includes(new, text))

# --- Moves --------------------------------------------------------------------------------------------------------------------
moved = {}  # old path: new path
for old, new in PUBLIC.items():
    moved[f"include/rtdata/{old}"] = f"include/rtdata/{new}"
for old, new in SOURCES.items():
    for end in (".hpp", ".cpp"):
        if (tree / f"src/{old}{end}").is_file() or (tree / f"src/{new}{end}").is_file():
            moved[f"src/{old}{end}"] = f"src/{new}{end}"
for name in tracked():
    for old, new in FOLDERS.items():
        if name.startswith(f"src/{old}/"):
            moved[name] = f"src/{new}/{name.rpartition('/')[2]}"
moved |= INTO_SOURCES
for old, new in moved.items():
    there, here = (tree / new).is_file(), (tree / old).is_file()
    if here and there:
        problems.append(f"{old} and {new} are both there")
    elif here:
        (tree / new).parent.mkdir(parents=True, exist_ok=True)
        git("mv", old, new)
    elif not there:
        problems.append(f"neither {old} nor {new} is there")
for name in tracked():
    if name.startswith("src/loop/support/"):
        problems.append(f"{name}: loop/support is dissolved; say in moves.py where it goes")

# --- Paths in all texts ----------------------------------------------------------------------------------------------------------
# Folders that moved whole: also files that were moved on another branch, or have gone.
paths = dict(moved)
for old, new in merged.items():
    paths[old] = moved.get(new, new)
forms = {}
for old, new in paths.items():
    forms[old] = new
    for top in ("include/", "src/"):
        if old.startswith(top):
            forms[old.removeprefix(top)] = re.sub(r"^(include|src)/", "", new)
everywhere = re.compile(r"(?<![\w.-])(" + "|".join(sorted(map(re.escape, [form for form in forms if form.startswith(("include/", "src/", "rtdata/"))]),
                                                             key=len, reverse=True)) + r")(?![\w])")
in_includes = re.compile(r'(#\s*include\s+")(' + "|".join(sorted(map(re.escape, [form for form in forms if not form.startswith(("include/", "src/", "rtdata/"))]),
                                                                 key=len, reverse=True)) + r')(")')
in_folders = re.compile(r"\bsrc/(" + "|".join(map(re.escape, FOLDERS)) + r")(?![\w])")
in_folders_of_includes = re.compile(r'(#\s*include\s+")(' + "|".join(map(re.escape, FOLDERS)) + r")(?=/)")


for name in tracked():
    if not re.search(r"(\.([ch]pp|c|h|md|py|sh|cmake|txt|build|in|sources|json|yml|yaml|toml)$|^script/|^debian/|^tests/|^packaging/|^\.)", name):
        continue
    if name == "CHANGELOG.md" or name == "tests/build/layers.py":
        continue
    try:
        before = read(name)
    except UnicodeDecodeError:
        continue
    text = everywhere.sub(lambda found: forms[found.group(1)], before)
    text = in_includes.sub(lambda found: found.group(1) + forms[found.group(2)] + found.group(3), text)
    text = in_folders_of_includes.sub(lambda found: found.group(1) + FOLDERS[found.group(2)], text)
    text = in_folders.sub(lambda found: "src/" + FOLDERS[found.group(1)], text)
    if text != before:
        if name.endswith((".cpp", ".hpp")):
            text = sorted_includes(text, before)
        write(name, text)

# A header includes itself no more (what joined it did so, or the other way round).
for name in tracked():
    if name.endswith(".hpp") and name.startswith(("include/", "src/")):
        own = f'#include "{name.partition("/")[2]}"\n'
        text = read(name)
        if own in text:
            write(name, text.replace(own, ""))

# --- Units ---------------------------------------------------------------------------------------------------------------------
# A unit is of one folder. What moved into another one leaves its unit, in the same order; what has a unit of its own here:
UNITS = [  # (the folder or file, the unit before whose first path it is put)
    ("src/net/", "src/outputs/"), ("src/testing/", None), ("src/recording/", "src/sensors/"),
]
name = "src/rtdata.sources"
units = [unit.split("\n") for unit in re.split(r"\n{2,}", read(name).strip("\n"))]


def take(prefix):
    taken = []
    for unit in units:
        for path in [path for path in unit if path.startswith(prefix)]:
            unit.remove(path)
            taken.append(path)
    return taken


if any(len({"/".join(path.split("/")[:2]) for path in unit if not path.startswith("#")}) > 1 for unit in units):
    for prefix, before in UNITS:
        taken = take(prefix)
        units = [unit for unit in units if unit]
        at = next((i for i, unit in enumerate(units) if before and unit[0].startswith(before)), len(units))
        if taken:
            units.insert(at, taken)
for path, first in (("src/loop/core/cycle_clock.cpp", "src/loop/core/blame.cpp"), ("src/config/read/secret.cpp", "src/config/read/builder.cpp")):
    home = next((unit for unit in units if first in unit), None)
    if home is None:
        problems.append(f"{name}: there is no {first}")
    elif path not in home:
        take(path)
        home.append(path)
        home[home[0].startswith("#"):] = sorted(home[home[0].startswith("#"):])
units = [unit for unit in units if unit]
write(name, "\n\n".join("\n".join(unit) for unit in units) + "\n")

# --- Words that name headers -----------------------------------------------------------------------------------------------------
include = "include/rtdata/"
for name, old, new in (
    (include + "config/registry.hpp", "reading takes (load.hpp)", "reading takes (loop.hpp)"),
    (include + "config/system.hpp", "that were resolved (secret.hpp)", "that were resolved (read.hpp)"),
    (include + "config/system.hpp", "may hold it (load.hpp)", "may hold it (LoopLoad)"),
    (include + "recording/recording.hpp", "/// See health.hpp.", "/// See HealthChange (runtime.hpp)."),
    (include + "sensors/sensor.hpp", "takes at most, see load.hpp", "takes at most, see loop.hpp"),
    (include + "outputs/output.hpp", "in the output (control/pid.hpp)", "in the output (controllers.hpp)"),
    (include + "data/parameter.hpp", "never shown; see secret.hpp.", "never shown; see read.hpp."),
    (include + "loop/loop.hpp", "configurations say: see load.hpp.", "configurations say: see LoopLoad."),
    ("docs/sinks.md", "| `SqliteSink`, `sqlite.hpp` |", "| `SqliteSink`, `rtdata/recording/sqlite.hpp` |"),
    ("docs/sinks.md", "| `PostgresqlSink`, `postgresql.hpp` |", "| `PostgresqlSink`, `rtdata/postgresql/sink.hpp` |"),
    ("docs/sinks.md", "| kind | class, header in `rtdata/sinks/` |", "| kind | class, header (in `rtdata/sinks/` unless it says more) |"),
    ("cmake/examples.cmake", 'MATCHES "rtdata/sinks/sqlite"', 'MATCHES "rtdata/recording/"'),
):
    if old != new:
        replace(name, old, new)

# --- docs --------------------------------------------------------------------------------------------------------------------------
if not (tree / "docs/headers.md").is_file():
    write("docs/headers.md", (parts / "headers.md").read_text())
    git("add", "docs/headers.md")
replace("README.md", "[handles](docs/handles.md), [embedding](docs/embedding.md)", "[handles](docs/handles.md), [embedding](docs/embedding.md), [headers](docs/headers.md)")
page = "docs/architecture.md"
ROWS = {  # a row of the table of folders by its first cell, once it has been rewritten
    "| `include/rtdata/` |": "| `include/rtdata/` | public headers, in folders as `src/` has; none of another library. `chips`: a driver each; `testing`: fakes of buses and lines; `detail`: what other public headers need and programs do not use, by the same folders | |",
    "| `src/data/` |": "| `src/data/` | descriptions, values, codecs, errors, times; items of a configuration and what components declare of their parameters; what needs no loop: sums of instants that saturate, delays before trying again, names | |",
    "| `src/loop/` |": "| `src/loop/` | `core`: one loop, its turns, deadlines, timers, lanes; `events`: topics, subscriptions, origins; `runtime`: what a loop has beside its turns: names, clock, reports, the exchange with other loops; `tier`: loops on other threads | data |",
    "| `src/io/` |": "| `src/io/` | serial lines, buses (I2C, SPI, serial ports, Modbus), GPIO lines, IIO devices |loop |",
    "| `src/sensors/` |": "| `src/sensors/` | `core`: the sensor and what it does with a device; a folder for each kind: `analog`, `derived`, `gpio`, `gps`, `host`, `kernel` (IIO, counters, 1-Wire, PPS), `modbus`, `mqtt`, `serial`. Drivers of chips are headers in `include/rtdata/chips/`, with no source | io, net, process |",
    "| `src/sinks/` |": "| `src/sinks/` | `core`: the sink, its queue and account; a folder for each kind: `file`, `console`, `tcp` (with UDP), `http`, `mqtt` | io, net |",
}
AFTER = {
    "| `src/io/` |": "| `src/net/` | clients of servers: TCP, TLS, HTTP, MQTT, looking names up | io |\n| `src/testing/` | the fakes of buses and lines, with which programs test their sensors | io |",
    "| `src/sinks/` |": "| `src/recording/` | the SQLite recording: writing, its account, sealing, reading, verifying, and the rows for sinks that go through it | sinks |\n| `src/postgresql/` | the sink of a PostgreSQL server, and getting a recording back from it | recording |",
}
lines = read(page).split("\n")
for first, row in ROWS.items():
    row = row.replace(" |loop |", " | loop |")
    at = [i for i, line in enumerate(lines) if line.startswith(first)]
    if len(at) != 1:
        problems.append(f"{page}: {len(at)} rows {first}")
        continue
    lines[at[0]] = row
    if first in AFTER and lines[at[0] + 1] != AFTER[first].split("\n")[0]:
        lines[at[0] + 1:at[0] + 1] = AFTER[first].split("\n")
write(page, "\n".join(lines))
for old, new in (
    ("`tests/build/layers.py` holds this table, and that each public header compiles alone. Public headers lie one level deep, so that\nthe lines with which users include them stay when a file moves to another room.",
     "`tests/build/layers.py` holds this table, and that each public header compiles alone; it names the sources that still include what\nlies higher. Public headers lie one level deep, so that the lines with which users include them stay when a file moves to another\nroom. [headers.md](headers.md) has those that are needed first."),
    ("a driver, which is one header in `include/rtdata/sensors/`, as `lm75.hpp` there:", "a driver, which is one header in `include/rtdata/chips/`, as `lm75.hpp` there:"),
):
    replace(page, old, new)

# --- layers.py ------------------------------------------------------------------------------------------------------------------------
rooms = ["core", "events", "runtime", "tier"]
upwards, private = {}, {}
for path in sorted((tree / "src/loop").rglob("*.cpp")):
    for included in re.findall(r'^#include "(loop/[^"]+)"', path.read_text(), re.M):
        if rooms.index(included.split("/")[1]) > rooms.index(path.relative_to(tree / "src").parts[1]):
            upwards.setdefault(included, []).append(path.relative_to(tree / "src").as_posix())
for path in sorted((tree / "src/app").rglob("*.[ch]pp")):
    for included in re.findall(r'^#include "((?!rtdata/|app/)[^"]+)"', path.read_text(), re.M):
        private.setdefault(included, []).append(path.relative_to(tree / "src").as_posix())


def table(name, found):
    lines = [f"{name} = {{"]
    for included, files in sorted(found.items()):
        line = f'    "{included}": {{'
        for i, file in enumerate(sorted(set(files))):
            item = f'"{file}"' + (", " if i + 1 < len(set(files)) else "")
            if len(line) + len(item) > 118:
                lines.append(line.rstrip())
                line = "        "
            line += item
        lines.append(line + "},")
    return "\n".join(lines + ["}"])


template = (parts / "layers.py").read_text()
layers = read("tests/build/layers.py")
if "below = {" not in layers or "rooms = {" not in layers:
    problems.append("tests/build/layers.py: it is another one")
elif '"recording": {' not in layers and '[{"support"}, {"core"}, {"events"}, {"runtime"}, {"tier"}]' not in layers:
    problems.append("tests/build/layers.py: it is another one; compare it with moves.d/layers.py")
write("tests/build/layers.py", template.replace("UPWARDS", table("upwards", upwards)).replace("PRIVATE", table("private", private)))

# --- What is left ------------------------------------------------------------------------------------------------------------------------
names = {name for name in tracked()}
for name in sorted(names):
    if name.endswith((".cpp", ".hpp")) and name.startswith(("src/", "include/", "tests/", "examples/")):
        for included in re.findall(r'^\s*#\s*include\s+"([^"]+)"', read(name), re.M):
            folder = name.rpartition("/")[0]
            if not any((tree / root / included).is_file() for root in ("include/", "src/", "tests/", "", f"{folder}/")):
                problems.append(f"{name}: #include \"{included}\" finds nothing")
    if name.endswith(".sources"):
        for path in read(name).split("\n"):
            if path and not path.startswith("#") and path not in names:
                problems.append(f"{name}: {path} is not there")
git("add", "-u")
headers = [name for name in names if name.startswith("include/rtdata/") and name.endswith(".hpp")]
apart = [name for name in headers if name.startswith(("include/rtdata/chips/", "include/rtdata/testing/", "include/rtdata/detail/"))]
print(f"{len(headers)} public headers: {len([n for n in apart if '/chips/' in n and '/detail/' not in n])} in chips, "
      f"{len([n for n in apart if '/testing/' in n])} in testing, {len([n for n in apart if '/detail/' in n])} in detail, {len(headers) - len(apart)} others")
print(f"sources of loop that include upwards: {sum(map(len, upwards.values()))}; private headers that src/app includes: {len(private)}, "
      f"in {len({one for files in private.values() for one in files})} files")
for problem in problems:
    print(problem)
sys.exit(1 if problems else 0)
