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
# Of each layer, which is a folder of src, of include/rtdata and of include/rtdata/detail, the layers and single headers that it may include. The
# deepest folder that is named here counts: "sensors/core" is a layer of its own once it has a row. Configurations know
# the bases of sensors and sinks, and no kind of them.
below = {
    "data": set(),
    "loop": {"data"},
    "io": {"data", "loop"},
    "net": {"data", "loop", "io"},
    "testing": {"data", "loop", "io"},
    "process": {"data", "loop"},
    "sensors": {"data", "loop", "io", "net", "process"},  # every sensor processes its samples before it publishes them
    "chips": {"data", "loop", "io", "process", "sensors"},
    "sinks": {"data", "loop", "io", "net"},
    "recording": {"data", "loop", "io", "sinks"},
    "postgresql": {"data", "loop", "io", "sinks", "recording"},
    "fsm": {"data", "loop", "io", "process", "sensors/feed.hpp", "sensors/sensor.hpp"},  # a machine publishes by a feed
    "control": {"data"},
    "outputs": {"data", "loop", "io", "net", "process", "control", "sensors/derived.hpp", "sensors/feed.hpp", "sensors/sensor.hpp", "sensors/core/feed_node.hpp"},  # an output is a feed of its changes
    "config": {"data", "loop", "io", "control", "outputs/guard.hpp", "outputs/output.hpp", "sensors/driver.hpp", "sensors/sensor.hpp", "sensors/feed.hpp", "sinks/sink.hpp", "process/processing.hpp"},
    "app": {"data", "loop", "io", "net", "process", "sensors", "chips", "sinks", "recording", "postgresql", "fsm", "outputs", "control", "config"},
}
# Rooms of a folder, lowest first: a file includes headers of its own room and of lower ones.
rooms = {
    "loop": [{"core"}, {"events"}, {"runtime"}, {"tier"}],
    "sensors": [{"core"}, {"analog", "derived", "gpio", "gps", "host", "kernel", "lines", "modbus"}, {"http", "mqtt"}],
    "sinks": [{"core"}, {"console", "file", "http", "mqtt", "tcp"}],
    "config": [{"read"}, {"schema"}, {"plan"}],
    "app": [{"core"}, {"machine"}, {"bench", "control"}, {"inspect"}, {"page"}, {"run"}],
}
# The sources that include a header of a higher room all the same, since objects of a loop register with its runtime: by the
# header. None is added, and one that does so no more is taken out.
upwards = {
    "loop/runtime/runtime_core.hpp": {"loop/core/blame.cpp", "loop/core/deliveries.cpp", "loop/core/lane.cpp",
        "loop/core/load.cpp", "loop/core/loop.cpp", "loop/core/loop_core.cpp", "loop/core/nodes.cpp",
        "loop/core/posts.cpp", "loop/core/run.cpp", "loop/core/schedule.cpp", "loop/core/timer.cpp",
        "loop/core/watch.cpp", "loop/events/made_of.cpp", "loop/events/origin_core.cpp",
        "loop/events/subscription.cpp", "loop/events/topic_core.cpp"},
    "loop/tier/bridge.hpp": {"loop/events/topic_core.cpp", "loop/runtime/exchange.cpp", "loop/runtime/names.cpp",
        "loop/runtime/runtime.cpp", "loop/runtime/runtime_core.cpp"},
    "loop/tier/tier_core.hpp": {"loop/runtime/drain.cpp", "loop/runtime/exchange.cpp", "loop/runtime/runtime.cpp",
        "loop/runtime/runtime_core.cpp"},
}
# The program includes public headers only. The private ones of other folders that it still includes, and where; likewise.
private = {
    "config/plan/written_file.hpp": {"app/run/log_file.cpp"},
    "config/read/mistakes.hpp": {"app/core/recordings.cpp", "app/core/shipped_sinks.cpp",
        "app/machine/doctor_parts.cpp", "app/run/data_at_risk.cpp", "app/run/forward.cpp", "app/run/growth.cpp",
        "app/run/log_file.cpp"},
    "data/csv_row.hpp": {"app/inspect/import_columns.hpp", "app/inspect/import_rows.hpp"},
    "data/fitting.hpp": {"app/control/commands.cpp"},
    "data/listed.hpp": {"app/control/commands.cpp", "app/control/status_view.cpp", "app/core/program.cpp",
        "app/core/shipped_sinks.cpp", "app/inspect/info.cpp", "app/inspect/types.cpp",
        "app/inspect/types_markdown.cpp", "app/machine/doctor_rules.cpp", "app/run/data_at_risk.cpp",
        "app/run/init.cpp", "app/run/reload.cpp", "app/run/run.cpp"},
    "data/lower_case.hpp": {"app/inspect/import.cpp", "app/inspect/import_time.cpp", "app/inspect/import_columns.cpp",
                            "app/inspect/import_zone.cpp"},
    "data/nearest.hpp": {"app/inspect/import_head.cpp"},
    "data/number_text.hpp": {"app/control/commands.cpp", "app/control/control_socket.cpp",
        "app/core/recording_arguments.cpp", "app/inspect/import_columns.cpp", "app/inspect/import_time.cpp",
        "app/run/service.cpp"},
    "data/permissions.hpp": {"app/run/log.cpp"},
    "data/rounded_time.hpp": {"app/bench/bench.cpp", "app/control/status_view.cpp", "app/inspect/info.cpp"},
    "data/saturating.hpp": {"app/core/machines.cpp", "app/inspect/import_time.cpp", "app/inspect/import.cpp", "app/run/replay.cpp"},
    "data/utf8.hpp": {"app/control/top.cpp", "app/core/table.cpp", "app/core/terminal_text.cpp",
        "app/inspect/import.cpp", "app/inspect/import_rows.cpp", "app/run/log.cpp"},
    "data/wrap.hpp": {"app/inspect/info.cpp"},
    "fsm/configured.hpp": {"app/control/commands.cpp", "app/control/status_source.cpp", "app/core/machines.hpp",
        "app/inspect/graph.cpp"},
    "io/enabling.hpp": {"app/machine/doctor_parts.cpp", "app/machine/machine_files.cpp", "app/machine/scan_gpsd.cpp",
        "app/machine/scan_i2c.cpp", "app/machine/scan_iio.cpp", "app/machine/scan_serial.cpp",
        "app/machine/scan_spi.cpp"},
    "io/gpio_lookup.hpp": {"app/machine/doctor_parts.cpp"},
    "io/kernel_file.hpp": {"app/machine/doctor_parts.cpp", "app/machine/scan_serial.cpp"},
    "loop/core/callback_survey.hpp": {"app/control/status_source.cpp"},
    "loop/core/loop_core.hpp": {"app/control/commands.cpp", "app/control/control_socket.cpp",
        "app/control/status_source.cpp", "app/core/machine_resume.cpp", "app/core/machines.cpp",
        "app/run/passing_time.cpp", "app/run/run.cpp"},
    "loop/core/no_thread.hpp": {"app/run/async_writer.cpp", "app/run/stop_signals.cpp"},
    "loop/core/signals_blocked.hpp": {"app/run/async_writer.cpp"},
    "loop/runtime/final_account.hpp": {"app/control/account.cpp"},
    "loop/runtime/runtime_core.hpp": {"app/control/account.cpp", "app/control/commands.cpp",
        "app/control/status_source.cpp", "app/core/machine_resume.cpp", "app/core/machines.cpp",
        "app/run/passing_time.cpp", "app/run/replay.cpp", "app/run/run.cpp"},
    "loop/tier/processors.hpp": {"app/bench/bench.cpp", "app/machine/doctor_rules.cpp"},
    "loop/tier/tier_core.hpp": {"app/control/commands.cpp", "app/control/status_source.cpp"},
    "net/ip_address.hpp": {"app/page/page_server.cpp"},
    "net/tls_mistakes.hpp": {"app/page/check_page.cpp"},
    "net/http_url.hpp": {"app/core/shipped_outputs.cpp"},
    "recording/account_text.hpp": {"app/control/account.cpp", "app/inspect/report_figures.cpp", "app/page/view.cpp"},
    "recording/recording_file.hpp": {"app/inspect/export_table.cpp", "app/run/left_backlogs.cpp"},
    "recording/replay_choice.hpp": {"app/run/replay.cpp"},
    "sinks/core/sink_node.hpp": {"app/run/passing_time.cpp"},
}
problems = []
needed = set()  # of these


