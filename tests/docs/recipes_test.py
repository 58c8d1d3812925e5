"""Holds docs/recipes to the product:  recipes_test.py SOURCE_DIR PROGRAM [PAGE...]

Each page has a configuration, a sample of what its device sends, and the values that come of it. The device is that of
its first sensor, and the values are those of its last; fields that the page leaves out have none. The test is the
device: a pseudo terminal, a program, a client of a real broker, or a server of HTTP. `rtdata run` must store exactly the values of the
page, and refuse nothing, though it begins in the middle of a line.

Samples are ```hex, or ```text, whose lines end with CR LF and in which <02> stands for the byte 2. Of a device that
answers, "> " begins what it is asked and "< " what it answers; of one at a broker, each line has the topic first; of a
URL, each line is an answer.
"""
import csv
import io
import json
import os
import re
import select
import shutil
import signal
import socket
import sqlite3
import struct
import subprocess
import sys
import tempfile
import threading
import time
import tty
import urllib.parse
from concurrent.futures import ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

BLOCK = re.compile(r"(?:<!-- test: configuration(?P<types>.*?) -->\n+)?^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.S | re.M)
PATIENCE = 30  # seconds for what takes a fraction of one
MOSQUITTO = shutil.which("mosquitto", path=os.environ.get("PATH", "") + ":/usr/sbin:/usr/local/sbin")


class Wrong(Exception):
    pass


def until(done, what):
    end = time.monotonic() + PATIENCE
    while not done():
        if time.monotonic() > end:
            raise Wrong(f"{what} within {PATIENCE} s")
        time.sleep(0.005)


def bytes_of(language, text):
    if language == "hex":
        return bytes.fromhex(text)
    data = text.replace("\n", "\r\n").encode("latin-1")
    return re.sub(rb"<([0-9A-F]{2})>", lambda match: bytes.fromhex(match[1].decode()), data)


class Terminal:
    """A device at a serial line. The program opens its path, as that of any other."""

    def __init__(self):
        self.device, line = os.openpty()
        tty.setraw(line)
        self.path = os.ttyname(line)
        os.close(line)

    def wait_until_opened(self):
        poll = select.poll()
        poll.register(self.device, 0)
        until(lambda: not poll.poll(0), "the device was not opened")

    def send(self, data):
        while data:
            data = data[os.write(self.device, data):]


class Talker(Terminal):
    """Sends a sample, after the end of what it sent before anybody listened."""

    def __init__(self, sensor, language, text):
        super().__init__()
        self.name, sensor["device"] = sensor["device"], self.path
        frame = sensor.get("frame", {})
        without_start = frame and not ("start" in frame or "start_hex" in frame)
        last = bytes_of(language, text.splitlines(keepends=True)[-1])  # of text a line, of bytes a frame
        self.sample = (last if without_start else last[len(last) // 2:]) + bytes_of(language, text)

    def play(self, stopped):
        self.wait_until_opened()
        self.send(self.sample)


class Answerer(Terminal):
    """Answers requests, each with the next of its answers; nothing to others."""

    def __init__(self, sensor, bus, language, text):
        super().__init__()
        bus["device"] = self.path
        end = b"" if language == "hex" else sensor.get("answer_end", "\r\n").encode()
        self.turns = [(line[:2], bytes_of(language, line[2:])) for line in text.splitlines()]
        self.turns = [(kind, data + (end if kind == "< " else b"")) for kind, data in self.turns]
        self.request_ends = b"$" if language == "hex" else rb"([\r\n]|$)"

    def play(self, stopped):
        self.wait_until_opened()
        heard = b""
        turns = list(self.turns)
        while turns and not stopped.is_set():
            if turns[0][0] == "< ":
                self.send(turns.pop(0)[1])
            elif re.search(rb"(^|[\r\n])" + re.escape(turns[0][1]) + self.request_ends, heard):
                turns.pop(0)
                heard = b""
            elif select.select([self.device], [], [], 0.05)[0]:
                heard += os.read(self.device, 4096)


class Script:
    """A program that prints the sample, in the place of the page's."""

    def __init__(self, sensor, sample, folder):
        (folder / "sample").write_bytes(sample)
        sensor["run"] = ["sh", "-c", f"cat '{folder}/sample'; exec sleep 1000"]

    def play(self, stopped):
        pass


class Publisher:
    """A client of mosquitto. MQTT 5, since its answer says whether somebody is subscribed."""

    def __init__(self, sensor, text, folder):
        with socket.socket() as finder:
            finder.bind(("127.0.0.1", 0))
            self.port = finder.getsockname()[1]
        (folder / "mosquitto.conf").write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\nuser root\n")
        with (folder / "mosquitto.log").open("w") as log:
            self.broker = subprocess.Popen([MOSQUITTO, "-c", folder / "mosquitto.conf"], stdout=log, stderr=log)
        sensor.update(host="127.0.0.1", port=self.port)
        self.messages = [line.split(" ", 1) for line in text.splitlines()]

    def play(self, stopped):
        def connected():
            try:
                self.line = socket.create_connection(("127.0.0.1", self.port), PATIENCE)
                return True
            except OSError:
                return False

        until(connected, "there was no broker")
        self.send(0x10, b"\0\4MQTT\5\2\0\0\0" + self.text("recipe"))
        self.receive()
        for number, (topic, message) in enumerate(self.messages, 1):
            until(lambda: self.publish(number, topic, message), "nobody was subscribed")

    def publish(self, number, topic, message):
        self.send(0x32, self.text(topic) + struct.pack(">HB", number, 0) + message.encode())
        answer = self.receive()
        return len(answer) == 2 or answer[2] != 0x10  # no matching subscribers

    @staticmethod
    def text(text):
        return struct.pack(">H", len(text)) + text.encode()

    def send(self, kind, body):
        length, size = b"", len(body)
        while True:
            length += bytes([size % 128 | (128 if size >= 128 else 0)])
            size //= 128
            if size == 0:
                break
        self.line.sendall(bytes([kind]) + length + body)

    def receive(self):
        size = self.line.recv(2, socket.MSG_WAITALL)[1]  # of the answers here, below 128
        return self.line.recv(size, socket.MSG_WAITALL)

    def close(self):
        self.broker.kill()
        self.broker.wait()


class Server:
    """Answers at the page's path, each time with the next line, and then that nothing has changed."""

    def __init__(self, sensor, text):
        url = urllib.parse.urlsplit(sensor["url"])
        lines = text.splitlines()

        class Handler(BaseHTTPRequestHandler):
            answered = 0

            def log_message(self, *_):
                pass

            def do_GET(self):
                is_asked = self.path == urllib.parse.urlunsplit(("", "", url.path, url.query, ""))
                is_over = Handler.answered == len(lines)
                self.send_response(404 if not is_asked else 304 if is_over else 200)
                self.send_header("ETag", f'"{Handler.answered}"')
                self.end_headers()
                if is_asked and not is_over:
                    self.wfile.write(lines[Handler.answered].encode())
                    Handler.answered += 1

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        here = url._replace(scheme="http", netloc=f"127.0.0.1:{self.server.server_address[1]}")
        sensor.update(rate="10 Hz", url=here.geturl())
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def play(self, stopped):
        pass

    def close(self):
        self.server.shutdown()
        self.server.server_close()


def device_of(config, language, text, folder):
    sensor = config["sensors"][0]
    if "bus" in sensor:
        return Answerer(sensor, config["buses"][sensor["bus"]], language, text)
    if sensor["type"] == "mqtt":
        return Publisher(sensor, text, folder)
    if sensor["type"] == "http":
        return Server(sensor, text)
    if sensor["type"] == "command":
        return Script(sensor, bytes_of(language, text), folder)
    return Talker(sensor, language, text)


def refused(database):
    """What was unreadable, thrown away as a first line, or lost."""
    with sqlite3.connect(f"file:{database}?mode=ro", uri=True) as connection:
        counts = "sum(unreadable) + sum(coalesce(first_lines, 0)) + sum(coalesce(lost, 0))"
        return connection.execute(f"SELECT {counts} FROM rtdata_ledger").fetchone()[0]


def rows_stored(database, table):
    try:
        with sqlite3.connect(f"file:{database}?mode=ro", uri=True) as connection:
            return connection.execute(f'SELECT count(*) FROM "{table}"').fetchone()[0]
    except sqlite3.OperationalError:
        return 0  # not made yet


def run(command):
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def try_page(program, page, folder):
    """Why it is skipped, or None."""
    blocks = list(BLOCK.finditer(page.read_text()))
    configurations = [block for block in blocks if block["types"] is not None]
    samples = [block for block in blocks if block["language"] in ("text", "hex")]
    tables = [block for block in blocks if block["language"] == "csv"]
    if [len(configurations), len(samples), len(tables)] != [1, 1, 1]:
        raise Wrong("it needs one configuration, one sample and one table of values")
    for name in configurations[0]["types"].split():
        if run([program, "types", name, "--schema"]).returncode != 0:
            return f"this program has no type {name}"
    config = json.loads(configurations[0]["text"])
    if config["sensors"][0]["type"] == "mqtt" and MOSQUITTO is None:
        return "there is no mosquitto"
    expected = list(csv.reader(io.StringIO(tables[0]["text"])))

    (folder / "page.json").write_text(configurations[0]["text"])
    database = folder / "recipe.db"
    table = config["sensors"][-1].get("topic", config["sensors"][-1]["name"])
    device = device_of(config, samples[0]["language"], samples[0]["text"], folder)
    config["sinks"][0]["path"] = str(database)
    (folder / "recipe.json").write_text(json.dumps(config))
    stopped = threading.Event()
    failures = []

    def play():
        try:
            device.play(stopped)
        except Exception as failure:  # told below
            failures.append(failure)

    player = threading.Thread(target=play, daemon=True)
    try:
        for name in ("page.json", "recipe.json"):
            checked = run([program, "check", folder / name])
            if checked.returncode != 0:
                raise Wrong(f"`check` refuses {name}:\n" + checked.stdout + checked.stderr)
        with (folder / "output").open("w") as output:
            process = subprocess.Popen([program, "run", folder / "recipe.json"], cwd=folder, stdout=output, stderr=output)
        try:
            player.start()
            try:
                until(lambda: failures or process.poll() is not None or rows_stored(database, table) >= len(expected) - 1,
                      "not all rows came")
            except Wrong as late:
                failures.append(late)
        finally:
            stopped.set()
            process.send_signal(signal.SIGTERM)
            status = process.wait(PATIENCE)
    finally:
        if isinstance(device, (Publisher, Server)):
            device.close()
    exported = run([program, "export", database, "--topic", table])
    verified = run([program, "verify", database])
    said = (folder / "output").read_text()
    if failures or status != 0 or verified.returncode != 0:
        raise Wrong(f"{failures}, `run` ended with {status}, `verify` with {verified.returncode}:\n{said}{exported.stdout}")
    is_talker = isinstance(device, Talker)
    if refused(database) > (1 if is_talker else 0):  # the end of what was sent before
        raise Wrong(f"not all of the sample is used:\n{said}")
    got = [row[3:] for row in csv.reader(io.StringIO(exported.stdout))]  # without time, origin and sequence
    shown = [column for column, name in enumerate(got[0]) if name in expected[0] or any(row[column] for row in got[1:])]
    got = [[row[column] for column in shown] for row in got]
    if is_talker:
        got = [[device.name if value == device.path else value for value in row] for row in got]
    if got != expected:
        raise Wrong(f"the values are\n{got}\nand the page says\n{expected}\n{said}")
    return None


def main():
    source, program = Path(sys.argv[1]), Path(sys.argv[2]).resolve()
    if run([program, "types", "sqlite", "--schema"]).returncode != 0:
        print("skipped: this program has no sink sqlite")
        return 77
    folder_of_pages = source / "docs/recipes"
    pages = [page for page in sorted(folder_of_pages.glob("*.md")) if page.name != "README.md"]
    wrong = []
    listed = re.findall(r"\]\(([\w-]+\.md)\)", (folder_of_pages / "README.md").read_text())
    if sorted(listed) != [page.name for page in pages]:
        wrong.append(f"README.md lists {sorted(listed)}, and there are {[page.name for page in pages]}")
    for word in ("pms5003", "dsmr", "rtl_433"):
        if "docs/recipes" not in run([program, "types", word]).stdout:
            wrong.append(f"`rtdata types {word}` does not lead to the recipes")
    chosen = [page for page in pages if not sys.argv[3:] or page.stem in sys.argv[3:]]

    def try_one(page):
        with tempfile.TemporaryDirectory() as folder:
            try:
                reason = try_page(program, page, Path(folder))
                if reason:
                    print(f"skipped: {page.name}, since {reason}")
            except (Wrong, OSError, ValueError, KeyError, subprocess.TimeoutExpired) as failure:
                wrong.append(f"{page.name}: {failure}")

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(try_one, chosen))
    for one in wrong:
        print(one)
    print(f"{len(chosen)} recipes, {len(wrong)} wrong")
    return 1 if wrong or not chosen else 0


sys.exit(main())