def layer_of(name):
    """Of "sensors/sensor.hpp"; "" when it lies in none."""
    folder = name.removeprefix("detail/").rpartition("/")[0]
    while folder and folder not in below:
        folder = folder.rpartition("/")[0]
    return folder


def room_of(name):
    """Of "loop/core/lane.cpp": its folder, its room, and how high that lies."""
    folder, room = (name.split("/") + [""])[:2]
    for height, alike in enumerate(rooms.get(folder, [])):
        if room in alike:
            return folder, room, height
    return folder, "", 0


def is_upwards(name, included):
    folder, room, height = room_of(name)
    other_folder, other, other_height = room_of(included)
    if folder != other_folder or not room or not other or room == other:
        return False
    if other_height >= height and name in upwards.get(included, ()):
        needed.add((included, name))
        return False
    return other_height >= height


def look_at(path, folder):
    name = path.relative_to(folder).as_posix()
    layer = layer_of(name)
    if not layer:
        problems.append(f"{path.relative_to(root)} lies in no layer")
        return
    public = folder.name == "rtdata"
    if not public and name.split("/")[0] in rooms and not room_of(name)[1] and name != "app/main.cpp":
        problems.append(f"{path.relative_to(root)} lies in no room of its folder")
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
        if not public and is_upwards(name, included):
            problems.append(f"{where}: {included} lies no lower than this room")
        if name.startswith("app/") and not included.startswith(("rtdata/", "app/")):
            needed.add((included, name))
            if name not in private.get(included, ()):
                problems.append(f"{where}: the program includes {included}, which is private to another folder")
        included = included.removeprefix("rtdata/").removeprefix("detail/")
        other = layer_of(included)
        if other not in below[layer] | {layer} and included not in below[layer]:
            problems.append(f"{where}: {layer} includes {other or 'a header of no layer'} ({included})")


for folder in (root / "include" / "rtdata", root / "src"):
    for path in sorted(folder.glob("**/*.hpp")) + sorted(folder.glob("**/*.cpp")):
        look_at(path, folder)
for known in (upwards, private):
    for included, names in known.items():
        problems.extend(f"{name} includes {included} no more: take it out of layers.py" for name in sorted(names)
                        if (included, name) not in needed)


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
